"""The experiment that is found in a folder: what it is, what it was before it grew, and what somebody added to it.

It is there twice, in `experiment.toml` and `resolved.json`, and its fingerprint is in the manifest: where one of the
two is missing or damaged, it is made again of the other. What it was before is in `resolved.json` and in the manifest.
Nobody edits these two; what is changed in `experiment.toml` is a wish.
"""

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import provenance
from jaxrl_tab.experiment import disk, growth, sources, storage
from jaxrl_tab.experiment.places import Source
from jaxrl_tab.experiment.records import library_versions, records_in, timestamp
from jaxrl_tab.experiment.spec import Experiment, difference
from jaxrl_tab.experiment.storage import AS_WRITTEN, RESOLVED, warn_of_remake

HISTORY = "history"  # the key in `resolved.json` of what an experiment was before
KEPT = "what is there is kept, and a folder only grows"


class Earlier(NamedTuple):
    """What an experiment was until it grew.

    Attributes:
        experiment: that.
        entry: what the folder says of it, see `storage.is_history`.
    """

    experiment: Experiment
    entry: dict[str, Any]


class Found(NamedTuple):
    """What is in a folder.

    Attributes:
        experiment: for which it was made, or to which it grew.
        source: how that is written there.
        earlier: what it was before, the first one first.
        wish: to what it is to grow, as somebody changed `experiment.toml`; None where nothing was changed.
    """

    experiment: Experiment
    source: Source
    earlier: tuple[Earlier, ...] = ()
    wish: Experiment | None = None

    @property
    def entries(self) -> dict[str, dict[str, Any]]:
        """What the folder says of what was before, by the fingerprints."""
        return {x.experiment.fingerprint: x.entry for x in self.earlier}

    @property
    def experiments(self) -> list[Experiment]:
        """All, the last one last."""
        return [*(x.experiment for x in self.earlier), self.experiment]

    def history(self, sessions: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
        """What was begun or added: when, what, and by which command."""
        first, *later = self.experiments
        begun = sessions[0] if sessions else {"started": "not recorded", "command": "not recorded"}
        lines = [(begun["started"], first.in_words, begun["command"])]
        for was, now in zip(self.earlier, later, strict=True):
            lines.append((was.entry["time"], growth.added(was.experiment, now), was.entry["command"]))
        return lines


def find(path: Path, other_source: bool = False) -> Found:
    """What is in a folder.

    Args:
        path: the folder.
        other_source: whether the file that the experiment was read from may say something else.

    Raises:
        InputError: what the folder says of the experiment is lost, or it lacks something that it had, or what
            somebody wrote there is wrong; or the file that it was read from is not what it was.
    """
    manifest = storage.read_manifest(path) or {}
    fingerprint, before = manifest.get("fingerprint"), manifest.get(HISTORY, [])
    data = disk.read_json(path / RESOLVED)
    history: Any = data.pop(HISTORY, []) if isinstance(data, dict) else None
    pinned = sources.read(path, data)
    resolved = _parsed(lambda: Experiment.from_data(data)) if isinstance(data, dict) else None
    text, wish = _text(path), None
    written = _parsed(lambda: Experiment.load(path / AS_WRITTEN, pinned)) if text is not None else None
    if resolved and _is_newest(resolved, history, fingerprint, before):
        experiment, before = resolved, history
        if written is None:
            if _is_by_a_person(text):
                Experiment.load(path / AS_WRITTEN, pinned)  # which says what is wrong, and where
            warn_of_remake(path / AS_WRITTEN, f"made again, of {RESOLVED}")
            disk.write(path / AS_WRITTEN, experiment.to_toml())
        elif written.data() != experiment.data():
            if lines := growth.taken_away(experiment, written):
                raise InputError(
                    f"{path / AS_WRITTEN} was changed since: {'; '.join(lines)}; {KEPT}: put it back to go on, or "
                    "begin a new one"
                )
            wish = written
    elif written and fingerprint in (None, written.fingerprint):
        experiment = written
        warn_of_remake(path / RESOLVED, f"made again, of {AS_WRITTEN}")
        _write_resolved(path, experiment, before)
    elif changed := _other_libraries(path, data):  # then an environment may be another one, or none
        raise InputError(f"{'; '.join(changed)}: install what it was, to go on in {path}")
    elif resolved or written:
        raise InputError(
            f"{path} was begun with another experiment: {AS_WRITTEN} and {RESOLVED} were changed or damaged "
            "since"
        )
    else:
        raise InputError(
            f"there is no experiment in {path} any more: {AS_WRITTEN} and {RESOLVED} are damaged"
        )
    source = Source(path / AS_WRITTEN, text if written and text else experiment.to_toml(), pinned)
    found = Found(experiment, source, _earlier(path, before, experiment), wish)
    if not other_source:
        _check_source(path, found)
    return found


def _text(path: Path) -> str | None:
    """What stands in `experiment.toml`; None where there is no such file."""
    if not disk.is_file(path / AS_WRITTEN):
        return None
    with disk.as_run_error(path / AS_WRITTEN, "read"):
        return (path / AS_WRITTEN).read_bytes().decode("utf-8-sig", errors="replace").replace("\r\n", "\n")


def _is_by_a_person(text: str | None) -> bool:
    """Whether a text that is no experiment looks as if somebody made a mistake in it, and no disk."""
    return (
        text is not None
        and all(x in text for x in ("environment", "method"))
        and text.replace("\n", "").replace("\t", "").isprintable()
        and "\ufffd" not in text
    )


def _is_newest(resolved: Experiment, history: Any, fingerprint: str | None, before: list[Any]) -> bool:
    """Whether `resolved.json` is whole: as the manifest says, or what was written when the experiment grew."""
    if not storage.is_history(history):
        return False
    if fingerprint == resolved.fingerprint:
        return history == before
    if fingerprint is None:
        return True
    last = _parsed(lambda: Experiment.from_data(history[-1]["experiment"]))  # the manifest is written later
    return history[:-1] == before and last is not None and last.fingerprint == fingerprint


def _earlier(path: Path, entries: Sequence[dict[str, Any]], last: Experiment) -> tuple[Earlier, ...]:
    one_by_one = [_parsed(lambda data=x["experiment"]: Experiment.from_data(data)) for x in entries]
    whole = [x for x in one_by_one if x]
    lost = [growth.taken_away(old, new) for old, new in itertools.pairwise([*whole, last])]
    if len(whole) < len(entries) or any(lost):
        raise InputError(f"what {path / RESOLVED} says of how the experiment grew is damaged: put it back")
    return tuple(map(Earlier, whole, entries))


def wished(found: Found, given: Experiment | None, more: Mapping[str, int]) -> Experiment:
    """The experiment that somebody wants in place of what is found: perhaps another one, with other numbers.

    Raises:
        InputError: it lacks something that is there.
    """
    one = given or found.wish or found.experiment
    for key, other in (("steps", "episodes"), ("episodes", "steps")):
        if key in more and getattr(one, other):
            raise InputError(f"the length of these runs is a number of {other}: give {other}, not {key}")
    new = one
    if more:
        numbers = dict(more)
        as_many = one.select and one.select["fresh_seeds"] == one.seeds  # as it is by default
        if as_many and "seeds" in more and not one.until_decided:  # whose looks stay as they were planned
            numbers["fresh_seeds"] = more["seeds"]
        select = one.select and one.select | {k: x for k, x in numbers.items() if k == "fresh_seeds"}
        data = one.data() | dict(more) | ({"select": select} if select else {})
        new = Experiment.from_data(data)
        edited = _edited(one.source or found.source, numbers)
        written = _parsed(lambda: Experiment.from_source(edited))
        if written and written.data() == new.data():
            new = written
    if lines := growth.taken_away(found.experiment, new):
        raise InputError(
            f"{'; '.join(lines)}; {KEPT}: ask for all that is there, and more, or begin a new one"
        )
    return new


def _edited(source: Source, numbers: Mapping[str, int]) -> Source:
    """What somebody wrote, with other numbers; those that are not there come first."""
    text = source.text
    for key, number in numbers.items():
        text, count = re.subn(rf"(?m)^({key}\s*=\s*)\d[\d_]*", rf"\g<1>{number}", text, count=1)
        if not count and key != "fresh_seeds":
            text = f"{key} = {number}\n{text}"
    return source._replace(text=text)


def grow(path: Path, found: Found, new: Experiment, command: str, files: Mapping[str, str]) -> None:
    """Writes into a folder that its experiment is a larger one now; `files` are those made of what it was.

    Where this is interrupted, the folder is what it was, or is as if somebody had edited `experiment.toml`.
    """
    sources.write(path, new.references)
    disk.write(path / AS_WRITTEN, new.source.text if new.source else new.to_toml())
    was = {"experiment": found.experiment.data(), "files": dict(files)}
    entry = was | {"time": timestamp(), "command": command}
    _write_resolved(path, new, [*(x.entry for x in found.earlier), entry])


def _write_resolved(path: Path, experiment: Experiment, history: list[Any]) -> None:
    disk.write_json(path / RESOLVED, experiment.data() | ({HISTORY: history} if history else {}))


def _check_source(path: Path, found: Found) -> None:
    """Raises InputError where the file that the experiment was read from says what it never was."""
    source = (records_in(path) or {}).get("file")
    if not source or not Path(source).is_file():
        return
    more = ""
    try:
        one = Experiment.load(source, found.source.pinned)
    except InputError as error:
        changed = str(error)
    else:
        if any(one.data() == known.data() for known in (*found.experiments, found.wish) if known):
            return
        changed = "; ".join(difference(found.experiment.data(), one.data()))
        if not growth.taken_away(found.experiment, one):
            more = f", or add what is new in it: `jaxrl-tab resume {path} {source}`"
    raise InputError(
        f"{source} was changed since: {changed}; put it back, or rename it to go on with what it was{more}"
    )


def _other_libraries(path: Path, data: Any) -> list[str]:
    """What has another version among the libraries from which environments come, a line for each."""
    sessions = (records_in(path) or {"sessions": []})["sessions"]
    was = sessions[0].get("surroundings", {}) if sessions else {}
    now = {library: version for library, version in library_versions(data).items() if library in was}
    return provenance.differences(was, now)


def _parsed(read: Callable[[], Experiment]) -> Experiment | None:
    """The experiment, or None where the data are damaged."""
    try:
        return read()
    except Exception:  # there is no end to what a flipped bit makes of data
        return None
