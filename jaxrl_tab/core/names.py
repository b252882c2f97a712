"""What the name of an environment, a method or a recorder stands for: something built in, or somebody's own.

Wherever one is named (in Python, on the command line, in a file), it may be

    sarsa                      a name of a registry: built in, registered, or an entry point of a package
    path/to/mine.py:Mine       a class, or a function that records, in a file: see `core.modules`
    package.module:Mine        the same in a module that can be imported
    gymnasium:FrozenLake-v1    an environment of another library
    finite-horizon:20:chain    an environment that ends after so many steps, whatever is named at the end
    mdp.npz                    a table that `FiniteMDP.save` wrote
    tiger.POMDP                a file in Cassandra's format, also .MDP
"""

import dataclasses
import functools
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from jaxrl_tab.core import describe, modules
from jaxrl_tab.core.errors import InputError, nearest, shown
from jaxrl_tab.core.modules import PACKAGE, File

_IN_MODULE = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
_REGISTERED = re.compile(r"\w[\w.-]*")
OWN_FILE = "put it into a file of its own, and name it 'file.py:NAME'"


class Reference(NamedTuple):
    """What a name stands for.

    Attributes:
        name: how it is recorded, so that it can be found again.
        cls: the class that is built with its parameters; of a recorder, the function.
        label: what it is called in tables and pictures.
        file: the file that it is in; None where it is built in, or of another library.
        refusal: why it cannot be recorded in a folder; empty where it can.
    """

    name: str
    cls: Any
    label: str
    file: File | None = None
    refusal: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Kind:
    """What can be named: environments, or methods.

    Attributes:
        noun: what one of them is called, with its article.
        registry: the classes that are known by a name.
        group: the entry points by which packages register theirs.
        needs: the attributes that a class of this kind has.
        add: puts a class into the registry.
        hint: what a message suggests in place of an unknown name.
        libraries: prefix of a name -> the class of what another library has under the rest of it.
        around: prefix of a name -> what the rest of it stands for, where that names another one, which the function
            that is given with it finds.
        table: the class of what is in the file of a table; None where there are no such files.
    """

    noun: str
    registry: Mapping[str, type]
    group: str
    needs: tuple[str, ...]
    add: Callable[[str, type], None]
    hint: Callable[[Any], str]
    libraries: dict[str, Callable[[str], type]] = dataclasses.field(default_factory=dict)
    around: dict[str, Callable[[str, Callable[[str], Reference]], Reference]] = dataclasses.field(
        default_factory=dict
    )
    table: Callable[[File], type] | None = None

    def __post_init__(self):
        KINDS.append(self)

    def lacks(self, cls: Any) -> list[str]:
        """The attributes that `cls` would need to be of this kind, and does not have."""
        fields = getattr(cls, "__dataclass_fields__", {})
        return [name for name in self.needs if not hasattr(cls, name) and name not in fields]

    def check(self, what: str, cls: Any) -> None:
        """Raises InputError, which calls it `what`, unless `cls` is a class of this kind."""
        if not isinstance(cls, type):
            raise InputError(f"{what} is not a class")
        if missing := self.lacks(cls):
            other = [f"; it is {kind.noun}" for kind in KINDS if kind is not self and not kind.lacks(cls)]
            raise InputError(f"{what} is not {self.noun}: it has no {', '.join(missing)}{''.join(other)}")
        if not dataclasses.is_dataclass(cls):
            raise InputError(f"{what} is not a JAX pytree: decorate the class with jaxrl_tab.pytree")


class Functions(Kind):
    """What is named is a function and no class. None of them is built in, and none can be registered."""

    def __init__(self, noun: str, hint: str):
        super().__init__(noun, registry={}, group="", needs=(), add={}.__setitem__, hint=lambda _: hint)

    def __post_init__(self):
        pass  # it is not one of KINDS

    def check(self, what: str, cls: Any) -> None:
        if not callable(cls) or isinstance(cls, type):
            raise InputError(f"{what} is not a function")


KINDS: list[Kind] = []
_here: dict[tuple[str, str | None], Reference] = {}  # those made in this process, by (name, checksum)


def register(name: str, cls: type) -> None:
    """Makes a method or an environment known by a name, in this process: `register("mine", Mine)`.

    Raises:
        InputError: the name is taken, or cannot be one; or the class is neither a method nor an environment.
    """
    if not isinstance(name, str) or not _REGISTERED.fullmatch(name):
        raise InputError(
            f"a name has letters, digits, hyphens and dots, such as 'my-method', not {shown(name)}"
        )
    if any(name in kind.registry for kind in KINDS):
        raise InputError(f"the name {name!r} is taken; choose another one")
    what = cls.__name__ if isinstance(cls, type) else shown(cls)
    kind = min(KINDS, key=lambda kind: len(kind.lacks(cls)))
    kind.check(what, cls)
    kind.add(name, cls)


def find(kind: Kind, name: Any, base: Path | None = None, sha256: str | None = None) -> Reference:
    """What a name stands for.

    Args:
        kind: what it names.
        name: one of the forms above, or the class or the function itself.
        base: the folder from which paths start; by default that of the process.
        sha256: the checksum that its file must have; None for any.

    Raises:
        InputError: it stands for nothing; or its file cannot be loaded, or has another checksum.
    """
    if callable(name):
        return reference(kind, name)
    if isinstance(name, str) and name in kind.registry:
        return reference(kind, kind.registry[name])._replace(label=name)
    if not isinstance(name, str) or not name:
        raise InputError(f"{shown(name)} is not {kind.noun}; {kind.hint(name)}")
    if (name, sha256) in _here:
        return _here[name, sha256]
    prefix, _, rest = name.partition(":")
    if prefix in kind.around and rest:
        return kind.around[prefix](rest, lambda inner: find(kind, inner, base, sha256))
    if prefix in kind.libraries and rest:
        return Reference(name, kind.libraries[prefix](rest), rest)
    if kind.table and modules.is_table(name):
        file = modules.of_checksum((base or Path()) / name, sha256)
        return Reference(name, kind.table(file), Path(name).stem, file)
    where, _, attribute = name.rpartition(":")
    if where.endswith(".py"):
        file = modules.of_checksum((base or Path()) / where, sha256)
        in_file = _of_module(kind, name, modules.load(file), attribute, file)
        return in_file._replace(refusal=modules.refusal(file))
    if name.endswith(".py"):
        raise InputError(f"{name} is a file: name what is in it as well, as in '{name}:NAME'")
    if _IN_MODULE.fullmatch(name):
        module = modules.imported(where)
        file = modules.read(Path(getattr(module, "__file__", None) or where), alone=True)
        if sha256 not in (None, file.sha256):
            raise InputError(f"{file.path} was changed since: put it back as it was to go on")
        return _of_module(kind, name, module, attribute, file)
    for point in metadata.entry_points(group=kind.group, name=name):
        return find(kind, f"{point.module}:{point.attr}", base, sha256)._replace(label=name)
    if prefix == "memory":
        raise InputError(f"{name} was only in the memory of the process that made it; {OWN_FILE}")
    raise InputError(f"{shown(name)} is not {kind.noun}; {kind.hint(name)}")


def add_entry_points(kind: Kind) -> list[str]:
    """Registers the entry points of all installed packages; a line for each that cannot be loaded."""
    complaints = []
    for point in metadata.entry_points(group=kind.group):
        if point.name in kind.registry:
            continue
        try:
            kind.add(point.name, find(kind, point.name).cls)
        except InputError as error:
            complaints.append(f"{point.name}: {error}")
    return complaints


def is_from_outside(name: str) -> bool:
    """Whether a name has one of the forms of what is in no registry: a file, a module, another library."""
    prefix, _, rest = name.partition(":")
    prefixes = {prefix for kind in KINDS for prefix in (*kind.libraries, *kind.around)}
    if modules.is_table(name) or name.endswith(".py") or name.rpartition(":")[0].endswith(".py"):
        return True
    return bool(rest and prefix in prefixes) or _IN_MODULE.fullmatch(name) is not None


def registered_name(registry: Mapping[str, type], cls: type) -> str:
    """The name of a class in a registry; that of the class itself where it is not there."""
    return next((name for name, registered in registry.items() if registered is cls), cls.__name__)


def reference(kind: Kind, cls: Any) -> Reference:
    """The reference to a class or a function: by its name in the registry, its module, or its file."""
    module_name, label = (getattr(cls, key, "") or "" for key in ("__module__", "__name__"))
    label = label or type(cls).__name__
    if module_name.partition(".")[0] == PACKAGE:
        for name, registered in kind.registry.items():
            if registered is cls:
                return Reference(name, cls, name)
    kind.check(label, cls)
    module, path = sys.modules.get(module_name), getattr(cls, "__qualname__", label)
    if "<locals>" in path:
        return remember(cls, label, f"{label} is made inside a function: {OWN_FILE}")
    if file := modules.of_module(module_name):
        return Reference(f"{file.path}:{path}", cls, label, file, modules.refusal(file))
    place = getattr(module, "__file__", None)
    if not place or not place.endswith(".py") or not Path(place).is_file():
        return remember(cls, label, f"{label} is made in a notebook or at a prompt: {OWN_FILE}")
    if module is None or _attribute(module, path) is not cls:
        return remember(cls, label, f"{label} is not what {place} has under this name: {OWN_FILE}")
    spec = getattr(module, "__spec__", None)
    if spec and ("." in spec.name or "site-packages" in Path(place).parts):
        return Reference(f"{spec.name}:{path}", cls, label, modules.read(Path(place), alone=True))
    file = modules.read(Path(place))
    in_file = Reference(f"{file.path}:{path}", cls, label, file, modules.refusal(file))
    return _here.setdefault((in_file.name, file.sha256), in_file)


def remember(cls: Any, label: str, refusal: str) -> Reference:
    """A reference to what can only be found again in this process."""
    for remembered in _here.values():
        if remembered.cls is cls:
            return remembered
    new = Reference(f"memory:{label}-{len(_here)}", cls, label, None, refusal)
    return _here.setdefault((new.name, None), new)


def forget(files: Iterable[File]) -> None:
    """From now on the classes of these files are what the files say, and no longer what this process has."""
    checksums = {file.sha256 for file in files}
    for key in [key for key in _here if key[1] in checksums]:
        del _here[key]


def _of_module(kind: Kind, name: str, module: ModuleType, attribute: str, file: File) -> Reference:
    """The reference to the class or function `attribute` of a module; `name` is what the user calls it."""
    cls = _attribute(module, attribute)
    if cls is None:
        own = [x for x, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
        hint = nearest(attribute, own) if own else "it has no classes or functions"
        raise InputError(f"there is no {shown(attribute)} in {name.rpartition(':')[0]}; {hint}")
    kind.check(name, cls)
    return Reference(name, cls, attribute.rpartition(".")[2], file)


def _attribute(module: ModuleType, path: str) -> Any:
    return functools.reduce(lambda obj, name: getattr(obj, name, None), path.split("."), module)


def made_by(make: Callable[..., Any], label: str, defaults: Mapping[str, Any], about: str = "") -> type:
    """A class with these parameters; calling it returns what `make` returns for them, not an instance.

    So a function can stand wherever a class is expected. It gets only those parameters that differ from their
    defaults.
    """

    def new(cls: type, **values: Any) -> Any:
        # A default that is a list is a tuple in the field.
        as_listed = lambda x: list(x) if isinstance(x, tuple) else x
        return make(**{k: x for k, x in values.items() if as_listed(x) != as_listed(defaults[k])})

    fields = [
        (key, describe.Plain, dataclasses.field(default=tuple(x) if isinstance(x, list) else x))
        for key, x in defaults.items()
    ]
    return dataclasses.make_dataclass(label, fields, namespace={"__new__": new, "__doc__": about})
