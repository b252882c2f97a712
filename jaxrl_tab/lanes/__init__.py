"""The lane compiler: the jaxpr of one run becomes machine code in which every number is a vector over lanes.

It knows nothing of reinforcement learning. A jaxpr goes through three rooms: it is lowered to scalar code, the
program of one lane; facts about that are gathered; and LLVM IR is written from both. `program.compile` walks through
all of them. docs/performance.md follows one program, stage by stage.

What is lowered to, from single numbers up:

Scalar code:

    code        values, loops, memory, and the builder that writes them
    scalars     the operations on single numbers, and what they mean at the edges
    functions   exp, log and others, in terms of these operations
    versions    of JAX, on which some of that depends
    arrays      what an array of the jaxpr is while it is lowered: known, taken apart, in memory, or a rule

From a jaxpr to scalar code:

    registry    which rule stands for which primitive
    rules       what each primitive means
    reciprocals quotients by what is the same in all lanes
    choices     choices between sums, or products, with an operand in common
    lowering    the program of one lane, while it is written: calls, memory and loops
    lower       the program of one lane, from a jaxpr
    outside     what is left to XLA, as a function says it
    calls       what is left to XLA, as it is called for all lanes at once

From scalar code to LLVM's language:

    analysis    what is used, what differs from lane to lane, in which range a number lies
    types       how LLVM writes types and numbers
    text        lines, and the names in them
    target      the processor for which code is made
    layout      where the arrays of a block of lanes lie in memory
    vectors     code for the lanes of a group: from memory to vectors, and back
    operations  how each operation of `scalars` is written, for a vector
    names       under which name each value is known, and the slots in which it waits
    segment     straight code for a group, with loops in it that lanes leave one by one
    ahead       what a loop of one lane alone works out before it is wanted
    emit        a kernel: loops that all lanes leave together, and the segments between them

And to a function that can be called:

    machine     LLVM's language -> object code -> a function, by llvmlite
    program     what is compiled, as plain bytes that can be kept; how wide it is
    kernel      a program, loaded

How to add a primitive
----------------------

Nearly always it is one function in `rules`: in `numbers` if it works number by number, in `places` if it puts numbers
elsewhere, in `indexing` if it reads or writes at an index, in `sums` if it goes along an axis. A rule is given the
code that is written, the equation of the jaxpr, and its arguments as `arrays`; it says which number of the result
comes from which numbers of the arguments. Take `clamp`, which works number by number:

        @rule("clamp")
        def clamp(code: Lowering, equation: Any, least: Plain, x: Plain, most: Plain) -> Plain:
            def write(low: Value, v: Value, high: Value) -> Value:
                return code.op("min", v.dtype, code.op("max", v.dtype, low, v), high)

            return each_number(code, equation, write, (least, x, most))

`code.op` writes an operation of `scalars` on single numbers. `each_number` does the rest: it stretches what is one
number, takes small arrays apart, and makes of large ones a rule that gives the number at an index. Whoever writes
`write` thinks of one number of one lane, and of no vector.

And `rev`, which puts numbers elsewhere: `moved` is told how NumPy does it, for arrays whose places are known, and
where the number at an index comes from, for all others:

        @rule("rev")
        def reverse(code: Lowering, equation: Any, x: Plain) -> Plain:
            axes = equation.params["dimensions"]

            def at(index: list[Value]) -> list[Value]:
                last = [code.const(n - 1, np.int32) for n in x.shape]
                turned = [code.op("sub", np.int32, n, i) for n, i in zip(last, index, strict=True)]
                return [turned[axis] if axis in axes else i for axis, i in enumerate(index)]

            return moved(code, x.shape, x, lambda y: np.flip(y, axes), at)

Then a case in tests/test_lanes_rules.py, under the name of the primitive: the test runs it by lanes and by XLA, at the
edges, too, and wants the same bits. What XLA does at an edge stands in its HLO semantics; where that leaves it open,
the test says what it does. If the primitive needs an operation that `scalars` does not have, that is an entry there
(what it means, in NumPy, by which constants are folded), a writer in `operations` (how LLVM writes it), and, for
whole numbers, perhaps a range in `analysis`.

Three things to know. An index that comes from the jaxpr is never trusted: `indexing.clamped`. An array in memory is
changed in what `code.to_change(x)` gives, which copies it where somebody still needs the old content; a new one is
`code.empty`. And where a primitive cannot be done, raise `Unsupported` with the reason: XLA then compiles the program,
and the user reads it.
"""
