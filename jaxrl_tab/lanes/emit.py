"""From scalar code to LLVM IR in which each number is a vector over lanes.

A kernel works through blocks of lanes. A block is some groups, and a group as many lanes as a vector holds. Loops
that all lanes leave together are loops of the kernel; what stands between two such loops is a *segment*: straight
code that is done for one group after another, so that a processor that looks ahead works on several at once.
Values that one segment hands to another, or a loop to its next turn, lie in slots: memory of the block, a vector
for each group. What is the same in all lanes is one number, worked out beside the segments.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxrl_tab.lanes.analysis import Facts, buffer_of, operations
from jaxrl_tab.lanes.code import Buffer, Region, Unsupported, Value
from jaxrl_tab.lanes.lower import Lowering

TYPES = {"bool": "i1", "int32": "i32", "uint32": "i32", "float32": "float"}
AT_ONCE = 600  # a loop that lanes leave one by one is done group by group where its body has so few operations
LINE = 64  # bytes of a cache line, to which everything is aligned
COMPARE = {"eq": "eq", "ne": "ne", "lt": "lt", "le": "le", "gt": "gt", "ge": "ge"}


class Emitter:
    """Writes one kernel: `void kernel(i64 first block, i64 after the last, ptr scratch, ptr arrays, ptr tables)`."""

    def __init__(self, code: Lowering, width: int, groups: int, gather: bool = False):
        self.code, self.facts = code, Facts(code.region)
        self.width, self.groups, self.lanes = width, groups, width * groups
        self.gather = gather
        self.text = Function()
        self.segment: Segment | None = None
        self.names: dict[Value, str] = {}  # of what is the same in all lanes
        self.homes: dict[Value, tuple[Segment, str]] = {}  # of what differs: where it was worked out, and its name there
        self.slots: dict[Value, str] = {}
        self.scratch = 0
        self.tables: dict[Buffer, int] = {}
        self.place: dict[Buffer, str] = {}
        self.masks: list[str] = []  # slots: which lanes are still in the loops around
        self.by_index: set[Buffer] = set()  # buffers that are read or written at an index of each lane's own
        for value in operations(code.region):
            if value in self.facts.live and (value.op == "store" or buffer_of(value) is not None):
                buffer = value.attr if value.op == "store" else buffer_of(value)
                if value.op == "row" or self.facts.varies(value.args[0]):
                    self.by_index.add(buffer)

    # --- the whole

    def kernel(self) -> str:
        t = self.text
        inputs = len(self.code.inputs)
        for k, buffer in enumerate((*self.code.inputs, *self.code.outputs)):
            address = t.entry(f"getelementptr ptr, ptr %arrays, i32 {k}")
            self.place[buffer] = t.entry(f"load ptr, ptr {address}")
        blocks, body, after = t.label("blocks"), t.label("block"), t.label("after")
        start = t.block
        t.line(f"br label %{blocks}")
        t.begin(blocks)
        block = t.fresh("b")
        t.line(f"{block} = phi i64 [ %first, %{start} ], [ {block}.next, %BLOCKEND ]")
        t.line(f"{block}.more = icmp ult i64 {block}, %last")
        t.line(f"br i1 {block}.more, label %{body}, label %{after}")
        t.begin(body)
        self.first_lane = t.value(f"mul i64 {block}, {self.lanes}")
        self.region(self.code.region)
        self.close()
        t.line(f"{block}.next = add i64 {block}, 1")
        t.line(f"br label %{blocks}")
        end = t.block
        t.begin(after)
        t.line("call void @llvm.x86.sse.ldmxcsr(ptr %control)")
        t.line("ret void")
        del inputs
        return t.whole().replace("%BLOCKEND", f"%{end}")

    # --- regions and loops

    def region(self, region: Region) -> None:
        """The operations of a region that no lane leaves before the others."""
        for value in region.ops:
            if value not in self.facts.live or value.op in ("result", "const"):
                continue
            if value.op == "loop":
                if not self.facts.varies(value):
                    self.loop(value)
                elif self.facts.size(value.attr) <= AT_ONCE:
                    self.here().loop(value)
                else:
                    self.masked_loop(value)
            elif self.facts.varies(value):
                self.here()
                self.vector_operation(value)
            elif value.op == "store":
                self.close()
                self.uniform_store(value)
            else:
                self.names[value] = self.uniform_operation(value)

    def loop(self, value: Value) -> None:
        t, loop = self.text, value.attr
        carried = self.facts.carried(value)
        varying = [k for k in carried if self.facts.varies(loop.body.params[k])]
        uniform = [k for k in carried if k not in varying]
        for k in varying:
            self.slots[loop.body.params[k]] = self.slot(loop.body.params[k].dtype)
        self.fill(loop.body.params, value.args, varying)
        self.close()
        first = [self.scalar(value.args[k]) for k in uniform]
        head, body, after = t.label("head"), t.label("body"), t.label("done")
        before = t.block
        t.line(f"br label %{head}")
        t.begin(head)
        names = [t.fresh("c") for _ in uniform]
        phis = [
            f"{name} = phi {self.type(loop.body.params[k])} [ {x}, %{before} ], [ {name}.next, %{head}.end ]"
            for k, name, x in zip(uniform, names, first, strict=True)
        ]
        for phi in phis:
            t.line(phi)
        self.names |= {loop.body.params[k]: name for k, name in zip(uniform, names, strict=True)}
        self.region(loop.condition)
        self.close()
        t.line(f"br i1 {self.scalar(loop.condition.results[0])}, label %{body}, label %{after}")
        t.begin(body)
        self.region(loop.body)
        self.fill(loop.body.params, loop.body.results, varying)
        self.close()
        end = f"{head}.end"
        t.line(f"br label %{end}")
        t.begin(end)
        for k, name in zip(uniform, names, strict=True):
            x = self.scalar(loop.body.results[k])
            t.line(f"{name}.next = select i1 true, {self.type(loop.body.params[k])} {x}, {self.type(loop.body.params[k])} {x}")
        t.line(f"br label %{head}")
        t.begin(after)

    def masked_loop(self, value: Value) -> None:
        """A long loop that lanes leave one by one: it goes on until all have left it."""
        t, loop = self.text, value.attr
        carried = self.facts.carried(value)
        for k in carried:
            self.slots[loop.body.params[k]] = self.slot(loop.body.params[k].dtype)
        self.fill(loop.body.params, value.args, carried)
        self.close()
        mask, some = self.slot(np.dtype(bool)), t.entry("alloca i32")
        head, body, after = t.label("head"), t.label("body"), t.label("done")
        t.line(f"br label %{head}")
        t.begin(head)
        t.line(f"store i32 0, ptr {some}")
        self.region(loop.condition)
        segment = self.here()
        active = segment.active(self.vector(loop.condition.results[0]))
        segment.store_slot(mask, np.dtype(bool), active)
        segment.note(some, active)
        self.close()
        any_left = t.value(f"icmp ne i32 {t.value(f'load i32, ptr {some}')}, 0")
        t.line(f"br i1 {any_left}, label %{body}, label %{after}")
        t.begin(body)
        self.masks.append(mask)
        self.region(loop.body)
        self.fill(loop.body.params, loop.body.results, carried)
        self.close()
        self.masks.pop()
        t.line(f"br label %{head}")
        t.begin(after)

    def fill(self, params: Sequence[Value], values: Sequence[Value], places: Sequence[int]) -> None:
        """Puts values into the slots of what a loop carries: all are read before one is written."""
        if not places:
            return
        segment = self.here()
        new = [segment.kept(self.vector(values[k]), params[k]) for k in places]
        for k, x in zip(places, new, strict=True):
            segment.store_slot(self.slots[params[k]], params[k].dtype, x)

    # --- segments

    def here(self) -> "Segment":
        """The segment that is being written."""
        if self.segment is None:
            self.segment = Segment(self)
        return self.segment

    def close(self) -> None:
        if self.segment is not None:
            self.segment.finish()
            self.segment = None

    def slot(self, dtype: Any) -> str:
        kind = "i8" if dtype == bool else TYPES[dtype.name]
        return self.text.entry(f"alloca [{self.lanes} x {kind}], align {LINE}")

    def buffer(self, buffer: Buffer) -> str:
        """Where a buffer begins."""
        if buffer not in self.place:
            if buffer.known is not None:
                k = self.tables.setdefault(buffer, len(self.tables))
                address = self.text.entry(f"getelementptr ptr, ptr %tables, i32 {k}")
                self.place[buffer] = self.text.entry(f"load ptr, ptr {address}, !invariant.load !0")
            else:
                count = self.stride(buffer) * (self.lanes if buffer in self.facts.varying else 1)
                self.place[buffer] = self.text.entry(f"getelementptr i8, ptr %scratch, i64 {self.scratch}")
                self.scratch += -(-bytes_of(buffer.dtype) * count // LINE) * LINE + 5 * LINE  # not all on one set of the cache
        return self.place[buffer]

    def stride(self, buffer: Buffer) -> int:
        """From one lane's numbers to the next's. One more than there are: lanes that have left a loop write there."""
        return buffer.size + (buffer in self.facts.masked)

    # --- what is the same in all lanes

    @property
    def writer(self) -> "Writer":
        """Where it is worked out: beside the segments, but within a loop of a segment there."""
        return self.segment if self.segment is not None and self.segment.depth else self.text

    def type(self, value: Value) -> str:
        return TYPES[value.dtype.name]

    def scalar(self, value: Value) -> str:
        value = self.facts.of(value)
        if value.op == "const":
            return literal(value.attr)
        if value.op == "result":
            return self.scalar_param(value)
        return self.names[value]

    def scalar_param(self, value: Value) -> str:
        return self.names[value.args[0].attr.body.params[value.attr]]

    def uniform_operation(self, value: Value) -> str:
        if value.op == "load":
            return self.uniform_load(value)
        if value.op in ("row", "part"):
            raise Unsupported("a row that is the same in all lanes")
        args = self.facts.args(value)
        return operation(self.writer, self.facts, value, [self.scalar(x) for x in args], [self.type(x) for x in args], self.type(value), 0, self.fused_with(value, self.scalar))

    def uniform_load(self, value: Value) -> str:
        t, kind = self.writer, memory_type(value.dtype)
        index = t.value(f"sext i32 {self.scalar(value.args[0])} to i64")
        address = t.value(f"getelementptr {kind}, ptr {self.buffer(value.attr)}, i64 {index}")
        x = t.value(f"load {kind}, ptr {address}")
        return t.value(f"trunc i8 {x} to i1") if value.dtype == bool else x

    def uniform_store(self, value: Value) -> None:
        t, kind = self.text, memory_type(value.dtype)
        index = t.value(f"sext i32 {self.scalar(value.args[0])} to i64")
        address = t.value(f"getelementptr {kind}, ptr {self.buffer(value.attr)}, i64 {index}")
        x = self.scalar(value.args[1])
        x = t.value(f"zext i1 {x} to i8") if value.dtype == bool else x
        t.line(f"store {kind} {x}, ptr {address}")

    # --- what differs

    def vector_type(self, value: Value) -> str:
        return f"<{self.width} x {self.type(value)}>"

    def vector(self, value: Value) -> str:
        """A value as a vector, in the segment that is being written."""
        value, segment = self.facts.of(value), self.here()
        if not self.facts.varies(value):
            return segment.splat(self.type(value), self.scalar(value))
        if value.op == "result":
            value = value.args[0].attr.body.params[value.attr]
        if value in segment.names:
            return segment.names[value]
        if value not in self.slots:
            home, name = self.homes[value]
            self.slots[value] = self.slot(value.dtype)
            home.store_slot(self.slots[value], value.dtype, name)
        segment.names[value] = name = segment.load_slot(self.slots[value], value.dtype)
        return name

    def fused(self, value: Value) -> tuple[int, Value] | None:
        """Where an addition takes a product that nobody else uses: its place, and the product. They are rounded once."""
        if value.op not in ("add", "sub") or value.dtype.kind != "f":
            return None
        for k, x in enumerate(self.facts.args(value)):
            if x.op == "mul" and self.facts.uses[x] == 1:
                return k, x
        return None

    def vector_operation(self, value: Value) -> None:
        segment, args = self.here(), self.facts.args(value)
        if value.op == "store":
            return segment.store(value)
        if value.op == "load":
            name = segment.load(value)
        elif value.op == "row":
            segment.rows[value] = segment.load_row(value)
            return None
        elif value.op == "part":
            name = segment.rows[args[0]][value.attr]
        else:
            types = [self.vector_type(x) for x in args]
            name = operation(segment, self.facts, value, [self.vector(x) for x in args], types, self.vector_type(value), self.width, self.fused_with(value, self.vector))
        segment.names[value] = name
        self.homes[value] = segment, name
        return None

    def fused_with(self, value: Value, name: Callable[[Value], str]) -> tuple[int, list[str]] | None:
        if (found := self.fused(value)) is None:
            return None
        k, product = found
        return k, [name(x) for x in self.facts.args(product)]


class Writer:
    """Lines of one piece of a function. Names are numbered through the whole function."""

    counter = 0
    lines: list[str]

    def line(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def fresh(self, name: str = "v") -> str:
        Writer.counter += 1
        return f"%{name}{Writer.counter}"

    def value(self, text: str) -> str:
        name = self.fresh()
        self.lines.append(f"  {name} = {text}")
        return name


class Function(Writer):
    """The kernel: its entry, and pieces of code one after another."""

    def __init__(self) -> None:
        self.entries: list[str] = []
        self.lines = []
        self.parts: list[Any] = [self.lines]
        self.block = "start"
        self.declared: set[str] = set()

    def entry(self, text: str) -> str:
        name = self.fresh()
        self.entries.append(f"  {name} = {text}")
        return name

    def label(self, name: str) -> str:
        return self.fresh(name)[1:]

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label

    def resume(self, label: str) -> None:
        self.lines = []
        self.parts.append(self.lines)
        self.begin(label)

    def whole(self) -> str:
        body: list[str] = []
        for part in self.parts:
            body += part if isinstance(part, list) else part.whole()
        head = "define void @kernel(i64 %first, i64 %last, ptr noalias %scratch, ptr %arrays, ptr %tables) {"
        return "\n".join([*sorted(DECLARATIONS), head, "entry:", *self.entries, *_FLUSHED, "  br label %start", "start:", *body, "}", "!0 = !{}"])


# Numbers too small for full precision are 0, as in XLA's kernels: two bits of the processor's control word.
_FLUSHED = [
    "  %control = alloca i32",
    "  %flushed = alloca i32",
    "  call void @llvm.x86.sse.stmxcsr(ptr %control)",
    "  %word = load i32, ptr %control",
    f"  %flushing = or i32 %word, {1 << 15 | 1 << 6}",
    "  store i32 %flushing, ptr %flushed",
    "  call void @llvm.x86.sse.ldmxcsr(ptr %flushed)",
]


class Segment(Writer):
    """Code that is done for one group after another.

    `head` is what is read at its beginning, `last` what is put into slots at its end.
    """

    def __init__(self, emitter: Emitter):
        self.e, self.text = emitter, emitter.text
        self.label, self.after = self.text.label("segment"), self.text.label("u")
        self.block = self.label
        self.group = f"%{self.label}.g"
        self.head: list[str] = []
        self.lines: list[str] = []
        self.last: list[str] = []
        self.depth = 0  # of the loops in it that are being written
        self.masks: list[str] = []
        self.names: dict[Value, str] = {}
        self.rows: dict[Value, list[str]] = {}
        self.splats: dict[Any, str] = {}
        self.elements: dict[Any, list[str]] = {}
        self.bases: dict[Buffer, str] = {}

    def finish(self) -> None:
        """Goes on behind it."""
        self.text.line(f"br label %{self.label}")
        self.before = self.text.block
        self.text.parts.append(self)
        self.text.resume(self.after)

    def whole(self) -> list[str]:
        g = self.group
        if self.e.groups == 1:
            loop = [f"  br label %{self.after}"]
            head = [f"  {g} = phi i32 [ 0, %{self.before} ]"]
        else:
            head = [f"  {g} = phi i32 [ 0, %{self.before} ], [ {g}.next, %{self.block} ]"]
            loop = [
                f"  {g}.next = add nuw nsw i32 {g}, 1",
                f"  {g}.more = icmp ult i32 {g}.next, {self.e.groups}",
                f"  br i1 {g}.more, label %{self.label}, label %{self.after}",
            ]
        return [f"{self.label}:", *head, *self.head, *self.lines, *self.last, *loop]

    # --- loops that lanes leave one by one

    def loop(self, value: Value) -> None:
        loop, facts = value.attr, self.e.facts
        carried = facts.carried(value)
        first = [self.e.vector(value.args[k]) for k in carried]
        head, body, after = (self.text.label(name) for name in ("inner", "turn", "out"))
        before = self.block
        self.line(f"br label %{head}")
        self.begin(head)
        names = [self.fresh("c") for _ in carried]
        kinds = [self.e.vector_type(loop.body.params[k]) for k in carried]
        for name, kind, x in zip(names, kinds, first, strict=True):
            self.line(f"{name} = phi {kind} [ {x}, %{before} ], [ {name}.next, %{body}.end ]")
        self.names |= {loop.body.params[k]: name for k, name in zip(carried, names, strict=True)}
        outer = dict(self.elements)
        self.depth += 1
        self.region(loop.condition)
        active = self.active(self.e.vector(loop.condition.results[0]))
        w = self.e.width
        any_left = self.value(f"icmp ne i{w} {self.value(f'bitcast <{w} x i1> {active} to i{w}')}, 0")
        self.line(f"br i1 {any_left}, label %{body}, label %{after}")
        self.begin(body)
        self.masks.append(active)
        in_head = dict(self.elements)
        self.region(loop.body)
        new = [self.e.vector(loop.body.results[k]) for k in carried]
        self.masks.pop()
        self.line(f"br label %{body}.end")
        self.begin(f"{body}.end")
        for name, kind, x in zip(names, kinds, new, strict=True):
            self.line(f"{name}.next = select <{w} x i1> {active}, {kind} {x}, {kind} {name}")
        self.line(f"br label %{head}")
        self.begin(after)
        self.depth -= 1
        if not self.depth:  # what it leaves may be wanted in other segments
            self.e.homes |= {loop.body.params[k]: (self, name) for k, name in zip(carried, names, strict=True)}
        self.elements = outer if not self.depth else {k: v for k, v in in_head.items() if k in outer}

    def region(self, region: Region) -> None:
        for value in region.ops:
            if value not in self.e.facts.live or value.op in ("result", "const"):
                continue
            if value.op == "loop":
                self.loop(value)
            elif self.e.facts.varies(value):
                self.e.vector_operation(value)
            else:
                self.e.names[value] = self.e.uniform_operation(value)

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label

    def mask(self) -> str | None:
        """Which lanes are in all the loops around."""
        if self.masks:
            return self.masks[-1]
        if not self.e.masks:
            return None
        if (key := ("mask", self.e.masks[-1])) not in self.splats:
            self.splats[key] = self.load_slot(self.e.masks[-1], np.dtype(bool))
        return self.splats[key]

    def active(self, condition: str) -> str:
        mask = self.mask()
        return condition if mask is None else self.value(f"and <{self.e.width} x i1> {mask}, {condition}")

    def kept(self, x: str, param: Value) -> str:
        """What a loop carries next: in lanes that have left it, what it was."""
        if not self.e.masks:
            return x
        kind, old = self.e.vector_type(param), self.load_slot(self.e.slots[param], param.dtype)
        return self.value(f"select <{self.e.width} x i1> {self.mask()}, {kind} {x}, {kind} {old}")

    def note(self, some: str, active: str) -> None:
        """Notes whether any lane is active."""
        w = self.e.width
        bits = self.value(f"zext i{w} {self.value(f'bitcast <{w} x i1> {active} to i{w}')} to i32") if w < 32 else self.value(f"bitcast <{w} x i1> {active} to i{w}")
        self.line(f"store i32 {self.value(f'or i32 {bits}, ' + self.value(f'load i32, ptr {some}'))}, ptr {some}")

    # --- slots

    def at_head(self, text: str) -> str:
        name = self.fresh()
        self.head.append(f"  {name} = {text}")
        return name

    def _slot_type(self, dtype: Any) -> str:
        return f"<{self.e.width} x {memory_type(dtype)}>"

    def load_slot(self, slot: str, dtype: Any) -> str:
        """What a slot holds at the beginning of the segment."""
        kind = self._slot_type(dtype)
        address = self.at_head(f"getelementptr {kind}, ptr {slot}, i32 {self.group}")
        x = self.at_head(f"load {kind}, ptr {address}, align {self._align(dtype)}")
        return self.at_head(f"trunc {kind} {x} to <{self.e.width} x i1>") if dtype == bool else x

    def _align(self, dtype: Any) -> int:
        return min(LINE, self.e.width * bytes_of(dtype))

    def store_slot(self, slot: str, dtype: Any, x: str) -> None:
        self.lines, kept = self.last, self.lines
        kind = self._slot_type(dtype)
        x = self.value(f"zext <{self.e.width} x i1> {x} to {kind}") if dtype == bool else x
        address = self.value(f"getelementptr {kind}, ptr {slot}, i32 {self.group}")
        self.line(f"store {kind} {x}, ptr {address}, align {self._align(dtype)}")
        self.lines = kept

    def as_bool(self, x: str) -> str:
        return self.value(f"trunc <{self.e.width} x i8> {x} to <{self.e.width} x i1>")

    # --- vectors

    def splat(self, kind: str, x: str) -> str:
        if not x.startswith("%"):
            return f"splat ({kind} {x})"
        if (kind, x) not in self.splats:
            w = self.e.width
            place = self.value if self.depth else self.at_head
            one = place(f"insertelement <{w} x {kind}> poison, {kind} {x}, i32 0")
            shuffled = place(f"shufflevector <{w} x {kind}> {one}, <{w} x {kind}> poison, <{w} x i32> zeroinitializer")
            if self.depth:
                return shuffled
            self.splats[kind, x] = shuffled
        return self.splats[kind, x]

    def lanes_of(self, x: str) -> list[str]:
        """The numbers of a vector of indices, as 64 bits."""
        if x not in self.elements:
            w = self.e.width
            parts = [self.value(f"extractelement <{w} x i32> {x}, i32 {j}") for j in range(w)]
            self.elements[x] = [self.value(f"zext i32 {part} to i64") for part in parts]
        return self.elements[x]

    def joined(self, kind: str, xs: Sequence[str]) -> str:
        out = "poison"
        for j, x in enumerate(xs):
            out = self.value(f"insertelement <{self.e.width} x {kind}> {out}, {kind} {x}, i32 {j}")
        return out

    # --- memory

    def base(self, buffer: Buffer) -> str:
        """Where the numbers of this group begin: lane after lane, or the first entry's numbers of all its lanes."""
        if buffer not in self.bases:
            start, kind, e = self.e.buffer(buffer), memory_type(buffer.dtype), self.e
            g = self.at_head(f"zext i32 {self.group} to i64")
            per_lane = e.stride(buffer) if self.lane_after_lane(buffer) else 1
            at = self.at_head(f"mul i64 {g}, {e.width * per_lane}")
            if buffer.role != "scratch":
                lane = self.at_head(f"mul i64 {e.first_lane}, {buffer.size}")
                at = self.at_head(f"add i64 {at}, {lane}")
            self.bases[buffer] = self.at_head(f"getelementptr {kind}, ptr {start}, i64 {at}")
        return self.bases[buffer]

    def lane_after_lane(self, buffer: Buffer) -> bool:
        return buffer in self.e.by_index or buffer.role != "scratch"

    def addresses(self, buffer: Buffer, index: Value, vector: str | None = None) -> list[str]:
        """Where each lane finds its entry `index` of a buffer that lies lane after lane, or of a known one."""
        e, kind = self.e, memory_type(buffer.dtype)
        shared = buffer not in e.facts.varying and buffer.role == "scratch"
        base = e.buffer(buffer) if shared else self.base(buffer)
        if vector is not None or e.facts.varies(index):
            at = self.lanes_of(vector or e.vector(index))
        else:
            at = [e.writer.value(f"sext i32 {e.scalar(index)} to i64")] * e.width
        found = []
        for j, i in enumerate(at):
            lane = base if shared or not j else self.value(f"getelementptr {kind}, ptr {base}, i64 {j * e.stride(buffer)}")
            found.append(self.value(f"getelementptr {kind}, ptr {lane}, i64 {i}"))
        return found

    def side_by_side(self, buffer: Buffer, index: Value) -> str:
        """Where the vector of entry `index` lies, of a buffer that lies entry after entry."""
        e, kind = self.e, memory_type(buffer.dtype)
        i = e.writer.value(f"sext i32 {e.scalar(index)} to i64")
        row = e.writer.value(f"mul i64 {i}, {e.lanes}")
        return self.value(f"getelementptr {kind}, ptr {self.base(buffer)}, i64 {row}")

    def load(self, value: Value) -> str:
        buffer, index, kind = value.attr, value.args[0], memory_type(value.dtype)
        if buffer in self.e.facts.varying and not self.lane_after_lane(buffer):
            x = self.value(f"load <{self.e.width} x {kind}>, ptr {self.side_by_side(buffer, index)}, align {self._align(value.dtype)}")
        else:
            x = self.joined(kind, [self.value(f"load {kind}, ptr {address}") for address in self.addresses(buffer, index)])
        return self.as_bool(x) if value.dtype == bool else x

    def load_row(self, value: Value) -> list[str]:
        (buffer, count), kind = value.attr, memory_type(value.dtype)
        addresses = self.addresses(buffer, value.args[0])
        if count == 4 and value.dtype != bool and self.e.width % 4 == 0:
            return self.transposed([self.value(f"load <4 x {kind}>, ptr {address}, align 4") for address in addresses], kind)
        found = []
        for k in range(count):
            at = [self.value(f"getelementptr {kind}, ptr {address}, i64 {k}") for address in addresses]
            x = self.joined(kind, [self.value(f"load {kind}, ptr {address}") for address in at])
            found.append(self.as_bool(x) if value.dtype == bool else x)
        return found

    def transposed(self, rows: list[str], kind: str) -> list[str]:
        """As many rows of four as there are lanes -> four vectors: shuffles within 128 bits, which are quick."""
        w = self.e.width

        def join(parts: list[str], size: int) -> str:
            while len(parts) > 1:
                mask = ", ".join(f"i32 {i}" for i in range(2 * size))
                parts = [
                    self.value(f"shufflevector <{size} x {kind}> {a}, <{size} x {kind}> {b}, <{2 * size} x i32> <{mask}>")
                    for a, b in zip(parts[::2], parts[1::2], strict=True)
                ]
                size *= 2
            return parts[0]

        def mix(a: str, b: str, pick: tuple[int, ...]) -> str:
            at = [(i if i < 4 else i - 4 + w) + 4 * part for part in range(w // 4) for i in pick]
            mask = ", ".join(f"i32 {i}" for i in at)
            return self.value(f"shufflevector <{w} x {kind}> {a}, <{w} x {kind}> {b}, <{w} x i32> <{mask}>")

        a = [join([rows[4 * part + k] for part in range(w // 4)], 4) for k in range(4)]
        low, high = (0, 4, 1, 5), (2, 6, 3, 7)
        t = [mix(a[0], a[1], low), mix(a[2], a[3], low), mix(a[0], a[1], high), mix(a[2], a[3], high)]
        first, second = (0, 1, 4, 5), (2, 3, 6, 7)
        return [mix(t[0], t[1], first), mix(t[0], t[1], second), mix(t[2], t[3], first), mix(t[2], t[3], second)]

    def store(self, value: Value) -> None:
        buffer, (index, x), kind, w = value.attr, self.e.facts.args(value), memory_type(value.dtype), self.e.width
        vector, mask = self.e.vector(x), self.mask()
        if value.dtype == bool:
            vector = self.value(f"zext <{w} x i1> {vector} to <{w} x i8>")
        if not self.lane_after_lane(buffer):
            address, align = self.side_by_side(buffer, index), self._align(value.dtype)
            if mask is not None:
                old = self.value(f"load <{w} x {kind}>, ptr {address}, align {align}")
                vector = self.value(f"select <{w} x i1> {mask}, <{w} x {kind}> {vector}, <{w} x {kind}> {old}")
            self.line(f"store <{w} x {kind}> {vector}, ptr {address}, align {align}")
            return
        to = None
        if mask is not None:
            to = self.value(f"select <{w} x i1> {mask}, <{w} x i32> {self.e.vector(index)}, <{w} x i32> splat (i32 {buffer.size})")
        for j, address in enumerate(self.addresses(buffer, index, to)):
            element = self.value(f"extractelement <{w} x {kind}> {vector}, i32 {j}")
            self.line(f"store {kind} {element}, ptr {address}")


def bytes_of(dtype: Any) -> int:
    return 1 if dtype == bool else np.dtype(dtype).itemsize


def memory_type(dtype: Any) -> str:
    return "i8" if dtype == bool else TYPES[np.dtype(dtype).name]


def literal(number: Any) -> str:
    if number.dtype == bool:
        return "true" if number else "false"
    if number.dtype == np.float32:  # LLVM writes a float as the double that is equal to it
        return f"0x{np.float64(number).view(np.uint64):016X}"
    return str(int(number))


# --- single operations ------------------------------------------------------------------------------------------

DECLARATIONS: set[str] = {f"declare void @llvm.x86.sse.{name}mxcsr(ptr)" for name in ("st", "ld")}


def operation(w: Writer, facts: Facts, value: Value, args: list[str], types: list[str], kind: str, width: int, fused: Any) -> str:
    """One operation of `scalars`, for one number (`width` 0) or a vector."""
    name, x = value.op, value.args[-1].dtype
    f, signed = x.kind == "f", x.kind == "i"

    def intrinsic(name: str, *given: str, kind: str = kind) -> str:
        suffix = ("v%d" % width if width else "") + {"float": "f32", "i32": "i32"}[kind.split()[-1].rstrip(">")]
        DECLARATIONS.add(f"declare {kind} @llvm.{name}.{suffix}({', '.join([kind] * len(given))})")
        return w.value(f"call {kind} @llvm.{name}.{suffix}({', '.join(f'{kind} {x}' for x in given)})")

    both = f"{types[0]} {args[0]}, {args[1]}" if len(args) > 1 else ""
    if fused is not None:
        k, (a, b) = fused
        c = args[1 - k]
        if name == "sub":
            a, c = (a, w.value(f"fneg {kind} {c}")) if k == 0 else (w.value(f"fneg {kind} {a}"), c)
        return intrinsic("fma", a, b, c)
    if name in ("add", "sub", "mul"):
        return w.value(f"{'f' if f else ''}{name} {both}")
    if name == "neg":
        return w.value(f"fneg {kind} {args[0]}") if f else w.value(f"sub {kind} {zero(kind)}, {args[0]}")
    if name in ("and", "or", "xor"):
        return w.value(f"{name} {both}")
    if name == "not":
        return w.value(f"xor {kind} {args[0]}, {ones(kind)}")
    if name in ("div", "rem"):
        if f:
            return w.value(f"f{name} {both}")
        return _divided(w, facts, value, args, kind, width)
    if name.startswith("shift"):
        return _shift(w, facts, value, args, types, width)
    if name in COMPARE:
        if f:
            return w.value(f"fcmp {'u' if name == 'ne' else 'o'}{COMPARE[name]} {both}")
        sign = "" if name in ("eq", "ne") else "s" if signed else "u"
        return w.value(f"icmp {sign}{COMPARE[name]} {both}")
    if name in ("max", "min"):
        if f:
            return intrinsic("maximum" if name == "max" else "minimum", *args)
        (low, high), (other_low, other_high) = (facts.bounds(v) for v in value.args)
        if name == "min" and high <= other_low or name == "max" and low >= other_high:
            return args[0]  # it is in range: nothing is to be clamped
        return intrinsic(("s" if signed else "u") + name, *args)
    if name == "select":
        which, no, yes = args
        return w.value(f"select {types[0]} {which}, {kind} {yes}, {kind} {no}")
    if name == "bitcast":
        return w.value(f"bitcast {types[0]} {args[0]} to {kind}") if types[0] != kind else args[0]
    if name == "convert":
        return _convert(w, value, args[0], types[0], kind, width)
    if name == "sign" and not f:
        more = w.value(f"icmp sgt {both or f'{kind} {args[0]}, {zero(kind)}'}")
        less = w.value(f"icmp slt {kind} {args[0]}, {zero(kind)}")
        more, less = (w.value(f"zext {_bool(width)} {z} to {kind}") for z in (more, less))
        return w.value(f"sub {kind} {more}, {less}")
    if name == "pow":
        return intrinsic("pow", *args)
    if name == "is_finite":
        size = intrinsic("fabs", args[0], kind=types[0])
        return w.value(f"fcmp one {types[0]} {size}, {'splat (float 0x7FF0000000000000)' if width else '0x7FF0000000000000'}")
    if name == "abs":
        return w.value(f"call {kind} @llvm.abs.{'v%d' % width if width else ''}i32({kind} {args[0]}, i1 false)") if not f else intrinsic("fabs", *args)
    if name in ("sqrt", "floor", "ceil") or name == "abs" and f:
        return intrinsic("fabs" if name == "abs" else name, *args)
    raise Unsupported(f"the operation {name}")


def _shift(w: Writer, facts: Facts, value: Value, args: list[str], types: list[str], width: int) -> str:
    """A shift; LLVM leaves open what one by the width or more gives, so where that may be, it is asked."""
    name = {"shift_left": "shl", "shift_right_logical": "lshr", "shift_right_arithmetic": "ashr"}[value.op]
    (low, high), bits, kind = facts.bounds(value.args[1]), 8 * bytes_of(value.dtype), types[0]
    if 0 <= low and high < bits:
        return w.value(f"{name} {kind} {args[0]}, {args[1]}")
    constant = lambda n: f"splat ({TYPES[value.dtype.name]} {n})" if width else str(n)
    inside = w.value(f"icmp ult {kind} {args[1]}, {constant(bits)}")
    by = w.value(f"select {_bool(width)} {inside}, {kind} {args[1]}, {kind} {constant(bits - 1)}")
    shifted = w.value(f"{name} {kind} {args[0]}, {by}")
    if name == "ashr":
        return shifted
    return w.value(f"select {_bool(width)} {inside}, {kind} {shifted}, {kind} {zero(kind)}")


def _divided(w: Writer, facts: Facts, value: Value, args: list[str], kind: str, width: int) -> str:
    """A quotient or remainder of whole numbers; a processor stops at a divisor 0, and at the least number by -1."""
    signed, (low, high) = value.dtype.kind == "i", facts.bounds(value.args[1])
    name = f"{'s' if signed else 'u'}{value.op}"
    if low > 0 or high < (-1 if signed else 0):
        return w.value(f"{name} {kind} {args[0]}, {args[1]}")
    constant = lambda n: f"splat ({TYPES[value.dtype.name]} {n})" if width else str(n)
    unsafe = is_zero = w.value(f"icmp eq {kind} {args[1]}, {constant(0)}")
    if signed:
        by_minus_one = w.value(f"icmp eq {kind} {args[1]}, {constant(-1)}")
        least = w.value(f"icmp eq {kind} {args[0]}, {constant(np.iinfo(value.dtype).min)}")
        overflows = w.value(f"and {_bool(width)} {by_minus_one}, {least}")
        unsafe = w.value(f"or {_bool(width)} {is_zero}, {overflows}")
    divisor = w.value(f"select {_bool(width)} {unsafe}, {kind} {constant(1)}, {kind} {args[1]}")
    found = w.value(f"{name} {kind} {args[0]}, {divisor}")
    by_zero = constant(-1) if value.op == "div" else args[0]
    return w.value(f"select {_bool(width)} {is_zero}, {kind} {by_zero}, {kind} {found}")


def _bool(width: int) -> str:
    return f"<{width} x i1>" if width else "i1"


def zero(kind: str) -> str:
    return "zeroinitializer" if kind.startswith("<") else "0.0" if kind == "float" else "0"


def ones(kind: str) -> str:
    element = kind.split()[-1].rstrip(">")
    one = "true" if element == "i1" else "-1"
    return f"splat ({element} {one})" if kind.startswith("<") else one


def _convert(w: Writer, value: Value, x: str, kind: str, to: str, width: int) -> str:
    before, after = value.args[0].dtype, value.dtype
    if kind == to and before != bool:
        return x
    if after == bool:
        return w.value(f"fcmp une {kind} {x}, {zero(kind)}" if before.kind == "f" else f"icmp ne {kind} {x}, {zero(kind)}")
    if before == bool:
        return w.value(f"{'uitofp' if after.kind == 'f' else 'zext'} {kind} {x} to {to}")
    if after.kind == "f":
        return w.value(f"{'s' if before.kind == 'i' else 'u'}itofp {kind} {x} to {to}")
    name = f"fpto{'s' if after.kind == 'i' else 'u'}i.sat.{'v%d' % width if width else ''}i32.{'v%d' % width if width else ''}f32"
    DECLARATIONS.add(f"declare {to} @llvm.{name}({kind})")
    return w.value(f"call {to} @llvm.{name}({kind} {x})")
