"""What every party does: the same runs, with the same settings."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

METHODS = ("q-learning", "sarsa")
STEPS = 8000
ALPHA = 0.5
EPSILON = 0.1  # gamma is 1, Q starts at 0, ties are broken uniformly

SHAPE = (7, 10)  # states are numbered row by row from the top left
WIND = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
MOVES = ((-1, 0), (0, 1), (1, 0), (0, -1))
START, GOAL = 30, 37


class Timing(NamedTuple):
    """One round of one party.

    Attributes:
        seconds: time from the call to the results, compilation apart.
        episodes: episodes finished in each lane, int [lanes].
    """

    seconds: float
    episodes: np.ndarray


Round = Callable[[int], Timing]  # runs all lanes once, with random numbers named by a whole number
