"""What very many shards cost beside computing: `python -m benchmarks.shards 100000`, a line for each stage.

The shards are of nothing: of one run each, whose results an executor makes up. All else is what an experiment in a
folder does: it plans, writes each shard and the manifest, verifies all when it is opened again, puts them together,
and makes tables and report. So a stage that grows faster than the shards is seen. Time is wall time, without that of
computing, of which there is none; memory is the largest resident set in the stage.
"""

import contextlib
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

import jaxrl_tab as rl
from benchmarks import machine
from jaxrl_tab.experiment import runner, shards
from jaxrl_tab.experiment.storage import Store

SETTINGS = 10  # the shards are as many settings, each with a tenth of the seeds
# The functions whose times are told apart, in the order of their beginning; what is called in another is not in it.
STAGES = {
    "planning": (runner, "_begin"),
    "finding out what is missing": (runner, "missing"),
    "handing out, and counting": (runner, "compute"),
    "writing shards": (Store, "write"),
    "writing the manifest": (Store, "write_manifest"),
    "verifying what is there": (Store, "_take_stock"),
    "assembly": (runner, "collect"),
    "tables and report": (runner, "write_files"),
}
REST = "all else"
# The system takes 0.1 ms to say how large the resident set was, as long as half a shard: it is asked this often.
BETWEEN_LOOKS = 0.1  # seconds


class Stage(NamedTuple):
    """What a stage took: seconds of wall time, and the largest resident set in it, MiB."""

    wall: float = 0.0
    mebibytes: float = 0.0


class Nothing:
    """An executor that computes nothing: all runs took a hundred steps and learned zeros."""

    def run(self, work: Any, tasks: Sequence[int]) -> Generator[tuple[int, dict[str, np.ndarray]]]:
        """As `Executor.run`."""
        part = work.parts[work.shards[0].part]
        shapes = shards.shapes_of(part, 0, 1)
        arrays = {name: np.zeros(shape, dtype) for name, (shape, dtype) in shapes.items()}
        arrays |= {"seconds": np.full(2, 1e-3), "steps": np.full_like(arrays["steps"], 100)}
        for task in tasks:
            yield task, arrays


def experiment(count: int) -> rl.Experiment:
    """Has `count` runs."""
    alphas = [i / SETTINGS for i in range(1, SETTINGS + 1)]
    return rl.Experiment(
        "two-loops", {"name": "q-learning", "alpha": alphas}, seeds=count // SETTINGS, steps=100
    )


@contextlib.contextmanager
def of_nothing() -> Iterator[None]:
    """Within the block each run is a shard."""
    with mock.patch.object(shards, "shard_runs", return_value=1):
        shards.forget_parts()
        yield
    shards.forget_parts()


def measure(count: int, folder: Path) -> dict[str, dict[str, Stage]]:
    """What the stages took, of a run and of a `resume` of all that is there."""
    found = {}
    with of_nothing():
        with _timed() as found["run"]:
            rl.run(experiment(count), folder, executor=Nothing(), progress=False, formats=())
        with _timed() as found["resume"]:
            rl.resume(folder, progress=False, formats=())
    return found


@contextlib.contextmanager
def _timed() -> Iterator[dict[str, Stage]]:
    """Within the block the stages are measured; the time of one that is called in another counts for it alone."""
    found: dict[str, Stage] = {}
    running = [REST]
    last = looked = time.perf_counter()

    def count(then: Callable[[], Any]) -> None:
        nonlocal last, looked
        now = time.perf_counter()
        wall, mebibytes = found.get(running[-1], Stage())
        if now - looked > BETWEEN_LOOKS:
            mebibytes, looked = max(mebibytes, _largest_resident_set()), now
        found[running[-1]] = Stage(wall + now - last, mebibytes)
        last = now
        then()

    def within(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*given: Any, **named: Any) -> Any:
            count(lambda: running.append(name))
            try:
                return function(*given, **named)
            finally:
                count(running.pop)

        return wrapped

    with contextlib.ExitStack() as patches:
        for name, (place, function) in STAGES.items():
            wrapped = within(name, getattr(place, function))
            patches.enter_context(mock.patch.object(place, function, wrapped))
        yield found
        count(lambda: None)


def _largest_resident_set() -> float:
    """Of this process since it was last asked, MiB; Linux forgets the one before."""
    status = Path("/proc/self/status").read_text()
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    Path("/proc/self/clear_refs").write_text("5")
    return int(peak.split()[1]) / 2**10


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    print(f"{count:,} shards of nothing on {machine.processor()}")
    with tempfile.TemporaryDirectory() as scratch:
        found = measure(count, Path(scratch) / "run")
    for what, stages in found.items():
        print(f"\n{what:28}  wall, s  peak, MiB")
        for name in (*(name for name in STAGES if name in stages), REST):
            print(f"{name:28}{stages[name].wall:9.1f}{stages[name].mebibytes:11.0f}")
        print(
            f"{'together':28}{sum(x.wall for x in stages.values()):9.1f}"
            f"{max(x.mebibytes for x in stages.values()):11.0f}"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
