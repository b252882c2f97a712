"""The scalars in event files, as TensorBoard shows them: read without TensorFlow, checked, and never trusted.

A file is a row of records (TFRecord): the length of the data, 8 bytes, its checksum, the data, and their checksum. The
data are an `Event` of protocol buffers, of which the fields are read that scalars need.
Source: TensorFlow, `core/lib/io/record_writer.h`, `core/util/event.proto`, `core/framework/summary.proto`.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

MOST = 2**31  # bytes of a record; protocol buffers have none that is longer
CHECKED = (
    2**16
)  # bytes of a record without scalars whose checksum is worked out; it takes Python a second for 2**24
FLOAT, DOUBLE = 1, 2  # numbers of types in a TensorProto


class Scalars(NamedTuple):
    """What an event file has.

    Attributes:
        tags: by its tag each scalar's (step, value), in the order of the file.
        damaged: from which byte on the file is damaged or cut off; None where it is whole.
    """

    tags: dict[str, list[tuple[int, float]]]
    damaged: int | None


def scalars(file: Path) -> Scalars:
    """Reads the scalars of an event file. What comes after the first damaged record is not read.

    Raises:
        OSError: the file cannot be read.
    """
    data = file.read_bytes()
    tags: dict[str, list[tuple[int, float]]] = {}
    at = 0
    while at < len(data):
        end = _end(data, at)
        try:
            found = [] if end is None else _scalars_of(data[at + 12 : end - 4])
        except (ValueError, IndexError, struct.error):
            end = None
            found = []
        # Large records without scalars, such as pictures and graphs, are passed over: nothing of them is used.
        checked = end is not None and (found or end - at <= CHECKED)
        if end is None or (checked and _masked(data[at + 12 : end - 4]) != _word(data, end - 4)):
            return Scalars(tags, at)
        for tag, step, value in found:
            tags.setdefault(tag, []).append((step, value))
        at = end
    return Scalars(tags, None)


def _end(data: bytes, at: int) -> int | None:
    """Where the record ends that begins here; None where its length is damaged, or the file is cut off."""
    if at + 12 > len(data) or _masked(data[at : at + 8]) != _word(data, at + 8):
        return None
    (length,) = struct.unpack_from("<Q", data, at)
    end = at + 12 + length + 4
    return end if length < MOST and end <= len(data) else None


# --- checksums ---------------------------------------------------------------------------------------
def _table() -> list[int]:
    table = []
    for x in range(256):
        for _ in range(8):
            x = x >> 1 ^ (0x82F63B78 if x & 1 else 0)
        table.append(x)
    return table


_CRC = _table()


def crc32c(data: bytes) -> int:
    """The checksum CRC-32C (Castagnoli)."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = _CRC[(crc ^ byte) & 0xFF] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


def _masked(data: bytes) -> int:
    """The checksum as records have it: rotated, and with a constant added."""
    crc = crc32c(data)
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


def _word(data: bytes, at: int) -> int:
    return struct.unpack_from("<I", data, at)[0]


# --- protocol buffers --------------------------------------------------------------------------------
def _scalars_of(event: bytes) -> list[tuple[str, int, float]]:
    """The (tag, step, value) of an `Event`."""
    step, found = 0, []
    for number, value in _fields(event):
        if number == 2 and isinstance(value, int):
            step = value
        elif number == 5 and isinstance(value, bytes):  # its summary
            found += [_value(x) for n, x in _fields(value) if n == 1 and isinstance(x, bytes)]
    return [(tag, step, number) for tag, number in found if number is not None]


def _value(message: bytes) -> tuple[str, float | None]:
    """The tag and the number of a `Summary.Value`; None where it is no scalar."""
    tag, number = "", None
    for field, value in _fields(message):
        if field == 1 and isinstance(value, bytes):
            tag = value.decode("utf-8", "replace")
        elif field == 2 and isinstance(value, bytes):  # simple_value; fixed32 comes as its bytes
            (number,) = struct.unpack("<f", value)
        elif field == 8 and isinstance(value, bytes):
            number = _tensor(value)
    return tag, number


def _tensor(message: bytes) -> float | None:
    """The number of a `TensorProto` that is a scalar of floats or doubles."""
    fields = dict(_fields(message))
    kind = {FLOAT: ("<f", 5), DOUBLE: ("<d", 6)}.get(fields.get(1, 0))
    if kind is None or (isinstance(fields.get(2), bytes) and 2 in dict(_fields(fields[2]))):
        return None  # of another type, or with axes
    packed, own = kind
    content = fields.get(4) or fields.get(own)
    size = struct.calcsize(packed)
    if not isinstance(content, bytes) or len(content) != size:
        return None
    return struct.unpack(packed, content)[0]


def _fields(message: bytes) -> Iterator[tuple[int, Any]]:
    """The fields of a message: its number, and an int, or bytes (also of numbers of 4 or 8 bytes).

    Raises:
        ValueError, IndexError: it is no message.
    """
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == 0:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == 2:
            length, at = _varint(message, at)
        elif kind in (1, 5):
            length = 8 if kind == 1 else 4
        else:
            raise ValueError(f"a field of kind {kind}")
        if at + length > len(message):
            raise ValueError("a field that is cut off")
        yield number, message[at : at + length]
        at += length


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if not byte & 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a number that is too long")
