"""More of the one-step methods as plain loops over NumPy scalars, as in `reference`: each by its own paper."""

import numpy as np
from reference import Agent, DoubleQLearning, F, draw, epsilon_greedy, mean

# --- by the average reward, in tasks that do not end ---------------------------------------------------


class OfRate(Agent):
    """Keeps the average reward; `beta` is the step size of it."""

    def __init__(self, *args, beta, **kwargs):
        super().__init__(*args, **kwargs)
        self.beta, self.rate = F(beta), F(0)

    def end(self, terminal, x):
        return F(0) if terminal else x


class RLearning(OfRate):
    """Schwartz 1993, as in figure 6.16 of the first edition."""

    def learn(self, s, a, r, s_next, terminal, ended, u):
        q = self.q
        q[s, a] += self.alpha(s, a) * (r - self.rate + self.end(terminal, max(q[s_next])) - q[s, a])
        if q[s, a] == max(q[s]):
            self.rate += self.beta * (r - self.rate + self.end(terminal, max(q[s_next])) - max(q[s]))
        return self.act(s_next, u)


class DifferentialQLearning(OfRate):
    """Wan, Naik and Sutton 2021, equations 4 to 6; `beta` is their eta."""

    def learn(self, s, a, r, s_next, terminal, ended, u):
        error = r - self.rate + self.end(terminal, max(self.q[s_next])) - self.q[s, a]
        self.q[s, a] += self.alpha(s, a) * error
        self.rate += self.beta * self.alpha(s, a) * error
        return self.act(s_next, u)


class DifferentialSarsa(OfRate):
    """The box of section 10.3, in which the features are those of a table."""

    def learn(self, s, a, r, s_next, terminal, ended, u):
        a_next = self.act(s_next, u)
        error = r - self.rate + self.end(terminal, self.q[s_next, a_next]) - self.q[s, a]
        self.rate += self.beta * error
        self.q[s, a] += self.alpha(s, a) * error
        return a_next


# --- with several tables, or two step sizes ------------------------------------------------------------


class Double(DoubleQLearning):
    """Ganger, Duryea and Hu 2016. `expected`: the mean over A'; else A' is the action that is taken."""

    def __init__(self, *args, expected=False, **kwargs):
        super().__init__(*args, words=None, **kwargs)
        self.expected = expected

    def learn(self, s, a, r, s_next, terminal, ended, u):
        own, other = (self.q1, self.q2) if self.heads[self.t - 1] else (self.q2, self.q1)
        epsilon = self.rates.epsilon(self.t + 1, self.episode, 1)
        a_next = None if self.expected else self.act(s_next, u)
        pi = epsilon_greedy(self.values(s_next), epsilon)
        q_next = mean(pi, other[s_next]) if self.expected else other[s_next, a_next]
        own[s, a] += self.alpha(s, a) * (r + self.discount(terminal) * q_next - own[s, a])
        return self.act(s_next, u) if self.expected else a_next


class WeightedDoubleQLearning(DoubleQLearning):
    """Zhang, Pan and Kochenderfer 2017, algorithm 1; `worst` are the words by which ties for the least are broken."""

    def __init__(self, *args, c, worst, **kwargs):
        super().__init__(*args, **kwargs)
        self.c, self.worst = F(c), worst

    def learn(self, s, a, r, s_next, terminal, ended, u):
        own, other = (self.q1, self.q2) if self.heads[self.t - 1] else (self.q2, self.q1)
        best = draw(epsilon_greedy(own[s_next], 0.0), self.words[self.t - 1])
        there = [q for q in own[s_next] if q > -np.inf]
        least = draw([F(q == min(there)) for q in own[s_next]], self.worst[self.t - 1])
        apart = abs(other[s_next, best] - other[s_next, least])
        beta = apart / (self.c + apart)
        value = beta * own[s_next, best] + (1 - beta) * other[s_next, best]
        own[s, a] += self.alpha(s, a) * (r + self.discount(terminal) * value - own[s, a])
        return self.act(s_next, u)


class MaxminQLearning(Agent):
    """Lan et al. 2020, algorithm 1, without a memory; `words` say which table learns."""

    def __init__(self, *args, tables, words, **kwargs):
        super().__init__(*args, **kwargs)
        self.tables, self.words = [self.q.copy() for _ in range(tables)], words

    def values(self, s):
        return np.array([min(q[s, a] for q in self.tables) for a in range(self.q.shape[1])])

    def learn(self, s, a, r, s_next, terminal, ended, u):
        q = self.tables[draw([1] * len(self.tables), self.words[self.t - 1])]
        target = r + self.discount(terminal) * max(self.values(s_next))
        q[s, a] += self.alpha(s, a) * (target - q[s, a])
        self.q = np.min(self.tables, 0)
        return self.act(s_next, u)


class HystereticQLearning(Agent):
    """Matignon, Laurent and Le Fort-Piat 2007."""

    def __init__(self, *args, beta, **kwargs):
        super().__init__(*args, **kwargs)
        self.beta = F(beta)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        error = r + self.discount(terminal) * max(self.q[s_next]) - self.q[s, a]
        self.q[s, a] += (self.alpha(s, a) if error >= 0 else self.beta) * error
        return self.act(s_next, u)


def array_of(outcomes):
    """P [S, A, S] and r [S, A] of a `Task`'s outcomes."""
    p = np.zeros((len(outcomes), len(outcomes[0]), len(outcomes)))
    r = np.zeros(p.shape[:2])
    for s, actions in enumerate(outcomes):
        for a, rows in enumerate(actions):
            for chance, s_next, reward, _ in rows:
                p[s, a, s_next] += chance
                r[s, a] += chance * reward
    return p, r
