"""The vocabulary of the package: what an environment answers, what a method learns from.

Everything here is written for **one** transition; `jax.vmap` makes the batches. Symbols follow
Sutton and Barto (2018): S, A, R, S', A', gamma, alpha, epsilon, pi, delta.
"""

import dataclasses
import difflib
import inspect
import os
import reprlib
import sys
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, dataclass_transform, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, Key

T = TypeVar("T")
L = TypeVar("L")


class InputError(ValueError):
    """Something that the user gave is wrong; the message is one line that says what would be right."""


class RunError(RuntimeError):
    """What was asked for is right, and could not be finished here; the message is one line that says why."""


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
SHOWN = 120  # characters of a value, at most


def shown(value: Any) -> str:
    """`value` as a message names it: in one short line, whatever it is."""
    if isinstance(value, np.ndarray | jax.Array) and value.ndim:
        if value.ndim > 1 or concrete(value) is None:
            return f"an array of shape {value.shape}"
        return one_line(np.array2string(np.asarray(value[:9]), max_line_width=1000, threshold=8))
    try:
        return one_line(_SHORT.repr(value))
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return f"a number of more than {sys.get_int_max_str_digits()} digits"


def one_line(text: str) -> str:
    """`text` in one line that is not long: the end is cut off where it would be."""
    line = " ".join(text.split())
    return line if len(line) <= SHOWN else line[: SHOWN - 4] + " ..."


def reason(error: BaseException) -> str:
    """What an error says, in one line; the name of its class where it says nothing."""
    return one_line(getattr(error, "strerror", None) or str(error)) or type(error).__name__


def nearest(name: Any, names: Iterable[str]) -> str:
    """Returns "did you mean 'x'?" for the name most like `name`, or one that begins so; else all `names`."""
    names, name = list(names), (name if isinstance(name, str) else "").lower().replace("_", "-")
    begins = [x for x in names if name and x.startswith(name)]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5) or begins
    return f"did you mean '{close[0]}'?" if close else f"choose one of {', '.join(names)}"


def check_choice(name: str, what: str, value: Any, choices: Iterable[str]) -> None:
    """Raises InputError unless `value` is one of the texts in `choices`; the message names the nearest."""
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"{name}: {what} {shown(value)} is unknown; {nearest(value, choices)}")


def build(cls: type[T], name: str, parameters: Mapping[str, Any]) -> T:
    """`cls(**parameters)`, where `name` is what a person calls the class.

    Raises:
        InputError: a parameter is unknown, with the nearest right one; or `cls` refuses a value.
    """
    known = [f.name for f in dataclasses.fields(cls)]  # pyright: ignore[reportArgumentType]
    for parameter in parameters:
        if parameter not in known:
            raise InputError(f"{name} has no parameter {shown(parameter)}; {nearest(parameter, known)}")
    return cls(**parameters)


def as_path(what: str, given: Any) -> Path:
    """`given` as a path. Raises InputError unless it is one that the system can be asked for."""
    try:
        known = isinstance(given, str | os.PathLike) and b"\0" not in os.fsencode(given)
    except UnicodeEncodeError:
        known = False
    if not known:
        raise InputError(f"{what} must be named by a text, or a Path, not {shown(given)}")
    return Path(given)


TOLERANCE = 1e-6  # of a sum of probabilities: tables in float32 pass, thirds written as 0.333 do not


def is_distribution(prob: np.ndarray) -> Any:
    """Whether the last axis holds probabilities that add up to 1, bool [...]."""
    return (prob >= 0).all(-1) & (abs(prob.sum(-1) - 1) < TOLERANCE)


def first(wrong: np.ndarray) -> Any:
    """The index of the first True, as a tuple of int, or None: what a message about an array names."""
    return tuple(int(i) for i in np.argwhere(wrong)[0]) if wrong.any() else None


def repeated(values: Iterable[Any]) -> list[Any]:
    """Those of `values` that were there before, in their order."""
    seen, again = set(), []
    for value in values:
        key = value if type(value).__hash__ else repr(value)
        if key in seen:
            again.append(value)
        seen.add(key)
    return again


def is_whole(value: Any, least: int = 1) -> bool:
    """Whether `value` is a whole number, `least` to 2**31 - 1; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) < 2**31


def whole(name: str, what: str, value: Any, least: int = 1) -> int:
    """`value` as an int. Raises InputError unless it `is_whole`."""
    if not is_whole(value, least):
        raise InputError(f"{name}: {what} must be a whole number of at least {least}, not {shown(value)}")
    return int(value)


def check_switches(name: str, obj: Any) -> None:
    """Raises InputError unless the static fields of `obj` that are declared bool are True or False."""
    for field in dataclasses.fields(obj):
        if field.type is not bool or not field.metadata.get("static"):
            continue
        if not isinstance(value := getattr(obj, field.name), bool | np.bool_):
            raise InputError(f"{name}: {field.name} must be True or False, not {shown(value)}")
        object.__setattr__(obj, field.name, bool(value))


def check_pytree(what: str, obj: Any, registry: Mapping[str, type] | None = None) -> None:
    """Raises InputError unless `obj` is an instance of a class that JAX can take apart.

    Where it is a string, the message names the class that has this name in `registry`, or else the first.
    """
    if isinstance(obj, str) and registry:
        cls = registry.get(obj, next(iter(registry.values())))
        raise InputError(f"{what} must be an instance, such as {cls.__name__}(), not {shown(obj)}")
    if isinstance(obj, type):
        raise InputError(f"{what} must be an instance, such as {obj.__name__}(), not the class")
    if hint := foreign(obj):
        raise InputError(f"{what} must be an environment of jaxrl_tab, not {shown(obj)}{hint}")
    if jax.tree_util.all_leaves([obj]):
        raise InputError(f"{what} is no JAX pytree: decorate its class with jaxrl_tab.core.types.pytree")


def foreign(obj: Any) -> str:
    """What a message adds about `obj` where it is an environment of Gymnasium or gymnax."""
    library = "gymnasium" if hasattr(obj, "unwrapped") else "gymnax" if hasattr(obj, "step_env") else None
    return f"; rl.interop.from_{library} imports it" if library else ""


def check_held(obj: Any) -> None:
    """Raises InputError where a number of `obj` would be infinite in JAX's floats, which are float32 as a rule."""
    dtype = jax.dtypes.canonicalize_dtype(float)
    for path, leaf in jax.tree_util.tree_leaves_with_path(obj):
        if not jnp.issubdtype(jax.typeof(leaf).dtype, jnp.floating) or (number := concrete(leaf)) is None:
            continue
        with np.errstate(over="ignore"):
            lost = np.isfinite(number) & ~np.isfinite(number.astype(dtype))
        if lost.any():
            field = jax.tree_util.keystr(path, simple=True, separator=".")
            raise InputError(
                f"{type(obj).__name__}: {field} holds {number[lost][0]:g}, and {dtype} has numbers up to "
                f"{np.finfo(dtype).max:.2g} in size"
            )


# --- frozen dataclasses that are pytrees -------------------------------------------------------------


def static(default: Any = dataclasses.MISSING, **kwargs: Any) -> Any:
    """A field of a `pytree` class that shapes the program (a size, a rule) and so is not a leaf."""
    return dataclasses.field(default=default, metadata={"static": True}, **kwargs)


@dataclass_transform(frozen_default=True, field_specifiers=(static, dataclasses.field))
def pytree(cls: type[T]) -> type[T]:
    """Makes `cls` a frozen dataclass and a JAX pytree: its fields are leaves, but for the `static` ones.

    JAX rebuilds an instance without calling `__init__`, so `__post_init__` sees only what a person wrote
    and may check values there (`concrete` tells a number from a tracer).
    """
    cls = dataclasses.dataclass(frozen=True, eq=False)(cls)
    fields = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    leaves = [f.name for f in fields if not f.metadata.get("static")]
    statics = [f.name for f in fields if f.metadata.get("static")]

    def flatten(obj):
        children = [(jax.tree_util.GetAttrKey(n), getattr(obj, n)) for n in leaves]
        return children, tuple(getattr(obj, n) for n in statics)

    def unflatten(aux, children):
        obj = object.__new__(cls)
        for name, value in (*zip(statics, aux, strict=True), *zip(leaves, children, strict=True)):
            object.__setattr__(obj, name, value)
        return obj

    jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
    return cls


def concrete(x: Any) -> np.ndarray | None:
    """The value of `x` as a NumPy array, or None where it is a tracer and has no value yet."""
    return None if isinstance(x, Tracer) else np.asarray(x)


def as_array(x: Any) -> np.ndarray | None:
    """`concrete(x)`; what cannot become an array, such as rows of unlike lengths, is an empty one of objects."""
    try:
        return concrete(x)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0, object)


# --- what environments and methods exchange ----------------------------------------------------------


class Outcome(NamedTuple):
    """What an environment answers to an action.

    Attributes:
        s_next: the state S' that was entered, int32 []; terminal states are states too.
        reward: R, float [].
        terminal: whether S' is terminal, bool []. A time limit is not the environment's business here.
    """

    s_next: Int[Array, "*k"]
    reward: Float[Array, "*k"]
    terminal: Bool[Array, "*k"]


class Transition(NamedTuple):
    """What a method learns from: (S, A, R, S', gamma').

    Attributes:
        s: S, int32 [].
        a: A, int32 [].
        r: R, float [].
        s_next: S', int32 []: the state before any reset.
        discount: gamma', float []: gamma, and 0 only where S' is terminal. At a time limit it stays gamma,
            so a method that multiplies its bootstrap with it does the right thing in both cases.
        last: whether the episode ends here, by S' or by the time limit, bool [].
    """

    s: Int[Array, ""]
    a: Int[Array, ""]
    r: Float[Array, ""]
    s_next: Int[Array, ""]
    discount: Float[Array, ""]
    last: Bool[Array, ""]


class Task(NamedTuple):
    """How large a task is: what a method must know of it before it learns.

    Attributes:
        num_states: the number of states, terminal ones included.
        num_actions: the number of actions.
        max_steps: the longest that an episode may get, in steps.
    """

    num_states: int
    num_actions: int
    max_steps: int


@runtime_checkable
class Environment(Protocol):
    """A task: a frozen pytree whose numbers are leaves and whose sizes are static.

    It may have a method `instance(key) -> Environment`, which draws the problem of one run; `train` calls it
    once. `mean_optimal_value(gamma) -> float` may then say the mean over problems of v* from the start.

    Where a state does not have every action, a method `available(s) -> bool [A]` says which there are in `s`,
    at least one, in terminal states too. Nobody then takes another one, and no maximum and no mean counts it:
    see `restricted`.

    Attributes:
        num_states: the number of states, terminal ones included.
        num_actions: the number of actions, the same in every state.
        max_steps: the time limit of an episode, in steps; reaching it truncates and does not terminate.
    """

    @property
    def num_states(self) -> int: ...
    @property
    def num_actions(self) -> int: ...
    @property
    def max_steps(self) -> int: ...

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        """Draws a start state, int32 []."""
        ...

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        """Draws what follows action `a` in state `s`."""
        ...


@runtime_checkable
class FiniteEnvironment(Environment, Protocol):
    """An environment that states its dynamics, so that exact values exist."""

    def initial(self) -> Float[Array, " S"]:
        """The exact distribution of the start state, float [S]."""
        ...

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """The K possible outcomes of `a` in `s`: their probabilities, float [K], and an Outcome of [K] each.

        A terminal state leads to itself with reward 0.
        """
        ...


class Algorithm(Protocol[L]):
    """A control method: a frozen pytree. The instance *is* its hyperparameters, so `vmap` batches them.

    Attributes:
        gamma: the discount rate, in [0, 1].

    A method whose `update` draws A' as its last act, as `policy(key, new state, S')`, and learns nothing from
    it, may say so by `acts_after_update = True` in the class that defines `update`. The driver then draws A'
    itself, together with the first actions of episodes, which makes a step a quarter faster and changes no
    decision.

    In the same place `learns_from` says what experience of somebody else `update` learns rightly from (see
    `offline`): "transitions", any of them in any order; "transitions of b", where the method is told the
    policy b that acted, as a table in its field `behaviour`; or "episodes of b", in order. A method that does
    not say can learn only from what it did itself.

    A method that multiplies returns by ratios of importance sampling says `multiplies_returns = True`: what
    it learns may be greater than any return, and is no sign that it diverges.

    Where the environment says which actions are `available`, the method is asked for one like itself that takes
    and counts no others: `restricted_to(available) -> Algorithm`, available bool [S, A].
    """

    @property
    def gamma(self) -> Any: ...

    def init(self, num_states: int, num_actions: int) -> L:
        """The state of the learner before the first step. It has a field `q`, float [S, A].

        A method that remembers whole episodes takes a third argument, `max_steps`: how long they may get.
        """
        ...

    def policy(self, key: Key[Array, ""], state: L, s: Int[Array, ""]) -> Int[Array, ""]:
        """Draws an action for `s` from the behaviour policy, int32 []."""
        ...

    def update(self, key: Key[Array, ""], state: L, t: Transition) -> tuple[L, Int[Array, ""]]:
        """Learns from `t`, and gives A', the action to take in `t.s_next`, int32 [].

        Where the episode ends (`t.last`) A' is not taken: the driver resets and asks `policy`.
        """
        ...


def init_learner(algorithm: Algorithm[L], task: Environment | Task) -> L:
    """The state of the learner before its first step in the task."""
    takes = inspect.signature(algorithm.init).parameters
    longest = {"max_steps": task.max_steps} if "max_steps" in takes else {}
    return algorithm.init(task.num_states, task.num_actions, **longest)


def available_actions(env: Any) -> Bool[Array, "S A"] | None:
    """Which actions there are in each state, or None where the environment does not say: then it is all.

    Raises:
        InputError: what `available` gives has the wrong shape, or a state has no action.
    """
    if getattr(env, "available", None) is None:
        return None
    there = jax.vmap(env.available)(jnp.arange(env.num_states, dtype=jnp.int32)).astype(bool)
    check_available(f"{type(env).__name__}: available", there, env.num_states, env.num_actions)
    return there


def stand_ins(available: Bool[Array, "S A"]) -> Int[Array, "S A"]:
    """What is done where an action is asked for: itself where it is available, else the first that is, [S, A]."""
    actions = jnp.arange(available.shape[1], dtype=jnp.int32)
    return jnp.where(
        available, actions, jnp.where(available, actions, len(actions) - 1).min(1, keepdims=True)
    )


def check_available(what: str, available: Any, num_states: int, num_actions: int) -> None:
    """Raises InputError unless these are booleans [S, A], with an action in every state."""
    there = concrete(available)
    if (shape := np.shape(available)) != (num_states, num_actions):
        raise InputError(f"{what} must be booleans [S, A] = [{num_states}, {num_actions}], not {list(shape)}")
    if there is None:
        return
    if not np.isin(there, (0, 1)).all():
        raise InputError(f"{what} must be True or False in each place, not {shown(there)}")
    if (s := first(np.asarray(~there.any(1)))) is not None:
        raise InputError(f"{what} must name an action in every state, in terminal ones too; {s[0]} has none")


def restricted(chooser: T, available: Bool[Array, "S A"] | None) -> T:
    """A method or a policy that takes these actions only; as it is where `available` is None: there are all.

    Raises:
        InputError: it cannot be told, for it has no method `restricted_to`; or it takes another action.
    """
    if available is None:
        return chooser
    if not hasattr(chooser, "restricted_to"):
        raise InputError(
            f"{type(chooser).__name__} cannot be told that some states do not have every action: give it a "
            "method restricted_to(available), available bool [S, A], that returns what takes no other"
        )
    return chooser.restricted_to(available)  # pyright: ignore[reportAttributeAccessIssue]


def said_of_update(algorithm: Any, name: str) -> Any:
    """What the class that defines the `update` of `algorithm` says of it by its attribute `name`, or None.

    A subclass with another `update` must say so again.
    """
    owner = next(cls for cls in type(algorithm).__mro__ if "update" in vars(cls))
    return vars(owner).get(name)
