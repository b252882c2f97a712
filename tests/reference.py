"""The book's boxes as plain loops over NumPy scalars: what every method is compared with.

Nothing here is shared with the package but the random words: a loop is told what the word of each decision
was and makes the decision by itself. So a loop and the package must agree step for step, entry for entry.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

F = np.float32


class Words(NamedTuple):
    """Uniform numbers in [0, 1) for each decision of each step, [steps]; and for the start of the run."""

    update: np.ndarray
    start: np.ndarray
    step: np.ndarray
    reset: np.ndarray
    first_reset: float
    first_action: float


class Task(NamedTuple):
    """A finite MDP as nested tables: outcomes[s][a] = [(probability, s_next, reward, terminal), ...]."""

    outcomes: list
    initial: np.ndarray
    max_steps: int

    def begin(self, u):
        return draw(self.initial, u)

    def step(self, s, a, u):
        outcomes = self.outcomes[s][a]
        return outcomes[draw([p for p, *_ in outcomes], u) if len(outcomes) > 1 else 0][1:]


class Rates(NamedTuple):
    """alpha and epsilon as functions of (step, episode, visits): numbers of this one, counted from 1."""

    alpha: Callable
    epsilon: Callable


def draw(probabilities, u):
    """The index in whose interval u falls, the intervals laid end to end and scaled to their sum."""
    edges = np.cumsum(np.asarray(probabilities, F))
    for i, edge in enumerate(edges[:-1]):
        if F(u) * edges[-1] < edge:
            return i
    return len(edges) - 1


def epsilon_greedy(row, epsilon):
    best = [q == max(row) for q in row]
    return [F(epsilon) / F(len(row)) + (F(1) - F(epsilon)) * F(b) / F(sum(best)) for b in best]


def td_control(kind, task, num_actions, rates, gamma, num_steps, words, q0=0.0):
    """Sarsa, Q-learning and Expected Sarsa (boxes of sections 6.4, 6.5; equation 6.9).

    Returns Q [S, A], the visits [S, A], and the return and length of each finished episode.
    """
    num_states = len(task.outcomes)
    q = np.full((num_states, num_actions), q0, F)
    visits = np.zeros((num_states, num_actions), int)
    finished = []
    t, episode = 0, 1
    s = task.begin(words.first_reset)
    a = draw(epsilon_greedy(q[s], rates.epsilon(1, 1, 1)), words.first_action)
    while True:  # each episode
        g, length, ended = F(0), 0, False
        while not ended:
            if t == num_steps:
                return q, visits, finished
            s_next, reward, terminal = task.step(s, a, words.step[t])
            g += F(gamma) ** length * F(reward)
            length += 1
            visits[s, a] += 1
            ended = terminal or length == task.max_steps
            epsilon = rates.epsilon(t + 2, episode, visits[s_next].sum() + 1)
            if kind == "sarsa":
                a_next = draw(epsilon_greedy(q[s_next], epsilon), words.update[t])
                bootstrap = q[s_next, a_next]
            elif kind == "q-learning":
                bootstrap = max(q[s_next])
            else:
                pi = epsilon_greedy(q[s_next], epsilon)
                bootstrap = sum(pi[b] * q[s_next, b] for b in range(num_actions))
            target = F(reward) + (F(0) if terminal else F(gamma) * bootstrap)
            q[s, a] += F(rates.alpha(t + 1, episode, visits[s, a])) * (target - q[s, a])
            if kind != "sarsa":
                a_next = draw(epsilon_greedy(q[s_next], epsilon), words.update[t])
            s, a = s_next, a_next
            t += 1
        finished.append((g, length))
        episode += 1
        s = task.begin(words.reset[t - 1])
        epsilon = rates.epsilon(t + 1, episode, visits[s].sum() + 1)
        a = draw(epsilon_greedy(q[s], epsilon), words.start[t - 1])


# --- one loop, many agents ---------------------------------------------------------------------------


def run(agent, task, num_steps, words):
    """Lets `agent` act and learn for so many steps; the return and length of each finished episode."""
    finished, g, length = [], F(0), 0
    s = task.begin(words.first_reset)
    a = agent.act(s, words.first_action)
    for t in range(num_steps):
        s_next, reward, terminal = task.step(s, a, words.step[t])
        g += F(agent.gamma) ** length * F(reward)
        length += 1
        ended = terminal or length == task.max_steps
        agent.t += 1
        agent.visits[s, a] += 1
        a = agent.learn(s, a, F(reward), s_next, terminal, ended, words.update[t])
        s = s_next
        if ended:
            finished.append((g, length))
            g, length = F(0), 0
            agent.episode += 1
            s = task.begin(words.reset[t])
            a = agent.act(s, words.start[t])
    return finished


class Agent:
    """Acts epsilon-greedily by `values(s)`, a row of A; `learn` gives A', by the word u or later ones."""

    def __init__(self, shape, rates, gamma, q0=0.0):
        self.q = np.full(shape, q0, F)
        self.visits = np.zeros(shape, int)
        self.rates, self.gamma = rates, gamma
        self.t, self.episode = 0, 1

    def values(self, s):
        return self.q[s]

    def act(self, s, u):
        epsilon = self.rates.epsilon(self.t + 1, self.episode, self.visits[s].sum() + 1)
        return draw(epsilon_greedy(self.values(s), epsilon), u)

    def alpha(self, s, a):
        return F(self.rates.alpha(self.t, self.episode, self.visits[s, a]))

    def discount(self, terminal):
        return F(0) if terminal else F(self.gamma)


class OffPolicy(Agent):
    """Q-learning with A' ~ target(row, s), drawn by words of its own; or, without words, its expectation."""

    def __init__(self, *args, target, words=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.target, self.words = target, words

    def learn(self, s, a, r, s_next, terminal, ended, u):
        row = self.q[s_next]
        pi = self.target(row, s_next)
        if self.words is None:
            bootstrap = sum(F(p) * x for p, x in zip(pi, row, strict=True))
        else:
            bootstrap = row[draw(pi, self.words[self.t - 1])]
        target = r + self.discount(terminal) * bootstrap
        self.q[s, a] += self.alpha(s, a) * (target - self.q[s, a])
        return self.act(s_next, u)


class DoubleQLearning(Agent):
    """The box of section 6.7. Heads: Q1 learns. Several maximal actions count with their mean."""

    def __init__(self, *args, heads, **kwargs):
        super().__init__(*args, **kwargs)
        self.q1, self.q2, self.heads = self.q, self.q.copy(), heads

    def values(self, s):
        return (self.q1[s] + self.q2[s]) / F(2)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        own, other = (self.q1, self.q2) if self.heads[self.t - 1] else (self.q2, self.q1)
        best = [b for b, x in enumerate(own[s_next]) if x == max(own[s_next])]
        bootstrap = sum(other[s_next, b] for b in best) / F(len(best))
        target = r + self.discount(terminal) * bootstrap
        own[s, a] += self.alpha(s, a) * (target - own[s, a])
        return self.act(s_next, u)


class NStepSarsa(Agent):
    """The box of section 7.2, with the whole episode kept in lists; at a time limit the tail bootstraps."""

    def __init__(self, *args, n, **kwargs):
        super().__init__(*args, **kwargs)
        self.n, self.steps = n, []

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, r, self.alpha(s, a)))
        a_next = self.act(s_next, u)
        length = len(self.steps)
        oldest = length - self.n
        for tau in range(max(oldest, 0), length if ended else oldest + 1):
            g = F(0)
            for i in range(tau, length):
                g += F(self.gamma) ** (i - tau) * self.steps[i][2]
            if not terminal:
                g += F(self.gamma) ** (length - tau) * self.q[s_next, a_next]
            s, a, _, alpha = self.steps[tau]
            self.q[s, a] += alpha * (g - self.q[s, a])
        if ended:
            self.steps = []
        return a_next


class MonteCarlo(Agent):
    """Every visit, in order, towards its return (book, equation 6.1), with its own step size."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.steps = []

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, r, self.alpha(s, a)))
        a_next = self.act(s_next, u)
        if ended:
            returns = [F(0)]
            for _, _, r, _ in reversed(self.steps):
                returns.append(r + F(self.gamma) * returns[-1])
            for (s, a, _, alpha), g in zip(self.steps, reversed(returns), strict=False):
                self.q[s, a] += alpha * (g - self.q[s, a])
            self.steps = []
        return a_next


class Traces(Agent):
    """Sarsa(lambda), with dutch traces as in the box of section 12.7, else as in the lecture's; and Watkins's

    Q(lambda), as in the box of section 7.6 of the first edition. In float64.
    """

    def __init__(self, *args, lam, trace="accumulating", offline=False, watkins=False):
        super().__init__(*args)
        self.q = self.q.astype(float)
        self.lam, self.trace, self.offline, self.watkins = lam, trace, offline, watkins
        self.begin()

    def begin(self):
        self.z, self.increments, self.q_old = np.zeros_like(self.q), np.zeros_like(self.q), 0.0

    def learn(self, s, a, r, s_next, terminal, ended, u):
        q, z, alpha = self.q, self.z, float(self.alpha(s, a))
        a_next = self.act(s_next, u)
        is_greedy = q[s_next, a_next] == max(q[s_next])
        q_now, q_next = q[s, a], max(q[s_next]) if self.watkins else q[s_next, a_next]
        if terminal:
            q_next = 0.0
        delta = r + self.gamma * q_next - q_now
        if self.trace == "accumulating":
            z[s, a] += 1
        elif self.trace == "replacing":
            z[s, a] = 1
        else:
            z[s, a] += 1 - alpha * z[s, a]
        if self.offline:
            self.increments += alpha * delta * z
        elif self.trace == "dutch":
            q += alpha * (delta + q_now - self.q_old) * z
            q[s, a] -= alpha * (q_now - self.q_old)
            self.q_old = q_next
        else:
            q += alpha * delta * z
        z *= self.gamma * self.lam
        if self.watkins and not is_greedy:
            z[:] = 0
        if ended:
            q += self.increments
            self.begin()
        return a_next


# --- the forward view, in float64 --------------------------------------------------------------------


class Episode(NamedTuple):
    """S, A, R and gamma' of each step, [T] each, and the pair (S', A') from which each is bootstrapped."""

    s: np.ndarray
    a: np.ndarray
    r: np.ndarray
    discount: np.ndarray
    s_next: np.ndarray
    a_next: np.ndarray


def lambda_return(r, discount, values, lam, t, horizon):
    """The return of step t from the n-step returns as far as `horizon` (book, equation 12.3 and 12.9).

    values[k] stands for what follows step k.
    """
    returns, g, weight = [], 0.0, 1.0
    for k in range(t, horizon):
        g += weight * r[k]
        weight *= discount[k]
        returns.append(g + weight * values[k])
    *shorter, longest = returns
    return (1 - lam) * sum(lam**n * x for n, x in enumerate(shorter)) + lam ** len(shorter) * longest


def offline_forward(q, episode, alpha, lam):
    """Q after an episode by the off-line lambda-return algorithm, all by its first Q (section 12.1)."""
    values = q[episode.s_next, episode.a_next]
    new = q.copy()
    for t, (s, a) in enumerate(zip(episode.s, episode.a, strict=True)):
        g = lambda_return(episode.r, episode.discount, values, lam, t, len(episode.s))
        new[s, a] += alpha * (g - q[s, a])
    return new


def online_forward(q, episode, alpha, lam):
    """Q after each step by the on-line lambda-return algorithm (section 12.4): with each new step the updates

    of the whole episode are made again, from the Q of its start, with returns that look as far as that step.
    """
    values, after = [], []
    latest = q
    for h in range(1, len(episode.s) + 1):
        values.append(latest[episode.s_next[h - 1], episode.a_next[h - 1]])
        latest = q.copy()
        for t in range(h):
            g = lambda_return(episode.r, episode.discount, values, lam, t, h)
            pair = episode.s[t], episode.a[t]
            latest[pair] += alpha * (g - latest[pair])
        after.append(latest)
    return after


def every_visit_monte_carlo(q, episode, alpha):
    """Q after the episode: alpha (G - Q) added up over all visits, all by the Q of its start (section 5.1).

    Where a time limit cut the episode, G goes on with the value of the pair at which it was cut.
    """
    new, g = q.copy(), q[episode.s_next[-1], episode.a_next[-1]]
    for t in reversed(range(len(episode.s))):
        g = episode.r[t] + episode.discount[t] * g
        new[episode.s[t], episode.a[t]] += alpha * (g - q[episode.s[t], episode.a[t]])
    return new
