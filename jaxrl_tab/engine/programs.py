"""What is compiled outlives the process: a second start of the command finds it by what it was made from.

That is the sources of this package, the versions and settings of JAX, the machine, and a name: the method, the
environment and the budget. Only this package's own classes have such a name, for the code behind anybody else's may
change without a trace. The text of what was traced is a name, too, whoever wrote the class. The exact values of an
environment are kept in the same way.

Compiled code is run. So what is read must be what this user wrote, to the last bit; otherwise one line of the log
says what is wrong, and it is made again. Three things see to that:

- The folder and each file are the user's own, and no link, and only the user may write them. So nobody else can
  have put anything there.
- Each file begins with a keyed checksum (HMAC-SHA256) of its name and its content. The key is 32 random bytes in a
  file beside them, which only the user may read. This finds all damage, and all that the user did not make here,
  such as files out of somebody else's archive: without the key nobody can work out a checksum.
- What is kept is plain bytes. Nothing looks at them before their checksum is found to be right, and nothing is
  unpickled.

Nothing helps against somebody who can read and write as the user.

The programs of XLA are left to JAX's own cache, which spares the compiler, but not the tracing before it. JAX checks
nothing of this kind. Its cache lies in a folder that was checked here, unless the user chose one.

Nothing is kept until `keep` is called, which the command line does.
"""

import contextlib
import dataclasses
import functools
import hashlib
import hmac
import logging
import operator
import os
import platform
import re
import secrets
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from jaxrl_tab.core.errors import reason
from jaxrl_tab.engine import provenance
from jaxrl_tab.exact import model

T = TypeVar("T")

AT_MOST = 512  # files; of more, those that were unused for longest are removed
UNFINISHED_SECONDS = 3600  # what was begun so long ago was left by a process that died
COMPILE_SECONDS = 0.2  # JAX keeps what took at least so long to compile; by default a second, too long for us
_OWN = re.compile(r"[0-9a-f]{64}\.program")  # the names of our files, beside the key
_UNFINISHED = re.compile(r"([0-9a-f]{64}\.program|key)\.\w+")
_KEY_BYTES, _CHECKSUM_BYTES = 32, hashlib.sha256().digest_size
_READ, _WRITE = stat.S_IRGRP | stat.S_IROTH, stat.S_IWGRP | stat.S_IWOTH  # what others may do
PROGRAMS, EXACT = "programs", "exact"  # what is kept, each in a folder of this name
NAMES = {PROGRAMS: "compiled programs", EXACT: "exact values"}
_folder: Path | None = None


def keep(folder: Path | None = None) -> None:
    """From now on keeps what is compiled in `folder`, for this process and later ones.

    By default that is where the user's `JAX_COMPILATION_CACHE_DIR` says, or else the user's cache folder
    (`XDG_CACHE_HOME`), and JAX is told to keep its programs there. `JAX_ENABLE_COMPILATION_CACHE=0` turns
    both off. Where the folder cannot be used, one line of the log says why.
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
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", COMPILE_SECONDS)
    _folder = Path(chosen)
    model.keep_with(functools.partial(kept, what=EXACT))


def are_kept() -> bool:
    """Whether `keep` was called, and there is a folder for it."""
    return _folder is not None


def kept(
    name: Any,
    make: Callable[[], T],
    pack: Callable[[T], bytes | None],
    unpack: Callable[[bytes], T],
    what: str = PROGRAMS,
) -> T:
    """What `make` gives, or gave in an earlier process under the same `name`.

    Args:
        name: all that it depends on, besides code, versions, settings and machine: plain data, such as the text
            of a program or its digest, and instances of this package's own classes. Where anything else is in
            it, nothing is kept.
        make: makes it.
        pack, unpack: to bytes, and back. Where `pack` gives None, nothing is kept. `unpack` is given what `pack`
            gave, to the last bit; where it raises something, one line of the log says so, and it is made again.
        what: kind of thing it is: the name of the folder, which no other kind has.
    """
    if (place := _place(name, what)) is None:
        return make()
    if (found := _found(place, unpack, ", and made again")) is not None:
        return found
    made = make()
    if (data := pack(made)) is not None:
        _put(place, data, NAMES[what])
    return made


def note(name: str, data: bytes) -> None:
    """Keeps `data` under a name, instead of what is there; it need not be there later."""
    if place := _place(("note", name)):
        _put(place, data, name)


def noted(name: str, unpack: Callable[[bytes], T]) -> T | None:
    """What was kept last under a name, unpacked; None where there is nothing, or nothing that can be used."""
    place = _place(("note", name))
    return place and _found(place, unpack)


class _Place(NamedTuple):
    """A file in which something is kept, and the key of its checksum."""

    file: Path
    key: bytes


def _place(name: Any, what: str = PROGRAMS) -> _Place | None:
    """Where what has this name is kept; None where it is not kept."""
    file = _file(name, what)
    key = file and _key(file.parent)
    return _Place(file, key) if file and key else None


def _found(place: _Place, unpack: Callable[[bytes], T], remedy: str = "") -> T | None:
    """What is kept there; None where nothing is, or it cannot be used: the log says so, and what is done about it."""
    try:
        found = unpack(_read(*place))
        os.utime(place.file)  # `_make_room` takes the time for that of the last use
        return found
    except FileNotFoundError:
        return None
    except Exception as error:  # what LLVM raises has no common type
        _warn(f"{place.file} is not used{remedy}: {reason(error)}")
        return None


def _put(place: _Place, data: bytes, what: str) -> None:
    """Keeps data there; where that cannot be, the log says `what` is not kept."""
    try:
        _write(*place, data)
    except OSError as error:
        _warn(f"{what} are not kept in {place.file.parent}: {reason(error)}")


def _default() -> Path | None:
    """A folder of ours in the user's cache folder; None where there is none."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxrl_tab"
    except RuntimeError as error:
        _warn(f"compiled programs are not kept: {reason(error)}")
        return None


# --- names -------------------------------------------------------------------------------------------


def _file(name: Any, what: str = PROGRAMS) -> Path | None:
    """The file in which what has this name is kept; None where it is not kept."""
    if _folder is None:
        return None
    try:
        text = _as_text(name)
    except TypeError:
        return None
    parts = (
        text.encode(),
        repr(sorted(jax.config.values.items())).encode(),
        os.environ.get("XLA_FLAGS", "").encode(),
        _code_and_machine(),
    )
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
    return _folder / what / f"{digest}.program"


def _as_text(x: Any) -> str:
    """A text that no two objects share unless they are of the same class, with the same values of the same types.

    Raises TypeError for anything but plain data and instances of this package's own classes.
    """
    if x is None or type(x) in (bool, int, float, str, bytes):
        return repr(x)  # all digits, and in quotes what could be taken for something else
    if type(x) is np.ndarray and x.dtype.kind in "biuf":
        return f"{x.dtype}{x.shape}{hashlib.sha256(x.tobytes()).hexdigest()}"
    if type(x) is tuple:
        return f"({','.join(map(_as_text, x))})"
    if type(x) is list:
        return f"[{','.join(map(_as_text, x))}]"
    if type(x) is dict:
        return f"{{{','.join(f'{_as_text(key)}:{_as_text(value)}' for key, value in x.items())}}}"
    name = f"{type(x).__module__}.{type(x).__qualname__}"
    if _is_own(type(x)) and dataclasses.is_dataclass(x):
        return f"{name}({_as_text(vars(x))})"
    if _is_own(type(x)) and isinstance(x, tuple):  # a NamedTuple
        return f"{name}({','.join(map(_as_text, x))})"
    raise TypeError(f"{name} is neither plain data nor a class of jaxrl_tab")


def _is_own(cls: type) -> bool:
    """Whether it is what this package has under its name, and not made by a function, as others may be."""
    if cls.__module__.partition(".")[0] != "jaxrl_tab":
        return False
    try:
        return operator.attrgetter(cls.__qualname__)(sys.modules.get(cls.__module__)) is cls
    except AttributeError:
        return False


@functools.cache
def _code_and_machine() -> bytes:
    """All that a program depends on and nobody passes, but for flags and settings."""
    devices = [(d.platform, d.device_kind) for d in jax.devices()]
    # All that `platform.platform` says; but that starts a process, to ask for the processor.
    system = [getattr(platform, part)() for part in ("system", "release", "version", "machine", "libc_ver")]
    return repr((provenance.installed(), system, provenance.features(), devices)).encode()


# --- files -------------------------------------------------------------------------------------------


@functools.cache
def _is_usable(folder: Path) -> bool:
    """Whether something can be kept in `folder`, which is created; where it cannot, the log says so once."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _check_own(folder.lstat(), stat.S_ISDIR, _WRITE)
    except OSError as error:
        _warn(f"compiled programs are not kept in {folder}: {reason(error)}")
        return False
    return True


@functools.cache
def _key(folder: Path) -> bytes | None:
    """The key of the checksums in `folder`; both are created. None where that cannot be: the log says so once."""
    if not _is_usable(folder):
        return None
    file = folder / "key"
    try:
        if not os.path.lexists(file):
            with (
                _on_disk(file, secrets.token_bytes(_KEY_BYTES)) as unfinished,
                contextlib.suppress(FileExistsError),
            ):
                os.link(unfinished, file)  # which does not replace that of a process that was faster
        key = _contents(file, _READ | _WRITE)
        if len(key) != _KEY_BYTES:
            raise OSError(f"it has {len(key)} bytes instead of {_KEY_BYTES}; remove it")
    except OSError as error:
        _warn(f"compiled programs are not kept in {folder}: the key in it cannot be used: {reason(error)}")
        return None
    return key


def _check_own(status: os.stat_result, is_kind: Callable[[int], bool], forbidden: int) -> None:
    """Raises OSError unless it is the user's own, others have none of these rights, and it is no link."""
    if not is_kind(status.st_mode):
        raise OSError("it is a link, or of another kind")
    if os.name == "nt":  # whose rights are not in the mode; a user's cache folder is the user's there
        return
    if status.st_uid != os.geteuid():
        raise OSError(f"it belongs to another user ({status.st_uid})")
    if rights := status.st_mode & forbidden:
        verb = "write" if rights & _WRITE else "read"
        raise OSError(f"others may {verb} it, too (its mode is {stat.S_IMODE(status.st_mode):o}); remove it")


def _contents(file: Path, forbidden: int) -> bytes:
    """All that is in a file. Raises OSError where it is not the user's own, or others have these rights."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    with open(os.open(file, flags), "rb") as opened:
        # Of what is read, whatever has the name by then.
        _check_own(os.fstat(opened.fileno()), stat.S_ISREG, forbidden)
        return opened.read()


def _read(file: Path, key: bytes) -> bytes:
    """What `_write` was given under this name. Raises OSError where it is not that, or not there."""
    data = _contents(file, _WRITE)
    checksum, data = data[:_CHECKSUM_BYTES], data[_CHECKSUM_BYTES:]
    if not hmac.compare_digest(checksum, _checksum(file, key, data)):
        raise OSError("it is damaged, or was not written here")
    return data


def _write(file: Path, key: bytes, data: bytes) -> None:
    """Writes `data` under its name, so that nobody ever sees a part of it; then makes room."""
    with _on_disk(file, _checksum(file, key, data) + data) as unfinished:
        os.replace(unfinished, file)
    _make_room(file.parent)


@contextlib.contextmanager
def _on_disk(file: Path, data: bytes) -> Iterator[str]:
    """Writes `data` beside `file`, for the user alone: the path, until it has got its name."""
    descriptor, unfinished = tempfile.mkstemp(dir=file.parent, prefix=f"{file.name}.")
    try:
        with open(descriptor, "wb") as opened:
            opened.write(data)
            opened.flush()
            os.fsync(descriptor)
        yield unfinished
    finally:
        Path(unfinished).unlink(missing_ok=True)


def _make_room(folder: Path) -> None:
    """Removes what was not used for longest, and what was never finished. It knows our files by their names."""
    finished = []
    for file in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):  # another process makes room, too
            age = time.time() - file.lstat().st_mtime
            if _OWN.fullmatch(file.name):
                finished.append((age, file))
            elif _UNFINISHED.fullmatch(file.name) and age > UNFINISHED_SECONDS:
                file.unlink()
    for _, file in sorted(finished)[AT_MOST:]:
        file.unlink(missing_ok=True)


def _checksum(file: Path, key: bytes, data: bytes) -> bytes:
    return hmac.digest(key, file.name.encode() + data, "sha256")


@functools.cache
def _warn(line: str) -> None:
    """Logs the line, the first time only."""
    logging.getLogger(__name__).warning("%s", line)
