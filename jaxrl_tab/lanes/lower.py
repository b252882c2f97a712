"""The program of one lane, from the jaxpr of one run."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes import versions
from jaxrl_tab.lanes.arrays import Array, Known, Parts, Plain, Stale, Stored, is_small, made_of, size_of
from jaxrl_tab.lanes.choices import choose_operands
from jaxrl_tab.lanes.code import Buffer, Unsupported
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.reciprocals import use_reciprocals
from jaxrl_tab.lanes.rules import keys
from jaxrl_tab.lanes.rules.numbers import impl_of

__all__ = ["Lowering", "lower"]


def lower(closed: Any, varying: Sequence[bool], given: Sequence[Any], results: int | None = None) -> Lowering:
    """The program of one lane.

    Args:
        closed: the jaxpr of one run.
        varying: for each of its arguments, whether it differs from lane to lane.
        given: the others, as NumPy arrays (keys as their data), and None for those that differ.
        results: how many of its results are wanted, from the first on; None: all.

    Raises:
        Unsupported: where the jaxpr holds something that is not compiled.
    """
    wanted = closed.jaxpr.outvars[:results]
    if any(impl_of(v.aval) is not None for v in wanted):
        raise Unsupported("random keys are no results that are compiled")
    copied: frozenset[int] = frozenset()
    while True:
        code = Lowering(copied)
        try:
            arguments = zip(closed.jaxpr.invars, varying, given, strict=True)
            args = [_argument(code, v.aval, None if differs else x) for v, differs, x in arguments]
            for v, x in zip(wanted, code.closed(closed, *args)[:results], strict=True):
                _give(code, v.aval, x)
            use_reciprocals(code.region)
            choose_operands(code.region)
            return code
        except Stale as stale:
            copied |= {stale.site}
        except Exception as error:
            if isinstance(error, Unsupported) or not (newer := versions.newer()):
                raise
            raise Unsupported(f"{newer} ({type(error).__name__}: {error})") from error


def _argument(code: Lowering, aval: Any, given: Any) -> Array:
    """An argument of the jaxpr, for one lane."""
    impl = impl_of(aval)
    if given is not None:
        x: Plain = Known(np.asarray(given), code)
    else:
        shape = aval.shape if impl is None else (*aval.shape, *impl.key_shape)
        buffer = Buffer(aval.dtype if impl is None else np.uint32, size_of(shape), role="input")
        code.inputs.append(buffer)
        x = Stored(shape, buffer, 0, code)
        if is_small(shape):
            x = made_of(code, shape, x.dtype, [x.item(i) for i in range(buffer.size)])
    return x if impl is None else keys.wrapped(code, x)


def _give(code: Lowering, aval: Any, x: Array) -> None:
    """Puts a result where the caller finds it."""
    if impl_of(aval) is not None:
        x = keys.unwrapped(code, x)
    if isinstance(x, Parts):
        raise Unsupported("a complex result is not compiled")
    buffer = Buffer(x.dtype, size_of(x.shape), role="output")
    code.outputs.append(buffer)
    code.copy(x, buffer)
