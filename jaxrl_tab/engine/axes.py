"""What a sweep tries of a hyperparameter: besides lists, grids in equal steps, and random draws.

    grid = {"alpha": rl.LogUniform(0.01, 1), "q0": rl.Uniform(-20, 0), "epsilon": rl.LinearGrid(0, 0.4, 5)}
    rl.sweep(env, rl.Sarsa, grid, num_draws=20, num_seeds=9, num_steps=800)  # axes epsilon, draw, seed

Grids beside one another make all combinations. Hyperparameters that are drawn go together: draw i is one
trial, with the i-th value of each. What is drawn depends on the root seed, the method, the hyperparameter's
name and i alone: more draws keep the first ones, and neither the order nor what else is drawn changes any.
"""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from jaxrl_tab.core.errors import InputError, is_whole, shown
from jaxrl_tab.core.pytree import checked_dataclass, field

DRAW = "draw"  # the axis of trials; each of its values is a dict of what is drawn together
MOST = 1e100  # so large an end may be; and so small, where its logarithm is taken
DIGITS = 12  # significant ones of what is computed: beyond, machines may differ
MOST_SETTINGS = 100_000  # in one sweep, or one experiment: far beyond what anybody can look at


class Grid:
    """Values between two ends, which are both among them."""

    def values(self) -> list[Any]:
        raise NotImplementedError


class Random:
    """A distribution of values."""

    def value(self, u: float) -> Any:
        """The value below which lies the share `u` of the distribution, for `u` in [0, 1)."""
        raise NotImplementedError


@dataclass(frozen=True)
class _Between:
    """All numbers from `low` to `high`, in equal differences, or in equal ratios where it is `logarithmic`."""

    low: float
    high: float

    logarithmic: ClassVar[bool] = False

    def __post_init__(self):
        for end in (self.low, self.high):
            if not isinstance(end, int | float | np.number) or isinstance(end, bool) or not abs(end) <= MOST:
                raise InputError(f"the ends must be numbers, {MOST:g} at most, not {shown(end)}")
        if self.logarithmic and self.low < 1 / MOST:
            raise InputError(f"the ends must be above 0 on a logarithmic scale, not {shown(self.low)}")
        if not self.low < self.high:
            raise InputError(
                f"the low end, {shown(self.low)}, must be below the high end, {shown(self.high)}"
            )

    def at(self, share: float) -> float:
        """The number that lies this share of the way from `low` to `high`, rounded to DIGITS."""
        if self.logarithmic:
            x = self.low * (self.high / self.low) ** share
        else:
            x = self.low + (self.high - self.low) * share
        return float(f"{x:.{DIGITS}g}")


@checked_dataclass
class LinearGrid(_Between, Grid):
    """So many points from `low` to `high` with equal differences; whole numbers where all of them are."""

    points: int = field(at_least=2)

    def __post_init__(self):
        super().__post_init__()
        check_settings(self.points, f"{self.points} points")

    def values(self) -> list[Any]:
        # The ends are as they were given: `at` would round them.
        inner = [self.at(i / (self.points - 1)) for i in range(1, self.points - 1)]
        values = [self.low, *inner, self.high]
        if all(float(x).is_integer() for x in values) and is_whole(self.low, -(2**31)):
            return [int(x) for x in values]
        return [float(x) for x in values]


@checked_dataclass
class LogGrid(LinearGrid):
    """So many points from `low` to `high`, both above 0, with equal ratios."""

    logarithmic: ClassVar[bool] = True


@dataclass(frozen=True)
class Uniform(_Between, Random):
    """A number from `low` to `high`."""

    def value(self, u: float) -> float:
        return self.at(u)


@dataclass(frozen=True)
class LogUniform(Uniform):
    """A number from `low` to `high`, both above 0, whose logarithm is uniform."""

    logarithmic: ClassVar[bool] = True


@checked_dataclass
class Integers(_Between, Random):
    """A whole number from `low` to `high`, both included."""

    low: int = field(at_least=-(2**31))
    high: int = field(at_least=-(2**31))

    def value(self, u: float) -> int:
        return int(self.low + math.floor(u * (self.high - self.low + 1)))


@dataclass(frozen=True)
class Choice(Random):
    """One of these values, each equally likely: numbers, schedules, policies, ..."""

    values: Sequence[Any]

    def __post_init__(self):
        if not isinstance(self.values, Sequence) or isinstance(self.values, str) or not self.values:
            raise InputError(f"a choice must be among a list of values, not {shown(self.values)}")

    def value(self, u: float) -> Any:
        return self.values[int(u * len(self.values))]


def spread(grid: Mapping[str, Any], num_draws: int | None, seed: int, method: str) -> dict[str, Any]:
    """`grid` with lists in place of grids in steps, and what is random drawn.

    Args:
        grid: hyperparameter -> a value, a list, a `Grid` or a `Random`; or `draw` -> what was drawn before.
        num_draws: how many trials; None where nothing is random.
        seed: the root seed of the sweep.
        method: its name, or its label in an experiment: another one draws other values.

    Returns:
        The same hyperparameters, but for those drawn: these are at the end under `draw`, in a list of dicts.

    Raises:
        InputError: something is random and `num_draws` is missing, or the other way round.
    """
    random = {name: values for name, values in grid.items() if isinstance(values, Random)}
    listed = {n: v.values() if isinstance(v, Grid) else v for n, v in grid.items() if n not in random}
    trials = listed.pop(DRAW, None)
    if num_draws is not None and not is_whole(num_draws):
        raise InputError(f"the number of draws must be a whole number of at least 1, not {shown(num_draws)}")
    check_settings(num_draws or 1, f"{num_draws} draws of {method}")
    if num_draws is not None and not random:
        raise InputError(f"there is nothing to draw: no hyperparameter of {method} is random")
    if random:
        if num_draws is None:
            raise InputError(f"{next(iter(random))} is drawn at random: say how many draws")
        if trials is not None:
            raise InputError(f"{next(iter(random))} is drawn at random, and there are draws already")
        share = lambda name, i: _share(seed, method, name, i)
        trials = [{name: x.value(share(name, i)) for name, x in random.items()} for i in range(num_draws)]
    if trials is not None:
        _check_trials(trials, listed)
        listed[DRAW] = trials
    return listed


def check_settings(number: int, what: str) -> None:
    """Raises InputError where `number` settings, which `what` says in words, are too many to be listed."""
    if number > MOST_SETTINGS:
        raise InputError(f"{what} are {number:,} settings, and there may be {MOST_SETTINGS:,}: try fewer")


def swept_names(axes: Mapping[str, tuple]) -> list[str]:
    """The hyperparameters that are not the same in all runs: those of a grid, then those drawn."""
    return [*(name for name in axes if name != DRAW), *next(iter(axes.get(DRAW, ())), {})]


def _share(seed: int, method: str, name: str, i: int) -> float:
    """A number in [0, 1) for each draw, from a hash: NumPy does not promise the same stream for ever."""
    digest = hashlib.sha256(json.dumps([int(seed), method, name, i]).encode()).digest()
    # 53 of the 64 bits: as many as a float holds, so that no rounding gives 1.
    return (int.from_bytes(digest[:8], "big") >> 11) * 2.0**-53


def _check_trials(trials: Any, others: Mapping[str, Any]) -> None:
    if not isinstance(trials, Sequence) or not trials or not all(isinstance(x, Mapping) for x in trials):
        raise InputError(f"draw must be a list of dicts from hyperparameters to values, not {shown(trials)}")
    names = set(trials[0])
    if (i := next((i for i, trial in enumerate(trials) if set(trial) != names), None)) is not None:
        raise InputError(f"draw {i} has other hyperparameters than draw 0")
    if both := names & set(others):
        raise InputError(f"{min(both)} is given both in the draws and beside them")


# How each is written in a file: {log = [0.01, 1], points = 5}, {uniform = [0, 1]}, {choice = [1, 2]}.
WRITTEN: dict[str, type[Grid] | type[Random]] = {
    "linear": LinearGrid,
    "log": LogGrid,
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "integers": Integers,
    "choice": Choice,
}
