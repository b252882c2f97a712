"""Compiled programs that outlive the process: a second start of the command neither traces nor compiles.

JAX's own persistent cache spares the compiler, but not the tracing before it, which takes as long. Here a
program is found by what it is made from: the sources of this package, the versions and settings of JAX, the
machine, and the method, environment and budget. Only what consists of this package's own classes is kept:
the code behind anybody else's may change without a trace in the name.

A program is code, and it is run. So it is read only where nobody else can have put it: the file and its folder
are the user's own, and no link, and only the user may write them. And only as it was written: it begins with
the SHA-256 of its name and its content. (That finds all damage. Nothing helps against somebody who can write as
the user.) Otherwise one line of the log says what is wrong, and the program is compiled again.

Off until `keep` is called, which the command line does.
"""

import contextlib
import hashlib
import io
import logging
import os
import pickle
import platform
import re
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import jax

from jaxrl_tab.core.checks import reason
from jaxrl_tab.engine import provenance

T = TypeVar("T")

AT_MOST = 512  # programs; of more, those that were unused for longest are removed
UNFINISHED_SECONDS = 3600  # what was begun so long ago was left by a process that died
_OWN = re.compile(r"[0-9a-f]{64}\.program(?P<unfinished>\.\w+)?")  # the names of our files
_folder: Path | None = None


def keep(folder: Path | None = None) -> None:
    """From now on keeps compiled programs in `folder`, for this process and later ones.

    By default that is where the user's `JAX_COMPILATION_CACHE_DIR` says, or else the user's cache folder
    (`XDG_CACHE_HOME`), and JAX is told to keep there what else it compiles. `JAX_ENABLE_COMPILATION_CACHE=0`
    turns both off. Where the folder cannot be used, one line of the log says why.
    """
    global _folder
    if not jax.config.jax_enable_compilation_cache:  # pyright: ignore[reportAttributeAccessIssue]
        return
    chosen = folder or jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        chosen = _default()
        if chosen is None or not _is_usable(chosen):
            return
        jax.config.update("jax_compilation_cache_dir", str(chosen))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    _folder = Path(chosen) / "programs"


def kept(name: Any, make: Callable[[str], T], pack: Callable[[T], Any], unpack: Callable[[Any], T]) -> T:
    """What `make` gives, or gave in an earlier process under the same `name`.

    Args:
        name: a pytree of all that it depends on, besides code, versions and settings.
        make: makes it, under the name in JAX that it is given: a program that is kept here is never one that
            JAX took from its own cache, see `_unknown_to_jax`.
        pack, unpack: to something that can be pickled, and back. `pack` may raise: then it is not kept.
    """
    file = _file(name)
    if file is None or not _is_usable(file.parent):
        return make("program")
    try:
        program = unpack(pickle.loads(_read(file)))
        os.utime(file)  # `_make_room` takes the time for that of the last use
        return program
    except FileNotFoundError:
        pass
    except Exception as error:  # jaxlib's have no common type
        _warn(f"{file} is not used, and made again: {reason(error)}")
    with _unknown_to_jax():
        made = make("kept_program")
    with contextlib.suppress(Exception):
        packed = pickle.dumps(pack(made))
        try:
            _write(file, packed)
        except OSError as error:
            _warn(f"compiled programs are not kept in {file.parent}: {reason(error)}")
    return made


def _default() -> Path | None:
    """A folder of ours in the user's cache folder; None where there is none."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxrl_tab"
    except RuntimeError as error:
        _warn(f"compiled programs are not kept: {reason(error)}")
        return None


@contextlib.contextmanager
def _unknown_to_jax() -> Iterator[None]:
    """Keeps what is compiled within out of JAX's cache: what comes from there cannot be written down again.

    (On a CPU with jax 0.10.2 it can, but what is read then says "Function ... not found" when it is called.)
    """
    setting = "jax_persistent_cache_min_compile_time_secs"
    before = jax.config.values[setting]
    jax.config.update(setting, 1e9)
    try:
        yield
    finally:
        jax.config.update(setting, before)


def _file(name: Any) -> Path | None:
    """The file in which the program with this name is kept; None where it is not kept."""
    if _folder is None:
        return None
    pickled = io.BytesIO()
    try:
        _Named(pickled, protocol=5).dump(name)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    parts = (
        pickled.getvalue(),
        repr(sorted(jax.config.values.items())).encode(),
        os.environ.get("XLA_FLAGS", "").encode(),
        _code_and_machine(),
    )
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
    return _folder / f"{digest}.program"


class _Named(pickle.Pickler):
    """Refuses classes and functions whose code is not in this package, in JAX or in NumPy."""

    def reducer_override(self, obj: Any) -> Any:
        definition = obj if hasattr(obj, "__qualname__") else type(obj)  # classes and functions have a name
        if (definition.__module__ or "").partition(".")[0] not in _COVERED:
            raise pickle.PicklingError(f"{obj} is not of jaxrl_tab")
        return NotImplemented


# Packages that a name may refer to: their versions are part of it too, or their code shapes no program.
_COVERED = ("jaxrl_tab", "jax", "jaxlib", "numpy", "ml_dtypes", "builtins", "copyreg")


@cache
def _code_and_machine() -> bytes:
    """All that a program depends on and nobody passes, but for flags and settings."""
    devices = [(d.platform, d.device_kind) for d in jax.devices()]
    machine = platform.platform(), platform.machine(), provenance.features(), devices
    return repr((provenance.installed(), machine)).encode()


# --- files -------------------------------------------------------------------------------------------


@cache
def _is_usable(folder: Path) -> bool:
    """Whether programs can be kept in `folder`, which is created; where they cannot, the log says so once."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _check_own(folder.lstat(), stat.S_ISDIR)
    except OSError as error:
        _warn(f"compiled programs are not kept in {folder}: {reason(error)}")
        return False
    return True


def _check_own(status: os.stat_result, is_kind: Callable[[int], bool]) -> None:
    """Raises OSError unless it is the user's own, nobody else may write it, and it is no link."""
    if not is_kind(status.st_mode):
        raise OSError("it is a link, or of another kind")
    if os.name == "nt":  # whose rights are not in the mode; a user's cache folder is the user's there
        return
    if status.st_uid != os.geteuid():
        raise OSError(f"it belongs to another user ({status.st_uid})")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise OSError(f"others may write it, too (its mode is {stat.S_IMODE(status.st_mode):o}); remove it")


def _read(file: Path) -> bytes:
    """What `_write` was given under this name. Raises OSError where it is not that, or not there."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(file, flags), "rb") as opened:
        _check_own(os.fstat(opened.fileno()), stat.S_ISREG)  # of what is read, whatever has the name by then
        data = opened.read()
    checksum, data = data[:_SIZE], data[_SIZE:]
    if checksum != _checksum(file, data):
        raise OSError("it is damaged")
    return data


def _write(file: Path, data: bytes) -> None:
    """Writes `data` under its name, so that nobody ever sees a part of it; then makes room."""
    descriptor, unfinished = tempfile.mkstemp(dir=file.parent, prefix=f"{file.name}.")
    try:
        with open(descriptor, "wb") as opened:
            opened.write(_checksum(file, data) + data)
            opened.flush()
            os.fsync(descriptor)
        os.replace(unfinished, file)
    except BaseException:
        os.unlink(unfinished)
        raise
    _make_room(file.parent)


def _make_room(folder: Path) -> None:
    """Removes what was not used for longest, and what was never finished. It knows our files by their names."""
    ages = {}
    for file in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another process makes room, too
            if named := _OWN.fullmatch(file.name):
                ages[file] = named["unfinished"], time.time() - file.lstat().st_mtime
    abandoned = [file for file, (unfinished, age) in ages.items() if unfinished and age > UNFINISHED_SECONDS]
    finished = sorted((age, file) for file, (unfinished, age) in ages.items() if not unfinished)
    for file in [*abandoned, *(file for _, file in finished[AT_MOST:])]:
        file.unlink(missing_ok=True)


_SIZE = hashlib.sha256().digest_size


def _checksum(file: Path, data: bytes) -> bytes:
    return hashlib.sha256(file.name.encode() + data).digest()


@cache
def _warn(line: str) -> None:
    """Logs the line, the first time only."""
    logging.getLogger(__name__).warning("%s", line)
