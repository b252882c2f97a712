"""Our side on the XLA backend, in a process of its own, so that the choice is made before anything else."""

import os
from typing import Any

from benchmarks.rounds import Round


def windy(**work: Any) -> Round:
    """As `ours.windy`."""
    os.environ["JAXRL_TAB_BACKEND"] = "xla"
    from benchmarks import ours

    return ours.windy(**work)
