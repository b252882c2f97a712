"""Sarsa(lambda), the backward view: eligibility traces (book, section 12.7; Silver, lecture 5)."""

from typing import Any, ClassVar, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.algorithms.traces import TraceControl
from jaxrl_tab.core import linear, tables
from jaxrl_tab.core.backups import Backup, lambda_return
from jaxrl_tab.core.clock import Clock
from jaxrl_tab.core.credited import Credited
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import State, Transition


class SarsaLambdaState(NamedTuple):
    """A learner with traces, and what some kinds of them need besides.

    Attributes:
        values, clock: as in `traces.TraceState`.
        q_old: Q(S', A') as the last update found it, float []; with dutch traces, else None.
        q_start: Q at the start of the episode, by which it acts and learns, float [S, A]; off-line, else None.
        optimizer: the state of the optimiser of weights, where there is one (`approx.optimized`), else None.
    """

    values: Credited
    clock: Clock
    q_old: Float[Array, ""] | None
    q_start: Float[Array, "S A"] | None
    optimizer: Any = None

    @property
    def q(self) -> Float[Any, "... S A"]:
        """Q, float [S, A]; of a batch [..., S, A]."""
        return self.values.q if self.q_start is None else self.q_start


@pytree
class SarsaLambda(TraceControl):
    """Sarsa whose error is credited to all pairs of the episode so far, the more the later they came.

    delta = R + gamma Q(S', A') - Q(S, A)
    z(s, a) <- gamma lambda z(s, a) + 1[(s, a) = (S, A)]        (accumulating; Silver, lecture 5)
    Q(s, a) <- Q(s, a) + alpha delta z(s, a)

    A' is drawn from the behaviour policy before the update, and is the action that is then taken. Traces end
    with the episode, by a terminal state or by the time limit.

    With dutch traces this is true online Sarsa(lambda), `TrueOnlineSarsaLambda` (book, box of section 12.7; van Seijen
    and Sutton 2014): for a constant alpha, at every step the very Q of the forward view that looks as far as that step.

    The sum of the off-line increments is that of the forward view, `SarsaLambdaForward`. **It is not the
    book's off-line lambda-return algorithm** (section 12.1, figure 12.3; `SarsaLambdaForward(one_by_one=True)`), which
    makes its updates at the end of the episode one after another, each from what the one before it left. A pair that
    comes n times in an episode moves by n errors here, so Q diverges where alpha n is much more than 2; the book's does
    not. In the prediction of its figure, with lambda = 0 and alpha = 1, that is an RMS error of thousands against
    0.40.
    """

    trace: Literal["accumulating", "replacing", "clearing", "dutch"] = static(  # pyright: ignore[reportIncompatibleVariableOverride]
        default="accumulating",
        help="A pair that comes again gets 1 added to its trace; or gets 1; or gets 1, and the other actions of its "
        "state get 0; or gets 1 added to 1 - alpha of it.",
    )
    offline: bool = static(
        default=False,
        help="Act and learn by the Q of the start of the episode, and add the sum of all increments at its end "
        "(Silver, lecture 4). It goes with accumulating traces.",
    )

    backup: ClassVar[Backup] = Backup(
        lambda_return("action", "state, action"),
        "Traces carry each error back to earlier pairs, which adds up to this: exactly, where it learns off-line; "
        "as far as the episode has come, with dutch traces; nearly, else.",
    )

    def __post_init__(self):
        super().__post_init__()
        if self.offline and self.trace != "accumulating":
            problem = f"offline goes with accumulating traces only, not {self.trace}"
            raise InputError(problem, who=type(self).__name__, field="offline")

    def init(self, num_states: int, num_actions: int) -> SarsaLambdaState:
        values, clock = super().init(num_states, num_actions)
        q_old = jnp.zeros_like(values.credit) if self.trace == "dutch" else None
        return SarsaLambdaState(values, clock, q_old, values.q if self.offline else None)

    def row(self, state: SarsaLambdaState, s: State) -> Float[Array, " A"]:
        return super().row(state, s) if state.q_start is None else linear.row(state.q_start, self.x(s))

    def value(self, state: SarsaLambdaState, s: State, a: Int[Array, ""]) -> Float[Array, ""]:
        return (
            super().value(state, s, a) if state.q_start is None else linear.entry(state.q_start, self.x(s), a)
        )

    def update(self, key, state: SarsaLambdaState, t: Transition):
        state = self.begin(state, t)
        a_next = self.policy(key, state, t.s_next)
        q, q_next = self.value(state, t.s, t.a), self.value(state, t.s_next, a_next)
        delta = t.r + t.discount * q_next - q
        if state.q_old is not None:  # dutch
            # Q(S, A) is no longer what the last error counted on: all pairs but this step's own are told. In the
            # first step of an episode there are no others, so q_old may be anything.
            alpha, told = self.step_size(state, t), q - state.q_old
            values = state.values.added(self.x(t.s), t.a, -alpha * told)
            state, delta = state._replace(values=values, q_old=q_next), delta + told
        state = self.learn(state, t, delta)
        if state.q_start is not None:  # at the end of an episode no trace is left, so that Q is the base
            q_start = tables.changed_where(t.last, _replaced, state.q_start, state.values.base)
            state = state._replace(q_start=q_start)
        return state, a_next


def _replaced(old: Array, new: Array) -> Array:
    return new
