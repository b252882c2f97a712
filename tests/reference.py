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
