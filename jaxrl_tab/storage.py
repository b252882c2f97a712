"""Shards on disk and their manifest: what has a name is whole, and what is damaged is found.

A shard is a file of arrays. Every file is written under another name in the same folder, brought to the disk, and
only then renamed, so a process can be killed at any moment. The manifest knows the sha256 of each, and its own.
"""

import contextlib
import hashlib
import io
import json
import os
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from jaxrl_tab.types import InputError, RunError

MANIFEST, SHARDS, ASIDE = "manifest.json", "shards", "set-aside"
UNFINISHED = ".unfinished"  # the end of the name of a file that is being written
ABOUT = "about"  # of a shard: which it is, of which experiment


@contextlib.contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Where to write what shall be the file `path`, which it becomes when all is written and on the disk.

    Raises:
        RunError: it cannot be written, as where the disk is full; nothing of it is left.
    """
    unfinished = path.with_name(path.name + UNFINISHED)
    try:
        yield unfinished
        with unfinished.open("rb+") as file:
            os.fsync(file.fileno())
        unfinished.replace(path)
        _sync(path.parent)
    except OSError as error:
        raise RunError(f"{path} could not be written: {_reason(error)}") from None
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)


def write(path: Path, data: Any) -> None:
    """Writes bytes, or text, as a whole; see `writing`."""
    with writing(path) as unfinished:
        unfinished.write_bytes(data.encode() if isinstance(data, str) else data)


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Where to write what shall be the new folder `path`, which it becomes when its first files are all there.

    Raises:
        InputError: there is something already, or it cannot be made.
    """
    unfinished = path.with_name(f".{path.name}{UNFINISHED}-{os.getpid()}")
    try:
        if path.exists() or path.is_symlink():
            raise InputError(_exists(path))
        unfinished.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{path} cannot be made: {_reason(error)}") from None
    try:
        yield unfinished
        _sync(unfinished)
        try:
            unfinished.rename(path)
        except OSError:  # somebody was quicker
            raise InputError(_exists(path)) from None
        _sync(path.parent)
    except BaseException:
        _remove(unfinished)
        raise


class Store:
    """The shards of one experiment in a folder, and the files made of them. One process at a time has it open.

    Attributes:
        path: the folder.
        fingerprint: of the experiment.
        finished: the numbers of the shards that are there.
        found: what `open` found damaged or missing, a line each.
    """

    def __init__(self, path: Path, fingerprint: str):
        self.path, self.fingerprint = path, fingerprint
        self.finished: set[int] = set()
        self.found: list[str] = []
        self._manifest = _empty(fingerprint)

    @classmethod
    @contextlib.contextmanager
    def open(cls, path: Path, fingerprint: str) -> Iterator[Self]:
        """Takes stock of a folder that `lock` has: what is damaged is set aside, what was unfinished removed."""
        store = cls(path, fingerprint)
        (path / SHARDS).mkdir(exist_ok=True)
        for folder in (path, path / SHARDS):
            for file in folder.glob(f"*{UNFINISHED}"):
                file.unlink()
        store._take_stock()
        yield store

    def write(self, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps a shard. Raises RunError where it cannot be written; nothing of it is left then."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays, **{ABOUT: np.array(self._about(number))})
        data = buffer.getbuffer()
        file = self.path / SHARDS / _name(number)
        write(file, data)
        self._keep_shard(number, hashlib.sha256(data).hexdigest())
        self._write_manifest()

    def read(self, number: int) -> dict[str, np.ndarray]:
        """The arrays of a shard that is there."""
        arrays = _load(self.path / SHARDS / _name(number))
        del arrays[ABOUT]
        return arrays

    def note(self, **facts: Any) -> None:
        """Keeps plain data in the manifest."""
        self._manifest["notes"].update(facts)
        self._write_manifest()

    @property
    def notes(self) -> Mapping[str, Any]:
        return self._manifest["notes"]

    def keep_files(self, names: list[str]) -> None:
        """Notes that files in the folder, made of the shards, are finished."""
        self._manifest["files"] = {name: _sha256(self.path / name) for name in names}
        self._write_manifest()

    @property
    def files(self) -> list[str]:
        """The files made of the shards that are there, if all are."""
        return list(self._manifest["files"])

    def forget_files(self) -> None:
        self._manifest["files"] = {}

    def _take_stock(self) -> None:
        manifest = self.path / MANIFEST
        with contextlib.suppress(FileNotFoundError):
            if (read := _read_manifest(manifest)) is None:
                self._set_aside(manifest, "is damaged", "it is made again of the shards")
            elif read["fingerprint"] != self.fingerprint:
                self._set_aside(manifest, "is of another experiment", "it is made again")
            else:
                self._manifest = read
        for name, sha256 in list(self._manifest["shards"].items()):
            file = self.path / SHARDS / name
            if not self._is_whole(file, sha256, "computed"):
                del self._manifest["shards"][name]
        for file in sorted((self.path / SHARDS).iterdir()):
            if file.name not in self._manifest["shards"]:  # written just before the process was killed
                self._adopt(file)
        self.finished = {int(Path(name).stem) for name in self._manifest["shards"]}
        if not all([self._is_whole(self.path / n, s, "made") for n, s in self._manifest["files"].items()]):
            self.forget_files()
        self._write_manifest()

    def _is_whole(self, file: Path, sha256: str, done: str) -> bool:
        if not file.exists():
            self.found.append(f"{file.relative_to(self.path)} is missing: it is {done} again")
            return False
        if _sha256(file) != sha256:
            self._set_aside(file, "is damaged", f"it is {done} again")
            return False
        return True

    def _adopt(self, file: Path) -> None:
        number = int(found[1]) if (found := re.fullmatch(r"(\d+)\.npz", file.name)) else -1
        try:
            whole = _load(file)[ABOUT] == self._about(number) and file.name == _name(number)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError):
            whole = False
        if whole:
            self._keep_shard(number, _sha256(file))
        else:
            self._set_aside(file, "is damaged", "it is computed again")

    def _keep_shard(self, number: int, sha256: str) -> None:
        self._manifest["shards"][_name(number)] = sha256
        self.finished.add(number)

    def _set_aside(self, file: Path, what: str, then: str) -> None:
        aside = self.path / ASIDE
        aside.mkdir(exist_ok=True)
        number = sum(1 for _ in aside.iterdir())
        goal = aside / f"{file.name}.{number}"
        file.rename(goal)
        where = goal.relative_to(self.path)
        self.found.append(f"{file.relative_to(self.path)} {what}: it is in {where} now, and {then}")

    def _about(self, number: int) -> str:
        return f"shard {number} of {self.fingerprint}"

    def _write_manifest(self) -> None:
        write(self.path / MANIFEST, _manifest_text(self._manifest))


@contextlib.contextmanager
def lock(path: Path) -> Iterator[None]:
    """Holds a file, so that no other process can: it is locked for as long as this one lives.

    Raises:
        InputError: another process holds it, or it cannot be opened for writing.
    """
    try:
        file = path.open("rb+")
    except OSError as error:
        raise InputError(f"{path.parent} cannot be written: {_reason(error)}") from None
    with file:
        try:
            import fcntl
        except ImportError:  # Windows has no such thing
            yield
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process is at work in {path.parent}") from None
        yield


def _name(number: int) -> str:
    return f"{number:06d}.npz"


def _load(file: Path) -> dict[str, np.ndarray]:
    """All arrays of a shard; the checksums in the file are compared."""
    with np.load(file) as arrays:
        return dict(arrays)


def _empty(fingerprint: str) -> dict[str, Any]:
    return {"fingerprint": fingerprint, "shards": {}, "files": {}, "notes": {}}


def _manifest_text(manifest: Mapping[str, Any]) -> str:
    body = {key: value for key, value in manifest.items() if key != "sha256"}
    return json.dumps({**body, "sha256": _checksum(body)}, indent=1) + "\n"


def _read_manifest(path: Path) -> dict[str, Any] | None:
    """What is in the manifest; None where it is damaged."""
    try:
        manifest = json.loads(path.read_bytes())
        checksum = manifest.pop("sha256")
    except (ValueError, KeyError, AttributeError, TypeError):
        return None
    return manifest if checksum == _checksum(manifest) else None


def _checksum(body: Any) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(folder: Path) -> None:
    """Brings the names in a folder to the disk."""
    if os.name == "nt":  # which opens no folders
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove(folder: Path) -> None:
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()


def _exists(path: Path) -> str:
    what = "" if path.is_dir() else ", and is no folder"
    return f"{path} exists already{what}; name a new folder"


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
