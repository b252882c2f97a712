"""Code for the lanes of a group: what is read at its beginning, what is done, and what is put away at its end."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes.layout import LINE, Layout
from jaxrl_tab.lanes.target import Target
from jaxrl_tab.lanes.text import Writer
from jaxrl_tab.lanes.types import bytes_of, in_memory, is_bool, type_of, vector

PAIRED = (
    16  # numbers of a processor's vector: there indices leave one vector two by two, since that was faster
)


class Vectors(Writer):
    """Straight code that is done for one group of lanes after another.

    Attributes:
        group: the name of the group's number.
        head: what is read at its beginning.
        last: what is put into slots at its end.
        depth: how many loops of its own are being written around the next line.
    """

    def __init__(self, layout: Layout, target: Target):
        function = layout.function
        label = function.label("segment")
        super().__init__(function.numbers, function.declared, label)
        self.layout, self.target, self.width, self.depth = layout, target, layout.width, 0
        self.name, self.after, self.group = label, function.label("after"), f"%{label}.group"
        self.head = Writer(self.numbers, self.declared, label)
        self.last = Writer(self.numbers, self.declared, label)
        self._splats: dict[Any, str] = {}
        self.elements: dict[str, list[str]] = {}  # of vectors of indices: the single ones

    def finish(self) -> None:
        """Goes on behind it."""
        function = self.layout.function
        function.line(f"br label %{self.name}")
        self.before = function.block
        function.insert(self, self.after)

    def whole(self) -> Sequence[str]:
        g, groups = self.group, self.layout.groups
        if groups == 1:
            head = [f"  {g} = phi i32 [ 0, %{self.before} ]"]
            turn = [f"  br label %{self.after}"]
        else:
            head = [f"  {g} = phi i32 [ 0, %{self.before} ], [ {g}.next, %{self.block} ]"]
            turn = [
                f"  {g}.next = add nuw nsw i32 {g}, 1",
                f"  {g}.more = icmp ult i32 {g}.next, {groups}",
                f"  br i1 {g}.more, label %{self.name}, label %{self.after}",
            ]
        return [f"{self.name}:", *head, *self.head.lines, *self.lines, *self.last.lines, *turn]

    def kind(self, dtype: Any) -> str:
        """A vector of numbers."""
        return vector(self.width, type_of(dtype))

    # --- slots: memory of the block for one number of each lane, in which a value waits

    def load_slot(self, slot: str, dtype: Any) -> str:
        """What a slot holds at the beginning of the segment."""
        kind = vector(self.width, in_memory(dtype))
        address = self.head.value(f"getelementptr {kind}, ptr {slot}, i32 {self.group}")
        x = self.head.value(f"load {kind}, ptr {address}, align {self.alignment(dtype)}")
        return self.head.value(f"trunc {kind} {x} to {self.kind(bool)}") if is_bool(dtype) else x

    def store_slot(self, slot: str, dtype: Any, x: str) -> None:
        """What it holds from the end of the segment on."""
        kind = vector(self.width, in_memory(dtype))
        x = self.last.value(f"zext {self.kind(bool)} {x} to {kind}") if is_bool(dtype) else x
        address = self.last.value(f"getelementptr {kind}, ptr {slot}, i32 {self.group}")
        self.last.line(f"store {kind} {x}, ptr {address}, align {self.alignment(dtype)}")

    def alignment(self, dtype: Any) -> int:
        return min(LINE, self.width * bytes_of(dtype))

    # --- from single numbers to vectors, and back

    def splat(self, dtype: Any, x: str) -> str:
        """A number in all lanes."""
        kind = type_of(dtype)
        if not x.startswith("%"):
            return f"splat ({kind} {x})"
        if self.depth:  # it may be known within a loop only
            return self._splat(self, kind, x)
        if (kind, x) not in self._splats:
            self._splats[kind, x] = self._splat(self.head, kind, x)
        return self._splats[kind, x]

    def _splat(self, writer: Writer, kind: str, x: str) -> str:
        w, whole = self.width, vector(self.width, kind)
        one = writer.value(f"insertelement {whole} poison, {kind} {x}, i32 0")
        return writer.value(f"shufflevector {whole} {one}, {whole} poison, <{w} x i32> zeroinitializer")

    def lanes_of(self, x: str) -> list[str]:
        """The numbers of a vector of indices, none of which is negative, as 64 bits."""
        if x not in self.elements:
            by_two = self.width <= self.target.width == PAIRED and self.width % 2 == 0
            write = self._two_by_two if by_two else self._one_by_one
            self.elements[x] = write(x)
        return self.elements[x]

    def _one_by_one(self, x: str) -> list[str]:
        whole = self.kind(np.int32)
        numbers = [self.value(f"extractelement {whole} {x}, i32 {j}") for j in range(self.width)]
        return [self.value(f"zext i32 {number} to i64") for number in numbers]

    def _two_by_two(self, x: str) -> list[str]:
        """They leave the vector in pairs, as numbers of 64 bits, which are cut in half."""
        pairs = self.width // 2
        wide = self.value(f"bitcast {self.kind(np.int32)} {x} to {vector(pairs, 'i64')}")
        numbers = []
        for k in range(pairs):
            pair = self.value(f"extractelement {vector(pairs, 'i64')} {wide}, i32 {k}")
            # This does nothing, but LLVM forgets how large the numbers are. Where it knows that of a sum, LLVM 22
            # leaves out the mask of the lower half in an address, and would read and write anywhere.
            pair = self.value(f'call i64 asm "", "=r,0"(i64 {pair})')
            numbers += [self.value(f"and i64 {pair}, {2**32 - 1}"), self.value(f"lshr i64 {pair}, 32")]
        return numbers

    def joined(self, kind: str, numbers: Sequence[str]) -> str:
        """Single numbers of some type as a vector."""
        whole = "poison"
        for j, x in enumerate(numbers):
            whole = self.value(f"insertelement {vector(self.width, kind)} {whole}, {kind} {x}, i32 {j}")
        return whole

    def from_memory(self, x: str, dtype: Any) -> str:
        if not is_bool(dtype):
            return x
        return self.value(f"trunc {vector(self.width, 'i8')} {x} to {self.kind(bool)}")

    def to_memory(self, x: str, dtype: Any) -> str:
        if not is_bool(dtype):
            return x
        return self.value(f"zext {self.kind(bool)} {x} to {vector(self.width, 'i8')}")

    def any(self, mask: str) -> str:
        """Whether it is true in any lane."""
        bits = self.value(f"bitcast {self.kind(bool)} {mask} to i{self.width}")
        return self.value(f"icmp ne i{self.width} {bits}, 0")

    def transposed(self, rows: Sequence[str], kind: str) -> list[str]:
        """As many vectors of four as there are lanes -> four vectors: shuffles within 128 bits, which are quick."""
        w = self.width

        def shuffled(a: str, b: str, size: int, places: Sequence[int]) -> str:
            mask, of = ", ".join(f"i32 {i}" for i in places), vector(size, kind)
            return self.value(f"shufflevector {of} {a}, {of} {b}, <{len(places)} x i32> <{mask}>")

        def joined(parts: list[str], size: int) -> str:
            while len(parts) > 1:
                pairs = zip(parts[::2], parts[1::2], strict=True)
                parts = [shuffled(a, b, size, range(2 * size)) for a, b in pairs]
                size *= 2
            return parts[0]

        def mixed(a: str, b: str, places: tuple[int, ...]) -> str:
            """The same places of each four, of which those from 4 on are of `b`."""
            return shuffled(
                a, b, w, [(i if i < 4 else i - 4 + w) + k for k in range(0, w, 4) for i in places]
            )

        a = [joined([rows[4 * part + k] for part in range(w // 4)], 4) for k in range(4)]
        low, high = (0, 4, 1, 5), (2, 6, 3, 7)
        t = [mixed(a[0], a[1], low), mixed(a[2], a[3], low), mixed(a[0], a[1], high), mixed(a[2], a[3], high)]
        first, second = (0, 1, 4, 5), (2, 3, 6, 7)
        return [mixed(t[k], t[k + 1], places) for k in (0, 2) for places in (first, second)]
