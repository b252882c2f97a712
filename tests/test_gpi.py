"""The picture of generalized policy iteration, `solve --steps`, and docs/gpi.md: numbers from plain loops."""

import io
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from rich.console import Console

import jaxrl_tab as rl
from jaxrl_tab import planning, plot
from jaxrl_tab.cli import main, tables
from jaxrl_tab.figures import FIGURES, gpi

FIGURE = FIGURES["gpi"]
HIT = 1
ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def datasets():
    return {name: run(lambda state: None) for name, run in FIGURE.experiment().items()}


# --- the 4 x 4 grid, cell by cell --------------------------------------------------------------------


def neighbours(row, column):
    """Where the four moves lead, up, right, down, left."""
    for down, right in ((-1, 0), (0, 1), (1, 0), (0, -1)):
        yield min(max(row + down, 0), 3), min(max(column + right, 0), 3)


ENDS = (0, 0), (3, 3)


def test_the_grid_is_that_of_the_book():
    """Broken once: rows and columns exchanged, by which no value changes -> fails."""
    model = planning.exact_model(gpi.grid())
    for s, cell in enumerate(np.ndindex(4, 4)):
        if cell not in ENDS:
            assert model.s_next[s, :, 0].tolist() == [4 * row + column for row, column in neighbours(*cell)]
            assert (model.reward[s] == -1).all() and model.start[s] == pytest.approx(1 / 14)


def swept(times):
    """v of the random policy after so many sweeps from 0 on, [4][4]."""
    v = dict.fromkeys(np.ndindex(4, 4), 0.0)
    for _ in range(times):
        v = {cell: 0 if cell in ENDS else -1 + sum(v[n] for n in neighbours(*cell)) / 4 for cell in v}
    return v


def greedy(v):
    """The moves that lead to the largest value: cell -> list of cells."""
    best = {}
    for cell in v:
        entered = list(neighbours(*cell))
        best[cell] = [n for n in entered if v[n] > max(v[m] for m in entered) - 1e-9]
    return best


def worth(moves):
    """The value of taking any of these moves, in each cell."""
    v = dict.fromkeys(moves, 0.0)
    for _ in range(2000):
        v = {cell: 0 if cell in ENDS else -1 + sum(v[n] for n in to) / len(to) for cell, to in moves.items()}
    return v


# --- Easy21, from its rules --------------------------------------------------------------------------


def dealt():
    """From each total of 1 to 21 to each, [21, 21], with one more card: black, or red, which counts against."""
    p = np.zeros((21, 21))
    for total in range(1, 22):
        for card in range(1, 11):
            for new, chance in ((total + card, 2 / 30), (total - card, 1 / 30)):
                if 1 <= new <= 21:
                    p[total - 1, new - 1] += chance
    return p


DEALT = dealt()


def stuck():
    """What sticking is worth, [total, card that the dealer shows]; she sticks from 17 on."""
    ends = np.linalg.matrix_power(np.vstack([DEALT[:16], np.eye(21)[16:]]), 10_000)[:10]
    bust = 1 - ends.sum(1)
    return np.array(
        [[bust[c] + ends[c, :t].sum() - ends[c, t + 1 :].sum() for c in range(10)] for t in range(21)]
    )


STUCK, BUST = stuck(), 1 - DEALT.sum(1)


def hit_value(v):
    """What hitting is worth if v holds after the next card."""
    return DEALT @ v - BUST[:, None]


def easy21(sweeps, improvements):
    """The probability of hitting and v, [total, card] each, of each iterate; 200 sweeps are all."""
    hit, v, found = np.full((21, 10), 0.5), np.zeros((21, 10)), []
    for n in range(improvements + 1):
        for _ in range(200 if sweeps is None else sweeps * (n > 0)):
            v = (1 - hit) * STUCK + hit * hit_value(v)
        found.append((hit, v))
        hit = hit_value(v) > STUCK
    return found


# --- the figure --------------------------------------------------------------------------------------


def test_the_numbers_of_the_figure_are_those_of_plain_loops(datasets):
    """Broken once, each -> fails: a move too few; values after one sweep less; greedy to other values."""
    got = {number.what: number.check(datasets) for number in FIGURE.numbers}
    assert all(check.ok for check in got.values())
    assert FIGURE.numbers[0].expected == -1.75
    for times in (0, 1, 2, 3, 10):
        v = swept(times)
        np.testing.assert_allclose(datasets[gpi.RANDOM].v.sel(sweeps=times), list(v.values()), atol=1e-12)
        best = greedy(v)
        for s, cell in enumerate(v):
            if cell not in ENDS:
                taken = datasets[gpi.RANDOM].greedy.sel(sweeps=times).values[s] > 0
                entered = list(neighbours(*cell))
                assert {entered[a] for a in np.flatnonzero(taken)} == set(best[cell])
        value = datasets[gpi.RANDOM].greedy_value.sel(sweeps=times)
        np.testing.assert_allclose(value, list(worth(best).values()), atol=1e-9)


@pytest.mark.parametrize("name", [gpi.EXACTLY, "3 sweeps", "1 sweep: value iteration"])
def test_its_iterates_of_easy21_are_those_of_plain_loops(name, datasets):
    ds = datasets[name].isel(improvement=slice(7))
    found = easy21(gpi.SWEEPS[name], ds.sizes["improvement"] - 1)
    best = easy21(None, 4)[-1][1]
    for n, (hit, v) in enumerate(found):
        np.testing.assert_allclose(ds.v[n][:210], v.ravel(), atol=1e-9)
        np.testing.assert_array_equal(ds.policy[n][:210, HIT], hit.ravel())
        assert ds.error[n] == pytest.approx(abs(v - best).max(), abs=1e-9)
        assert ds.start_value[n] == pytest.approx(v[:10].mean())


# --- solve --steps -----------------------------------------------------------------------------------


def rows(text):
    """The cells of the first table that was printed."""
    lines = text.partition("└")[0].splitlines()
    return [[cell.strip() for cell in line.split("│")[1:-1]] for line in lines if line.startswith("│")]


def test_steps_show_every_policy_on_the_way(capsys):
    assert main(["solve", "cliff-walking", "--steps"]) == 0
    text = capsys.readouterr().out
    assert "Policy iteration, from the policy that takes any action:" in text
    first, second, *_, last = rows(text)
    assert len(rows(text)) == 9
    assert first == ["0", "", "-65375.1", "", "65398.1"]
    assert second == ["1", "47", "-17", "0 to 65396.1", "4"] and last == ["8", "1", "-13", "0 to 2", "0"]
    assert "No action is better anywhere than those of policy 8: it is the best." in text
    grids = text.split("  policy ")[1:]
    assert [grid[0] for grid in grids] == list("012345678")
    beside = [next(line for line in grid.splitlines() if line.startswith("│2│")) for grid in grids]
    assert [line.count("↑") for line in beside] == [0, 8, 6, 5, 4, 3, 2, 1, 0]
    assert beside[0].count("any") == 12 and "S any" in grids[0]


def test_steps_by_sweeps_of_a_policy_that_explores(capsys):
    assert main(["solve", "windy-gridworld", "--steps", "--sweeps", "1", "--epsilon", "0.1"]) == 0
    optimal, soft = capsys.readouterr().out.split("windy-gridworld, ")[1:]
    assert "Value iteration, from v = 0:" in optimal and "Further sweeps change nothing." in optimal
    assert [row[2] for row in rows(optimal)] == [str(-n) for n in range(16)] + ["-15"]
    assert "policy 0" not in optimal  # too many to print
    assert "and 52 more: --json prints them all" in soft and len(rows(soft)) == 17
    assert rows(soft)[-1][0] == "68" and rows(soft)[-1][2] == "-17.0483"


def test_steps_that_have_not_settled_or_at_what_is_not_best_say_so(monkeypatch, capsys, tmp_path):
    moves, rewards = np.array([[0, 1], [2, 2], [2, 2]]), np.array([[0.0, 1], [-3, -3], [0, 0]])
    rl.FiniteMDP(np.eye(3)[moves], rewards, terminal=[2]).save(tmp_path / "wait.npz")
    assert main(["solve", str(tmp_path / "wait.npz"), "--steps", "--sweeps", "1"]) == 0
    said = "It has settled at values that are up to 1 off: from v = 0, waiting looks better than it is."
    assert said in capsys.readouterr().out
    cut = planning.generalized_policy_iteration(rl.RandomWalk(), sweeps=1, improvements=10)
    monkeypatch.setattr(planning, "generalized_policy_iteration", lambda *_, **__: cut)
    assert main(["solve", "random-walk", "--steps", "--sweeps", "1"]) == 0
    assert "After 10 improvements it has not settled: values are up to 0.39" in capsys.readouterr().out


def test_steps_as_json_and_as_pictures(capsys, tmp_path):
    argv = ["solve", "two-doors", "--steps", "--sweeps", "2", "--epsilon", "0.5", "--json"]
    assert main([*argv, "--out", str(tmp_path / "out")]) == 0
    found = json.loads(capsys.readouterr().out)
    for key, epsilon in (("optimal", 0.0), ("epsilon_soft", 0.5)):
        expected = planning.generalized_policy_iteration(rl.TwoDoors(), sweeps=2, epsilon=epsilon)
        assert (found[key]["sweeps"], found[key]["settled"]) == (2, True)
        steps = found[key]["steps"]
        assert [step["improvement"] for step in steps] == list(range(len(expected.v)))
        assert steps[0]["least_change"] is None and steps[1]["least_change"] == expected.least_change[1]
        for name in ("start_value", "changed", "error", "v", "q", "policy"):
            np.testing.assert_allclose([step[name] for step in steps], getattr(expected, name))
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"values.png", "gpi.png", "gpi_soft.png"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--sweeps 2", "--sweeps says how to make the steps that --steps shows; give both"),
        ("--steps --sweeps 0", "sweeps must be a whole number of at least 1, not 0"),
        ("--steps 3", "unexpected argument '3'"),
    ],
)
def test_wrong_steps_are_refused_in_one_line(words, message, capsys):
    assert main(["solve", "windy-gridworld", *words.split()]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and message in err


# --- pictures ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cliff-walking", "blackjack", "easy21", "random-walk", "two-doors"])
def test_iterates_are_drawn_as_people_see_the_states(name):
    env = rl.make(name)
    history = planning.generalized_policy_iteration(env, sweeps=None if env.num_states > 40 else 3)
    figure = plot.iterates(env, history, "title")
    assert figure.get_figwidth() <= plot.WIDTH
    shown = {text.get_text() for text in figure.findobj(Text)}
    n = len(history.v) - 1
    assert any(f"policy {n}" in text or text == "policy" for text in shown)
    if name == "cliff-walking":
        titles = [ax.get_title() for ax in figure.axes]
        assert (
            titles[0] == "policy 0\nfrom the start −65375.1"
            and titles[8] == "policy 8: 1 changed\nfrom the start −13"
        )
        assert figure.axes[8].images[0].get_clim() == (-14, -1)
    if name == "two-doors":
        np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), history.v[:, 0])
    if name == "random-walk":
        np.testing.assert_array_equal(figure.axes[0].lines[-1].get_ydata(), history.v[-1][1:-1])


def test_the_zigzag_lies_between_its_lines():
    """On the upper line where v = v_pi, on the lower one where pi is greedy; exact improvements go straight down."""
    history = planning.generalized_policy_iteration(rl.Easy21())
    ax = plot.canvas(4).subplots()
    plot.zigzag(ax, history.zigzag)
    x, y = ax.lines[0].get_data()
    upper, lower = (line.get_data() for line in ax.lines[1:3])
    for i in range(len(x) - 1):
        line = lower if i % 2 else upper
        assert y[i] == pytest.approx(np.interp(x[i], *line))
    np.testing.assert_allclose(x[:-1:2], x[1::2])
    np.testing.assert_allclose((x[-1], y[-1]), 0, atol=1e-4)
    np.testing.assert_allclose(x**3, -history.zigzag.sum(1), atol=1e-12)


# --- docs/gpi.md -------------------------------------------------------------------------------------


def blocks(language):
    page = (ROOT / "docs/gpi.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def test_the_page_shows_what_its_script_prints(capsys):
    """Broken once: a number of the page changed -> fails."""
    runpy.run_path(str(ROOT / "examples/gpi.py"))
    assert capsys.readouterr().out == blocks("text")[0]


def test_its_python_runs():
    for code in blocks("python"):
        names = {}
        exec(code, names)
        assert names["history"].settled


def test_wide_grids_are_whole_in_a_file_and_a_narrow_window_is_told():
    """Broken once: printed as wide as the console is -> columns are missing, unsaid."""
    env = rl.TraceGridworld(shape=(1, 40), start=(0, 0), goal=(0, 39))
    _, v, q = planning.policy_iteration(env)
    tables.show(Console(file=(file := io.StringIO()), width=60), *tables.tables(env, v, q))
    top = file.getvalue().splitlines()[1]
    assert [int(x) for x in top.replace("┃", " ").split()] == list(range(40))
    window = Console(file=(file := io.StringIO()), width=60, force_terminal=True, color_system=None)
    tables.show(window, *tables.tables(env, v, q))
    assert "The window is too narrow, and cuts columns off: 243" in file.getvalue()
