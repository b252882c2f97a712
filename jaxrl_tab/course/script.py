"""The script of the update: an agent acts, the script says where that leads, and what Q was is written down.

Any next state may follow, with any of a few rewards. An episode that ends in a terminal state has a number of a state
there in which other episodes go on, so that its Q is not 0.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from jaxrl_tab.course.exercises import Exercise
from jaxrl_tab.course.student import Agent, Code
from jaxrl_tab.course.updates import Learner, Setting, Step

EPISODES = 36
LONGEST = 9  # steps
REWARDS = (-2.0, -1.0, -0.5, 1.0, 3.0)
CLOSE = 1e-5  # of the largest number in Q: a table may be in float32
UNSURE = ("draws-again", "explores-in-target")


class Seen(NamedTuple):
    """A step, as it was seen.

    Attributes:
        episode, number: the episode and the step in it, from 1.
        step: the step.
        a_next: A', where it is known: the action that was taken next, or that `update` returned.
        before, after: Q before and after `update`, float [S, A].
    """

    episode: int
    number: int
    step: Step
    a_next: int | None
    before: np.ndarray
    after: np.ndarray


def record(code: Code, exercise: Exercise, seed: int = 1) -> list[Seen]:
    """What an agent learns in each step of the script."""
    agent, draw = Agent(code, Setting(), seed), np.random.default_rng(seed)
    states, seen = agent.setting.num_states, []
    for episode in range(1, EPISODES + 1):
        s, number, length = int(draw.integers(states)), 0, int(draw.integers(1, LONGEST + 1))
        recent: list[int] = []  # the last n states: where an episode ends, no pair of theirs comes twice
        cut_off = exercise.time_limits and episode % 2 == 0
        action = agent.act(s)
        while not number or not seen[-1].step.last:
            number += 1
            recent = [*recent, s][-agent.setting.n :]
            s_next, r = int(draw.integers(states)), float(draw.choice(REWARDS))
            ends = number >= length and len(set(recent)) == len(recent) and s_next not in recent
            step = Step(s, action, r, s_next, ends and not cut_off, ends and cut_off)
            before = agent.q()
            a_next = agent.update(step)
            after = agent.q()
            if agent.is_lost:
                return [*seen, Seen(episode, number, step, a_next, before, after)]
            if not step.last:
                a_next = action = agent.act(s_next)
            seen.append(Seen(episode, number, step, a_next, before, after))
            s = s_next
    return seen


def follow(
    seen: Sequence[Seen], learner: Learner, late: bool = False
) -> Iterator[tuple[Seen, list[np.ndarray]]]:
    """Each step with the tables that are right after it; several where nobody saw which action A' was.

    With `late` a step is learned in the `update` after it, when A' is known, and the last two steps of an episode at
    once.
    """
    pending: Seen | None = None
    for x in seen:
        tables = [x.before]
        if pending is not None:
            own = pending.step
            learner.see(own._replace(r=x.step.r) if "next-reward" in learner.mistakes else own)
            tables = [learner.after(q, a) for q in tables for a in _choices(learner, pending)]
        if not late or x.step.last:
            learner.see(x.step)
            tables = [learner.after(q, a) for q in tables for a in _choices(learner, x)]
            pending = None
        else:
            pending = x
        yield x, tables


def _choices(learner: Learner, x: Seen) -> Iterable[int]:
    """What A' may have been."""
    if learner.unsure or (x.a_next is None and learner.kind == "sampled"):
        return range(learner.setting.num_actions)
    return (x.a_next or 0,)


def agrees(table: np.ndarray, tables: Sequence[np.ndarray]) -> bool:
    """Whether a table is one of these, but for rounding."""
    near = CLOSE * (1 + np.abs(table).max())
    return any(np.abs(table - other).max() <= near for other in tables)


def wrong(seen: Sequence[Seen], learner: Learner, late: bool = False) -> list[Seen]:
    """The steps after which Q is not what it should be."""
    return [x for x, tables in follow(seen, learner, late) if not agrees(x.after, tables)]


def explains(seen: Sequence[Seen], learner: Learner, late: bool) -> bool:
    return all(agrees(x.after, tables) for x, tables in follow(seen, learner, late))


def diagnose(seen: Sequence[Seen], exercise: Exercise) -> tuple[str, ...] | None:
    """The mistakes, at most two, that explain every step; none for a right agent, None where nothing explains it."""
    assert exercise.learner
    setting = Setting()
    for mistakes in _suspected(exercise):
        for late in (False, True):
            with np.errstate(all="ignore"):
                if explains(seen, exercise.learner(setting, frozenset(mistakes)), late):
                    return mistakes
    return None


def _suspected(exercise: Exercise) -> Iterator[tuple[str, ...]]:
    """No mistake, one, two. What explains more than it should comes last, for others may pass for it."""
    sure = [x for x in exercise.mistakes if x not in UNSURE]
    unsure = [x for x in exercise.mistakes if x in UNSURE]
    yield ()
    yield from ((x,) for x in exercise.mistakes)
    yield from combinations(sure, 2)
    yield from ((x, y) for y in unsure for x in sure)
