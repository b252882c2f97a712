"""The bridge to dynamic programming: what a one-step method samples is what dynamic programming sums.

Each method of the table below moves an entry towards a target that it draws: a **sample backup**. The mean of
that target, over the outcomes of the environment and over whatever the method draws itself, is a **full
backup** of dynamic programming (Silver, lecture 5, "Relationship between DP and TD"; book, section 8.5).

    print(bridge.table())
    q_next = bridge.expected_backup(rl.QLearning(gamma=0.9), env, q)     # = planning.optimality_backup(...)
    bridge.full_backup(rl.QLearning(gamma=0.9), env, q)                  # the same, by dynamic programming
"""

import dataclasses
import itertools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxrl_tab.algorithms import CONTROL
from jaxrl_tab.algorithms.every_draw import no_words, over_draws
from jaxrl_tab.algorithms.prediction import OF_STATES, Prediction, ValueState
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.core import policies
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import InputError, shown
from jaxrl_tab.core.types import Environment, Transition, available_actions, init_learner, restricted
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.model import Model


class Row(NamedTuple):
    """A row of the lecture's table: a Bellman equation and the two ways to turn it into an update.

    Attributes:
        equation: the Bellman equation.
        full, full_update, full_diagram: the method of dynamic programming, its update, and what that looks ahead to.
        backup: the function of `planning` that is one sweep of it.
        sample, sample_update: the method of temporal differences, and its update.
        methods: the names of all registered methods that sample it, in CONTROL and OF_STATES; those with
            a target policy of their own sample it for that policy, the others for the policy that acts.
    """

    equation: str
    full: str
    full_update: str
    full_diagram: Backup
    backup: Callable[..., np.ndarray]
    sample: str
    sample_update: str
    methods: tuple[str, ...]

    @property
    def classes(self) -> tuple[type, ...]:
        """The classes of its methods, whose values are tables."""
        return tuple((CONTROL | OF_STATES)[name] for name in self.methods)

    @property
    def sample_diagram(self) -> Backup:
        """What the update of the method of temporal differences looks ahead to, as that declares it."""
        diagram = of_method(self.classes[0]).backup
        assert diagram
        return diagram._replace(words="")


TABLE = (
    Row(
        "Bellman expectation equation for v_pi",
        "iterative policy evaluation",
        "v(s) <- E[R + gamma v(S') | s]",
        Backup("state, each action, each state"),
        planning.evaluation_backup,
        "TD(0)",
        "V(S) <-alpha- R + gamma V(S')",
        ("td", "off-policy-td"),
    ),
    Row(
        "Bellman expectation equation for q_pi",
        "q-policy iteration",
        "q(s, a) <- E[R + gamma q(S', A') | s, a]",
        Backup("action, each state, each action"),
        planning.expectation_backup,
        "Sarsa",
        "Q(S, A) <-alpha- R + gamma Q(S', A')",
        ("sarsa", "expected-sarsa", "double-sarsa", "double-expected-sarsa", "q-learning-target"),
    ),
    Row(
        "Bellman optimality equation for q*",
        "q-value iteration",
        "q(s, a) <- E[R + gamma max_a' q(S', a') | s, a]",
        Backup("action, each state, max action"),
        planning.optimality_backup,
        "Q-learning",
        "Q(S, A) <-alpha- R + gamma max_a' Q(S', a')",
        ("q-learning", "double-q-learning", "weighted-double-q-learning"),
    ),
)
WIDEST = max((row.full_update for row in TABLE), key=len)
NOTE = "x <-alpha- y stands for x <- x + alpha (y - x)"


def table() -> str:
    """The lecture's table, to print: each Bellman equation, and below it both of its backups with their diagrams."""
    lines = [line for row in TABLE for line in [row.equation, "", *beside(row), "", ""]]
    return "\n".join([*lines, NOTE])


def beside(row: Row, method: str = "", diagram: Backup | None = None) -> list[str]:
    """Both backups of a row side by side, in lines; or of another method that samples it, with the diagram it has."""
    update = row.sample_update if method in ("", row.methods[0]) else ""
    drawn = diagram if method else row.sample_diagram
    full = [f"full backup (DP): {row.full}", row.full_update, "", *row.full_diagram.diagram()]
    sample = [f"sample backup (TD): {method or row.sample}", update, "", *(drawn.diagram() if drawn else [])]
    width = max(len(line) for line in [WIDEST, *full])
    return [f"  {x:{width}}    {y}".rstrip() for x, y in itertools.zip_longest(full, sample, fillvalue="")]


def row_of(method: TDControl | Prediction) -> Row:
    """The row of the table of a one-step method, or of a class of somebody's own that is made from one.

    Raises:
        InputError: it is on none of them.
    """
    for row in TABLE:
        if isinstance(method, row.classes) and of_method(method).features is None:
            return row
    names = ", ".join(name for row in TABLE for name in row.methods)
    raise InputError(f"{type(method).__name__} is on no row of the table, whose methods are {names}")


def full_backup(
    method: TDControl | Prediction, env: Environment, values: Float[np.ndarray, "S *A"]
) -> Float[np.ndarray, "S *A"]:
    """The full backup that `method` samples: one sweep of its row of the table, float64, [S, A] of Q or [S] of V.

    That is for the policy that the method learns about: its target, or else the one that acts, as it is in the first
    step. `planning` sums over the outcomes of `env`, and runs no update. Args: as `expected_backup`.

    Raises:
        InputError: as `expected_backup`; or the method is on no row.
    """
    row = row_of(method)
    if row.backup is planning.optimality_backup:
        return planning.optimality_backup(env, values, method.gamma)
    available = available_actions(env)
    if isinstance(method, Prediction):
        probs = restricted(method, available).probabilities(env)
        return planning.evaluation_backup(env, values, probs, method.gamma)
    values = planning.checked_values(planning.exact_model(env), "q", values)
    with jax.enable_x64():
        learner: Any = restricted(dataclasses.replace(method, q0=values), available)
        state, states = init_learner(learner, env), jnp.arange(env.num_states, dtype=jnp.int32)
        target = getattr(learner, "target_probs", learner.probs)
        probs = np.asarray(jax.vmap(lambda s: target(state, s))(states))
    return planning.expectation_backup(env, values, probs, method.gamma)


def expected_backup(
    method: TDControl | Prediction, env: Environment, values: Float[np.ndarray, "S *A"]
) -> Float[np.ndarray, "S *A"]:
    """The mean of the target that `method` draws, float64, exact to rounding: [S, A] of Q, or [S] of V.

    The `update` of the method itself is run, once for every outcome of the environment together with every
    outcome of every draw that the method makes by `policies.sample` and `policies.coin`; each is weighted
    with its probability. Nothing is drawn.

    Args:
        method: a one-step method. Its schedules stand where they stand in the first step; alpha is not used.
        env: an environment with `outcomes`.
        values: what the learner believes: Q [S, A], in all tables that it has; for a method of prediction V
            [S]. It gives the mean for each pair (s, a), UNAVAILABLE where s does not have a; in prediction for
            each s, over the actions of the policy that acts.

    Raises:
        InputError: `values` has the wrong shape; `env` can only be sampled; the method remembers more from
            step to step than tables, so that it learns from more than one transition; its values are a function of
            features; or it draws in another way.
    """
    if not isinstance(method, TDControl | Prediction):
        raise InputError(
            f"method must be an instance of a one-step method such as Sarsa(), not {shown(method)}"
        )
    if of_method(method).features is not None:
        raise InputError(
            "its values are a function of features, and this is for tables", who=type(method).__name__
        )
    model = planning.exact_model(env)
    learns = of_method(method).learns
    of_states = learns is Learns.STATES
    values = planning.checked_values(model, "v" if of_states else "q", values)
    belief = {learns.initial: values[:, None] if of_states else values}
    with jax.enable_x64():
        available = available_actions(env)
        at_once: Any = restricted(dataclasses.replace(method, alpha=1.0, **belief), available)
        start = jax.eval_shape(lambda: init_learner(at_once, env))
        _check_one_step(type(method).__name__, start, np.shape(*belief.values()))
        means = values + np.asarray(_expected_moves(at_once, model, of_states))
        return means if available is None or of_states else np.asarray(policies.among(means, available))


@partial(jax.jit, static_argnames="of_states")
def _expected_moves(method: Any, model: Model, of_states: bool) -> Float[Array, "S *A"]:
    """How far an update with alpha = 1 moves each entry, on average."""
    num_states, num_actions, _ = model.prob.shape
    start = method.init(num_states, num_actions)
    key = no_words()

    def move(s, a):
        k = policies.sample(key, model.prob[s, a])
        s_next, r, terminal = model.s_next[s, a, k], model.reward[s, a, k], model.terminal[s, a, k]
        t = Transition(s, a, r, s_next, jnp.where(terminal, 0, method.gamma), terminal)
        after, _ = method.update(key, start, t)
        entry = s, 0 if of_states else a
        # Of several tables the one that learned is moved to its target; the others are as they were.
        moves = [x[entry] - y[entry] for x, y in zip(_tables(after), _tables(start), strict=True)]
        return jnp.stack(moves).sum()

    def mean(s):
        if of_states:
            return _mean_over_draws(lambda: move(s, method.policy(key, start, s)))
        actions = jnp.arange(num_actions, dtype=jnp.int32)
        return jax.vmap(lambda a: _mean_over_draws(lambda: move(s, a)))(actions)

    # State by state, for all updates that run at the same time have tables of their own.
    return lax.map(mean, jnp.arange(num_states, dtype=jnp.int32))


def _memory(state: Any) -> dict[str, Any]:
    """What a learner keeps from step to step, apart from its clock."""
    kept = state.learner if isinstance(state, ValueState) else state
    return {field: x for field, x in kept._asdict().items() if field != "clock"}


def _tables(state: Any) -> list[Float[Array, "S A"]]:
    return list(_memory(state).values())


def _check_one_step(name: str, state: Any, shape: tuple[int, ...]) -> None:
    for field, x in _memory(state).items():
        if getattr(x, "shape", None) != shape:
            raise InputError(
                f"{name} remembers {field} from step to step, so it learns from more than one transition; "
                "a one-step method keeps nothing but tables"
            )


def _mean_over_draws(draw: Callable[[], Float[Array, ""]]) -> Float[Array, ""]:
    """The mean of `draw()`, over all that may be drawn in it."""
    chance, x = over_draws(draw)
    return jnp.where(chance > 0, chance * x, 0).sum()  # what cannot happen may be no number
