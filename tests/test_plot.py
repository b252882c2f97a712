"""The pictures: the data that they show, read back from the axes; and the files."""

import dataclasses
import re

import numpy as np
import pytest
import xarray as xr
from made_up import ALPHAS, make_result
from matplotlib.cbook import is_math_text
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from matplotlib.text import Text

import jaxrl_tab as rl
from jaxrl_tab import plot, stats
from jaxrl_tab.core.declared import Learns
from jaxrl_tab.methods import PREDICTION
from jaxrl_tab.show import words
from jaxrl_tab.stats.columns import Methods


@pytest.fixture(scope="module")
def solved(windy):
    return rl.planning.value_iteration(windy)


@pytest.fixture(scope="module")
def datasets(windy, solved):
    sarsa = make_result(windy, solved[1])
    return {"sarsa": sarsa.to_xarray(), "q-learning": make_result(windy, solved[1], best=-16.0).to_xarray()}


@pytest.fixture
def ax():
    return Figure().subplots()


@pytest.fixture
def unwritten(monkeypatch, tmp_path):
    """A folder to save pictures in, which takes no time, for none is rendered."""
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    return tmp_path


def texts(ax):
    return [text.get_text() for text in ax.texts]


def named(ax):
    """What the legend says."""
    return [text.get_text() for text in ax.get_legend().texts]


# --- curves ------------------------------------------------------------------------------------------


def test_a_mean_curve_is_the_mean_with_its_interval(ax):
    values = xr.DataArray([[1.0, 4.0], [3.0, 4.0]], dims=("seed", "row"))
    plot.mean_curve(ax, [10, 20], values, "sarsa", plot.COLORS[1])
    (line,) = ax.get_lines()
    assert line.get_label() == "sarsa"
    np.testing.assert_array_equal(line.get_xydata(), [[10, 2], [20, 4]])
    band = ax.collections[0].get_paths()[0].vertices
    half = 12.7062047  # Student's t with one degree of freedom, times a standard error of 1
    assert {*np.round(band[band[:, 0] == 10, 1], 4)} == {*np.round([2 - half, 2 + half], 4)}
    assert {*band[band[:, 0] == 20, 1]} == {4.0}


def test_episodes_against_steps(ax, datasets):
    plot.episodes_against_steps(ax, datasets, alpha=0.2)
    lines = ax.get_lines()
    assert [line.get_label() for line in lines] == ["Sarsa, α = 0.2", "Q-learning, α = 0.2"]
    episodes = datasets["sarsa"].episodes.sel(alpha=0.2).cumsum("row")
    np.testing.assert_array_equal(lines[0].get_xdata(), 200 * np.arange(21))
    np.testing.assert_allclose(lines[0].get_ydata(), [0, *episodes.mean("seed").values])
    band = ax.collections[0].get_paths()[0].vertices
    interval = stats.mean_interval(episodes)
    for bound in (interval.low, interval.high):
        assert np.isclose(band, [4000, float(bound[-1])]).all(1).any()


def test_episodes_against_steps_where_episodes_were_the_budget(ax, windy, solved):
    """Then the steps are random: x is their mean, and the band is horizontal."""
    budget = {"num_steps": None, "num_episodes": 20, "log_every": 1}
    ds = make_result(windy, solved[1], budget=budget).to_xarray()
    plot.episodes_against_steps(ax, {"sarsa": ds})
    (line,) = ax.get_lines()
    steps = ds.steps.sel(stats.best(ds)).cumsum("row")
    np.testing.assert_allclose(line.get_xdata(), [0, *steps.mean("seed").values])
    np.testing.assert_array_equal(line.get_ydata(), np.arange(21))
    band = ax.collections[0].get_paths()[0].vertices
    assert np.isclose(band, [float(stats.mean_interval(steps).high[-1]), 20]).all(1).any()


def test_learning_curves(ax, datasets):
    plot.learning_curves(ax, datasets)
    sarsa, _, optimum = ax.get_lines()
    assert sarsa.get_label() == "Sarsa, α = 0.9"
    ds = datasets["sarsa"].sel(alpha=0.9)
    interval = stats.mean_interval(stats.learning_curve(ds))
    enough = interval.n.values == 5
    assert enough.any()
    assert not enough.all()
    np.testing.assert_array_equal(np.isfinite(sarsa.get_ydata()), enough)
    np.testing.assert_allclose(sarsa.get_ydata()[enough], interval.estimate.values[enough])
    np.testing.assert_array_equal(sarsa.get_xdata(), 200 * np.arange(1, 21))
    assert set(optimum.get_ydata()) == {-15}
    assert "exact optimum −15" in named(ax)
    low, high = ax.get_ylim()
    assert low < interval.low.values[enough].min() < -15 < high < 0


def test_learning_curves_against_episodes(ax, windy, solved):
    budget = {"num_steps": None, "num_episodes": 100, "log_every": 1}
    plot.learning_curves(ax, {"sarsa": make_result(windy, solved[1], rows=100, budget=budget).to_xarray()})
    assert ax.get_xlabel() == "episodes"
    np.testing.assert_array_equal(ax.get_lines()[0].get_xdata(), [*range(3, 100, 3), 100])


def test_learning_curves_merge_rows_until_most_seeds_are_in_each(ax, datasets):
    """Every other row empty: ten points of two rows each leave no gap."""
    ds = datasets["sarsa"].copy(deep=True)
    ds["episodes"][..., ::2] = 0
    ds["returns"][..., ::2] = 0
    plot.learning_curves(ax, {"sarsa": ds})
    line = ax.get_lines()[0]
    np.testing.assert_array_equal(line.get_xdata(), 400 * np.arange(1, 11))
    assert np.isfinite(line.get_ydata()[5:]).all()


def test_learning_curves_of_runs_that_finish_nothing(ax, datasets):
    ds = datasets["sarsa"]
    plot.learning_curves(ax, {"sarsa": ds.assign(episodes=ds.episodes * 0, returns=ds.returns * 0)})
    assert "too few episodes for a curve" in texts(ax)


def test_sensitivity(ax, datasets):
    plot.sensitivity(ax, datasets)
    table = stats.summary(datasets).query("method == 'q-learning'")
    line = next(line for line in ax.get_lines() if line.get_label() == "Q-learning")
    np.testing.assert_array_equal(line.get_xdata(), ALPHAS)
    np.testing.assert_allclose(line.get_ydata(), table.last_tenth_return)
    bars = ax.containers[1].lines[2][0].get_segments()
    bounds = table[["last_tenth_low", "last_tenth_high"]].to_numpy()
    np.testing.assert_allclose([bar[:, 1] for bar in bars], bounds)
    assert ax.get_xscale() == "log"  # 0.05 to 0.9
    assert "exact optimum −15" in named(ax)


def test_what_explores_has_its_own_optimum(datasets, windy):
    """-17.0483, see GROUND_TRUTH.md: dotted, beside the optimum."""
    _, curves, alphas, _ = plot.overview(datasets, windy).axes
    for ax in (curves, alphas):
        (dotted,) = [line for line in ax.get_lines() if line.get_linestyle() == ":"]
        assert dotted.get_ydata()[0] == pytest.approx(-17.0483, abs=1e-4)
        assert "best ε-soft −17.05" in named(ax)


def test_sensitivity_marks_settings_that_lose_seeds(ax, datasets):
    ds = datasets["sarsa"].copy(deep=True)
    ds["episodes"][1, 0, -2:] = 0
    plot.sensitivity(ax, {"sarsa": ds.isel(alpha=[1, 2])})
    hollow = [line for line in ax.get_lines() if line.get_color() == "white"]
    assert [x for line in hollow for x in line.get_xdata()] == [0.2]
    assert "hollow: some runs unfinished" in [text.get_text() for text in ax.get_legend().texts]
    assert ax.get_xscale() == "linear"


def test_sensitivity_marks_nothing_unfinished_in_a_task_that_does_not_end(ax, datasets):
    """Broken once, each: it asks no environment; with `color_by` it has none -> fails."""
    ds = datasets["sarsa"].isel(alpha=[0, 1]).assign(episodes=lambda ds: ds.episodes * 0)
    two = xr.concat([ds, ds], xr.Variable("epsilon", [0.1, 0.2]))
    for swept, more in ((ds, {}), (two, {"color_by": "epsilon"})):
        for env, marked in ((rl.make("windy-gridworld"), True), (rl.make("river-swim"), False)):
            ax.clear()
            plot.sensitivity(ax, Methods.of({"sarsa": swept}, env), **more)
            assert ("hollow: some runs unfinished" in ax.get_legend_handles_labels()[1]) == marked


def test_sensitivity_shows_a_method_that_kept_the_parameter(ax, datasets):
    kept = datasets["q-learning"].isel(alpha=1, drop=True).assign_attrs(fixed='{"alpha": 0.3}')
    plot.sensitivity(ax, {"sarsa": datasets["sarsa"], "kept": kept})
    line = next(line for line in ax.get_lines() if line.get_label() == "kept")
    assert line.get_xdata() == [0.3]


def test_sensitivity_puts_schedules_and_numbers_side_by_side(ax, datasets):
    """In the order in which they come, without a line, for nothing lies between them."""
    ds = datasets["sarsa"].assign_coords(alpha=["0.5", "sample-average", "power:0.8:1:visit"])
    kept = datasets["q-learning"].isel(alpha=1, drop=True).assign_attrs(fixed='{"alpha": 0.5}')
    plot.sensitivity(ax, {"sarsa": ds, "kept": kept})
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert [tick.get_text() for tick in ax.get_xticklabels()] == [
        "0.5",
        "sample-average",
        "power:0.8:1:visit",
    ]
    np.testing.assert_array_equal(lines["Sarsa"].get_xdata(), [0, 1, 2])
    np.testing.assert_array_equal(lines["kept"].get_xdata(), [0])
    assert lines["Sarsa"].get_linestyle() == "None"


def test_curves_need_what_was_swept(ax, datasets):
    with pytest.raises(rl.InputError, match="no method swept 'epsilon'"):
        plot.learning_curves(ax, datasets, epsilon=0.1)
    with pytest.raises(rl.InputError, match="no method swept 'epsilon'"):
        plot.sensitivity(ax, datasets, "epsilon")
    with pytest.raises(rl.InputError, match=r"alpha was not swept at 0\.3"):
        plot.episodes_against_steps(ax, datasets, alpha=0.3)


# --- labels ------------------------------------------------------------------------------------------


STRANGE = ("x$\\foo$", "_x", "50% & <b>", "a\\$b", "日本 🎲", "a" * 300)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("label", STRANGE)
def test_every_label_is_shown_as_it_is(label, datasets, windy, tmp_path):
    """None is taken for a formula, left out, or warned of.

    Broken once: without `literal` -> fails for the first two; without `_Canvas` for the fifth, without `_short` for the
    last.
    """
    swept = {label: datasets["sarsa"], "other": datasets["q-learning"]}
    figure = plot.overview(swept, windy)
    plot.save(figure, tmp_path / "overview.png")
    shown = figure.axes[0].get_legend().texts[0].get_text().removeprefix("\u200b")
    assert not is_math_text(shown)
    shown = shown.replace("\\$", "$").replace("\n", "")
    assert shown == f"{label}, α = 0.9" if len(label) < 60 else shown.startswith("aaa")
    assert len(shown) < 80


def test_texts_of_an_environment_and_of_hyperparameters_are_shown_as_they_are(
    datasets, tmp_path, monkeypatch
):
    """The names of actions, of states, and of schedules and policies."""
    env = a_ring(3, 12)
    monkeypatch.setattr(type(env), "action_names", tuple(f"$\\frac_{a}$" for a in range(12)))
    figure = plot.canvas(5, 4)
    one, other = figure.subplots(1, 2)
    plot.action_values(one, env, rl.planning.value_iteration(env)[1])
    alphas = {"alpha": ["$\\foo$", "_", "1"]}
    plot.sensitivity(other, {"sarsa": datasets["sarsa"].assign_coords(alphas)})
    plot.save(figure, tmp_path / "strange.svg")


def test_a_legend_says_which_curve_is_not_to_be_seen(ax):
    for y, name in (([1, 2], "here"), ([np.nan, np.nan], "nowhere"), ([8, 9], "above")):
        ax.plot([0, 1], y, label=name)
    ax.set_ylim(0, 3)
    plot.legend(ax)
    assert [text.get_text() for text in ax.get_legend().texts] == [
        "here",
        "nowhere (no value)",
        "above (off the scale)",
    ]


def test_fifty_methods_look_different(ax, datasets):
    plot.episodes_against_steps(ax, {f"method {i}": datasets["sarsa"] for i in range(50)})
    assert len({look(line) for line in ax.get_lines()}) == 50


def test_names_are_as_people_write_them():
    for name in [*rl.ENVS, *rl.ALGORITHMS, *PREDICTION]:
        title = words.title_of(name)
        assert title[0].isupper() or title[:2] in ("n-", "k-")
        assert "_" not in title
        # Broken once: each part of a name in lower case -> fails.
        assert not re.search("q learning|sarsa|lambda|monte carlo|td\\b", title), title
    titles = {
        "true-online-sarsa-lambda": "True online Sarsa(λ)",
        "n-step-expected-sarsa": "n-step Expected Sarsa",
    }
    for name, title in titles.items():
        assert words.title_of(name) == title
    assert words.title_of("windy-gridworld,moves=king") == "Windy gridworld,moves=king"
    assert words.title_of("my-own") == "my-own"


# --- prediction --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def predicted(windy, solved):
    """As a method of prediction on the random walk leaves it: the larger alpha is the better one."""
    result = make_result(windy, solved[1])
    errors = np.random.default_rng(1).uniform(0.9, 1.1, result.log.steps.shape)
    errors *= np.array([0.8, 0.4, 0.2])[:, None, None] / (1 + np.arange(20))
    v = np.random.default_rng(2).normal(size=(3, 5, 21, 1))
    return dataclasses.replace(
        result,
        algorithm="td",
        environment="random-walk",
        log=result.log._replace(v_error=errors),
        q=v,
        optimal_value=np.array(0.0),
        learns=Learns.STATES,
    ).to_xarray()


def test_the_learning_curve_of_prediction_is_its_error(ax, predicted):
    plot.learning_curves(ax, {"td": predicted})
    (line,) = ax.get_lines()
    assert line.get_label() == "TD(0), α = 0.9"
    np.testing.assert_allclose(line.get_ydata(), predicted.v_error.sel(alpha=0.9).mean("seed"))
    np.testing.assert_array_equal(line.get_xdata(), 200 * np.arange(1, 21))
    assert texts(ax) == []  # there is no optimum to reach


def test_the_sensitivity_of_prediction_is_the_error_of_the_whole_run(ax, predicted):
    ds = predicted.copy(deep=True)
    ds["v_error"][0] = 1e6  # diverged, and leaves the picture
    plot.sensitivity(ax, {"td": ds})
    line = ax.get_lines()[-2]
    np.testing.assert_allclose(line.get_ydata(), ds.v_error.mean(("row", "seed")))
    assert ax.get_ylim()[0] == 0
    assert line.get_ydata()[1] < ax.get_ylim()[1] < 1
    assert stats.best(ds) == {"alpha": 0.9}


def test_learned_values_are_beside_those_of_the_policy(ax, predicted):
    plot.state_values(ax, {"td": predicted}, rl.RandomWalk())
    learned, exact = ax.get_lines()
    np.testing.assert_array_equal(learned.get_xdata(), np.arange(1, 20))
    np.testing.assert_allclose(learned.get_ydata(), predicted.q.sel(alpha=0.9)[:, 1:20, 0].mean("seed"))
    np.testing.assert_allclose(exact.get_ydata(), np.arange(-9, 10) / 10, atol=1e-9)
    assert learned.get_marker() == "o"
    ax.clear()
    of_states = (*predicted.q.dims[:2], "state", "action")
    many = predicted.drop_vars("q").assign(q=(of_states, np.zeros((3, 5, 101, 1))))
    plot.state_values(ax, {"td": many}, rl.RandomWalk(states=99))
    learned, exact = ax.get_lines()
    assert learned.get_marker() == "none"  # they would be one broad band
    assert exact.get_zorder() > learned.get_zorder()


def test_of_prediction_there_is_no_path_and_on_a_grid_there_are_tables(predicted, windy, unwritten):
    names = [file.stem for file in plot.save_all({"td": predicted}, rl.RandomWalk(), unwritten)]
    assert names == ["learning_curves", "sensitivity", "values", "overview"]
    grid = predicted.drop_vars("q").assign(q=(("alpha", "seed", "state", "action"), np.ones((3, 5, 70, 1))))
    names = [file.stem for file in plot.save_all({"td": grid}, windy, unwritten)]
    assert names == ["learning_curves", "sensitivity", "values", "overview"]


# --- tables of states --------------------------------------------------------------------------------


def test_panels_show_values_and_actions_where_people_see_the_states():
    """Broken once: the rows of `states` upside down -> fails."""
    env = rl.make("blackjack", rules="natural")
    policy, v, _ = rl.planning.policy_iteration(env)
    _, ((usable, hard, natural),) = plot.panels_canvas(env, 1)
    plot.panels([usable, hard, natural], env, v, policy > 0, "exact")
    assert usable.get_title(loc="left") == "exact\nusable ace"
    assert [tick.get_text() for tick in hard.get_yticklabels()] == [str(n) for n in range(21, 11, -1)]
    assert [tick.get_text() for tick in hard.get_xticklabels()] == ["A", *map(str, range(2, 11))]
    shown = hard.images[0].get_array()
    assert shown[0, 0] == v[env.state(21, 1)]
    assert shown[9, 3] == v[env.state(12, 4)]
    assert natural.images[0].get_array()[0, 9] == v[env.state(21, 10, usable=True, natural=True)]
    assert hard.images[0].get_clim() == usable.images[0].get_clim() == natural.images[0].get_clim()
    at = {text.get_position(): text.get_text() for text in hard.texts}
    assert at[0, 5] == f"−{abs(v[env.state(16, 1)]):.2f}\nhit".replace("0.", ".")
    assert at[2, 5].endswith("stick")


def test_panels_that_do_not_fit_side_by_side_lie_in_lines():
    """Broken once: what is spare left in -> fails."""
    drawn, grid = plot.panels_canvas(rl.make("blackjack", rules="natural"), 2)
    assert grid.shape == (2, 3) and len(drawn.axes) == 6
    lines = [[ax.get_subplotspec().rowspan.start for ax in row] for row in grid]
    assert lines == [[0, 0, 1], [2, 2, 3]]


@pytest.mark.slow
def test_of_card_games_what_was_learned_stands_above_what_is_exact(unwritten):
    env = rl.make("easy21")
    q = rl.planning.value_iteration(env)[1]
    result = dataclasses.replace(make_result(env, q), environment="easy21", optimal_value=np.array(0.0631))
    datasets = {"monte-carlo": result.to_xarray()}
    names = [file.stem for file in plot.save_all(datasets, env, unwritten)]
    assert names == ["episodes", "learning_curves", "sensitivity", "values", "overview"]


def test_values_of_actions_are_marks(ax):
    """In one state the actions lie side by side."""
    env = rl.make("two-doors")
    plot.action_values(ax, env, rl.planning.value_iteration(env)[1])
    (line,) = ax.get_lines()
    assert line.get_xydata().tolist() == [[0, 3], [1, 2]]
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["left", "right"]


def a_ring(num_states, num_actions):
    """States in a ring and one terminal one: action a pays a, and ends."""
    P = np.zeros((num_states + 1, num_actions, num_states + 1))
    P[:, :, -1] = 1
    R = np.tile(np.arange(num_actions, dtype=float), (num_states + 1, 1))
    R[-1] = 0
    return rl.FiniteMDP(P, R)


def look(line):
    return line.get_color(), line.get_marker(), line.get_linestyle()


def test_no_two_actions_have_the_same_mark(ax):
    """Broken once: `_styles` as pairs of seven -> fails."""
    env = a_ring(12, 10)
    plot.action_values(ax, env, rl.planning.value_iteration(env)[1])
    assert len(ax.get_lines()) == 10
    assert len({look(line) for line in ax.get_lines()}) == 10
    assert len(ax.get_legend().texts) == 10


def test_of_too_many_marks_two_are_left(ax):
    env = a_ring(40, 30)
    plot.action_values(ax, env, rl.planning.value_iteration(env)[1])
    assert [text.get_text() for text in ax.get_legend().texts] == ["any action", "the best action"]
    *others, best = ax.get_lines()
    assert len(others) == 30
    assert best.get_ydata().tolist() == [29] * 40 + [0]


# --- grids -------------------------------------------------------------------------------------------


def cells(ax):
    """The cells (row, column) of the path that was drawn."""
    return list(zip(*(np.asarray(x).tolist() for x in reversed(ax.get_lines()[0].get_data())), strict=True))


def test_greedy_path_of_the_optimum(ax, windy, solved):
    """The one optimal path of the book: fifteen steps, round the goal and back with the wind."""
    plot.greedy_path(ax, windy, solved[1], "exact", optimum=-15.0)
    path = cells(ax)
    assert len(path) == 16
    assert path[:5] == [(3, 0), (3, 1), (3, 2), (3, 3), (2, 4)]
    assert path[-3:] == [(4, 9), (4, 8), (3, 7)]
    assert ax.get_title() == "exact\n15 steps to the goal; optimum v* = −15"
    assert [text for text in texts(ax) if len(text) == 1] == [*"0001112210", "S", "G"]


def test_greedy_path_that_never_ends(ax, windy):
    """Always left: the walker stays in the corner it starts in."""
    q = np.zeros((70, 4))
    q[:, 3] = 1
    plot.greedy_path(ax, windy, q, "left")
    assert cells(ax) == [(3, 0), (3, 0)]
    assert ax.get_title() == "left\ngoes round for ever"


def test_ties_lead_to_the_goal_if_any_of_them_does(ax, windy, solved):
    """The greedy policy splits ties, so a tie with a useless first action does not go round for ever."""
    v, q = solved
    tied = q.copy()
    tied[:, 0] = v  # up is now among the maximal actions everywhere
    plot.greedy_path(ax, windy, tied)
    assert "15 steps to the goal" in ax.get_title()


def test_greedy_path_takes_the_middle_one_of_equally_likely_gusts(ax, windy, solved):
    env = dataclasses.replace(windy, stochastic=True)
    plot.greedy_path(ax, env, solved[1])
    other = Figure().subplots()
    plot.greedy_path(other, windy, solved[1])
    assert cells(ax) == cells(other)
    assert "likeliest outcomes: 15 steps to the goal" in ax.get_title()


def test_diverged_values_have_a_picture(ax, windy):
    plot.greedy_path(ax, windy, np.full((70, 4), np.nan))


def test_values(ax, windy, solved):
    v, q = solved
    plot.values(ax, windy, v, q)
    (image,) = ax.images
    shown = ~image.get_array().mask
    assert shown.sum() == 62  # the wind keeps everyone out of seven cells, and at the goal nothing is done
    assert not shown[6, 4:8].any()
    np.testing.assert_allclose(image.get_array()[shown], v.reshape(7, 10)[shown])
    assert "−15" in texts(ax)
    (arrows,) = (x for x in ax.collections if isinstance(x, Quiver))
    places = list(zip(arrows.X.tolist(), (arrows.Y + 0.12).round(9).tolist(), strict=True))
    assert len(set(places)) == 62  # all of them but the goal
    at = [place == (9, 5) for place in places]  # where up and left are equally good
    assert sorted(zip(np.sign(arrows.U[at]), np.sign(arrows.V[at]), strict=True)) == [(-1, 0), (0, -1)]


def test_cliff_is_hatched(ax):
    env = rl.CliffWalking()
    plot.values(ax, env, *rl.planning.value_iteration(env))
    mask = ax.images[0].get_array().mask
    assert mask[3, 1:12].all()  # the cliff and the goal
    assert mask.sum() == 11


# --- files -------------------------------------------------------------------------------------------


def test_save_all(datasets, windy, tmp_path):
    files = plot.save_all(datasets, windy, tmp_path / "new")
    names = ["episodes", "learning_curves", "sensitivity", "greedy_path", "overview"]
    assert files == [tmp_path / "new" / f"{name}.png" for name in names]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files)


def test_pictures_for_a_paper_are_the_same_bytes_each_time(datasets, windy, tmp_path):
    """Broken once: the date left in -> fails in the next second."""
    for kind, start in (("pdf", b"%PDF"), ("svg", b"<?xml")):
        figure = plot.pictures(datasets, windy)["sensitivity"]
        first, again = (tmp_path / f"{name}.{kind}" for name in ("first", "again"))
        plot.save(figure, first)
        plot.save(figure, again)
        assert first.read_bytes() == again.read_bytes()
        assert first.read_bytes().startswith(start)
        assert not re.search(rb"<dc:date>|CreationDate", first.read_bytes())


def test_type_can_be_read_in_a_column(datasets, windy):
    """No figure is wider than a column, and no type smaller than 8 points but in the cells of tables."""
    figures = {**plot.pictures(datasets, windy), "overview": plot.overview(datasets, windy)}
    for name, figure in figures.items():
        assert figure.get_figwidth() <= plot.WIDTH
        figure.draw_without_rendering()
        sizes = {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()}
        assert min(sizes) >= plot.SMALL, name


def test_overview_shows_the_path_of_the_best_method(datasets, windy):
    figure = plot.overview(datasets, windy)
    title = figure.axes[3].get_title()
    assert title.startswith("Q-learning, α = 0.9\ngreedy path, median of 5 seeds\n15 steps to the goal")
    what, seeds = figure.get_suptitle().splitlines()
    assert what == "Windy gridworld, ε = 0.1, γ = 1"
    assert seeds == "mean over 5 seeds, and its 95% interval at each point"


def test_caption_says_what_is_unusual(datasets):
    figure = plot.overview(datasets, rl.make("windy-gridworld", stochastic=True))
    assert figure.get_suptitle().startswith("Windy gridworld, stochastic = True, ε = 0.1")


def test_every_hyperparameter_that_was_swept_has_its_picture(datasets, windy):
    ds = datasets["sarsa"].expand_dims(lam=[0.0, 0.9])
    figure = plot.overview({"sarsa-lambda": ds}, windy)
    assert [ax.get_xlabel() for ax in figure.axes][2:4] == ["step size α", "λ"]
    assert len(figure.axes) == 5  # with the greedy path


def test_caption_of_an_environment_with_arrays(datasets):
    figure = plot.overview(datasets, rl.make("k-armed-testbed", arms=3))
    assert figure.get_suptitle().startswith("Windy gridworld, arms = 3, ε = 0.1")


def test_long_captions_are_broken_between_settings(datasets, windy):
    settings = (
        '{"trace": "accumulating", "offline": false, "epsilon": "harmonic:100:visit", "gamma": 1.0, "q0": 0}'
    )
    caption = plot.overview({"a": datasets["sarsa"].assign_attrs(fixed=settings)}, windy).get_suptitle()
    first, second, _ = caption.splitlines()
    assert first == "Windy gridworld, trace = accumulating, offline = off, ε = harmonic:100:visit, γ = 1,"
    assert second == "q0 = 0"


def test_median_path_counts_endless_ones_as_longest(windy, solved, ax):
    """Of five seeds two go for ever and one takes 15 steps: the median is the longest that arrives."""
    left, detour = np.zeros((70, 4)), solved[1].copy()
    left[:, 3] = 1
    detour[30] = [0, -1, -1, -1]  # from the start up first: 16 steps
    result = make_result(windy, solved[1])
    q = np.stack([left, detour, left, solved[1], detour])
    ds = dataclasses.replace(result, q=np.broadcast_to(q, (3, *q.shape))).to_xarray()
    figure = plot.overview({"sarsa": ds}, windy)
    assert "16 steps to the goal" in figure.axes[3].get_title()


def test_what_is_no_grid_has_no_path(datasets):
    figure = plot.overview(datasets, rl.RandomWalk())
    assert len(figure.axes) == 3
