"""A part of an experiment: one method in one environment, with all its configurations and seeds."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxrl_tab.approx import dangers
from jaxrl_tab.core import rng
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.types import Algorithm, Environment
from jaxrl_tab.engine import batch
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.log import Log
from jaxrl_tab.engine.loop import Run
from jaxrl_tab.engine.onward import Onward, with_table
from jaxrl_tab.engine.room import Needs, needs_of, plan
from jaxrl_tab.envs.base import samples_outcomes
from jaxrl_tab.exact import planning

BEYOND = 10  # times the largest possible return: large step sizes and traces may overshoot it for a while
FAR = 1e6  # times the same, and 1, where values may well be larger than any return before they are right
FRESH = 2**32 - 1  # what is folded into a root for the root of its fresh seeds


class Computed(NamedTuple):
    """What some runs gave.

    Attributes:
        q: their final tables, float [n, S, A].
        log: what happened, [n, rows] each; see `log.Log`.
        seconds: how long it took.
        ends: where the runs are in the end but for `q`, [n, ...] each, of a part that goes on; else None.
    """

    q: np.ndarray
    log: Log
    seconds: batch.Seconds
    ends: Run | None = None

    @property
    def begun(self) -> Run | None:
        """Where the runs are in the end, as `compute` takes it for them to go on."""
        return with_table(self.ends, self.q) if self.ends else None


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """One method in one environment, with every combination of hyperparameters and every seed: to be run.

    Its runs have numbers, 0 to `runs` - 1: the number of the configuration times `num_seeds` plus the place
    of the seed. A run with the seed at place i has the key `fold_in(key(seed), first_seed + i)`.

    Fresh seeds must be seeds of no other sweep, not even of a larger one of the same root. So they have a
    root of their own, `fold_in(key(seed), FRESH)`, in place of `key(seed)`: no sweep has a seed with this
    number, for numbers of seeds are below 2**31.

    Attributes:
        env: the environment.
        algorithm: the class of the method.
        axes: the swept hyperparameters in the order of the axes, each with its values.
        configs: an instance of the method for every point of the axes, in C order.
        num_seeds, first_seed: how many seeds there are, and the first of them.
        seed: the root seed.
        budget: how long each run is and what it records.
        fresh: whether the seeds are fresh ones, of the root that is kept for them.
        goes_on: whether it is wanted where the runs are in the end, so that they can go on.
    """

    env: Environment
    algorithm: type[Algorithm]
    axes: dict[str, tuple]
    configs: list[Algorithm]
    num_seeds: int
    first_seed: int
    seed: int
    budget: Budget
    fresh: bool = False
    goes_on: bool = False

    @property
    def root(self) -> Any:
        """The key whose folds are those of the runs."""
        key = rng.key(self.seed)
        return jax.random.fold_in(key, FRESH) if self.fresh else key

    @property
    def runs(self) -> int:
        return len(self.configs) * self.num_seeds

    @functools.cached_property
    def largest_values(self) -> Float[np.ndarray, " configs"]:
        """Of each configuration, the |Q| beyond which a run has diverged; infinite where that is not judged.

        It is `BEYOND` times what no average of returns exceeds: the initial value, and the largest return of
        as many steps as the run has. Only runs of methods that multiply no return by ratios, learn no
        preferences, which may grow without end, and no bounds, are judged, in environments whose rewards are those of
        their outcomes. Runs with all three parts of the deadly triad, and those that begin with weights of their own,
        are judged by `FAR` times the largest return, and 1.
        """
        budget, env = self.budget, self.env
        steps = budget.num_steps or (budget.num_episodes or 0) * env.max_steps
        of_outcomes = samples_outcomes(env) and not of_environment(env).differs

        @functools.cache
        def largest_return(gamma: float, anywhere: bool) -> float:
            return planning.largest_return(env, gamma, steps, anywhere)

        def largest(config: Any) -> float:
            method = of_method(config)
            grows = method.multiplies_returns or method.learns is Learns.PREFERENCES or method.needs_horizon
            triad = dangers.has_deadly_triad(config)
            if not of_outcomes or (grows and not triad):
                return np.inf
            if triad or getattr(config, "w0", ""):
                return FAR * (1 + largest_return(config.gamma, method.exploring_starts))
            initial = abs(getattr(config, method.learns.initial, 0.0))
            return BEYOND * (initial + largest_return(config.gamma, method.exploring_starts))

        return np.array([largest(config) for config in self.configs])

    @functools.cached_property
    def programs(self) -> list[np.ndarray]:
        """The numbers of the configurations that run as one program, int [configs] ascending, for each."""
        return [np.array(members) for members in _same_program(self.configs)]

    @functools.cached_property
    def needs(self) -> list[Needs]:
        """What one run of each program needs of memory. Raises InputError where the method does not fit the task."""
        instances = (leaves_as_arrays(self.configs[members[0]]) for members in self.programs)
        instances = (Onward(x) if self.goes_on else x for x in instances)
        return [needs_of(self.env, algorithm, self.root, self.budget) for algorithm in instances]

    @functools.cached_property
    def onward(self) -> "list[Part]":
        """For each program a part of its configurations alone, of which it is wanted where its runs are in the end.

        Alone, for where runs are has another shape in each program.
        """
        configs = ([self.configs[i] for i in members] for members in self.programs)
        return [dataclasses.replace(self, axes={}, configs=own, goes_on=True) for own in configs]


def compute(
    part: Part,
    runs: np.ndarray | None = None,
    *,
    begun: Run | None = None,
    memory: int | None = None,
    progress: Callable[[int, int], None] = lambda done, steps: None,
) -> Computed:
    """What some runs of a part give, in the order of `runs`; bitwise what they are among all runs.

    Args:
        runs: their numbers, int [n]; all by default.
        begun: where they are, [n, ...] each, of a part that goes on, as `Computed.begun`: they go on for as long as the
            budget says. By default they begin at time 0.
        memory: as in `sweep`.
        progress: is called with the number of runs finished and of the steps they took, as blocks of them
            finish.

    Raises:
        InputError: there is not enough memory; nothing was compiled.
    """
    root = part.root
    total = part.runs if runs is None else len(runs)
    results, room = plan(part.needs, total, memory)
    config, place = np.divmod(np.arange(total) if runs is None else runs, part.num_seeds)
    done, steps, running, compiling = 0, 0, 0.0, 0.0

    def keep(finished: np.ndarray, tables_and_log: Any) -> None:
        nonlocal steps
        results.write(at[finished], tables_and_log)
        steps += int(tables_and_log[1].steps.sum(dtype=np.int64))

    for members in part.programs:
        at = np.flatnonzero(np.isin(config, members))
        if not len(at):
            continue
        leaves = (leaves_as_arrays(part.configs[i]) for i in members)
        # [members, 1]: broadcast to [members, seeds], which `batch.run` numbers in C order.
        stacked = jax.tree.map(lambda *x: np.stack(x)[:, None], *leaves)
        if part.goes_on:
            stacked: Any = Onward(stacked)
        seeds = part.first_seed + np.arange(part.num_seeds, dtype=np.uint32)
        seeds = np.broadcast_to(seeds, (len(members), part.num_seeds))
        # `members` ascends, so this is the place of each configuration among them.
        within = np.searchsorted(members, config[at]) * part.num_seeds + place[at]
        # `done` is bound now, as it is before these runs; `steps` is looked up in each call.
        report = lambda n, done=done: progress(done + n, steps)
        own = jax.tree.map(lambda x, at=at: x[at], begun)
        seconds = batch.run(
            part.env, stacked, root, seeds, part.budget, keep, report, room, None, within, own
        )
        done, running, compiling = done + len(at), running + seconds.running, compiling + seconds.compiling
    q, log, *ends = results.arrays
    return Computed(q, log, batch.Seconds(running, compiling), *ends)


def leaves_as_arrays(algorithm: Algorithm) -> Algorithm:
    """Numbers as float64, of which JAX takes as much as it uses: a Python float would be another program."""
    return jax.tree.map(lambda x: np.asarray(x, np.float64), algorithm)


def _same_program(configs: Sequence[Algorithm]) -> list[list[int]]:
    """The configurations, as indices, grouped by what shapes the program: all but the leaves' values."""
    groups: dict[Any, list[int]] = {}
    for i, config in enumerate(configs):
        leaves, treedef = jax.tree.flatten(config)  # what is static is in the treedef
        groups.setdefault((treedef, tuple(np.shape(x) for x in leaves)), []).append(i)
    return list(groups.values())
