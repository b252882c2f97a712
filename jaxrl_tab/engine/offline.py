"""Learning without acting: from a log of what somebody else did, and again from what was remembered.

The lecture gives four reasons why off-policy learning matters (Silver, lecture 5, "Off-Policy Learning"):

1. *Learn from observing humans or other agents*: put their transitions or episodes into an `Experience`, and
   `learn` from it.
2. *Re-use experience generated from old policies*: `replay` it. (`collect` logs a run as an `Experience`.)
3. *Learn about the optimal policy while following an exploratory policy*: that is `train` with `QLearning`.
4. *Learn about multiple policies while following one policy*: `train` (or `learn`, or `replay`) with
   `ManyTargets`.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.algorithms.prediction import METHODS
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import rng, tables
from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.types import (
    Algorithm,
    Environment,
    InputError,
    Task,
    Transition,
    available_actions,
    check_available,
    check_pytree,
    concrete,
    first,
    init_learner,
    pytree,
    restricted,
    said_of_update,
    shown,
    whole,
)
from jaxrl_tab.engine.train import train
from jaxrl_tab.envs import ENVS
from jaxrl_tab.envs.base import assign, numbers

L = TypeVar("L")

NAME = "Experience"
WHOLE, REAL = ("iu", "whole numbers"), ("iuf", "numbers")  # kinds of dtypes
TRUTH = "b", "booleans, or 0 and 1"
KINDS = {"s": WHOLE, "a": WHOLE, "r": REAL, "s_next": WHOLE, "terminal": TRUTH, "last": TRUTH}


# --- the data ----------------------------------------------------------------------------------------


@pytree
class Experience:
    """N transitions (S, A, R, S'), in the order in which they happened.

    Arrays or lists; traced arrays are taken as they are, unchecked.

    Attributes:
        s: S, whole numbers [N].
        a: A, whole numbers [N].
        r: R, finite numbers [N].
        s_next: S', the state before any reset, whole numbers [N].
        terminal: whether S' is terminal, booleans (or 0 and 1) [N]. A time limit makes no state terminal.
        last: where episodes end, booleans [N]: at terminal states; where a time limit, or the end of the log,
            cuts one short. Elsewhere the next transition starts in S'. By default only terminal states and
            the end of the log are. `True` stands for True everywhere: transitions in no order.

    Raises:
        InputError: something is wrong, named with the index of the first wrong transition.
    """

    s: Int[Any, " N"]
    a: Int[Any, " N"]
    r: Float[Any, " N"]
    s_next: Int[Any, " N"]
    terminal: Bool[Any, " N"]
    last: Bool[Any, " N"] | Any = None

    def __post_init__(self):
        given = vars(self) | {"last": _ends(self.terminal) if self.last is None else self.last}
        fields = {
            name: _truth(name, x) if KINDS[name] is TRUTH else numbers(NAME, name, x)
            for name, x in given.items()
        }
        if any(concrete(x) is None for x in fields.values()):
            return
        if fields["last"].ndim == 0:
            fields["last"] = np.full(fields["s"].shape, fields["last"])
        for name, kind in KINDS.items():
            _check_array(name, fields[name], kind, fields["s"].size)
        assign(self, **fields)
        self._check_order()

    def _check_order(self) -> None:
        if (i := first(~np.isfinite(self.r))) is not None:
            raise InputError(f"{NAME}: r[{i[0]}] is {self.r[i]}, not a finite number")
        if (i := first(self.terminal & ~self.last)) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} enters a terminal state, which ends the episode: "
                f"last[{i[0]}] must be True"
            )
        if not self.last[-1]:
            raise InputError(
                f"{NAME}: the last transition must end its episode, if only because the log does: "
                f"last[{len(self.last) - 1}] must be True"
            )
        if (i := first((self.s_next[:-1] != self.s[1:]) & ~self.last[:-1])) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} leads to state {self.s_next[i]}, and transition {i[0] + 1} "
                f"starts in state {self.s[1:][i]}; if an episode was cut short there, last[{i[0]}] must be "
                "True; for transitions in no order give last=True"
            )

    @classmethod
    def from_episodes(
        cls, episodes: Sequence[tuple[Any, Any, Any]], terminal: bool | Bool[Any, " E"] = True
    ) -> "Experience":
        """The experience of E episodes S_0, A_0, R_1, S_1, A_1, R_2, ..., S_T.

        Args:
            episodes: of each the states S_0 to S_T, whole numbers [T + 1]; the actions A_0 to A_{T-1}, whole
                numbers [T]; and the rewards R_1 to R_T, [T]. T may differ, and is at least 1.
            terminal: whether S_T is terminal, for each episode or for all; if not, it was cut short.

        Raises:
            InputError: as `Experience`; the message names the first wrong episode.
        """
        try:
            episodes = list(episodes)
        except TypeError:
            raise InputError(
                f"{NAME}: episodes must be a list of (states, actions, rewards), not {shown(episodes)}"
            ) from None
        if not episodes:
            raise InputError(f"{NAME}: there must be at least one episode")
        columns = []
        for e, episode in enumerate(episodes):
            try:
                s, a, r = episode
            except (TypeError, ValueError):
                raise InputError(
                    f"{NAME}: episode {e} must be (states, actions, rewards), not {shown(episode)}"
                ) from None
            given = {"s": s, "a": a, "r": r}
            s, a, r = (numbers(NAME, f"{name} of episode {e}", x) for name, x in given.items())
            if a.ndim != 1 or not len(a) or r.shape != a.shape or s.shape != (len(a) + 1,):
                raise InputError(
                    f"{NAME}: episode {e} must have T actions, T rewards and T + 1 states, the last one "
                    f"included, for a T of at least 1; not arrays of shape {a.shape}, {r.shape} and {s.shape}"
                )
            columns.append((s[:-1], a, r, s[1:], np.arange(len(a)) == len(a) - 1))
        s, a, r, s_next, last = map(np.concatenate, zip(*columns, strict=True))
        return cls(s, a, r, s_next, _terminal_ends(terminal, last), last)

    @classmethod
    def from_padded(
        cls, s: Any, a: Any, r: Any, lengths: Int[Any, " E"], terminal: bool | Bool[Any, " E"] = True
    ) -> "Experience":
        """The experience of E episodes in arrays as long as the longest of them.

        Args:
            s: the states S_0 to S_T of each episode, whole numbers [E, T_max + 1]; then anything.
            a: the actions A_0 to A_{T-1}, whole numbers [E, T_max].
            r: the rewards R_1 to R_T, [E, T_max].
            lengths: T of each episode, whole numbers [E], from 1 to T_max.
            terminal: whether S_T is terminal, for each episode or for all; if not, it was cut short.

        Raises:
            InputError: as `Experience`.
        """
        given = {"s": s, "a": a, "r": r, "lengths": lengths}
        s, a, r, lengths = (numbers(NAME, name, x) for name, x in given.items())
        shape = a.shape
        if (
            a.ndim != 2
            or r.shape != shape
            or s.shape != (shape[0], shape[1] + 1)
            or lengths.shape != shape[:1]
        ):
            raise InputError(
                f"{NAME}: a and r must be [E, T], s [E, T + 1] with the last states, and lengths [E]; not "
                f"{a.shape}, {r.shape}, {s.shape} and {lengths.shape}"
            )
        _check_array("lengths", lengths, WHOLE, shape[0])
        if (e := first((lengths < 1) | (lengths > shape[1]))) is not None:
            raise InputError(f"{NAME}: lengths[{e[0]}] is {lengths[e]}, and must be from 1 to {shape[1]}")
        steps = np.arange(shape[1])
        there = steps < lengths[:, None]
        last = (steps == lengths[:, None] - 1)[there]
        return cls(
            s[:, :-1][there], a[there], r[there], s[:, 1:][there], _terminal_ends(terminal, last), last
        )

    def check(self, num_states: int, num_actions: int, behaviour: Table | None = None) -> None:
        """Raises InputError unless this can be experience of such a task, and of such a policy.

        Args:
            num_states: the number of states of the task, terminal ones included.
            num_actions: the number of its actions.
            behaviour: the policy that is said to have acted.
        """
        num_states, num_actions = (
            whole(NAME, "num_states", num_states),
            whole(NAME, "num_actions", num_actions),
        )
        if behaviour is not None:
            behaviour.check(num_states, num_actions)
        if any(concrete(x) is None for x in vars(self).values()):
            return
        states, actions = ("state", num_states), ("action", num_actions)
        for name, (what, count) in {"s": states, "a": actions, "s_next": states}.items():
            x = getattr(self, name)
            if (i := first((x < 0) | (x >= count))) is not None:
                raise InputError(f"{NAME}: {name}[{i[0]}] is {x[i]}; the task has {what}s 0 to {count - 1}")
        b = None if behaviour is None else concrete(behaviour.probabilities)
        if b is not None and (i := first(b[self.s, self.a] == 0)) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} takes action {self.a[i]} in state {self.s[i]}, which the "
                "behaviour policy never does; it is not the policy that acted"
            )

    def check_available(self, available: Bool[Any, "S A"]) -> None:
        """Raises InputError where an action was taken that its state does not have; traced ones pass."""
        there, s, a = (concrete(x) for x in (available, self.s, self.a))
        if there is None or s is None or a is None:
            return
        if (i := first(~there.astype(bool)[s, a])) is not None:
            raise InputError(
                f"{NAME}: transition {i[0]} takes action {a[i]} in state {s[i]}, which does not have it; see available"
            )

    def transitions(self, gamma: Any, dtype: Any) -> Transition:
        """What methods learn from: a Transition of [N] each, with rewards and gamma' of type `dtype`."""
        s, a, s_next = (jnp.asarray(x, jnp.int32) for x in (self.s, self.a, self.s_next))
        terminal, last = jnp.asarray(self.terminal, bool), jnp.asarray(self.last, bool)
        discount = jnp.where(terminal, 0, jnp.asarray(gamma, dtype))
        return Transition(s, a, jnp.asarray(self.r, dtype), s_next, discount, last)


def _check_array(name: str, x: np.ndarray, kind: tuple[str, str], size: int) -> None:
    """Raises InputError unless `x` has one axis of this size, 1 or more, and a dtype of this kind."""
    letters, words = kind
    if x.ndim != 1 or not x.size:
        raise InputError(f"{NAME}: {name} must be {words} [N], at least one, not of shape {list(x.shape)}")
    if len(x) != size:
        raise InputError(f"{NAME}: {name} must have length {size}, as s has, not {len(x)}")
    if x.dtype.kind not in letters:
        raise InputError(f"{NAME}: {name} must be {words}, not {x.dtype}")


def _truth(name: str, value: Any) -> Any:
    """`value` as booleans, where it is nothing but 0 and 1, as a file of numbers has them; else as it is."""
    x = numbers(NAME, name, value)
    return x.astype(bool) if concrete(x) is None or np.isin(x, (0, 1)).all() else x


def _ends(terminal: Any) -> Any:
    """The ends of episodes where only terminal states end them, and the end of the log."""
    terminal = _truth("terminal", terminal)
    if terminal.ndim != 1 or terminal.dtype != bool:
        return terminal  # which is refused later
    return terminal | (np.arange(terminal.size) == terminal.size - 1)


def _terminal_ends(terminal: Any, last: Bool[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Which transitions enter a terminal state, where `terminal` says it of all episodes, or of each."""
    terminal, ends = _truth("terminal", terminal), np.flatnonzero(last)
    if terminal.dtype.kind != "b" or terminal.shape not in ((), ends.shape):
        raise InputError(
            f"{NAME}: terminal must be True, False, or booleans [E] = {list(ends.shape)}, not "
            f"{terminal.dtype} {list(terminal.shape)}"
        )
    enters = np.zeros_like(last)
    enters[ends] = terminal
    return enters


# --- learning from it --------------------------------------------------------------------------------


def learn(
    key: Key[Array, ""],
    algorithm: Algorithm[L],
    experience: Experience,
    num_states: int,
    num_actions: int,
    *,
    passes: int = 1,
    available: Any = None,
) -> L:
    """Learns from experience of somebody else, transition by transition, in the order of the log.

    One-step methods that learn about a target policy of their own need no more than the transitions:
    QLearning, ExpectedSarsa, TargetQLearning, DoubleQLearning, ManyTargets. Those with importance sampling,
    OffPolicyMonteCarlo and the off-policy ones of `prediction`, need to know the policy that acted,
    `behaviour=policies.Table(b)`. Where a method has such a behaviour policy, the actions of the log must be
    possible under it. What can be learned at all depends on which pairs (s, a) the log holds.

    Args:
        key: a JAX key, for what the method itself draws.
        algorithm: the method with its hyperparameters.
        experience: the log.
        num_states: the number of states of the task, terminal ones included.
        num_actions: the number of its actions.
        passes: how often to go through the log. Schedules go on counting.
        available: which actions there are in each state, bool [S, A], where a state does not have all.

    Returns:
        The state of the learner (`.q` is float [S, A]).

    Raises:
        InputError: the method can learn only from what it did itself; or the log is not experience of such a
            task, or not of the behaviour policy that the method was given; or it holds an action that is not
            available.
    """
    rng.check_key(key)
    algorithm = _checked(algorithm, experience, num_states, num_actions, available)
    task = Task(int(num_states), int(num_actions), _longest_episode(experience))
    return _learn(key, algorithm, experience, task, whole("learn", "passes", passes))


def replay(
    key: Key[Array, ""],
    algorithm: Algorithm[L],
    experience: Experience,
    num_states: int,
    num_actions: int,
    *,
    num_updates: int,
    available: Any = None,
) -> L:
    """Learns again and again from remembered transitions, each drawn uniformly (Lin 1992).

    For one-step off-policy methods: QLearning, ExpectedSarsa, TargetQLearning, DoubleQLearning, ManyTargets
    and `prediction.OffPolicyTD`.
    Schedules by episode count the ends of episodes that were drawn.

    Args:
        key: a JAX key.
        algorithm: the method with its hyperparameters.
        experience: the memory; of one old policy or of many, in any order.
        num_states: the number of states of the task, terminal ones included.
        num_actions: the number of its actions.
        num_updates: how many transitions to draw, with replacement.
        available: as in `learn`.

    Returns:
        The state of the learner (`.q` is float [S, A]).

    Raises:
        InputError: as `learn`; or the method learns from whole episodes.
    """
    rng.check_key(key)
    algorithm = _checked(algorithm, experience, num_states, num_actions, available)
    if said_of_update(algorithm, "learns_from").startswith("episodes"):
        raise InputError(
            f"replay draws single transitions, and {type(algorithm).__name__} learns from whole episodes: "
            "learn takes it; or give a one-step method such as QLearning"
        )
    task = Task(int(num_states), int(num_actions), max_steps=1)
    return _replay(key, algorithm, experience, task, whole("replay", "num_updates", num_updates))


def _checked(algorithm: Any, experience: Any, num_states: int, num_actions: int, available: Any) -> Any:
    """The method as it is among the actions that are available. Raises InputError as `learn` does."""
    check_pytree("algorithm", algorithm, METHODS)
    if not isinstance(experience, Experience):
        raise InputError(f"experience must be an Experience, not {type(experience).__name__}")
    name, learns_from = type(algorithm).__name__, said_of_update(algorithm, "learns_from")
    if learns_from is None:
        raise InputError(
            f"{name} can learn only from what it did itself; take QLearning for the optimal policy, or "
            "ExpectedSarsa(target=policies.Table(pi)) for the values of any policy, that of the log too"
        )
    behaviour = getattr(algorithm, "behaviour", None)
    behaviour = behaviour if isinstance(behaviour, Table) else None
    if learns_from.endswith(" of b") and behaviour is None:
        raise InputError(
            f"{name} weighs what it learns by the policy that acted, which must be given: "
            "behaviour=policies.Table(b)"
        )
    experience.check(num_states, num_actions, behaviour)
    if available is None:
        return algorithm
    there = numbers("learn", "available", available)
    check_available("learn: available", there, num_states, num_actions)
    experience.check_available(there)
    return restricted(algorithm, there.astype(bool))


def _longest_episode(experience: Experience) -> int:
    last = concrete(experience.last)
    if last is None:
        return experience.last.shape[-1]  # not known, but no longer than the log
    return int(np.diff(np.flatnonzero(last), prepend=-1).max())


UPDATE, DRAW = 0, 1  # decisions, as `rng` numbers them


# How often is no constant of the programs, so another number needs no new one.
@partial(jax.jit, static_argnums=3, inline=True)
def _learn(key, algorithm, experience, task, passes):
    learner = init_learner(algorithm, task)
    transitions = experience.transitions(algorithm.gamma, learner.q.dtype)
    stream, size = rng.stream(key), len(transitions.s)

    def update(learner, numbered):
        i, t = numbered
        learner, _ = algorithm.update(rng.as_key(rng.word(stream, i, UPDATE)), learner, t)
        return learner, None

    def one_pass(k, learner):
        return lax.scan(update, learner, (k * size + jnp.arange(size), transitions))[0]

    return lax.fori_loop(0, passes, one_pass, learner)


@partial(jax.jit, static_argnums=3, inline=True)
def _replay(key, algorithm, experience, task, num_updates):
    learner = init_learner(algorithm, task)
    transitions = experience.transitions(algorithm.gamma, learner.q.dtype)
    stream, size = rng.stream(key), len(transitions.s)

    def update(i, learner):
        update_key, draw_key = (rng.as_key(rng.word(stream, i, decision)) for decision in (UPDATE, DRAW))
        drawn = jax.random.randint(draw_key, (), 0, size)
        t = jax.tree.map(lambda x: tables.entry(x, drawn), transitions)
        learner, _ = algorithm.update(update_key, learner, t)
        return learner

    return lax.fori_loop(0, num_updates, update, learner)


# --- logging a run -----------------------------------------------------------------------------------


def collect(
    key: Key[Array, ""], behaviour: Algorithm | Table | Float[Any, "S A"], env: Environment, num_steps: int
) -> Experience:
    """Logs what a method or a fixed policy does in an environment.

    Args:
        key: a JAX key. With a method it is the run of `train(key, method, env, num_steps=num_steps)`.
        behaviour: a method, which learns as it goes; or the probabilities of a policy, [S, A] or a
            `policies.Table` of them.
        env: the environment.
        num_steps: how many steps to log. The log cuts the last episode short, as a time limit would.

    Raises:
        InputError: an argument is wrong.
    """
    method = _method(behaviour)
    check_pytree("env", env, ENVS)
    method = restricted(method, available_actions(env))
    logged = _Logged(method, init_learner(method, env))
    _, log = train(key, logged, env, num_steps=num_steps, log_every=1, record=_transition)
    assert log.recorded is not None
    t = Transition(**log.recorded)
    return Experience(t.s, t.a, t.r, t.s_next, terminal=t.discount == 0, last=t.last.at[-1].set(True))


def _method(behaviour: Any) -> Any:
    """What acts, as a method."""
    if isinstance(behaviour, type | str) or hasattr(behaviour, "update"):
        check_pytree("behaviour", behaviour, METHODS)
        return behaviour
    if hasattr(behaviour, "probs") and not isinstance(behaviour, Table):
        raise InputError(
            f"collect: {type(behaviour).__name__} chooses by Q, and nobody has learned one here; give its "
            "probabilities [S, A], such as planning.epsilon_greedy_policy(q, 0.1), or a method"
        )
    return _Acts(behaviour=behaviour if isinstance(behaviour, Table) else Table(behaviour))


@pytree
class _Acts(TDControl):
    """Acts and learns nothing."""

    acts_after_update: ClassVar[bool] = True

    def update(self, key, state, t: Transition):
        return state, self.policy(key, state, t.s_next)


class _LoggedState(NamedTuple):
    """What a method learned, and its last transition."""

    learner: Any
    t: Transition

    @property
    def q(self) -> Float[Array, "S A"]:
        return self.learner.q


def _transition(state: _LoggedState) -> dict[str, Array]:
    return state.t._asdict()


@pytree
class _Logged:
    """A method whose last transition can be seen."""

    method: Any
    start: Any  # the state of its learner before the first step

    @property
    def gamma(self) -> float:
        """1, so that gamma' tells terminal states, whatever the method's gamma is."""
        return 1.0

    @property
    def exploring_starts(self) -> bool:
        return getattr(self.method, "exploring_starts", False)

    def restricted_to(self, available: Bool[Array, "S A"]) -> Self:
        return self  # its method was, before it began

    def init(self, num_states: int, num_actions: int) -> _LoggedState:
        zero, real = jnp.int32(0), jnp.zeros((), self.start.q.dtype)
        return _LoggedState(self.start, Transition(zero, zero, real, zero, real, jnp.bool(False)))

    def policy(self, key, state: _LoggedState, s: Int[Array, ""]) -> Int[Array, ""]:
        return self.method.policy(key, state.learner, s)

    def update(self, key, state: _LoggedState, t: Transition):
        discount = jnp.asarray(self.method.gamma, t.discount.dtype) * t.discount
        learner, a_next = self.method.update(key, state.learner, t._replace(discount=discount))
        return _LoggedState(learner, t), a_next
