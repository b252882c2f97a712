"""How time and memory grow with the number of states and of lanes: each point in a fresh process.

Q-learning in windy gridworlds of ten columns and ever more rows, and in the usual one with ever more lanes.
Memory is the largest resident set, less what it was when jaxrl_tab had been imported; compiling is in it, and
is most of it where the problem is small.
"""

import resource
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.rounds import fresh
from benchmarks.tasks import Size

STATES = (10, 100, 1000, 10_000)
LANES = (*(2 * 4**i for i in range(8)), 65_536)
COLUMNS = 10


class Point(NamedTuple):
    """What one process needed.

    Attributes:
        states, lanes, steps: what it ran; steps of each lane.
        nanoseconds: time of a step of one lane, compilation apart.
        mebibytes: largest resident set, less that after the import.
    """

    states: int
    lanes: int
    steps: int
    nanoseconds: float
    mebibytes: float


def measure(size: Size, cores: int, progress: Callable[[str], None]) -> dict[str, list[Point]]:
    """The points by what grows in them: "states" and "lanes"."""
    grown = {
        "states": [(states, size.slow_lanes) for states in STATES],
        "lanes": [(70, lanes) for lanes in LANES],
    }
    points: dict[str, list[Point]] = {}
    for what, settings in grown.items():
        points[what] = []
        for states, lanes in settings:
            progress(f"growth: {states} states, {lanes} lanes")
            arguments = {"states": states, "lanes": lanes, "steps": size.steps // 4}
            points[what].append(fresh("benchmarks.growth:point", cores, **arguments))
    return points


def point(states: int, lanes: int, steps: int) -> Point:
    """Runs in the process that is measured."""
    import jaxrl_tab as rl

    rl.use_all_cores()
    imported = _largest_resident_set()
    middle = states // COLUMNS // 2
    shape, start, goal = (states // COLUMNS, COLUMNS), (middle, 0), (middle, 7)
    env = rl.make("windy-gridworld", shape=shape, start=start, goal=goal)
    result = rl.sweep(env, "q-learning", num_seeds=lanes, num_steps=steps)
    nanoseconds = 1e9 * result.seconds / (lanes * steps)
    return Point(states, lanes, steps, nanoseconds, _largest_resident_set() - imported)


def _largest_resident_set() -> float:
    """Of this process so far, MiB."""
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB on Linux
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def draw(points: Mapping[str, Sequence[Point]], file: Path) -> None:
    """A panel for each thing that grows, with the time of a step and the memory."""
    from jaxrl_tab import plot

    canvas = plot.canvas(plot.WIDTH, 3.2)
    for ax, (what, series) in zip(canvas.subplots(1, len(points)), points.items(), strict=True):
        x = [getattr(p, what) for p in series]
        time, memory = plot.COLORS[:2]
        ax.plot(x, [p.nanoseconds for p in series], "o-", color=time)
        plot.tidy(ax, what, "time of a step, ns")
        ax.yaxis.label.set_color(time)
        other = ax.twinx()
        other.plot(x, [p.mebibytes for p in series], "s--", color=memory)
        other.set_ylabel("peak memory, MiB", color=memory)
        other.spines["top"].set_visible(False)
        other.set_ylim(bottom=0)
        ax.set_yscale("log")
        ax.set_xscale("log", base=10 if what == "states" else 2)
    canvas.savefig(file)
