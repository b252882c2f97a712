"""What pictures look like, at the width of a page and of one of its columns: nothing hides anything."""

import dataclasses
import itertools

import numpy as np
import pytest
from made_up import make_result
from marks import slow_but_first
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.quiver import Quiver
from matplotlib.text import Text

import jaxrl_tab as rl
from jaxrl_tab import plot
from jaxrl_tab.cli import solve
from jaxrl_tab.core.declared import Learns
from jaxrl_tab.show import style

COLUMN = 3.3  # inches
WIDTHS = (COLUMN, plot.WIDTH)
METHODS = ("sarsa", "q-learning", "expected-sarsa", "double-q-learning", "n-step-sarsa", "sarsa-lambda")


def drawn(figure, monkeypatch):
    """Draws a figure as `save` does, and returns the texts in it that were drawn."""
    texts = []

    def draw(self, renderer):
        if self.get_visible() and self.get_text().strip("\u200b "):
            texts.append(self)
        return of_matplotlib(self, renderer)

    of_matplotlib = Text.draw
    with monkeypatch.context() as patched:
        patched.setattr(Text, "draw", draw)
        style.lay_out(figure)
        figure.draw_without_rendering()
    return list(dict.fromkeys(texts))


def overlap(one, other):
    """Whether two boxes have a part in common that people would see, pixels."""
    width = min(one.x1, other.x1) - max(one.x0, other.x0)
    height = min(one.y1, other.y1) - max(one.y0, other.y0)
    return min(width, height) > 1.5


def check(figure, monkeypatch):
    """No text lies on another, or beyond the edge; no legend lies on a curve."""
    texts = drawn(figure, monkeypatch)
    assert texts
    boxes = {text: text.get_window_extent() for text in texts if not 0 < text.get_rotation() < 90}
    for (one, box), (other, another) in itertools.combinations(boxes.items(), 2):
        assert not overlap(box, another), (one, other)
    for text in texts:
        box = text.get_window_extent()
        inside = figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
        assert inside, text
        assert figure.bbox.y0 <= box.y0, text
        assert box.y1 <= figure.bbox.y1, text
    for ax in figure.axes:
        for legend in (child for child in ax.get_children() if isinstance(child, Legend)):
            box = legend.get_window_extent()
            assert not overlap(box, ax.get_window_extent())
            own = {legend.get_title(), *legend.get_texts()}
            assert not [text for text in boxes if text not in own and overlap(box, boxes[text])]
            for line in ax.get_lines():
                points = line.get_transform().transform(np.column_stack(line.get_data()).astype(float))
                assert not [point for point in points if box.contains(*point)], line


# --- every kind of picture -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def windy_q(windy):
    return rl.planning.value_iteration(windy)[1]


@pytest.fixture(scope="module")
def control(windy, windy_q):
    return {name: make_result(windy, windy_q).to_xarray() for name in METHODS}


def with_schedules(datasets):
    alphas = {"alpha": ["harmonic:100:visit", "sample-average", "0.5"]}
    return {name: ds.assign_coords(alphas) for name, ds in datasets.items()}


def with_many_settings(datasets):
    """Of 40 values of alpha, in thousands of steps."""
    ds = datasets["sarsa"].isel(alpha=[i % 3 for i in range(40)])
    ds = ds.assign_coords(alpha=np.linspace(0.01, 1, 40).round(3)).expand_dims(lam=[0.0, 0.9])
    ds = ds.assign(steps=ds.steps * 12345)
    return {"sarsa-lambda": ds.assign_attrs(num_steps=200 * 20 * 12345)}


def of_prediction(windy, windy_q):
    result = make_result(windy, windy_q)
    errors = np.random.default_rng(0).uniform(0.1, 0.5, result.log.steps.shape)
    return dataclasses.replace(
        result,
        algorithm="td",
        environment="random-walk",
        log=result.log._replace(v_error=errors),
        q=np.random.default_rng(2).normal(size=(3, 5, 21, 1)),
        optimal_value=np.array(0.0),
        learns=Learns.STATES,
    ).to_xarray()


def of_cards(name):
    env = rl.make(name)
    q = rl.planning.value_iteration(env)[1]
    result = dataclasses.replace(make_result(env, q), environment=name, optimal_value=np.array(0.0631))
    return {"monte-carlo": result.to_xarray()}, env


@pytest.fixture(scope="module")
def sweeps(control, windy, windy_q):
    """Sweeps with their environments, such that together they have every kind of picture."""
    one = {"sarsa": control["sarsa"].isel(alpha=[1])}
    strange = {"a" * 300: control["sarsa"], "x $y$": control["q-learning"]}
    return {
        "one setting": (one, dataclasses.replace(windy, stochastic=True)),
        "six methods": (control, windy),
        "schedules": (with_schedules(control), windy),
        "many settings": (with_many_settings(control), windy),
        "long names": (strange, windy),
        "prediction": ({"td": of_prediction(windy, windy_q)}, rl.RandomWalk()),
        "cards": of_cards("blackjack"),
    }


SWEEPS = ("one setting", "six methods", "schedules", "many settings", "long names", "prediction", "cards")


@pytest.mark.one_in(2)
@pytest.mark.parametrize("width", slow_but_first(WIDTHS))
@pytest.mark.parametrize("name", SWEEPS)
def test_nothing_hides_anything_in_pictures_of_a_sweep(name, width, sweeps, monkeypatch):
    """Broken once: the legend of Matplotlib's choice; `_thin_out` away; names not tilted -> fails."""
    datasets, env = sweeps[name]
    figures = plot.pictures(datasets, env, width=width)
    for figure in (*figures.values(), plot.overview(datasets, env, width=width)):
        check(figure, monkeypatch)
        assert figure.get_figwidth() <= width


@pytest.mark.parametrize("name", ["windy-gridworld", "cliff-walking", "random-walk", "k-armed-testbed"])
def test_nothing_hides_anything_in_pictures_of_exact_values(name, monkeypatch, tmp_path):
    """Broken once: the numbers of cells in one size, in the middle -> fails."""
    figures = []
    monkeypatch.setattr(plot, "save", lambda figure, file: figures.append(figure))
    env = rl.make(name)
    solve._draw_solutions(env, {"optimal": rl.planning.policy_iteration(env)}, tmp_path)
    for figure in figures:
        check(figure, monkeypatch)


@pytest.mark.parametrize("shape", [(7, 10), (14, 20), (14, 4), (3, 12)])
@pytest.mark.parametrize("width", WIDTHS)
def test_values_of_grids_fit_their_cells(shape, width, monkeypatch):
    """In small cells they are smaller, or left out; none crosses the lines of the grid."""
    env = rl.make("trace-gridworld", shape=shape, start=(shape[0] - 1, 0), goal=(0, shape[1] - 1))
    figure = plot.canvas(width)
    ax = figure.subplots()
    plot.values(ax, env, *rl.planning.value_iteration(env, 0.9))
    check(figure, monkeypatch)
    for text in ax.texts:
        row, column = np.round(text.get_position()[::-1])
        cell = ax.transData.transform([(column - 0.5, row + 0.5), (column + 0.5, row - 0.5)])
        if text.get_text() not in "SG" and text._fit():
            box = text.get_window_extent()
            assert (cell[0] <= (box.x0, box.y0 + 3)).all()  # a font has room below its digits
            assert ((box.x1, box.y1) <= cell[1]).all()


# --- marks and legends ---------------------------------------------------------------------------------


def test_ten_arms_have_ten_marks():
    """Broken once: eight markers in `MARKERS` -> fails."""
    assert len({mark["marker"] for mark in itertools.islice(style.line_styles(), 10)}) == 10


def test_a_legend_that_is_too_long_says_how_many_more_there_are():
    ax = Figure((6, 4)).subplots()
    for i in range(30):
        ax.plot([0, 1], [i, i], label=f"method {i}")
    plot.legend(ax)
    names = [text.get_text() for text in ax.get_legend().texts]
    assert names == [*(f"method {i}" for i in range(11)), "and 19 more"]


def test_a_legend_has_marks_only_for_what_is_drawn():
    """Broken once: the marks of all -> fails."""
    ax = Figure((6, 4)).subplots()
    for y, name in (([1, 2], "here"), ([np.nan, np.nan], "nowhere"), ([8, 9], "above")):
        ax.plot([0, 1], y, "o-", label=name)
    ax.set_ylim(0, 3)
    plot.legend(ax)
    marks = [line for line in ax.get_legend().get_lines() if line.get_linestyle() != "None"]
    assert len(ax.get_legend().texts) == 3
    assert len(marks) == 1


def test_the_best_policy_that_explores_is_named_only_where_it_is_another_one(control):
    """In the random walk nothing can be done, and both are worth 0."""
    ax = Figure().subplots()
    plot.learning_curves(ax, {"sarsa": control["sarsa"]}, soft=-15.0)
    assert not [text for text in ax.get_legend().texts if "soft" in text.get_text()]


# --- grids ---------------------------------------------------------------------------------------------


def arrows_of(ax):
    """The cells (row, column) in which arrows begin."""
    quivers = [x for x in ax.collections if isinstance(x, Quiver)]
    return {(round(float(y)), round(float(x))) for q in quivers for x, y in zip(q.X, q.Y, strict=True)}


@pytest.mark.parametrize("draw", ["greedy_path", "values"])
def test_the_start_has_its_arrow_and_a_letter_beside_it(draw, windy, windy_q):
    """Broken once: the start's letter in the middle; the arrows of the path left out -> fails."""
    figure = plot.canvas(COLUMN)
    ax = figure.subplots()
    if draw == "values":
        plot.values(ax, windy, windy_q.max(-1), windy_q)
    else:
        plot.greedy_path(ax, windy, windy_q)
    style.lay_out(figure)
    assert windy.start in arrows_of(ax)
    (start,) = [text for text in ax.texts if text.get_text() == "S"]
    middle = ax.transData.transform(windy.start[::-1])
    assert not start.get_window_extent().contains(*middle)


def test_all_cells_of_a_path_have_their_arrows_above_it(windy, windy_q):
    ax = Figure().subplots()
    plot.greedy_path(ax, windy, windy_q)
    band = ax.get_lines()[0]
    path = {(int(y), int(x)) for x, y in zip(*band.get_data(), strict=True)} - {tuple(windy.goal)}
    assert path <= arrows_of(ax)
    assert all(q.get_zorder() > band.get_zorder() for q in ax.collections if isinstance(q, Quiver))


def test_cells_out_of_reach_are_hatched(windy, windy_q):
    """Seven in the windy gridworld. Broken once: no hatches -> fails."""
    for draw in (
        lambda ax: plot.greedy_path(ax, windy, windy_q),
        lambda ax: plot.values(ax, windy, windy_q.max(-1), None),
    ):
        ax = Figure().subplots()
        draw(ax)
        assert len([x for x in ax.patches if isinstance(x, Rectangle) and x.get_hatch()]) == 7


# --- the names of methods ------------------------------------------------------------------------------


def test_labels_are_shown_in_place_of_names(control, windy):
    labels = {"sarsa": "Ours"}
    for figure in plot.pictures(control, windy, labels=labels).values():
        shown = [text.get_text() for text in figure.findobj(Text)]
        assert any(text.startswith("Ours") for text in shown)
        assert not any(text.startswith("Sarsa,") or text == "Sarsa" for text in shown)


def test_wrong_labels_are_refused(control, windy):
    with pytest.raises(rl.InputError, match=r"'sarse' is unknown; did you mean 'sarsa'\?"):
        plot.overview(control, windy, labels={"sarse": "Ours"})
    with pytest.raises(rl.InputError, match="two methods cannot both be called 'sarsa'"):
        plot.overview(control, windy, labels={"q-learning": "sarsa"})


def test_ticks_that_are_too_near_have_no_name(control, monkeypatch):
    """On a logarithmic axis 1.8 and 1.9 lie at the same place. Broken once: without `_thin_out` -> fails."""
    figure = plot.canvas(COLUMN)
    ax = figure.subplots()
    plot.sensitivity(ax, {"sarsa": control["sarsa"].assign_coords(alpha=[0.1, 1.8, 1.9])})
    check(figure, monkeypatch)
    assert [label.get_text() for label in ax.get_xticklabels()] == ["0.1", "1.8", ""]


def test_millions_of_episodes_leave_the_legend_alone(control, monkeypatch):
    """Broken once: with a power of ten above the axis -> fails."""
    figure = plot.canvas(COLUMN)
    ds = control["sarsa"].assign(episodes=control["sarsa"].episodes * 1_000_000)
    plot.episodes_against_steps(figure.subplots(), {"sarsa": ds})
    check(figure, monkeypatch)


def test_long_names_of_settings_are_tilted_and_all_there(control):
    """Broken once: not tilted, so that every other one is left out -> fails."""
    figure = plot.canvas(COLUMN)
    ax = figure.subplots()
    plot.sensitivity(ax, with_schedules(control))
    style.lay_out(figure)
    names = ["harmonic:100:visit", "sample-average", "0.5"]
    assert [label.get_text() for label in ax.get_xticklabels()] == names


def test_lines_are_told_apart_where_they_lie_at_the_same_place(control):
    """At each alpha the marks of two methods lie side by side. Broken once: `_aside` away -> fails."""
    ax = Figure((6, 4)).subplots()
    same = dict.fromkeys(("one", "other"), control["sarsa"])
    plot.sensitivity(ax, same)
    lines = [line for line in ax.get_lines() if isinstance(line, Line2D) and line.get_label() in same]
    one, other = (line.get_transform().transform(np.column_stack(line.get_data())) for line in lines)
    assert (np.hypot(*(one - other).T) > 3).all()


# --- what is drawn, and by what it is coloured ---------------------------------------------------------


def test_another_measure_is_drawn_as_the_report_has_it(control):
    """The mean length of episodes, at the points of the report; worked out anew. Broken once: rewards -> fails."""
    ax = Figure().subplots()
    plot.learning_curves(ax, {"sarsa": control["sarsa"]}, measure="length", alpha=0.9)
    (line,) = ax.get_lines()
    ds = control["sarsa"].sel(alpha=0.9)
    length = (ds.lengths / ds.episodes.where(ds.episodes > 0)).mean("seed")
    enough = (ds.episodes > 0).mean("seed") >= 0.9
    np.testing.assert_allclose(line.get_ydata(), length.where(enough))
    assert ax.get_ylabel() == "mean length of an episode"


def test_a_curve_for_each_value_of_a_hyperparameter(control):
    """Each has a colour, a mark and a name of its own. Broken once: the values of all as the first -> fails."""
    ax = Figure().subplots()
    plot.episodes_against_steps(ax, {"sarsa": control["sarsa"]}, color_by="alpha")
    lines = ax.get_lines()
    assert [line.get_label() for line in lines] == [f"Sarsa, α = {alpha}" for alpha in (0.05, 0.2, 0.9)]
    for line, alpha in zip(lines, (0.05, 0.2, 0.9), strict=True):
        finished = control["sarsa"].episodes.sel(alpha=alpha).sum("row").mean("seed")
        assert line.get_ydata()[-1] == pytest.approx(float(finished))
    assert len({tuple(line.get_color()) for line in lines}) == 3
    assert len({line.get_marker() for line in lines}) == 3


def test_sensitivity_has_a_curve_for_each_value_of_another_hyperparameter(control):
    ds = control["sarsa"].expand_dims(n=[1, 4])
    ax = Figure().subplots()
    plot.sensitivity(ax, {"n-step-sarsa": ds, "sarsa": control["sarsa"]}, "alpha", color_by="n")
    names = [line.get_label() for line in ax.get_lines() if not line.get_label().startswith("_")]
    assert names[:3] == ["n-step Sarsa, n = 1", "n-step Sarsa, n = 4", "Sarsa"]


def test_wrong_measures_and_colours_are_refused(control):
    ax = Figure().subplots()
    with pytest.raises(rl.InputError, match=r"the measure 'lenght' is unknown; did you mean 'length'\?"):
        plot.learning_curves(ax, control, measure="lenght")
    with pytest.raises(rl.InputError, match=r"no method swept 'alhpa'; did you mean 'alpha'\?"):
        plot.sensitivity(ax, control, color_by="alhpa")
