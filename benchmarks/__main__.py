"""The command line of the benchmark: `python -m benchmarks --help`."""

import argparse
import collections
import importlib.util
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import command, growth, machine, problems, report, suite
from benchmarks.rounds import Task, cores_in_words, measure
from benchmarks.tasks import FULL, QUICK, ROWS, SLOW

ROUNDS, QUICK_ROUNDS = 9, 3
WIDTH = 160  # of the table where nobody looks at it in a terminal


def main() -> int:
    if sys.argv[1:2] == ["suite"]:
        return suite.main(sys.argv[2:])
    args = _arguments()
    cores = min(2, len(os.sched_getaffinity(0)))
    size = QUICK if args.quick else FULL
    rounds = args.rounds or (QUICK_ROUNDS if args.quick else ROUNDS)
    record: dict[str, Any] = {
        "machine": machine.settings(),
        "versions": machine.versions(),
        "settings": {"cores": cores, "rounds": rounds, **size._asdict(), **problems.settings()},
    }
    _say(f"{machine.processor()}, {cores_in_words(cores)}")
    if args.growth:
        points = growth.measure(size, cores, _say)
        growth.draw(points, args.growth)
        record["growth"] = {what: [point._asdict() for point in series] for what, series in points.items()}
        differences = []
    else:
        names = args.only or [name for name in ROWS if not (args.quick and name in SLOW)]
        tasks = [task for name in names for task in ROWS[name](size, cores)]
        needs_numba = any(party.library == "numba" for task in tasks for party in task.parties)
        if needs_numba and importlib.util.find_spec("numba") is None:
            _say("this part of the benchmark needs Numba: pip install -e '.[bench]'")
            return 2
        compared, differences = _compare(tasks, rounds)
        record |= compared
    if args.json:
        args.json.write_text(json.dumps(record, indent=1) + "\n")
    return 1 if differences else 0


def _compare(tasks: Sequence[Task], rounds: int) -> tuple[dict[str, Any], list[str]]:
    """Measures and prints; returns what goes into the JSON, and where parties do not learn the same."""
    begun = time.perf_counter()
    progress = lambda what: _say(f"{time.perf_counter() - begun:4.0f} s  {what}")
    records = []
    try:
        records.extend(measure(tasks, rounds, progress))
    except KeyboardInterrupt:  # what was measured is not lost
        counts = collections.Counter((record.task, record.cores) for record in records)
        whole = lambda task: counts[task.name, task.cores] == rounds * len(task.parties)
        tasks = [task for task in tasks if whole(task)]
        _say(f"stopped: {len(tasks)} rows were finished")
    rows = [row for task in tasks for row in report.rows(task, records)]
    differences = [line for task in tasks for line in report.disagreements(task, records)]
    Console(width=None if sys.stdout.isatty() else WIDTH).print(report.table(rows, rounds))
    if any("command" in party.call for task in tasks for party in task.parties):
        _say(f"where the time of a second start goes:\n{command.phases()}")
    for line in differences:
        _say(f"NOT THE SAME LEARNING: {line}")
    compared = {
        "rows": [row._asdict() for row in rows],
        "disagreements": differences,
        "rounds": [record._asdict() for record in records],
    }
    return compared, differences


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="How fast it is beside others, as ratios within rounds in which all take turns. The exit "
        "code is 1 where two parties do not learn the same. `python -m benchmarks suite --help` is another: the public "
        "results.",
    )
    parser.add_argument(
        "--only", nargs="+", choices=ROWS, metavar="NAME", help=f"only these rows, of {', '.join(ROWS)}"
    )
    parser.add_argument(
        "--quick", action="store_true", help=f"fewer lanes and rounds, and not {' and '.join(SLOW)}"
    )
    parser.add_argument("--rounds", type=int, metavar="N", help=f"default: {ROUNDS}, quick {QUICK_ROUNDS}")
    parser.add_argument(
        "--growth", type=Path, metavar="PNG", help="instead: time and memory by states and lanes, as a plot"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write versions, machine, all rounds")
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
