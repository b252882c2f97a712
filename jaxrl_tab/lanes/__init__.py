"""The lane compiler: the jaxpr of one run becomes machine code in which every number is a vector over lanes.

It knows nothing of reinforcement learning. A jaxpr goes through three rooms:

    lower       jaxpr -> scalar code: arrays become scalars or memory, loops stay loops (`rules`, one a primitive)
    analysis    what is used, what differs from lane to lane, in which range a number lies
    emit        scalar code -> LLVM IR, each number a vector over the lanes that go side by side
"""
