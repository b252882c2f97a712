"""The copies that a folder keeps of the files that somebody's own classes, functions and tables are in.

They are in `sources/`, where `sources.json` says what each name stood for. A copy, with those of the files that it
imports, is known by its checksum alone, which the data of the experiment have, too: one that was altered is another
file, and is not used.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxrl_tab.core import modules, names
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.modules import File
from jaxrl_tab.engine.budget import RECORDER
from jaxrl_tab.envs import ENVIRONMENT
from jaxrl_tab.experiment import disk
from jaxrl_tab.methods import METHOD

SOURCES, INDEX = "sources", "sources.json"
KEYS = {"name", "label", "sha256", "original", "copies"}


def write(folder: Path, references: Mapping[str, names.Reference]) -> None:
    """Keeps copies of the files that names stand for, beside those that are there.

    Raises:
        InputError: something is in no file.
    """
    for reference in references.values():
        if reference.refusal:
            raise InputError(f"{reference.refusal}; or run it without a folder")
    index = _index(folder)
    own = {
        typed: (reference, reference.file)
        for typed, reference in references.items()
        if reference.file and typed not in index
    }
    if not own:
        return
    places = _places([file for _, file in own.values()], len(_folders(index)))
    for typed, (reference, file) in own.items():
        place = places[file.path, file.sha256]
        (folder / SOURCES / place).mkdir(parents=True, exist_ok=True)
        for part in (file, *file.neighbours):
            disk.write(folder / SOURCES / place / part.name, part.data)
        index[typed] = {
            "name": reference.name,
            "label": reference.label,
            "sha256": file.sha256,
            "original": file.path if Path(file.path).is_absolute() else None,
            "copies": {f"{place}{part.name}": _sha256(part) for part in (file, *file.neighbours)},
        }
    disk.write_json(folder / SOURCES / INDEX, index)


def _index(folder: Path) -> dict[str, dict[str, Any]]:
    """What each name stood for; nothing where that is missing or damaged."""
    index = disk.read_json(folder / SOURCES / INDEX)
    return index if isinstance(index, dict) and all(map(_is_entry, index.values())) else {}


def _folders(index: Mapping[str, Any]) -> set[str]:
    """The folders that have copies."""
    return {copy.rpartition("/")[0] for entry in index.values() for copy in entry["copies"]}


def _places(files: Iterable[File], taken: int) -> dict[tuple[str, str], str]:
    """The folder of the copies of each file and its neighbours, "" or such as "1/", by its path and checksum.

    The first `taken` folders are those of other files.
    A program finds there what lay beside it, and nothing else: programs of several folders are not mixed.
    """
    places, folders = {}, []
    for file in sorted(files, key=lambda file: not _is_program(file)):
        contents = {part.name.lower(): part.data for part in (file, *file.neighbours)}
        origin = Path(file.path).parent
        for number, (other, copied) in enumerate([*folders, (origin, {})]):
            is_free = all(copied.get(name, data) == data for name, data in contents.items())
            if is_free and (other == origin or not _is_program(file)):
                folders[number:] = [(other, copied | contents), *folders[number + 1 :]]
                places[file.path, file.sha256] = f"{number + taken}/" if number + taken else ""
                break
    return places


def read(folder: Path, data: Any) -> dict[str, dict[str, Any]]:
    """What the names of an experiment stand for, from the copies in its folder, whose checksums are checked.

    Args:
        folder: of the experiment.
        data: of the experiment; not a dict where they are lost.

    Raises:
        InputError: a copy is missing or was altered; or an original file was changed since.
    """
    index, copies = _index(folder), folder / SOURCES
    paths = [copies, *copies.glob("*"), *copies.glob("*/*")]
    for path in paths:
        disk.check_no_link(path)
    paths = [path for path in paths if disk.is_file(path) and path != copies / INDEX]
    alone = {path.relative_to(copies).as_posix(): modules.read(path, alone=True) for path in paths}
    files = [*alone.values(), *map(modules.read, paths)]
    modules.keep(files)
    names.forget(files)
    for entry in index.values():
        for copy, sha256 in entry["copies"].items():
            if not _is_module(entry["name"]) and (copy not in alone or alone[copy].sha256 != sha256):
                raise InputError(_altered(Path(copy).name, copies, sha256))
        _check_original(entry, copies)
    kept = {file.sha256 for file in files}
    for kind, key in ((ENVIRONMENT, "environment"), (METHOD, "method"), (RECORDER, "record")):
        tables = data.get(key, []) if isinstance(data, dict) else []
        for table in tables if isinstance(tables, list) else [tables]:
            if not isinstance(table, dict) or not isinstance(name := table.get("name"), str):
                continue  # damaged, as is found out later
            if "sha256" in table and not _is_module(name) and table["sha256"] not in kept:
                raise InputError(_altered(name, copies, table["sha256"]))
            if "sha256" in table:
                names.find(kind, name, None, table["sha256"])
    return index


def _altered(what: str, copies: Path, sha256: str) -> str:
    return f"the copy of {what} in {copies} is missing or was altered: put the file back whose SHA-256 is {sha256}"


def _check_original(entry: Mapping[str, Any], copies: Path) -> None:
    """Raises InputError where a file that is still there, or one that it imports, is not as its copy."""
    original, is_module = Path(entry["original"] or ""), _is_module(entry["name"])
    if not entry["original"] or not original.is_file():
        return
    file = modules.read(original, alone=is_module)
    now = {part.name: _sha256(part) for part in (file, *file.neighbours)}
    was = {Path(copy).name: (copy, sha256) for copy, sha256 in entry["copies"].items()}
    for name in now | was:
        if name not in was:
            raise InputError(f"{original} imports {original.with_name(name)}, which was not there before")
        copy, sha256 = was[name]
        if now.get(name) != sha256:
            what = "was changed since" if name in now else "is missing"
            it = "it" if name == original.name else original
            way = "" if is_module else f", or rename {it} to go on with the copy"
            raise InputError(
                f"{original.with_name(name)} {what}: put it back as it was (its copy is {copies / copy}){way}"
            )


def _sha256(part: File) -> str:
    """The checksum of the file alone, without its neighbours."""
    return part._replace(neighbours=()).sha256


def _is_program(file: File) -> bool:
    return file.path.endswith(".py")


def _is_module(name: str) -> bool:
    """Whether it names something in a module, which is imported and not loaded from its copy."""
    return not modules.is_table(name) and not name.rpartition(":")[0].endswith(".py")


def _is_entry(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and entry.keys() == KEYS
        and all(isinstance(entry[key], str) for key in ("name", "label", "sha256"))
        and isinstance(entry["original"], str | None)
        and isinstance(entry["copies"], dict)
        and all(isinstance(sha256, str) for sha256 in entry["copies"].values())
    )
