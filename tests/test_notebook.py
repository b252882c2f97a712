"""What objects show of themselves in a line, and in a notebook: short, true, and as text that is no HTML."""

import dataclasses
import html
import re
from html.parser import HTMLParser

import jax
import numpy as np
import pytest
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import policies, schedules, stats
from jaxrl_tab.core import notebook
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment.files import Outcome
from jaxrl_tab.methods import ALGORITHMS, METHODS

EVIL = "<img src=x onerror='&'>"


class _Cells(HTMLParser):
    """The texts of the cells of a page, as a browser would show them; whatever else is in it is counted."""

    def __init__(self, page):
        super().__init__()
        self.rows, self.tags = [], set()
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data):
        if self.rows and self.rows[-1] and data.strip():
            self.rows[-1][-1] += data


def cells(shown):
    """The rows of the tables that an object shows in a notebook. There is nothing but tables in it."""
    parsed = _Cells(shown._repr_html_())
    assert parsed.tags == {"p", "table", "thead", "tbody", "tr", "td", "th"}
    return parsed.rows


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (rl.Sarsa(), "Sarsa()"),
        (rl.Sarsa(alpha=0.5, q0=0.0), "Sarsa(alpha=0.5)"),
        (
            rl.NStepSarsa(n=2, behaviour=policies.Softmax(0.5)),
            "NStepSarsa(behaviour=Softmax(temperature=0.5), n=2)",
        ),
        (rl.MonteCarlo(epsilon=schedules.glie()), "MonteCarlo(epsilon=Harmonic(n0=1.0, clock='episode'))"),
        (rl.MonteCarlo(alpha=schedules.sample_average()), "MonteCarlo()"),
        (rl.make("windy-gridworld"), "WindyGridworld()"),
        (
            rl.make("windy-gridworld", moves="king", wind=[1] * 10),
            f"WindyGridworld(wind={[1] * 10}, moves='king')",
        ),
        (rl.make("k-armed-testbed", arms=2, means=[0.0, 1.0]), "KArmedTestbed(arms=2, means=[0.0, 1.0])"),
        (rl.Sarsa(q0=np.ones((7, 4))), "Sarsa(q0=float64[7, 4])"),
        (rl.prediction.TD(v0=0.5), "TD(v0=0.5)"),
    ],
)
def test_a_method_or_an_environment_shows_what_is_not_as_usual(shown, expected):
    """Also after JAX has taken it apart. Broken once: arrays compared by identity -> fails."""
    assert repr(shown) == expected
    assert repr(jax.tree.map(lambda x: x, shown)) == expected


@pytest.mark.parametrize("name", [*METHODS, *ENVS])
def test_each_shows_all_its_parameters_in_a_notebook(name):
    shown = rl.make(name) if name in ENVS else METHODS[name]()
    assert re.fullmatch(r"\w+\(\)", repr(shown))
    head, *rows = cells(shown)
    assert head == ["parameter", "value", "what it is"]
    assert [row[0] for row in rows] == [f.name for f in dataclasses.fields(shown)]
    assert all(row[1] for row in rows)


def test_one_that_is_traced_is_shown_too():
    seen = []
    jax.jit(lambda method: seen.append(repr(method)) or method.alpha)(rl.Sarsa(alpha=0.5))
    assert seen[0].startswith("Sarsa(alpha=") and "epsilon" in seen[0]


def test_a_class_may_show_itself_otherwise():
    @pytree
    class Own(rl.Sarsa):
        def __repr__(self):
            return "mine"

    @pytree
    class Inherits(rl.Sarsa):
        haste: float = field(default=1.0)

    assert repr(Own(alpha=0.5)) == "mine"
    assert repr(Inherits(haste=2.0)) == "Inherits(haste=2.0)"


@pytree
class Evil(rl.WindyGridworld):
    """<img src=x onerror='&'>"""

    word: str = static(default=EVIL, help=EVIL)


Evil.__name__ = EVIL


@pytest.fixture(scope="module")
def outcome():
    experiment = rl.Experiment(
        "windy-gridworld",
        [{"name": "sarsa", "alpha": [0.25, 0.5]}, "q-learning"],
        seeds=5,
        steps=2000,
        select={},
    )
    return experiment, rl.run(experiment, None)


def test_names_and_values_inject_nothing(outcome):
    """Broken once: nothing escaped -> fails."""
    ((_, *rows),) = [cells(Evil())]
    word = next(row for row in rows if row[0] == "word")
    assert word == ["word", repr(EVIL), EVIL]
    result = rl.sweep(Evil(), "sarsa", {}, num_seeds=1, num_steps=2, progress=False)
    assert EVIL in html.unescape(result._repr_html_())
    cells(result)
    x = xr.DataArray(np.zeros((1, 3)), dims=("behaviour", "seed"), coords={"behaviour": [EVIL]})
    interval = stats.mean_interval(x)
    assert cells(interval)[1][0] == EVIL
    cells(stats.Selection({"behaviour": EVIL}, *[interval.__class__(*[part[0] for part in interval])] * 3))
    _, ran = outcome
    name = "windy-gridworld/sarsa"
    renamed = Outcome({f"{EVIL}/{EVIL}": ran.datasets[name]}, {}, {EVIL: ran.envs["windy-gridworld"]})
    assert cells(renamed)[1][0].startswith(EVIL[:5])
    assert notebook.table(EVIL, [EVIL], [[EVIL]]).count("<img") == 0


def test_a_sweep_in_a_notebook():
    grid = {"alpha": rl.LogUniform(0.1, 1.0), "epsilon": [0.1, 0.2]}
    result = rl.sweep(
        rl.make("two-doors"), "sarsa", grid, num_draws=2, num_seeds=3, num_episodes=2000, progress=False
    )
    rows = dict(cells(result)[1:])
    drawn = [trial["alpha"] for trial in result.grid["draw"]]
    assert rows["epsilon"] == "0.1, 0.2" and rows["gamma"] == "1.0"
    assert rows["alpha, drawn"] == f"{drawn[0]}, {drawn[1]}"
    assert (rows["seeds"], rows["each run"]) == ("3", "2,000 episodes")


def test_an_experiment_and_what_it_gave(outcome):
    """The outcome shows the numbers of the summary. Broken once: the first setting instead of the best -> fails."""
    experiment, ran = outcome
    words = "sarsa, q-learning in windy-gridworld; 5 seeds, 2000 steps"
    assert repr(experiment) == f"<Experiment: {words}>" and words in experiment._repr_html_()
    assert [row[:2] for row in cells(experiment)[1:]] == [
        ["environment", "windy-gridworld"],
        ["method", "sarsa"],
        ["method", "q-learning"],
    ]
    assert "alpha = [0.25, 0.5]" in cells(experiment)[2][2]
    assert repr(ran) == "<Outcome: windy-gridworld/sarsa, windy-gridworld/q-learning>"
    head, *rows = cells(ran)
    assert head[:2] == ["method", "setting"] and "5 fresh seeds" in head[3]
    best = ran.summary[ran.summary.best].sort_values("last_tenth_return", ascending=False)
    for row, expected in zip(rows, best.itertuples(), strict=True):
        assert row[0] == {"sarsa": "Sarsa", "q-learning": "Q-learning"}[expected.method]
        assert (
            row[2].split(" (")[0].replace("−", "-").replace("\xa0", "") == f"{expected.last_tenth_return:.0f}"
        )


def test_intervals_and_selections(outcome):
    """Broken once: bounds exchanged -> fails."""
    x = xr.DataArray([[0.0, 2.0, 4.0], [5.0, 5.0, 5.0]], dims=("alpha", "seed"), coords={"alpha": [0.1, 0.5]})
    interval = stats.mean_interval(x)
    assert repr(interval) == "<Interval of 2 alpha: estimates 2 to 5>"
    half = 4.302652729911275 * 2 / np.sqrt(3)  # t with 2 degrees of freedom
    assert cells(interval) == [
        ["alpha", "estimate", "low", "high", "n"],
        ["0.1", "2", f"{2 - half:.4g}", f"{2 + half:.4g}", "3"],
        ["0.5", "5", "5", "5", "3"],
    ]
    one = stats.mean_interval(x[0])
    assert repr(one) == f"<Interval 2 ({2 - half:.4g} to {2 + half:.4g}), n = 3>"
    long = stats.mean_interval(xr.DataArray(np.zeros((60, 3)), dims=("row", "seed")))
    assert len(cells(long)) == 51 and "the first 50 of 60 places" in long._repr_html_()
    nothing = stats.mean_interval(xr.DataArray(np.full((2, 3), np.nan), dims=("row", "seed")))
    assert repr(nothing) == "<Interval of 2 row: estimates none>"
    chosen = stats.Selection({"alpha": 0.5}, one, one, one)
    assert repr(chosen) == f"<Selection of alpha = 0.5: promised {one!r}, fresh {one!r}>"
    assert [row[0] for row in cells(chosen)] == ["", "promised", "fresh", "bias"]


def test_reprs_are_short():
    """Of a table with a thousand states as well."""
    s_next = np.zeros((1000, 2, 1000))
    s_next[..., 0] = 1
    for shown in (rl.FiniteMDP(s_next, np.zeros((1000, 2))), *(cls() for cls in ALGORITHMS.values())):
        assert len(repr(shown)) < 300
        assert len(shown._repr_html_()) < 10_000
