"""An experiment with its report, to look around in: made once, without its pictures, which take a while."""

import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab.experiment.again import RunAgain, toml_of_settings
from jaxrl_tab.show import report
from jaxrl_tab.show.explorer import packing


@pytest.fixture(scope="session")
def explored(tmp_path_factory):
    """The report, and what the experiment gave: two methods, one with two hyperparameters; 100 rows of 20 steps."""
    sarsa = {"name": "sarsa", "alpha": [0.3, 1.0], "epsilon": [0.1, 0.4]}
    other = {"name": "q-learning", "alpha": [0.3, 0.6, 1.0]}
    experiment = rl.Experiment("windy-gridworld", [sarsa, other], seeds=8, steps=2000, log_every=20)
    outcome = rl.run(experiment, progress=False)
    parts, toml = experiment.parts(), toml_of_settings(experiment)
    folder = tmp_path_factory.mktemp("explored")
    return report.write_methods(folder, outcome.methods, {}, {}, RunAgain(parts), toml), outcome


def decoded(page, method, setting):
    """Q at all moments, [views, moments, S, A], from the page, and its views."""
    data, found = page
    about = data["methods"][method]["tables"][str(setting)]
    views = (["mean", "median"] if about["averaged"] else []) + data["methods"][method]["ranks"]
    raw = packing.from_text(found[f"data-1-tables-{method}-{setting}"])
    shape = (len(views), about["moments"], len(data["scene"]["states"]), about["actions"])
    size = 2 * int(np.prod(shape))
    steps = packing.Steps(about["low"], about["step"], about["decimals"])
    return packing.decoded(packing.unpacked_codes(raw[:size], shape), steps), views, about
