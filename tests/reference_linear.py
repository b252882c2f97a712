"""The semi-gradient methods as plain loops in float64: every feature is a number, every trace a matrix."""

import numpy as np


def probabilities(row, epsilon):
    """Epsilon-greedy, ties sharing."""
    best = row == row.max()
    return epsilon / len(row) + (1 - epsilon) * best / best.sum()


def learned(kind, x, transitions, a_next, *, alpha, gamma, epsilon=0.1, lam=0.0, n=1, trace="accumulating"):
    """The weights [n, A] after each transition, by the boxes of the book.

    Args:
        kind: "sarsa", "expected-sarsa", "q-learning", "n-step", or "lambda".
        x: the features, [S, n].
        transitions: (S, A, R, S', gamma', whether the episode ends), of each step.
        a_next: A' of each step, as the method drew it.
    """
    actions = 1 + max(a for _, a, *_ in transitions)
    w = np.zeros((x.shape[1], actions))
    z, q_old, waiting = np.zeros_like(w), 0.0, []
    q = lambda s, a: x[s] @ w[:, a]
    for (s, a, r, s_next, discount, last), after in zip(transitions, a_next, strict=True):
        row = x[s_next] @ w
        if kind == "n-step":
            waiting = [
                [*step[:2], step[2] + step[3] * r, step[3] * discount]
                for step in (*waiting, [s, a, 0.0, 1.0])
            ]
            while len(waiting) == n or (last and waiting):
                s0, a0, g, weight = waiting.pop(0)
                w[:, a0] += alpha * (g + weight * q(s_next, after) - q(s0, a0)) * x[s0]
        elif kind == "lambda":
            value, delta = q(s, a), r + discount * q(s_next, after) - q(s, a)
            q_next = q(s_next, after)
            if trace == "dutch":
                z[:, a] += (1 - alpha * z[:, a] @ x[s]) * x[s]
                w += alpha * (delta + value - q_old) * z
                w[:, a] -= alpha * (value - q_old) * x[s]
                q_old = q_next
            else:
                if trace == "clearing":
                    z[x[s] != 0] = 0
                z[:, a] = np.where((x[s] != 0) & (trace != "accumulating"), x[s], z[:, a] + x[s])
                w += alpha * delta * z
            z *= 0 if last else discount * lam
        else:
            ahead = {
                "sarsa": lambda row=row, after=after: row[after],
                "expected-sarsa": lambda row=row: probabilities(row, epsilon) @ row,
                "q-learning": lambda row=row: row.max(),
            }[kind]()
            w[:, a] += alpha * (r + discount * ahead - q(s, a)) * x[s]
        yield w.copy()
