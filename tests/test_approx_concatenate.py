"""Several features of one observation, one after another."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference_linear

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.approx.features import read
from jaxrl_tab.core.linear import Active
from jaxrl_tab.core.types import Transition, fitted, init_learner

KEY = jax.random.key(0)
CAR = rl.MountainCar()
WALK = rl.RandomWalk(states=5)


@pytest.mark.parametrize(
    "text",
    [
        "fourier(2) + tile-coding(4, 3)",
        "aggregation(3) + one-hot + tile-coding(2, 2)",
        "one-hot + polynomial(1)",
    ],
)
def test_each_part_has_its_place(text):
    """Of every state of a walk: the features of each part, side by side, and weights with which all values are 1.

    Broken once: the second part begins where the first does -> fails.
    """
    together = read(text).fitted(WALK)
    parts = [read(part).fitted(WALK) for part in text.split(" + ")]
    matrices = [np.eye(7) if isinstance(part, approx.OneHot) else part.matrix for part in parts]
    np.testing.assert_array_equal(together.matrix, np.concatenate(matrices, 1))
    np.testing.assert_allclose(together.matrix @ together.unit, 1)
    assert together.active == (None if "(1)" in text or "fourier" in text else 4)
    assert str(read(str(read(text)))) == text


@pytest.mark.parametrize("second", ["tile-coding(2, 3)", "fourier(1)"])
def test_of_what_is_observed_they_are_those_of_each(second):
    """Of a car: where all are 1 or 0, those that are 1; else all of them."""
    first = approx.TileCoding(4, 5)
    x = jnp.asarray([-0.5, 0.01])
    both = approx.Concatenate((first, second)).fitted(CAR)
    of_first, of_second = first.fitted(CAR)(x), read(second).fitted(CAR)(x)
    found = both(x)
    if isinstance(found, Active):
        np.testing.assert_array_equal(
            found.ones, [*of_first.ones, *(of_second.ones + first.fitted(CAR).size)]
        )
    else:
        np.testing.assert_array_equal(np.flatnonzero(found[: -len(of_second)]), of_first.ones)
        np.testing.assert_array_equal(found[-len(of_second) :], of_second)


def test_what_is_learned_is_what_a_plain_loop_learns():
    """Sarsa with cosines and tiles, 60 transitions, in float64."""
    from test_approx import steps

    transitions = steps(60)
    with jax.enable_x64():
        env = rl.WindyGridworld()
        method = fitted(
            approx.SemiGradientSarsa(features="fourier(1) + tile-coding(2, 3)", alpha=0.05, gamma=0.9), env
        )
        arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))

        def one(state, step):
            state, a_next = method.update(*step[:1], state, step[1])
            return state, (state.q, a_next)

        keys = jax.random.split(KEY, len(transitions))
        _, (q, a_next) = jax.lax.scan(one, init_learner(method, env), (keys, arrays))
        rows = method.features.matrix
    by_hand = reference_linear.learned("sarsa", rows, transitions, np.asarray(a_next), alpha=0.05, gamma=0.9)
    np.testing.assert_allclose(q, list(by_hand), rtol=1e-9, atol=1e-11)


def train(features, env: Any = CAR):
    return rl.train(KEY, approx.SemiGradientSarsa(features=features), env, num_steps=3)


REFUSED = {  # see test_approx_refusals
    "'fourier(3) + ': a plus stands between two features": lambda: train("fourier(3) + "),
    "there are no features 'tile-codin'; did you mean 'tile-coding'": lambda: train(
        "fourier + tile-codin(3)"
    ),
    "tiles must be whole numbers of at least 1, not 0": lambda: train("fourier(3) + tile-coding(8, 0)"),
    "OneHot: the states of MountainCar cannot be counted": lambda: train("fourier(3) + one-hot"),
    "tiles are 3 numbers, and 2 are observed": lambda: train("fourier + tile-coding(8, (1, 2, 3))"),
    "Concatenate: parts must be a tuple of features": lambda: approx.Concatenate(()),
    "are 17,000,016 features, and at most 16,777,216 are possible": lambda: train(
        "fourier(3) + tile-coding(4, 1999) + aggregation(1000)"
    ),
    "features of 3 states were given, and the task has 7": lambda: train(
        approx.Concatenate(("one-hot", np.eye(3))), WALK
    ),
    "number 0 of what is observed of a state is always 0: give low and high around it": lambda: train(
        "tile-coding(4, 4)", rl.make("maze", map=["S..G"])
    ),
}
