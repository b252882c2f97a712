"""The public results of twenty methods in twenty tasks: what is kept of them, and whether they come out again.

The ordinary command computes them, from benchmarks/suite.toml. `--keep` takes what the repository holds out of its
folder: scores, against which `jaxrl-tab compare` ranks other methods; two bytes of the checksum of every run; a table.
`--check` draws some of all runs at random, computes these alone, and looks whether each has the same bits. `--page`
makes what docs/suite.md shows of what is kept.
"""

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core.errors import InputError, RunError

DERIVED = ("diverged", "optimum")  # of a dataset: what follows from the rest


class Files(NamedTuple):
    """Where everything is.

    Attributes:
        toml: the experiment.
        scores, bits: of every run of a chosen setting on its fresh seeds; of every run.
        table: a row for each method in each task.
        about: what was computed when by what, and the numbers over all tasks.
    """

    toml: Path
    scores: Path
    bits: Path
    table: Path
    about: Path

    @classmethod
    def beside(cls, toml: Path) -> "Files":
        return cls(
            toml, *(toml.with_name(f"{toml.stem}{end}") for end in (".npz", "-bits.npz", ".csv", ".json"))
        )


SUITE = Files.beside(Path(__file__).with_name("suite.toml"))


class Sizes(NamedTuple):
    """How many runs of a part there are bits of: of each setting and seed of the sweep, and then of the fresh seeds."""

    settings: int
    seeds: int
    fresh: int
    chosen: int

    @property
    def runs(self) -> int:
        return self.settings * self.seeds + self.fresh


def bits_of(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Two bytes of the SHA-256 of all numbers of each run, uint16 [runs], from arrays [runs, ...] by their names."""
    named = {name: np.ascontiguousarray(x) for name, x in sorted(arrays.items())}
    found = np.empty(len(next(iter(named.values()))), np.uint16)
    for i in range(len(found)):
        checksum = hashlib.sha256()
        for name, x in named.items():
            checksum.update(f"{name} {x.dtype} {x.shape[1:]}".encode() + x[i].tobytes())
        found[i] = int.from_bytes(checksum.digest()[:2], "little")
    return found


def bits_of_dataset(ds: Any) -> np.ndarray:
    """The same of all runs of a dataset, in the order of its settings, and of seeds in each."""
    axes = [dim for dim in ds.diverged.dims if dim != "seed"]
    names = [name for name in ds.data_vars if name not in DERIVED]
    arrays = {str(name): ds[name].transpose(*axes, "seed", ...).values for name in names}
    return bits_of({name: x.reshape(-1, *x.shape[len(axes) + 1 :]) for name, x in arrays.items()})


# --- what is kept ------------------------------------------------------------------------------------
def keep(folder: Path, files: Files, say: Callable[[str], None]) -> None:
    """Writes what the repository holds of a finished folder."""
    import jaxrl_tab as rl
    from jaxrl_tab.experiment import scores
    from jaxrl_tab.experiment.sides import side
    from jaxrl_tab.show import over_tasks

    outcome, known = rl.resume(folder, progress=False, formats=()), side(folder)
    assert known.experiment and known.session and outcome.tasks
    scores.save(files.scores, outcome.fresh, known.experiment, known.session)
    bits, sizes = [], {}
    for name, ds in outcome.datasets.items():
        parts = bits_of_dataset(ds), bits_of_dataset(outcome.fresh[name])
        settings = len(outcome.parts[name].configs)
        sizes[name] = Sizes(settings, ds.sizes["seed"], len(parts[1]), outcome.chosen[name])
        bits.append(np.concatenate(parts))
        say(name)
    np.savez_compressed(files.bits, bits=np.concatenate(bits))
    digests = {name: hashlib.sha256(x.tobytes()).hexdigest() for name, x in zip(sizes, bits, strict=True)}
    known_tasks = _tasks(outcome)
    _table(outcome, known_tasks, digests).to_csv(files.table, index=False, float_format="%.9g")
    about = {
        "fingerprint": rl.Experiment.load(files.toml).fingerprint,
        "session": known.session,
        "over_environments": over_tasks.to_dict(outcome.tasks),
        "parts": {name: list(size) for name, size in sizes.items()},
        "tasks": known_tasks,
    }
    files.about.write_text(json.dumps(about, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _tasks(outcome: Any) -> dict[str, Any]:
    """What is known of each task."""
    from jaxrl_tab import stats

    found = {}
    for label, own in outcome.fresh_methods.items():
        ds = next(iter(own.values()))
        gamma = float(stats.fixed(ds)["gamma"])
        found[label] = {
            "states": own.env.num_states,
            "actions": own.env.num_actions,
            "steps": int(ds.attrs["num_steps"]),
            "gamma": gamma,
            "random": stats.random_value(own.env, gamma),
            "optimum": float(stats.optimum(ds)),
        }
    return found


def _table(outcome: Any, known: Mapping[str, Any], digests: Mapping[str, str]) -> Any:
    """A row for each method in each task."""
    import pandas as pd

    from jaxrl_tab import stats
    from jaxrl_tab.show.words import in_words

    tasks, rows = outcome.tasks, []
    for name in outcome.fresh:
        label, _, method = name.partition("/")
        own, fresh = (x[label].settings[method] for x in (outcome.methods, outcome.fresh_methods))
        here = {"environment": label, "method": method}
        scaled = stats.mean_interval(tasks.scores.sel(here, drop=True))
        rows.append(
            here
            | {"setting": ", ".join(in_words(stats.named(own.ds, own.best)))}
            | dict(zip(("score", "low", "high"), map(float, fresh.interval[:3]), strict=True))
            | dict(
                zip(("normalised", "normalised_low", "normalised_high"), map(float, scaled[:3]), strict=True)
            )
            | {
                "random": known[label]["random"],
                "optimum": known[label]["optimum"],
                "diverged": int(fresh.ds.diverged.sum()),
                "at_edge": " ".join(own.edges),
                "sha256": digests[name],
            }
        )
    return pd.DataFrame(rows)


# --- whether it comes out again ----------------------------------------------------------------------
class Drawn(NamedTuple):
    """Runs of a part that are computed again.

    Attributes:
        name: of the part.
        fresh: whether they are of the chosen setting on fresh seeds.
        runs: their numbers in the part, int [n].
        kept: what is kept of their bits, uint16 [n].
    """

    name: str
    fresh: bool
    runs: np.ndarray
    kept: np.ndarray


def drawn(about: Mapping[str, Any], bits: np.ndarray, share: float, seed: int) -> Iterator[Drawn]:
    """Some of all runs, at random, by their parts."""
    some = np.random.default_rng(seed).choice(len(bits), math.ceil(share * len(bits)), replace=False)
    begin = 0
    for name, size in about["parts"].items():
        of, first = Sizes(*size), begin
        own = np.sort(some[(some >= first) & (some < first + of.runs)]) - first
        swept = of.runs - of.fresh
        for fresh, runs in ((False, own[own < swept]), (True, own[own >= swept])):
            if len(runs):
                yield Drawn(name, fresh, runs - swept if fresh else runs, bits[first + runs])
        begin += of.runs


def check(share: float, seed: int, files: Files, say: Callable[[str], None]) -> list[str]:
    """Computes some runs alone; a line for each that does not come out with the same bits."""
    import jaxrl_tab as rl
    from jaxrl_tab.engine import backend, provenance
    from jaxrl_tab.engine.part import compute
    from jaxrl_tab.experiment.shards import again

    about, bits = (
        json.loads(files.about.read_text(encoding="utf-8")),
        np.load(files.bits, allow_pickle=False)["bits"],
    )
    experiment = rl.Experiment.load(files.toml)
    if experiment.fingerprint != about["fingerprint"]:
        return [f"{files.toml.name} is not the experiment whose results are kept"]
    if sum(Sizes(*size).runs for size in about["parts"].values()) != len(bits):
        return [f"{files.bits.name} is not of the runs that {files.about.name} tells of"]
    was = about["session"]["surroundings"]
    settings = {name: was[name] for name in provenance.settings() if name in was}
    wrong, count = [], 0
    with backend.using(experiment.backend), provenance.using(settings):
        now = provenance.surroundings()
        for line in provenance.differences(was, {name: now.get(name) for name in was}):
            say(f"not as it was: {line}")
        for some in drawn(about, bits, share, seed):
            part = experiment.parts()[some.name]
            size = Sizes(*about["parts"][some.name])
            if some.fresh:
                part = again(part, size.chosen, size.fresh)
            computed = compute(part, some.runs)
            same = bits_of({"q": computed.q, **computed.log.named()}) == some.kept
            count += len(same)
            for run in some.runs[~same]:
                setting, place = divmod(int(run), part.num_seeds)
                kind = "fresh seed" if some.fresh else f"setting {setting}, seed"
                wrong.append(f"{some.name}, {kind} {place}: other bits")
            say(f"{some.name}: {int(same.sum())} of {len(same)}")
    say(f"{count - len(wrong)} of {count} runs, drawn from {len(bits)}, have the same bits")
    return wrong


def main(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks suite", description=__doc__)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--keep", type=Path, metavar="DIR", help="the folder of the sweep, which has ended")
    what.add_argument("--check", type=float, metavar="SHARE", help="of all runs, such as 0.01")
    what.add_argument(
        "--page", type=Path, metavar="DIR", help="draw the pictures into it, and print the tables"
    )
    parser.add_argument("--seed", type=int, default=0, help="which runs are drawn; default 0")
    args = parser.parse_args(argv)
    say = lambda text: print(text, file=sys.stderr, flush=True)
    if args.keep:
        try:
            keep(args.keep, SUITE, say)
        except (InputError, RunError) as error:
            parser.error(str(error))
        return 0
    if args.page:
        from benchmarks import suite_page  # here, for it draws

        print(suite_page.draw(SUITE, args.page))
        return 0
    if not 0 < args.check <= 1:
        parser.error(f"--check is a share of all runs, above 0 and at most 1, not {args.check:g}")
    wrong = check(args.check, args.seed, SUITE, say)
    for line in wrong:
        print(line)
    return 1 if wrong else 0
