"""What the name of an environment or a method stands for: something built in, or somebody's own.

Wherever one is named (in Python, on the command line, in a file), it may be

    sarsa                      a name of a registry: built in, registered, or an entry point of a package
    path/to/mine.py:Mine       a class in a file
    package.module:Mine        a class in a module that can be imported
    gymnasium:FrozenLake-v1    an environment of another library
    mdp.npz                    a table that `FiniteMDP.save` wrote

A class in a file is loaded from the bytes of the file, under a module name that holds their checksum. So it can
be loaded anywhere from a copy, and two versions of a file are never mixed up.
"""

import contextlib
import dataclasses
import functools
import hashlib
import importlib
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from jaxrl_tab.core import describe
from jaxrl_tab.core.checks import InputError, nearest, reason, shown

_IN_MODULE = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*(\.[^\W\d]\w*)*")
_REGISTERED = re.compile(r"\w[\w.-]*")
PACKAGE = __name__.partition(".")[0]
OWN_FILE = "put it into a file of its own, and name it 'file.py:Class'"


class File(NamedTuple):
    """A file that holds a class or a table.

    Attributes:
        path: where it was read; only a name where it never was a file.
        data: its content.
    """

    path: str
    data: bytes

    @property
    def sha256(self) -> str:
        """The checksum of its content, in hexadecimal digits."""
        return hashlib.sha256(self.data).hexdigest()


class Reference(NamedTuple):
    """What a name stands for.

    Attributes:
        name: how it is recorded, so that it can be found again.
        cls: the class that is built with its parameters.
        label: what it is called in tables and pictures.
        file: the file that it is in; None where it is built in, or of another library.
        refusal: why it cannot be recorded in a folder; empty where it can.
    """

    name: str
    cls: type
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
        hint: what a message says instead of a name that is unknown.
        libraries: prefix of a name -> the class of what another library has under the rest of it.
        table: the class of what is in an .npz file; None where there are no such files.
    """

    noun: str
    registry: Mapping[str, type]
    group: str
    needs: tuple[str, ...]
    add: Callable[[str, type], None]
    hint: Callable[[Any], str]
    libraries: dict[str, Callable[[str], type]] = dataclasses.field(default_factory=dict)
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


KINDS: list[Kind] = []
_contents: dict[str, File] = {}  # the files that were read or received, by checksum
_loaded: dict[str, File] = {}  # the files that were loaded, by the name of the module
_here: dict[tuple[str, str | None], Reference] = {}  # classes of this process, by (name, checksum)
_importing: list[str] = []  # the files that are being run at the moment to load their classes


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
        name: one of the forms above, or a class.
        base: the folder from which paths start; by default that of the process.
        sha256: the checksum that its file must have, where that is settled.

    Raises:
        InputError: it stands for nothing; or its file cannot be loaded, or has another checksum.
    """
    if isinstance(name, type):
        return reference(kind, name)
    if isinstance(name, str) and name in kind.registry:
        return reference(kind, kind.registry[name])._replace(label=name)
    if not isinstance(name, str) or not name:
        raise InputError(f"{shown(name)} is not {kind.noun}; {kind.hint(name)}")
    if (name, sha256) in _here:
        return _here[name, sha256]
    prefix, _, rest = name.partition(":")
    if prefix in kind.libraries and rest:
        return Reference(name, kind.libraries[prefix](rest), rest)
    if kind.table and name.endswith(".npz"):
        file = _file((base or Path()) / name, sha256)
        return Reference(name, kind.table(file), Path(name).stem, file)
    where, _, attribute = name.rpartition(":")
    if where.endswith(".py"):
        file = _file((base or Path()) / where, sha256)
        return _of_module(kind, name, load(file), attribute, file)
    if name.endswith(".py"):
        raise InputError(f"{name} is a file: name the class in it as well, as in '{name}:MyClass'")
    if _IN_MODULE.fullmatch(name):
        module = _imported(where)
        file = read(Path(getattr(module, "__file__", None) or where))
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
    """Whether a word has one of the forms that name something from outside of the registries."""
    prefix, _, rest = name.partition(":")
    libraries = {library for kind in KINDS for library in kind.libraries}
    if name.endswith((".npz", ".py")) or name.rpartition(":")[0].endswith(".py"):
        return True
    return bool(rest and prefix in libraries) or _IN_MODULE.fullmatch(name) is not None


def registered_name(registry: Mapping[str, type], cls: type) -> str:
    """The name of a class in a registry; that of the class itself where it is not there."""
    return next((name for name, known in registry.items() if known is cls), cls.__name__)


def reference(kind: Kind, cls: type) -> Reference:
    """The reference to a class: by its name in the registry, its module, or its file."""
    if cls.__module__.partition(".")[0] == PACKAGE:
        for name, known in kind.registry.items():
            if known is cls:
                return Reference(name, cls, name)
    kind.check(cls.__name__, cls)
    module, path = sys.modules.get(cls.__module__), cls.__qualname__
    if "<locals>" in path:
        return remember(cls, cls.__name__, f"{cls.__name__} is made inside a function: {OWN_FILE}")
    if cls.__module__ in _loaded:
        file = _loaded[cls.__module__]
        return Reference(f"{file.path}:{path}", cls, cls.__name__, file)
    place = getattr(module, "__file__", None)
    if not place or not place.endswith(".py") or not Path(place).is_file():
        return remember(cls, cls.__name__, f"{cls.__name__} is made in a notebook or at a prompt: {OWN_FILE}")
    if module is None or _attribute(module, path) is not cls:
        return remember(
            cls, cls.__name__, f"{cls.__name__} is not what {place} has under this name: {OWN_FILE}"
        )
    file, spec = read(Path(place)), getattr(module, "__spec__", None)
    if spec and ("." in spec.name or "site-packages" in Path(place).parts):
        return Reference(f"{spec.name}:{path}", cls, cls.__name__, file)
    found = Reference(f"{file.path}:{path}", cls, cls.__name__, file)
    return _here.setdefault((found.name, file.sha256), found)


def remember(cls: type, label: str, refusal: str) -> Reference:
    """A reference to what can only be found again in this process."""
    for known in _here.values():
        if known.cls is cls:
            return known
    found = Reference(f"memory:{label}-{len(_here)}", cls, label, None, refusal)
    return _here.setdefault((found.name, None), found)


def forget(files: Iterable[File]) -> None:
    """From now on the classes of these files are what the files say, and no longer what this process has."""
    checksums = {file.sha256 for file in files}
    for key in [key for key in _here if key[1] in checksums]:
        del _here[key]


def keep(files: Iterable[File]) -> None:
    """From now on files with the checksums of these are not read again."""
    for file in files:
        _contents.setdefault(file.sha256, file)


def read(path: Path) -> File:
    """The file at `path`, as it is now."""
    try:
        file = File(str(path.resolve()), path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {reason(error)}") from None
    return _contents.setdefault(file.sha256, file)._replace(path=file.path)


def _file(path: Path, sha256: str | None) -> File:
    if sha256 in _contents:
        return _contents[sha256]
    file = read(path)
    if sha256 not in (None, file.sha256):
        raise InputError(f"{path} was changed since: its SHA-256 is no longer {sha256}")
    return file


def load(file: File) -> ModuleType:
    """The module that a file gives, which is run once for each place and content."""
    stem = re.sub(r"\W", "_", Path(file.path).stem)
    of_both = hashlib.sha256(f"{file.path} {file.sha256}".encode(errors="surrogateescape")).hexdigest()
    name = f"{PACKAGE}_file_{stem}_{of_both[:16]}"
    if name not in sys.modules:
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = file.path
        _loaded[name] = file
        try:
            with importing(file.path):
                exec(compile(file.data, file.path, "exec"), vars(module))
        except BaseException:
            del sys.modules[name], _loaded[name]
            raise
    return sys.modules[name]


def _imported(name: str) -> ModuleType:
    if name in sys.modules:
        return sys.modules[name]
    with importing(name):
        return importlib.import_module(name)


class _ComputesAtOnce(InputError):
    """A file that only defines classes would not do this."""


@contextlib.contextmanager
def importing(what: str) -> Iterator[None]:
    """While the code of somebody's file runs: what it raises is said in one line, and it may compute nothing."""
    _importing.append(what)
    try:
        yield
    except _ComputesAtOnce:
        raise
    except (Exception, SystemExit) as error:
        lines = [at.lineno for at in traceback.extract_tb(error.__traceback__) if at.filename == what]
        lines += [error.lineno] if isinstance(error, SyntaxError) else []
        where = f", line {lines[-1]}" if lines else ""
        raise InputError(
            f"{what} cannot be imported: {type(error).__name__}{where}: {reason(error)}"
        ) from error
    finally:
        _importing.pop()


def check_not_importing() -> None:
    """Raises InputError while a file is imported: as a script that is not guarded, it would run again and again."""
    if _importing:
        raise _ComputesAtOnce(
            f"{_importing[-1]} computes when it is imported: put all that it runs below "
            '`if __name__ == "__main__":`'
        )


def _of_module(kind: Kind, name: str, module: ModuleType, attribute: str, file: File) -> Reference:
    """The class of a module that is called `name`."""
    cls = _attribute(module, attribute)
    if cls is None:
        classes = [x for x, value in vars(module).items() if _is_defined_in(value, module)]
        hint = nearest(attribute, classes) if classes else "it has no classes"
        raise InputError(f"there is no {shown(attribute)} in {name.rpartition(':')[0]}; {hint}")
    kind.check(name, cls)
    return Reference(name, cls, attribute.rpartition(".")[2], file)


def _is_defined_in(value: Any, module: ModuleType) -> bool:
    return isinstance(value, type) and value.__module__ == module.__name__


def _attribute(module: ModuleType, path: str) -> Any:
    return functools.reduce(lambda obj, name: getattr(obj, name, None), path.split("."), module)


def made_by(make: Callable[..., Any], label: str, defaults: Mapping[str, Any], about: str = "") -> type:
    """A class with these parameters, which is not what it builds: that is what `make` gives for them.

    So what is made by a function stands wherever a class does. Only what differs from its default is handed on.
    """

    def new(cls: type, **values: Any) -> Any:
        as_listed = lambda x: list(x) if isinstance(x, tuple) else x
        return make(**{k: x for k, x in values.items() if as_listed(x) != as_listed(defaults[k])})

    fields = [
        (key, describe.Plain, dataclasses.field(default=tuple(x) if isinstance(x, list) else x))
        for key, x in defaults.items()
    ]
    return dataclasses.make_dataclass(label, fields, namespace={"__new__": new, "__doc__": about})
