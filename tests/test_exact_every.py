"""Exact values in few rows of the log only: `exact_every`."""

import jax.numpy as jnp
import numpy as np
import pytest
from made_up import make_result

import jaxrl_tab as rl
from jaxrl_tab.show.explorer.measures import POINTS, Flat, measures_of

DOORS = rl.make("two-doors")
THIN = ("greedy_value", "policy_value", "q_error")
BUDGETS = {
    "a shorter last row": {"num_steps": 95, "log_every": 10},
    "episodes": {"num_episodes": 11},
}


def both(method, budget, backend, record=None):
    """The log with exact values in all rows, and in every fourth."""
    given = {"num_seeds": 4, "backend": backend, "record": record} | BUDGETS[budget]
    sweep = lambda **exact: rl.sweep(DOORS, method, {"alpha": 0.3}, **given, **exact).log.named()
    return sweep(exact=True), sweep(exact_every=4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "budget"),
    [("xla", "a shorter last row"), pytest.param("lanes", "episodes", marks=pytest.mark.slow)],
)
def test_every_fourth_row_and_the_last_have_them_and_nothing_else_changes(backend, budget):
    """Broken once: the last rows left out -> fails; all that is recorded thinned out -> fails."""
    whole, thin = both("sarsa", budget, backend, record=lambda state: {"top": 2 * jnp.max(state.q)})
    rows = whole["steps"].shape[-1]
    measured = [row for row in range(rows) if (row + 1) % 4 == 0 or row == rows - 1]
    for name, x in whole.items():
        at = measured if name in THIN else slice(None)
        np.testing.assert_array_equal(thin[name][..., at], x[..., at])
        assert name not in THIN or np.isnan(np.delete(thin[name], measured, -1)).all()


def test_of_fewer_rows_than_are_left_out_the_last_has_them():
    """Broken once: a loop over no groups of rows -> `lanes` fails."""
    log = rl.sweep(DOORS, "sarsa", num_seeds=2, num_episodes=3, exact_every=4).log
    np.testing.assert_array_equal(np.isfinite(log.policy_value), [[False, False, True]] * 2)


@pytest.mark.slow
def test_errors_of_prediction_are_in_all_rows():
    """They are what methods are compared by. Broken once: thinned out as well -> NaN."""
    log = rl.sweep(rl.make("random-walk"), "td", num_seeds=2, num_episodes=5, exact_every=4).log
    assert np.isfinite(log.v_error).all()


def test_what_is_drawn_is_what_was_known_by_then():
    """Of 100 rows one in 7 is measured, and three make a point. Broken once: the rows at the ends of points -> NaN."""
    ds = make_result(DOORS, np.zeros((DOORS.num_states, DOORS.num_actions)), seeds=2, rows=100).to_xarray()
    rows = ds.sizes["row"]
    measured = np.array([(row + 1) % 7 == 0 or row == rows - 1 for row in range(rows)])
    numbers = 100 + np.arange(rows)
    ds["q_error"] = ds.episodes.dims, np.broadcast_to(np.where(measured, numbers, np.nan), ds.episodes.shape)
    ds.attrs["exact_every"] = 7
    flat = Flat(ds)
    expected = [
        max((x for x, known in zip(numbers[: end + 1], measured, strict=False) if known), default=np.nan)
        for end in flat.ends
    ]
    assert 1 < rows / len(flat.ends) < 7 and len(flat.ends) <= POINTS
    np.testing.assert_array_equal(
        flat.sums(0)["q_error"], np.broadcast_to(expected, (flat.seeds, len(expected)))
    )
    (code,) = (one.code for one in measures_of(ds) if one.key == "q_error")
    names = {"ds": ds, "ends": flat.ends.tolist()}
    exec(code, names)
    np.testing.assert_array_equal(names["x"].isel(seed=0).values.reshape(-1, len(expected))[0], expected)


@pytest.mark.parametrize("wrong", [0, 2.5, True])
def test_what_is_no_number_of_rows_is_refused(wrong):
    with pytest.raises(rl.InputError, match="exact_every must be a whole number of at least 1"):
        rl.sweep(DOORS, "sarsa", num_seeds=1, num_steps=10, exact_every=wrong)


def test_an_experiment_keeps_it():
    """It decides what is computed, and makes `exact` true."""
    experiment = rl.Experiment("two-doors", "sarsa", steps=10, exact_every=3)
    assert experiment.exact and experiment.data()["exact_every"] == 3
    assert next(iter(experiment.parts().values())).budget.exact_every == 3
