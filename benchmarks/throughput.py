"""Steps per second of jaxrl_tab beside Numba and naive JAX: `python -m benchmarks.throughput [--quick]`.

Q-learning and Sarsa on the windy gridworld (see `task`), on one core and on two. Speed drifts with the load
and the clock of the machine, so the parties run in turn, round after round, and what counts is the median
over rounds of the ratio within a round. Flags, devices and threads are settled when a process starts, so
each party has its own process, which is kept waiting while the others run.

The parties must also learn the same: their mean numbers of episodes may differ by 4 standard errors, or the
exit code is 1.
"""

import argparse
import importlib.metadata
import importlib.util
import itertools
import json
import multiprocessing
import os
import platform
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.task import ALPHA, EPSILON, METHODS, STEPS, Round

OURS = "jaxrl_tab"
PEERS = ("numba, 4 lanes abreast", "numba, lane by lane", "naive JAX")
PARTIES = (OURS, *PEERS)
TOLERANCE = 4  # standard errors
PACKAGES = ("jaxrl-tab", "jax", "jaxlib", "numba", "llvmlite", "numpy")


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.throughput", description="Steps per second beside Numba and naive JAX."
    )
    parser.add_argument("--quick", action="store_true", help="1024 lanes and 2 rounds: under a minute")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="also write versions, machine and all rounds"
    )
    args = parser.parse_args()
    if importlib.util.find_spec("numba") is None:
        print("the benchmark needs Numba: pip install -e '.[bench]'", file=sys.stderr)
        return 2

    lanes, rounds = (1024, 2) if args.quick else (4096, 5)
    cores = [c for c in (1, 2) if c <= len(os.sched_getaffinity(0))]
    print(f"{cpu_model()}; {lanes} lanes of {STEPS} steps, {rounds} rounds", flush=True)
    records = measure(lanes, rounds, cores)
    summary = [summarise(records, method, c) for method, c in itertools.product(METHODS, cores)]
    for row in summary:
        show(row)
    differences = [d for method in METHODS for d in disagreements(records, method)]
    for line in differences:
        print(f"NOT THE SAME LEARNING: {line}", file=sys.stderr)
    if args.json:
        settings = {"steps": STEPS, "lanes": lanes, "rounds": rounds, "alpha": ALPHA, "epsilon": EPSILON}
        report = {
            "machine": {"cpu": cpu_model(), "cores": os.cpu_count(), "system": platform.platform()},
            "versions": {name: importlib.metadata.version(name) for name in PACKAGES}
            | {"python": platform.python_version()},
            "settings": settings,
            "summary": summary,
            "disagreements": differences,
            "rounds": records,
        }
        args.json.write_text(json.dumps(report, indent=1) + "\n")
    return 1 if differences else 0


# --- processes ---------------------------------------------------------------------------------------


def prepare(party: str, method: str, lanes: int, cores: int) -> Round:
    """The compiled round of a party, in the process where this is called."""
    if party == OURS:
        from benchmarks.ours import ours

        return ours(method, lanes, cores)
    if party == "naive JAX":
        from benchmarks.peer_naive_jax import naive

        return naive(method, lanes)
    from benchmarks import peer_numba

    kernel = peer_numba.four_abreast if "abreast" in party else peer_numba.one_at_a_time
    return peer_numba.numba_peer(method, lanes, cores, kernel)


def serve(pipe: Connection, party: str, lanes: int, cores: int) -> None:
    """A party's process: compiles, says so, then runs a round for each (method, seed) it is told."""
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])  # before JAX and Numba start threads
    run = {method: prepare(party, method, lanes, cores) for method in METHODS}
    pipe.send("ready")
    while (order := pipe.recv()) is not None:
        method, seed = order
        timing = run[method](seed)
        pipe.send((timing.seconds, float(timing.episodes.mean()), float(timing.episodes.var(ddof=1))))


def measure(lanes: int, rounds: int, cores: list[int]) -> list[dict[str, Any]]:
    """One record for each round, method, number of cores and party, in the order in which they ran."""
    context = multiprocessing.get_context("spawn")
    pipes: dict[tuple[int, str], Connection] = {}
    for c, party in itertools.product(cores, PARTIES):
        pipes[c, party], theirs = context.Pipe()
        context.Process(target=serve, args=(theirs, party, lanes, c), daemon=True).start()
        theirs.close()  # so that a process that died is noticed
    for pipe in pipes.values():
        pipe.recv()

    records = []
    for r, method, c, party in itertools.product(range(rounds), METHODS, cores, PARTIES):
        pipes[c, party].send((method, r))
        seconds, mean, variance = pipes[c, party].recv()
        records.append(
            {
                "round": r,
                "method": method,
                "cores": c,
                "party": party,
                "seconds": seconds,
                "steps_per_second": lanes * STEPS / seconds,
                "mean_episodes": mean,
                "standard_error": (variance / lanes) ** 0.5,
            }
        )
    for pipe in pipes.values():
        pipe.send(None)
    return records


# --- results -----------------------------------------------------------------------------------------


def summarise(records: list[dict[str, Any]], method: str, cores: int) -> dict[str, Any]:
    """Median steps per second of each party, and the median over rounds of ours / peer."""
    speed = {
        party: np.array(
            [
                x["steps_per_second"]
                for x in records
                if (x["method"], x["cores"], x["party"]) == (method, cores, party)
            ]
        )
        for party in PARTIES
    }
    return {
        "method": method,
        "cores": cores,
        "steps_per_second": {party: float(np.median(speed[party])) for party in PARTIES},
        "ratio": {peer: float(np.median(speed[OURS] / speed[peer])) for peer in PEERS},
    }


def show(row: dict[str, Any]) -> None:
    print(f"\n{row['method']}, {row['cores']} core{'s' if row['cores'] > 1 else ''}")
    for party in PARTIES:
        ratio = f"   ours / it {row['ratio'][party]:6.2f}" if party in PEERS else ""
        print(f"  {party:<24}{row['steps_per_second'][party] / 1e6:8.1f} M steps/s{ratio}")


def disagreements(records: list[dict[str, Any]], method: str) -> list[str]:
    """A line for each pair of parties whose mean numbers of episodes differ by more than chance allows."""

    def pooled(party: str) -> tuple[float, float]:
        # The same lanes run again on two cores are no further evidence.
        mine = [x for x in records if (x["method"], x["cores"], x["party"]) == (method, 1, party)]
        error = np.sqrt(np.mean([x["standard_error"] ** 2 for x in mine]) / len(mine))
        return float(np.mean([x["mean_episodes"] for x in mine])), float(error)

    lines = []
    for one, other in itertools.combinations(PARTIES, 2):
        (mean1, error1), (mean2, error2) = pooled(one), pooled(other)
        if abs(mean1 - mean2) > TOLERANCE * np.hypot(error1, error2):
            lines.append(f"{method}: {one} finished {mean1:.2f} episodes, {other} {mean2:.2f}")
    return lines


def cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor()


if __name__ == "__main__":
    raise SystemExit(main())
