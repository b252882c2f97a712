"""What is recorded of a run, row by row."""

import contextlib
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple, Self, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.errors import InputError, reason, shown
from jaxrl_tab.core.types import Environment, fitted, init_learner
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.budget import NO_RECORDER, Recorder, Tables

Recording: TypeAlias = Callable[[Any, Any], Any]
"""What is recorded, a dict of arrays if it is right: a function of the method, which is fitted to its task, and of the
state of its learner."""

_NAMES = {"q", "diverged", "optimum", "environment", "method", DRAW, "seed", "row", "state", "action"}
# Fields that earlier versions did not record: files of theirs lack them.
LATER = frozenset({"policy_value", "value_error", "bellman_error", "projected_bellman_error"})
_OWN = "recorded."  # before the names of what is recorded, where they stand beside the fields


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
        policy_value: the same of the policy that acts, as it acts at the end of the row, exploring and all; float
            [rows]. None unless recorded, and where a method does not say by what probabilities it acts.
        q_error: the largest |Q - Q*| at the end of the row, over the states that can be reached from the
            start and are not terminal, float [rows]. None unless recorded.
        v_error: of a method of `prediction`, the root of the mean squared error of V at the end of the row,
            over the same states, float [rows]. None unless recorded.
        value_error: of a method of prediction with features, the root of VE, the mean squared error of V weighted by
            how often the policy that acts is in each state, float [rows] (book, equation 9.1). None unless recorded.
        bellman_error: of the same, the root of BE, the mean squared error of the Bellman equation, weighted in the same
            way, float [rows] (equation 11.19). None unless recorded.
        projected_bellman_error: of the same, the root of PBE, which is what of it the features can express, float
            [rows] (equation 11.22). None unless recorded.
        recorded: what `record` gave at the end of the row, [rows] of each. None unless asked for.
    """

    steps: Int[Array, "*rows"]
    episodes: Int[Array, "*rows"]
    returns: Float[Array, "*rows"]
    lengths: Int[Array, "*rows"]
    rewards: Float[Array, "*rows"]
    greedy_value: Float[Array, "*rows"] | None = None
    policy_value: Float[Array, "*rows"] | None = None
    q_error: Float[Array, "*rows"] | None = None
    v_error: Float[Array, "*rows"] | None = None
    value_error: Float[Array, "*rows"] | None = None
    bellman_error: Float[Array, "*rows"] | None = None
    projected_bellman_error: Float[Array, "*rows"] | None = None
    recorded: dict[str, Array] | None = None

    def named(self) -> dict[str, Any]:
        """All that is there, by names of which no two are the same: `Log.of` makes the Log of it again."""
        named = {name: x for name, x in self._asdict().items() if x is not None and name != "recorded"}
        return named | {_OWN + name: x for name, x in (self.recorded or {}).items()}

    @classmethod
    def of(cls, named: Mapping[str, Any]) -> Self:
        own = {name.removeprefix(_OWN): x for name, x in named.items() if name.startswith(_OWN)}
        return cls(**{name: x for name, x in named.items() if name in cls._fields}, recorded=own or None)


def record_of(record: Recorder | None, algorithm: Any) -> Recording | None:
    """What is recorded of a run: what the method declares, and what `record` says; None where that is nothing."""
    names = of_method(algorithm).records
    if record is None and not names:
        return None

    def both(algorithm: Any, learner: Any) -> Any:
        own = {name: getattr(learner, name) for name in names}
        if record is None:
            return own
        more = record.of(algorithm, learner) if isinstance(record, Tables) else record(learner)
        return own | more if isinstance(more, dict) else more

    both.__name__ = getattr(record, "__name__", "it")
    return both


def recorded(record: Recording, algorithm: Any, learner: Any) -> dict[str, Array]:
    """What `record` says of the learner of a method that is fitted to its task, as arrays.

    Raises:
        InputError: it raises something, or gives anything but arrays of numbers, each with a name of its own.
    """
    try:
        arrays = record(algorithm, learner)
    except Exception as error:
        problem = f"record: {record.__name__} raised {type(error).__name__}: {reason(error)}"
        raise InputError(problem) from error
    if not isinstance(arrays, dict):
        raise InputError(NO_RECORDER)
    arrays = {name: _as_array(name, x) for name, x in arrays.items()}
    hyperparameters = {f.name for f in fields(algorithm)} if is_dataclass(algorithm) else set()
    axes = {f"{name}_{i}" for name, x in arrays.items() for i in range(x.ndim)}
    if taken := sorted({*Log._fields, *_NAMES, *hyperparameters, *axes} & set(arrays)):
        raise InputError(f"record: {taken[0]!r} is already a name in the results; choose another one")
    return arrays


def recorded_shapes(
    record: Recorder | None, algorithm: Any, env: Environment
) -> dict[str, jax.ShapeDtypeStruct]:
    """The shapes of what `record` says of a learner; nothing is computed. Raises InputError as `recorded`."""
    if (whole := record_of(record, algorithm)) is None:
        return {}
    algorithm = fitted(algorithm, env)
    return jax.eval_shape(lambda: recorded(whole, algorithm, init_learner(algorithm, env)))


def _as_array(name: Any, x: Any) -> Array:
    """What is recorded under a name, as it can stand in a file."""
    if not isinstance(name, str) or not re.fullmatch(r"\w([\w .+-]*[\w.+-])?", name):
        raise InputError(
            f"record: a name has letters, digits, '_', '-' and '.', such as 'q_start', not {shown(name)}"
        )
    with contextlib.suppress(TypeError, ValueError):
        x = jnp.asarray(x)
    is_array = isinstance(x, jax.Array)
    if not is_array or not x.size or not re.fullmatch(r"bool|u?int(8|16|32|64)|float(32|64)", str(x.dtype)):
        of = f"{x.dtype}{list(x.shape)}" if is_array else shown(x)
        raise InputError(f"record: {name} must be a number or an array of numbers, not {of}")
    return x
