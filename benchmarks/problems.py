"""What the parties run: the problems with their settings, as plain numbers and NumPy arrays.

No party may import another one's library by accident, so nothing here knows of JAX or Numba.
"""

from typing import NamedTuple

import numpy as np

# In all of them Q starts at 0, gamma is 1 and ties are broken uniformly. Numbers of steps and lanes: `tasks`.
EPSILON = 0.1
ALPHA = 0.5

# Of Sarsa(lambda). The accumulating trace of a pair that comes in every step goes to 1 / (1 - lambda) = 10,
# so this alpha is in effect 1 at the most; with more than 2 Q may diverge.
ALPHA_OF_TRACES = 0.1
LAMBDA = 0.9

# Of the mountain car: so many tilings with so many tiles along a number, alpha for all tilings together, and after how
# many steps an episode is cut off, for one run in a thousand may come to a policy that goes round for ever.
TILINGS, TILES = 8, 8
CAR_ALPHA = 0.5
LONGEST = 10_000


def settings() -> dict[str, float]:
    """These numbers by name, for the record."""
    return {"alpha": ALPHA, "epsilon": EPSILON, "alpha_of_traces": ALPHA_OF_TRACES, "lambda": LAMBDA}


# The windy gridworld (book, example 6.5).
SHAPE = (7, 10)  # states are numbered row by row from the top left
WIND = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
START, GOAL = 30, 37


def windy_successors() -> np.ndarray:
    """S' for each (S, A); int [S, A]."""
    rows, columns = SHAPE
    row, column = np.divmod(np.arange(rows * columns), columns)
    down, right = np.array(MOVES).T
    next_row = np.clip(row[:, None] + down - np.array(WIND)[column][:, None], 0, rows - 1)
    next_column = np.clip(column[:, None] + right, 0, columns - 1)
    return columns * next_row + next_column


class Garnet(NamedTuple):
    """A random finite MDP (Archibald et al. 1995); episodes start in state 0.

    Attributes:
        successors: K different states, int [S, A, K].
        prob: their probabilities, float64 [S, A, K].
        reward: of each pair, from -1 to 0, float64 [S, A].
        terminal: bool [S].
    """

    successors: np.ndarray
    prob: np.ndarray
    reward: np.ndarray
    terminal: np.ndarray


def garnet(states: int = 1000, actions: int = 4, successors: int = 5, terminal: int = 10) -> Garnet:
    """Always the same one. Every step costs something, and the last states are terminal.

    With one state in a hundred terminal, an episode has some hundred steps: long enough to come everywhere,
    and short enough that the number of episodes tells what was learned.
    """
    rng = np.random.default_rng(0)
    pairs = states, actions
    order = rng.random((*pairs, states)).argpartition(successors, axis=-1)
    cuts = np.sort(rng.random((*pairs, successors - 1)), axis=-1)
    prob = np.diff(cuts, prepend=0, append=1)
    return Garnet(order[..., :successors], prob, -rng.random(pairs), np.arange(states) >= states - terminal)
