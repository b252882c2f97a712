"""What XLA is asked for before JAX starts."""

import os
import sys
import warnings

_THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"


def set_flags() -> None:
    """Asks XLA for one kernel per loop, unless the environment already says something about it."""
    flags = os.environ.get("XLA_FLAGS", "")
    if os.environ.get("JAXRL_TAB_XLA") == "0" or _THRESHOLD in flags:
        return
    if "jax" in sys.modules and _started():
        warnings.warn(
            "JAX had computed something before jaxrl_tab was imported, so its loops run several times slower "
            "(the results are the same): import jaxrl_tab first",
            stacklevel=2,
        )
    else:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={_THRESHOLD}={2**24}".strip()


def _started() -> bool:
    """Whether JAX's backend runs, so that flags come too late: it then refuses another number of devices."""
    import jax

    chosen = jax.config.jax_num_cpu_devices  # pyright: ignore[reportAttributeAccessIssue]
    try:
        jax.config.update("jax_num_cpu_devices", max(chosen, 0) + 1)
        jax.config.update("jax_num_cpu_devices", chosen)
    except RuntimeError:
        return True
    return False
