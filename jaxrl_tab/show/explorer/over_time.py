"""Tables at moments of the runs of one setting, and the views of them that a reader can choose."""

from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.show.explorer.packing import Steps, as_text, codes, packed_codes, packed_sets

MOMENTS = 40  # at which tables are shown
RECORDED = 256  # rows in which a run may record its table; of more, only every so many
EARLY = 128  # rows of the log that are recorded one by one nevertheless
RANKS = {"worst": 0.0, "lower quarter": 0.25, "middle": 0.5, "upper quarter": 0.75, "best": 1.0}


class OverTime(NamedTuple):
    """What some runs of a setting had learned at some moments.

    Attributes:
        tables: Q, of prediction V; float32 [runs, moments, states, A or 1].
        visits: N, how often each action was taken, int32 [runs, moments, states, A]; None where it was not counted.
    """

    tables: np.ndarray
    visits: np.ndarray | None


class Source(Protocol):
    """Where tables over time come from: a second run of settings, in which they are recorded."""

    def takes(self, name: str, runs: int, numbers: int) -> bool:
        """Whether there are time and memory left for so many runs of a sweep that record so many numbers each."""
        ...

    def over_time(
        self, name: str, setting: int, seeds: np.ndarray, moments: "Moments", states: np.ndarray
    ) -> OverTime:
        """The tables of the runs at these places of the seeds, int [runs], of a setting of a sweep.

        Raises:
            InputError, RunError: they cannot be had; the message says why.
        """
        ...

    def toml(self, name: str) -> str:
        """The experiment of this one sweep as TOML, up to and with what is fixed of its method."""
        ...


class Moments(NamedTuple):
    """At which moments tables are shown.

    Attributes:
        ends: after how many rows of the log, int [moments], ascending; the last is the end of the run.
        every: beyond the first `EARLY` rows, they are whole multiples of so many rows, but for the end.
    """

    ends: np.ndarray
    every: int

    @classmethod
    def of(cls, rows: int) -> "Moments":
        """About `MOMENTS` of so many rows: the earlier, the denser, for most is learned early."""
        every = -(-rows // RECORDED)
        ends, n = np.array([rows]), min(rows, MOMENTS)
        while len(ends) < min(rows, MOMENTS) and n < 8 * MOMENTS:
            ends = np.rint(np.geomspace(1, rows, n)).astype(int)
            late = ends > EARLY if every > 1 else ends > rows
            ends = np.unique(np.where(late, np.minimum(-(-ends // every) * every, rows), ends))
            n += 1
        return cls(ends, every)


class View(NamedTuple):
    """A view of the runs of a setting: their mean, their median, or one of them."""

    key: str
    label: str


class Block(NamedTuple):
    """Views of one setting, packed.

    Attributes:
        text: the numbers, as `packing.as_text` gives them: tables, greedy sets, how many seeds agree, visits.
        data: what it takes to read them, as JSON has it.
    """

    text: str
    data: dict[str, Any]


def block(over: OverTime, seeds: np.ndarray, order: np.ndarray, ends: list[int], whole: bool) -> Block:
    """The views of some runs.

    A mean of tables has arrows of its own, which need be those of no run. So the arrows of mean and median are a
    vote: the actions that the most seeds would take, with the share of seeds that would.

    Args:
        over: of these runs.
        seeds: the numbers of their seeds, int [runs].
        order: their places by score, the worst first, int [runs].
        ends: the time of each moment, in steps or episodes.
        whole: whether these are all runs of the setting; else mean and median are left out.
    """
    tables = np.where(over.tables == UNAVAILABLE, np.nan, over.tables)
    ranks = _ranks(order)
    singles = list(ranks.values())
    views = [View(f"seed {seeds[i]}", f"seed {seeds[i]} ({rank})") for rank, i in ranks.items()]
    sets = greedy(over.tables[singles])
    shown, counts, agree = tables[singles], over.visits if over.visits is None else over.visits[singles], b""
    if whole:
        with np.errstate(invalid="ignore", over="ignore"):
            averages = [tables.mean(0, dtype=float), np.median(tables, axis=0)]
        shown = np.concatenate([np.stack(averages), shown.astype(float)])
        vote = _vote(over.tables)
        most = vote >= vote.max(-1, keepdims=True) - 1e-6
        sets = np.concatenate([most[None], sets])
        agree = np.rint(100 * np.where(most, vote, 0).sum(-1)).astype(np.uint8).tobytes()
        views = [
            View("mean", f"mean of {len(seeds)} seeds"),
            View("median", f"median of {len(seeds)} seeds"),
            *views,
        ]
        if over.visits is not None:
            counts = np.concatenate([over.visits.mean(0, dtype=float)[None], over.visits[singles]])
    steps = Steps.of(shown)
    parts = [packed_codes(codes(shown, steps)), packed_sets(sets), agree]
    visit_steps = None
    if counts is not None:
        digits = int(np.ceil(np.log10(max(1, counts.max()) / 65000)))
        visit_steps = Steps(0.0, 10.0 ** max(0, digits), 0)
        parts.append(packed_codes(codes(counts.astype(float), visit_steps)))
    return Block(
        as_text(*parts),
        {
            "ends": ends,
            "views": [view._asdict() for view in views],
            "averages": whole,
            "low": steps.low,
            "step": steps.step,
            "decimals": steps.decimals,
            "visits": visit_steps and visit_steps.step,
        },
    )


def greedy(q: np.ndarray) -> np.ndarray:
    """Which actions are greedy, just as the method itself compares them, bool [..., A]."""
    return q == q.max(-1, keepdims=True)


def _vote(q: np.ndarray) -> np.ndarray:
    """The share of runs that would take each action, float [..., A] of [runs, ..., A]; of ties each has its part."""
    sets = greedy(q)
    return (sets / np.maximum(1, sets.sum(-1, keepdims=True))).mean(0)


def _ranks(order: np.ndarray) -> dict[str, int]:
    """The places of the runs that are looked at one by one, by what they are; all, where there are few."""
    last = len(order) - 1
    if last < len(RANKS):
        names = ["worst", *[f"{i + 1}. from below" for i in range(1, last)], "best"] if last else ["only one"]
        return dict(zip(names, order.tolist(), strict=True))
    return {name: int(order[round(share * last)]) for name, share in RANKS.items()}
