"""Of many values of a parameter, which are tested at once: of the others some before anything lands."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def slow_but(quick: Collection[Any], values: Iterable[Any]) -> list[Any]:
    """The values for `parametrize`, marked as further cases but for those that are quick."""
    return [x if x in quick else pytest.param(x, marks=pytest.mark.further) for x in values]


def slow_but_first(values: Iterable[Any], number: int = 1) -> list[Any]:
    """The same, where the first ones are quick."""
    values = list(values)
    return slow_but(values[:number], values)
