"""What a table of values is worth, worked out inside a compiled program while it is learned."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxrl_tab.core import policies
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.double import doubled, in_turn
from jaxrl_tab.exact.model import Model, check_lasting, ending_at, enumerate_model, reachable, terminal_states
from jaxrl_tab.exact.projected import least_size
from jaxrl_tab.exact.values import NEARLY, from_start, greedy_to, iterate_policies, policy_values, solve_dense

Measure = Callable[..., tuple[Float[Array, ""], ...]]


def _traced_model(env: Any) -> Model:
    """The Model of an environment inside a compiled program, of the states that matter.

    Those that cannot be reached from the start are made terminal: whatever they pay then has no part in
    anything. Probabilities that are thirds of float32 are made to add up to 1.
    """
    model = enumerate_model(jax.tree.map(lambda x: x.copy() if isinstance(x, np.ndarray) else x, env))
    model = ending_at(model, ~reachable(model))
    return model._replace(prob=model.prob / model.prob.sum(-1, keepdims=True))


def measurer(env: Environment, gamma: Any) -> Measure:
    """A function from Q [S, A] to (greedy_value [], q_error []), for use under `jit` and `vmap`.

    It takes policies [S, A] besides, and then also gives the value of each: (greedy_value, q_error, value, ...).

    greedy_value is the exact value, from the start distribution, of the policy that is greedy to Q with ties
    split; -inf where gamma is 1 and that policy may be caught for ever while rewards go on. q_error is the
    largest |Q - Q*| over the states that can be reached from the start and are not terminal, never visited
    ones included; NaN where Q* is not finite in one of them. Both are NaN where Q holds a NaN. The value of a policy
    is from the start distribution as well; its probabilities are made to add up to 1, and it is NaN where one is.

    Everything is computed in float64, also where the program around it is in float32, and comes back in the
    precision of Q. So both have the relative error of a float32, 6e-8, and in addition that of float64, 1e-16
    times the expected number of steps to the end, of the numbers that they are added up from. What `env` and
    `gamma` hold is taken as it is: a tracer in float32 holds 0.99 to 1e-8 only, while 1 - 0.99 is then right
    to 1e-6. (`train` hands on in full what is no tracer when it is called.)

    Args:
        env: an environment with `outcomes`; its leaves may be tracers.
        gamma: discount rate; may be a tracer.

    Raises:
        InputError: `env` can only be sampled, or changes in a run.
    """

    def value(model: Model, policy: Float[Array, "S A"], gamma: Any) -> Float[Array, ""]:
        return from_start(model, policy_values(model, policy, gamma).v)

    return _measurer(env, gamma, value, lambda far, counts: _largest(jnp.where(counts, abs(far), 0)))


def long_run_measurer(env: Environment) -> Measure:
    """The same by the average reward of a step, in tasks that do not end, where values are known up to a constant.

    The value of a policy is its average reward from the start distribution, r(pi), and q_error half the difference
    between the largest and the least Q - q*, which is the largest |Q - q* - c| with the constant c that fits best.

    (1 - gamma) v is r(pi) but for what goes with 1 - gamma, and the difference of two such numbers takes that off. The
    linear systems are solved without a subtraction (`values.solve_dense`), so gamma may be as close to 1 as it likes.
    What is left is about 1e-12 times the square of the steps that a chain needs to forget where it began.

    Args, errors: as `measurer`.
    """

    def rate(model: Model, policy: Float[Array, "S A"], gamma: Any) -> Float[Array, ""]:
        value = lambda by: (1 - by) * from_start(model, policy_values(model, policy, by).v)
        first, second = lax.map(value, jnp.stack([gamma, (1 + gamma) / 2]))  # one linear system to compile
        return 2 * second - first

    def apart(far: Float[Array, "S A"], counts: Any) -> Float[Array, ""]:
        return (jnp.where(counts, far, -jnp.inf).max() - jnp.where(counts, far, jnp.inf).min()) / 2

    return _measurer(env, NEARLY, rate, apart)


def _measurer(env: Environment, gamma: Any, value: Callable[..., Any], apart: Callable[..., Any]) -> Measure:
    """What `measurer` describes.

    Args:
        env, gamma: as there.
        value: (model, policy [S, A], gamma) -> what the policy is worth.
        apart: (Q - Q* [S, A], which entries count) -> how far it is from none.
    """
    check_lasting(env)
    with doubled():
        model = _traced_model(env)
        gamma = jnp.asarray(gamma, model.prob.dtype)
        best = iterate_policies(model, 0.0, gamma)
        is_solved = ~(best.caught.any() | best.better.any())
        matters = ~terminal_states(model)

    def worth(policy: Float[Array, "S A"]) -> Float[Array, ""]:
        with doubled():
            return jnp.where(jnp.isnan(policy).any(), jnp.nan, value(model, policy, gamma))

    def measure(q: Float[Array, "S A"], *others: Float[Array, "S A"]) -> tuple[Float[Array, ""], ...]:
        if q.shape != model.prob.shape[:2]:
            raise InputError(f"exact values are those of one table [S, A]; this method has {list(q.shape)}")
        counts = matters[:, None] & (q > policies.UNAVAILABLE)
        # NaN is looked for on its own: in compiled code 0 / 0 may be 0 and a maximum may pass over NaN.
        sound = ~jnp.isnan(q).any()
        with doubled():
            exact_q = q.astype(model.prob.dtype)
            # A policy that depends on what is the largest jumps: it has no derivative.
            greedy, *acting = (lax.stop_gradient(x.astype(exact_q.dtype)) for x in (exact_q, *others))
            each = [greedy_to(greedy), *(x / x.sum(1, keepdims=True) for x in acting)]
            # One after another, so that there is one linear system at a time, and one to compile.
            worths = lax.map(worth, jnp.stack(each)).astype(q.dtype)
            error = apart(exact_q - best.q, counts).astype(q.dtype)
        of_greedy, *values = worths
        return jnp.where(sound, of_greedy, jnp.nan), jnp.where(sound & is_solved, error, jnp.nan), *values

    return measure


@jax.custom_jvp
def _largest(x: Float[Array, "..."]) -> Float[Array, ""]:
    return x.max()


@_largest.defjvp
def _largest_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """JAX's own rule for a maximum, which is asked for when the block `doubled` is left, in float64 all the same."""
    (x,), (change,) = primals, tangents
    with doubled():
        largest = x.max()
        is_largest = (x == largest).astype(x.dtype)
        return largest, (is_largest * change).sum() / is_largest.sum()


def value_measurer(env: Environment, policy_probs: Any, gamma: Any) -> Callable[[Any], Float[Array, ""]]:
    """A function from V [S] to the root of its mean squared error as v_pi, for use under `jit` and `vmap`.

    The mean is over the states that can be reached from the start and are not terminal; NaN where v_pi is not
    finite in one of them. In float64, as `measurer`.

    Args:
        env: an environment with `outcomes`; its leaves may be tracers.
        policy_probs: pi, float [S, A]; may be a tracer.
        gamma: discount rate; may be a tracer.

    Raises:
        InputError: `env` can only be sampled, or changes in a run.
    """
    check_lasting(env)
    with doubled():
        model = _traced_model(env)
        pi, gamma = _in_precision(model, policy_probs, gamma)
        return _value_measurer(model, policy_values(model, pi / pi.sum(1, keepdims=True), gamma).v)


def _in_precision(model: Model, *numbers: Any) -> tuple[Array, ...]:
    return tuple(jnp.asarray(x, model.prob.dtype) for x in numbers)


def _value_measurer(model: Model, v_pi: Float[Array, " S"]) -> Callable[[Any], Float[Array, ""]]:
    matters = ~terminal_states(model)
    finite = jnp.isfinite(jnp.where(matters, v_pi, 0)).all()

    def measure(v: Float[Array, " S"]) -> Float[Array, ""]:
        with doubled():
            squares = jnp.where(matters, (v.astype(v_pi.dtype) - v_pi) ** 2, 0)
            error = jnp.sqrt(squares.sum() / matters.sum()).astype(v.dtype)
        return jnp.where(finite, error, jnp.nan)

    return measure


def linear_value_measurer(
    env: Environment, policy_probs: Any, gamma: Any, features: Any = None, behaviour: Any = None
) -> Callable[[Any], tuple[Float[Array, ""], ...]]:
    """A function from V [S] to (v_error, value_error, bellman_error, projected_bellman_error), of a linear V.

    v_error is that of `value_measurer`. The others are the roots of VE, BE and PBE as `projected.LinearValues` has
    them, weighted by how often the policy that acts is in each state. As there NaN, but for BE and PBE, where v_pi is
    not finite.

    Args:
        env, policy_probs, gamma: as in `value_measurer`.
        features: x(s) of each state, float64 [S, n]; None where each state is a feature of its own.
        behaviour: the policy that acts, float [S, A]; None where it is pi.
    """
    check_lasting(env)
    with doubled():
        model = _traced_model(env)
        pi, b, gamma = _in_precision(
            model, policy_probs, policy_probs if behaviour is None else behaviour, gamma
        )
        pi, b = (x / x.sum(1, keepdims=True) for x in (pi, b))
        v_pi = policy_values(model, pi, gamma).v
        v_error = _value_measurer(model, v_pi)

        @in_turn
        def weighed(pi: Array, b: Array, gamma: Array) -> Any:
            mu = _share_of_steps(model, b)
            onward, reward = _chain(model, pi), (pi[:, :, None] * model.prob * model.reward).sum((1, 2))
            root = jnp.sqrt(mu)
            # delta = r + (gamma P - 1) v, weighted.
            to_delta, constant = root[:, None] * (gamma * onward - jnp.eye(len(mu))), root * reward
            if features is None:
                return mu, to_delta, constant, None, None
            x = jnp.asarray(features, root.dtype)
            # What the features can express, and the same weighted: of both a basis, with one program for the two.
            values, basis = lax.map(_orthonormal, jnp.stack([x, root[:, None] * x]))
            # V by its coordinates, so that a row of the log takes n numbers for each state instead of S.
            return mu, to_delta @ values, constant, values, basis

        mu, to_delta, constant, values, basis = weighed(pi, b, gamma)

    @in_turn
    def of_weights(v: Float[Array, " S"]) -> tuple[Float[Array, ""], ...]:
        with doubled():
            exact_v = v.astype(v_pi.dtype)
            apart = jnp.where(mu > 0, exact_v - v_pi, 0)
            delta = constant + to_delta @ _coordinates(values, exact_v)
            projected = _coordinates(basis, delta)
            squares = (mu * apart**2).sum(), (delta**2).sum(), (projected**2).sum()
            return tuple(jnp.sqrt(x).astype(v.dtype) for x in squares)

    return lambda v: (v_error(v), *of_weights(v))


def _coordinates(basis: Float[Array, "S k"] | None, x: Float[Array, " S"]) -> Float[Array, " k"]:
    """Those of x in an orthonormal basis; x itself where each state is a feature of its own."""
    return x if basis is None else basis.T @ x


def _chain(model: Model, policy: Float[Array, "S A"]) -> Float[Array, "S S"]:
    """The probabilities with which a policy leads from state to state within an episode."""
    weight = jnp.where(model.terminal, 0, policy[:, :, None] * model.prob)
    return (
        jnp.zeros((len(policy),) * 2, weight.dtype)
        .at[np.arange(len(policy))[:, None, None], model.s_next]
        .add(weight)
    )


def _share_of_steps(model: Model, policy: Float[Array, "S A"]) -> Float[Array, " S"]:
    """The share of all steps that a policy spends in each state in the long run, as `visits.stationary_distribution`.

    It is 1 - gamma times the discounted visits from the start, but for what goes with 1 - gamma; and the difference of
    two such numbers takes that off (see `long_run_measurer`).
    """
    over = (policy[:, :, None] * model.prob * model.terminal).sum((1, 2))
    again = _chain(model, policy) + jnp.outer(over, model.start)  # where an episode ends the next one begins
    n = len(again)

    def visits(gamma: Any) -> Float[Array, " S"]:
        left = jnp.full(n, 1 - gamma, again.dtype)
        return (1 - gamma) * (model.start @ solve_dense(gamma * again, left, jnp.eye(n, dtype=again.dtype)))

    nearly = jnp.asarray(NEARLY, again.dtype)
    first, second = lax.map(visits, jnp.stack([nearly, (1 + nearly) / 2]))
    share = jnp.where(terminal_states(model), 0, jnp.maximum(2 * second - first, 0))
    return share / share.sum()


def _orthonormal(x: Float[Array, "S n"]) -> Float[Array, "S k"]:
    """Vectors of length 1, at right angles to each other, that span the columns of x; the rest of the k are 0.

    The longest of what is left is taken out, over and over, so that rounding comes last (Gram and Schmidt with
    exchanges, each vector made orthogonal twice). It is not left to LAPACK, for the reason given in `values`.
    """
    steps = min(x.shape)
    least = least_size(x.shape) ** 2 * (x**2).sum(0).max()

    def take(k: Any, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        found, left = carry
        sizes = (left**2).sum(0)
        # Of truths, and with 32 bits: JAX lowers it where float64 is not known, and fails at an `argmax` of that.
        i = lax.argmax(sizes == sizes.max(), 0, jnp.int32)
        longest = left[:, i]
        longest = longest - found @ (found.T @ longest)
        size = (longest**2).sum()
        unit = jnp.where(sizes[i] > least, longest / jnp.sqrt(jnp.where(size > 0, size, 1)), 0)
        return found.at[:, k].set(unit), left - jnp.outer(unit, unit @ left)

    return lax.fori_loop(0, steps, take, (jnp.zeros((len(x), steps), x.dtype), x))[0]
