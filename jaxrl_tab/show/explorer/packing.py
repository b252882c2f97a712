"""Numbers as text in a page, a few bits for each, and back.

Tables over time are `codes`: whole numbers of steps from the lowest one, so that what is shown is right to its last
decimal; then differences from row to row, small ones, as unsigned numbers (zigzag); then all low bytes before all
high ones; then deflate, and base64. Of the windy gridworld's Q this makes 3.8 bits a number, where JSON with two
decimals takes 8, and float32 takes 14. Curves are float32, byte by byte in planes.

`data.js` has the inverse of what writes here; that of this module is for tests, and for whoever reads a page.
"""

import base64
import zlib
from typing import NamedTuple

import numpy as np

BELOW, ABOVE, MISSING = 65533, 65534, 65535  # the codes of -inf, inf and NaN
MOST_CODES = 65533
DIGITS = 4.5  # about so many of the largest number are kept


class Steps(NamedTuple):
    """How codes are numbers: `low + code * step`, which is shown with so many `decimals`."""

    low: float
    step: float
    decimals: int

    @classmethod
    def of(cls, x: np.ndarray) -> "Steps":
        """Steps that are fine enough for these numbers, and coarse enough for their codes."""
        finite = x[np.isfinite(x)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
        largest = max(abs(low), abs(high), high - low, 1e-12)
        decimals = int(np.floor(DIGITS - np.log10(largest)))
        while (high - low) * 10.0**decimals > MOST_CODES - 2:
            decimals -= 1
        step = 10.0**-decimals
        return cls(float(np.floor(low / step) * step), step, max(0, decimals))


def codes(x: np.ndarray, steps: Steps) -> np.ndarray:
    """Numbers as codes, uint16 of the same shape."""
    finite = np.isfinite(x)
    u = np.rint((np.where(finite, x, steps.low) - steps.low) / steps.step)
    assert u.size == 0 or (u.min() >= 0 and u.max() < MOST_CODES), "the steps are not of these numbers"
    return np.where(finite, u, np.where(np.isnan(x), MISSING, np.where(x < 0, BELOW, ABOVE))).astype(
        np.uint16
    )


def decoded(u: np.ndarray, steps: Steps) -> np.ndarray:
    """The numbers that codes stand for, float64."""
    x = steps.low + u.astype(float) * steps.step
    for code, value in ((BELOW, -np.inf), (ABOVE, np.inf), (MISSING, np.nan)):
        x[u == code] = value
    return x


def packed_codes(u: np.ndarray) -> bytes:
    """Codes [view, row, ...] as bytes, before they are deflated."""
    delta = u.copy()
    delta[:, 1:] -= u[:, :-1]
    signed = delta.view(np.int16)
    return _planes(((signed << 1) ^ (signed >> 15)).astype("<u2"))


def unpacked_codes(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """The inverse of `packed_codes`, uint16 of this shape."""
    zigzag = _from_planes(data, "<u2").astype(np.uint16).reshape(shape)
    delta = (zigzag >> 1) ^ (-(zigzag & 1).astype(np.int16)).astype(np.uint16)
    return delta.cumsum(1, dtype=np.uint16)


def packed_floats(x: np.ndarray) -> bytes:
    """Numbers as float32, before they are deflated."""
    return _planes(x.astype("<f4"))


def unpacked_floats(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """The inverse of `packed_floats`, float32 of this shape."""
    return _from_planes(data, "<f4").reshape(shape)


def packed_sets(sets: np.ndarray) -> bytes:
    """Sets of actions, bool [..., A], as bits: the first action is the lowest bit of the first byte."""
    return np.packbits(sets, axis=-1, bitorder="little").tobytes()


def unpacked_sets(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """The inverse of `packed_sets`, bool of this shape."""
    bytes_ = np.frombuffer(data, np.uint8).reshape(*shape[:-1], -1)
    return np.unpackbits(bytes_, axis=-1, count=shape[-1], bitorder="little").astype(bool)


def as_text(*parts: bytes) -> str:
    return base64.b64encode(zlib.compress(b"".join(parts), 6)).decode("ascii")


def from_text(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


def _planes(x: np.ndarray) -> bytes:
    """The first bytes of all numbers, then the second ones, and so on: alike bytes stand together."""
    return np.ascontiguousarray(x).view(np.uint8).reshape(-1, x.dtype.itemsize).T.tobytes()


def _from_planes(data: bytes, dtype: str) -> np.ndarray:
    size = np.dtype(dtype).itemsize
    return np.frombuffer(data, np.uint8).reshape(size, -1).T.copy().view(dtype)[:, 0]
