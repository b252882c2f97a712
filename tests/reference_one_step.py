"""More of the one-step methods as plain loops over NumPy scalars, as in `reference`: each by its own paper."""

import numpy as np
from reference import Agent, F

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
