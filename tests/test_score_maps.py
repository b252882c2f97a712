"""Pictures of scores: of any measure, over two hyperparameters; and of exact values in one scale of colours."""

import numpy as np
import pytest
from made_up import make_result
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

import jaxrl_tab as rl
from jaxrl_tab import InputError, plot, stats


@pytest.fixture(scope="module")
def one(windy):
    """A sweep over three step sizes."""
    return make_result(windy, rl.planning.value_iteration(windy)[1]).to_xarray()


@pytest.fixture(scope="module")
def two(one):
    """A sweep over these and two exploration rates, of which the second is worse."""
    epsilon = np.array([0.1, 0.4])
    ds = one.expand_dims(epsilon=epsilon).assign_attrs(fixed='{"gamma": 1.0}')
    worse = ds.returns * (1 + (ds.epsilon > 0.1))
    return ds.assign(returns=worse.transpose(*ds.returns.dims)).transpose("alpha", "epsilon", ...)


@pytest.fixture
def ax():
    return Figure().subplots()


def test_a_map_shows_the_mean_scores(ax, two):
    """The best has a frame. Broken once: the axes the wrong way round; the frame at the worst -> fails."""
    plot.score_map(ax, two, title="Sarsa")
    mean = stats.score_interval(two).estimate.transpose("epsilon", "alpha").values
    [image] = ax.get_images()
    np.testing.assert_allclose(image.get_array(), mean)
    assert image.origin == "lower"
    assert isinstance(image.norm, SymLogNorm)  # from -17 to -680: colours are of ratios
    assert [x.get_text() for x in ax.get_xticklabels()] == ["0.05", "0.2", "0.9"]
    assert [x.get_text() for x in ax.get_yticklabels()] == ["0.1", "0.4"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("α", "ε")
    [frame] = ax.patches
    assert frame.get_xy() == (1.5, -0.5)  # alpha = 0.9, epsilon = 0.1
    shown = {
        (round(t.get_position()[0]), round(t.get_position()[1])): t.get_text() for t in ax.texts + ax.artists
    }
    for (row, column), x in np.ndenumerate(mean):
        assert float(shown[column, row].replace("−", "-")) == pytest.approx(x, rel=0.005)


def test_of_what_is_to_be_small_the_smallest_is_the_brightest(ax, two):
    """Broken once: bright is large -> fails."""
    ds = two.assign(q_error=two.steps * 0 + two.alpha)
    plot.score_map(ax, ds, "epsilon", "alpha", measure="q_error end")
    [image] = ax.get_images()
    np.testing.assert_allclose(image.get_array(), two.alpha.values[:, None].repeat(2, 1))
    bright = [sum(image.cmap(image.norm(x))[:3]) for x in (0.05, 0.9)]
    assert bright[0] > bright[1]
    assert ax.patches[0].get_xy()[1] == -0.5


def test_a_map_needs_two_that_were_swept(ax, one, two):
    with pytest.raises(InputError, match="two hyperparameters that were swept: no second hyperparameter"):
        plot.score_map(ax, one)
    with pytest.raises(InputError, match="two hyperparameters that were swept: not 'n'"):
        plot.score_map(ax, two, "alpha", "n")
    with pytest.raises(InputError, match="interim"):
        plot.score_map(ax, two, measure="interims")


def test_methods_that_vary_two_have_their_map(windy, one, two):
    """In colours that compare. Broken once: colours of each for itself -> fails."""
    assert "score_map" not in plot.pictures({"sarsa": one}, windy)
    better = two.assign(returns=two.returns * 0.9)
    figure = plot.pictures({"sarsa": two, "q-learning": better, "other": one}, windy)["score_map"]
    images = [image for ax in figure.axes for image in ax.get_images()]
    assert len(images) == 2
    assert images[0].get_clim() == images[1].get_clim()
    titles = [ax.get_title() for ax in figure.axes if ax.get_images()]
    assert titles == ["Sarsa: mean of 5 seeds", "Q-learning: mean of 5 seeds"]


@pytest.mark.parametrize("measure", ["interim", "until -40", "episodes", "greedy_value end"])
def test_sensitivity_of_any_measure(ax, one, measure):
    """Broken once: the score whatever the measure; an axis that ends below the curve -> fails."""
    ds = one.assign(greedy_value=one.returns * 0 - 20 + one.alpha)
    plot.sensitivity(ax, {"sarsa": ds}, measure=measure)
    merged = stats.merge_rows(ds, 40)
    expected = {
        "interim": lambda: stats.mean_return(ds).mean("seed"),
        "until -40": lambda: stats.time_to_threshold(
            stats.learning_curve(merged), -40, merged.steps.cumsum("row")
        ).median("seed"),
        "episodes": lambda: ds.episodes.sum("row").mean("seed"),
        "greedy_value end": lambda: ds.greedy_value.isel(row=-1).median("seed"),
    }[measure]().values  # fmt: skip
    [line] = [x for x in ax.get_lines() if x.get_label().startswith("Sarsa")]
    finite = np.where(np.isfinite(expected), expected, np.nan)
    np.testing.assert_allclose(line.get_ydata(), finite, rtol=1e-6)
    low, high = ax.get_ylim()
    assert low <= np.nanmin(finite)
    assert np.nanmax(finite) <= high
    assert ax.get_ylabel().endswith(", median") == (measure in ("until -40", "greedy_value end"))


def test_sensitivity_says_which_measures_there_are(ax, one):
    with pytest.raises(InputError, match="until"):
        plot.sensitivity(ax, {"sarsa": one}, measure="until then")


def scales(figure):
    """The ends of the colours of all that is shown in them, and how many scales of colours there are."""
    shown = [image for ax in figure.axes for image in ax.get_images()]
    return {image.get_clim() for image in shown}, len(figure.get_layout_engine().bars)


def test_all_rows_of_tables_have_one_scale_of_colours():
    """Without what is exact, too. Broken once: a scale for each row -> fails."""
    env = rl.Blackjack()
    result = rl.sweep(env, "monte-carlo", {"epsilon": [0.1]}, num_seeds=2, num_episodes=300, progress=False)
    ds = result.to_xarray()
    model = rl.planning.exact_model(env)
    inner = rl.planning.reachable(model) & ~rl.planning.terminal_states(model)
    v = rl.planning.value_iteration(env)[0][inner]
    methods = {"first": ds, "second": ds.assign(q=2 * ds.q)}
    assert scales(plot.value_tables(methods, env)) == ({(v.min(), v.max())}, 1)
    unknown = {name: x.assign_attrs(optimal_value=np.nan) for name, x in methods.items()}
    learned = ds.q.isel(epsilon=0).max("action").mean("seed", dtype=float).values[inner]
    [ends], bars = scales(plot.value_tables(unknown, env))
    assert bars == 1
    np.testing.assert_allclose(
        ends, (min(learned.min(), 2 * learned.min()), max(learned.max(), 2 * learned.max()))
    )


def test_solutions_have_one_scale_and_the_width_that_is_wanted(windy):
    """Broken once: a scale for each; the usual width -> fails."""
    for env, picture in ((windy, 3.3), (rl.Blackjack(), 3.3), (rl.TwoDoors(), 3.3)):
        v, q = rl.planning.value_iteration(env)
        _, soft, soft_q = rl.planning.epsilon_soft(env, 0.2)
        figure = plot.solutions(env, {"optimal": (v, q), "soft": (soft, soft_q)}, width=picture)
        assert figure.get_figwidth() <= picture + 1e-9
        ends, bars = scales(figure)
        assert len(ends) == (0 if isinstance(env, rl.TwoDoors) else 1)
        assert bars == {"WindyGridworld": 2, "Blackjack": 1, "TwoDoors": 0}[type(env).__name__]
