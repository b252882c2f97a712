"""What a sweep gives: every number of every seed, with named axes."""

import dataclasses
import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from jaxrl_tab.approx.dangers import has_deadly_triad
from jaxrl_tab.approx.network import MLP
from jaxrl_tab.approx.observed import Features
from jaxrl_tab.core import memory
from jaxrl_tab.core.clock import Schedule
from jaxrl_tab.core.declared import Learns
from jaxrl_tab.core.errors import one_line
from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.optimizers import Transformation
from jaxrl_tab.core.policies import UNAVAILABLE, Policy
from jaxrl_tab.core.types import Environment
from jaxrl_tab.engine import provenance
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.log import Log

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from jaxrl_tab.engine.part import Part
    from jaxrl_tab.show.explained import Explanation
    from jaxrl_tab.show.report import Page
    from jaxrl_tab.stats.columns import Methods


@dataclasses.dataclass(frozen=True)
class SweepResult:
    """The raw data of a sweep of one method: nothing is averaged.

    Attributes:
        environment, algorithm: names in the registries (of the class, where it is not registered).
        env: the environment.
        grid: swept hyperparameters in the order of the axes, each with its values. Those that were drawn at
            random go together: they are the axis `draw`, each value a dict of them.
        fixed: the other hyperparameters.
        log: what happened, NumPy [*grid, seeds, rows] each; see `log.Log`.
        q: the final tables, float [*grid, seeds, S, A].
        optimal_value: v* from the start distribution, for prediction v_pi; float64 [gammas] where gamma is
            swept, [draws] where it is drawn, else []. Where each run has a problem of its own, the mean over
            problems. NaN where the environment does not say, or there is no finite v*, or no single such
            number.
        references: what the errors of values that are linear in features are measured by, where these were recorded,
            float64 [*grid] each: `least_value_error`, the least `value_error` that the features allow, and
            `td_value_error`, that of the TD fixed point, NaN where there is none. Else nothing.
        root_seed: the seed of the sweep; run i has the key `fold_in(key(root_seed), first_seed + i)`.
        num_steps, num_episodes, log_every, exact_every: the budget of each run, what a row of the log is, and how
            many of them have exact values, as in `train`.
        seconds, compile_seconds: time spent running the compiled program, and compiling it.
        first_seed: see `root_seed`.
        largest_value: the largest |Q| that is not taken for diverged, float64 [*grid]; see `part.Part`.
        fresh: whether the root is instead the one that is kept for fresh seeds; see `part.Part`.
        learns: whether the method learns action values, as in control, or state values, as in prediction.
        part: what was run, so that some of it can be run again; None where that is not known.
    """

    environment: str
    algorithm: str
    env: Environment
    grid: dict[str, tuple]
    fixed: dict[str, Any]
    log: Log
    q: np.ndarray
    optimal_value: np.ndarray
    root_seed: int
    num_steps: int | None
    num_episodes: int | None
    log_every: int
    seconds: float
    compile_seconds: float
    first_seed: int = 0
    largest_value: Any = np.inf
    fresh: bool = False
    exact_every: int | None = None
    learns: Learns = Learns.ACTIONS
    part: "Part | None" = None
    references: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)

    def __repr__(self) -> str:
        axes = ", ".join(f"{len(values)} {name}" for name, values in self.grid.items()) or "one setting"
        seeds = self.log.steps.shape[-2]
        return f"<SweepResult of {self.algorithm} in {self.environment}: {axes}, {seeds} seeds>"

    def _repr_html_(self) -> str:
        def several(values: Iterable[Any]) -> str:
            return one_line(", ".join(map(str, labels(values))))

        drawn = self.grid.get(DRAW, ())
        rows = [(name, several(values)) for name, values in self.grid.items() if name != DRAW]
        rows += [(f"{name}, drawn", several(trial[name] for trial in drawn)) for name in (drawn or [{}])[0]]
        rows += [(name, one_line(str(label(x)))) for name, x in self.fixed.items() if x is not None]
        steps, episodes = self.num_steps, self.num_episodes
        length = f"{steps:,} steps" if steps is not None else f"{episodes:,} episodes"
        million = self.steps_per_second / 1e6
        rows += [("seeds", str(self.log.steps.shape[-2])), ("each run", length)]
        rows += [("speed", f"{million:.3g} million steps a second"), ("data", "to_xarray(), to_pandas()")]
        return table(f"{self.algorithm} in {self.environment}", ("", ""), rows)

    @property
    def steps_per_second(self) -> float:
        """Environment steps with their updates, per second, compilation apart."""
        return float(self.log.steps.sum(dtype=np.int64)) / self.seconds

    @property
    def diverged(self) -> np.ndarray:
        """Which runs diverged, bool [*grid, seeds]: see `is_diverged` and `largest_value`."""
        bound = np.asarray(self.largest_value)[..., None]
        return is_diverged(self.q, self.log.returns, self.log.rewards, largest=bound)

    def to_xarray(self) -> "xr.Dataset":
        """The result as a dataset: dimensions are the swept hyperparameters, then seed, then row.

        The fields of the log are its variables, with what was recorded, `q` [*grid, seed, state, action] (weights
        [feature, action] where states cannot be counted), and
        `diverged` [*grid, seed]; what is the same for all runs is in `attrs`. Hyperparameters that were drawn
        at random are coordinates along a dimension `draw`: alpha(draw).
        """
        import xarray as xr

        axes = (*self.grid, "seed")
        variables: dict[str, Any] = {
            name: ((*axes, "row"), x)
            for name, x in self.log._asdict().items()
            if x is not None and name != "recorded"
        }
        for name, x in (self.log.recorded or {}).items():
            more = [f"{name}_{i}" for i in range(x.ndim - len(axes) - 1)]
            variables[name] = ((*axes, "row", *more), x)
        variables["q"] = ((*axes, "state" if self.env.num_states else "feature", "action"), self.q)
        variables["diverged"] = (axes, self.diverged)
        variables |= {name: ((*self.grid,), x) for name, x in self.references.items()}
        if self.optimal_value.ndim:
            variables["optimum"] = (("gamma" if "gamma" in self.grid else DRAW,), self.optimal_value)
        coords: dict[str, Any] = {name: labels(x) for name, x in self.grid.items() if name != DRAW}
        if draws := self.grid.get(DRAW):
            coords[DRAW] = np.arange(len(draws))
            coords |= {name: (DRAW, labels(trial[name] for trial in draws)) for name in draws[0]}
        coords["seed"] = self.first_seed + np.arange(self.q.shape[len(self.grid)])
        coords["row"] = np.arange(self.log.steps.shape[-1])
        budget = {"num_steps": self.num_steps, "num_episodes": self.num_episodes}
        attrs = {
            "environment": self.environment,
            "environment_parameters": json.dumps(describe(self.env)),
            "algorithm": self.algorithm,
            "learns": self.learns.value,
            "fixed": json.dumps({name: label(v) for name, v in self.fixed.items() if v is not None}),
            **{name: value for name, value in budget.items() if value is not None},
            "log_every": self.log_every,
            **({"exact_every": self.exact_every} if self.exact_every else {}),
            **({"deadly_triad": 1} if self.part and any(map(has_deadly_triad, self.part.configs)) else {}),
            "root_seed": self.root_seed,
            **({"fresh_seeds": 1} if self.fresh else {}),
            "optimal_value": float(self.optimal_value) if self.optimal_value.ndim == 0 else float("nan"),
            "seconds": self.seconds,
            "compile_seconds": self.compile_seconds,
            "steps_per_second": self.steps_per_second,
        }
        return xr.Dataset(variables, coords, attrs)

    def to_pandas(self, per: Literal["row", "seed"] = "row") -> "pd.DataFrame":
        """The result as a table in long form: a row for each row of the log of each run, or for each run.

        See `export.to_pandas`; its `to_csv` and `to_parquet` write it.
        """
        from jaxrl_tab.stats import export

        return export.to_pandas(self.to_xarray(), per)

    def report(self) -> "Page":
        """The report of this sweep, to look around in: a notebook shows it, and its `save` writes it into a file.

        What is shown of the tables is what was learned in the end; for the moments before it takes an experiment.
        """
        from jaxrl_tab.show import report

        about = {"made by": repr(self), "versions": provenance.installed()}
        return report.page(self._methods(), about, {}, explained=self.explain())

    def explain(self) -> "Explanation":
        """Where the method, at its best setting, loses what it earns less than the best policy.

        Exact, for the policies after all that was learned: see `show.explained.Explained`, and docs/why.md. A notebook
        shows it, `print` says it in sentences, its `save` draws it.
        """
        from jaxrl_tab.engine.explain import explain

        parts = {} if self.part is None else {f"{self.environment}/{self.algorithm}": self.part}
        return explain(self._methods(), parts)

    def _methods(self) -> "dict[str, Methods]":
        from jaxrl_tab.stats.columns import by_environment

        datasets = {f"{self.environment}/{self.algorithm}": self.to_xarray()}
        return by_environment(datasets, {self.environment: self.env})


def is_diverged(q: Any, *sums: Any, largest: Any = np.inf) -> np.ndarray:
    """Which runs diverged, bool [...], by their table [..., S, A] and sums of their log [..., rows].

    There is a NaN or an infinity in one of these; or an entry of the table is larger in size than `largest` [...].
    """
    diverged = np.zeros(q.shape[:-2], bool)
    # `flat` is a view: what is written into it is in `diverged`.
    flat, beyond = diverged.reshape(-1), np.broadcast_to(largest, diverged.shape).reshape(-1)
    nowhere = np.array(UNAVAILABLE, q.dtype)
    for x in (q, *sums):
        runs = x.reshape(diverged.size, -1)
        for block in memory.blocks(diverged.size, runs[:1].nbytes):
            for extreme in (runs[block].min(-1), runs[block].max(-1)):  # where there is a NaN, both are NaN
                flat[block] |= ~np.isfinite(extreme)
            if x is q:
                size = np.max(abs(runs[block]), -1, initial=0, where=runs[block] != nowhere)
                flat[block] |= size > beyond[block]
    return diverged


def label(value: Any) -> Any:
    """A hyperparameter as a coordinate: a number as it is, what else it may be as it is typed."""
    is_transformation = hasattr(value, "_fields")  # of gradients, as optax makes it in Python
    is_typed = isinstance(value, Schedule | Policy | Features | MLP | Transformation)
    return str(value) if is_transformation or is_typed else value


def labels(values: Iterable[Any]) -> Any:
    """The coordinates of an axis: numbers, or texts; where both are among them, an array of objects, of which each
    number is still one: `ds.sel(epsilon=0.1)` finds it beside a schedule."""
    coordinates = [label(value) for value in values]
    kinds = {isinstance(x, str) for x in coordinates}
    if len(kinds) == 1:
        return coordinates
    mixed = np.empty(len(coordinates), object)
    mixed[:] = [x if isinstance(x, str) else np.asarray(x).item() for x in coordinates]
    return mixed


def parameters(obj: Any) -> dict[str, Any]:
    """The fields of a frozen dataclass with their values."""
    return {f.name: getattr(obj, f.name) for f in dataclasses.fields(obj)}


def describe(obj: Any) -> dict[str, Any]:
    """The fields of a frozen dataclass in types that JSON knows; a large array by its shape."""

    def plain(value):
        if isinstance(value, (str, bool, int, float, type(None))):
            return value
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            return repr(value)
        return array.tolist() if array.size <= 64 else f"{array.dtype}{list(array.shape)}"

    fields = parameters(obj) if dataclasses.is_dataclass(obj) else {}
    return {name: plain(value) for name, value in fields.items()}
