"""The report: what it tells in words and tables, and that it needs nothing beside it."""

import dataclasses
import re
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from made_up import ALPHAS, make_result

import jaxrl_tab as rl
from jaxrl_tab import plot, report, stats
from jaxrl_tab.show import rows, words

ABOUT = {
    "experiment": 'seeds = 5\n[[environment]]\nname = "<windy>"\n',
    "command": "jaxrl-tab sweep windy.toml --out runs/windy",
    "root_seed": 7,
    "git_commit": None,
    "versions": {"jax": "0.10.2", "numpy": "2.4.6"},
    "machine": {"devices": ["cpu:0", "cpu:1"]},
}


class Page(HTMLParser):
    """What a page is made of.

    Attributes:
        links, ids: of the page; tags: all there are.
        tables: rows of cells, as text; text: all that can be read.
    """

    def __init__(self, html):
        super().__init__()
        self.links, self.ids, self.tags, self.tables = [], [], set(), []
        self.text = ""
        self.feed(html)
        self.text = " ".join(self.text.split())

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.add(tag)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found["href"]] if tag == "a" else []
        self.tables += [[]] if tag == "table" else []
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.cell = True
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.cell = False

    def handle_data(self, data):
        data = data.replace("\xa0", " ")
        self.text += " " + data
        if getattr(self, "cell", False):
            self.tables[-1][-1][-1] += data


@pytest.fixture(scope="module")
def windy_sets(windy):
    q = rl.planning.value_iteration(windy)[1]
    methods = {"sarsa": -17.0, "q-learning": -16.0}
    return {f"windy/{name}": make_result(windy, q, best=best).to_xarray() for name, best in methods.items()}


@pytest.fixture(scope="module")
def made(windy, windy_sets, tmp_path_factory):
    """The file of a report of two methods, one of them run again on fresh seeds."""
    chosen = windy_sets["windy/sarsa"].sel(alpha=0.9)
    fresh = {"windy/sarsa": chosen.assign(returns=chosen.returns * 1.01)}
    return report.write(tmp_path_factory.mktemp("report"), windy_sets, {"windy": windy}, ABOUT, fresh)


def read(file):
    return Page(file.read_text(encoding="utf-8"))


def numbers(text):
    """Those in a cell."""
    return [float(x.replace("−", "-")) for x in re.findall(r"−?[\d.]+", text)]


def number(text):
    (found,) = numbers(text)
    return found


def test_it_needs_nothing_beside_it(made):
    page = read(made)
    html = made.read_text(encoding="utf-8")
    assert [file.name for file in made.parent.iterdir()] == ["report.html"]
    namespace = '"http://www.w3.org/2000/svg"'  # a name, which nothing is loaded from
    assert not re.search(r"https?://|//cdn|@import|url\((?!#)", html.replace(namespace, ""))
    assert not page.tags & {"link", "iframe", "object", "img"}
    assert "default-src 'none'" in unescape(html)
    assert len(html) < 2e6
    assert len(page.ids) == len(set(page.ids))
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)


def test_the_table_of_methods_has_both_numbers_of_what_was_chosen(made, windy_sets):
    head, first, second = read(made).tables[0]
    assert head == [
        *("method", "setting", "mean return (95% interval), seeds of the choice"),
        *(
            "mean return (95% interval), 5 fresh seeds",
            "difference from the first",
            "p",
            "9 of 10 runs",
            "seeds",
        ),
        *("best ε-soft", "exact optimum"),
    ]
    assert [first[0], second[0]] == ["Q-learning", "Sarsa"]
    assert second[1] == "α = 0.9"
    scores = stats.score(windy_sets["windy/sarsa"]).sel(alpha=0.9)
    interval = [
        float(x) for x in stats.score_interval(windy_sets["windy/sarsa"])[:3] for x in [x.sel(alpha=0.9)]
    ]
    assert numbers(second[2]) == pytest.approx(interval, abs=0.006)
    assert numbers(second[3])[0] == pytest.approx(1.01 * interval[0], abs=0.006)
    assert first[3:6] == ["–", "–", "–"]  # was not run again, and is the first
    better = stats.score(windy_sets["windy/q-learning"]).sel(alpha=0.9)
    pairs = 3 * 3  # of their settings: chosen on the same seeds
    difference = stats.paired_difference(scores, better, confidence=1 - 0.05 / pairs, worst=-400)
    assert numbers(second[4]) == pytest.approx([float(x) for x in difference.interval[:3]], abs=0.006)
    assert numbers(second[5]) == pytest.approx([min(pairs * float(difference.p), 1)], abs=0.001)
    runs = stats.tolerance_interval(1.01 * scores)
    assert numbers(second[6]) == pytest.approx([float(runs.low), float(runs.high)], abs=0.006)
    assert second[-1] == "−15"


def test_all_settings_stand_with_the_best_first(made, windy_sets):
    head, *rows = read(made).tables[2]
    early = ["steps an episode, first tenth", "steps an episode, last tenth"]
    assert head[:6] == ["method", "α", "mean return", "95% interval", "episodes", early[0]]
    assert head[6:] == [early[1], "9 of 10 runs", "seeds"]
    table = stats.summary(windy_sets).sort_values("last_tenth_return", ascending=False)
    names = [words.title_of(name.removeprefix("windy/")) for name in table.method]
    assert [row[0].rstrip(" ★≈") for row in rows] == names
    assert [number(row[2]) for row in rows] == pytest.approx([*table.last_tenth_return], abs=0.006)
    assert [row[1] for row in rows if row[0].endswith("★")] == ["0.9", "0.9"]


def test_it_says_how_it_was_made_and_escapes_it(made):
    page = read(made)
    assert 'name = "<windy>"' in page.text
    assert "<windy>" not in made.read_text(encoding="utf-8")
    for said in ("root seed 7", "git commit –", "jax 0.10.2", "cpu:1", ABOUT["command"]):
        assert said in page.text
    assert "Unfinished" not in page.text  # explains only what is there
    assert "on fresh seeds does not: quote that" in page.text


def test_what_it_says_first_is_the_best_method(made):
    """Not all methods were run on fresh seeds, so none is judged by them."""
    assert re.search(
        r"windy : best: Q-learning, α = 0.9, with a mean return of −1\d\.\d+; the exact optimum",
        read(made).text,
    )


def test_many_settings_are_folded_away(windy, windy_sets, tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "AT_MOST", 50)
    sarsa = windy_sets["windy/sarsa"]
    epsilons = np.linspace(0, 1, 21)
    many = sarsa.expand_dims(epsilon=epsilons).assign_attrs(fixed='{"gamma": 1.0}')
    many["returns"] = many.returns * (1 + many.epsilon)
    file = report.write(tmp_path, {"windy/sarsa": many}, {"windy": windy}, {})
    page = read(file)
    assert [len(table) - 1 for table in page.tables[2:4]] == [12, 38]
    assert "38 more settings, of 51; all are in summary.csv" in page.text
    assert page.tables[2][1][:3] == ["Sarsa ★", "0", "0.9"]


def test_diverged_runs_are_counted_and_score_as_the_worst(windy, windy_sets, tmp_path):
    """Broken once: the infinite returns in the mean -> fails."""
    broken = windy_sets["windy/sarsa"].copy(deep=True)
    broken["q"][2, 0] = np.nan
    broken["returns"][2, 0] = -np.inf
    broken["q"][1] = np.inf
    broken["diverged"][2, 0] = broken["diverged"][1] = True
    page = read(report.write(tmp_path, {"windy/sarsa": broken}, {"windy": windy}, {}))
    assert "6 runs diverged" in page.text
    assert "Sarsa, α = 0.9: 1 of 5" in page.text
    assert "Sarsa, α = 0.2: 5 of 5" in page.text
    head, *rows = page.tables[2]
    by_alpha = {row[1]: row for row in rows}
    at = head.index("diverged")
    assert {alpha: row[at] for alpha, row in by_alpha.items()} == {"0.05": "0", "0.2": "5", "0.9": "1"}
    finite = stats.score(windy_sets["windy/sarsa"]).sel(alpha=[0.05, 0.9])
    sound = finite.sel(alpha=0.9).isel(seed=slice(1, None))
    assert number(by_alpha["0.9"][2]) == pytest.approx(float(sound.sum() + finite.min()) / 5, abs=0.6)
    assert number(by_alpha["0.2"][2]) == pytest.approx(float(finite.min()), abs=0.6)
    assert [row[1] for row in rows] == ["0.05", "0.9", "0.2"]  # the best first: where the fewest diverge


def test_it_says_what_a_mean_rests_on(windy, windy_sets, tmp_path):
    """One run of the best setting is unfinished and stands still: -400 in its last two rows."""
    ds = windy_sets["windy/sarsa"].isel(alpha=[0, 2]).copy(deep=True)
    ds["episodes"][1, 0, -2:] = 0
    ds["returns"][1, 0, -2:] = 0
    page = read(report.write(tmp_path, {"windy/sarsa": ds}, {"windy": windy}, {}))
    head, row = page.tables[0]
    assert row[head.index("unfinished")] == "1"
    others = stats.score(ds).sel(alpha=0.9)[1:]
    assert numbers(row[2])[0] == pytest.approx((float(others.sum()) - 400) / 5, abs=0.6)
    assert row[2].endswith(" !")
    for said in (
        "! The mean of Sarsa, α = 0.9 rests on few bad runs and may be worse than it looks: 5 seeds were run, and 125",
        "The middle of the runs is sure: median −1",
        "1 of 5 runs of Sarsa, α = 0.9 finished no episode in the last tenth",
        "The best α of Sarsa is the largest that was tried",
        "up to 60% of all runs may be stuck",
        "the difference seed by seed decides",
    ):
        assert said in page.text
    assert "nobody knows" not in page.text


def test_draws_are_known_by_what_was_drawn(windy, windy_sets, tmp_path):
    ds = windy_sets["windy/sarsa"].rename(alpha="draw").drop_vars("draw")
    ds = ds.assign_coords(draw=[0, 1, 2], alpha=("draw", [*ALPHAS]), q0=("draw", [0.0, -1.0, -2.0]))
    file = report.write(tmp_path, {"windy/sarsa": ds}, {"windy": windy}, {})
    page = read(file)
    assert page.tables[0][1][:2] == ["Sarsa", "α = 0.9, q0 = −2"]
    assert [row[:3] for row in page.tables[2]] == [
        ["method", "α", "q0"],
        ["Sarsa ★", "0.9", "−2"],
        ["Sarsa ≈", "0.2", "−1"],  # five seeds tell nothing apart
        ["Sarsa ≈", "0.05", "0"],
    ]
    assert {"alpha", "q0"} <= set(stats.summary({"sarsa": ds}).columns)


def test_sensitivity_to_what_was_drawn_is_a_point_for_each_draw(windy_sets):
    ds = windy_sets["windy/sarsa"].rename(alpha="draw").drop_vars("draw")
    ds = ds.assign_coords(draw=[0, 1, 2], alpha=("draw", [*ALPHAS]), q0=("draw", [0.0, -1.0, -2.0]))
    ax = plot.canvas(4, 3).subplots()
    plot.sensitivity(ax, {"sarsa": ds}, "q0")
    line = next(line for line in ax.get_lines() if line.get_label() == "Sarsa")
    np.testing.assert_array_equal(line.get_xdata(), [0, -1, -2])
    np.testing.assert_allclose(line.get_ydata(), stats.score(ds).mean("seed"))
    assert line.get_linestyle() == "None"


def test_prediction_and_an_environment_without_exact_values(windy_sets, tmp_path):
    """Two chapters, each with its own words."""
    control = windy_sets["windy/sarsa"].assign_attrs(optimal_value=np.nan, environment="sampled")
    error = np.random.default_rng(1).uniform(0.1, 0.2, (3, 5, 20))
    predicted = control.drop_vars("q").assign(
        v_error=(("alpha", "seed", "row"), error),
        q=(("alpha", "seed", "state", "action"), np.zeros((3, 5, 21, 1))),
    )
    predicted = predicted.assign_attrs(environment="random-walk", optimal_value=0.0, learns="states")

    @dataclasses.dataclass(frozen=True)
    class Sampled:
        """Nobody knows how it works."""

        num_states, num_actions, max_steps = 70, 4, 100

        def reset(self, key): ...
        def step(self, key, s, a): ...

    envs = {"sampled": Sampled(), "walk": rl.RandomWalk()}
    page = read(report.write(tmp_path, {"sampled/sarsa": control, "walk/td": predicted}, envs, {}))
    assert "Nobody knows how it works." in page.text
    assert page.tables[0][0][-1] == "exact optimum"
    assert page.tables[0][1][-1] == "–"
    ends = ["error at the end", "exact value"]
    assert page.tables[3][0][2:] == ["mean error (95% interval)", "9 of 10 runs", "seeds", *ends]
    best = float(stats.mean_interval(stats.score(predicted))[0].min())
    assert numbers(page.tables[3][1][2])[0] == pytest.approx(best, abs=6e-4)
    means = [number(row[2]) for row in page.tables[5][1:]]
    assert means == sorted(means)  # of errors the lowest is the best
    assert "The lower the better." in page.text


def test_what_cannot_be_told_is_refused(windy, windy_sets, tmp_path):
    with pytest.raises(rl.InputError, match="at least one dataset"):
        report.write(tmp_path, {}, {}, {})
    with pytest.raises(rl.InputError, match="no environment 'windy'; there are cliff"):
        report.write(tmp_path, windy_sets, {"cliff": windy}, {})
    with pytest.raises(rl.InputError, match="must be one setting, but windy/sarsa is a sweep"):
        report.write(tmp_path, windy_sets, {"windy": windy}, {}, windy_sets)
    assert not [*tmp_path.iterdir()]
