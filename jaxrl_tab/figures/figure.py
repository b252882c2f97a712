"""What a published figure is here: what to run, how to draw it, and the numbers that it must show."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from jaxrl_tab.core.types import Algorithm, Environment
from jaxrl_tab.engine.sweep import sweep
from jaxrl_tab.show.progress import Report

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray as xr

    Datasets = Mapping[str, xr.Dataset]
    Run = Callable[[Report], xr.Dataset]

MOST_APART = 4.0  # standard errors
EXACT = 1e-6  # how far an exact number may be rounded

Relation = Literal["is", "at most", "at least"]


class Check(NamedTuple):
    """A number of a figure as it came out, beside the one that is expected.

    Attributes:
        what: says which number it is.
        got, standard_error: mean over seeds and its standard error; 0 where the number is exact.
        relation: whether `expected` is the number itself, or a bound.
        expected, expected_standard_error: the same of the published or computed number.
        apart: how many standard errors of the difference lie between them; 0 on the right side of a bound.
        published: the number as its source printed it; None where it prints none.
        published_standard_error: of that, where the source estimated it and says how well; else 0.
    """

    what: str
    got: float
    standard_error: float
    relation: Relation
    expected: float
    expected_standard_error: float
    apart: float
    published: str | None = None
    published_standard_error: float = 0.0

    @property
    def ok(self) -> bool:
        return self.apart <= MOST_APART

    @property
    def reproduces(self) -> bool | None:
        """Whether the published number comes out, as far as its digits and both errors tell; None without one."""
        if self.published is None:
            return None
        printed = Decimal(self.published.replace("−", "-"))
        rounding = 0.5 * 10.0 ** int(printed.as_tuple().exponent)
        noise = MOST_APART * math.hypot(self.standard_error, self.published_standard_error)
        return abs(self.got - float(printed)) <= rounding * (1 + 1e-9) + noise


@dataclass(frozen=True)
class Number:
    """A number that a figure must show.

    Attributes:
        what: says which number it is.
        expected: its value, or the bound.
        standard_error: of `expected`; of an exact number, how far it may be rounded; of a bound, 0.
        measure: gives the number from the datasets of the figure: one for each seed, [seeds], or an exact
            one, [].
        relation: "is", or "at most" or "at least" where `expected` is a bound.
        published: the number as the source prints it, digit by digit: "−14", "0.36". None where it prints none, as
            where there is only a curve. It need not be `expected`: where a right implementation shows another number,
            that one is expected, and the figure says that what was published does not reproduce.
        published_standard_error: of that, where the source estimated it and says from how many runs.
    """

    what: str
    expected: float
    standard_error: float
    measure: "Callable[[Datasets], Any]"
    relation: Relation = "is"
    published: str | None = None
    published_standard_error: float = 0.0

    def check(self, datasets: "Datasets") -> Check:
        """Compares what `measure` gives with what is expected."""
        x = np.asarray(self.measure(datasets), float)
        mean = float(x.mean())
        error = float(x.std(ddof=1) / math.sqrt(x.size)) if x.ndim else 0.0
        over = mean - self.expected
        wrong = {"is": abs(over), "at most": np.maximum(over, 0), "at least": np.maximum(-over, 0)}
        unit = math.hypot(error, self.standard_error)
        distance = float(wrong[self.relation])
        apart = distance / unit if unit else (0.0 if distance == 0 else math.inf)
        of_source = self.published, self.published_standard_error
        return Check(
            self.what, mean, error, self.relation, self.expected, self.standard_error, apart, *of_source
        )


@dataclass(frozen=True)
class Figure:
    """A published figure: what to run, how to draw it, and what it must show.

    Attributes:
        title: what it shows.
        source: where it was published.
        shows: what there is to see in it, in a sentence or two.
        experiment: what to run, by name: each gets a function to call with its `Progress`, and gives a
            dataset; most are sweeps, see `swept`. Its keyword arguments, all with defaults, are its budget.
        small: such arguments for a quick trial run, whose numbers come from too little to mean anything.
        numbers: what it must show.
        draw: makes the picture from the datasets.
    """

    title: str
    source: str
    shows: str
    experiment: "Callable[..., Mapping[str, Run]]"
    numbers: tuple[Number, ...]
    draw: "Callable[[Datasets], matplotlib.figure.Figure]"
    small: Mapping[str, Any] = field(default_factory=dict)


def swept(env: Environment, method: type[Algorithm] | str, grid: Mapping[str, Any], **budget: Any) -> "Run":
    """A sweep, as what an experiment is made of: arguments as those of `sweep`."""
    return lambda progress: sweep(env, method, grid, **budget, progress=progress).to_xarray()
