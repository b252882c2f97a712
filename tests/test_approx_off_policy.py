"""Prediction off-policy with features, LSTD, weights at the start, and the two counterexamples, against plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_approx import KEY, steps

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.core.types import Transition, fitted, init_learner
from jaxrl_tab.exact import planning

GRID = rl.WindyGridworld()
RANDOM = np.random.default_rng(5)
PI, B = (x / x.sum(1, keepdims=True) for x in RANDOM.uniform(0.1, 1, (2, 70, 4)))
OFF_POLICY = {"gamma": 0.9, "alpha": 0.02, "pi": PI, "behaviour": B}
METHODS = {
    "td": (approx.SemiGradientOffPolicyTD, OFF_POLICY),
    "gtd2": (approx.GTD2, OFF_POLICY | {"beta": 0.07}),
    "tdc": (approx.TDC, OFF_POLICY | {"beta": 0.07}),
    "emphatic": (approx.EmphaticTD, OFF_POLICY | {"alpha": 0.002}),
    "emphatic, traces": (approx.EmphaticTD, OFF_POLICY | {"alpha": 0.002, "lam": 0.6}),
    "lstd": (approx.LSTD, {"gamma": 0.9, "ridge": 0.2}),
}
COUNTED_FROM = "1,1,1,1,1,1,10,1"  # of example 11.2


def by_the_book(name, x, transitions, alpha=0.02, beta=0.07, gamma=0.9, ridge=0.2):
    """The weights [n] after each transition, in float64, by the equations of chapters 9 and 11."""
    n = x.shape[1]
    w, v, a, b = np.zeros(n), np.zeros(n), ridge * np.eye(n), np.zeros(n)
    z, followed, fades, lam = np.zeros(n), 1.0, 0.0, 0.6 if name == "emphatic, traces" else 0.0
    for s, action, r, s_next, discount, last in transitions:
        rho = PI[s, action] / B[s, action]
        now, ahead = x[s], discount * x[s_next]
        delta = r + ahead @ w - now @ w
        if name == "td":
            w = w + alpha * rho * delta * now
        elif name == "gtd2":
            w, v = w + alpha * rho * (now - ahead) * (now @ v), v + beta * rho * (delta - v @ now) * now
        elif name == "tdc":
            w, v = (
                w + alpha * rho * (delta * now - ahead * (now @ v)),
                v + beta * rho * (delta - v @ now) * now,
            )
        elif name.startswith("emphatic"):
            z = rho * (fades * z + (lam + (1 - lam) * followed) * now)
            w = w + 0.1 * alpha * delta * z
            fades, followed = (0.0, 1.0) if last else (discount * lam, 1 + discount * rho * followed)
        else:
            a, b = a + np.outer(now, now - ahead), b + r * now
            w = np.linalg.solve(a, b)
        yield w


def learned(methods, transitions):
    """The methods as they are in the windy gridworld, and their weights after each transition, of one program."""
    methods = {name: fitted(method, GRID) for name, method in methods.items()}
    arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))

    def one(states, t):
        states = {name: methods[name].update(KEY, state, t)[0] for name, state in states.items()}
        return states, {name: state.v for name, state in states.items()}

    states = {name: init_learner(method, GRID) for name, method in methods.items()}
    return methods, jax.jit(lambda steps: jax.lax.scan(one, states, steps)[1])(arrays)


@pytest.mark.parametrize(
    "features", ["tile-coding(4, 3)", pytest.param("polynomial(3)", marks=pytest.mark.slow)]
)
def test_methods_learn_what_the_book_says(features):
    """After each of 300 transitions; LSTD has the weights of its closed form.

    Broken once: without rho; v before w; an emphasis that outlives its episode; A^-1 not turned -> each fails.
    """
    transitions = steps(300)
    with jax.enable_x64():
        methods = {name: cls(features=features, **more) for name, (cls, more) in METHODS.items()}
        methods, weights = learned(methods, transitions)
    for name, method in methods.items():
        by_hand = list(by_the_book(name, method.features.matrix, transitions))
        np.testing.assert_allclose(weights[name], by_hand, rtol=1e-8, atol=1e-9, err_msg=name)


def test_one_hot_features_are_the_table():
    """To the last bit: n-step TD off-policy with n = 1 multiplies the whole error by rho, too."""
    mine = approx.SemiGradientOffPolicyTD(**OFF_POLICY)
    table = rl.prediction.NStepOffPolicyTD(**OFF_POLICY, n=1)
    _, v = learned({"features": mine, "table": table}, steps(300))
    np.testing.assert_array_equal(v["features"], v["table"])


# --- the counterexamples ---------------------------------------------------------------------------------


def test_baird_is_that_of_the_book():
    """Solid leads down and dashed up; all states come equally often; the features are those of its figure."""
    env = rl.make("baird")
    prob, after = jax.vmap(jax.vmap(env.outcomes, (None, 0)), (0, None))(jnp.arange(7), jnp.arange(2))
    leads = np.zeros((7, 2, 7))
    np.add.at(leads, (*np.ogrid[:7, :2, :0][:2], np.asarray(after.s_next)), np.asarray(prob))
    np.testing.assert_allclose(leads[:, 0], np.tile([1 / 6] * 6 + [0], (7, 1)), atol=1e-7)
    np.testing.assert_allclose(leads[:, 1], np.tile([0] * 6 + [1], (7, 1)), atol=1e-7)
    assert not np.asarray(after.reward).any()
    np.testing.assert_allclose(np.einsum("sa,saz->sz", env.behaviour_policy, leads), 1 / 7, atol=1e-7)
    weights = np.arange(1.0, 9)
    np.testing.assert_array_equal(env.features @ weights, [10, 12, 14, 16, 18, 20, 7 + 16])
    np.testing.assert_allclose(planning.stationary_distribution(env, env.behaviour_policy), 1 / 7)


def test_least_squares_and_dynamic_programming_diverge_in_the_task_of_tsitsiklis_and_van_roy():
    """w is multiplied by (6 - 4 ends) / 5 gamma (book, equation 11.10)."""
    env = rl.make("tsitsiklis-van-roy", ends=0.25)
    x, w, gamma = env.features[:2], np.ones(1), 0.95
    for _ in range(3):
        backup = rl.planning.evaluation_backup(env, env.features @ w, np.ones((3, 1)), gamma)
        found = np.linalg.lstsq(x, backup[:2])[0]
        np.testing.assert_allclose(found, w * (6 - 4 * 0.25) / 5 * gamma)
        w = found


def test_a_task_states_its_features_and_its_policies():
    """What is left out is what the task says; what is given stays."""
    env = rl.make("baird")
    method = fitted(approx.TDC(features="own"), env)
    np.testing.assert_array_equal(method.features.matrix, env.features)
    np.testing.assert_array_equal(method.pi.probabilities, env.target_policy)
    np.testing.assert_array_equal(method.behaviour.probabilities, env.behaviour_policy)
    other = np.full((7, 2), 0.5)
    np.testing.assert_array_equal(fitted(approx.TDC(pi=other), env).pi.probabilities, other)
    np.testing.assert_array_equal(fitted(rl.prediction.TD(), env).pi.probabilities, env.target_policy)
    assert fitted(approx.TDC(), GRID).pi is None


# --- weights at the start --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "w"),
    [
        ("0.1", np.full((7, 2), 0.1)),
        (0.1, np.full((7, 2), 0.1)),
        ("1,2,3,4,5,6,7.5", np.repeat([[1], [2], [3], [4], [5], [6], [7.5]], 2, 1)),
        (np.arange(14).reshape(7, 2) / 3, np.arange(14).reshape(7, 2) / 3),
    ],
)
def test_weights_at_the_start(given, w):
    """As a number, of each feature, or of each feature and action; the text that is kept means the same."""
    method = approx.SemiGradientSarsa(features=np.eye(7), w0=given)
    assert approx.SemiGradientSarsa(features=np.eye(7), w0=method.w0).w0 == method.w0
    state = init_learner(fitted(method, rl.make("baird")), rl.make("baird"))
    np.testing.assert_array_equal(state.q, w.astype(np.float32))


def train(method, env):
    return rl.train(KEY, method, env, num_steps=3)


REFUSED = {  # see test_approx_refusals
    "w0 must be a number for all weights": lambda: approx.TDC(w0=[]),
    "w0 must be weights that are finite in float32, not 1e+39": lambda: approx.TDC(w0=1e39),
    "SemiGradientTD: give v0 or w0, not both": lambda: approx.SemiGradientTD(v0=1.0, w0=2.0),
    "SemiGradientSarsa: give q0 or w0, not both": lambda: approx.SemiGradientSarsa(q0=1.0, w0="2"),
    "w0 must be a number for all weights, or those of each feature": lambda: approx.GTD2(w0="1,2,x"),
    "such as 1,1,10, not '1,2;3'": lambda: approx.GTD2(w0="1,2;3"),
    "w0 are weights of shape [3], and there are 8 features": lambda: train(
        approx.GTD2(features="own", w0="1,2,3"), rl.make("baird")
    ),
    "w0 are weights of shape [2, 2], and there are 70 features and 4 actions": lambda: train(
        approx.SemiGradientSarsa(w0="1,2;3,4"), GRID
    ),
    "MountainCar has no features of its own": lambda: train(
        approx.SemiGradientSarsa(features="own"), rl.MountainCar()
    ),
    "behaviour leaves out action 0 in state 0": lambda: approx.TDC(behaviour=[[0, 1]], pi=[[0.5, 0.5]]),
    "GTD2: it compares two policies state by state, and the states of MountainCar cannot be counted": lambda: (
        train(approx.GTD2(features="tile-coding"), rl.MountainCar())
    ),
    "LSTD: ridge must be": lambda: approx.LSTD(ridge=0.0),
}
