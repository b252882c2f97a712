"""Tabular reinforcement-learning control in JAX: whole sweeps in one program, beside the exact optimum.

    import jaxrl_tab as rl

    env = rl.make("windy-gridworld")
    result = rl.sweep(env, rl.Sarsa, {"alpha": [0.1, 0.5]}, num_seeds=200, num_steps=8000)
    result.to_xarray()

Importing the package asks XLA for faster loops, as long as JAX has not started: see `core.flags`. What is in it is
imported, with JAX, when the first of it is used (see `api`); so the command line can say what is wrong before.
"""

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

from jaxrl_tab.core import flags

_API = f"{__name__}.api"

if TYPE_CHECKING:
    from jaxrl_tab.api import *  # noqa: F403
    from jaxrl_tab.core.version import __version__ as __version__

flags.set_flags()


def __getattr__(name: str) -> Any:
    module = f"{__name__}.{name}"
    if name == "__version__":
        value = importlib.import_module(f"{__name__}.core.version").__version__
    elif name.startswith("__") and name != "__all__":  # what Python and its tools ask every module for
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    elif importlib.util.find_spec(module):  # `from jaxrl_tab import stats` must not import everything
        value = importlib.import_module(module)
    else:
        value = getattr(importlib.import_module(_API), name)
    globals()[name] = value  # found at once from now on
    return value


def __dir__() -> list[str]:
    return dir(importlib.import_module(_API))
