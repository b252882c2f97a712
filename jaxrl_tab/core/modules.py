"""Files that hold somebody's own classes and functions, and the modules that they give.

A file is loaded from its bytes, under a module name that holds their checksum. So it can be loaded anywhere from
a copy, and two versions of a file are never mixed up. It may import files that lie beside it, its neighbours:
they are part of its checksum, go wherever it goes, and are loaded from there in the same way.
"""

import ast
import builtins
import contextlib
import functools
import hashlib
import importlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from jaxrl_tab.core.errors import InputError, reason

PACKAGE = __name__.partition(".")[0]
TABLES = (
    ".npz",
    ".mdp",
    ".pomdp",
)  # how the names of files end that hold a table of an environment, in any case


class File(NamedTuple):
    """A file that holds a class, a function or a table.

    Attributes:
        path: where it was read; only a name where it never was a file.
        data: its content.
        neighbours: the files beside it that it imports, and those that they import, in the order of their names.
    """

    path: str
    data: bytes
    neighbours: tuple["File", ...] = ()

    @property
    def name(self) -> str:
        """Its name in its folder."""
        return Path(self.path).name

    @property
    def sha256(self) -> str:
        """The checksum of its content, and of its neighbours where it has any, in hexadecimal digits."""
        digest = hashlib.sha256(self.data)
        for file in self.neighbours:
            digest.update(f"{file.name} {file.sha256}".encode())
        return digest.hexdigest()


def is_table(name: str) -> bool:
    """Whether a file of this name holds a table of an environment: see `FiniteMDP.load`."""
    return name.lower().endswith(TABLES)


_contents: dict[str, File] = {}  # the files that were read or received, by checksum
_loaded: dict[str, File] = {}  # the files that were loaded, by the name of the module
_importing: list[str] = []  # the files that are being run at the moment to load what is in them


def keep(files: Iterable[File]) -> None:
    """From now on files with the checksums of these are not read again."""
    for file in files:
        _contents.setdefault(file.sha256, file)


def read(path: Path, alone: bool = False) -> File:
    """The file at `path`, as it is now; a program with its neighbours, unless `alone`."""
    try:
        file = File(str(path.resolve()), path.read_bytes())
        if path.suffix == ".py" and not alone:
            file = _with_neighbours(file, functools.partial(_beside, Path(file.path).parent))
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {reason(error)}") from None
    keep([file])
    return file


def of_checksum(path: Path, sha256: str | None) -> File:
    """The file with this checksum if it was read or received; else, or without one, the file at `path`."""
    if sha256 in _contents:
        return _contents[sha256]
    file = read(path)
    if sha256 not in (None, file.sha256):
        raise InputError(f"{path} was changed since: its SHA-256 is no longer {sha256}")
    return file


def of_module(name: str) -> File | None:
    """The file that a module of this name was loaded from by `load`."""
    return _loaded.get(name)


def _with_neighbours(file: File, find: Callable[[str], File | None]) -> File:
    """The file with its neighbours, which `find` gives by the names of their modules."""
    neighbours: dict[str, File] = {}
    unread = [file]
    while unread:
        for name in _imports(unread.pop()):
            neighbour = None if name in neighbours else find(name)
            if neighbour and neighbour.path != file.path:
                neighbours[name] = neighbour
                unread.append(neighbour)
    return file._replace(neighbours=tuple(neighbours[name] for name in sorted(neighbours)))


def _beside(folder: Path, name: str) -> File | None:
    path = folder / f"{name}.py"
    return File(str(path), path.read_bytes()) if path.is_file() else None


def _imports(file: File) -> set[str]:
    """What a program imports, anywhere in it: modules and packages, without what is in them."""
    try:
        nodes = list(ast.walk(ast.parse(file.data)))
    except (SyntaxError, ValueError):  # whoever runs the file gets this error
        return set()
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level]
    return {name.partition(".")[0] for name in names}


def refusal(file: File) -> str:
    """Why a program cannot be kept in a folder: it imports a package beside it. Empty where it can."""
    folder = Path(file.path).parent
    # A folder on the path holds what is installed for development. (The first is where Python was started.)
    if str(folder) in sys.path[1:]:
        return ""
    for program in (file, *file.neighbours):
        for name in sorted(_imports(program)):
            spec = importlib.util.find_spec(name) if (folder / name).is_dir() else None
            if spec and str(folder / name) in (spec.submodule_search_locations or ()):
                return (
                    f"{program.path} imports {name}, a package beside it, of which no copy is kept: install "
                    "it, or put what is needed of it into a file there"
                )
    return ""


def load(file: File, part: File | None = None) -> ModuleType:
    """The module that a file gives, or a `part` of it, which is a neighbour; run once for each place and content."""
    part = part or file
    stem = re.sub(r"\W", "_", Path(part.path).stem)
    identity = f"{file.path} {file.sha256} {part.name}".encode(errors="surrogateescape")
    name = f"{PACKAGE}_file_{stem}_{hashlib.sha256(identity).hexdigest()[:16]}"
    if name not in sys.modules:
        beside = {Path(x.path).stem: x._replace(neighbours=()) for x in (file, *file.neighbours)}
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = part.path
        # Imports that are below a function are run later, and find their neighbours there as well.
        own_import = functools.partial(_import, file)
        vars(module)["__builtins__"] = vars(builtins) | {"__import__": own_import}
        _loaded[name] = _with_neighbours(part, beside.get)
        try:
            with importing(part.path):
                exec(compile(part.data, part.path, "exec"), vars(module))
        except BaseException:
            del sys.modules[name], _loaded[name]
            raise
    return sys.modules[name]


def _import(
    file: File, name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
) -> ModuleType:
    """`__import__` in what a file gives: it finds what belongs to the file before what is installed."""
    for part in (file, *file.neighbours):
        if not level and name == Path(part.path).stem:
            return load(file, part)
    try:
        return builtins.__import__(name, globals, locals, fromlist, level)
    except ModuleNotFoundError as error:
        if level or error.name is None or not (Path(file.path).parent / error.name).is_dir():
            raise
        raise ImportError(
            f"{error.name} is a package beside it, and only files beside it are found"
        ) from None


def imported(name: str) -> ModuleType:
    """The module of this name, which Python finds."""
    if name in sys.modules:
        return sys.modules[name]
    with importing(name):
        return importlib.import_module(name)


class _AtImport(InputError):
    """An error in a file when it is imported, reported of that file and not of those that import it."""


@contextlib.contextmanager
def importing(what: str) -> Iterator[None]:
    """Runs the code of a user's file: an error in it is reported in one line, and it may compute nothing."""
    _importing.append(what)
    try:
        yield
    except _AtImport:
        raise
    except (Exception, SystemExit) as error:
        lines = [at.lineno for at in traceback.extract_tb(error.__traceback__) if at.filename == what]
        lines += [error.lineno] if isinstance(error, SyntaxError) else []
        where = f", line {lines[-1]}" if lines else ""
        raise _AtImport(
            f"{what} cannot be imported: {type(error).__name__}{where}: {reason(error)}"
        ) from error
    finally:
        _importing.pop()


def check_not_importing() -> None:
    """Raises InputError while a file is imported: as a script that is not guarded, it would run again and again."""
    if _importing:
        raise _AtImport(
            f"{_importing[-1]} computes when it is imported: put all that it runs below "
            '`if __name__ == "__main__":`'
        )
