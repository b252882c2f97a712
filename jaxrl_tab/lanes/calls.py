"""What a program calls and XLA compiles: for all lanes of a block at once."""

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
from jax import export
from jax.extend.core import jaxpr_as_fun

from jaxrl_tab.lanes.code import Unsupported
from jaxrl_tab.lanes.lowering import Call

Kind: TypeAlias = tuple[tuple[int, ...], np.dtype]  # the shape and the dtype of an array


class Exported(NamedTuple):
    """A call, as plain data.

    Attributes:
        code: a function of arrays with a leading axis of lanes, serialized by `jax.export`.
        inputs, outputs: the shapes and dtypes of what it takes and gives, lanes first.
    """

    code: bytes
    inputs: list[Kind]
    outputs: list[Kind]


def exported(call: Call, lanes: int) -> Exported:
    """A call for so many lanes."""
    function = jaxpr_as_fun(call.closed)

    def of_lane(*varying: Any) -> Any:
        rest = iter(varying)
        return function(*(next(rest) if x is None else x for x in call.known))

    kinds = [
        jax.ShapeDtypeStruct((lanes, *v.aval.shape), v.aval.dtype)
        for v, x in zip(call.closed.jaxpr.invars, call.known, strict=True)
        if x is None
    ]
    try:
        with jax.enable_x64():  # or numbers of 64 bits, which a jaxpr may hold, would lose half of them
            made = export.export(jax.jit(jax.vmap(of_lane)))(*kinds)
    except NotImplementedError:  # as JAX says of it
        raise Unsupported("a call of Python from within is not compiled") from None
    of = lambda avals: [(x.shape, np.dtype(x.dtype)) for x in avals]
    return Exported(bytes(made.serialize()), of(made.in_avals), of(made.out_avals))


def callable_of(call: Exported) -> Callable[[int], None]:
    """A function of the address at which the addresses of the arrays lie, those that are read before the others."""
    with jax.enable_x64():
        kinds = [jax.ShapeDtypeStruct(*kind) for kind in call.inputs]
        function = jax.jit(export.deserialize(bytearray(call.code)).call).lower(*kinds).compile()

    def do(addresses: int) -> None:
        kinds = [*call.inputs, *call.outputs]
        pointers = (ctypes.c_void_p * len(kinds)).from_address(addresses)
        arrays = [_at(pointer, *kind) for pointer, kind in zip(pointers, kinds, strict=True)]
        # Copies, for JAX may go on using what it is given, and the kernel's memory changes.
        with jax.enable_x64():
            results = function(*(x.copy() for x in arrays[: len(call.inputs)]))
        for array, x in zip(arrays[len(call.inputs) :], results, strict=True):
            array[...] = x

    return do


def _at(address: int | None, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """The array at an address."""
    memory = (ctypes.c_uint8 * (int(np.prod(shape)) * dtype.itemsize)).from_address(address or 0)
    return np.frombuffer(memoryview(memory), dtype).reshape(shape)
