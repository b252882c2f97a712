"""What is exact about values that are linear in features: brute force, and numbers that are in the book."""

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.envs import FiniteMDP

RAND = np.random.default_rng(5)
linear_values = rl.planning.linear_values


def task(ends):
    """A random task of six states and two actions; where it `ends`, in the last of them."""
    rand = np.random.default_rng(1)
    p, r = rand.dirichlet(np.ones(6), (6, 2)), rand.normal(size=(6, 2, 6))
    last = ends * 5
    outcomes = [
        [
            [(1.0, 5, 0.0, True)]
            if ends and s == 5
            else [(p[s, a, k], k, r[s, a, k], ends and k == last) for k in range(6)]
            for a in range(2)
        ]
        for s in range(6)
    ]
    return FiniteMDP.from_outcomes(outcomes, start=np.eye(6)[0]), p, r


@pytest.mark.parametrize("of_actions", [False, True])
@pytest.mark.parametrize("ends", [False, True])
def test_all_of_it_is_what_brute_force_gives(ends, of_actions):
    """Off-policy, with features that depend on each other. Broken once: mu of pi; the end goes on -> fails."""
    env, p, r = task(ends)
    pi, b, gamma = RAND.dirichlet(np.ones(2), 6), RAND.dirichlet(np.ones(2), 6), 0.8
    x = RAND.normal(size=(6, 2)) @ RAND.normal(size=(2, 3))
    states = np.arange(6) < (5 if ends else 6)
    p, r = (np.where(states[:, None, None], y, 0) for y in (p, r))
    inside = p * states
    # mu: where an episode ends the next one begins; a million steps of powers.
    walk = np.einsum("sa,sak->sk", b, inside)
    walk[:, 0] += states * (1 - walk.sum(1))
    mu = np.linalg.matrix_power(walk + np.diag(~states), 2**20)[0]
    if of_actions:
        lead = np.einsum("sak,kb->sakb", inside, pi).reshape(12, 12)
        mu, reward = (mu[:, None] * b).ravel(), (p * r).sum(2).ravel()
        full = np.kron(x, np.eye(2))
    else:
        lead, reward, full = np.einsum("sa,sak->sk", pi, inside), np.einsum("sa,sak->s", pi, p * r), x
    truth = np.linalg.solve(np.eye(len(lead)) - gamma * lead, reward)
    d = np.diag(mu)
    found = linear_values(env, pi, x, gamma, behaviour=b, of_actions=of_actions)
    np.testing.assert_allclose(found.mu, mu, atol=1e-12)
    np.testing.assert_allclose(found.values[mu > 0], truth[mu > 0], atol=1e-12)

    w = RAND.normal(size=full.shape[1])
    given = w.reshape(3, 2) if of_actions else w
    delta = reward + gamma * lead @ (full @ w) - full @ w
    project = full @ np.linalg.pinv(full.T @ d @ full, rcond=1e-10) @ full.T @ d
    of = lambda y: y @ d @ y
    np.testing.assert_allclose(found.value_error(given), of(full @ w - truth), rtol=1e-9)
    np.testing.assert_allclose(found.bellman_error(given), of(delta), rtol=1e-9)
    np.testing.assert_allclose(found.projected_bellman_error(given), of(project @ delta), rtol=1e-8)
    best = found.best_weights()
    np.testing.assert_allclose(full @ best.ravel(), project @ truth, atol=1e-9)
    a = full.T @ d @ (full - gamma * lead @ full)
    fixed = np.linalg.pinv(a, rcond=1e-10) @ (full.T @ d @ reward)
    td = found.td_fixed_point()
    np.testing.assert_allclose(full @ td.ravel(), full @ fixed, atol=1e-8)
    assert found.projected_bellman_error(td) < 1e-20
    # Of all weights with these values the smallest: nothing of them lies where the features see nothing.
    for weights in (best, td):
        np.testing.assert_allclose(
            np.linalg.pinv(full) @ (full @ weights.ravel()), weights.ravel(), atol=1e-9
        )


def test_the_least_bellman_error_is_not_where_the_values_are():
    """A-presplit (example 11.3): A1 leads to B, A2 to C, and both look alike; B earns 1, C nothing."""
    end = [(1.0, 4, 0.0, True)]
    a1, a2, b, c = ([(1.0, k, r, k == 4)] for k, r in ((2, 0.0), (3, 0.0), (4, 1.0), (4, 0.0)))
    env = FiniteMDP.from_outcomes([[a1], [a2], [b], [c], [end]], start=np.array([0.5, 0.5, 0, 0, 0]))
    x = np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]])
    found = linear_values(env, np.ones((5, 1)), x)
    np.testing.assert_allclose(found.best_weights(), [0.5, 1, 0], atol=1e-12)
    np.testing.assert_allclose(found.td_fixed_point(), [0.5, 1, 0], atol=1e-12)
    np.testing.assert_allclose(found.bellman_error([0.5, 1, 0]), 1 / 8)
    np.testing.assert_allclose(found.bellman_error([0.5, 0.75, 0.25]), 1 / 16)  # where it is least
    assert found.projected_bellman_error([0.5, 0.75, 0.25]) > 0.01


def w_to_2w(gamma, reward):
    """Two states whose values are w and 2 w (section 11.2); pi goes to the second, b to either."""
    to = lambda s: [(1.0, s, reward, False)]
    env = FiniteMDP.from_outcomes([[to(0), to(1)], [to(0), to(1)]], start=np.array([0.5, 0.5]))
    pi, b = np.array([[0.0, 1.0]] * 2), np.full((2, 2), 0.5)
    return linear_values(env, pi, [[1.0], [2.0]], gamma, behaviour=b)


def test_where_there_is_no_fixed_point_it_says_so():
    """A = (1 - 2 gamma) / 2 + 2 (1 - gamma) is 0 at gamma = 5/6. Broken once: without the check -> fails."""
    np.testing.assert_allclose(w_to_2w(0.5, 1.0).td_fixed_point(), [1.5])  # b = 3/2, A = 1
    with pytest.raises(rl.InputError, match="no single fixed point") as error:
        w_to_2w(5 / 6, 1.0).td_fixed_point()
    assert "\n" not in str(error.value)


REFUSED = {
    "features must be finite numbers of each of the 21 states": ({"features": np.eye(5)}, rl.RandomWalk()),
    "gamma must be": ({"gamma": 2.0}, rl.RandomWalk()),
    "behaviour leaves out action": (
        {"policy_probs": np.full((70, 4), 0.25), "behaviour": np.eye(4)[[0] * 70], "features": np.eye(70)},
        rl.WindyGridworld(),
    ),
    "it has no finite value there; take gamma below 1": (
        {"policy_probs": np.full((20, 2), 0.5), "features": np.eye(20)},
        rl.make("garnet"),
    ),
    "can only be sampled": ({}, rl.MountainCar()),
}


@pytest.mark.parametrize("message", REFUSED)
def test_refusals(message):
    own, env = REFUSED[message]
    if "garnet" in type(env).__name__.lower():
        own = own | {
            "policy_probs": np.full((env.num_states, env.num_actions), 1 / env.num_actions),
            "features": np.eye(env.num_states),
        }
    given = {"policy_probs": np.ones((21, 1)), "features": np.eye(21)} | own
    with pytest.raises(rl.InputError) as error:
        linear_values(env, **given)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_weights_of_another_number_are_refused():
    with pytest.raises(rl.InputError, match=r"weights \[1\] of the features, not \[3\]"):
        w_to_2w(0.5, 0.0).value_error([1, 2, 3])


# --- along the curve -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walks():
    """By XLA, as on a GPU. Broken once: what is prepared for the errors not `in_turn` -> a TypeError."""
    walk = rl.RandomWalk(states=9)
    grid = {"features": ["aggregation(3)", "polynomial(2)"], "alpha": [0.05]}
    budget = {"num_seeds": 3, "num_episodes": 40, "log_every": 20, "exact": True, "progress": False}
    budget["backend"] = "xla"
    return rl.sweep(walk, approx.SemiGradientTD, grid, **budget)


def test_errors_along_the_curve_are_those_of_the_weights(walks):
    """Weights are worked out from the values that results hold. Broken once: weighted by states alone -> fails."""
    for i, features in enumerate(walks.grid["features"]):
        x = approx.matrix(features, walks.env)
        exact = linear_values(walks.env, np.ones((11, 1)), x)
        for seed in range(3):
            w = np.linalg.lstsq(x, walks.q[i, 0, seed, :, 0].astype(float))[0]
            log = walks.log
            np.testing.assert_allclose(
                log.value_error[i, 0, seed, -1], exact.value_error(w) ** 0.5, rtol=1e-5
            )
            for name in ("bellman_error", "projected_bellman_error"):
                error = getattr(log, name)[i, 0, seed, -1]
                np.testing.assert_allclose(error, getattr(exact, name)(w) ** 0.5, rtol=1e-4)
        best, td = (exact.value_error(w) ** 0.5 for w in (exact.best_weights(), exact.td_fixed_point()))
        np.testing.assert_allclose(walks.references["least_value_error"][i], best)
        np.testing.assert_allclose(walks.references["td_value_error"][i], td)


def test_they_are_in_the_dataset_the_table_and_the_picture(walks):
    ds = walks.to_xarray()
    assert ds.least_value_error.dims == ("features", "alpha")
    table = rl.stats.summary({"td": ds})
    np.testing.assert_allclose(table.final_value_error, ds.value_error[..., -1].mean("seed").values.ravel())
    assert [*table.columns[-2:]] == ["final_v_error", "optimum"]
    canvas = rl.plot.canvas(rl.plot.WIDTH)
    ax = canvas.subplots()
    rl.plot.learning_curves(ax, {"td": ds}, measure="value_error")
    assert {"the least possible", "fixed point of TD"} <= {*ax.get_legend_handles_labels()[1]}


@pytest.mark.slow
def test_the_measurer_sees_what_acts():
    """Off-policy in a task that does not end, and in one that does; with features, and each state for itself."""
    for ends in (False, True):
        env = task(ends)[0]
        pi, b = RAND.dirichlet(np.ones(2), 6), RAND.dirichlet(np.ones(2), 6)
        for x in (RAND.normal(size=(6, 2)) @ RAND.normal(size=(2, 3)), np.eye(6)):
            given = None if x.shape == (6, 6) else x
            w = RAND.normal(size=x.shape[1]) * (np.arange(x.shape[1]) < 5)
            exact = linear_values(env, pi, x, 0.9, behaviour=b)
            with jax.enable_x64():
                found = rl.planning.linear_value_measurer(env, pi, 0.9, given, b)(jax.numpy.asarray(x @ w))
            of = exact.value_error, exact.bellman_error, exact.projected_bellman_error
            np.testing.assert_allclose(found[1:], [error(w) ** 0.5 for error in of], rtol=1e-8)
