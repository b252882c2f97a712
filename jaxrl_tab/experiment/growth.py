"""Which runs an experiment has that those before it in its folder had not, and what a folder cannot lose.

A run depends on its environment, its setting, its seed and its length alone. So what was computed of an experiment
is of use to every larger one: only the runs that are new are computed. They are rectangles of settings and seeds.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.engine.part import Part
from jaxrl_tab.engine.results import parameters
from jaxrl_tab.engine.sweep import configurations
from jaxrl_tab.experiment.plain import as_plain
from jaxrl_tab.experiment.resolve import grid_of
from jaxrl_tab.experiment.spec import Experiment, change, difference

LENGTH = ("steps", "episodes", "log_every")
PARTS = ("environment", "method")
GROWS = ("seeds", "first_seed", "select", "until_decided", *LENGTH, *PARTS)


class Block(NamedTuple):
    """Runs of a part that belong together: settings of one of its programs, each with the same seeds.

    Attributes:
        part: the name of the part.
        program: which of its programs it is.
        configs: the numbers of the settings in the part, int [n].
        place: the place of the first seed in the part.
        seeds: how many seeds follow each other.
        planned: the part for which it was planned, which decides how it is split.
    """

    part: str
    program: int
    configs: np.ndarray
    place: int
    seeds: int
    planned: Part

    @property
    def runs(self) -> int:
        return len(self.configs) * self.seeds


class Fresh(NamedTuple):
    """The places of the fresh seeds that a part has more than before: `first` to `last` - 1."""

    part: str
    first: int
    last: int


class Generation(NamedTuple):
    """What an experiment added to the one before it.

    Attributes:
        blocks: runs, in the numbers of the last experiment's parts where it is of use.
        fresh: fresh seeds.
        of_use: whether its runs are as long as those of the last experiment, and so are among these.
    """

    blocks: list[Block]
    fresh: list[Fresh]
    of_use: bool


class _Own(NamedTuple):
    """A part of an experiment: its name, and for each setting what tells it from others, with its number."""

    name: str
    part: Part
    numbers: dict[Any, int]


class _Known:
    """What there was until now that is equally long."""

    def __init__(self):
        self.seeds = range(0)
        self.settings: dict[Any, dict[Any, int]] = {}  # of each part, numbered as they came
        self.fresh: Counter[Any] = Counter()


def generations(experiments: Sequence[Experiment]) -> tuple[list[Generation], dict[str, list[int]]]:
    """What each of the experiments of a folder added, from the first to the last.

    Also, for each part of the last, numbers of its settings that stay as they are when others are added.
    """
    alone, last = len(experiments) == 1, experiments[-1]
    goals = _parts(last, alone)
    known: dict[Any, _Known] = {}
    found = []
    for experiment in experiments:
        of_use = _length(experiment) == _length(last)
        had = known.setdefault(_length(experiment), _Known())
        now, fresh = _seeds(experiment), experiment.select["fresh_seeds"] if experiment.select else 0
        generation = Generation([], [], of_use)
        for key, own in _parts(experiment, alone).items():
            goal, before = goals[key] if of_use else own, had.settings.setdefault(key, {})
            settings = list(own.numbers)
            for members in own.part.programs:
                old = [settings[i] for i in members if settings[i] in before]
                new = [settings[i] for i in members if settings[i] not in before]
                more = (range(now.start, had.seeds.start), range(had.seeds.stop, now.stop))
                for some, seeds in ((new, now), *((old, x) for x in more)):
                    if some and seeds:
                        generation.blocks.append(_block(goal, some, seeds, own.part))
            before |= {x: len(before) + i for i, x in enumerate(x for x in settings if x not in before)}
            if fresh > had.fresh[key]:
                generation.fresh.append(Fresh(goal.name, had.fresh[key], fresh))
                had.fresh[key] = fresh
        had.seeds = now
        found.append(generation)
    came = known[_length(last)].settings
    return found, {own.name: [came[key][x] for x in own.numbers] for key, own in goals.items()}


def _block(goal: _Own, settings: Sequence[Any], seeds: range, planned: Part) -> Block:
    configs = np.array([goal.numbers[x] for x in settings])
    program = next(i for i, members in enumerate(goal.part.programs) if configs[0] in members)
    return Block(goal.name, program, configs, seeds.start - goal.part.first_seed, len(seeds), planned)


def taken_away(old: Experiment, new: Experiment) -> list[str]:
    """What an experiment has no more, or has otherwise, that one before it had; a line for each."""
    (was, now), lines = (old.data(), new.data()), []
    for key in was | now:
        if key not in GROWS:
            lines += change(key, was.get(key), now.get(key))
    before, after = _seeds(old), _seeds(new)
    if before.start < after.start:
        lines += change("first_seed", before.start, after.start)
    if before.stop > after.stop:
        lines += change("seeds", old.seeds, new.seeds)
    longest = max(LENGTH[:2], key=lambda key: was.get(key, 0))
    if now.get(longest, 0) < was[longest]:
        lines += change(longest, was[longest], now.get(longest))
    elif now[longest] == was[longest]:
        lines += change("log_every", was["log_every"], now["log_every"])
    fresh = [x.select["fresh_seeds"] if x.select else 0 for x in (old, new)]
    if fresh[0] > fresh[1] or (old.until_decided and fresh[0] < fresh[1]):  # a second look at what is decided
        lines += change("select: fresh_seeds", *(n or None for n in fresh))
    if old.select:  # its fresh seeds were looked at already, with another plan
        lines += change("until_decided", was.get("until_decided"), now.get("until_decided"))
    return lines + _taken_from_tables(old, new)


def _taken_from_tables(old: Experiment, new: Experiment) -> list[str]:
    called = dict(zip(_environments(new), new.environment, strict=True))
    gone = [
        table["label"]
        for key, table in zip(_environments(old), old.environment, strict=True)
        if key not in called
    ]
    lost = [("environment", label) for label in gone]
    before, after = _settings(old), _settings(new)
    lost += [("method", label) for label, x in before.items() if x.keys() - after.get(label, {}).keys()]
    lines = difference(old.data(), new.data())
    starts = tuple(f"{kind} {label}{x}" for kind, label in lost for x in (": ", " is gone"))
    told = [line for line in lines if line.startswith(starts)]
    return told or [f"{kind} {label} is not what it was" for kind, label in lost]


def added(old: Experiment, new: Experiment) -> str:
    """What was added to an experiment, in words."""
    labels = [
        dict(zip(_environments(x), (table["label"] for table in x.environment), strict=True))
        for x in (old, new)
    ]
    renamed = {label: labels[1][key] for key, label in labels[0].items() if labels[1][key] != label}
    known = {f"environment {label} is gone" for label in renamed}
    known |= {f"environment {label} is new" for label in renamed.values()}
    (was, now), lines = (old.data(), new.data()), []
    if "select" in was:
        lines += change("fresh_seeds", was["select"]["fresh_seeds"], now.pop("select")["fresh_seeds"])
        del was["select"]
    lines = [*(line for line in difference(was, now) if line not in known), *lines]
    lines += [f"environment {was} is called {now}" for was, now in renamed.items()]
    return "; ".join(lines) or "the same in another order"


def are_longer(old: Experiment, new: Experiment) -> bool:
    """Whether the runs of one, which the other grew to, have another length."""
    return _length(old) != _length(new)


def shared(old: Experiment, new: Experiment) -> dict[str, tuple[str, list[int]]]:
    """For each part of one experiment that another had: its name there, and the number there of each setting, or -1."""
    before, after = _parts(old), _parts(new)
    return {
        own.name: (before[key].name, [before[key].numbers.get(x, -1) for x in own.numbers])
        for key, own in after.items()
        if key in before
    }


def _parts(experiment: Experiment, alone: bool = False) -> dict[Any, _Own]:
    """The parts by what they are, whatever the environment is called; where it is `alone`, settings by number."""
    found, settings = {}, {} if alone else _settings(experiment)
    for environment, table in zip(_environments(experiment), experiment.environment, strict=True):
        for method in experiment.method:
            name = f"{table['label']}/{method['label']}"
            part = experiment.parts()[name]
            numbers = {i: i for i in range(len(part.configs))} if alone else settings[method["label"]]
            found[environment, method["label"]] = _Own(name, part, numbers)
    return found


def _environments(experiment: Experiment) -> list[tuple[str, int]]:
    """What tells each environment from others, which is all but what it is called."""
    own = (table | {"name": _identity(table), "label": ""} for table in experiment.environment)
    return _told_apart(json.dumps(x, sort_keys=True) for x in own)


def _settings(experiment: Experiment) -> dict[str, dict[tuple[str, int], int]]:
    """For each method, by its label, what tells each of its settings from others, with its number."""
    found = {}
    for method in experiment.method:
        cls = experiment.references[method["name"]].cls
        _, configs = configurations(cls, grid_of(method, cls, experiment.seed))
        keys = _told_apart(_identity(method) + _setting(config) for config in configs)
        found[method["label"]] = {key: i for i, key in enumerate(keys)}
    return found


def _identity(table: Mapping[str, Any]) -> str:
    """What a table names; of what is in a file it is the checksum, wherever the file lies."""
    _, colon, attribute = table["name"].rpartition(":")
    return f"{attribute if colon else ''} {table['sha256']}" if "sha256" in table else table["name"]


def _setting(config: Any) -> str:
    values = {key: as_plain(key, value) for key, value in parameters(config).items()}
    return json.dumps(values, sort_keys=True, default=repr)


def _told_apart(keys: Iterable[str]) -> list[tuple[str, int]]:
    """The keys, each with how many of the same there were before it: draws may be the same, for one."""
    seen: Counter[str] = Counter()
    return [(key, seen.update([key]) or seen[key]) for key in keys]


def _length(experiment: Experiment) -> tuple[int | None, ...]:
    return tuple(getattr(experiment, key) for key in LENGTH)


def _seeds(experiment: Experiment) -> range:
    return range(experiment.first_seed, experiment.first_seed + experiment.seeds)
