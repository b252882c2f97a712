"""Weights that are given at the start of learning, as text: "0.5" for all, "1,1,10", or rows of actions "1,2;3,4"."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxrl_tab.core.checks import as_array
from jaxrl_tab.core.errors import InputError, unfit

WANTED = "a number for all weights, or those of each feature [n] or [n, A], such as 1,1,10"


def as_text(who: str, given: Any) -> str:
    """The weights as a text, which sweeps and files can hold, without loss.

    Raises:
        InputError: they are no finite numbers in rows of equal length.
    """
    array = _read(given) if isinstance(given, str) else as_array(given)
    if array is None or array.dtype.kind not in "iuf" or array.ndim > 2 or not array.size:
        raise unfit(who, "w0", WANTED, given)
    with np.errstate(over="ignore"):
        held = array.astype(jax.dtypes.canonicalize_dtype(float))
    if not np.isfinite(held).all():
        raise unfit(who, "w0", f"weights that are finite in {held.dtype}", given)
    rows = array.reshape(len(array) if array.ndim == 2 else 1, -1)
    return ";".join(",".join(repr(float(x)).removesuffix(".0") for x in row) for row in rows)


def weights(text: str, size: int, num_actions: int, who: str) -> Float[np.ndarray, "n A"]:
    """The weights of so many features and actions, float64.

    Raises:
        InputError: they are given for another number of features or actions.
    """
    array = _read(text)
    assert array is not None
    column = array.ndim == 1
    if array.shape not in ((), (size,), (size, num_actions)):
        each = f"{size} features" + ("" if column else f" and {num_actions} actions")
        problem = f"w0 are weights of shape {list(array.shape)}, and there are {each}"
        raise InputError(problem, who=who, field="w0")
    return np.broadcast_to(array[:, None] if column else array, (size, num_actions))


def _read(text: str) -> np.ndarray | None:
    """The numbers [], [n] or [n, A] of a text; None where they are none."""
    try:
        rows = [[float(x) for x in row.split(",")] for row in text.split(";")]
    except ValueError:
        return None
    if len({len(row) for row in rows}) > 1:
        return None
    array = np.array(rows)
    return array if len(rows) > 1 else array[0] if array.size > 1 else array.reshape(())
