"""Policies: the exact probabilities of the actions, and one way to draw from them.

A policy turns a row of action values Q(s, .) into probabilities, float [A]. What is drawn, what Expected
Sarsa averages over, what importance sampling divides by and what `planning` evaluates are therefore the same
numbers. Ties for the maximum share its probability equally, everywhere. (In float32, the precision of JAX
unless told otherwise, values of a deterministic task become exact ties after fewer visits than in float64, so
ties are broken more often and single entries of Q may differ: in the windy gridworld, by Q-learning with
alpha = 0.5, Q(15, 2) is -10.781 on average and would be -10.751. Returns and lengths of episodes do not.)

Where a state does not have every action (`types.Environment`), none of these takes another one.

Every method takes one as its `behaviour`, and methods that learn about another policy take one as their
`target`: `Greedy`, `EpsilonGreedy`, `Softmax`, `UCB`, or any `Table` of probabilities. All but tables are
written as they are typed on the command line (`str`, `parse`): "softmax:0.5".
"""

import dataclasses
import zlib
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from functools import reduce
from itertools import accumulate
from typing import Any, Protocol, Self, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core import schedules, tables
from jaxrl_tab.core.checks import KINDS, Kind, as_array, build, concrete, first, is_distribution
from jaxrl_tab.core.clock import Clock, Rate, exploration, goes_by_visit, of_state
from jaxrl_tab.core.errors import InputError, nearest, shown, unfit
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.core.types import Available, State, check_available

# The value of an action that a state does not have: never the maximum, and of weight 0 in a softmax. It is
# finite because 0 times it must be 0. Nothing is learned about such an action, so the value never changes.
UNAVAILABLE = -1e30

UNROLLED = 16  # rows up to this length are worked through entry by entry

# Where set, `sample` and `coin` ask it for the index, given the weights, and do not look at the key: so
# everything that is random in a method can be enumerated (see `bridge`).
choose: ContextVar[Callable[[Array], Array] | None] = ContextVar("choose", default=None)


def largest(q: Float[Array, " A"]) -> Float[Array, ""]:
    """max_a q(a), [A] -> []."""
    # A comparison, because the maximum of XLA asks for NaN first, which takes four instructions more.
    larger = lambda x, y: jnp.where(x > y, x, y)
    return reduce(larger, list(q)) if len(q) <= UNROLLED else q.max()


def greedy(q: Float[Array, " A"]) -> Float[Array, " A"]:
    """The greedy policy: all maximal actions equally likely, [A] -> [A]."""
    best = (q == largest(q)).astype(q.dtype)
    return best / _reduce(jnp.add, best)


def epsilon_greedy(q: Float[Array, " A"], epsilon: Float[Array, ""] | float) -> Float[Array, " A"]:
    """epsilon / A for every action and the rest for the greedy ones, [A] -> [A] (book, section 5.4)."""
    return epsilon / q.shape[0] + (1 - epsilon) * greedy(q)


def softmax(q: Float[Array, " A"], temperature: Float[Array, ""] | float) -> Float[Array, " A"]:
    """Probabilities proportional to exp(q / temperature), [A] -> [A] (book, equation 2.11)."""
    weights = jnp.exp((q - largest(q)) / temperature)
    return weights / _reduce(jnp.add, weights)


def among(q: Any, available: Any) -> Float[Array, "S A"]:
    """Action values, one for all or [S, A], with UNAVAILABLE in place of those that are not `available` [S, A].

    `available` may be numbers, as the leaves of a method in a sweep are.
    """
    return jnp.where(jnp.asarray(available, float) > 0, jnp.asarray(q, float), UNAVAILABLE)


def sample(key: Key[Array, ""], weights: Float[Array, " n"]) -> Int[Array, ""]:
    """Draws an index with probability proportional to `weights` [n] >= 0, int32 [].

    By inversion, from one random word of which 24 bits count. The word is scaled to the sum of the weights,
    so an index of weight zero is never drawn, however the sum was rounded.
    """
    if (chosen := choose.get()) is not None:
        return chosen(weights)
    u = (jax.random.bits(key, dtype=jnp.uint32) >> 8).astype(weights.dtype) * 2**-24
    if len(weights) > UNROLLED:
        edges = jnp.cumsum(weights)
        return (u * edges[-1] >= edges[:-1]).sum(dtype=jnp.int32)
    *edges, total = accumulate(list(weights))
    return reduce(jnp.add, ((u * total >= edge).astype(jnp.int32) for edge in edges), jnp.int32(0))


def below(key: Key[Array, ""], count: Int[Array, ""] | int) -> Int[Array, ""]:
    """Draws one of the whole numbers from 0 to below `count`, all equally likely, int32 []; as `sample`, by 24 bits."""
    u = (jax.random.bits(key, dtype=jnp.uint32) >> 8).astype(jnp.result_type(float)) * 2**-24
    # Never `count` itself, however the product is rounded.
    return (u * jnp.asarray(count, u.dtype)).astype(jnp.int32)


def coin(key: Key[Array, ""]) -> Bool[Array, ""]:
    """A fair coin, bool [], from the lowest bit of the key's word.

    `sample` never looks at that bit, so what both give for one key is independent: a word for two decisions.
    """
    if (chosen := choose.get()) is not None:
        return chosen(jnp.ones(2)) == 1
    return (jax.random.bits(key, dtype=jnp.uint32) & 1) == 1


def _reduce(op: Any, x: Array) -> Array:
    """`op` over all entries of x [A], written out entry by entry where A is small.

    Under `vmap` a row is one of many, and a reduction along so short an axis cannot be vectorised. Entry by
    entry, each operation runs over all lanes at once.
    """
    return reduce(op, list(x)) if len(x) <= UNROLLED else op.reduce(x)


# --- policies as objects -----------------------------------------------------------------------------
@runtime_checkable
class Policy(Protocol):
    """A rule of choosing actions: a pytree whose numbers are leaves, so that `vmap` batches them.

    Where states do not have every action, Q(s, a) of the others is UNAVAILABLE, and the policy is asked for one
    like itself that does not take them: `restricted_to(available) -> Policy`, available bool [S, A].
    """

    @property
    def by_visit(self) -> bool:
        """Whether it needs N(s, a), the table of visits in the clock."""
        ...

    def check(self, num_states: int, num_actions: int) -> None:
        """Raises InputError where it does not fit a task of so many states and actions."""
        ...

    def probs(self, q: Float[Array, " A"], clock: Clock, s: State) -> Float[Array, " A"]:
        """pi(. | s), float [A], where `q` is Q(s, .)."""
        ...


def _check_policy(who: str | None, field: dataclasses.Field, value: Any) -> Any:
    """`value` where it is a policy, or None; text as `parse` reads it."""
    if isinstance(value, str):
        try:
            return parse(value)
        except InputError as error:
            raise error.renamed(who, field.name) from None
    if value is not None and (isinstance(value, type) or not isinstance(value, Policy)):
        table = isinstance(value, Sequence | np.ndarray | jax.Array)
        hint = "; for probabilities [S, A] it is policies.Table(...)" if table else ""
        raise unfit(who, field.name, "a policy such as policies.Softmax(0.5)", value, hint)
    return value


KINDS[Policy | None] = Kind(_check_policy)


def _check_table(who: str, field: str, table: Any, num_states: int, num_actions: int) -> None:
    if (shape := np.shape(table)) != (num_states, num_actions):
        problem = (
            f"{field} are of shape {shape}, and the task has {num_states} states and {num_actions} actions"
        )
        raise InputError(problem, who=who, field=field)


def check_among(what: str, probabilities: Any, available: Any) -> None:
    """Raises InputError where probabilities [..., S, A] are not 0 of an action that is not `available` [S, A].

    Traced ones are let through.
    """
    pi, is_available = concrete(probabilities), concrete(available)
    if pi is not None and is_available is not None and (at := first((pi > 0) & ~is_available)):
        *_, s, a = at
        raise InputError(
            f"{what}: state {s} does not have action {a}, so its probability must be 0, not {pi[at]}"
        )


class _Anywhere:
    """What policies share that fit every task and, unless they say so, count nothing.

    Their `str` is what one types for them. Where they do not define `restricted_to`, the value UNAVAILABLE
    alone keeps them from an action.
    """

    @property
    def by_visit(self) -> bool:
        return False

    def check(self, num_states: int, num_actions: int) -> None:
        pass

    def restricted_to(self, available: Available) -> Self:
        return self

    def __str__(self) -> str:
        name = next((name for name, cls in POLICIES.items() if cls is type(self)), None)
        if name is None:
            return repr(self)
        if (field := _number_of(name)) is None:
            return name
        number = schedules.typed(getattr(self, field.name))
        return repr(self) if number is None else f"{name}:{number}"


@pytree
class Greedy(_Anywhere):
    """A maximal action; ties split equally."""

    def probs(self, q: Float[Array, " A"], clock: Clock, s: State) -> Float[Array, " A"]:
        return greedy(q)


@pytree
class EpsilonGreedy(_Anywhere):
    """With probability epsilon any action, else a maximal one (book, section 2.2)."""

    epsilon: Rate = field(default=0.1, at_least=0, at_most=1, help="Probability of exploring.")
    available: Any = field(
        default=None,
        help="The actions to choose from in each state, bool [S, A]; None for all that there are. The values of "
        "the others are UNAVAILABLE, so that no target takes them for the best either. (What an environment "
        "says about its actions need not be said again.)",
    )

    def __post_init__(self):
        if self.available is None or (is_available := as_array(self.available)) is None:
            return
        if is_available.ndim != 2:
            problem = f"available must be booleans [S, A], not of shape {is_available.shape}"
            raise InputError(problem, who="EpsilonGreedy", field="available")
        check_available("EpsilonGreedy: available", is_available, *is_available.shape)
        object.__setattr__(self, "available", is_available)  # rows of a list would be leaves by themselves

    @property
    def by_visit(self) -> bool:
        return goes_by_visit(self.epsilon)

    def __str__(self) -> str:
        suffix = "" if self.available is None else f", available {_brief(self.available)}"
        return super().__str__() + suffix

    def check(self, num_states: int, num_actions: int) -> None:
        if self.available is not None:
            _check_table("EpsilonGreedy", "available", self.available, num_states, num_actions)

    def restricted_to(self, available: Available) -> Self:
        if self.available is not None:
            _check_table("EpsilonGreedy", "available", self.available, *np.shape(available))
            available = (jnp.asarray(self.available) > 0) & available
        return dataclasses.replace(self, available=available)

    def probs(self, q: Float[Array, " A"], clock: Clock, s: State) -> Float[Array, " A"]:
        epsilon = exploration(self.epsilon, clock, s)
        if self.available is None:
            return epsilon_greedy(q, epsilon)
        # As floats, because a sweep makes floats of all hyperparameters, of booleans too.
        is_available = tables.row(jnp.asarray(self.available, float), s)
        best = greedy(jnp.where(is_available > 0, q, -jnp.inf))
        return epsilon * is_available / _reduce(jnp.add, is_available) + (1 - epsilon) * best


@pytree
class Softmax(_Anywhere):
    """Probabilities proportional to exp(Q(s, a) / temperature) (book, section 13.1)."""

    temperature: Rate = field(default=1.0, greater_than=0, help="Near 0 it is greedy, large it is random.")

    @property
    def by_visit(self) -> bool:
        return goes_by_visit(self.temperature)

    def probs(self, q: Float[Array, " A"], clock: Clock, s: State) -> Float[Array, " A"]:
        return softmax(q, of_state(self.temperature, clock, s))


@pytree
class UCB(_Anywhere):
    """The largest upper confidence bound, Q(s, a) + c sqrt(ln t / N(s, a)) (book, equation 2.10).

    t = N(s) + 1 counts the choices made in s, this one included. An action that was never taken comes first.
    """

    c: float = field(default=2.0, at_least=0, help="Width of the bound, in units of the action values.")

    @property
    def by_visit(self) -> bool:
        return True

    def probs(self, q: Float[Array, " A"], clock: Clock, s: State) -> Float[Array, " A"]:
        assert clock.visits is not None
        visits = tables.row(clock.visits, s)
        n = _reduce(jnp.add, visits).astype(q.dtype)
        bonus = jnp.sqrt(jnp.log(n + 1) / jnp.maximum(visits, 1).astype(q.dtype))
        new = (visits == 0) & (q > UNAVAILABLE)
        return greedy(jnp.where(new, jnp.inf, q + self.c * bonus))


@pytree
class Table:
    """A policy that is given as a table, whatever Q is."""

    probabilities: Any = field(
        help="pi(a | s), float [S, A]; every row sums to 1, those of terminal states too."
    )

    def __post_init__(self):
        if (pi := as_array(self.probabilities)) is None:
            return
        if pi.ndim != 2 or pi.dtype.kind not in "biuf":
            wanted = "numbers [S, A], in rows of equal length"
            raise unfit("Table", "probabilities", wanted, self.probabilities)
        if (s := first(~is_distribution(pi))) is not None:
            problem = f"the probabilities in state {s[0]} are not a distribution: {shown(pi[s])}"
            raise InputError(problem, who="Table", field="probabilities")
        object.__setattr__(self, "probabilities", pi)  # rows of a list would be leaves by themselves

    @property
    def by_visit(self) -> bool:
        return False

    def __str__(self) -> str:
        return f"table {_brief(self.probabilities)}"

    def check(self, num_states: int, num_actions: int) -> None:
        _check_table("Table", "probabilities", self.probabilities, num_states, num_actions)

    def restricted_to(self, available: Available) -> Self:
        self.check(*np.shape(available))
        check_among("Table: probabilities", self.probabilities, available)
        return self

    def probs(self, q: Float[Array, " _"], clock: Clock, s: State) -> Float[Array, " A"]:
        return tables.row(jnp.asarray(self.probabilities, float), s)  # where v is learned, `q` is v(s) alone


def as_table(name: str, policy: Any, shape: tuple[int, ...] | None = None) -> Table:
    """A Table, or the probabilities [S, A] of one, as a Table; of this shape, where one is given.

    Raises:
        InputError: it is none; the message calls it `name`.
    """
    try:
        table = policy if isinstance(policy, Table) else Table(policy)
        if shape is not None:
            table.check(*shape)
    except InputError as error:
        raise error.renamed(name) from None
    return table


def uniform(available: Available) -> Table:
    """The policy that takes all actions of a state that are available with equal probability."""
    is_available = jnp.asarray(available, float)
    return Table(is_available / is_available.sum(1, keepdims=True))


POLICIES: dict[str, type] = {
    "greedy": Greedy,
    "epsilon-greedy": EpsilonGreedy,
    "softmax": Softmax,
    "ucb": UCB,
}


def parse(text: str) -> Policy:
    """A policy from what is typed: its name, and its number or schedule where it has one.

    So "greedy", "ucb:2", "softmax:0.5", "epsilon-greedy:harmonic:100:visit". The number may be left off.

    Raises:
        InputError: `text` is none of these; the message says what would be right.
    """
    if not isinstance(text, str):
        raise InputError(f"a policy is written as a text, such as 'softmax:0.5', not {shown(text)}")
    name, colon, number = text.replace("_", "-").partition(":")
    if name not in POLICIES:
        raise InputError(f"there is no policy {shown(text)}; {nearest(name, POLICIES)}")
    if not colon:
        return POLICIES[name]()
    field = _number_of(name)
    if field is None:
        raise InputError(f"{shown(text)} is not of the form {form(name)}")
    takes_schedule = field.type == Rate
    try:
        if takes_schedule and schedules.is_named(number) and not number.startswith(":"):
            value = schedules.parse(number)
        else:
            value = float(number)
    except InputError as error:
        raise error.renamed(name, field.name) from None
    except ValueError:
        what = "a number or a schedule" if takes_schedule else "a number"
        raise InputError(
            f"{shown(text)} is not of the form {form(name)}, where {field.name.upper()} is {what}"
        ) from None
    return build(POLICIES[name], name, {field.name: value})


def form(name: str) -> str:
    """How the policy `name` is typed: "softmax[:TEMPERATURE]"."""
    field = _number_of(name)
    return f"{name}[:{field.name.upper()}]" if field else name


def _brief(table: Any) -> str:
    """The size and a checksum of a table, so that tables that differ look different."""
    numbers = concrete(table)
    if numbers is None:
        return "traced"
    size = "x".join(map(str, numbers.shape))
    return f"{size}:{zlib.crc32(numbers.astype(np.float64).tobytes()):08x}"


def _number_of(name: str) -> dataclasses.Field | None:
    """The field that is typed with the policy `name`: the first, if it has any."""
    return next(iter(dataclasses.fields(POLICIES[name])), None)
