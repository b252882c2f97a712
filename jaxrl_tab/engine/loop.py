"""The loop of one run: step after step of an agent in its environment, and a log of sums.

The random words of a step (`rng`) depend on its number alone, so the learner's path does not depend on
`log_every`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxrl_tab.core import policies, rng, tables
from jaxrl_tab.core.declared import of_environment, of_method
from jaxrl_tab.core.types import (
    Algorithm,
    Environment,
    Outcome,
    State,
    Transition,
    available_actions,
    init_learner,
)
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.log import Log
from jaxrl_tab.envs.base import samples_outcomes
from jaxrl_tab.exact import planning


class Run(NamedTuple):
    """What one run carries from step to step."""

    learner: Any
    t: Int[Array, ""]  # steps taken
    s: State
    a: Int[Array, ""]
    length: Int[Array, ""]  # steps of this episode so far
    g: Float[Array, ""]  # its return so far
    discount: Float[Array, ""]  # gamma^length


class Happened(NamedTuple):
    """What happened in a step: its transition, and whether S' is terminal."""

    t: Transition
    terminal: Bool[Array, ""]


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


# In most environments the method alone draws: its two decisions are a pair, which costs one call of `rng`.
IN_A_STEP = _Decisions(update=0, start=1, step=2, reset=3)
BEFORE_RESET, BEFORE_START = 4, 5  # at time 0
INSTANCE = 6  # the problem of a run, where the environment draws one
LEARNER = 7  # with what a method begins, where that is random

Step: TypeAlias = Callable[[Run, _Decisions], tuple[Run, Log, "Happened"]]


class Measure(NamedTuple):
    """What is measured at the end of a row, or of some.

    Attributes:
        of: gives fields of the Log from the state of the learner.
        most: of how many rows it may be measured at once.
        every: of how many rows one is measured, and the last is; the others have NaN.
    """

    of: Callable[[Any], dict[str, Any]]
    most: int
    every: int = 1


Measures: TypeAlias = tuple[Measure, ...]


def run(
    stream: rng.Stream,
    algorithm: Algorithm,
    env: Environment,
    budget: Budget,
    measures: Measures,
    begun: Run | None = None,
) -> tuple[Run, Log]:
    """Where a run of a method in an environment is in the end, and what happened.

    Args:
        stream: from which the random words of the run come.
        algorithm: the method, which takes available actions only.
        env: the environment.
        budget: how long the run is.
        measures: what is measured at the end of rows; at most one of every row, and one of fewer.
        begun: where the run is, which goes on for as long as the budget says; None: at time 0. After a number of
            episodes it is at the beginning of one.
    """
    start = _make_start(algorithm, env)
    step = _make_step(algorithm, env, start)
    first = _start(stream, algorithm, env, start) if begun is None else begun
    if budget.num_steps is not None:
        return _run_steps(stream, step, first, budget.num_steps, budget.row, measures)
    assert budget.num_episodes is not None
    return _run_episodes(stream, step, first, budget.num_episodes, budget.row, measures)


def empty_log(dtype: Any, budget: Budget, measured: dict[str, Any]) -> Log:
    """The Log of a run whose returns are of this type, with zeros in all places; `measured`: more fields of a row."""
    row = _zero_log(dtype)._replace(**measured)
    return _empty(row, -(-(budget.num_steps or budget.num_episodes or 0) // budget.row))


# --- the same, one step at a time ----------------------------------------------------------------------


def at_start(stream: rng.Stream, algorithm: Algorithm, env: Environment) -> Run:
    """The run at time 0."""
    return _start(stream, algorithm, env, _make_start(algorithm, env))


def any_start(algorithm: Algorithm, env: Environment) -> Run:
    """A run at time 0, for its shapes alone: all its random words are zero."""
    key = rng.as_key(jnp.uint32(0))
    return _begin(_make_start(algorithm, env), key, key, init_learner(algorithm, env), jnp.int32(0))


def after_episode(
    stream: rng.Stream, algorithm: Algorithm, env: Environment, learner: Any, t: Int[Array, ""]
) -> Run:
    """The run when an episode has ended with step `t` > 0 and left this learner: the next one begins."""
    keys = _keys(stream, t - 1)
    return _begin(_make_start(algorithm, env), keys.reset, keys.start, learner, t)


def one_step(stream: rng.Stream, algorithm: Algorithm, env: Environment, run: Run) -> tuple[Run, Happened]:
    """The run one step later, and what happened in this step."""
    step = _make_step(algorithm, env, _make_start(algorithm, env))
    run, _, happened = step(run, _keys(stream, run.t))
    return run, happened


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
    available = available_actions(env)
    return jnp.ones(env.num_actions) if available is None else tables.row(available.astype(float), s)


def _make_step_of(env: Environment) -> Callable[[Int[Array, ""]], Callable[..., Outcome]]:
    """What an environment answers in a step of the run: number of the step -> ((key, S, A) -> Outcome)."""
    if (at := of_environment(env).at) is not None:
        return lambda t: at(t).step
    # An environment whose step is nothing but its outcomes is read from tables: less to compute in each step.
    step = env.tabulated_step() if samples_outcomes(env) else env.step
    return lambda t: step


def _make_step(algorithm: Algorithm, env: Environment, start: _Start) -> Step:
    """The step of the agent in its environment: run -> (run, the step's own Log, what happened)."""

    step_at = _make_step_of(env)
    acts_after_update = of_method(algorithm).acts_after_update

    def step(run: Run, key: _Decisions) -> tuple[Run, Log, Happened]:
        # Drawn before the update, on which it does not depend: so a processor works on both at the same time.
        s_start = _as_state(start.state(key.reset))
        s_next, reward, terminal = step_at(run.t)(key.step, run.s, run.a)
        s_next = _as_state(s_next)
        reward, terminal = jnp.asarray(reward, run.g.dtype), jnp.asarray(terminal, bool)
        length = run.length + 1
        last = terminal | (length >= env.max_steps)
        gamma = jnp.asarray(algorithm.gamma, run.g.dtype)
        discount = jnp.where(terminal, 0, gamma)  # a time limit ends the episode and bootstraps
        t = Transition(run.s, run.a, reward, s_next, discount, last)
        learner, a_next = algorithm.update(key.update, run.learner, t)

        s = jnp.where(last, s_start, s_next)
        if acts_after_update and start.action == algorithm.policy:
            # A' and the first action of an episode are drawn alike: one draw serves, whichever is wanted.
            a = algorithm.policy(jnp.where(last, key.start, key.update), learner, s)
        else:
            a = lax.cond(  # few steps are the last of an episode: `lanes` leaves out what none of them wants
                last,
                lambda: jnp.asarray(start.action(key.start, learner, s_start), run.a.dtype),
                lambda: jnp.asarray(a_next, run.a.dtype),
            )
        g = run.g + run.discount * reward
        log = Log(
            steps=jnp.int32(1),
            episodes=last.astype(jnp.int32),
            returns=jnp.where(last, g, 0),
            lengths=jnp.where(last, length, 0),
            rewards=reward,
        )
        run = Run(
            learner,
            t=run.t + 1,
            s=s,
            a=a,
            length=jnp.where(last, 0, length),
            g=jnp.where(last, 0, g),
            discount=jnp.where(last, 1, run.discount * gamma),
        )
        return run, log, Happened(t, terminal)

    return step


def _start(stream: rng.Stream, algorithm: Algorithm, env: Environment, start: _Start) -> Run:
    """The run at time 0, in a start state with its first action chosen."""
    reset_key, start_key = (
        rng.as_key(rng.word(stream, jnp.int32(0), decision)) for decision in (BEFORE_RESET, BEFORE_START)
    )
    learner = init_learner(algorithm, env, lambda: learner_key(stream))
    return _begin(start, reset_key, start_key, learner, jnp.int32(0))


def learner_key(stream: rng.Stream) -> Any:
    """What a method begins with where that is random."""
    return rng.as_key(rng.word(stream, jnp.int32(0), LEARNER))


def _begin(start: _Start, reset_key: Any, start_key: Any, learner: Any, t: Int[Array, ""]) -> Run:
    """The run at the beginning of an episode, in its start state with its first action chosen."""
    s = _as_state(start.state(reset_key))
    a = start.action(start_key, learner, s)
    zero = jnp.zeros((), learner.q.dtype)
    return Run(learner, t=t, s=s, a=a, length=jnp.int32(0), g=zero, discount=zero + 1)


def _as_state(s: Any) -> State:
    """A state in the type that a run carries: a number in int32, what it is otherwise in JAX's floats."""
    s = jnp.asarray(s)
    return s.astype(float if jnp.issubdtype(s.dtype, jnp.floating) else jnp.int32)


# --- many steps --------------------------------------------------------------------------------------


def _keys(stream: rng.Stream, t: Int[Array, ""]) -> _Decisions:
    """The random words of a step, as keys."""
    return IN_A_STEP.map(lambda decision: rng.as_key(rng.word(stream, t, decision)))


def _run_steps(
    stream: rng.Stream, step: Step, run: Run, num_steps: int, log_every: int, measures: Measures
) -> tuple[Run, Log]:
    """`num_steps` steps, with a row of the log after each `log_every` and after the last."""

    def one(_, carry):
        run, total = carry
        run, log, _ = step(run, _keys(stream, run.t))
        return run, jax.tree.map(jnp.add, total, log)

    def row(run: Run, size: int) -> tuple[Run, Log]:
        return lax.fori_loop(0, size, one, (run, _zero_log(run.g.dtype)))

    def whole_row(run: Run, _: None) -> tuple[Run, dict[str, Any]]:
        run, log = row(run, log_every)
        return run, log._asdict()

    rest = num_steps % log_every
    whole = _Rows(whole_row, lambda run: run.learner, is_end=not rest)
    run, fields = whole.run(run, None, num_steps // log_every, measures)
    log = Log(**fields)
    if rest:
        run, last_row = row(run, rest)
        for measure in measures:
            last_row = last_row._replace(**measure.of(run.learner))
        log = jax.tree.map(lambda rows, x: jnp.append(rows, x[None], axis=0), log, last_row)
    return run, log


class _Rows(NamedTuple):
    """Rows of a log, one after another.

    Attributes:
        row: (carry, x) -> (carry, fields of the Log).
        learner: carry -> the state of the learner.
        is_end: whether the last of them is the last of the log.
    """

    row: Callable[[Any, Any], tuple[Any, dict[str, Any]]]
    learner: Callable[[Any], Any]
    is_end: bool = True

    def run(self, carry: Any, xs: Any, count: int, measures: Measures) -> tuple[Any, dict[str, Any]]:
        """`count` rows, with what is measured in them: the carry, and the fields, [count] each."""
        thin = next((measure for measure in measures if measure.every > 1), None)
        each = next((measure for measure in measures if measure.every == 1), None)
        return (
            self._measured(carry, xs, count, each)
            if thin is None
            else self._thin(carry, xs, count, each, thin)
        )

    def _thin(
        self, carry: Any, xs: Any, count: int, each: Measure | None, thin: Measure
    ) -> tuple[Any, dict[str, Any]]:
        """The same where one of the measures is taken in few rows: at the end of each group of rows, and of all."""
        nothing = jax.eval_shape(thin.of, self.learner(carry))
        unknown = lambda size: jax.tree.map(lambda x: jnp.full((size, *x.shape), jnp.nan, x.dtype), nothing)

        def group(carry: Any, xs: Any, size: int, is_measured: bool) -> tuple[Any, dict[str, Any]]:
            carry, fields = self._measured(carry, xs, size, each)
            if not is_measured:
                return carry, fields | unknown(size)
            now = thin.of(self.learner(carry))
            return carry, fields | jax.tree.map(
                lambda nan, x: jnp.append(nan, x[None], axis=0), unknown(size - 1), now
            )

        groups, rest = divmod(count, thin.every)
        if rest and not groups:
            return group(carry, xs, rest, self.is_end)
        first, last = (
            jax.tree.map(lambda x, of=of: x[of], xs)
            for of in (slice(count - rest), slice(count - rest, None))
        )
        split = jax.tree.map(lambda x: x.reshape(groups, thin.every, *x.shape[1:]), first)
        carry, fields = lax.scan(
            lambda carry, xs: group(carry, xs, thin.every, True), carry, split, length=groups
        )
        fields = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), fields)
        if rest:
            carry, others = group(carry, last, rest, self.is_end)
            fields = jax.tree.map(lambda x, y: jnp.append(x, y, axis=0), fields, others)
        return carry, fields

    def _measured(
        self, carry: Any, xs: Any, count: int, measure: Measure | None
    ) -> tuple[Any, dict[str, Any]]:
        """The same where all of them are measured, or none.

        By `lanes` measuring is a call of what XLA compiled, which takes as long as hundreds of steps. So several rows
        are measured together, if that may be; as many as divide `count`, since a shorter rest would be a program of
        its own.
        """
        if measure is None:
            return lax.scan(self.row, carry, xs, length=count)
        together = max(n for n in range(1, measure.most + 1) if count % n == 0)

        def one(carry, x):
            carry, fields = self.row(carry, x)
            return carry, fields | measure.of(self.learner(carry))

        if together == 1:
            return lax.scan(one, carry, xs, length=count)

        def some(carry, xs):
            def unmeasured(carry, x):
                carry, fields = self.row(carry, x)
                return carry, (self.learner(carry), fields)

            carry, (learners, fields) = lax.scan(unmeasured, carry, xs, length=together)
            return carry, fields | jax.vmap(measure.of)(learners)

        split = lambda x: x.reshape(-1, together, *x.shape[1:])
        carry, fields = lax.scan(some, carry, jax.tree.map(split, xs), length=count // together)
        return carry, jax.tree.map(lambda x: x.reshape(count, *x.shape[2:]), fields)


def _run_episodes(
    stream: rng.Stream, step: Step, run: Run, num_episodes: int, log_every: int, measures: Measures
) -> tuple[Run, Log]:
    """`num_episodes` episodes, with a row of the log for each `log_every`, the last one perhaps shorter."""
    rows = -(-num_episodes // log_every)
    nothing = _zero_log(run.g.dtype)
    carry = run, _Begun(_empty(nothing, rows), jnp.int32(0), nothing), jnp.int32(0)
    if not measures:
        run, (log, *_), _ = _run_until(stream, step, carry, num_episodes, log_every)
        return run, log

    def row(carry, target):
        return _run_until(stream, step, carry, target, log_every), {}

    targets = jnp.minimum(log_every * jnp.arange(1, rows + 1), num_episodes)
    (run, (log, *_), _), measured = _Rows(row, lambda carry: carry[0].learner).run(
        carry, targets, rows, measures
    )
    return run, log._replace(**measured)


class _Begun(NamedTuple):
    """The log of a run by episodes, and the row of it that has begun.

    Attributes:
        log: the rows, [rows]; zeros where they are not over.
        over: how many are.
        total: the sums of the row that is not.
    """

    log: Log
    over: Int[Array, ""]
    total: Log


def _run_until(stream: rng.Stream, step: Step, carry, target: int | Int[Array, ""], log_every: int):
    """Runs on until `target` episodes are over, at the end of a row. `carry` is (run, rows, episodes)."""

    def one(carry):
        run, (log, over, total), episodes = carry
        run, now, _ = step(run, _keys(stream, run.t))
        total, episodes = jax.tree.map(jnp.add, total, now), episodes + now.episodes
        ends = (total.episodes == log_every) | (episodes == target)
        log = tables.lane_by_lane(_put_row, log, over, total, ends)
        total = jax.tree.map(lambda x: jnp.where(ends, 0, x), total)
        return run, _Begun(log, over + ends.astype(jnp.int32), total), episodes

    return lax.while_loop(lambda carry: carry[-1] < target, one, carry)


def _zero_log(dtype: Any) -> Log:
    count, real = jnp.int32(0), jnp.zeros((), dtype)
    return Log(steps=count, episodes=count, returns=real, lengths=count, rewards=real)


def _empty(row: Log, rows: int) -> Log:
    """So many rows like this one, with zeros in all places."""
    return jax.tree.map(lambda x: jnp.zeros((rows, *jnp.shape(x)), x.dtype), row)


def _put_row(lane: Array, log: Log, row: Array, total: Log, ends: Array) -> Log:
    """The sums of a row into the log where the row ends, for `tables.lane_by_lane`: a loop of one turn or none."""
    at = lane, tables.entry(row, lane)
    put = lambda table, x: tables.write(table, tables.entry(x, lane), *at)
    times = tables.entry(ends, lane).astype(jnp.int32)
    return lax.fori_loop(0, times, lambda _, log: jax.tree.map(put, log, total), log)
