"""The command line of the benchmark: `python -m benchmarks --help`."""

import argparse
import importlib.util
import json
import os
import sys
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks import report
from benchmarks.rounds import measure
from benchmarks.tasks import FULL, QUICK, ROWS, SLOW

ROUNDS, QUICK_ROUNDS = 9, 3


def main() -> int:
    args = _arguments()
    if importlib.util.find_spec("numba") is None:
        print("the benchmark needs Numba: pip install -e '.[bench]'", file=sys.stderr)
        return 2
    cores = min(2, len(os.sched_getaffinity(0)))
    size = QUICK if args.quick else FULL
    rounds = args.rounds or (QUICK_ROUNDS if args.quick else ROUNDS)
    names = args.only or [name for name in ROWS if not (args.quick and name in SLOW)]
    print(f"{report.cpu_model()}, {report.cores(cores)}; {rounds} rounds", file=sys.stderr)

    tasks = [task for name in names for task in ROWS[name](size, cores)]
    records = measure(
        tasks, rounds, lambda task: print(f"{task.name}, {report.cores(task.cores)}", file=sys.stderr)
    )
    rows = [row for task in tasks for row in report.rows(task, records)]
    differences = [line for task in tasks for line in report.disagreements(task, records)]
    Console(width=None if sys.stdout.isatty() else 160).print(report.table(rows))
    for line in differences:
        print(f"NOT THE SAME LEARNING: {line}", file=sys.stderr)
    if args.json:
        found: dict[str, Any] = {
            "machine": report.machine(),
            "versions": report.versions(),
            "settings": {"rounds": rounds, "size": size._asdict()},
            "rows": [row._asdict() for row in rows],
            "disagreements": differences,
            "tasks": [task._asdict() | {"parties": [p._asdict() for p in task.parties]} for task in tasks],
            "rounds": [record._asdict() for record in records],
        }
        args.json.write_text(json.dumps(found, indent=1) + "\n")
    return 1 if differences else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="How fast it is beside others, as ratios within rounds in which all take turns. The exit "
        "code is 1 where two parties do not learn the same.",
    )
    parser.add_argument(
        "--only", nargs="+", choices=ROWS, metavar="NAME", help=f"some rows: {', '.join(ROWS)}"
    )
    parser.add_argument("--quick", action="store_true", help="under a minute: fewer lanes, rounds and rows")
    parser.add_argument("--rounds", type=int, metavar="N", help=f"default: {ROUNDS}, or {QUICK_ROUNDS}")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="also write versions, machine and all rounds"
    )
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
