"""Expected updates of linear TD: the mean of the sampled ones, and what diverges, without a sample."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.core.types import Transition, fitted, init_learner
from jaxrl_tab.exact import expected
from jaxrl_tab.exact.projected import linear_values

BAIRD = rl.make("baird")
START = [1.0, 1, 1, 1, 1, 1, 10, 1]  # of the book
RATES = {"alpha": 0.005, "beta": 0.05}


@pytest.fixture(scope="module")
def baird():
    return linear_values(
        BAIRD, BAIRD.target_policy, BAIRD.features, BAIRD.discount, behaviour=BAIRD.behaviour_policy
    )


@pytest.fixture(scope="module")
def garnet():
    """A task with rewards, two policies, and three features of its states."""
    random = np.random.default_rng(3)
    env = rl.make("garnet")
    pi, b = random.dirichlet(np.ones(env.num_actions), (2, env.num_states))
    return linear_values(env, pi, random.normal(size=(env.num_states, 3)), 0.9, behaviour=b)


@pytest.mark.parametrize("method", [expected.semi_gradient, expected.dynamic_programming])
def test_semi_gradient_td_and_dynamic_programming_diverge(baird, method):
    """By an eigenvalue above 1, however small alpha is, and by going on. Broken once: P without gamma -> fails."""
    for alpha in (1e-6, 1e-3, 0.01):
        assert method(baird, alpha).diverges
        np.testing.assert_allclose((method(baird, alpha).radius - 1) / alpha, 0.2392505, rtol=1e-5)
    for alpha in (1e-3, 0.01):
        errors = [
            baird.value_error(w)
            for w in method(baird, alpha).curve(START, int(50 / alpha))[:: int(10 / alpha)]
        ]
        assert (np.diff(errors) > 0).all()
        assert errors[-1] > 1e5


def test_gradient_td_and_emphatic_td_do_not(baird):
    """TDC brings the projected Bellman error to 0, and not the value error, as in figure 11.5; emphatic TD both."""
    for update in (expected.tdc(baird, **RATES), expected.gtd2(baird, **RATES)):
        assert not update.diverges
        w = update.curve(START, 3000)[-1, :8]
        assert np.sqrt(baird.projected_bellman_error(w)) < 0.01
        assert 1.9 < np.sqrt(baird.value_error(w)) < 2
    for lam in (0.0, 0.5):
        assert not expected.emphatic(baird, 0.03, lam).diverges
        for curve in (
            expected.emphatic(baird, 0.03, lam).curve(START, 1000),
            expected.emphatic_curve(baird, 0.03, START, 1000, lam),
        ):
            np.testing.assert_allclose(BAIRD.features @ curve[-1], 0, atol=1e-8)


def test_gradient_td_goes_down_the_projected_bellman_error(garnet):
    """With the second weights that are right for w: its direction is that of finite differences of PBE."""
    w, h = np.array([0.3, -1.0, 2.0]), 1e-5
    weighed = garnet.features.T * garnet.mu
    error = garnet.reward + garnet.onward @ (garnet.features @ w) - garnet.features @ w
    v = np.linalg.solve(weighed @ garnet.features, weighed @ error)
    pbe = garnet.projected_bellman_error
    slope = [(pbe(w + h * e) - pbe(w - h * e)) / (2 * h) for e in np.eye(3)]
    for update in (expected.gtd2(garnet, **RATES), expected.tdc(garnet, **RATES)):
        step = (update.curve(np.append(w, v), 1)[1, :3] - w) / RATES["alpha"]
        np.testing.assert_allclose(step, -0.5 * np.array(slope), rtol=1e-6, atol=1e-9)


def test_where_td_does_not_diverge_it_ends_in_its_fixed_point(garnet):
    for update in (
        expected.semi_gradient(garnet, 0.1),
        expected.gtd2(garnet, 0.05, 0.5),
        expected.tdc(garnet, 0.05, 0.5),
    ):
        assert not update.diverges
        w = np.linalg.solve(np.eye(len(update.matrix)) - update.matrix, update.constant)[:3]
        np.testing.assert_allclose(w, garnet.td_fixed_point(), rtol=1e-8)


@pytest.mark.parametrize("lam", [0.0, 0.7, 1.0])
def test_emphatic_td_in_the_long_run(garnet, lam):
    """Its curve comes to its own step, and with lambda = 1 to the values that are best where b comes.

    Broken once: traces that go on by P, without lambda; the emphasis of lambda = 0 for each -> each fails.
    """
    update, w = expected.emphatic(garnet, 0.05, lam), np.array([0.3, -1.0, 2.0])
    curve = expected.emphatic_curve(garnet, 0.05, w, 400, lam)
    np.testing.assert_allclose(curve[-1], update.curve(curve[-2], 1)[1], rtol=1e-9)
    if lam == 1:
        end = np.linalg.solve(np.eye(3) - update.matrix, update.constant)
        np.testing.assert_allclose(end, garnet.best_weights(), rtol=1e-8)


def test_the_expected_update_is_the_mean_of_the_sampled_ones(baird):
    """Over all states, actions and what follows, of the methods themselves, in float64."""
    s, a, k = (x.ravel() for x in np.mgrid[:7, :2, :6])
    s_next = np.where(a == 0, k, 6)
    chance = BAIRD.behaviour_policy[s, a] / 7 / 6
    w, v = np.random.default_rng(0).normal(size=(2, 8, 1))
    classes = {approx.SemiGradientOffPolicyTD: {}, approx.GTD2: {"beta": 0.05}, approx.TDC: {"beta": 0.05}}
    with jax.enable_x64():
        zero = np.zeros(len(s))
        arrays = (
            s.astype(np.int32),
            a.astype(np.int32),
            zero,
            s_next.astype(np.int32),
            zero + 0.99,
            zero > 1,
        )
        ts = Transition(*map(jnp.asarray, arrays))
        methods = [
            fitted(cls(features="own", alpha=0.005, gamma=0.99, **more), BAIRD)
            for cls, more in classes.items()
        ]

        def moved(t):
            found = []
            for method in methods:
                state = init_learner(method, BAIRD)
                given = {"q": jnp.asarray(w)} | ({"v": jnp.asarray(v)} if hasattr(state.learner, "v") else {})
                state = state._replace(learner=state.learner._replace(**given))
                learner = method.update(jax.random.key(0), state, t)[0].learner
                found.append(
                    [x[:, 0] for x in ([learner.q, learner.v] if hasattr(learner, "v") else [learner.q])]
                )
            return found

        found = jax.jit(jax.vmap(moved))(ts)
    updates = (
        expected.semi_gradient(baird, 0.005),
        expected.gtd2(baird, **RATES),
        expected.tdc(baird, **RATES),
    )
    for update, after in zip(updates, found, strict=True):
        mean = chance @ np.concatenate([np.asarray(x) for x in after], 1)
        start = np.concatenate([w, v])[: mean.size, 0]
        np.testing.assert_allclose(mean, update.curve(start, 1)[1], rtol=1e-9, atol=1e-12)


def test_refusals(baird, garnet):
    with pytest.raises(rl.InputError, match=r"start must be 8 weights, not \[3\]"):
        expected.semi_gradient(baird, 0.1).curve([1.0, 2, 3], 2)
    with pytest.raises(rl.InputError, match=r"start must be 8 weights, not \[3\]"):
        expected.emphatic_curve(baird, 0.1, [1.0, 2, 3], 2)
    with pytest.raises(rl.InputError, match="curve: updates must be a whole number of at least 0, not -1"):
        expected.tdc(baird, 0.1, 0.1).curve(np.ones(8), -1)
    with pytest.raises(rl.InputError, match="beta must be greater than 0, not nan"):
        expected.gtd2(baird, 0.1, float("nan"))
    with pytest.raises(rl.InputError, match=r"those of planning.linear_values\(...\), not of Baird"):
        expected.dynamic_programming(BAIRD, 0.1)  # pyright: ignore[reportArgumentType]
    env = rl.make("two-loops")
    pi = np.full((env.num_states, 2), 0.5)
    with pytest.raises(rl.InputError, match="leave of_actions out"):
        expected.tdc(linear_values(env, pi, np.eye(env.num_states), 0.9, of_actions=True), 0.1, 0.1)
