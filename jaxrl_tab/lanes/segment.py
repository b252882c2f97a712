"""Straight code for the lanes of a group, with loops in it that lanes leave one by one."""

import numpy as np

from jaxrl_tab.lanes import operations
from jaxrl_tab.lanes.code import Buffer, Loop, Region, Unsupported, Value
from jaxrl_tab.lanes.names import Names
from jaxrl_tab.lanes.text import Writer
from jaxrl_tab.lanes.types import in_memory, type_of, vector
from jaxrl_tab.lanes.vectors import Vectors


class Segment(Vectors):
    """One of the pieces of which a kernel consists.

    Attributes:
        around: the slot that says which lanes are still in the long loop around the segment; None where all are.
    """

    def __init__(self, names: Names, around: str | None):
        super().__init__(names.layout, names.target)
        self.names, self.facts, self.around = names, names.facts, around
        self._rows: dict[Value, list[str]] = {}
        self._current: dict[Buffer, list[Value]] = {}  # the rows that were read since the memory was changed
        self._bases: dict[Buffer, str] = {}
        self._mask: str | None = None
        self._inner_masks: list[str] = []

    def vector(self, value: Value) -> str:
        return self.names.vector(value, self)

    def write(self, value: Value) -> None:
        """Writes an operation that differs from lane to lane."""
        if value.op == "store":
            self._store(value)
        elif value.op == "row":
            self._rows[value] = self._load_row(value)
            self._current.setdefault(value.attr[0], []).append(value)
        elif value.op == "loop":
            self._loop(value)
        else:
            self.names.set_vector(value, self, self._found(value))

    def _found(self, value: Value) -> str:
        if value.op == "load":
            return self._out_of_row(value) or self._load(value)
        if value.op == "part":
            return self._rows[value.args[0]][value.attr]
        return operation(self.names, self, value, self.vector, self.width)

    # --- loops that lanes leave one by one

    def _loop(self, value: Value) -> None:
        """It goes on until all lanes of the group have left it."""
        loop: Loop = value.attr
        places = self.facts.carried(value)
        carried = [loop.body.params[k] for k in places]
        first = [self._named(value.args[k], param) for k, param in zip(places, carried, strict=True)]
        head, body, end, after = (self.label(name) for name in ("inner", "turn", "end", "out"))
        before = self.block
        self.line(f"br label %{head}")
        self.begin(head)
        names = [self.fresh("c") for _ in carried]
        for param, name, x in zip(carried, names, first, strict=True):
            self.line(f"{name} = phi {self._kind_of(param)} [ {x}, %{before} ], [ {name}.next, %{end} ]")
            if self.facts.varies(param):
                # What the outermost of these loops leaves may be wanted in other segments.
                self.names.set_vector(param, self, name, leaves=not self.depth)
            else:
                self.names.scalars[param] = name
        elements_before = dict(self.elements)
        self._current.clear()
        self.depth += 1
        self._region(loop.condition)
        active, condition = None, loop.condition.results[0]
        if self.facts.varies(condition):
            active = self.active(self.vector(condition))
            self._inner_masks.append(active)
            goes_on = going_on(self, self.any(active))
        else:
            goes_on = self.names.scalar(condition)
            if not self.facts.ends_soon(value):
                goes_on = going_on(self, goes_on)
        self.line(f"br i1 {goes_on}, label %{body}, label %{after}")
        elements_in_head = dict(self.elements)
        self.begin(body)
        self._region(loop.body)
        new = [self._named(loop.body.results[k], param) for k, param in zip(places, carried, strict=True)]
        self.line(f"br label %{end}")
        self.begin(end)
        for param, name, x in zip(carried, names, new, strict=True):
            kind = self._kind_of(param)
            which, old = ("i1 true", x) if active is None else (f"{self.kind(bool)} {active}", name)
            self.line(f"{name}.next = select {which}, {kind} {x}, {kind} {old}")
        if active is not None:
            self._inner_masks.pop()
        self.line(f"br label %{head}")
        self.begin(after)
        self._current.clear()
        self.depth -= 1
        # Behind a loop one knows what was known before it, and, within another one, not what its head worked out.
        self.elements = {x: elements_in_head[x] for x in elements_before}

    def _named(self, value: Value, param: Value) -> str:
        """The name of a value that a loop carries as `param`: of a vector, unless that is the same in all lanes."""
        return self.vector(value) if self.facts.varies(param) else self.names.scalar(value)

    def _kind_of(self, param: Value) -> str:
        return self.kind(param.dtype) if self.facts.varies(param) else type_of(param.dtype)

    def _region(self, region: Region) -> None:
        for value in region.ops:
            if value not in self.facts.live or value.op in ("result", "const"):
                continue
            if value.op == "outside":
                raise Unsupported("a call in a loop that lanes leave one by one")
            if value.op == "loop" or self.facts.varies(value):
                self.write(value)
            else:
                self.names.scalars[value] = uniform(self.names, self, value)

    def mask(self) -> str | None:
        """Which lanes are in all the loops around; None: all."""
        if self._inner_masks:
            return self._inner_masks[-1]
        if self.around is not None and self._mask is None:
            self._mask = self.load_slot(self.around, np.dtype(bool))
        return self._mask

    def active(self, condition: str) -> str:
        """Where a condition holds in lanes that are in all the loops around."""
        mask = self.mask()
        return condition if mask is None else self.value(f"and {self.kind(bool)} {mask}, {condition}")

    def kept(self, x: str, param: Value) -> str:
        """What a loop carries next: in lanes that have left the loop around, what it was."""
        if (mask := self.mask()) is None:
            return x
        kind, old = self.kind(param.dtype), self.load_slot(self.names.slots[param], param.dtype)
        return self.value(f"select {self.kind(bool)} {mask}, {kind} {x}, {kind} {old}")

    def note(self, some: str, active: str) -> None:
        """Notes in memory whether any lane is active."""
        before = self.value(f"load i1, ptr {some}")
        self.line(f"store i1 {self.value(f'or i1 {before}, {self.any(active)}')}, ptr {some}")

    # --- memory

    def _base(self, buffer: Buffer) -> str:
        """Where the numbers of this group begin."""
        if buffer not in self._bases:
            layout, head, kind = self.layout, self.head, in_memory(buffer.dtype)
            start = layout.place(buffer)
            per_lane = layout.stride(buffer) if layout.lane_after_lane(buffer) else 1
            group = head.value(f"zext i32 {self.group} to i64")
            at = head.value(f"mul i64 {group}, {self.width * per_lane}")
            if buffer.role in ("input", "output"):
                lane = head.value(f"mul i64 {layout.first_lane}, {buffer.size}")
                at = head.value(f"add i64 {at}, {lane}")
            self._bases[buffer] = head.value(f"getelementptr {kind}, ptr {start}, i64 {at}")
        return self._bases[buffer]

    def _addresses(self, buffer: Buffer, index: Value, beyond: str | None = None) -> list[str]:
        """Where each lane finds its entry `index` of a buffer.

        Lanes in which the mask `beyond` is false are sent behind the entries, where nothing is read.
        """
        layout, kind = self.layout, in_memory(buffer.dtype)
        shared = layout.is_shared(buffer)
        base = layout.place(buffer) if shared else self._base(buffer)
        to_next = 1 if shared or layout.lane_after_lane(buffer) else layout.lanes  # from an entry to the next
        of_lane = layout.stride(buffer) if to_next == 1 else 1
        if beyond is not None:
            of, nowhere = self.kind(np.int32), self.splat(np.int32, str(buffer.size))
            at = self.value(f"select {self.kind(bool)} {beyond}, {of} {self.vector(index)}, {of} {nowhere}")
            places = self.lanes_of(at)
        elif self.facts.varies(index):
            places = self.lanes_of(self.vector(index))
        else:
            places = [self._wide(index)] * self.width
        addresses = []
        for j, i in enumerate(places):
            lane = base
            if j and not shared:
                lane = self.value(f"getelementptr {kind}, ptr {base}, i64 {j * of_lane}")
            at = i if to_next == 1 else self.value(f"mul i64 {i}, {to_next}")
            addresses.append(self.value(f"getelementptr {kind}, ptr {lane}, i64 {at}"))
        return addresses

    def _side_by_side(self, buffer: Buffer, index: Value) -> str:
        """Where the vector of entry `index` lies, of a buffer that lies entry after entry."""
        row = self._writer.value(f"mul i64 {self._wide(index)}, {self.layout.lanes}")
        return self.value(f"getelementptr {in_memory(buffer.dtype)}, ptr {self._base(buffer)}, i64 {row}")

    @property
    def _writer(self) -> Writer:
        """Where what is the same in all lanes is worked out: before the segment, or, in its loops, there."""
        return self if self.depth else self.layout.function

    def _wide(self, index: Value) -> str:
        """An index that is the same in all lanes, as 64 bits."""
        return self._writer.value(f"sext i32 {self.names.scalar(index)} to i64")

    def _at_once(self, buffer: Buffer, index: Value) -> bool:
        """Whether all lanes want the same entry of a buffer that lies entry after entry."""
        layout = self.layout
        return not (layout.lane_after_lane(buffer) or layout.is_shared(buffer) or self.facts.varies(index))

    def _load(self, value: Value) -> str:
        buffer, index, kind = value.attr, value.args[0], in_memory(value.dtype)
        if not self._at_once(buffer, index):
            numbers = [
                self.value(f"load {kind}, ptr {address}") for address in self._addresses(buffer, index)
            ]
            return self.from_memory(self.joined(kind, numbers), value.dtype)
        address, whole = self._side_by_side(buffer, index), vector(self.width, kind)
        x = self.value(f"load {whole}, ptr {address}, align {self.alignment(value.dtype)}")
        return self.from_memory(x, value.dtype)

    def _out_of_row(self, value: Value) -> str | None:
        """A number of a row that was read before: it is chosen, and no index has to leave the vectors."""
        index = self.facts.of(value.args[0])
        if index.op != "add":
            return None
        for row in self._current.get(value.attr, ()):
            first, count = self.facts.of(row.args[0]), row.attr[1]
            places = [x for x in self.facts.args(index) if x is not first]
            if len(places) == 1 and self._stays_at_hand(count):
                low, high = self.facts.bounds(places[0])
                if low >= 0 and high < count:
                    return self._chosen(self._rows[row], self.vector(places[0]), self.kind(value.dtype))
        return None

    def _stays_at_hand(self, count: int) -> bool:
        """Whether a row of so many numbers takes a quarter of the registers at most."""
        return count * self.width <= self.target.registers // 4 * self.target.width

    def _chosen(self, row: list[str], place: str, kind: str) -> str:
        """Of each lane the number at its place in a row."""
        chosen = row[0]
        for k, x in enumerate(row[1:], 1):
            is_it = self.value(f"icmp eq {self.kind(np.int32)} {place}, {self.splat(np.int32, str(k))}")
            chosen = self.value(f"select {self.kind(bool)} {is_it}, {kind} {x}, {kind} {chosen}")
        return chosen

    def _load_row(self, value: Value) -> list[str]:
        (buffer, count), kind = value.attr, in_memory(value.dtype)
        apart = not (self.layout.lane_after_lane(buffer) or self.layout.is_shared(buffer))
        addresses = self._addresses(buffer, value.args[0])
        if not apart and count == 4 and value.dtype != bool and self.width % 4 == 0:
            rows = [self.value(f"load <4 x {kind}>, ptr {address}, align 4") for address in addresses]
            return self.transposed(rows, kind)
        columns = []
        for k in range(count):
            offset = k * self.layout.lanes if apart else k
            at = [self.value(f"getelementptr {kind}, ptr {address}, i64 {offset}") for address in addresses]
            numbers = self.joined(kind, [self.value(f"load {kind}, ptr {address}") for address in at])
            columns.append(self.from_memory(numbers, value.dtype))
        return columns

    def _store(self, value: Value) -> None:
        buffer, (index, x), kind = value.attr, self.facts.args(value), in_memory(value.dtype)
        self._current.pop(buffer, None)
        numbers, mask, whole = (
            self.to_memory(self.vector(x), value.dtype),
            self.mask(),
            vector(self.width, kind),
        )
        if not self._at_once(buffer, index):
            for j, address in enumerate(self._addresses(buffer, index, mask)):
                number = self.value(f"extractelement {whole} {numbers}, i32 {j}")
                self.line(f"store {kind} {number}, ptr {address}")
            return
        address, align = self._side_by_side(buffer, index), self.alignment(value.dtype)
        if mask is not None:
            old = self.value(f"load {whole}, ptr {address}, align {align}")
            numbers = self.value(f"select {self.kind(bool)} {mask}, {whole} {numbers}, {whole} {old}")
        self.line(f"store {whole} {numbers}, ptr {address}, align {align}")


def going_on(writer: Writer, condition: str) -> str:
    """Whether a loop goes on: as long as its condition holds, and nobody has asked the kernel to stop."""
    stopped = writer.value("load volatile i8, ptr %stop")
    return writer.value(f"and i1 {condition}, {writer.value(f'icmp eq i8 {stopped}, 0')}")


def operation(names: Names, writer: Writer, value: Value, name, width: int) -> str:
    """Writes an operation of `scalars`; `name` gives the names of its arguments."""
    product, args = names.product_in(value), names.facts.args(value)
    named = [name(x) for k, x in enumerate(args) if product is None or k != product[0]]
    site = operations.Site(writer, names.facts, value, named, width)
    if product is None:
        return operations.write(site)
    place, factors = product
    a, b = (name(x) for x in names.facts.args(factors))
    return operations.write_fused(site, place, (a, b))


def uniform(names: Names, writer: Writer, value: Value) -> str:
    """Writes an operation that is the same in all lanes: for one number. Of a row it is the address."""
    if value.op == "row":
        return uniform_address(names, writer, value.attr[0], value.args[0])
    if value.op == "part":
        kind, row = in_memory(value.dtype), names.scalar(value.args[0])
        address = writer.value(f"getelementptr {kind}, ptr {row}, i64 {value.attr}")
    elif value.op == "load":
        address = uniform_address(names, writer, value.attr, value.args[0])
    else:
        return operation(names, writer, value, names.scalar, 0)
    x = writer.value(f"load {in_memory(value.dtype)}, ptr {address}")
    return writer.value(f"trunc i8 {x} to i1") if value.dtype == bool else x


def uniform_address(names: Names, writer: Writer, buffer: Buffer, index: Value) -> str:
    """Where an entry lies of a buffer that is the same in all lanes, or of one lane alone."""
    kind, start = in_memory(buffer.dtype), names.layout.place(buffer)
    if buffer.role in ("input", "output"):
        lane = writer.value(f"mul i64 {names.layout.first_lane}, {buffer.size}")
        start = writer.value(f"getelementptr {kind}, ptr {start}, i64 {lane}")
    at = writer.value(f"zext i32 {names.scalar(index)} to i64")
    return writer.value(f"getelementptr {kind}, ptr {start}, i64 {at}")
