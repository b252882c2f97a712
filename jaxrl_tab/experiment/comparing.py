"""Methods compared on as many fresh seeds as it takes: look by look, each with shards of its own.

They are kept beside those of the experiment, in a folder in its folder. What is computed at a look depends on what the
looks before it gave, and on nothing else: so wherever it is interrupted, all is decided in the same way.
"""

import functools
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxrl_tab.core import modules
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.part import Part
from jaxrl_tab.engine.results import label
from jaxrl_tab.experiment import disk
from jaxrl_tab.experiment.growth import Block
from jaxrl_tab.experiment.shards import Job, Shard, again, arrays_of, runs, shard_runs
from jaxrl_tab.experiment.spec import Experiment
from jaxrl_tab.experiment.storage import Store

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.stats.deciding import Verdict

FOLDER = "comparison"  # of the shards, in that of the experiment
Looked = Callable[[str, Any], object]
"""Is called with the name of an environment and its `stats.Verdict`, at each look for which something was computed."""


class Candidate(NamedTuple):
    """A setting that is compared with others.

    Attributes:
        part: the name of its part, "ENVIRONMENT/METHOD".
        config: the number of the setting in it.
        name: what it is called in the verdict.
    """

    part: str
    config: int
    name: str

    @property
    def environment(self) -> str:
        return self.part.partition("/")[0]


class Span(NamedTuple):
    """Fresh seeds of a candidate, from `first` until before `last`.

    Attributes:
        number: of its first shard, the same whoever else is computed.
    """

    candidate: Candidate
    first: int
    last: int
    number: int

    @property
    def name(self) -> str:
        """What progress calls it."""
        return f"{self.candidate.environment}/{self.candidate.name} until {self.last} seeds"


class Look(NamedTuple):
    """The seeds that candidates need at a look, as work for an executor: as `shards.Job`, of which it is a part."""

    job: Job
    spans: tuple[Span, ...]

    @property
    def parts(self) -> dict[str, Part]:
        modules.keep(self.job.files)
        return _parts(self.job.experiment, self.spans)

    @property
    def shards(self) -> dict[int, Shard]:
        """By their numbers."""
        modules.keep(self.job.files)
        return _shards(self.job.experiment, self.spans)

    def setting(self, shard: Shard) -> int:
        """The number of the setting of a shard."""
        return next(span.candidate.config for span in self.spans if span.name == shard.part)

    def __call__(self, number: int) -> dict[str, np.ndarray]:
        """What the runs of a shard give, and what is raised: as `Job` has it."""
        self.job.check_libraries()
        shard = self.shards[number]
        part = self.parts[shard.part]
        return arrays_of(part, runs(part, shard), self.job.memory)


@functools.lru_cache(maxsize=4)
def _parts(experiment: str, spans: tuple[Span, ...]) -> dict[str, Part]:
    parts = Job(experiment, None).parts
    return {
        span.name: again(
            parts[span.candidate.part], span.candidate.config, span.last - span.first, span.first
        )
        for span in spans
    }


@functools.lru_cache(maxsize=4)
def _shards(experiment: str, spans: tuple[Span, ...]) -> dict[int, Shard]:
    found = {}
    for span in spans:
        part = _parts(experiment, spans)[span.name]
        most = shard_runs(part)
        block = Block(span.name, 0, np.array([0]), 0, part.runs, part)
        pieces = [Shard(block, x, min(x + most, part.runs)) for x in range(0, part.runs, most)]
        found |= dict(enumerate(pieces, span.number))
    return found


def candidates(job: Job, chosen: Mapping[str, int], all_settings: bool) -> list[Candidate]:
    """What is compared: the chosen setting of each part, or every setting."""
    if not all_settings:
        return [Candidate(part, config, part.partition("/")[2]) for part, config in chosen.items()]
    found = []
    for name, part in job.parts.items():
        swept = [key for axis, values in part.axes.items() for key in ([axis] if axis != DRAW else values[0])]
        for number, config in enumerate(part.configs):
            values = (f"{key}={label(getattr(config, key))}" for key in swept)
            found.append(Candidate(name, number, " ".join([name.partition("/")[2], *values])))
    return found


def open_store(folder: Path, experiment: Experiment, chosen: Mapping[str, int]) -> Store:
    """The shards of the comparison of these settings, in an experiment with however many seeds to choose them on.

    Where others are chosen, as when it grows, that is another comparison, in a folder beside.
    """
    data = {key: x for key, x in experiment.data().items() if key not in ("seeds", "first_seed")}
    data["until_decided"] = {key: x for key, x in data["until_decided"].items() if key != "difference"}
    text = json.dumps([data, dict(chosen)], sort_keys=True)
    fingerprint = hashlib.sha256(text.encode()).hexdigest()
    path = folder / FOLDER / fingerprint[:12]
    disk.check_no_link(folder / FOLDER)
    disk.check_no_link(path)
    if not path.exists():
        with disk.as_run_error(path):
            path.mkdir(parents=True)
        Store.begin(path, fingerprint)
    return Store(path, fingerprint)


def compare(
    job: Job,
    experiment: Experiment,
    chosen: Mapping[str, int],
    computed: "Callable[[Look], tuple[Mapping[str, xr.Dataset], bool]]",
    looked: Looked | None,
) -> "tuple[dict[str, Verdict], dict[str, xr.Dataset], bool]":
    """Goes from look to look until all is decided, in each environment for itself.

    Args:
        chosen: for each part the number of its chosen setting.
        computed: the results of a look, by the names of its parts, and whether anything had to be computed for it.

    Returns:
        The verdict in each environment, the runs of each chosen setting by the name of its part, and whether anything
        was computed.
    """
    import xarray as xr

    from jaxrl_tab.stats.deciding import decide, looks, scored
    from jaxrl_tab.stats.measures import standstill

    about = experiment.until_decided
    first, most = experiment.select["fresh_seeds"], about["most_seeds"]
    compared = candidates(job, chosen, about["all_settings"])
    numbers = _numbers(job, compared, looks(first, most))
    runs_of: dict[Candidate, list[xr.Dataset]] = {candidate: [] for candidate in compared}
    scores: dict[Candidate, list[xr.DataArray]] = {candidate: [] for candidate in compared}
    worst: dict[str, float] = {}
    wanted, done, until, verdicts, any_new = compared, 0, first, {}, False
    while wanted:
        spans = tuple(Span(one, done, until, numbers[one, until]) for one in wanted)
        datasets, new = computed(Look(job, spans))
        any_new |= new
        for span in spans:
            ds = datasets[span.name]
            scores[span.candidate].append(scored(ds))
            if chosen[span.candidate.part] == span.candidate.config:
                runs_of[span.candidate].append(ds)
            if not done:
                env = span.candidate.environment
                worst[env] = min(worst.get(env, np.inf), float(standstill(ds).min()))
        active, wanted, done = wanted, [], until
        for env in dict.fromkeys(one.environment for one in active):
            own = [one for one in compared if one.environment == env]
            so_far = {one.name: xr.concat(scores[one], "seed") for one in own}
            verdicts[env] = decide(so_far, about["difference"], first=first, most=most, worst=worst[env])
            wanted += [one for one in own if one.name in verdicts[env].wanted]
            until = verdicts[env].until or until
            if looked and new:
                looked(env, verdicts[env])
    fresh = {
        one.part: xr.concat(parts, "seed", combine_attrs="override")
        for one, parts in runs_of.items()
        if parts
    }
    return verdicts, fresh, any_new


def _numbers(
    job: Job, compared: Sequence[Candidate], looks: Sequence[int]
) -> dict[tuple[Candidate, int], int]:
    """The number of the first shard of each candidate at each look, as if all were there at all looks."""
    numbers, number = {}, 0
    for seeds, last in zip(looks, (0, *looks), strict=False):
        for one in compared:
            numbers[one, seeds] = number
            number += -(-(seeds - last) // shard_runs(job.parts[one.part]))
    return numbers
