"""A method with a run of it that goes on: from where the run is, so many steps or episodes more.

Wherever a method stands, `Onward` may: its program takes where the run is, and gives where it is then. The random words
of a step depend on its number alone, and that is kept. So a run that goes on, however often, is to the last bit the run
that is made at once.
"""

from typing import Any, NamedTuple

from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.engine.loop import Run


@pytree
class Onward:
    """A method, and where its run is.

    Attributes:
        method: the method.
        run: where the run is, as `loop.Run`, whose learner is of the method; None: at time 0.
    """

    method: Any
    run: Run | None = None


class Split(NamedTuple):
    """An `Onward`, or a method alone, taken apart.

    Attributes:
        method: the method.
        run: where the run is; None: at time 0.
        goes_on: whether it is wanted where the run is in the end.
    """

    method: Any
    run: Run | None
    goes_on: bool


def split(algorithm: Any) -> Split:
    """The method and where its run is, of what stands where a method stands."""
    if isinstance(algorithm, Onward):
        return Split(algorithm.method, algorithm.run, True)
    return Split(algorithm, None, False)
