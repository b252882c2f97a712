"""A compiled program that can be called."""

import ctypes
import math
import time
from collections.abc import Sequence

import numpy as np

from jaxrl_tab.lanes import calls, machine
from jaxrl_tab.lanes.program import Program

PAGE = 4096


class Stopped(Exception):
    """Somebody has asked a kernel to stop."""


class Stop:
    """By this, kernels that run in other threads can be asked to stop; they do so soon."""

    def __init__(self) -> None:
        self.flag = np.zeros(1, np.uint8)

    def set(self) -> None:
        self.flag[0] = 1

    @property
    def is_set(self) -> bool:
        return bool(self.flag[0])


class Kernel:
    """A program, loaded. Several threads may call it at once, and none of them holds up Python while it runs.

    Attributes:
        program: what it does.
        seconds: how long the last call took.
    """

    def __init__(self, program: Program):
        self.program, self.seconds = program, math.inf
        self._function = machine.loaded(program.code, program.target)
        self._calls = [calls.callable_of(call) for call in program.calls]
        self._tables = _pointers(program.tables)

    def __call__(self, *inputs: np.ndarray, stop: Stop | None = None) -> list[np.ndarray]:
        """What the program gives, [n, ...] each.

        Args:
            inputs: its arguments, [n, ...] each, of the dtypes and shapes that the program names. n must be a
                multiple of its lanes.
            stop: by which it can be stopped.

        Raises:
            Stopped: it was.
            Exception: what a call that XLA does has raised.
        """
        program, stop, n = self.program, stop or Stop(), len(inputs[0])
        given = [
            _checked(x, (n, *shape), dtype) for x, (shape, dtype) in zip(inputs, program.inputs, strict=True)
        ]
        if n % program.lanes:
            raise ValueError(f"{n} runs are no multiple of {program.lanes} lanes")
        outputs = [np.empty((n, *shape), dtype) for shape, dtype in program.outputs]
        scratch = np.zeros(program.scratch + PAGE, np.uint8)
        first = -(-scratch.ctypes.data // PAGE) * PAGE
        raised: list[BaseException] = []

        def outside(number: int, addresses: int) -> None:
            try:
                self._calls[number](addresses)
            except BaseException as error:  # it cannot go through the kernel
                raised.append(error)
                stop.set()

        arrays, called = _pointers([*given, *outputs]), machine.CALLED(outside)
        blocks, begun = n // program.lanes, time.perf_counter()
        self._function(0, blocks, first, arrays, self._tables, stop.flag.ctypes.data, called)
        if raised:
            raise raised[0]
        if stop.is_set:
            raise Stopped
        self.seconds = time.perf_counter() - begun
        return outputs


def _checked(x: np.ndarray, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """An argument as the kernel reads it: it trusts its size."""
    if x.shape != shape or x.dtype != dtype:
        raise ValueError(f"an argument is {x.dtype}{list(x.shape)}, not {dtype}{list(shape)}")
    return np.ascontiguousarray(x)


def _pointers(arrays: Sequence[np.ndarray]) -> ctypes.Array:
    return (ctypes.c_void_p * max(len(arrays), 1))(*(x.ctypes.data for x in arrays))
