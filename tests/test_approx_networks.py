"""Control by a neural network: its gradient, what it learns of a batch, the order of its memory, its copy."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.approx import network
from jaxrl_tab.core.types import Transition, fitted, init_learner

KEY = jax.random.key(0)
CAR = rl.MountainCar()
CLIFF = rl.CliffWalking()
DEEP = {"q": approx.DeepQNetwork, "sarsa": approx.DeepSarsa}
SMALL = {"network": "mlp(5, 4, activation='tanh')", "buffer": 6, "batch": 3, "target_every": 4, "gamma": 0.9}


def transitions(count, seed=0):
    rand = np.random.default_rng(seed)
    s = rand.integers(0, 48, count + 1)
    ends = rand.random(count) < 0.2
    discount = np.where(ends, 0, 0.9)
    return Transition(s[:-1], rand.integers(0, 4, count), rand.normal(size=count), s[1:], discount, ends)


def outputs(weights, x):
    """The network as a plain loop: tanh, and a linear layer."""
    for w, b in weights[:-1]:
        x = np.tanh(x @ w + b)
    return x @ weights[-1][0] + weights[-1][1]


def observed(s):
    """Row and column of the cliff, scaled to [-1, 1]."""
    return 2 * np.array([s // 12 / 3, s % 12 / 11]) - 1


@pytest.fixture(scope="module", params=["q", pytest.param("sarsa", marks=pytest.mark.slow)])
def run(request):
    """Twelve steps in float64: those, the learner before and after each, the places that it learned from, and A'."""
    method = fitted(DEEP[request.param](**SMALL, optimizer="optax:sgd(0.1)"), CLIFF)
    steps = transitions(12)

    @jax.jit
    def learned(steps):
        def one(state, step):
            key, t = step
            state, a_next = method.update(key, state, t)
            return state, (state, method.drawn(key, state), a_next)

        first = init_learner(method, CLIFF, lambda: KEY)
        return first, jax.lax.scan(one, first, (jax.random.split(KEY, 12), steps))[1]

    with jax.enable_x64():
        first, (after, drawn, actions) = jax.tree.map(np.asarray, learned(jax.tree.map(jnp.asarray, steps)))
    states = [first, *(jax.tree.map(lambda x, i=i: x[i], after) for i in range(12))]
    return request.param, [Transition(*x) for x in zip(*steps, strict=True)], states, drawn, actions


def test_the_gradient_is_that_of_finite_differences(run):
    """Of the mean of 1/2 [target - q(S, A)]^2 over a batch, by every weight: what the last step changed, over -0.1.

    Broken once: the gradient also of the target -> fails.
    """
    name, _, states, drawn, _ = run
    memory = states[-1].memory
    weights, copy = ([tuple(layer) for layer in x] for x in (states[-2].weights, states[-2].target))

    def loss(weights):
        errors = []
        for i in drawn[-1]:
            ahead = outputs(copy, memory.x_next[i])
            after = ahead.max() if name == "q" else ahead[memory.a_next[i]]
            target = memory.r[i] + memory.discount[i] * after
            errors.append(target - outputs(weights, memory.x[i])[memory.a[i]])
        return np.mean(np.square(errors)) / 2

    for k, layer in enumerate(weights):
        for part, x in enumerate(layer):
            found = (x - states[-1].weights[k][part]) / 0.1
            for at in np.ndindex(x.shape):
                sides = []
                for h in (1e-5, -1e-5):
                    moved = [[y.copy() for y in own] for own in weights]
                    moved[k][part][at] += h
                    sides.append(loss(moved))
                assert found[at] == pytest.approx((sides[0] - sides[1]) / 2e-5, abs=1e-8)


def test_it_learns_what_a_plain_loop_learns(run):
    """The weights after each step, with the draws given; the copy is made after steps 4, 8 and 12.

    Broken once: the copy not used; learning before there is a batch; the last action for A' -> each fails.
    """
    name, steps, states, drawn, actions = run
    weights = [(np.array(w), np.array(b)) for w, b in states[0].weights]
    copy = [(w.copy(), b.copy()) for w, b in weights]
    memory = {}
    for i, (t, places, a_next) in enumerate(zip(steps, drawn, actions, strict=True)):
        s, a, r, s_next, discount, _ = map(np.asarray, t)
        memory[i % 6] = (observed(s), int(a), float(r), float(discount), observed(s_next), a_next)
        if i >= 2:
            gradients = [[np.zeros_like(x) for x in layer] for layer in weights]
            for place in places:
                x, a, r, discount, x_next, after = memory[place]
                ahead = outputs(copy, x_next)
                target = r + discount * (ahead.max() if name == "q" else ahead[after])
                inputs = [x]
                for w, b in weights[:-1]:
                    inputs.append(np.tanh(inputs[-1] @ w + b))
                back = np.zeros(4)
                back[a] = (outputs(weights, x)[a] - target) / 3
                for k in (2, 1, 0):
                    gradients[k][0] += np.outer(inputs[k], back)
                    gradients[k][1] += back
                    back = (weights[k][0] @ back) * (1 - inputs[k] ** 2)
            weights = [
                (w - 0.1 * dw, b - 0.1 * db) for (w, b), (dw, db) in zip(weights, gradients, strict=True)
            ]
        if (i + 1) % 4 == 0:
            copy = weights
        for own, hand in ((states[i + 1].weights, weights), (states[i + 1].target, copy)):
            for layer, plain in zip(own, hand, strict=True):
                np.testing.assert_allclose(layer.w, plain[0], rtol=1e-9, atol=1e-12)
                np.testing.assert_allclose(layer.b, plain[1], rtol=1e-9, atol=1e-12)


def test_the_memory_is_a_ring(run):
    """After twelve steps in a memory of six: the last six, the oldest overwritten first; draws are where steps are."""
    _, steps, states, drawn, _ = run
    np.testing.assert_array_equal(states[-1].memory.r, [steps[i].r for i in range(6, 12)])
    np.testing.assert_array_equal(states[8].memory.r, [steps[i].r for i in (6, 7, 2, 3, 4, 5)])
    np.testing.assert_array_equal(states[8].memory.a, [steps[i].a for i in (6, 7, 2, 3, 4, 5)])
    for i, places in enumerate(drawn):
        assert places.shape == (3,)
        assert (places >= 0).all() and (places <= min(i, 5)).all()


def test_first_weights():
    """Of the variance that is said, different for each key, and the same for all runs of a seed."""
    net = network.read("mlp(400, 300)")
    weights = net.init(KEY, 200, 3)
    for layer, variance in zip(weights, (2 / 200, 2 / 400, 1 / 300), strict=True):
        n = layer.w.size
        assert abs(float(layer.w.var()) / variance - 1) < 5 * np.sqrt(0.8 / n)  # of a uniform: kurtosis 1.8
        assert abs(float(layer.w.mean())) < 5 * np.sqrt(variance / n)
        assert (layer.b == 0).all()
    assert str(net) == "mlp(400, 300)"
    assert str(network.read("mlp(32, activation='tanh')")) == "mlp(32, activation='tanh')"


@pytest.mark.slow
@pytest.mark.parametrize("name", DEEP)
def test_it_learns_the_way(name):
    """Over a windy grid of 5 x 6, in 6000 steps: as long as the shortest way, but for what exploring costs."""
    grid = rl.WindyGridworld(shape=(5, 6), wind=(0, 0, 1, 1, 0, 0), start=(2, 0), goal=(2, 5), max_steps=100)
    own = {"network": "mlp(32)", "batch": 16, "buffer": 2000, "target_every": 100, "gamma": 0.95}
    method = DEEP[name](optimizer="optax:adam(0.005)", **own)
    state, log = rl.train(KEY, method, grid, num_steps=6000, log_every=1000, exact=True)
    best = float(rl.planning.start_value(grid, rl.planning.value_iteration(grid, 0.95)[0]))
    assert log.greedy_value[-1] == pytest.approx(best, rel=0.1)
    assert log.lengths[-1] / log.episodes[-1] < 12
    assert np.isfinite(state.q).all()


def test_xla_compiles_it():
    """One who asks for `lanes` is told so. Broken once: the method not asked -> fails."""
    with pytest.raises(
        rl.InputError, match="DeepSarsa in CliffWalking is not compiled by lanes: it multiplies matri"
    ):
        rl.sweep(CLIFF, approx.DeepSarsa, {}, num_seeds=1, num_steps=1, backend="lanes", progress=False)


def train(method, env: Any = CLIFF):
    return rl.train(KEY, method, env, num_steps=3)


REFUSED = {  # see test_approx_refusals
    "DeepQNetwork: q0 is a table, and Q is a network": lambda: train(
        approx.DeepQNetwork(q0=np.ones((48, 4)))
    ),
    "DeepSarsa: the optimiser cannot be used for weights [2, 64], [64], [64, 64]": lambda: train(
        approx.DeepSarsa(
            optimizer=optax.GradientTransformation(lambda x: (), lambda g, state, x: (g + 1, state))
        )
    ),
    "DeepQNetwork: network: 'mpl(3)' is not a network with the widths of its hidden layers, such as mlp(64, 64)": (
        lambda: approx.DeepQNetwork(network="mpl(3)")
    ),
    "DeepQNetwork: network: widths must be whole numbers of at least 1, not": lambda: approx.DeepQNetwork(
        network="mlp(64, 0)"
    ),
    "activation": lambda: approx.DeepQNetwork(network="mlp(3, activation='selu')"),
    "mlp takes widths and activation": lambda: approx.DeepQNetwork(network="mlp(3, depth=4)"),
    "DeepSarsa: a batch of 32 steps cannot be drawn from a memory of 10": lambda: approx.DeepSarsa(buffer=10),
    "DeepQNetwork: optimizer: an optimiser is written as optax has it, with its learning rate": (
        lambda: approx.DeepQNetwork(optimizer="adam")
    ),
    "optax has no optimiser 'adm'; did you mean 'adam'?": lambda: approx.DeepQNetwork(
        optimizer="optax:adm(1)"
    ),
    "OneHot: the states of MountainCar cannot be counted": lambda: train(
        approx.DeepQNetwork(features="one-hot"), CAR
    ),
    "what goes by visits needs states that can be counted": lambda: train(
        approx.DeepQNetwork(epsilon="sample-average"), CAR
    ),
}
