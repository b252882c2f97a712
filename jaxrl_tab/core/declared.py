"""What methods and environments declare about themselves, with what holds where they declare nothing.

A declaration is an attribute of the class, such as `learns = "states"`; nobody needs a base class for it. All
code asks `of_method` and `of_environment`, so that what can be declared, and its default, stands here alone.
"""

import itertools
from collections.abc import Callable
from enum import StrEnum
from typing import Any, NamedTuple

from jaxrl_tab.core import backups
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.errors import check_choice


class Learns(StrEnum):
    """What a method learns, as a table.

    In control action values Q [S, A], or preferences theta [S, A], of which its policy is the softmax; in prediction
    state values V [S].
    """

    ACTIONS = "actions"
    STATES = "states"
    PREFERENCES = "preferences"

    @property
    def initial(self) -> str:
        """The field of a method that holds the first value of all entries."""
        return {Learns.ACTIONS: "q0", Learns.STATES: "v0", Learns.PREFERENCES: "theta0"}[self]

    @property
    def symbol(self) -> str:
        """What the table is called in formulas."""
        return {Learns.ACTIONS: "Q", Learns.STATES: "V", Learns.PREFERENCES: "θ"}[self]


class LearnsFrom(StrEnum):
    """What experience an `update` learns rightly from, besides that of the method itself."""

    ITSELF = "itself"
    TRANSITIONS = "transitions"
    TRANSITIONS_OF_B = "transitions of b"
    EPISODES = "episodes"
    EPISODES_OF_B = "episodes of b"

    @property
    def needs_behaviour(self) -> bool:
        """Whether the method must be told the policy b that acted."""
        return self in (LearnsFrom.TRANSITIONS_OF_B, LearnsFrom.EPISODES_OF_B)

    @property
    def in_episodes(self) -> bool:
        """Whether the transitions must come in the order of their episodes."""
        return self in (LearnsFrom.EPISODES, LearnsFrom.EPISODES_OF_B)


class OfMethod(NamedTuple):
    """What a method declares.

    Attributes:
        learns: "actions" in control, or "preferences" where these are learned instead of values; "states" in
            prediction. A method of prediction also has the policy `pi`, and `measurer(env)` and `exact_value(env)` for
            its values, as `prediction.Prediction` has them.
        learns_from: what experience of somebody else `update` learns rightly from (see `offline`):
            "transitions", any of them in any order; "transitions of b", where the method is told the policy b
            that acted, as a table in its field `behaviour`; "episodes", or "episodes of b", in order; or only
            from "itself".
            The class that defines `update` declares it, or a subclass without an `update` of its own.
        acts_after_update: whether `update` draws A' as its last act, as `policy(key, new state, S')`, and
            learns nothing from it. The driver then draws A' itself, together with the first actions of
            episodes, which makes a step a quarter faster and changes no decision. The class that defines
            `update` declares it, or a subclass without an `update` of its own.
        multiplies_returns: whether returns are multiplied by ratios of importance sampling. What is learned may
            then be greater than any return, and is no sign that the method diverges.
        exploring_starts: whether episodes start in any state with any action.
        needs_horizon: whether it is for tasks alone that end after a given number of steps. What it learns are bounds,
            which may be greater than any return.
        in_the_long_run: whether it learns about the average reward of a step, in tasks that do not end.
        measures: of a method of prediction, the fields of the log that its `measurer` gives; where states cannot be
            counted it is the first of them alone.
        records: names of fields of its state that are recorded at the end of every row of the log.
        works_with: gives, from a state, arrays of the shapes of those with which `update` works beside it, for the
            forecast of memory; None where these are no more than some numbers of each state and action.
        behaviour: the policy that acts, where the method was given one.
        features: the features of a state of which its values are a linear function; None where they are a table.
        left_to_xla: why `lanes` does not compile it: what it does in a step XLA does better. Empty where it does.
        backup: the diagram of what `update` looks ahead to, a `Backup` or its levels as text; None where nobody has
            drawn it. The class that defines `update` declares it, or a subclass without an `update` of its own.
    """

    learns: Learns = Learns.ACTIONS
    learns_from: LearnsFrom = LearnsFrom.ITSELF
    acts_after_update: bool = False
    multiplies_returns: bool = False
    exploring_starts: bool = False
    needs_horizon: bool = False
    in_the_long_run: bool = False
    measures: tuple[str, ...] = ("v_error",)
    records: tuple[str, ...] = ()
    works_with: Callable[[Any], Any] | None = None
    behaviour: Any = None
    features: Any = None
    left_to_xla: str = ""
    backup: Backup | None = None


class OfEnvironment(NamedTuple):
    """What an environment declares beyond `types.Environment`, whose docstring explains the first four.

    Attributes:
        instance: draws the problem of one run; None where all runs have the same one.
        at: what it is in a step of a run, from the number of that; None where it is the same in all.
        mean_optimal_value: the mean over problems of v* from the start; None where it is not known.
        available: which actions a state has; None where each has all.
        panels: the tables in which people see the states, as `envs.base.Panel`; none where they are a list.
        state_name: the name of a state from its number, where panels do not say it.
        action_names: a short name of each action, for pictures; their numbers where there are none.
        discount: the discount rate that its source states; None where it states none. What counts is gamma, which
            belongs to the method: this is what the command mentions.
        continuing: whether it has no terminal states, so that only its time limit ends an episode.
        horizon: H, after how many steps every episode has ended, where its states tell how many were taken: after h
            steps it is one of the S states from h S on, and state H S, the last, is the end. None where an episode may
            go on, or its states do not tell.
        low, high: the least and the largest that each number may be which is observed of a state; infinite where there
            is no bound. None where states are counted, and their number is all that is observed.
        number_names: what each of these numbers is, for pictures; () where that is not said.
        observation: the numbers that are observed of a state, float [d]; None where they are the state itself, or its
            number.
        wind: how strong the wind is in each column of a grid, [columns]; None, or (), where there is none.
        features: the features of every state that its source gives it, float [S, n]: what the features "own" are. None
            where it gives none.
        target_policy, behaviour_policy: the policy whose values its source asks for, and the one that acts, float
            [S, A]: those of a method of prediction that was given none. None where its source says nothing of them.
        picture: a drawing of a state that is numbers, from these, in lines of text; None where there is none.
        known_values: where states cannot be counted, and it is known all the same what they are worth, whatever the
            policy: some of them, float [N, d], that are equally likely, and the value of each, float [N].
        title: what it is called, where its class alone does not say it; else None.
    """

    instance: Callable[..., Any] | None = None
    at: Callable[..., Any] | None = None
    mean_optimal_value: Callable[[float], float] | None = None
    available: Callable[..., Any] | None = None
    panels: Callable[[], tuple[Any, ...]] = tuple
    state_name: Callable[[int], str] | None = None
    action_names: tuple[str, ...] = ()
    wind: Any = None
    discount: float | None = None
    continuing: bool = False
    horizon: int | None = None
    low: tuple[float, ...] | None = None
    high: tuple[float, ...] | None = None
    observation: Callable[[Any], Any] | None = None
    features: Any = None
    target_policy: Any = None
    behaviour_policy: Any = None
    number_names: tuple[str, ...] = ()
    picture: Callable[[Any], tuple[str, ...]] | None = None
    known_values: Callable[[], tuple[Any, Any]] | None = None
    title: str | None = None

    @property
    def observed_names(self) -> tuple[str, ...]:
        """What each of the numbers is that a state is."""
        return self.number_names or tuple(f"number {i + 1}" for i in range(len(self.low or ())))

    @property
    def differs(self) -> str:
        """How it differs between runs or their steps, in words; empty where it is the same in all."""
        if self.instance is not None:
            return "each run has a problem of its own"
        return "" if self.at is None else "the task changes while a run goes on"


def of_method(method: Any) -> OfMethod:
    """What a method declares, or its class, which has no value yet of a property like `multiplies_returns`.

    Raises:
        InputError: what it learns, or learns from, is none of the texts that there are for it; or its diagram is not
            written as one.
    """
    cls, values = method if isinstance(method, type) else type(method), _declared(OfMethod, method)
    # A subclass with an `update` of its own inherits nothing that was said of another one.
    for name in ("learns_from", "acts_after_update", "backup"):
        if any("update" in vars(c) for c in _above(cls, name)):
            values[name] = OfMethod._field_defaults[name]
    values["backup"] = backups.checked(cls.__name__, values["backup"])
    for name, kind in (("learns", Learns), ("learns_from", LearnsFrom)):
        check_choice(cls.__name__, name, values[name], [*kind])
        values[name] = kind(values[name])
    return OfMethod(**values)


def of_environment(env: Any) -> OfEnvironment:
    """What an environment declares."""
    values = _declared(OfEnvironment, env)
    values["action_names"] = values["action_names"] or tuple(map(str, range(env.num_actions)))
    if isinstance(values["wind"], tuple):
        values["wind"] = values["wind"] or None
    return OfEnvironment(**values)


def name_of(env: Any) -> str:
    """What an environment is called in a message: its title, or its class."""
    return getattr(env, "title", None) or type(env).__name__


def _above(cls: type, name: str) -> list[type]:
    """The classes that come before the one in which `cls` finds the attribute `name`: itself and its nearer bases."""
    return list(itertools.takewhile(lambda c: name not in vars(c), cls.__mro__))


def _declared(kind: Any, obj: Any) -> dict[str, Any]:
    """The fields of `kind` as `obj` has them as attributes, or else by default."""
    return {name: getattr(obj, name, default) for name, default in kind._field_defaults.items()}
