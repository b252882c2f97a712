"""Gradient Monte Carlo prediction, against a plain loop and against tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_approx import KEY, steps

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.core.types import Transition, fitted, init_learner


def by_the_box(x, transitions, alpha):
    """The weights [n] after each transition, in float64: the box of section 9.3; v(S') is the rest at a time limit."""
    w, episode = np.zeros(x.shape[1]), []
    for s, _, r, s_next, discount, last in transitions:
        episode.append((s, r))
        if last:
            returns, g = [], discount * x[s_next] @ w
            for _, r in reversed(episode):
                g = r + g
                returns.append(g)
                g *= 0.9
            for (s, _), g in zip(episode, reversed(returns), strict=True):
                w = w + alpha * (g - x[s] @ w) * x[s]
            episode = []
        yield w


def learned(method, transitions):
    """The method as it is in the windy gridworld, and its weights after each transition."""
    method = fitted(method, rl.WindyGridworld())
    arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))

    def one(state, t):
        state, _ = method.update(KEY, state, t)
        return state, state.v

    state = init_learner(method, rl.WindyGridworld())
    return method, jax.jit(lambda steps: jax.lax.scan(one, state, steps)[1])(arrays)


@pytest.mark.parametrize(
    "features", ["tile-coding(4, 5)", pytest.param("polynomial(3)", marks=pytest.mark.slow)]
)
def test_it_learns_what_the_box_learns(features):
    """After each of 300 transitions. Broken once: from the last step to the first; without the rest -> each fails."""
    transitions = steps(300)
    with jax.enable_x64():
        method, w = learned(approx.GradientMonteCarlo(features=features, alpha=0.05, gamma=0.9), transitions)
    by_hand = list(by_the_box(method.features.matrix, transitions, 0.05))
    np.testing.assert_allclose(w, by_hand, rtol=1e-9, atol=1e-11)


def test_one_hot_features_are_a_table():
    """To the last bit where no state comes twice in an episode; else that of lambda = 1, which goes forwards, too."""
    of_table = rl.prediction.MonteCarloPrediction(alpha=0.1, gamma=0.9)
    forwards = rl.prediction.OfflineLambdaReturn(alpha=0.1, gamma=0.9, lam=1.0)
    mine = approx.GradientMonteCarlo(alpha=0.1, gamma=0.9)
    again = steps(120, states=5)
    order = np.random.default_rng(0).permutation(70)
    once = [(int(order[i % 70]), *more) for i, (_, *more) in enumerate(steps(120))]
    np.testing.assert_array_equal(learned(mine, once)[1], learned(of_table, once)[1])
    np.testing.assert_allclose(learned(mine, again)[1], learned(forwards, again)[1], rtol=1e-4, atol=1e-6)


def test_states_need_not_be_counted():
    """The features of each step are remembered: of one that is always 1, by hand."""
    car = rl.MountainCar(max_steps=3)
    state, _ = rl.train(KEY, approx.GradientMonteCarlo(features="polynomial(0)", alpha=0.5), car, num_steps=3)
    # The returns are -3, -2 and -1, for the value 0 of what is reached at the time limit is the rest.
    np.testing.assert_allclose(state.v, [-1.375])
    with pytest.raises(rl.InputError, match="pi cannot be given for each state, for those of MountainCar"):
        rl.train(KEY, approx.GradientMonteCarlo(features="polynomial", pi=[[1, 0, 0]]), car, num_steps=3)
