"""The copies that a folder keeps of the files that somebody's own classes and tables are in.

They are in `sources/`, where `sources.json` says what each name stood for. A copy is known by its checksum alone,
which the data of the experiment have, too: one that was altered is another file, and is not used.
"""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxrl_tab.algorithms.prediction import METHOD
from jaxrl_tab.core import names
from jaxrl_tab.core.checks import InputError
from jaxrl_tab.envs import ENVIRONMENT
from jaxrl_tab.experiment import storage

SOURCES, INDEX = "sources", "sources.json"
KEYS = {"name", "label", "sha256", "original", "copy"}


def write(folder: Path, references: Mapping[str, names.Reference]) -> None:
    """Keeps copies of the files that classes and tables are in. Raises InputError where something is in none."""
    for reference in references.values():
        if reference.refusal:
            raise InputError(f"{reference.refusal}; or run it without a folder")
    own = {typed: reference for typed, reference in references.items() if reference.file}
    if not own:
        return
    (folder / SOURCES).mkdir()
    files = {reference.file for reference in own.values() if reference.file}
    often = Counter(Path(file.path).name.lower() for file in files)
    index = {}
    for typed, reference in own.items():
        file = reference.file
        assert file is not None
        path = Path(file.path)
        copy = path.name if often[path.name.lower()] == 1 else f"{path.stem}-{file.sha256[:8]}{path.suffix}"
        storage.write(folder / SOURCES / copy, file.data)
        about = {"name": reference.name, "label": reference.label, "sha256": file.sha256}
        index[typed] = about | {"original": file.path if path.is_absolute() else None, "copy": copy}
    storage.write_json(folder / SOURCES / INDEX, index)


def read(folder: Path, data: Any) -> dict[str, dict[str, Any]]:
    """What the names of an experiment stand for, from the copies in its folder, whose checksums are checked.

    Args:
        folder: of the experiment.
        data: of the experiment; not a dict where they are lost.

    Raises:
        InputError: a copy is missing or was altered; or the original file was changed since.
    """
    index = storage.read_json(folder / SOURCES / INDEX)
    index = index if isinstance(index, dict) and all(map(_is_entry, index.values())) else {}
    copies = folder / SOURCES
    storage.check_no_link(copies)
    files = [names.read(path) for path in copies.glob("*") if storage.is_file(path) and path.name != INDEX]
    names.keep(files)
    names.forget(files)
    for entry in index.values():
        original = Path(entry["original"] or "")
        if entry["original"] and original.is_file() and names.read(original).sha256 != entry["sha256"]:
            way = "" if _is_module(entry["name"]) else ", or rename it to go on with the copy"
            raise InputError(
                f"{original} was changed since: put it back as it was (its copy is {copies / entry['copy']}){way}"
            )
    kept = {file.sha256 for file in files}
    for kind, key in ((ENVIRONMENT, "environment"), (METHOD, "method")):
        for table in data.get(key, []) if isinstance(data, dict) else []:
            if not isinstance(table, dict) or not isinstance(name := table.get("name"), str):
                continue  # damaged, as is found out later
            if "sha256" in table and not _is_module(name) and table["sha256"] not in kept:
                raise InputError(
                    f"the copy of {name} in {copies} is missing or was altered: put the file back whose SHA-256 "
                    f"is {table['sha256']}"
                )
            if "sha256" in table:
                names.find(kind, name, None, table["sha256"])
    return index


def _is_module(name: str) -> bool:
    """Whether it names a class in a module, which is imported and not loaded from its copy."""
    return not name.endswith(".npz") and not name.rpartition(":")[0].endswith(".py")


def _is_entry(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and entry.keys() == KEYS
        and all(isinstance(entry[key], str) for key in KEYS - {"original"})
        and isinstance(entry["original"], str | None)
    )
