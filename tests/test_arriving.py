"""The share of seeds whose greedy policy arrives, in the table."""

import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import stats


def test_the_table_has_how_many_greedy_policies_arrive(windy):
    """Broken once: all greedy policies counted as arriving -> fails."""
    steps = {"num_seeds": 20, "num_steps": 8000, "log_every": 4000}
    ds = rl.sweep(windy, "sarsa", {"alpha": [0.5, 0.7]}, exact=True, **steps).to_xarray()
    share = np.isfinite(ds.isel(row=-1).greedy_value).mean("seed")
    own = stats.Methods.of({"sarsa": ds}).settings["sarsa"]
    np.testing.assert_allclose(own.numbers("greedy_arrives"), share)
    assert ((share > 0) & (share < 1)).all()
