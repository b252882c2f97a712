"""How much of the machine there is to use: what needs no other module, and no JAX."""

import os


def cores() -> int:
    """How many cores this process may use."""
    allowed = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))  # Linux alone has it
    return len(allowed(0))
