"""Shards on disk and their manifest: a file is complete or not there, and damage is found out.

A shard is a file of arrays (see `packed`), written as a whole (see `disk`). The manifest has the sha256 of each file,
and its own.

Nothing that is read is trusted: folders are damaged by disks, and sent by others. A manifest with entries
that this module does not write counts as damaged, and only files in the folder itself are looked at.
"""

import hashlib
import json
import logging
import os
import re
import shutil
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jaxrl_tab.core.errors import RunError, is_whole
from jaxrl_tab.experiment import disk, packed

MANIFEST, SHARDS, PICTURES = "manifest.json", "shards", "pictures"
ABOUT = "about"  # the array in a shard that tells its number, its experiment, and its `Facts`
SYNC_SECONDS = 1.0  # for which shards may be lost where the power fails: they are computed again

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
        if disk.is_file(path / SHARDS):
            self.problems.append(disk.set_aside(path / SHARDS, path, "made again", "is no folder"))
        disk.own_folder(path / SHARDS)
        with disk.as_run_error(path):
            for folder in [path, *_folders(path / PICTURES), path / SHARDS]:
                for leftover in list(folder.glob(f".*{disk.UNFINISHED}")):
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
        with disk.writing(self.path / SHARDS / _name(number), sync) as unfinished:
            sha256 = packed.save(unfinished, {**arrays, ABOUT: about})
        if sync:
            self._synced = time.monotonic()
        self.shards[number] = Facts(sha256, **facts)
        self._shapes[number] = self._once({name: (x.shape, x.dtype) for name, x in arrays.items()})
        if len(self.shards) - len(self._listed) > len(self._listed) // 4:
            self.write_manifest()

    def read(self, number: int, but: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
        """The arrays of a shard that is there, but for those whose names begin so."""
        return self._of_arrays(number, packed.array_of, but)

    def shapes(self, number: int) -> "Shapes":
        """(shape, dtype) of each array of a shard that is there, by its name."""
        if number not in self._shapes:
            self._shapes[number] = self._once(self._of_arrays(number, packed.shape_of))
        return self._shapes[number]

    def _once(self, shapes: Shapes) -> Shapes:
        return self._kinds.setdefault(tuple(shapes.items()), shapes)

    def _of_arrays(self, number: int, *of: Any) -> dict[str, Any]:
        """What `packed.load` gives of a shard that is there."""
        file = self.path / SHARDS / _name(number)
        with disk.as_run_error(file, "read"):
            found = packed.load(file, *of)
        if found is None:
            raise RunError(f"{file} was damaged while it was in use")
        return {name: x for name, x in found.items() if name != ABOUT}

    def leave_out(self, number: int) -> None:
        """Sets a shard aside that is whole, and holds what is not of use here."""
        file = self.path / SHARDS / _name(number)
        self.problems.append(
            disk.set_aside(file, self.path, "computed again", "is not as this version writes it")
        )
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
        with disk.as_run_error(self.path, "read"):
            self._manifest["files"] = {file: disk.sha256_of(self.path / file) for file in files}
        self.write_manifest()
        with disk.as_run_error(self.path, "removed"):
            for name, sha256 in (x for entry in self.earlier.values() for x in entry["files"].items()):
                file = self.path / name
                if name not in self.checksums and disk.is_file(file) and disk.sha256_of(file) == sha256:
                    file.unlink()

    def _read_manifest(self) -> dict[str, Any]:
        file = self.path / MANIFEST
        if not os.path.lexists(file):
            self.problems.append(f"{MANIFEST} is missing: it is made again, of the shards")
        elif (manifest := read_manifest(self.path)) is None:
            self.problems.append(disk.set_aside(file, self.path, "made again, of the shards"))
        elif manifest["fingerprint"] == self.fingerprint:
            return manifest
        elif manifest["fingerprint"] in self.earlier:
            return _empty(self.fingerprint) | {"shards": manifest["shards"]}
        else:
            what = "is of another experiment"
            self.problems.append(disk.set_aside(file, self.path, "made again, of the shards", what))
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
                    self.problems.append(disk.set_aside(file, self.path, "computed again"))
                else:
                    self.shards[number] = facts
        whole = [self._is_whole(self.path / n, x, "made again") for n, x in self._manifest["files"].items()]
        if not all(whole):
            self._manifest["files"] = {}

    def _is_whole(self, file: Path, sha256: str, remedy: str) -> bool:
        if not os.path.lexists(file):
            self.problems.append(f"{file.relative_to(self.path)} is missing: it is {remedy}")
            return False
        with disk.as_run_error(file, "read"):
            if disk.is_file(file) and disk.sha256_of(file) == sha256:
                return True
        self.problems.append(disk.set_aside(file, self.path, remedy))
        return False

    def _facts_in(self, file: Path, number: int) -> Facts | None:
        """What a shard says about itself; None where it is damaged, or of another experiment."""
        with disk.as_run_error(file, "read"):
            arrays = packed.load(file) if disk.is_file(file) else None
            sha256 = disk.sha256_of(file) if arrays else ""
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
    manifest = disk.read_json(folder / MANIFEST)
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
    with disk.as_run_error(file, "read"):
        return disk.is_file(file) and disk.sha256_of(file) == sha256


def peek(folder: Path, number: int, sha256: str) -> dict[str, np.ndarray] | None:
    """The arrays of a shard in a folder that is only looked at; None where it is missing or damaged."""
    file = folder / SHARDS / _name(number)
    if not has_checksum(file, sha256):
        return None
    with disk.as_run_error(file, "read"):
        found = packed.load(file)
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
    disk.write(folder / MANIFEST, whole + "\n")


def _checksum(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _empty(fingerprint: str) -> dict[str, Any]:
    return {"fingerprint": fingerprint, "shards": {}, "files": {}}


def _folders(path: Path) -> list[Path]:
    """The folder of pictures, if there is any, and those in it."""
    if not path.exists():
        return []
    return [disk.own_folder(path), *(disk.own_folder(x) for x in path.iterdir() if x.is_dir())]


def _name(number: int) -> str:
    return f"{number:06d}.npz"


def _number(name: str) -> int | None:
    """The number of the shard that has this file; None where it is no shard."""
    if re.fullmatch(r"\d{6,9}\.npz", name, re.ASCII) and _name(number := int(name[:-4])) == name:
        return number
    return None


AS_WRITTEN, RESOLVED, PROVENANCE = "experiment.toml", "resolved.json", "provenance.json"
DATA, FRESH_DATA, SUMMARY, SELECTION = "results.nc", "fresh.nc", "summary.csv", "selection.csv"
VERDICT, SEARCH = "verdict.csv", "search.csv"


def warn(line: str) -> None:
    logging.getLogger(__name__).warning("%s", line)


def warn_of_remake(file: Path, remedy: str) -> None:
    """Says that a file is made again; what is there now is set aside."""
    if os.path.lexists(file):
        warn(disk.set_aside(file, file.parent, remedy))
    else:
        warn(f"{file.name} is missing: it is {remedy}")
