"""Strict numerics, two devices, one compilation cache: set before JAX starts."""

import os
import signal
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["JAXRL_TAB_TRACEBACK"] = "1"  # no defect hides behind the one line that is said of it
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).parent.parent / ".pytest_cache")  # what the command keeps

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what the tests start must hear Ctrl-C

import jax

jax.config.update("jax_num_cpu_devices", 2)  # whatever the machine has: results must not depend on it

import annotations  # of the tests
import pytest

annotations.check()

from exploring import explored  # noqa: F401  A fixture of several files.
from keeping import programs_folder, said  # noqa: F401  Fixtures of several files.

import jaxrl_tab as rl

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_debug_key_reuse", False)
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parent.parent / ".pytest_cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


@pytest.fixture(scope="session")
def windy():
    return rl.make("windy-gridworld")
