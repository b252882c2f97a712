"""Which rule stands for which primitive."""

from collections.abc import Callable
from typing import Any

RULES: dict[str, Callable[..., Any]] = {}
# The primitives whose rules know numbers of two words; the others are applied to each word.
OF_PARTS: set[str] = set()


def rule(*names: str, of_parts: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Makes a function the rule of some primitives: (code, equation, *arrays) -> the result, or the results.

    Args:
        names: of the primitives.
        of_parts: whether it takes and gives complex numbers and Threefry keys as `Parts`.
    """

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        RULES.update(dict.fromkeys(names, function))
        if of_parts:
            OF_PARTS.update(names)
        return function

    return register
