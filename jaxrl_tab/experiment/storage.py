"""Shards on disk and their manifest: a file is complete or not there, and damage is found out.

A shard is a file of arrays. Every file is written under another name in the same folder, brought to the disk,
and only then renamed, so that a process can be killed at any moment. The manifest has the sha256 of each
file, and its own.

Nothing that is read is trusted: folders are damaged by disks, and sent by others. A manifest with entries
that this module does not write counts as damaged, and only files in the folder itself are looked at.
"""

import contextlib
import errno
import functools
import hashlib
import io
import json
import logging
import math
import os
import re
import shutil
import stat
import time
import unicodedata
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jaxrl_tab.core.errors import InputError, RunError, is_whole, one_line, reason

MANIFEST, SHARDS, PICTURES, ASIDE, LOCK = "manifest.json", "shards", "pictures", "set-aside", ".lock"
UNFINISHED = ".unfinished"  # while NAME is being written, it is called .NAME.unfinished
ABOUT = "about"  # the array in a shard that tells its number, its experiment, and its `Facts`
SMALL = 2**20  # bytes of a shard that is written and read at once
SYNC_SECONDS = 1.0  # for which shards may be lost where the power fails: they are computed again
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
        aside = _own_folder(folder / ASIDE)
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


Shapes: TypeAlias = Mapping[str, tuple[Any, Any]]


class Facts(NamedTuple):
    """What the manifest says of a shard.

    Attributes:
        sha256: of the file, in hexadecimal digits.
        diverged: how many of its runs diverged.
        setting: the number of the setting that was chosen, where its runs are on fresh seeds.
        surroundings: the name of the surroundings in which it was computed, see `provenance`; None where an
            earlier version, which did not record it, computed it.
    """

    sha256: str
    diverged: int
    setting: int | None
    surroundings: str | None = None


class Store:
    """The shards of an experiment in a folder that is locked, and the files made of them.

    To open it is to take stock: files that were never finished are removed, damaged ones are set aside.

    Attributes:
        path: the folder.
        fingerprint: of the experiment.
        earlier: what the experiment was before it grew, as `is_history` has it, by fingerprint; shards of these
            are its own.
        shards: facts about each shard that is there, by its number.
        problems: what was damaged or missing, a line each.

    Raises:
        InputError: a folder in it is a link.
        RunError: something in it cannot be read or written.
    """

    def __init__(self, path: Path, fingerprint: str, earlier: Mapping[str, dict[str, Any]] | None = None):
        self.path, self.fingerprint, self.earlier = path, fingerprint, earlier or {}
        self.problems: list[str] = []
        if is_file(path / SHARDS):
            self.problems.append(set_aside(path / SHARDS, path, "made again", "is no folder"))
        _own_folder(path / SHARDS)
        with as_run_error(path):
            for folder in [path, *_folders(path / PICTURES), path / SHARDS]:
                for leftover in list(folder.glob(f".*{UNFINISHED}")):
                    is_folder = leftover.is_dir() and not leftover.is_symlink()
                    shutil.rmtree(leftover) if is_folder else leftover.unlink()
        self._manifest = self._read_manifest()
        self._synced = -SYNC_SECONDS
        self._shapes: dict[int, Shapes] = {}  # of shards that were opened or written
        self._kinds: dict[Any, Shapes] = {}  # the different ones among these, each once
        entries, self._manifest["shards"] = self._manifest["shards"], {}  # which are kept once, in `shards`
        self.shards = {int(name[:-4]): Facts(**facts) for name, facts in entries.items()}
        self._take_stock()
        self.write_manifest()

    @staticmethod
    def begin(path: Path, fingerprint: str) -> None:
        """Writes the manifest of a folder that has no shards yet."""
        _write_manifest(path, _empty(fingerprint))

    def write(
        self,
        number: int,
        arrays: Mapping[str, np.ndarray],
        diverged: int = 0,
        setting: int | None = None,
        surroundings: str | None = None,
    ) -> None:
        """Writes a shard, with its `Facts`. Of many in a second only one is synced.

        The manifest is written for every fourth part of shards more, since writing it takes the longer the more there
        are. Until then a shard says about itself what the manifest would say, but for its checksum.

        Raises:
            RunError: it cannot be written, as where the disk is full; nothing of it is left.
        """
        if number in self._listed and number not in self.shards:  # with the checksum of what is set aside
            self.write_manifest()
        facts = {"diverged": diverged, "setting": setting, "surroundings": surroundings}
        about = np.array(json.dumps(self._about(number) | facts))
        sync = time.monotonic() >= self._synced + SYNC_SECONDS
        with writing(self.path / SHARDS / _name(number), sync) as unfinished:
            sha256 = _save(unfinished, {**arrays, ABOUT: about})
        if sync:
            self._synced = time.monotonic()
        self.shards[number] = Facts(sha256, **facts)
        self._shapes[number] = self._once({name: (x.shape, x.dtype) for name, x in arrays.items()})
        if len(self.shards) - len(self._listed) > len(self._listed) // 4:
            self.write_manifest()

    def read(self, number: int, but: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
        """The arrays of a shard that is there, but for those whose names begin so."""
        return self._of_arrays(number, _array, but)

    def shapes(self, number: int) -> "Shapes":
        """(shape, dtype) of each array of a shard that is there, by its name."""
        if number not in self._shapes:
            self._shapes[number] = self._once(self._of_arrays(number, _shape))
        return self._shapes[number]

    def _once(self, shapes: Shapes) -> Shapes:
        return self._kinds.setdefault(tuple(shapes.items()), shapes)

    def _of_arrays(self, number: int, *of: Any) -> dict[str, Any]:
        """What `_load` gives of a shard that is there."""
        file = self.path / SHARDS / _name(number)
        with as_run_error(file, "read"):
            found = _load(file, *of)
        if found is None:
            raise RunError(f"{file} was damaged while it was in use")
        return {name: x for name, x in found.items() if name != ABOUT}

    def leave_out(self, number: int) -> None:
        """Sets a shard aside that is whole, and holds what is not of use here."""
        file = self.path / SHARDS / _name(number)
        self.problems.append(set_aside(file, self.path, "computed again", "is not as this version writes it"))
        del self.shards[number]
        self._shapes.pop(number, None)

    @property
    def files(self) -> list[str]:
        """The files made of the shards; none unless all are there and whole."""
        return list(self.checksums)

    @property
    def checksums(self) -> dict[str, str]:
        """The checksums of these files."""
        return self._manifest["files"]

    def keep_files(self, files: Iterable[str]) -> None:
        """Notes that these files are finished. Others that were made before the experiment grew go."""
        with as_run_error(self.path, "read"):
            self._manifest["files"] = {file: _sha256(self.path / file) for file in files}
        self.write_manifest()
        with as_run_error(self.path, "removed"):
            for name, sha256 in (x for entry in self.earlier.values() for x in entry["files"].items()):
                file = self.path / name
                if name not in self.checksums and is_file(file) and _sha256(file) == sha256:
                    file.unlink()

    def _read_manifest(self) -> dict[str, Any]:
        file = self.path / MANIFEST
        if not os.path.lexists(file):
            self.problems.append(f"{MANIFEST} is missing: it is made again, of the shards")
        elif (manifest := read_manifest(self.path)) is None:
            self.problems.append(set_aside(file, self.path, "made again, of the shards"))
        elif manifest["fingerprint"] == self.fingerprint:
            return manifest
        elif manifest["fingerprint"] in self.earlier:
            return _empty(self.fingerprint) | {"shards": manifest["shards"]}
        else:
            what = "is of another experiment"
            self.problems.append(set_aside(file, self.path, "made again, of the shards", what))
        return _empty(self.fingerprint)

    def _take_stock(self) -> None:
        folder = self.path / SHARDS
        for number, facts in list(self.shards.items()):
            if not self._is_whole(folder / _name(number), facts.sha256, "computed again"):
                del self.shards[number]
        for file in sorted(folder.glob("*.npz")):
            number = _number(file.name)
            # A process may have been killed after it wrote a shard, and before it wrote the manifest.
            if number is not None and number not in self.shards:
                if (facts := self._facts_in(file, number)) is None:
                    self.problems.append(set_aside(file, self.path, "computed again"))
                else:
                    self.shards[number] = facts
        whole = [self._is_whole(self.path / n, x, "made again") for n, x in self._manifest["files"].items()]
        if not all(whole):
            self._manifest["files"] = {}

    def _is_whole(self, file: Path, sha256: str, remedy: str) -> bool:
        if not os.path.lexists(file):
            self.problems.append(f"{file.relative_to(self.path)} is missing: it is {remedy}")
            return False
        with as_run_error(file, "read"):
            if is_file(file) and _sha256(file) == sha256:
                return True
        self.problems.append(set_aside(file, self.path, remedy))
        return False

    def _facts_in(self, file: Path, number: int) -> Facts | None:
        """What a shard says about itself; None where it is damaged, or of another experiment."""
        with as_run_error(file, "read"):
            arrays = _load(file) if is_file(file) else None
            sha256 = _sha256(file) if arrays else ""
        try:
            about = json.loads(str((arrays or {})[ABOUT]))
            facts = {"sha256": sha256, **{key: about.pop(key) for key in Facts._fields if key in about}}
        except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
            return None
        ours = [self._about(number, fingerprint) for fingerprint in (self.fingerprint, *self.earlier)]
        return Facts(**facts) if about in ours and _are_facts(facts) else None

    def _about(self, number: int, fingerprint: str | None = None) -> dict[str, Any]:
        return {"experiment": fingerprint or self.fingerprint, "shard": number}

    def write_manifest(self) -> None:
        """Writes the manifest, with all shards that are there.

        Raises:
            RunError: it cannot be written.
        """
        shards = {_name(number): facts._asdict() for number, facts in sorted(self.shards.items())}
        if self.earlier:
            self._manifest["history"] = list(self.earlier.values())
        _write_manifest(self.path, self._manifest | {"shards": shards})
        self._listed = set(self.shards)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """What is in the manifest; None where it is damaged or missing."""
    manifest = read_json(folder / MANIFEST)
    keys = {"fingerprint", "shards", "files", "sha256"}
    if not isinstance(manifest, dict) or manifest.keys() - {"history"} != keys:
        return None
    if manifest.pop("sha256") != _checksum(manifest):
        return None
    shards, files = manifest["shards"], manifest["files"]
    if not isinstance(shards, dict):
        return None
    if not all(_number(name) is not None and _are_facts(facts) for name, facts in shards.items()):
        return None
    return manifest if _are_files(files) and is_history(manifest.get("history", [])) else None


def is_history(data: Any) -> bool:
    """Whether data are a list of what an experiment was before it grew.

    For each it is the data of the experiment, the files that were made of it with their checksums, and when and by
    what command it grew.
    """
    return isinstance(data, list) and all(
        isinstance(entry, dict)
        and entry.keys() == {"experiment", "files", "time", "command"}
        and isinstance(entry["experiment"], dict)
        and _are_files(entry["files"])
        and isinstance(entry["time"], str)
        and isinstance(entry["command"], str)
        for entry in data
    )


def _are_files(files: Any) -> bool:
    return isinstance(files, dict) and all(_is_result_file(f) and _is_sha256(x) for f, x in files.items())


def has_checksum(file: Path, sha256: str) -> bool:
    """Whether a file has this checksum; False where it is missing, too. Nothing is set aside."""
    with as_run_error(file, "read"):
        return is_file(file) and _sha256(file) == sha256


def peek(folder: Path, number: int, sha256: str) -> dict[str, np.ndarray] | None:
    """The arrays of a shard in a folder that is only looked at; None where it is missing or damaged."""
    file = folder / SHARDS / _name(number)
    if not has_checksum(file, sha256):
        return None
    with as_run_error(file, "read"):
        found = _load(file)
    return found and {name: x for name, x in found.items() if name != ABOUT}


def _are_facts(facts: Any) -> bool:
    return (
        isinstance(facts, dict)
        and facts.keys() | Facts._field_defaults.keys() == set(Facts._fields)
        and _is_sha256(facts["sha256"])
        and is_whole(facts["diverged"], least=0)
        and (facts["setting"] is None or is_whole(facts["setting"], least=0))
        and isinstance(facts.get("surroundings"), str | None)
    )


def _is_sha256(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value) is not None


def _is_result_file(file: str) -> bool:
    """Whether it may be a file that is made of the shards, such as "results.nc" or "pictures/walk/path.png"."""
    name = r"\w[\w=,.+-]*"
    return bool(re.fullmatch(rf"({PICTURES}/{name}/)?{name}\.(nc|csv|html|png|svg|pdf)", file, re.ASCII))


def _write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    # In one line: broken into lines it takes five times as long, and there may be very many shards.
    whole = json.dumps(manifest | {"sha256": _checksum(manifest)}, ensure_ascii=False)
    write(folder / MANIFEST, whole + "\n")


def _checksum(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _empty(fingerprint: str) -> dict[str, Any]:
    return {"fingerprint": fingerprint, "shards": {}, "files": {}}


def check_no_link(path: Path) -> None:
    """Raises InputError where a folder in the folder is a link: that leads out of it."""
    if path.is_symlink():
        raise InputError(f"{one_line(str(path))} is a link: put the folder that it leads to in its place")


def _own_folder(path: Path) -> Path:
    """A folder in the folder, made if need be. Raises InputError where it is a link."""
    check_no_link(path)
    with as_run_error(path):
        path.mkdir(exist_ok=True)
    return path


def _folders(path: Path) -> list[Path]:
    """The folder of pictures, if there is any, and those in it."""
    if not path.exists():
        return []
    return [_own_folder(path), *(_own_folder(x) for x in path.iterdir() if x.is_dir())]


def _unfinished(path: Path) -> Path:
    """What `path` is called until it is finished. `file_names` gives no such name."""
    return path.with_name(f".{path.name}{UNFINISHED}")


def _name(number: int) -> str:
    return f"{number:06d}.npz"


def _number(name: str) -> int | None:
    """The number of the shard that has this file; None where it is no shard."""
    if re.fullmatch(r"\d{6,9}\.npz", name, re.ASCII) and _name(number := int(name[:-4])) == name:
        return number
    return None


def _save(file: Path, arrays: Mapping[str, np.ndarray]) -> str:
    """As `np.savez`, in a fraction of its time for small arrays; gives the checksum of the file."""
    with file.open("wb+") as opened:
        is_small = sum(x.nbytes for x in arrays.values()) < SMALL
        goal = io.BytesIO() if is_small else opened  # a zip file is written in very many pieces
        with zipfile.ZipFile(goal, "w") as whole:
            for name, x in arrays.items():
                header, member = _header_of(x.dtype, x.shape), zipfile.ZipInfo(f"{name}.npy")
                member.file_size = len(header) + x.nbytes
                with whole.open(member, "w") as array:
                    array.write(header)
                    array.write(np.ascontiguousarray(x).data)
        if isinstance(goal, io.BytesIO):
            opened.write(goal.getbuffer())
        opened.seek(0)
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _load(file: Path, of: Any = None, but: tuple[str, ...] = ()) -> dict[str, Any] | None:
    """The arrays in a shard, or what `of` reads of each; None where it is damaged.

    The checksums in the file are looked at, too. Arrays whose names begin as one of `but` are left out.
    """
    with file.open("rb") as opened:
        try:
            is_small = os.fstat(opened.fileno()).st_size < SMALL  # it is read in very many pieces, too
            with zipfile.ZipFile(io.BytesIO(opened.read()) if is_small else opened) as whole:
                members = whole.infolist()
                if any(x.compress_type or x.file_size != x.compress_size for x in members):
                    return None  # we pack nothing, and what is packed could unpack to any size
                arrays = {}
                for member in members:
                    if member.filename.startswith(but):
                        continue
                    with whole.open(member) as array:
                        arrays[member.filename.removesuffix(".npy")] = (of or _array)(array)
                return arrays
        except Exception as error:  # there is no end to what a flipped bit makes zipfile and NumPy raise
            # EINVAL is damage, too: an offset that lies outside of the file.
            if isinstance(error, OSError) and error.errno != errno.EINVAL:
                raise
            return None


def _array(file: Any) -> np.ndarray:
    """An array in a file, which cannot be written to."""
    (shape, dtype), data = _shape(file), file.read()
    if dtype.hasobject or len(data) != dtype.itemsize * math.prod(shape):
        raise ValueError("it is not what we write")
    return np.ndarray(shape, dtype, data)


def _shape(file: Any) -> tuple[Any, Any]:
    """(shape, dtype) of an array in a file, of which only the header is read."""
    start = file.read(10)
    return _parsed(start + file.read(int.from_bytes(start[8:], "little")))


# The shards of an experiment have few different headers, which take longer than all else in a small one.
@functools.lru_cache(maxsize=256)
def _header_of(dtype: np.dtype, shape: tuple[int, ...]) -> bytes:
    about = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, about)
    return file.getvalue()


@functools.lru_cache(maxsize=256)
def _parsed(header: bytes) -> tuple[Any, Any]:
    file = io.BytesIO(header)
    version = np.lib.format.read_magic(file)
    shape, is_other_way_round, dtype = np.lib.format.read_array_header_1_0(file)
    if version != (1, 0) or is_other_way_round:
        raise ValueError("it is not what we write")
    return shape, dtype


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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


AS_WRITTEN, RESOLVED, PROVENANCE = "experiment.toml", "resolved.json", "provenance.json"
DATA, FRESH_DATA, SUMMARY, SELECTION = "results.nc", "fresh.nc", "summary.csv", "selection.csv"
VERDICT, SEARCH = "verdict.csv", "search.csv"


def warn(line: str) -> None:
    logging.getLogger(__name__).warning("%s", line)


def warn_of_remake(file: Path, remedy: str) -> None:
    """Says that a file is made again; what is there now is set aside."""
    if os.path.lexists(file):
        warn(set_aside(file, file.parent, remedy))
    else:
        warn(f"{file.name} is missing: it is {remedy}")
