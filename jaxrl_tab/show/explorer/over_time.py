"""Tables of the runs of a setting at the points of its curves, and the views of them that a reader can choose."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

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
# its seeds, int [runs], and after how many rows of the log each table is wanted. It raises InputError or RunError
# where that cannot be done.
Again = Callable[[str, int, np.ndarray, int], OverTime]


class Block(NamedTuple):
    """Views of one setting, packed.

    Attributes:
        text: the numbers, as `packing.as_text` gives them: tables, greedy sets, how many seeds agree, visits.
        data: what it takes to read them, as JSON has it.
    """

    text: str
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


def block(over: OverTime, singles: Sequence[int], whole: bool) -> Block:
    """The views of some runs: where these are all of the setting mean and median; and single runs.

    A mean of tables has arrows of its own, which need be those of no run. So the arrows of mean and median are a
    vote: the actions that the most seeds would take, with the share of seeds that would.

    Args:
        over: of these runs.
        singles: the places, in `over`, of the runs that are looked at one by one.
        whole: whether these are all runs of the setting.
    """
    # Where no action may be taken, nothing is learned: there is no number to show.
    tables = np.where(over.tables == UNAVAILABLE, np.nan, over.tables)
    sets = greedy(over.tables[singles])
    shown, counts, agree = tables[singles], over.visits if over.visits is None else over.visits[singles], b""
    if whole:
        with np.errstate(invalid="ignore", over="ignore"):
            averages = np.stack([tables.mean(0, dtype=float), np.median(tables, axis=0)])
        shown = np.concatenate([averages, shown])
        vote = _vote(over.tables)
        most = vote >= vote.max(-1, keepdims=True) - 1e-6
        sets = np.concatenate([most[None], sets])
        agree = np.rint(100 * np.where(most, vote, 0).sum(-1)).astype(np.uint8).tobytes()
        if over.visits is not None:
            counts = np.concatenate([over.visits.mean(0, dtype=float)[None], over.visits[singles]])
    steps, visit_step = Steps.of(shown), None
    parts = [packed_codes(codes(shown, steps)), packed_sets(sets), agree]
    if counts is not None:
        visit_step = 10.0 ** max(0, int(np.ceil(np.log10(max(1, counts.max()) / 65000))))
        parts.append(packed_codes(codes(counts.astype(float), Steps(0.0, visit_step, 0))))
    numbers = {"low": steps.low, "step": steps.step, "decimals": steps.decimals, "visits": visit_step}
    return Block(as_text(*parts), {"moments": shown.shape[1], "averages": whole, **numbers})


def greedy(q: np.ndarray) -> np.ndarray:
    """Which actions are greedy, just as the method itself compares them, bool [..., A]."""
    return q == q.max(-1, keepdims=True)


def _vote(q: np.ndarray) -> np.ndarray:
    """The share of runs that would take each action, float [..., A] of [runs, ..., A]; of ties each has its part."""
    sets = greedy(q)
    return (sets / np.maximum(1, sets.sum(-1, keepdims=True))).mean(0)
