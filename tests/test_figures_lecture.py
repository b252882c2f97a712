"""Figures of what the lecture shows: their numbers from plain loops, and what they measure in made-up runs."""

import html

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import PolyCollection

from jaxrl_tab import plot
from jaxrl_tab.figures import FIGURES, how_often, initial_q, lambda_arrows, time_step, trace
from jaxrl_tab.figures.page import page

BLACKJACK_END = how_often.EPISODES // how_often.EVERY - 1


def checked(figure, datasets, of=""):
    """The numbers with `of` in their name, as they come out; all must be right."""
    checks = [number.check(datasets) for number in figure.numbers if of in number.what]
    assert checks
    assert not [check for check in checks if not check.ok]


def drawn(figure, datasets, file):
    picture = figure.draw(datasets)
    plot.save(picture, file / "figure.png")
    assert picture.get_figwidth() <= plot.WIDTH
    return picture


def along_a_way(steps, lam, gamma, alpha, episodes):
    """Q of a way of so many steps, the last first, after each episode of Sarsa(lambda): [episodes, steps].

    A plain loop over a chain: the last step pays 1, the others nothing.
    """
    q, after = np.zeros(steps + 1), []
    for _ in range(episodes):
        z = np.zeros(steps + 1)
        for k in range(steps, 0, -1):  # steps that are left
            target = 1 if k == 1 else gamma * q[k - 1]
            delta = target - q[k]
            z[k] = 1
            q += alpha * delta * z
            z *= gamma * lam
        after.append(q[1:].copy())
    return np.array(after)


def test_the_trace_is_the_sum_over_visits():
    """Broken once: the trace of a step taken after it has faded; dutch with another alpha -> fails."""
    kept = {"accumulating": 1.0, "replacing": 0.0, "dutch": 0.7}
    z = trace._traces().z
    for kind, part in kept.items():
        for step in range(trace.STEPS):
            visits = [visit for visit in trace.VISITS if visit <= step]
            by_hand = sum(0.8 ** (step - v) * part ** (len(visits) - 1 - i) for i, v in enumerate(visits))
            assert z.sel(kind=kind, step=step).item() == pytest.approx(by_hand, rel=2e-6, abs=1e-7)
    checked(trace.FIGURE, {"trace": z.to_dataset()})


@pytest.fixture(scope="module")
def arrows():
    """What the figure would run, from the plain loop."""
    env, moves = lambda_arrows.ENV, lambda_arrows.MOVES
    states, actions = lambda_arrows.path(env, moves)
    tables = np.zeros((4, 1, 10, env.num_states, env.num_actions))
    for i, lam in enumerate(lambda_arrows.LAMBDAS):
        tables[i, 0][:, states, actions] = along_a_way(len(moves), lam, 1.0, 0.5, 10)[:, ::-1]
    dims = ("lam", "seed", "row", "table_0", "table_1")
    return {lambda_arrows.RUN: xr.Dataset({"table": (dims, tables)}, {"lam": list(lambda_arrows.LAMBDAS)})}


def test_the_numbers_of_the_arrows_are_those_of_a_plain_loop(arrows):
    """Broken once: an expected number; the pair counted from the first step -> fails."""
    checked(lambda_arrows.FIGURE, arrows)


def test_the_area_of_an_arrow_is_the_change_and_its_middle_in_its_cell(arrows, tmp_path):
    """Broken once: the length is the change -> fails."""
    ax = drawn(lambda_arrows.FIGURE, arrows, tmp_path).axes[2]  # lambda = 0.9, episode 1
    (arrowheads,) = (drawn for drawn in ax.collections if isinstance(drawn, PolyCollection))
    outlines = np.array([path.vertices[:-1] for path in arrowheads.get_paths()])
    x, y = outlines.transpose(2, 0, 1)
    areas = np.abs((x * np.roll(y, 1, 1) - y * np.roll(x, 1, 1)).sum(1)) / 2
    change = lambda_arrows._changes(arrows, 0.9)[0]
    states, _ = np.nonzero(change)
    sizes = change[np.nonzero(change)]
    assert areas / areas.max() == pytest.approx(sizes / sizes.max())
    middle = (outlines.min(1) + outlines.max(1)) / 2
    assert middle == pytest.approx(np.stack(np.divmod(states, lambda_arrows.ENV.shape[1]), -1)[:, ::-1])


def test_the_way_of_the_arrows_ends_at_the_goal_and_takes_no_cell_twice():
    for env, moves in (
        (lambda_arrows.ENV, lambda_arrows.MOVES),
        *((time_step._grid(parts), time_step._moves(parts)) for parts in time_step.PARTS),
    ):
        states, actions = lambda_arrows.path(env, moves)
        assert len(set(states)) == len(states)
        s, after = env.start_state, []
        for a in actions:
            s = int(env.neighbour(jnp.int32(s), jnp.int32(a)))
            after.append(s)
        assert [*states[1:], env.state(env.goal)] == after
        assert env.state(env.goal) not in states


@pytest.fixture(scope="module")
def finer():
    """What the figure would run along one way, from the plain loop; and runs of two seeds that are made up."""
    datasets = {}
    for parts in time_step.PARTS:
        gamma, lambdas = 0.95 ** (1 / parts), sorted({0.0, 0.9, 0.9 ** (1 / parts)})
        pairs = [along_a_way(6 * parts, lam, gamma, 0.5, 100) for lam in lambdas]
        dims = ("lam", "seed", "row", "pairs_0")
        datasets[f"way-{parts}"] = xr.Dataset({"pairs": (dims, np.array(pairs)[:, None])}, {"lam": lambdas})
    for parts in time_step.LEARNED:
        lambdas = datasets[f"way-{parts}"].lam.values
        start = np.zeros((len(lambdas), 2, 5))
        start[:, 0, 3:] = 0.1  # in the fourth episode, and never
        datasets[f"learning-{parts}"] = xr.Dataset(
            {"start": (("lam", "seed", "row"), start)}, {"lam": lambdas}
        )
    return datasets


@pytest.mark.parametrize("of", ["share", "same way"])
def test_what_ever_smaller_steps_tell_is_that_of_a_plain_loop(finer, of):
    """Broken once: lambda per unit as per step; the first pair of the way for the start -> fails."""
    checked(time_step.FIGURE, finer, of)


def test_the_episodes_of_the_same_way_are_those_of_a_coin(finer):
    """With alpha = 1/2, n episodes give a step with d steps left P(n fair coins show d heads or more) of its value.

    Broken once: more than a tenth of the largest change for a tenth of the value -> fails.
    """
    heads = np.zeros(200)
    heads[0] = 1
    needed = {}
    for n in range(1, 101):
        heads = (heads + np.append(0, heads[:-1])) / 2
        for parts in time_step.PARTS:
            if heads[6 * parts :].sum() >= 0.1:
                needed.setdefault(parts, n)
    assert needed == {1: 8, 2: 18, 4: 40, 8: 84}
    assert needed == {parts: time_step._along(time_step.SARSA, parts)(finer) for parts in time_step.PARTS}


def test_learning_takes_the_episodes_until_the_start_knows(finer, tmp_path):
    """Broken once: the number of the row for that of the episode -> fails."""
    measure = {number.what: number.measure for number in time_step.FIGURE.numbers}
    assert measure["one-step Sarsa, 4 steps: episodes to learn it"](finer).tolist() == [4, 5]
    drawn(time_step.FIGURE, finer, tmp_path)


def blackjack(dims, coords, **variables):
    shape = [len(coords[dim]) if dim in coords else size for dim, size in dims.items()]
    values = np.arange(np.prod(shape), dtype=float).reshape(shape)
    made_up = {name: (list(dims), factor * values) for name, factor in variables.items()}
    return xr.Dataset(made_up, coords)


def test_how_often_measures_the_run_that_it_names(tmp_path):
    """Broken once: the beginning at random for the other; the first row for the last -> fails."""
    rows = BLACKJACK_END + 1
    dims = {"seed": 2, "row": rows}
    runs = {}
    for batch in how_often.BATCHES:
        first = {"epsilon": 2} if batch == 1 else {}
        runs[f"batch-{batch}"] = blackjack(
            first | dims, {"row": range(rows)}, greedy_value=-0.01 / batch, returns=-1.0, episodes=1.0
        )
    greedy = runs["batch-1"].greedy_value.values
    assert (how_often._learned(1)(runs) == greedy[0, :, -1]).all()
    assert (how_often._learned(1, True)(runs) == greedy[1, :, -1]).all()
    assert (how_often._learned(100)(runs) == runs["batch-100"].greedy_value.values[:, -1]).all()
    assert how_often._earned(1000)(runs)[0] == pytest.approx(-sum(range(rows)) / 2000)
    drawn(how_often.FIGURE, runs, tmp_path)


def test_a_beginning_at_random_ends():
    rate = how_often.AtRandomFirst(1000)
    assert rate(jnp.array([1, 1000, 1001])).tolist() == pytest.approx([1, 1, 0.1])
    assert how_often.AtRandomFirst(0)(jnp.int32(1)) == pytest.approx(0.1)


def test_the_initial_value_is_measured_where_it_says(tmp_path):
    """Broken once: the row after the one that is named -> fails."""
    rows = BLACKJACK_END + 1
    coords = {"q0": list(initial_q.INITIAL), "row": range(rows)}
    ds = blackjack({"q0": 3, "seed": 2, "row": rows}, coords, greedy_value=-0.001, tried=1.0)
    runs = {initial_q.RUN: ds}
    assert (initial_q._at("tried", -5)(runs) == ds.tried.values[1, :, -1]).all()
    assert (initial_q._at("tried", 5, 500)(runs) == ds.tried.values[2, :, 1]).all()  # rows of 250
    drawn(initial_q.FIGURE, runs, tmp_path)


@pytest.mark.parametrize("name", FIGURES)
def test_the_page_says_what_there_is_to_see(name):
    """Broken once: left out of the page -> fails."""
    figure = FIGURES[name]
    assert figure.shows.endswith(".")
    assert figure.shows in html.unescape(page({name: (figure, [])}, "0"))
