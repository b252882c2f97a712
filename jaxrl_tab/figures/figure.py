"""What a published figure is here: settings, and the numbers that it must show."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import matplotlib.figure
    import xarray as xr

    Datasets = Mapping[str, xr.Dataset]

MOST_APART = 4.0  # standard errors


class Check(NamedTuple):
    """A number of a figure as it came out, beside the one that is expected.

    Attributes:
        what: says which number it is.
        got, standard_error: mean over seeds and its standard error; 0 where the number is exact.
        expected, expected_standard_error: the same of the published or computed number.
        apart: how many standard errors of the difference lie between them.
    """

    what: str
    got: float
    standard_error: float
    expected: float
    expected_standard_error: float
    apart: float

    @property
    def ok(self) -> bool:
        return self.apart <= MOST_APART


@dataclass(frozen=True)
class Number:
    """A number that a figure must show.

    Attributes:
        what: says which number it is.
        expected: its value.
        standard_error: of `expected`; of an exact number, how far it may be rounded.
        measure: gets the environment and the dataset of each method, and gives the number: one for each
            seed, [seeds], or an exact one, [].
    """

    what: str
    expected: float
    standard_error: float
    measure: "Callable[[Any, Datasets], Any]"

    def check(self, env: Any, datasets: "Datasets") -> Check:
        """Compares what `measure` gives with what is expected."""
        x = np.asarray(self.measure(env, datasets), float)
        error = float(x.std(ddof=1) / math.sqrt(x.size)) if x.ndim else 0.0
        apart = abs(float(x.mean()) - self.expected) / math.hypot(error, self.standard_error)
        return Check(self.what, float(x.mean()), error, self.expected, self.standard_error, apart)


@dataclass(frozen=True)
class Figure:
    """A published figure: what to run, how to draw it, and what it must show.

    Attributes:
        title: what it shows.
        source: where it was published.
        environment: name in ENVS.
        methods: names in ALGORITHMS.
        hyperparameters: of all methods.
        budget: arguments of `sweep`: seeds, steps or episodes.
        numbers: what it must show.
        draw: makes the picture from the dataset of each method and the environment.
        parameters: of the environment.
    """

    title: str
    source: str
    environment: str
    methods: tuple[str, ...]
    hyperparameters: Mapping[str, Any]
    budget: Mapping[str, Any]
    numbers: tuple[Number, ...]
    draw: "Callable[[Datasets, Any], matplotlib.figure.Figure]"
    parameters: Mapping[str, Any] = field(default_factory=dict)
