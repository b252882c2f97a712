"""Schedules of optax, given as functions and as they are typed."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
import pytest
import tiny

import jaxrl_tab as rl
from jaxrl_tab import schedules
from jaxrl_tab.cli import main
from jaxrl_tab.core import policies
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import provenance
from jaxrl_tab.experiment.spec import Experiment

COSINE = "optax:cosine_decay_schedule(0.5,8)"
LINEAR = "optax:linear_schedule(0.5,0.1,transition_steps=4):episode"


def test_values_by_hand():
    """Half of 1/2 (1 + cos(pi k / 8)) at count k = n - 1. Broken once: the count not begun at 0 -> fails."""
    cosine, linear = schedules.parse(COSINE), schedules.parse(LINEAR)
    assert (cosine.clock, linear.clock) == ("step", "episode")
    wants = [0.25 * (1 + math.cos(math.pi * k / 8)) for k in range(9)]
    np.testing.assert_allclose(jax.vmap(cosine)(jnp.arange(1, 10)), wants, atol=1e-7)
    np.testing.assert_allclose([linear(jnp.int32(n)) for n in (1, 2, 5, 99)], [0.5, 0.4, 0.1, 0.1], rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        (COSINE, COSINE),
        (LINEAR, LINEAR),
        (f"{COSINE}:step", COSINE),
        ("optax:exponential_decay( .5, 1e2, 1, staircase=True)", "optax:exponential_decay(0.5,100.0,1,staircase=True)"),
        ("optax:linear-schedule(1, 0, 3, transition-begin=1e-1)", "optax:linear_schedule(1,0,3,transition_begin=0.1)"),
        ("optax:linear_schedule(+1, -0x10, 3):visit", "optax:linear_schedule(+1,-16,3):visit"),
    ],
)  # fmt: skip
def test_what_is_printed_is_what_is_typed(text, printed):
    """And what is typed twice is one program. Broken once: the function kept in place of the text -> fails."""
    schedule = schedules.parse(text)
    assert str(schedule) == schedules.typed(schedule) == printed
    again = schedules.parse(printed)
    assert str(again) == printed and jax.tree.structure(again) == jax.tree.structure(schedule)


def test_a_function_cannot_be_typed():
    assert str(schedules.Optax(abs)) == "Optax(schedule=<built-in function abs>, clock='step')"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("optax", "'optax' is not of the form optax:NAME(NUMBERS)[:CLOCK], where CLOCK is one of step,"),
        (f"{COSINE}:step:step", "is not of the form optax:NAME(NUMBERS)[:CLOCK]"),
        (f"{COSINE}:day", "clock 'day' is unknown; choose one of step, episode, visit"),
        ("optax:cosine_decay(1, 8)", "no schedule 'cosine_decay'; did you mean 'cosine_decay_schedule'?"),
        ("optax:join_schedules(1, 2)", "optax has no schedule 'join_schedules'"),
        ("optax:adam(0.1)", "optax has no schedule 'adam'; choose one of constant_schedule, "),
        ("optax:linear_schedule(1)", "'end_value' and 'transition_steps'; linear_schedule takes init_value, "),
        ("optax:linear_schedule(1, 0, steps=3)", "argument 'steps'; linear_schedule takes init_value, end_v"),
        ("optax:cosine_decay_schedule(1, -8)", "requires positive decay_steps, got decay_steps=-8"),
        ("optax:constant_schedule(1" + 400 * "0" + ")", "...; constant_schedule takes value"),
        *(
            (f"optax:{text}", "is not the name of a schedule in optax with its numbers in parentheses, such as")
            for text in (
                "",
                "linear_schedule",
                "linear_schedule(1, 0, 3",
                "linear_schedule(1, 0, '3')",
                "linear_schedule(1, 0, 3j)",
                "linear_schedule(1, 0, 1 + 2)",
                "linear_schedule(1, 0, 1e999)",
                "linear_schedule(1, 0, None)",
                "linear_schedule(1, 0, exit())",
                "linear_schedule(*[1, 0, 3])",
                "linear_schedule(1, 0, 2, transition_begin=1, transition_begin=2)",
                "optax.linear_schedule(1, 0, 3)",
                "__import__('os').getcwd()",
                "linear_schedule" + 9000 * "(",
                "linear_schedule(" + 9000 * "-" + "1)",
            )
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(text, message):
    """Broken once: `eval` in place of `literal_eval`, no trial of the schedule, or infinite numbers -> fails."""
    with pytest.raises(InputError) as error:
        schedules.parse(text)
    assert message in str(error.value) and "\n" not in str(error.value) and len(str(error.value)) < 500


def test_nothing_can_be_told_about_its_limit():
    for judge in (schedules.is_glie, schedules.is_robbins_monro):
        with pytest.raises(InputError, match=r"cannot tell of an arbitrary function \(Optax\)"):
            judge(schedules.parse(COSINE))


def test_a_policy_takes_it():
    """Names may be typed with hyphens or underscores. Broken once: hyphens left in the name -> fails."""
    policy = policies.parse(f"epsilon-greedy:{COSINE}:visit")
    assert str(policy) == f"epsilon-greedy:{COSINE}:visit"
    method = {"name": "sarsa", "behaviour": [f"epsilon_greedy:{COSINE}", "epsilon_greedy:sample_average"]}
    (table,) = Experiment("two-doors", method, steps=9).method
    assert table["behaviour"] == [f"epsilon-greedy:{COSINE}", "epsilon-greedy:sample-average"]


def test_numbers_depend_on_the_version_of_optax():
    """Kept programs and folders of other versions are told apart. Broken once: its version left out -> fails."""
    assert provenance.installed()["optax"] == optax.__version__


@pytest.mark.slow
def test_from_the_command_line_to_the_results_and_back(tmp_path):
    """Bitwise the runs with optax's own functions; a folder holds them, and `resume` computes what is missing.

    Broken once: the clock left out of the text -> fails.
    """
    folder = tmp_path / "run"
    sizes = ["--seeds", "3", "--steps", "60", "--out", str(folder)]
    with tiny.small():
        assert main(["sweep", "two-doors", "sarsa", "--alpha", COSINE, LINEAR, *sizes]) == 0
        before = tiny.numbers(folder)
        (folder / "shards" / "000001.npz").unlink()
        assert main(["resume", str(folder)]) == 0
    tiny.check_the_same(folder, before)
    alpha = [
        schedules.Optax(optax.cosine_decay_schedule(0.5, 8)),
        schedules.Optax(optax.linear_schedule(0.5, 0.1, 4), clock="episode"),
    ]
    own = rl.sweep(rl.make("two-doors"), "sarsa", {"alpha": alpha}, num_seeds=3, num_steps=60).to_xarray()
    np.testing.assert_array_equal(before["q"], own.q)
    assert before["alpha"].tolist() == pd.read_csv(folder / "summary.csv").alpha.tolist() == [COSINE, LINEAR]
    loaded = Experiment.load(folder / "experiment.toml").data()
    assert loaded == json.loads((folder / "resolved.json").read_text())
    assert loaded["method"][0]["alpha"] == [COSINE, LINEAR]
