"""The check of an agent: what is right, which mistake it is that is not, and where one sees it."""

import os
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core.notebook import table
from jaxrl_tab.course import behaviour, script, student
from jaxrl_tab.course.exercises import EXERCISES, Exercise
from jaxrl_tab.course.mistakes import MISTAKES
from jaxrl_tab.course.script import Seen
from jaxrl_tab.course.student import Code
from jaxrl_tab.course.updates import Setting


class Verdict(NamedTuple):
    """What came out of one part of the check.

    Attributes:
        about: what was looked at.
        right: whether it is as it should be.
        mistakes: their names, as in `MISTAKES`; none where it is right, or where no known mistake explains it.
        told: what one sees: lines of text.
    """

    about: str
    right: bool
    mistakes: tuple[str, ...] = ()
    told: tuple[str, ...] = ()

    @property
    def sentences(self) -> list[str]:
        """What is wrong and what would be right, then what one sees."""
        if self.right:
            return []
        named = [f"{MISTAKES[x].what} {MISTAKES[x].why}" for x in self.mistakes]
        return [*(named or ["None of the known mistakes explains it."]), *self.told]


class Checked(NamedTuple):
    """What the check of an agent says; a notebook shows it.

    Attributes:
        what: what was checked, "my_agent.py" or the name of a class.
        exercise: name of the exercise.
        verdicts: one for each part.
        reward: for a right agent what it can do, lines of text; empty otherwise.
    """

    what: str
    exercise: str
    verdicts: tuple[Verdict, ...]
    reward: tuple[str, ...] = ()

    @property
    def right(self) -> bool:
        return all(x.right for x in self.verdicts)

    @property
    def mistakes(self) -> tuple[str, ...]:
        """Names of all mistakes, each once."""
        return tuple(dict.fromkeys(name for x in self.verdicts for name in x.mistakes))

    @property
    def title(self) -> str:
        exercise = EXERCISES[self.exercise]
        return f"{self.what}, exercise {exercise.number}: {exercise.title} ({exercise.source})"

    @property
    def conclusion(self) -> str:
        if self.right:
            return "It is right."
        return "Mend the first of these, and check again."

    def __str__(self) -> str:
        lines = [self.title]
        for x in self.verdicts:
            lines += [f"{'✓' if x.right else '✗'} {x.about}", *(f"  {line}" for line in x.sentences)]
        return "\n".join([*lines, self.conclusion, *self.reward])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        rows = [("right" if x.right else "wrong", x.about, " ".join(x.sentences)) for x in self.verdicts]
        end = " ".join([self.conclusion, *self.reward[:1]])
        return table(f"{self.title}. {end}", ("", "what was looked at", "what is wrong"), rows)


def check(agent: Any, exercise: str | None = None, *, reward: bool = True) -> Checked:
    """Checks an agent, and names the mistakes in it.

    Args:
        agent: a class with `act` and `update`, the function `epsilon_greedy`, or the path of a file that has one.
        exercise: its name, one of `EXERCISES`. By default what the file says (`exercise = "sarsa"`), or what the class
            is called.
        reward: whether a right agent shows on a task with exact values what it can do, which takes a few seconds.

    Raises:
        InputError: nothing can be said of it, as where it does not run; the message is one line with the number of the
            line in the file.
    """
    path = isinstance(agent, str | os.PathLike)
    code = student.load(Path(agent), exercise) if path else student.of(agent, exercise)
    own = EXERCISES[code.exercise]
    with code.watched():
        verdicts = tuple(_of_agent(code, own) if own.learner else _of_function(code))
        checked = Checked(code.where, code.exercise, verdicts)
        if not (reward and checked.right and own.task):
            return checked
        from jaxrl_tab.course.reward import shown  # here, for it starts JAX

        return checked._replace(reward=shown(code, own))


def _of_function(code: Code) -> list[Verdict]:
    choices = behaviour.try_function(code)
    values, rng = np.array([1.0, 2.0, 0.0]), np.random.default_rng(0)
    code.call(student.FUNCTION, code.made, values, 0.0, rng)
    verdicts = [_acts("it draws from all actions with probability ε, else one of the best", choices)]
    if values.tolist() != [1.0, 2.0, 0.0]:
        told = f"The values were [1.0, 2.0, 0.0], and are {values.tolist()}."
        verdicts.append(Verdict("it leaves the values as they are", False, ("changes-values",), (told,)))
    return verdicts


def _of_agent(code: Code, exercise: Exercise) -> list[Verdict]:
    agent = student.Agent(code, Setting(), 0)
    q, verdicts = agent.q(), [Verdict("Q is 0 at the beginning", True)]
    if agent.has_whole_numbers:
        return [Verdict("Q is a table of numbers", False, ("whole-numbers",))]
    if (q != 0).any():
        s, a = np.argwhere(q != 0).tolist()[0]
        told = f"Q({s}, {a}) is {_number(q[s, a])} at the beginning"
        verdicts = [Verdict(verdicts[0].about, False, ("starts-elsewhere",), (told,))]
    return [*verdicts, *_of_behaviour(code), _of_update(code, exercise)]


# --- how it acts -------------------------------------------------------------------------------------


def _of_behaviour(code: Code) -> list[Verdict]:
    seen = behaviour.watch(code)
    about = "its first action in an episode is ε-greedy", "its later actions are ε-greedy"
    first, later = (_acts(what, x) for what, x in zip(about, (seen.starts, seen.within), strict=True))
    if later.right and not first.right:
        end = tuple([0.0] * Setting().num_actions)  # of the state in which episodes end, which learns nothing
        if behaviour.is_stale(seen, Setting().epsilon, end):
            first = first._replace(mistakes=("stale-action",))
    if first.right and not later.right and behaviour.is_by_old(seen, Setting().epsilon):
        later = later._replace(mistakes=("old-state-action",))
    if first.right == later.right and first.mistakes == later.mistakes:
        return [later._replace(about="its actions are ε-greedy")]
    return [first, later]


def _acts(about: str, choices: Sequence[behaviour.Choice]) -> Verdict:
    epsilon = Setting().epsilon
    found = behaviour.diagnose(choices, epsilon)
    if found == ((), ""):
        return Verdict(about, True)
    mistakes, word = found or ((), "")
    told = [f"With ε = {epsilon}, {line}.".replace("-", "−") for line in behaviour.counted(choices, epsilon)]
    if word:
        told.insert(0, f"It looks like ε = {word}, and should be {epsilon}.")
    return Verdict(about, False, mistakes, tuple(told))


# --- what it learns ----------------------------------------------------------------------------------


def _of_update(code: Code, exercise: Exercise) -> Verdict:
    assert exercise.learner
    seen = script.record(code, exercise)
    about = f"what it learns, in {len(seen)} steps"
    mistakes = script.diagnose(seen, exercise)
    if mistakes == ():
        return Verdict(about, True)
    bad = script.wrong(seen, exercise.learner(Setting()))
    # Nobody says when the agent means to learn, at once or a step later: it is what makes fewer steps wrong.
    bad_late = script.wrong(seen, exercise.learner(Setting()), late=True)
    late = len(bad_late) < len(bad)
    bad = bad_late if late else bad
    told = [*([_where(bad, seen)] if mistakes is None else []), *_first(bad[0], seen, exercise, late)]
    return Verdict(about, False, mistakes or (), tuple(filter(None, told)))


def _first(x: Seen, seen: Sequence[Seen], exercise: Exercise, late: bool) -> list[str]:
    """The first step after which Q is wrong: what happened, what would be right, and what it is."""
    assert exercise.learner
    steps = script.follow(seen, exercise.learner(Setting()), late)
    tables = next(tables for y, tables in steps if y is x)
    right = min(tables, key=lambda t: float(np.abs(t - x.after).max()))
    off = np.argwhere(np.abs(right - x.after) > script.CLOSE * (1 + np.abs(x.after).max())).tolist()
    when = ""
    if late and x.number > 1 and not x.step.last:  # what is learned then is the step before
        one_before = next(y for y, z in pairwise(seen) if z is x)
        x, when = one_before._replace(before=x.before, after=x.after), " (learned in the update after it)"
    step = x.step
    end = ", terminated" if step.terminated else ", truncated" if step.truncated else ""
    next_action = "" if x.a_next is None or step.last else f", then A' = {x.a_next}"
    happened = (
        f"It shows first in episode {x.episode}, step {x.number}{when}: S = {step.s}, A = {step.a}, "
        f"R = {_number(step.r)}, S' = {step.s_next}{end}{next_action}."
    )
    pairs = sorted(off, key=lambda pair: pair != [step.s, step.a])
    many = f" {len(pairs)} values are wrong; these are some of them." if len(pairs) > 3 else ""
    should = "should be" if len(tables) == 1 or step.terminated else "should, with one A' of all, be"
    lines = [
        f"Q({s}, {a}) was {_number(x.before[s, a])}, {should} {_number(right[s, a])}, and is {_number(x.after[s, a])}."
        for s, a in pairs[:3]
    ]
    return [happened + many, *lines, *_worked_out(x, exercise)]


def _worked_out(x: Seen, exercise: Exercise) -> list[str]:
    """The right update in numbers, where it is that of one step."""
    if exercise.title not in ("Sarsa", "Q-learning"):
        return []
    step, set_ = x.step, Setting()
    old, row = x.before[step.s, step.a], x.before[step.s_next]
    target = _number(step.r)
    what = "R"
    if not step.terminated:
        if exercise.title == "Sarsa" and x.a_next is None:
            return []
        value = row.max() if exercise.title == "Q-learning" else row[x.a_next]
        what = "R + γ max Q(S', a)" if exercise.title == "Q-learning" else "R + γ Q(S', A')"
        target = f"{_number(step.r)} + {set_.gamma} · {_signed(value)}"
    return [
        f"Right: Q(S, A) + α [{what} − Q(S, A)] = {_number(old)} + {set_.alpha} [{target} − {_signed(old)}]."
    ]


def _signed(x: float) -> str:
    return f"({_number(x)})" if x < 0 else _number(x)


def _number(x: float) -> str:
    return f"{x:.5g}".replace("-", "−")


KINDS: Sequence[tuple[str, Callable[[Seen], bool]]] = (
    ("steps that end in a terminal state", lambda x: x.step.terminated),
    ("steps that a time limit ends", lambda x: x.step.truncated),
    ("steps that end an episode", lambda x: x.step.last),
    ("steps in which S' is S", lambda x: x.step.s == x.step.s_next),
    ("the first steps of episodes", lambda x: x.number == 1),
    ("steps in which A' is no best action", lambda x: _is_worse(x)),
    ("steps that do not end an episode", lambda x: not x.step.last),
    ("steps after the first of an episode", lambda x: x.number > 1),
    ("episodes after the first", lambda x: x.episode > 1),
)


def _is_worse(x: Seen) -> bool:
    row = x.before[x.step.s_next]
    return x.a_next is not None and bool(row[x.a_next] < row.max())


def _where(bad: Sequence[Seen], seen: Sequence[Seen]) -> str:
    """What the steps have in common that go wrong, where that says something."""
    if not bad or len(bad) == len(seen):
        return ""
    count = f"{len(bad)} of {len(seen)} steps go wrong"
    fits = [(sum(map(is_one, seen)), what) for what, is_one in KINDS if all(map(is_one, bad))]
    if len(bad) < 2 or not fits:
        return f"{count}."
    number, what = min(fits)
    return (
        f"{count}, and all of them are {what} (there are {number})."
        if "steps" in what
        else (f"{count}, all of them in {what}.")
    )
