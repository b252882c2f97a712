"""A method with a run of it that goes on: from where the run is, so many steps or episodes more.

Wherever a method stands, `Onward` may: its program takes where the run is, and gives where it is then. The random words
of a step depend on its number alone, and that is kept. So a run that goes on, however often, is to the last bit the run
that is made at once.
"""

from typing import Any, NamedTuple

import jax

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


@pytree
class Table:
    """Stands where the table of a run is that is given beside it, so that it is not given twice."""


def without_table(run: Run, place: int | None) -> Run:
    """Where a run is, but for its table: the leaf at this place; where it has no such leaf, as it is."""
    leaves, structure = jax.tree.flatten(run)
    return jax.tree.unflatten(structure, [Table() if i == place else x for i, x in enumerate(leaves)])


def with_table(run: Run, table: Any) -> Run:
    """Where a run is, of what `without_table` made of it."""
    is_table = lambda x: isinstance(x, Table)
    return jax.tree.map(lambda x: table if is_table(x) else x, run, is_leaf=is_table)


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
