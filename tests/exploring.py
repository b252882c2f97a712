"""An experiment with its report, to look around in: made once, without its pictures, which take a while."""

import pytest

import jaxrl_tab as rl
from jaxrl_tab.experiment.again import RunAgain, toml_of_settings
from jaxrl_tab.show import report


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
