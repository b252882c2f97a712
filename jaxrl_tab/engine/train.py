"""The loop of one run: an agent, an environment, and a log of sums.

`train` is a pure function of a key: `jit` and `vmap` work on it, and `sweep` is nothing but that. The random
words of a step (`rng`) depend on its number alone, so the learner's path does not depend on `log_every`.
"""

from collections.abc import Callable
from dataclasses import is_dataclass
from functools import partial
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxrl_tab.algorithms.prediction import METHODS
from jaxrl_tab.core import policies, rng, schedules, tables
from jaxrl_tab.core.checks import InputError, check_held, check_pytree, concrete
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.types import (
    Algorithm,
    Environment,
    Transition,
    available_actions,
    init_learner,
    restricted,
)
from jaxrl_tab.engine.budget import Budget, Record
from jaxrl_tab.envs import ENVS
from jaxrl_tab.envs.base import samples_outcomes
from jaxrl_tab.exact import planning

L = TypeVar("L")
T = TypeVar("T")

DRAWN_TOGETHER = 32  # for so many steps at most the random words are worked out at once; see `_steps`
CHUNKS = 256, 16  # so many steps are taken at once where a run ends with an episode; see `_run_until`


class Log(NamedTuple):
    """What happened, in rows: sums over so many steps (`num_steps`) or episodes (`num_episodes`).

    Attributes:
        steps: steps taken, int32 [rows].
        episodes: episodes that ended in the row, int32 [rows].
        returns: sum of their returns G = sum_t gamma^t R_{t+1}, float [rows].
        lengths: sum of their lengths in steps, int32 [rows].
        rewards: sum of the rewards of all steps, float [rows].
        greedy_value: exact value, from the start distribution, of the policy that is greedy to Q at the end
            of the row; -inf where it may go round for ever at a cost; float [rows]. None unless recorded.
        q_error: the largest |Q - Q*| at the end of the row, over the states that can be reached from the
            start and are not terminal, float [rows]. None unless recorded.
        v_error: of a method of `prediction`, the root of the mean squared error of V at the end of the row,
            over the same states, float [rows]. None unless recorded.
        recorded: what `record` gave at the end of the row, [rows] of each. None unless asked for.
    """

    steps: Int[Array, "*rows"]
    episodes: Int[Array, "*rows"]
    returns: Float[Array, "*rows"]
    lengths: Int[Array, "*rows"]
    rewards: Float[Array, "*rows"]
    greedy_value: Float[Array, "*rows"] | None = None
    q_error: Float[Array, "*rows"] | None = None
    v_error: Float[Array, "*rows"] | None = None
    recorded: dict[str, Array] | None = None


class _Run(NamedTuple):
    """What one run carries from step to step."""

    learner: Any
    t: Int[Array, ""]  # steps taken
    s: Int[Array, ""]
    a: Int[Array, ""]
    length: Int[Array, ""]  # steps of this episode so far
    g: Float[Array, ""]  # its return so far
    discount: Float[Array, ""]  # gamma^length


class _Start(NamedTuple):
    """How an episode begins.

    Attributes:
        state: key -> S.
        action: (key, state of the learner, S) -> A.
    """

    state: Callable
    action: Callable


class _Decisions(NamedTuple):
    """One for each decision that is made in a step: its number in `rng`, its words, or its key."""

    update: Any
    step: Any
    reset: Any
    start: Any

    def map(self, function: Callable[[Any], Any]) -> "_Decisions":
        return _Decisions(*map(function, self))


IN_A_STEP = _Decisions(update=0, step=1, reset=2, start=3)
BEFORE_RESET, BEFORE_START = 4, 5  # at time 0
INSTANCE = 6


Step: TypeAlias = Callable[[_Run, _Decisions], tuple[_Run, Log]]
Measured: TypeAlias = Callable[[Any], dict[str, Any]]


def train(
    key: PRNGKeyArray,
    algorithm: Algorithm[L] | Environment,
    env: Environment | Algorithm[L],
    *,
    num_steps: int | None = None,
    num_episodes: int | None = None,
    log_every: int | None = None,
    exact: bool = False,
    record: Record | None = None,
) -> tuple[L, Log]:
    """Runs `algorithm` in `env` and returns what it learned and what happened.

    Args:
        key: a JAX key; the run is a function of it and of the hyperparameters.
        algorithm: the method with its hyperparameters.
        env: the environment. It may also stand before the method, as in `sweep`.
        num_steps: how many steps to take. Give this or `num_episodes`.
        num_episodes: how many episodes to finish.
        log_every: steps in a row of the log (100), or episodes in a row (1). The last row may be shorter.
            Sums are plain running sums in float32: exact for whole rewards up to 2**24, so do not make rows
            of millions of steps.
        exact: also record `greedy_value` and `q_error`, or `v_error`, at the end of every row, right to 1e-6
            of themselves (`planning.measurer`): they are computed in float64, from the numbers that
            `algorithm` and `env` were given. It enumerates the environment, and for control solves a linear
            system in each row: S^3 / 3 multiply-adds (0.08 ms for 70 states on one core).
        record: a function from the state of the learner to a dict of arrays, such as
            `lambda state: {"q_start": state.q[30].max()}`; recorded at the end of every row.

    Returns:
        The state of the learner (`.q` is float [S, A]), and the Log.

    Raises:
        InputError: a number is out of range, or `exact` is asked of an environment without `outcomes`.
    """
    if isinstance(algorithm, Environment):
        algorithm, env = env, algorithm
    algorithm, env = cast(Algorithm[L], algorithm), cast(Environment, env)
    budget = Budget(num_steps, num_episodes, log_every, bool(exact), record)
    rng.check_key(key)
    check_pytree("algorithm", algorithm, METHODS)
    if is_dataclass(algorithm):
        schedules.check_single(type(algorithm).__name__, algorithm)
    check_pytree("env", env, ENVS)
    check_held(env)
    restricted(algorithm, available_actions(env))  # only to refuse what cannot be
    if exact:
        planning.check_finite(env)
    full = in_full((algorithm, env)) if exact else None
    return unchecked(key, algorithm, env, full, budget)


# Compiled by itself where nobody else does, so that a second call is quick; inlined where somebody does.
@partial(jax.jit, static_argnums=4, inline=True)
def unchecked(
    key: PRNGKeyArray,
    algorithm: Any,
    env: Any,
    full: Any,
    budget: Budget,
) -> tuple[Any, Log]:
    """`train` without its checks. `full` is `in_full((algorithm, env))` for exact values, or None."""
    stream = rng.stream(key)
    if (instance := of_environment(env).instance) is not None:
        env = instance(rng.as_key(rng.word(stream, jnp.int32(0), INSTANCE)))
        full = full and (full[0], env)  # it is drawn in the precision of the program
    measure = _make_measure(algorithm, env, full, budget.record)
    algorithm = restricted(algorithm, available_actions(env))
    start = _make_start(algorithm, env)
    step = _make_step(algorithm, env, start)
    run = _start(stream, algorithm, env, start)
    if budget.num_steps is not None:
        run, log = _run_steps(stream, step, run, budget.num_steps, budget.row, measure)
    else:
        assert budget.num_episodes is not None
        run, log = _run_episodes(stream, step, run, budget.num_episodes, budget.row, measure)
    return run.learner, log


def in_full(given: T) -> T:
    """All numbers of a method or an environment in float64, each as two words; what is traced, as it is.

    A program in float32 can be given no other numbers: 0.99 would become 0.9900000095, and v, which goes with
    1 / (1 - gamma), would be off by 1e-6.
    """

    def words(x: Any) -> Any:
        if not jnp.issubdtype(jax.typeof(x).dtype, jnp.floating) or (known := concrete(x)) is None:
            return x
        return known.astype(np.float64)[..., None].view(np.uint32)

    return jax.tree.map(words, given)


def _restored(full: T, given: T) -> T:
    """What was given to `in_full`, whose numbers in the program are `given`."""

    def number(words: Any, x: Any) -> Any:
        same = jnp.result_type(words) == jnp.result_type(x)
        return x if same or not planning.has_double() else lax.bitcast_convert_type(words, jnp.float64)

    return jax.tree.map(number, full, given)


# --- one step ----------------------------------------------------------------------------------------


def _make_start(algorithm: Algorithm, env: Environment) -> _Start:
    """How episodes begin: as the environment and the method say, or, for exploring starts, anyhow."""
    if not of_method(algorithm).exploring_starts:
        return _Start(env.reset, algorithm.policy)
    planning.check_finite(env)
    states = ~planning.terminal_states(planning.enumerate_model(env))
    return _Start(
        lambda key: policies.sample(key, states.astype(float)),
        lambda key, learner, s: policies.sample(key, _any_action(env, s)),
    )


def _any_action(env: Environment, s: Int[Array, ""]) -> Float[Array, " A"]:
    """Equal weights for the actions of a state."""
    there = available_actions(env)
    return jnp.ones(env.num_actions) if there is None else tables.row(there.astype(float), s)


def _make_step(algorithm: Algorithm, env: Environment, start: _Start) -> Step:
    """The step of the agent in its environment: run -> (run, the step's own Log)."""

    # An environment whose step is nothing but its outcomes is read from tables: less to compute in each step.
    env_step = env.step
    if samples_outcomes(env):
        env_step = env.tabulated_step()
    acts_after_update = of_method(algorithm).acts_after_update

    def step(run: _Run, key: _Decisions) -> tuple[_Run, Log]:
        s_next, reward, terminal = env_step(key.step, run.s, run.a)
        s_next = jnp.asarray(s_next, jnp.int32)
        reward, terminal = jnp.asarray(reward, run.g.dtype), jnp.asarray(terminal, bool)
        length = run.length + 1
        last = terminal | (length >= env.max_steps)
        gamma = jnp.asarray(algorithm.gamma, run.g.dtype)
        discount = jnp.where(terminal, 0, gamma)  # a time limit ends the episode and bootstraps
        t = Transition(run.s, run.a, reward, s_next, discount, last)
        learner, a_next = algorithm.update(key.update, run.learner, t)

        s_start = jnp.asarray(start.state(key.reset), jnp.int32)
        s = jnp.where(last, s_start, s_next)
        if acts_after_update and start.action == algorithm.policy:
            # A' and the first action of an episode are drawn alike: one draw serves, whichever is wanted.
            a = algorithm.policy(jnp.where(last, key.start, key.update), learner, s)
        else:
            a = jnp.where(last, start.action(key.start, learner, s_start), a_next)
        g = run.g + run.discount * reward
        log = Log(
            steps=jnp.int32(1),
            episodes=last.astype(jnp.int32),
            returns=jnp.where(last, g, 0),
            lengths=jnp.where(last, length, 0),
            rewards=reward,
        )
        run = _Run(
            learner,
            t=run.t + 1,
            s=s,
            a=a,
            length=jnp.where(last, 0, length),
            g=jnp.where(last, 0, g),
            discount=jnp.where(last, 1, run.discount * gamma),
        )
        return run, log

    return step


def _start(stream: rng.Stream, algorithm: Algorithm, env: Environment, start: _Start) -> _Run:
    """The run at time 0, in a start state with its first action chosen."""
    reset_key, start_key = (
        rng.as_key(rng.word(stream, jnp.int32(0), decision)) for decision in (BEFORE_RESET, BEFORE_START)
    )
    learner = init_learner(algorithm, env)
    s = jnp.asarray(start.state(reset_key), jnp.int32)
    a = start.action(start_key, learner, s)
    zero = jnp.zeros((), learner.q.dtype)
    return _Run(learner, t=jnp.int32(0), s=s, a=a, length=jnp.int32(0), g=zero, discount=zero + 1)


# --- many steps --------------------------------------------------------------------------------------


def _steps(stream: rng.Stream, one: Callable, carry: Any, number: int) -> Any:
    """`carry = one(carry, keys)` for so many steps; `carry[0]` is the run.

    The random words of some steps are worked out together, before these steps: in the step itself XLA would
    do it anew in each expression that uses them.
    """
    size = _drawn_together(number)

    def chunk(c, carry):
        words = IN_A_STEP.map(lambda decision: rng.words(stream, carry[0].t, size, decision))
        step = lambda i, carry: one(carry, words.map(lambda word: rng.as_key(word.at(i))))
        return lax.fori_loop(0, jnp.minimum(size, number - c * size), step, carry)

    return lax.fori_loop(0, -(-number // size), chunk, carry)


def _drawn_together(number: int) -> int:
    """For how many of so many steps the words are drawn at a time: equal parts of at most DRAWN_TOGETHER."""
    return -(-number // -(-number // DRAWN_TOGETHER))


def bytes_of_words(budget: Budget) -> int:
    """The bytes of the random words that a run holds, at most: those of no decision are never drawn."""
    number = max(CHUNKS, default=1) if budget.num_steps is None else min(budget.num_steps, budget.row)
    return len(IN_A_STEP) * rng.bytes_of_words(_drawn_together(number))


def _step(stream: rng.Stream, one: Callable, carry: Any) -> Any:
    """One of the `_steps`, by itself."""
    return one(carry, IN_A_STEP.map(lambda decision: rng.as_key(rng.word(stream, carry[0].t, decision))))


def _run_steps(
    stream: rng.Stream, step: Step, run: _Run, num_steps: int, log_every: int, measure: Measured | None
) -> tuple[_Run, Log]:
    """`num_steps` steps, with a row of the log after each `log_every` and after the last."""

    def one(carry, keys):
        run, total = carry
        run, log = step(run, keys)
        return run, jax.tree.map(jnp.add, total, log)

    def row(run: _Run, size: int) -> tuple[_Run, Log]:
        run, log = _steps(stream, one, (run, _zero_log(run)), size)
        return run, log._replace(**measure(run.learner)) if measure else log

    run, log = lax.scan(lambda run, _: row(run, log_every), run, length=num_steps // log_every)
    if rest := num_steps % log_every:
        run, last_row = row(run, rest)
        log = jax.tree.map(lambda rows, x: jnp.append(rows, x[None], axis=0), log, last_row)
    return run, log


def _run_episodes(
    stream: rng.Stream, step: Step, run: _Run, num_episodes: int, log_every: int, measure: Measured | None
) -> tuple[_Run, Log]:
    """`num_episodes` episodes, with a row of the log for each `log_every`, the last one perhaps shorter."""
    rows = -(-num_episodes // log_every)
    log = jax.tree.map(lambda x: jnp.zeros(rows, x.dtype), _zero_log(run))
    carry = run, log, jnp.int32(0)
    if measure is None:
        run, log, _ = _run_until(stream, step, carry, num_episodes, log_every)
        return run, log

    def row(carry, target):
        carry = _run_until(stream, step, carry, target, log_every)
        return carry, measure(carry[0].learner)

    targets = jnp.minimum(log_every * jnp.arange(1, rows + 1), num_episodes)
    (run, log, _), measured = lax.scan(row, carry, targets)
    return run, log._replace(**measured)


def _run_until(stream: rng.Stream, step: Step, carry, target: int | Int[Array, ""], log_every: int):
    """Runs on until `target` episodes are over. `carry` is (run, log [rows], episodes).

    Under `vmap` a loop whose length differs from lane to lane keeps the lanes that are done by selecting
    their whole state anew in every iteration. So whole chunks of steps are run as long as the target is not
    reached in one; the chunk in which it is, is run again in smaller ones, and in the end step by step.
    """

    def one(carry, keys):
        run, log, episodes = carry
        run, now = step(run, keys)
        row = episodes // log_every
        log = tables.lane_by_lane(_add_to_row, log, row, now)
        return run, log, episodes + now.episodes

    def run_chunk(size, state):
        carry, _ = state
        after = _steps(stream, one, carry, size)
        reached = after[-1] >= target
        return jax.tree.map(lambda old, new: jnp.where(reached, old, new), carry, after), reached

    for size in CHUNKS:
        state = carry, carry[-1] >= target
        carry, _ = lax.while_loop(lambda state: ~state[1], partial(run_chunk, size), state)
    return lax.while_loop(lambda carry: carry[-1] < target, partial(_step, stream, one), carry)


def _zero_log(run: _Run) -> Log:
    count, real = jnp.int32(0), jnp.zeros_like(run.g)
    return Log(steps=count, episodes=count, returns=real, lengths=count, rewards=real)


def _add_to_row(lane: Array, log: Log, row: Array, now: Log) -> Log:
    """The sums of a step into its row, for `tables.lane_by_lane`."""
    at = lane, tables.entry(row, lane)
    return jax.tree.map(
        lambda table, x: tables.write(table, tables.entry(table, *at) + tables.entry(x, lane), *at), log, now
    )


def _make_measure(algorithm: Algorithm, env: Environment, full: Any, record: Record | None):
    """What is measured at the end of a row, from the state of the learner, as fields of the Log."""
    if full is None and record is None:
        return None
    measures = []
    if full is not None:
        with planning.doubled():
            exact_algorithm, exact_env = _restored(full, (algorithm, env))
            exact_algorithm = restricted(exact_algorithm, available_actions(exact_env))
        measures.append(_exact_measurer(exact_algorithm, exact_env))
    if record:
        measures.append(lambda learner: {"recorded": _recorded(record, learner)})
    return lambda learner: {name: x for measure in measures for name, x in measure(learner).items()}


def _recorded(record: Record, learner: Any) -> dict[str, Array]:
    """What `record` says of the learner, as arrays. Raises InputError unless each has a name of its own."""
    found = record(learner) if callable(record) else None
    if not isinstance(found, dict):
        raise InputError("record must be a function from the state of the learner to a dict of arrays")
    if taken := sorted({*Log._fields, "q", "seed", "row"} & set(found)):
        raise InputError(f"record: {taken[0]!r} is already a name in the results; choose another one")
    return jax.tree.map(jnp.asarray, found)


def _exact_measurer(algorithm: Any, env: Environment) -> Measured:
    """The exact numbers beside a method: in prediction those of its own `measurer`."""
    if of_method(algorithm).learns is Learns.STATES:
        return algorithm.measurer(env)
    measure = planning.measurer(env, algorithm.gamma)
    return lambda learner: dict(zip(("greedy_value", "q_error"), measure(learner.q), strict=True))
