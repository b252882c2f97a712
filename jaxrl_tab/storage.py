"""Shards on disk and their manifest: what has a name is whole, and what is damaged is found.

A shard is a file of arrays. Every file is written under another name in the same folder, brought to the disk,
and only then renamed, so that a process can be killed at any moment. The manifest has the sha256 of each
file, and its own.
"""

import contextlib
import hashlib
import io
import json
import os
import re
import shutil
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxrl_tab.types import InputError, RunError

MANIFEST, SHARDS, ASIDE, LOCK = "manifest.json", "shards", "set-aside", ".lock"
UNFINISHED = ".unfinished"  # the end of the name of what is being written
ABOUT = "about"  # in a shard: which it is, of which experiment, and more facts


@contextlib.contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Where to write what shall be the file `path`, which it becomes when all is written and on the disk.

    Raises:
        RunError: it cannot be written, as where the disk is full; nothing of it is left.
    """
    unfinished = path.with_name(path.name + UNFINISHED)
    with said(path):
        try:
            yield unfinished
            with unfinished.open("rb+") as file:
                os.fsync(file.fileno())
            unfinished.replace(path)
            _sync(path.parent)
        finally:
            unfinished.unlink(missing_ok=True)


def write(path: Path, data: Any) -> None:
    """Writes text, or bytes, as a whole; see `writing`."""
    with writing(path) as unfinished:
        unfinished.write_bytes(data.encode() if isinstance(data, str) else data)


def write_json(path: Path, data: Any) -> None:
    write(path, json.dumps(data, indent=1, ensure_ascii=False) + "\n")


@contextlib.contextmanager
def said(path: Path) -> Iterator[None]:
    """An error of the system while something is written into `path` is a RunError of one line."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{path} could not be written: {_reason(error)}") from None


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Where to write the first files of the folder `path`, which appears when they are all there.

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
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


@contextlib.contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Keeps other processes out of a folder: until the end of the block, or of this process.

    Raises:
        InputError: another process is in it, or it cannot be written.
    """
    try:
        file = (folder / LOCK).open("ab")
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {_reason(error)}") from None
    with file:
        with contextlib.suppress(ImportError):  # Windows has no such locks
            import fcntl

            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"another process is at work in {folder}") from None
        yield


class Store:
    """The shards of an experiment in a folder that is locked, and the files made of them.

    To open it is to take stock: what was being written is removed, and what is damaged is set aside.

    Attributes:
        path: the folder.
        fingerprint: of the experiment.
        shards: facts about each shard that is there, by its number.
        found: what was damaged or missing, a line each.
    """

    def __init__(self, path: Path, fingerprint: str):
        self.path, self.fingerprint = path, fingerprint
        self.found: list[str] = []
        with said(path):
            (path / SHARDS).mkdir(exist_ok=True)
            for left in list(path.rglob(f"*{UNFINISHED}")):
                shutil.rmtree(left) if left.is_dir() else left.unlink()
            self._manifest = self._read_manifest()
            self._take_stock()
        self._write_manifest()

    @staticmethod
    def begin(path: Path, fingerprint: str) -> None:
        """Writes the manifest of a folder that has no shards yet."""
        _write_manifest(path, _empty(fingerprint))

    @property
    def shards(self) -> dict[int, Mapping[str, Any]]:
        return {int(Path(name).stem): facts for name, facts in self._manifest["shards"].items()}

    def write(self, number: int, arrays: Mapping[str, np.ndarray], **facts: Any) -> None:
        """Keeps a shard, with some plain facts about it.

        Raises:
            RunError: it cannot be written, as where the disk is full; nothing of it is left.
        """
        about = json.dumps({**self._about(number), **facts})
        buffer = io.BytesIO()
        np.savez(buffer, **arrays, **{ABOUT: np.array(about)})  # pyright: ignore[reportArgumentType]
        data = buffer.getbuffer()
        write(self.path / SHARDS / _name(number), data)
        self._manifest["shards"][_name(number)] = {"sha256": hashlib.sha256(data).hexdigest(), **facts}
        self._write_manifest()

    def read(self, number: int) -> dict[str, np.ndarray]:
        """The arrays of a shard that is there."""
        arrays = _load(self.path / SHARDS / _name(number))
        del arrays[ABOUT]
        return arrays

    @property
    def files(self) -> list[str]:
        """The files made of the shards; none unless all are there and whole."""
        return list(self._manifest["files"])

    def keep_files(self, files: Iterable[str]) -> None:
        """Notes that these files are finished."""
        self._manifest["files"] = {file: _sha256(self.path / file) for file in files}
        self._write_manifest()

    def set_aside(self, file: Path, what: str, then: str) -> None:
        """Moves what is damaged out of the way, and says so in `found`."""
        aside = self.path / ASIDE
        aside.mkdir(exist_ok=True)
        goal = aside / f"{sum(1 for _ in aside.iterdir())}-{file.name}"
        file.rename(goal)
        self.found.append(
            f"{file.relative_to(self.path)} {what}: it is now {goal.relative_to(self.path)}, and is {then}"
        )

    def _read_manifest(self) -> dict[str, Any]:
        file = self.path / MANIFEST
        if not file.exists():
            self.found.append(f"{MANIFEST} is missing: it is made again, of the shards")
        elif (manifest := read_manifest(self.path)) is None:
            self.set_aside(file, "is damaged", "made again, of the shards")
        elif manifest["fingerprint"] != self.fingerprint:
            self.set_aside(file, "is of another experiment", "made again, of the shards")
        else:
            return manifest
        return _empty(self.fingerprint)

    def _take_stock(self) -> None:
        shards = self._manifest["shards"]
        for name, facts in list(shards.items()):
            if not self._is_whole(self.path / SHARDS / name, facts["sha256"], "computed again"):
                del shards[name]
        for file in sorted((self.path / SHARDS).iterdir()):
            if file.name not in shards:  # written in the moment in which the process was killed
                if (facts := self._facts_in(file)) is None:
                    self.set_aside(file, "is damaged", "computed again")
                else:
                    shards[file.name] = facts
        whole = [self._is_whole(self.path / n, x, "made again") for n, x in self._manifest["files"].items()]
        if not all(whole):
            self._manifest["files"] = {}

    def _is_whole(self, file: Path, sha256: str, then: str) -> bool:
        if not file.exists():
            self.found.append(f"{file.relative_to(self.path)} is missing: it is {then}")
            return False
        if _sha256(file) != sha256:
            self.set_aside(file, "is damaged", then)
            return False
        return True

    def _facts_in(self, file: Path) -> dict[str, Any] | None:
        """What a shard says about itself; None where it is damaged, or of another experiment."""
        if not re.fullmatch(r"\d{6,}\.npz", file.name):
            return None
        with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            about = json.loads(str(_load(file)[ABOUT]))
            expected = self._about(int(file.stem))
            if expected.items() <= about.items():
                facts = {key: value for key, value in about.items() if key not in expected}
                return {"sha256": _sha256(file), **facts}
        return None

    def _about(self, number: int) -> dict[str, Any]:
        return {"experiment": self.fingerprint, "shard": number}

    def _write_manifest(self) -> None:
        _write_manifest(self.path, self._manifest)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """What is in the manifest; None where it is damaged or missing."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError, AttributeError):
        manifest = json.loads((folder / MANIFEST).read_bytes())
        if manifest.pop("sha256") == _checksum(manifest):
            return manifest
    return None


def _write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    write_json(folder / MANIFEST, manifest | {"sha256": _checksum(manifest)})


def _checksum(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _empty(fingerprint: str) -> dict[str, Any]:
    return {"fingerprint": fingerprint, "shards": {}, "files": {}}


def _name(number: int) -> str:
    return f"{number:06d}.npz"


def _load(file: Path) -> dict[str, np.ndarray]:
    """All arrays in a shard. Their checksums in the file are looked at, too."""
    with np.load(file) as arrays:
        return dict(arrays)


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


def _exists(path: Path) -> str:
    return f"{path} exists already; name a new folder"


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
