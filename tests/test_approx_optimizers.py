"""An optimiser of optax in place of alpha, for weights of features."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from test_approx import steps

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.core.types import Transition, fitted, init_learner

KEY = jax.random.key(0)
WALK = rl.RandomWalk(states=5)
GRID = rl.WindyGridworld()


class Adam:
    """Kingma and Ba 2015, algorithm 1: how much is added where it goes downhill."""

    def __init__(self, rate, b1=0.9, b2=0.999, eps=1e-8):
        self.rate, self.b1, self.b2, self.eps = rate, b1, b2, eps
        self.m = self.v = self.t = 0

    def __call__(self, gradient):
        self.t += 1
        self.m = self.b1 * self.m + (1 - self.b1) * gradient
        self.v = self.b2 * self.v + (1 - self.b2) * gradient**2
        m, v = self.m / (1 - self.b1**self.t), self.v / (1 - self.b2**self.t)
        return -self.rate * m / (np.sqrt(v) + self.eps)


def weights_of(method, transitions):
    """w after each transition in float64, A' of each, and the features of all states."""
    method = fitted(method, GRID)

    @jax.jit
    def learned(arrays):
        def one(state, step):
            key, t = step
            state, a_next = method.update(key, state, t)
            return state, (state.q, a_next)

        keys = jax.random.split(KEY, len(transitions))
        return jax.lax.scan(one, init_learner(method, GRID), (keys, arrays))[1]

    with jax.enable_x64():
        q, a_next = learned(Transition(*map(jnp.asarray, zip(*transitions, strict=True))))
    return np.asarray(q), np.asarray(a_next), method.features.matrix


CASES = {
    "q-learning": (approx.SemiGradientQLearning, {}, 0.0),
    "sarsa-lambda": (
        approx.SemiGradientSarsaLambda,
        {"lam": 0.8, "trace": "accumulating"},
        0.8,
    ),
}


@pytest.mark.parametrize("name", [*CASES])
@pytest.mark.parametrize("optimizer", ["sgd", "adam"])
def test_an_optimiser_learns_what_a_plain_loop_learns(name, optimizer):
    """The gradient is -delta x(S) at A, with traces -delta z; 60 transitions.

    Broken once: the gradient with the other sign; traces that do not end with the episode -> fails.
    """
    cls, more, lam = CASES[name]
    rate = 0.05
    method = cls(features="tile-coding(4, 3)", gamma=0.9, optimizer=f"optax:{optimizer}({rate})", **more)
    transitions = steps(60)
    found, a_next, x = weights_of(method, transitions)
    w, change = np.zeros((x.shape[1], 4)), Adam(rate) if optimizer == "adam" else lambda g: -rate * g
    z = np.zeros_like(w)
    for i, ((s, a, r, s_next, discount, last), after) in enumerate(zip(transitions, a_next, strict=True)):
        row = x[s_next] @ w
        delta = r + discount * (row[after] if lam else row.max()) - x[s] @ w[:, a]
        z[:, a] += x[s]
        w = w + change(-delta * z)
        z *= 0 if last else discount * lam
        np.testing.assert_allclose(found[i], w, rtol=1e-8, atol=1e-10)


def test_an_optimiser_of_n_steps_learns_what_a_plain_loop_learns():
    """Once for each step that learns, of which there are several where an episode ends.

    Broken once: alpha times the gradient; the state of the optimiser forgotten between steps -> each fails.
    """
    method = approx.SemiGradientNStepSarsa(
        features="tile-coding(4, 3)", gamma=0.9, optimizer="optax:adam(0.05)", n=3
    )
    transitions = steps(60)
    found, a_next, x = weights_of(method, transitions)
    w, change, waiting = np.zeros((x.shape[1], 4)), Adam(0.05), []
    for i, ((s, a, r, s_next, discount, last), after) in enumerate(zip(transitions, a_next, strict=True)):
        waiting = [(*pair, g + k * r, k * discount) for *pair, g, k in (*waiting, (s, a, 0.0, 1.0))]
        while len(waiting) == 3 or (last and waiting):
            s0, a0, g, k = waiting.pop(0)
            gradient = np.zeros_like(w)
            gradient[:, a0] = -(g + k * x[s_next] @ w[:, after] - x[s0] @ w[:, a0]) * x[s0]
            w = w + change(gradient)
        np.testing.assert_allclose(found[i], w, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("cls", [approx.SemiGradientSarsa, approx.SemiGradientSarsaLambda])
def test_gradient_descent_is_alpha(cls):
    """To rounding, decision for decision."""
    own = {"features": "tile-coding(2, 4)", "gamma": 0.9}
    by_alpha, first, _ = weights_of(cls(alpha=0.05, **own), steps(60))
    by_optax, second, _ = weights_of(cls(optimizer=optax.sgd(0.05), **own), steps(60))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_allclose(by_alpha, by_optax, rtol=1e-9, atol=1e-12)


def test_state_values_are_learned_by_an_optimiser():
    """In a sweep, which says what was used; an optimiser that was made in Python is one, too."""
    grid = {
        "features": "fourier(3)",
        "optimizer": ["optax:adam(0.02)", optax.chain(optax.clip(1.0), optax.sgd(0.05))],
    }
    result = rl.sweep(
        WALK, approx.SemiGradientTD, grid, num_seeds=2, num_episodes=100, exact=True, progress=False
    )
    errors = result.log.v_error
    assert (errors[..., -1] < 0.6 * errors[..., 0]).all()
    ds = result.to_xarray()
    assert ds.optimizer.values[0] == "optax:adam(0.02)"
    assert "alpha" not in ds.attrs["fixed"]


def wrong_state():
    """A transformation whose state grows."""
    return optax.GradientTransformation(
        lambda x: jnp.zeros(1), lambda g, state, x: (g, jnp.zeros(state.shape[0] + 1))
    )


def small():
    """A transformation whose state is that of two features and actions."""
    return optax.GradientTransformation(lambda x: jnp.zeros((2, 2)), lambda g, state, x: (g + state, state))


SARSA = approx.SemiGradientSarsa
REFUSED = {  # see test_approx_refusals
    "learning_rate must be greater than 0, not -1": lambda: SARSA(optimizer="optax:adam(-1)"),
    "learning_rate must be greater than 0, not 0": lambda: SARSA(optimizer="optax:sgd(learning_rate=0)"),
    "SemiGradientTD: the optimiser cannot be used for weights [7, 1]: add got incompatible shapes": lambda: (
        rl.train(jax.random.key(0), approx.SemiGradientTD(optimizer=small()), WALK, num_steps=1)
    ),
    "its updates are no real numbers": lambda: SARSA(
        optimizer=optax.GradientTransformation(lambda x: (), lambda g, state, x: (g.astype(int), state))
    ),
    "SemiGradientSarsa: give alpha or optimizer, not both": lambda: SARSA(
        alpha=0.5, optimizer="optax:adam(0.01)"
    ),
    "SemiGradientSarsa: optimizer: an optimiser is written as optax has it, with its learning rate, such as "
    "optax:adam(0.01), not 'adam(0.01)'": lambda: SARSA(optimizer="adam(0.01)"),
    "optax has no optimiser 'adm'; did you mean 'adam'?": lambda: SARSA(optimizer="optax:adm(0.01)"),
    "adam takes learning_rate, b1": lambda: SARSA(optimizer="optax:adam(b1=0.5)"),
    "its state after an update is of another kind than the one that it begins with": lambda: SARSA(
        optimizer=wrong_state()
    ),
    "SemiGradientTD: optimizer: an optimiser is a text such as": lambda: approx.SemiGradientTD(optimizer=3),
    "SemiGradientTD: give alpha or optimizer": lambda: approx.SemiGradientTD(
        alpha=0.5, optimizer="optax:adam(0.01)"
    ),
    "alpha is divided by the number of tilings, and there is none with an optimizer": lambda: SARSA(
        features="tile-coding", per_tiling=True, optimizer="optax:adam(0.01)"
    ),
    "true online learning has none, for alpha is a part of its traces: give alpha": lambda: (
        approx.SemiGradientSarsaLambda(trace="dutch", optimizer="optax:adam(0.01)")
    ),
    "has no parameter 'optimizer'": lambda: rl.sweep(
        WALK, approx.GradientMonteCarlo, {"optimizer": "optax:adam(0.01)"}, num_seeds=1, num_steps=1
    ),
}
