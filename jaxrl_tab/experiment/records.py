"""What a folder says about the sessions that computed it."""

import contextlib
import datetime
import platform
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.engine import provenance
from jaxrl_tab.envs import ENVIRONMENT
from jaxrl_tab.experiment import disk
from jaxrl_tab.experiment.storage import AS_WRITTEN, PROVENANCE, Store, warn_of_remake

NOT_RECORDED = "what it was computed with is not recorded"


class Origin(NamedTuple):
    """What the numbers of shards depend on beside the experiment, see `provenance`.

    Attributes:
        name: the name of this process's surroundings, which each shard that it computes records.
        changed: how they differ from those in which the shards on disk were computed, a line each.
        mixed: whether shards may be computed in spite of such differences.
    """

    name: str
    changed: list[str]
    mixed: bool

    @staticmethod
    def of(store: Store, records: Mapping[str, Any], mixed: bool, libraries: Mapping[str, str]) -> "Origin":
        now = provenance.surroundings(libraries)
        name = provenance.digest(now)
        others = origins_of(store) - {name}
        if not others:
            return Origin(name, [], mixed)
        was = recorded(records, others)
        lines = [line for session in was for line in _changes(session["surroundings"], now)]
        return Origin(name, list(dict.fromkeys(lines)) if was else [NOT_RECORDED], mixed)

    def check(self, path: Path) -> None:
        """Raises InputError where what is computed now would be numbers of another kind."""
        if self.changed and not self.mixed:
            raise InputError(
                f"what is missing in {path} would not be computed as the rest was: {'; '.join(self.changed)}; "
                f"go on with what it was, or begin a new folder with {path / AS_WRITTEN}, or allow it with "
                "--mixed (mixed=True): the report then says so"
            )


def library_versions(data: Any) -> dict[str, str]:
    """The versions of the libraries from which environments in the data of an experiment come."""
    tables = data.get("environment", []) if isinstance(data, Mapping) else []
    names = [str(table.get("name")) for table in tables if isinstance(table, Mapping)]
    versions = {}
    parts = {part for name in names for part in name.split(":")}
    for library in sorted(parts & ENVIRONMENT.libraries.keys()):
        versions[library] = "not installed"
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[library] = metadata.version(library)
    return versions


def origins_of(store: Store) -> set[str | None]:
    """The names of the surroundings in which the shards were computed."""
    return {facts.surroundings for facts in store.shards.values()}


def recorded(records: Mapping[str, Any], origins: Collection[str | None]) -> list[dict[str, Any]]:
    """The sessions in which shards of these origins were computed, in order."""
    named = [(provenance.digest(x.get("surroundings", {})), x) for x in records["sessions"]]
    return [session for name, session in named if name in origins]


def mixture(sessions: Sequence[Mapping[str, Any]]) -> str:
    """How the surroundings of these sessions differ, in one line; empty where only libraries came to others."""
    first, *others = [session["surroundings"] for session in sessions] or [{}]
    if not any(other != first for other in others):
        return NOT_RECORDED
    return "; ".join(dict.fromkeys(line for other in others for line in _changes(first, other)))


def _changes(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs, a line for each; but no library from which no environment came before."""
    return provenance.differences(
        was, {name: x for name, x in now.items() if name in was or name not in ENVIRONMENT.libraries}
    )


def settings_of(store: Store, records: Mapping[str, Any]) -> contextlib.AbstractContextManager[None]:
    """Gives JAX the settings that the shards were computed with, within the block."""
    sessions = recorded(records, origins_of(store))
    was = sessions[0]["surroundings"] if sessions else {}
    return provenance.using({name: was[name] for name in provenance.settings() if name in was})


def is_session(data: Any) -> bool:
    """Whether data are the record of a session, with the fields that are read later."""
    return (
        isinstance(data, dict)
        and isinstance(data.get("command"), str)
        and isinstance(data.get("started"), str)
    )


def records_in(path: Path) -> dict[str, Any] | None:
    """The records of all sessions in a folder; None where they are missing or damaged."""
    records = disk.read_json(path / PROVENANCE)
    if not isinstance(records, dict) or records.keys() != {"file", "sessions"}:
        return None
    if not isinstance(records["file"], str | None) or not isinstance(records["sessions"], list):
        return None
    return records if all(map(is_session, records["sessions"])) else None


def records_of(store: Store) -> dict[str, Any]:
    """The records of the processes that computed; begun anew where they are missing or damaged."""
    records = records_in(store.path)
    if records is None:
        warn_of_remake(store.path / PROVENANCE, "begun anew")
        records = {"file": None, "sessions": []}
    return records


@contextlib.contextmanager
def session(
    store: Store, records: dict[str, Any], command: str, libraries: Mapping[str, str], formats: Sequence[str]
) -> Iterator[None]:
    """Records this process as a session: when it began to compute and ended, and the formats of its pictures."""
    file = store.path / PROVENANCE
    session = {"command": command, "started": timestamp(), "ended": None, "formats": [*formats]}
    session |= _machine(libraries)
    records["sessions"].append(session)
    disk.write_json(file, records)
    try:
        yield
    finally:
        session["ended"] = timestamp()
        # The disk may be full: an error that says so is under way already.
        with contextlib.suppress(RunError):
            disk.write_json(file, records)


def _machine(libraries: Mapping[str, str]) -> dict[str, Any]:
    """What the record of a session says of this process: what its numbers depend on, and more."""
    devices = jax.devices()
    processor = provenance.cpu("model name") or platform.processor() or platform.machine()
    return {
        "surroundings": provenance.surroundings(libraries),
        "python": platform.python_version(),
        "processor": devices[0].device_kind if devices[0].platform != "cpu" else processor,
        "devices": len(devices),
        "platform": platform.platform(),
        "git_commit": provenance.git_commit(),
    }


def timestamp() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
