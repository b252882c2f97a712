"""`jaxrl-tab schedule`: what a step size or an exploration rate comes to, against plain formulas."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

from jaxrl_tab import plot, schedules
from jaxrl_tab.cli import main
from jaxrl_tab.show.rates import COUNTS, LONGEST, curve, study

N = np.arange(1, LONGEST + 1, dtype=float)
# As typed: its value for n, whether its sum is infinite, whether that of its squares is, GLIE, Robbins and Monro.
FORMULAS = {
    "glie": (1 / N, True, False, True, True),
    "sample-average": (1 / N, True, False, True, True),
    "harmonic:100:visit": (100 / (99 + N), True, False, True, True),
    "power:0.5:1:step": (N**-0.5, True, True, True, False),
    "power:2:0.5:episode": (0.5 / N**2, False, False, False, False),
    "linear:1:0.05:500:episode": (np.maximum(1 - 0.95 * (N - 1) / 500, 0.05), True, True, False, False),
    "linear:1:0:10:visit": (np.maximum(1 - (N - 1) / 10, 0), False, False, False, False),
    "exponential:1:0.99:0:step": (0.99 ** (N - 1), False, False, False, False),
    "exponential:0.5:0.9:0.1:step": (np.maximum(0.5 * 0.9 ** (N - 1), 0.1), True, True, False, False),
    "unbiased:0.1:visit": (0.1 / (1 - 0.9**N), True, True, False, False),
    "0.1": (np.full(LONGEST, 0.1), True, True, False, False),
    "0": (np.zeros(LONGEST), False, False, False, False),
}


@pytest.fixture(scope="module")
def studies():
    return {name: study(name) for name in FORMULAS}


@pytest.mark.parametrize("name", FORMULAS)
def test_its_numbers_are_those_of_the_formula(name, studies):
    """Broken once, each -> fails: n from 0; float32; the squares of the sums."""
    one, (values, *known) = studies[name], FORMULAS[name]
    np.testing.assert_allclose(one.values, values, rtol=1e-9, atol=1e-12)
    rows = one.rows()
    for k, n in enumerate(COUNTS[:5]):
        first = values[:n]
        wanted = [first[-1], sum(first.tolist()), sum((first**2).tolist())]
        np.testing.assert_allclose([x[k] for x in rows.values()], wanted, rtol=1e-9, atol=1e-12)
    told = [one.sum_is_infinite, one.squares_are_infinite, one.glie.holds, one.robbins_monro.holds]
    assert told == known
    assert one.name == name
    rate = schedules.read(name)
    assert one.glie == tuple(schedules.is_glie(rate))
    assert one.robbins_monro == tuple(schedules.is_robbins_monro(rate))


def test_in_a_narrow_window_the_curve_is_narrow(studies):
    """Broken once: as wide as ever -> fails."""
    one = [studies["glie"]]
    assert max(map(len, curve(one))) > 60 and max(map(len, curve(one, 50))) <= 50
    *lines, axis, below = curve(one, 50)
    assert below.split() == [*(f"1e{k}" for k in range(7)), "n"]
    places = [i for i, sign in enumerate(axis) if sign == "┴"]
    assert [lines[2 * k][x] for k, x in enumerate(places[:6])] == ["o"] * 6  # 1/n is 1e-k at 1ek


@pytest.mark.parametrize(
    "name", ["glie", *(x for x in FORMULAS if x.startswith(("harmonic", "power", "exp", "unbiased")))]
)
def test_the_formula_that_is_shown_is_right(name, studies):
    """It is computed, as it is written. Broken once: "n" for "n - 1" in `Harmonic` -> fails."""
    formula, _, least = studies[name].formula.partition(", but never below ")
    python = re.sub(r"(\d) (?=\d)", r"\1 * ", formula.replace("^", "**"))
    got = np.maximum(eval(python, {"n": N}), float(least or 0))
    np.testing.assert_allclose(studies[name].values, got, rtol=1e-9, atol=1e-300)


def test_a_straight_line_is_told_in_words(studies):
    line = studies["linear:1:0.05:500:episode"]
    assert line.formula == "from 1 at n = 1 in a straight line to 0.05 at n = 501, and 0.05 from then on"
    assert line.values[[0, 499, 500]].tolist() == pytest.approx([1, 0.0519, 0.05])


def test_of_a_function_nobody_can_tell():
    cosine = study("optax:cosine_decay_schedule(0.5,8000)")
    np.testing.assert_allclose(
        cosine.values[:8000], 0.25 * (1 + np.cos(np.pi * (N[:8000] - 1) / 8000)), atol=1e-7
    )
    mine = study(schedules.Optax(lambda count: 1 / (count + 1), clock="visit"))
    for one in (cosine, mine):
        assert (
            one.sum_is_infinite
            is one.squares_are_infinite
            is one.glie.holds
            is one.robbins_monro.holds
            is None
        )
        assert "cannot be told" in one.sums
        assert one.robbins_monro.answer == "cannot be told"


def test_what_is_above_one_is_no_exploration_rate():
    """As a step size it may be right. Broken once: only the first value looked at -> fails for the function."""
    for one in (study(2), study("power:1:20:episode"), study(schedules.Optax(lambda count: 0.1 * count))):
        assert one.glie.holds is None
        assert "it is no exploration rate, for its largest value is" in one.glie.why
    assert study("power:1:20:episode").robbins_monro.holds


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (jnp.ones(2), "a step size or an exploration rate is a number of at least 0, not"),
        (None, "is a number of at least 0, not None"),
        ("optax:cosine_decay(1,2)", "optax has no schedule 'cosine_decay'; did you mean"),
        (-1, "is a number of at least 0, not -1"),
        (schedules.Optax(lambda count: 1 / (count - 4.0)), "is no number at n = 5, but inf"),
    ],
)
def test_what_is_no_rate_is_refused(rate, message):
    refused(lambda: study(rate), message)


# --- on the command line -------------------------------------------------------------------------------

CURVE = """
   1 │o  o ooooooooooooo
     │x  x xxxxxxxx     ooo
     │             xxxxxx  oo
     │                   xxx
 0.1 │                      x
     │                       oooooooooooooooooooooooooooooooooooooo
     │                        x
     │                         x
0.01 │                          xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx
     └┴─────────┴─────────┴─────────┴─────────┴─────────┴─────────┴
      1         10        100       1 000     10 000    100 000   1 000 000  n
"""


def test_the_command_tells_all_of_it(capsys):
    command = ["schedule", "harmonic:100:visit", "glie", "0.1"]
    assert main(command) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    (row,) = [line for line in lines if line.startswith("│ harmonic:100:visit ")]
    assert [cell.strip() for cell in row.split("│")[2:6]] == ["value", "1", "0.9174", "0.5025"]
    at = lines.index("glie (harmonic:1:episode): 1 / n; n counts episodes")
    assert lines[at + 1] == "  Over all n its sum is infinite, and that of its squares finite."
    assert lines[at + 2].startswith(
        "  As ε, GLIE: yes: epsilon falls like 1/n, to 0, and its sum is infinite:"
    )
    assert lines[at + 3].startswith(
        "  As α, Robbins and Monro: yes: alpha falls like 1/n, so its sum is infinite"
    )
    assert lines[-3:] == [
        "  Over all n its sum is infinite, and that of its squares infinite.",
        "  As ε, GLIE: no: epsilon stays at 0.1: it explores for ever, but it never becomes greedy.",
        "  As α, Robbins and Monro: no: alpha stays at 0.1, so the sum of its squares is infinite: noise never dies "
        "down.",
    ]
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["schedules"]
    assert [one["schedule"] for one in found] == command[1:]
    np.testing.assert_allclose(found[1]["sums"][:3], [1, 7381 / 2520, 5.187377517639621])
    assert found[1]["n"] == list(COUNTS)
    assert found[2]["glie"] == {"holds": False, "why": schedules.is_glie(0.1).why}


def test_the_curves_in_a_terminal(capsys):
    """At n = 100 they are 0.5298 and 0.1849: 1.1 and 2.9 lines below 1, of which four are a power of ten.

    Broken once: two lines to a power of ten -> fails. What is named twice is shown once.
    """
    main(["schedule", "linear:1:0.05:200:step", "exponential:0.5:0.99:0.01:step", "linear:1:0.05:200:step"])
    text = capsys.readouterr().out
    assert CURVE.strip("\n") in text, text
    assert "\n  o linear:1:0.05:200:step   x exponential:0.5:0.99:0.01:step\n" in text
    main(["schedule", "0"])
    assert "└┴" not in capsys.readouterr().out  # nothing to draw


def test_the_picture_shows_the_same_values(tmp_path, studies):
    figure = plot.schedules([studies["glie"], "0.1", "linear:1:0:10:visit"])
    (ax,) = figure.axes
    lines = {line.get_label().partition(" ")[0]: line for line in ax.lines}
    n, y = lines["glie"].get_data()
    np.testing.assert_allclose(y, 1 / n)
    assert n[[0, -1]].tolist() == [1, LONGEST]
    n, y = lines["linear:1:0:10:visit"].get_data()
    assert np.isfinite(y).sum() == (n <= 10).sum()
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts[:2] == [
        "glie (GLIE: yes; Robbins and Monro: yes)",
        "0.1 (GLIE: no; Robbins and Monro: no)",
    ]
    assert main(["schedule", "0.1", "--out", str(tmp_path / "new")]) == 0
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["schedules.png"]
