"""From scalar code to LLVM's language, in which each number is a vector over lanes.

A kernel works through blocks of lanes. Loops that all lanes leave together are loops of the kernel; what stands
between two such loops is a *segment*: straight code that is done for one group of lanes after another, so that a
processor that looks ahead works on several at once. Values that one segment hands to another, or a loop to its next
turn, wait in slots. What is the same in all lanes is one number, worked out beside the segments.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxrl_tab.lanes.ahead import Ahead
from jaxrl_tab.lanes.analysis import Facts
from jaxrl_tab.lanes.code import Outside, Region, Unsupported, Value
from jaxrl_tab.lanes.layout import Layout
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.names import Names
from jaxrl_tab.lanes.segment import Segment, going_on, uniform, uniform_address
from jaxrl_tab.lanes.target import Target
from jaxrl_tab.lanes.text import Function
from jaxrl_tab.lanes.types import in_memory, type_of

AT_ONCE = (
    600  # a loop that lanes leave one by one is done group by group where it has at most so many operations
)
PARAMETERS = "i64 %first, i64 %last, ptr noalias %scratch, ptr %arrays, ptr %tables, ptr %stop, ptr %outside"


class Emitted(NamedTuple):
    """A kernel in LLVM's language: a function of `PARAMETERS`.

    It does the blocks from `first` to before `last`; `arrays` are the caller's, each with a leading axis of lanes;
    `tables` the arrays that are known; where the byte at `stop` is not 0 it ends soon; `outside` is called
    for what is not compiled, with the number of what is to be done, and the addresses of its arrays.

    Attributes:
        text: the code.
        lanes: of a block.
        scratch: the bytes with which a thread works.
        tables: the arrays that are known.
    """

    text: str
    lanes: int
    scratch: int
    tables: list[np.ndarray]


def emit(code: Lowering, facts: Facts, target: Target, width: int, groups: int) -> Emitted:
    """Writes the kernel of a program of one lane: `groups` of `width` lanes are a block.

    Raises:
        Unsupported: it holds something for which there is no rule.
    """
    emitter = _Emitter(code, facts, target, width, groups)
    text, layout = emitter.kernel(), emitter.layout
    tables = [b.known for b in layout.tables if b.known is not None]
    return Emitted(text, layout.lanes, layout.scratch, tables)


class _Emitter:
    def __init__(self, code: Lowering, facts: Facts, target: Target, width: int, groups: int):
        self.code, self.facts, self.target = code, facts, target
        self.function = Function("kernel", PARAMETERS)
        self.layout = Layout(self.function, facts, code.region, width, groups)
        self.names = Names(facts, self.layout, target)
        self.segment: Segment | None = None
        self.around: list[str] = []  # slots that say which lanes are still in the long loops around

    def kernel(self) -> str:
        f = self.function
        self.layout.set_arguments([*self.code.inputs, *self.code.outputs])
        control = self.target.flush_subnormals(f)
        blocks, body, after = f.label("blocks"), f.label("block"), f.label("after")
        block, before = f.fresh("block"), f.block
        f.line(f"br label %{blocks}")
        f.begin(blocks)
        f.line(f"{block} = phi i64 [ %first, %{before} ], [ {block}.next, %{body}.end ]")
        more = f.value(f"icmp ult i64 {block}, %last")
        f.line(f"br i1 {going_on(f, more)}, label %{body}, label %{after}")
        f.begin(body)
        self.layout.first_lane = f.value(f"mul i64 {block}, {self.layout.lanes}")
        self.region(self.code.region)
        self.close()
        f.line(f"br label %{body}.end")
        f.begin(f"{body}.end")
        f.line(f"{block}.next = add i64 {block}, 1")
        f.line(f"br label %{blocks}")
        f.begin(after)
        self.target.restore(f, control)
        f.line("ret void")
        return f.text()

    # --- regions and loops

    def region(self, region: Region, ahead: Ahead | None = None) -> None:
        """The operations of a region that no lane leaves before the others, or only by the masks around."""
        for value in region.ops:
            if value not in self.facts.live or value.op in ("result", "const"):
                continue
            if ahead is not None and value in ahead.values:
                ahead.read(value)
            elif value.op == "outside":
                self.outside(value.attr)
            elif value.op == "loop":
                if not self.facts.varies(value):
                    self.loop(value)
                elif self.facts.size(value.attr) <= AT_ONCE:
                    self.here().write(value)
                else:
                    self.masked_loop(value)
            elif self.facts.varies(value):
                self.here().write(value)
            elif value.op == "store":
                self.close()
                self.uniform_store(value)
            else:
                self.names.scalars[value] = uniform(self.names, self.function, value)

    def loop(self, value: Value) -> None:
        """A loop that all lanes leave together."""
        f, loop = self.function, value.attr
        params, results = loop.body.params, loop.body.results
        carried = self.facts.carried(value)
        varying = [k for k in carried if self.facts.varies(params[k])]
        uniform = [k for k in carried if k not in varying]
        self.names.slots |= {params[k]: self.names.slot(params[k].dtype) for k in varying}
        self.fill(params, value.args, varying)
        self.close()
        first = [self.names.scalar(value.args[k]) for k in uniform]
        ahead = Ahead(self.names, f, value)
        ahead.before()
        head, body, end, after = (f.label(name) for name in ("head", "body", "end", "done"))
        before = f.block
        f.line(f"br label %{head}")
        f.begin(head)
        names = {k: f.fresh("c") for k in uniform}
        for k, x in zip(uniform, first, strict=True):
            kind = type_of(params[k].dtype)
            f.line(f"{names[k]} = phi {kind} [ {x}, %{before} ], [ {names[k]}.next, %{end} ]")
            self.names.scalars[params[k]] = names[k]
        if ahead.values:
            f.line(f"{ahead.turn} = phi i32 [ 0, %{before} ], [ {ahead.turn}.next, %{end} ]")
        self.region(loop.condition)
        self.close()
        condition = self.names.scalar(loop.condition.results[0])
        if any(x.op == "loop" for x in loop.body.ops) or not self.facts.ends_soon(value):
            condition = going_on(f, condition)
        f.line(f"br i1 {condition}, label %{body}, label %{after}")
        f.begin(body)
        ahead.begin()
        self.region(loop.body, ahead)
        self.fill(params, results, varying)
        self.close()
        f.line(f"br label %{end}")
        f.begin(end)
        for k in uniform:  # a new name for what may be a literal or an older name
            kind, x = type_of(params[k].dtype), self.names.scalar(results[k])
            f.line(f"{names[k]}.next = select i1 true, {kind} {x}, {kind} {x}")
        if ahead.values:
            f.line(f"{ahead.turn}.next = add i32 {ahead.turn}, 1")
        f.line(f"br label %{head}")
        f.begin(after)

    def masked_loop(self, value: Value) -> None:
        """A long loop that lanes leave one by one: it goes on until all lanes of the block have left it."""
        f, loop = self.function, value.attr
        carried = self.facts.carried(value)
        self.names.slots |= {loop.body.params[k]: self.names.slot(loop.body.params[k].dtype) for k in carried}
        self.fill(loop.body.params, value.args, carried)
        self.close()
        mask, some = self.names.slot(bool), f.entry("alloca i1")
        head, body, after = f.label("head"), f.label("body"), f.label("done")
        f.line(f"br label %{head}")
        f.begin(head)
        f.line(f"store i1 false, ptr {some}")
        self.region(loop.condition)
        segment = self.here()
        active = segment.active(segment.vector(loop.condition.results[0]))
        segment.store_slot(mask, np.dtype(bool), active)
        segment.note(some, active)
        self.close()
        f.line(f"br i1 {going_on(f, f.value(f'load i1, ptr {some}'))}, label %{body}, label %{after}")
        f.begin(body)
        self.around.append(mask)
        self.region(loop.body)
        self.fill(loop.body.params, loop.body.results, carried)
        self.close()
        self.around.pop()
        f.line(f"br label %{head}")
        f.begin(after)

    def fill(self, params: Sequence[Value], values: Sequence[Value], places: Sequence[int]) -> None:
        """Puts values into the slots of what a loop carries: all are read before one is written."""
        if not places:
            return
        segment = self.here()
        new = [segment.kept(segment.vector(values[k]), params[k]) for k in places]
        for k, x in zip(places, new, strict=True):
            segment.store_slot(self.names.slots[params[k]], params[k].dtype, x)

    # --- segments, and what stands between them

    def here(self) -> Segment:
        """The segment that is being written."""
        if self.segment is None:
            self.segment = Segment(self.names, self.around[-1] if self.around else None)
        return self.segment

    def close(self) -> None:
        if self.segment is not None:
            self.segment.finish()
            self.segment = None

    def uniform_store(self, value: Value) -> None:
        f, kind = self.function, in_memory(value.dtype)
        index, x = value.args[0], self.names.scalar(value.args[1])
        address = uniform_address(self.names, f, value.attr, index)
        x = f.value(f"zext i1 {x} to i8") if value.dtype == bool else x
        f.line(f"store {kind} {x}, ptr {address}")

    def outside(self, outside: Outside) -> None:
        """Calls what is not compiled."""
        if self.around:
            raise Unsupported("a call in a loop that lanes leave one by one")
        self.close()
        f, buffers = self.function, [*outside.inputs, *outside.outputs]
        addresses = f.entry(f"alloca [{max(len(buffers), 1)} x ptr]")
        for k, buffer in enumerate(buffers):
            at = f.value(f"getelementptr ptr, ptr {addresses}, i32 {k}")
            f.line(f"store ptr {self.layout.place(buffer)}, ptr {at}")
        f.line(f"call void %outside(i64 {outside.number}, ptr {addresses})")
