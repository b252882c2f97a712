"""Environments of other libraries here, and ours there: gymnax and Gymnasium, both ways.

    rl.interop.from_gymnax("FrozenLake-misc")       rl.interop.to_gymnax(env)
    rl.interop.from_gymnasium("Taxi-v4")            rl.interop.to_gymnasium(env)
    rl.interop.make("gymnasium:FrozenLake-v1")      either, by a name with a prefix
    gymnasium.make("jaxrl_tab.interop.gymnasium:jaxrl_tab/WindyGridworld-v0", moves="king")

Each library is imported when it is asked for: `import gymnax` takes seconds and starts JAX, so `use_all_cores`
comes before it.
"""

import functools
import importlib
from typing import TYPE_CHECKING, Any

from jaxrl_tab.core import names
from jaxrl_tab.core.errors import InputError, reason, shown
from jaxrl_tab.envs import ENVIRONMENT

if TYPE_CHECKING:
    from jaxrl_tab.interop.gymnasium import from_gymnasium, to_gymnasium
    from jaxrl_tab.interop.gymnax import from_gymnax, to_gymnax

__all__ = ["from_gymnasium", "from_gymnax", "make", "to_gymnasium", "to_gymnax"]

# What pip installs of each: gymnax imports six, and does not declare it.
LIBRARIES = {"gymnasium": "gymnasium", "gymnax": "gymnax six"}


def make(name: str, **parameters: Any) -> Any:
    """An environment of another library, by a name that says which: "gymnasium:Taxi-v4".

    Args:
        name: the library, a colon, and the environment's name there.
        parameters: what the library's own `make` takes.

    Raises:
        InputError: the name is of no such form, the library cannot be imported, or it is as `from_gymnax` and
            `from_gymnasium` say.
    """
    library, _, of_library = str(name).partition(":")
    if library not in LIBRARIES or not of_library:
        raise InputError(f"{shown(name)} is not of the form gymnasium:NAME or gymnax:NAME")
    return __getattr__(f"from_{library}")(of_library, **parameters)


def __getattr__(name: str) -> Any:
    library = name.partition("_")[2]
    if name not in __all__ or library not in LIBRARIES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_module(library), name)


def _module(library: str) -> Any:
    """The module here that is about a library."""
    try:
        return importlib.import_module(f"{__name__}.{library}")
    except Exception as error:  # of gymnax, a version that is too old for JAX raises an AttributeError
        raise InputError(
            f"{library} cannot be imported ({reason(error)}); python -m pip install --upgrade {LIBRARIES[library]}"
        ) from None


def _class_of(library: str, name: str) -> type:
    """The class of an environment of a library, with the keyword arguments that it has there as parameters."""
    module = _module(library)
    make = functools.partial(module.by_name, name)
    return names.made_by(make, name, module.arguments(name), f"{name} of {library}.")


ENVIRONMENT.libraries.update((library, functools.partial(_class_of, library)) for library in LIBRARIES)
