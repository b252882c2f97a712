"""Where the arrays of a block of lanes lie in memory.

A block is some groups of lanes, and a group as many lanes as a vector holds. An array of which each lane mostly wants
an entry of its own lies lane after lane, as the caller's arrays do: then a row of a table is read at once. One of
which all lanes mostly want the same entry at a time lies entry after entry, so that the numbers of a group lie side
by side.
"""

from collections import defaultdict

from jaxrl_tab.lanes.analysis import Facts, buffer_of, operations
from jaxrl_tab.lanes.code import Buffer, Region
from jaxrl_tab.lanes.text import Function
from jaxrl_tab.lanes.types import bytes_of

LINE = 64  # bytes of a cache line, to which all that a thread works with is aligned
FAR = 1.2  # as much work it is to read an entry where those of the same lane do not lie together
APART = 5 * LINE  # between two arrays: else all of them might want the same few places in the cache


def lane_after_lane(facts: Facts, region: Region, width: int) -> set[Buffer]:
    """The buffers that lie lane after lane: those for which it is less work, so far as one can tell."""
    # The instructions that it takes for each lane, the one way and the other.
    so: defaultdict[Buffer, float] = defaultdict(float)
    otherwise: defaultdict[Buffer, float] = defaultdict(float)
    for value in operations(region):
        buffer = value.attr if value.op == "store" else buffer_of(value)
        if value not in facts.live or buffer is None:
            continue
        turns, count = facts.turns(value), value.attr[1] if value.op == "row" else 1
        own_index = value.op == "row" or facts.varies(value.args[0])
        so[buffer] += turns
        otherwise[buffer] += turns * count * FAR if own_index else turns / width
    return {buffer for buffer, work in so.items() if work <= otherwise[buffer]}


class Layout:
    """The memory of one block.

    Attributes:
        width: the lanes of a group.
        groups: of a block.
        scratch: the bytes with which a thread works.
        tables: the arrays that are known, in the order in which the kernel is given them.
        first_lane: the name of the number of the block's first lane, once it is written.
    """

    def __init__(self, function: Function, facts: Facts, region: Region, width: int, groups: int):
        self.function, self.facts, self.width, self.groups = function, facts, width, groups
        self.scratch = 0
        self.tables: dict[Buffer, int] = {}
        self.first_lane = ""
        self._place: dict[Buffer, str] = {}
        self._by_lanes = lane_after_lane(facts, region, width)

    @property
    def lanes(self) -> int:
        return self.width * self.groups

    def set_arguments(self, buffers: list[Buffer]) -> None:
        """Those that the kernel is given by the caller."""
        for k, buffer in enumerate(buffers):
            self._place[buffer] = self._pointer("arrays", k)

    def place(self, buffer: Buffer) -> str:
        """The name of the address at which a buffer begins."""
        if buffer not in self._place:
            if buffer.known is not None:
                self._place[buffer] = self._pointer(
                    "tables", self.tables.setdefault(buffer, len(self.tables))
                )
            else:
                of_lanes = self.lanes if buffer in self.facts.varying else 1
                self._place[buffer] = self.room(bytes_of(buffer.dtype) * self.stride(buffer) * of_lanes)
        return self._place[buffer]

    def room(self, size: int) -> str:
        """The name of the address of so many bytes, with which the thread works."""
        address = self.function.entry(f"getelementptr i8, ptr %scratch, i64 {self.scratch}")
        self.scratch += -(-size // LINE) * LINE + APART
        return address

    def _pointer(self, array: str, k: int) -> str:
        address = self.function.entry(f"getelementptr ptr, ptr %{array}, i32 {k}")
        return self.function.entry(f"load ptr, ptr {address}, !invariant.load !0")

    def stride(self, buffer: Buffer) -> int:
        """From one lane's numbers to the next's. One more than there are: lanes that have left a loop write there."""
        return buffer.size + (buffer in self.facts.masked)

    def lane_after_lane(self, buffer: Buffer) -> bool:
        return buffer in self._by_lanes or buffer.role != "scratch"

    def is_shared(self, buffer: Buffer) -> bool:
        """Whether it is the same in all lanes, and there once."""
        return buffer not in self.facts.varying and buffer.role == "scratch"
