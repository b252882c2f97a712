"""How often an agent takes which action, against what ε-greedy says, and what it says with a mistake in it."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.course.student import FUNCTION, Agent, Code, action_of
from jaxrl_tab.course.updates import Setting, Step

DRAWS = 400  # in each of four places
ERROR = 1e-7  # a right agent is refused with this probability
FAR = 1e-2  # what is shown as wrong comes from right agents with this probability
TIES = {"": "any", "first-of-ties": "first", "last-of-ties": "last"}
# How one explores -> the name of that mistake. One explores among the others than the one that was drawn as the best,
# than the first of the best ones, or than all of them.
EXPLORES = {
    "": "",
    "never": "never-explores",
    "always": "always-explores",
    "others": "explores-others",
    "all but the first": "explores-others",
    "worse ones": "explores-others",
    "all but the last action": "explores-not-last",
    "swapped": "epsilon-swapped",
    "to the worst": "takes-worst",
}
Row = tuple[float, ...]  # the values of the actions in a state


class Choice(NamedTuple):
    """An action that was taken.

    Attributes:
        where: in words.
        row: the values of the actions there.
        action: the action.
    """

    where: str
    row: Row
    action: int


@cache
def probabilities(row: Row, epsilon: float, ties: str = "any", explores: str = "") -> np.ndarray:
    """The probability of each action, float [A]."""
    q, count = np.array(row), len(row)
    best = np.flatnonzero(q == (q.min() if explores == "to the worst" else q.max()))
    all_best = best
    best = {"any": best, "first": best[:1], "last": best[-1:]}[ties]
    greedy = np.bincount(best, minlength=count) / len(best)
    if explores in ("never", "always"):
        return greedy if explores == "never" else np.full(count, 1 / count)
    random = np.full(count, 1 / count)
    if explores == "others":
        random = (1 - greedy) / (count - 1)
    if explores == "all but the first" or (explores == "worse ones" and len(all_best) < count):
        random[all_best[:1] if explores == "all but the first" else all_best] = 0
        random /= random.sum()
    if explores == "all but the last action":
        random = np.append(np.full(count - 1, 1 / (count - 1)), 0.0)
    if explores == "swapped":
        epsilon = 1 - epsilon
    return (1 - epsilon) * greedy + epsilon * random


def doubt(choices: Sequence[Choice], law: Callable[[Row], np.ndarray]) -> float:
    """How probable it is that counts are as far from what a law says as these are, if it holds; by G-tests."""
    count = len(choices[0].row) if choices else 0
    statistic, freedom = 0.0, 0
    for where in dict.fromkeys(x.where for x in choices):
        own = [x for x in choices if x.where == where]
        expected = np.sum([law(x.row) for x in own], axis=0)
        got = np.bincount([x.action for x in own], minlength=count)
        if (got[expected < 1e-9] > 0).any():
            return 0.0
        there = got > 0
        statistic += 2 * float((got[there] * np.log(got[there] / expected[there])).sum())
        freedom += count - 1
    return _beyond(statistic, freedom)


def _beyond(x: float, freedom: int) -> float:
    """The probability that chi squared is beyond x; of an odd number of degrees of freedom, with one more."""
    terms = [1.0]
    for k in range(1, (freedom + 1) // 2):
        terms.append(terms[-1] * x / 2 / k)
    return math.exp(-x / 2) * sum(terms) if x > 0 else 1.0


def diagnose(choices: Sequence[Choice], epsilon: float) -> tuple[tuple[str, ...], str] | None:
    """The mistakes that explain how often actions were taken, and a word about them; None where nothing does.

    Of all explanations it is that in which the counts are the most probable; one mistake is more probable than two, and
    a known one more than an epsilon that is fitted.
    """
    if doubt(choices, lambda row: probabilities(row, epsilon)) >= ERROR:
        return (), ""
    found: list[tuple[float, tuple[str, ...], str]] = []
    for explores, ties in product(EXPLORES, TIES):
        law = lambda row, e=explores, t=ties: probabilities(row, epsilon, TIES[t], e)
        named = tuple(filter(None, (ties, EXPLORES[explores])))
        if named and not (explores == "always" and ties):
            found.append((doubt(choices, law) / 1e2 ** (len(named) - 1), named, ""))
    for ties in TIES:
        other = _fitted(choices, TIES[ties])
        law = lambda row, e=other, t=ties: probabilities(row, e, TIES[t])
        found.append(
            (doubt(choices, law) / 1e3, tuple(filter(None, (ties, "other-epsilon"))), f"{other:.2f}")
        )
    best = max(found, key=lambda x: x[0])
    return best[1:] if best[0] >= ERROR else None


def _fitted(choices: Sequence[Choice], ties: str) -> float:
    """The epsilon with which as many actions are no best one as were."""
    told = [x for x in choices if min(probabilities(x.row, 0.0, ties)) < max(probabilities(x.row, 0.0, ties))]
    explored = sum(probabilities(x.row, 0.0, ties)[x.action] == 0 for x in told)
    possible = sum((probabilities(x.row, 0.0, ties) == 0).mean() for x in told)
    return min(1.0, explored / possible) if told else 0.0


# --- of an agent -------------------------------------------------------------------------------------

FIRST, SECOND, LEARNED, END, BEGIN = 1, 2, (1, 2), 5, 0
LESSONS: Mapping[int, Row] = {FIRST: (-4.0, -2.0, -2.0, -8.0), SECOND: (-8.0, -4.0, -16.0, -2.0)}


class Watched(NamedTuple):
    """What an agent does.

    Attributes:
        starts: in the first state of episodes.
        within: later on.
        by_old: the latter with the values of the state that was left, by which they must not be drawn.
        pairs: the last action of an episode and the first of the next.
    """

    starts: list[Choice]
    within: list[Choice]
    by_old: list[Choice]
    pairs: list[tuple[int, int]]


def watch(code: Code, seed: int = 2) -> Watched:
    """What an agent does where its values are known.

    First it learns, in episodes of one step, values in two states: in one of them two actions are best. From then on
    each reward there is what it expects, so that the values stay as they are.
    """
    agent = Agent(code, Setting(), seed)
    draw = np.random.default_rng(seed)
    _teach(agent)
    seen, last = Watched([], [], [], []), 0
    for k in range(4 * DRAWS):
        s, inside = LEARNED[k % 2], k // 2 % 2
        old: Row = ()
        if inside and not agent.is_lost:
            old = tuple(agent.q()[BEGIN])
            action = agent.act(BEGIN)
            agent.update(Step(BEGIN, action, float(draw.integers(-2, 3)), s, False, False))
        if agent.is_lost:
            break  # a mistake in what it learns, of which nothing follows for how it acts
        row = tuple(agent.q()[s])
        action = agent.act(s)
        (seen.within if inside else seen.starts).append(Choice(f"in state {s}", row, action))
        if inside:
            seen.by_old.append(Choice("", old, action))
        else:
            seen.pairs.append((last, action))
        agent.update(Step(s, action, row[action], END, True, False))
        last = action
    return seen


def _teach(agent: Agent) -> None:
    known: set[tuple[int, int]] = set()
    for k in range(60 * len(LEARNED)):
        if agent.is_lost:
            return
        s = LEARNED[k % 2]
        action = agent.act(s)
        r = float(agent.q()[s, action]) if (s, action) in known else LESSONS[s][action]
        known.add((s, action))
        agent.update(Step(s, action, r, END, True, False))


def is_stale(seen: Watched, epsilon: float, end: Row) -> bool:
    """Whether the first action of an episode was drawn in the episode before: it is the last one again, or was drawn
    in the state where that ended, whose values are `end`."""
    if all(last == first for last, first in seen.pairs[1:]):
        return True
    return doubt(seen.starts, lambda _: probabilities(end, epsilon)) >= ERROR


def is_by_old(seen: Watched, epsilon: float) -> bool:
    """Whether the later actions were drawn by the values of the state that was left."""
    return doubt(seen.by_old, lambda row: probabilities(row, epsilon)) >= ERROR


# --- of a function -----------------------------------------------------------------------------------

ROWS: Sequence[Row] = (
    (0.0, 2.0, 2.0, 1.0),
    (3.0, -1.0, 3.0, 3.0),
    (-2.0, -3.0, -5.0, -1.5),
    (0.0, 0.0, 0.0, 0.0),
)


def try_function(code: Code, seed: int = 3) -> list[Choice]:
    """What the function of the first exercise draws from some rows of values."""
    rng, epsilon = np.random.default_rng(seed), Setting().epsilon
    np.random.seed(seed)  # noqa: NPY002  of which a student may draw
    choices = []
    for k, row in enumerate(ROWS, 1):
        for _ in range(2 * DRAWS):
            choices.append(Choice(f"row {k}", row, _drawn(code, row, epsilon, rng)))
    return choices


def _drawn(code: Code, row: Row, epsilon: float, rng: Any) -> int:
    values = np.array(row)
    action = code.call(FUNCTION, code.made, values, epsilon, rng)
    return action_of(code, FUNCTION, action, len(row))


def counted(choices: Sequence[Choice], epsilon: float) -> list[str]:
    """Lines that say, where that is far apart, how often which action was taken, and how often it should be."""
    lines = []
    for where in dict.fromkeys(x.where for x in choices):
        own = [x for x in choices if x.where == where]
        if doubt(own, lambda row: probabilities(row, epsilon)) > FAR:
            continue
        got = np.bincount([x.action for x in own], minlength=len(own[0].row)) / len(own)
        wanted = np.mean([probabilities(x.row, epsilon) for x in own], axis=0)
        values = ", ".join(f"{x:.4g}" for x in own[-1].row)
        lines.append(
            f"{where} (values {values}): it took actions with frequencies {_list(got)}, not {_list(wanted)}"
        )
    return lines


def _list(x: np.ndarray) -> str:
    return ", ".join(f"{y:.2f}" for y in x)
