"""The lane compiler: the jaxpr of one run becomes machine code in which every number is a vector over lanes.

It knows nothing of reinforcement learning. A jaxpr goes through three rooms: it is lowered to scalar code, the
program of one lane; facts about that are gathered; and LLVM's language is written from both.

Scalar code:

    code        values, loops, memory, and the builder that writes them
    scalars     the operations on single numbers, and what they mean at the edges
    functions   exp, log and others, in terms of these operations

From a jaxpr to scalar code:

    arrays      what an array of the jaxpr is meanwhile
    registry    which rule stands for which primitive
    lowering    calls, memory and loops
    rules       what each primitive means
    reciprocals quotients by what is the same in all lanes
    outside     what is left to XLA
    lower       all of it

From scalar code to machine code:

    analysis    what is used, what differs from lane to lane, in which range a number lies
    types       how numbers are written in LLVM's language
    text        lines of LLVM's language
    vectors     vectors of lanes, slots and memory
    operations  the operations, for one number or a vector
    layout      where arrays lie
    names       what values are called
    segment     code that is done for one group of lanes after another
    target      the processor
    machine     from LLVM's language to a function that can be called
    emit        all of it

What can be kept and called:

    calls       what a program calls and XLA compiles
    program     compiled programs, as plain data
    kernel      a program that can be called
"""
