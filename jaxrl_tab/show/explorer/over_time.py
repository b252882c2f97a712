"""Tables of the runs of a setting at the points of its curves, and the views of them that a reader can choose."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core import memory
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.show.explorer.packing import Steps, as_text, codes, packed_codes, packed_sets

RANKS = {"worst": 0.0, "lower quarter": 0.25, "middle": 0.5, "upper quarter": 0.75, "best": 1.0}


class OverTime(NamedTuple):
    """What some runs of a setting had learned at some moments.

    Attributes:
        tables: Q, of prediction V; float32 [runs, moments, states, A or 1].
        visits: N, how often each action was taken, int32 [runs, moments, states, A]; None where it was not counted.
    """

    tables: np.ndarray
    visits: np.ndarray | None = None


# Runs a setting again and records its tables: from the name of its sweep, the number of the setting, the places of
# its seeds, int [runs], after how many rows of the log each table is wanted, and, where states cannot be counted, what
# is observed of those that stand for them, float [N, d]. It raises InputError or RunError where that cannot be done.
Again = Callable[[str, int, np.ndarray, int, np.ndarray | None], OverTime]


class Block(NamedTuple):
    """Views of one setting, packed.

    Attributes:
        text: the numbers, as `packing.as_text` gives them: tables, greedy sets, how many seeds agree, visits.
        numbers: how many of them there are.
        data: what it takes to read them, as JSON has it.
    """

    text: str
    numbers: int
    data: dict[str, Any]


def ranks(order: Sequence[int]) -> dict[str, int]:
    """Which runs are looked at one by one, by what they are; all, where there are few.

    Args:
        order: the places of the runs by score, the worst first.
    """
    last = len(order) - 1
    if last < len(RANKS):
        names = ["worst", *[f"{i + 1}. from below" for i in range(1, last)], "best"] if last else ["only one"]
        return dict(zip(names, map(int, order), strict=True))
    return {name: int(order[round(share * last)]) for name, share in RANKS.items()}


def averaged(places: np.ndarray) -> int:
    """How many of the first seeds are among these places, [runs] ascending, without a gap: a mean is of them."""
    return int((places == np.arange(len(places))).sum())


def block(
    over: OverTime, states: np.ndarray | slice, singles: Sequence[int] | np.ndarray, first: int
) -> Block:
    """The views of some runs: mean and median of the first ones, where these are several; and single runs.

    A mean of tables has arrows of its own, which need be those of no run. So the arrows of mean and median are a
    vote: the actions that the most seeds would take, with the share of seeds that would.

    Args:
        over: of these runs.
        states: which states there are to be seen.
        singles: the places, in `over`, of the runs that are looked at one by one.
        first: how many runs a mean is of.
    """
    tables, visits = over.tables[singles][:, :, states], over.visits
    shown, sets, agree = _learned(tables), greedy(tables), b""
    if visits is not None:
        visits = visits[singles][:, :, states]
    if first > 1:
        averages, vote = _over_runs(over.tables[:first], np.arange(over.tables.shape[2])[states])
        shown = np.concatenate([averages, shown])
        most = vote >= vote.max(-1, keepdims=True) - 1e-6
        sets = np.concatenate([most[None], sets])
        agree = np.rint(100 * np.where(most, vote, 0).sum(-1)).astype(np.uint8).tobytes()
        if visits is not None:
            mean = np.asarray(over.visits)[:first].mean(0, dtype=float)[:, states]
            visits = np.concatenate([mean[None], visits])
    steps, visit_step = Steps.of(shown), None
    parts, numbers = [packed_codes(codes(shown, steps)), packed_sets(sets), agree], shown.size
    if visits is not None:
        visit_step = 10.0 ** max(0, int(np.ceil(np.log10(max(1, visits.max()) / 65000))))
        parts.append(packed_codes(codes(visits.astype(float), Steps(0.0, visit_step, 0))))
        numbers += visits.size
    data = {
        "moments": shown.shape[1],
        "actions": over.tables.shape[-1],
        "visited": 0 if visits is None else visits.shape[-1],
        "averaged": first if first > 1 else 0,
        "low": steps.low,
        "step": steps.step,
        "decimals": steps.decimals,
        "visits": visit_step,
    }
    return Block(as_text(*parts), numbers, data)


def _learned(tables: np.ndarray) -> np.ndarray:
    """Where no action may be taken, nothing is learned: there is no number to show."""
    return np.where(tables == UNAVAILABLE, np.nan, tables)


def _over_runs(tables: np.ndarray, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and median over runs, [2, moments, states, A], and their vote, [moments, states, A].

    Of some states at a time, since there may be many runs.
    """
    averages, votes = [], []
    for some in memory.blocks(
        len(states), 16 * tables[:, :, 0].size
    ):  # bytes: in float64, and as much beside
        part = tables[:, :, states[some]]
        votes.append(_vote(part))
        part = _learned(part)
        with np.errstate(invalid="ignore", over="ignore"):
            averages.append(
                np.stack([part.mean(0, dtype=float), np.median(part, axis=0, overwrite_input=True)])
            )
    return np.concatenate(averages, 2), np.concatenate(votes, 1)


def greedy(q: np.ndarray) -> np.ndarray:
    """Which actions are greedy, just as the method itself compares them, bool [..., A]."""
    most = functools.reduce(np.maximum, np.moveaxis(q, -1, 0))  # some times as quick as `q.max(-1)`
    return q == most[..., None]


def _vote(q: np.ndarray) -> np.ndarray:
    """The share of runs that would take each action, float [..., A] of [runs, ..., A]; of ties each has its part."""
    sets = greedy(q)
    tied = functools.reduce(np.add, np.moveaxis(sets.astype(int), -1, 0))[..., None]
    return (sets / np.maximum(1, tied)).mean(0)
