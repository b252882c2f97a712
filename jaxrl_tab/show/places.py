"""Where states cannot be counted: places in the range of what is observed, at which people look at what was learned."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from jaxrl_tab import stats
from jaxrl_tab.approx.features import read
from jaxrl_tab.core import rng
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.linear import Active
from jaxrl_tab.core.types import Environment
from jaxrl_tab.envs.base import Panel
from jaxrl_tab.show.words import significant
from jaxrl_tab.stats.along import Datasets

STARTS = 100  # that are drawn
ROWS, COLUMNS = 15, 21  # odd, so that a number from -x to x is 0 in the middle


class Places(NamedTuple):
    """Places in the range of what is observed of a state.

    Attributes:
        points: what is observed there, float32 [N, 2]: the middles of the cells of a grid.
        panel: their numbers as people see them, the first number along, the second one up.
        start: the place that is the nearest to where episodes start, on average.
    """

    points: Float[np.ndarray, "N 2"]
    panel: Panel
    start: int


def places_of(env: Environment, datasets: Datasets) -> Places | None:
    """The places at which the report shows what methods learned; None where there are none."""
    return None if absent(env, datasets) else grid(env, ROWS, COLUMNS)


def ends_of(env: Environment) -> list[tuple[float, float]]:
    """The least and the largest of each of the numbers that a state is."""
    declared = of_environment(env)
    return list(zip(declared.low or (), declared.high or (), strict=True))


def dimensions(env: Environment, datasets: Datasets) -> int:
    """Of how many numbers what was learned is a function, where states cannot be counted; 0 where that is not known."""
    if env.num_states or not all(_is_known(env, ds) for ds in datasets.values()):
        return 0
    ends = ends_of(env)
    return len(ends) if all(math.isfinite(x) for pair in ends for x in pair) else 0


def absent(env: Environment, datasets: Datasets) -> str:
    """Why the report does not show what was learned of states that cannot be counted; empty where it does."""
    if dimensions(env, datasets) == 2:
        return ""
    if not all(_is_known(env, ds) for ds in datasets.values()):
        why = (
            "what results hold are not the weights of features that have a name, as where there is a network"
        )
    elif (d := dimensions(env, datasets)) == 1:
        return "A state is one number here: what was learned of each is the curve in values.png."
    else:
        why = f"a state is {d} numbers here, and a map is of two" if d else "its numbers have no bounds"
    return f"What was learned of single states is not shown: {why}."


def _texts(ds: xr.Dataset) -> list[str]:
    """The features of all settings of a method, as text."""
    swept = ds["features"].values.ravel().tolist() if "features" in ds.coords else None
    return swept or [stats.fixed(ds)["features"]]


def _is_known(env: Environment, ds: xr.Dataset) -> bool:
    """Whether results hold weights, of features that their names say; those of a network are not all there."""
    if "network" in {*stats.fixed(ds), *ds.coords}:
        return False
    try:
        sizes = [read(text).fitted(env).size for text in _texts(ds)]
    except (InputError, KeyError):  # they are somebody's own
        return False
    return max(sizes) == ds.sizes.get("feature")


def middles(low: float, high: float, n: int) -> Float[np.ndarray, " n"]:
    """Those of n equal parts of a range."""
    return low + (np.arange(n) + 0.5) * ((high - low) / n)


def grid(env: Environment, rows: int, columns: int) -> Places:
    """The middles of so many cells, where a state is two numbers."""
    ends = ends_of(env)
    along, up = (middles(*pair, n) for pair, n in zip(ends, (columns, rows), strict=True))
    up = up[::-1]
    points = np.stack(np.meshgrid(along, up), -1).reshape(-1, 2).astype(np.float32)
    name_along, name_up = of_environment(env).observed_names
    of_rows, of_columns = (tuple(significant(x, 2) for x in numbers) for numbers in (up, along))
    panel = Panel(
        "", np.arange(rows * columns).reshape(rows, columns), of_rows, of_columns, name_up, name_along
    )
    starts = jax.vmap(env.reset)(jax.random.split(rng.key(0), STARTS))
    far = (points - np.asarray(starts.mean(0))) / np.ptp(ends, axis=1)
    return Places(points, panel, int((far**2).sum(1).argmin()))


def learned_at(points: Float[np.ndarray, "N d"], env: Environment, ds: xr.Dataset) -> np.ndarray:
    """The values that every run of a setting learned of these points, float [seeds, N, A]; in prediction A is 1.

    Args:
        points: what is observed there.
        env: the environment.
        ds: one setting of a method with features, whose `q` are the weights, [seed, feature, action].
    """
    (text,) = _texts(ds)
    features = read(text).fitted(env)
    x: Any = jax.vmap(features)(jnp.asarray(points, jnp.float32))
    w = ds.q.transpose("seed", "feature", "action").values[:, : features.size]  # others may have more of them
    if isinstance(x, Active):
        return w[:, np.asarray(x.ones)].sum(2)
    return w[:, np.asarray(x)] if x.ndim == 1 else np.asarray(x, w.dtype) @ w
