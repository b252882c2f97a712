"""Files and folders that are whole or not there, whenever a process is killed.

Every file is written under another name in the same folder, brought to the disk, and only then renamed.
"""

import contextlib
import hashlib
import json
import os
import re
import shutil
import stat
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from jaxrl_tab.core.errors import InputError, RunError, one_line, reason

ASIDE, LOCK = "set-aside", ".lock"
UNFINISHED = ".unfinished"  # while NAME is being written, it is called .NAME.unfinished
RESERVED = r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)"  # names that are devices to Windows


def file_names(labels: Iterable[str]) -> dict[str, str]:
    """The name of the file or folder of each label: short, valid on any system, and different for each.

    It is the label itself where that is such a name; else its valid characters, with digits of its checksum.
    """
    plain_names = {}
    for label in labels:
        plain = unicodedata.normalize("NFKD", label).encode("ascii", "ignore").decode()
        plain = re.sub(r"[^\w=,.+-]+", "_", plain).lstrip(".-")[:60].rstrip(".")
        plain_names[label] = f"_{plain}" if not plain or re.match(RESERVED, plain, re.IGNORECASE) else plain
    often = Counter(name.lower() for name in plain_names.values())
    digits = {
        label: hashlib.sha256(label.encode("utf-8", "surrogatepass")).hexdigest()[:8] for label in plain_names
    }
    return {
        label: name
        if name == label and often[name.lower()] == 1 and not re.search(r"-[0-9a-f]{8}$", name, re.IGNORECASE)
        else f"{name}-{digits[label]}"
        for label, name in plain_names.items()
    }


@contextlib.contextmanager
def writing(path: Path, sync: bool = True) -> Iterator[Path]:
    """A temporary path to write to. At the end of the block the file is synced, and renamed to `path`.

    Without `sync` it may be lost, or found damaged, where the power fails in the next half minute.

    Raises:
        RunError: it cannot be written, as where the disk is full; nothing of it is left.
    """
    unfinished = _unfinished(path)
    with as_run_error(path):
        unfinished.unlink(missing_ok=True)  # were it a link, we would write to where it leads
        try:
            yield unfinished
            if sync:
                with unfinished.open("rb+") as file:
                    os.fsync(file.fileno())
            unfinished.replace(path)
            if sync:
                _sync(path.parent)
        except BaseException:
            unfinished.unlink(missing_ok=True)
            raise


def write(path: Path, data: Any) -> None:
    """Writes text, or bytes, as a whole; see `writing`."""
    with writing(path) as unfinished:
        unfinished.write_bytes(data.encode() if isinstance(data, str) else data)


def write_json(path: Path, data: Any) -> None:
    write(path, json.dumps(data, indent=1, ensure_ascii=False) + "\n")


@contextlib.contextmanager
def as_run_error(path: Path, done: str = "written") -> Iterator[None]:
    """Turns an OSError inside the block into a RunError of one line: `path` could not be `done`."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{one_line(str(path))} could not be {done}: {reason(error)}") from None


def read_json(file: Path) -> Any:
    """What is in the file; None where it is missing, or no file, or damaged.

    Raises:
        RunError: it cannot be read.
    """
    if not is_file(file):
        return None
    with as_run_error(file, "read"):
        data = file.read_bytes()
    try:
        parsed = json.loads(data.decode())
        # Raises where half of a surrogate pair could not be written again.
        json.dumps(parsed, ensure_ascii=False).encode()
        return parsed
    except (ValueError, RecursionError):
        return None


def is_file(path: Path) -> bool:
    """Whether it is a file, and no link to one: links lead out of the folder."""
    with contextlib.suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


def set_aside(file: Path, folder: Path, remedy: str, what: str = "is damaged") -> str:
    """Moves a damaged file of a folder out of the way, and gives a line that says so.

    `remedy` ends the line, such as "made again": what is done about it.
    """
    with as_run_error(folder):
        aside = own_folder(folder / ASIDE)
        numbers = {int(name) for path in aside.iterdir() if (name := path.name.partition("-")[0]).isdecimal()}
        goal = aside / f"{max(numbers, default=-1) + 1}-{file.name}"
        file.rename(goal)
    return f"{file.relative_to(folder)} {what}: it is now {goal.relative_to(folder)}, and is {remedy}"


@contextlib.contextmanager
def new_folder(path: Path, keep: bool = False) -> Iterator[Path]:
    """A temporary folder for the first files of `path`, to which it is renamed at the end of the block.

    If the block fails, the files are removed; with `keep` they stay, and a note of the error says where.

    Raises:
        InputError: there is something already, or it cannot be made.
    """
    try:
        if path.exists() or path.is_symlink():
            raise InputError(_exists(path))
        unfinished = _unfinished(path.with_name(f"{path.name}-{os.getpid()}"))  # ValueError: "." has no name
        unfinished.mkdir(parents=True)
    except (OSError, ValueError) as error:  # a name that holds NUL
        raise InputError(f"{one_line(str(path))} cannot be made: {reason(error)}") from None
    try:
        with as_run_error(path):
            yield unfinished
            _sync(unfinished)
            try:
                unfinished.rename(path)
            except OSError:
                if not path.exists():
                    raise
                raise InputError(_exists(path)) from None  # somebody was quicker
            _sync(path.parent)
    except BaseException as error:
        if keep and unfinished.is_dir() and any(unfinished.iterdir()):
            error.add_note(f"what was finished is in {unfinished}")
        else:
            shutil.rmtree(unfinished, ignore_errors=True)
        raise


@contextlib.contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Keeps other processes out of a folder: until the end of the block, or of this process.

    Raises:
        InputError: another process is in it, or it cannot be written.
    """
    from filelock import FileLock, Timeout  # here, so that importing the package stays cheap

    try:
        held = FileLock(folder / LOCK, timeout=0).acquire()
    except Timeout:
        raise InputError(f"another process is at work in {one_line(str(folder))}") from None
    except OSError as error:
        raise InputError(f"{one_line(str(folder / LOCK))} cannot be written: {reason(error)}") from None
    with held:
        yield


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_no_link(path: Path) -> None:
    """Raises InputError where a folder in the folder is a link: that leads out of it."""
    if path.is_symlink():
        raise InputError(f"{one_line(str(path))} is a link: put the folder that it leads to in its place")


def own_folder(path: Path) -> Path:
    """A folder in the folder, made if need be. Raises InputError where it is a link."""
    check_no_link(path)
    with as_run_error(path):
        path.mkdir(exist_ok=True)
    return path


def _unfinished(path: Path) -> Path:
    """What `path` is called until it is finished. `file_names` gives no such name."""
    return path.with_name(f".{path.name}{UNFINISHED}")


def _sync(folder: Path) -> None:
    """Brings the names in a folder to the disk."""
    if os.name == "nt":  # Windows opens no folders
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _exists(path: Path) -> str:
    return f"{one_line(str(path))} exists already; name a new folder"
