"""The lane compiler: the jaxpr of one run becomes machine code in which every number is a vector over lanes.

It knows nothing of reinforcement learning. A jaxpr goes through three rooms: it is lowered to scalar code, the
program of one lane; facts about that are gathered; and LLVM IR is written from both.

    code        scalar code: values, loops, memory, and the builder that writes them
    scalars     the operations on single numbers, and what they mean at the edges
    functions   exp, log and others, in terms of these operations
    arrays      what an array of the jaxpr is while it is lowered
    registry    which rule stands for which primitive
    lowering    the program of one lane, while it is written: calls, memory and loops
    rules       what each primitive means
    lower       the program of one lane, from a jaxpr
    analysis    what is used, what differs from lane to lane, in which range a number lies
    emit        scalar code -> LLVM IR
    kernel      LLVM IR -> a function that can be called
"""
