"""The versions of JAX that are known here: how a jaxpr is written, and which steps XLA's functions take.

Both are JAX's own affair, and change. What is compiled from a jaxpr that is written otherwise must not be nonsense, and
what is no defect of this package must not look like one. So under a JAX that is newer than all that were tested, what
cannot be read is left to XLA, and one line says why.
"""

import jax
import jaxlib.version

JAX, JAXLIB = (x.__version_info__[:2] for x in (jax, jaxlib.version))
NEWEST = (0, 12)  # that the tests were run with


def newer() -> str:
    """That JAX is newer than all that were tested, in words; nothing where it is not."""
    if JAX <= NEWEST:
        return ""
    return f"JAX {jax.__version__} is newer than {'.'.join(map(str, NEWEST))}, the newest known here"
