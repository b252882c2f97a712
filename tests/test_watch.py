"""An episode step by step, and learning over time: what is watched is what was learned."""

import dataclasses
import io
import itertools
import re
import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from marks import slow_but
from PIL import Image
from rich.console import Console

import jaxrl_tab as rl
from jaxrl_tab.cli import main, tables
from jaxrl_tab.cli import watch as command
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.steps import Change, Seen, Steps
from jaxrl_tab.engine import stepwise
from jaxrl_tab.engine import watch as module
from jaxrl_tab.methods import METHODS
from jaxrl_tab.show.states import state_names
from jaxrl_tab.show.steps import Told

ROOT, SEED = 3, 2


def key_of(root=ROOT, seed=SEED):
    return jax.random.fold_in(jax.random.key(root), seed)


def watched(env, method, **more):
    return rl.watch(env, method, **{"seed": SEED, "root_seed": ROOT} | more)


def bits(x):
    return np.asarray(x).tobytes()


# --- what is learned ---------------------------------------------------------------------------------


SOME = ["sarsa", "double-q-learning", "monte-carlo", "sarsa-lambda", "off-policy-td"]


@pytest.mark.usefixtures("optimised")  # what XLA makes of a sum of products else is not what a sweep has
@pytest.mark.parametrize("name", slow_but(SOME, METHODS))
def test_each_method_learns_what_it_learns_in_a_sweep(name):
    """To the last bit, with a step size that is no binary fraction; and nothing that it learns is left out.

    Broken once: changes since the beginning of the episode; an argument of `learn` that is not handed on -> fails.
    """
    declared = of_method(METHODS[name])
    goes_on = declared.in_the_long_run
    env = rl.make("chain", max_steps=20) if goes_on else rl.make("random-walk", states=5)
    env = rl.FiniteHorizon(env, 9) if declared.needs_horizon else env
    # Every step changes something.
    has_first_value = declared.learns.initial in {f.name for f in dataclasses.fields(METHODS[name])}
    initial = {declared.learns.initial: 0.5} if has_first_value and not declared.needs_horizon else {}
    grid = initial | {"gamma": 1.0 if goes_on else 0.9}
    by_step_size = isinstance(getattr(METHODS[name](), "alpha", None), float)
    grid |= {"alpha": 0.37} if by_step_size else {}
    seen = watched(env, METHODS[name](**grid), num_episodes=9, at=1)
    swept = rl.sweep(env, name, grid, num_seeds=SEED + 1, num_episodes=1, seed=ROOT)
    assert bits(seen.q) == bits(swept.q[SEED])
    assert len(seen.steps) == swept.log.lengths[SEED, -1]
    q = seen.before.copy()
    for change in seen.steps.changes:
        assert bits(q[change.s, change.a]) == bits(change.before)
        q[change.s, change.a] = change.after
    assert bits(q) == bits(seen.q)


CASES = {
    "the first episode": (rl.make("trace-gridworld"), rl.Sarsa(alpha=0.37), 1),
    "problems of their own": (rl.make("k-armed-testbed"), rl.QLearning(alpha=0.37, gamma=0.0), 5),
    "exploring starts": (rl.make("random-walk", states=5), rl.MonteCarlo(exploring_starts=True), 4),
    "a time limit": (rl.make("windy-gridworld", max_steps=5), rl.QLearning(), 3),
}


@pytest.mark.parametrize("case", slow_but(["the first episode", "a time limit"], CASES))
def test_the_steps_are_those_of_the_run(case):
    """As `collect` logs them, and the state of the learner is that of `train`, to the last bit.

    Broken once: S' taken from the run, where the next episode has begun; the first state of the episode drawn with
    the words of one step later -> fails.
    """
    env, method, at = CASES[case]
    episode = watched(env, method, num_episodes=at)
    seen = episode.steps.experience
    state, log = rl.train(key_of(), method, env, num_episodes=at)
    end = int(log.steps.sum())
    logged = rl.collect(key_of(), method, env, end)
    for name in ("s", "a", "r", "s_next", "terminal", "last"):
        assert bits(getattr(seen, name)) == bits(getattr(logged, name)[end - len(seen.s) :]), name
    assert [bits(x) for x in jax.tree.leaves(episode.learner)] == [bits(x) for x in jax.tree.leaves(state)]


def by_hand(seen, target):
    """The errors of one-step updates by a plain loop, and the table after them."""
    q, errors = seen.before.astype(float), []
    x = seen.steps.experience
    for i, (s, a, r, s_next, terminal) in enumerate(zip(x.s, x.a, x.r, x.s_next, x.terminal, strict=True)):
        a_next = x.a[i + 1] if i + 1 < len(x.a) else 0
        column = a if q.shape[1] > 1 else 0
        errors.append(r + (0 if terminal else 0.9 * target(q[s_next], a_next)) - q[s, column])
        q[s, column] += 0.37 * errors[-1]
    return np.array(errors), q


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("env", "method", "target"),
    [
        ("cliff-walking", rl.QLearning, lambda row, _: row.max()),
        ("cliff-walking", rl.Sarsa, lambda row, a: row[a]),
        ("random-walk", rl.prediction.TD, lambda row, _: row[0]),
    ],
)
def test_the_error_is_that_of_the_book(env, method, target):
    """Worked out by a plain loop over the steps. Broken once: the error of the step before -> fails."""
    seen = watched(rl.make(env), method(alpha=0.37, gamma=0.9), num_episodes=4)
    errors, q = by_hand(seen, target)
    assert len(errors) > 5 and np.ptp(errors) > 0.4
    np.testing.assert_allclose(seen.steps.delta, errors, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(seen.q, q, rtol=1e-4, atol=1e-4)
    assert all(len(change.s) <= 1 for change in seen.steps.changes)


def test_where_a_method_learns_from_no_one_error_there_is_none():
    seen = watched(rl.make("random-walk"), rl.MonteCarlo(), num_episodes=2)
    assert np.isnan(seen.steps.delta).all()
    assert [len(change.s) > 0 for change in seen.steps.changes] == [False] * (len(seen.steps) - 1) + [True]
    assert "error" not in " ".join(seen.told.head)


@pytest.mark.parametrize("episodes", [3, 450])
def test_over_time_there_are_the_tables_of_the_run(episodes):
    """Bitwise those of shorter runs. Broken once: one row later -> fails."""
    env, method = rl.make("random-walk", states=5), rl.QLearning(alpha=0.37, q0=0.5)
    seen = watched(env, method, num_episodes=episodes, at=1)
    moments, tables = seen.over_time
    assert moments[0] == 0 and moments[-1] == episodes and (np.diff(moments) > 0).all()
    assert len(moments) == len(tables) <= module.MOMENTS + 1
    np.testing.assert_array_equal(tables[0], np.full((7, 1), 0.5))
    for i in (1, -1):
        state, _ = rl.train(key_of(), method, env, num_episodes=int(moments[i]))
        assert bits(tables[i]) == bits(state.q)


def test_the_last_episode_is_watched_unless_another_is_named():
    env, method = rl.make("random-walk", states=5), rl.QLearning()
    last, fifth = watched(method, env, num_episodes=5), watched(env, method, num_episodes=9, at=5)
    assert (last.at, fifth.at) == (5, 5)
    assert bits(last.q) == bits(fifth.q)


# --- what is told of it ------------------------------------------------------------------------------


def made_up(count, learns=Learns.ACTIONS, changed=(0,)):
    """An episode along the top row of the windy gridworld, to the right and back, that changes some states."""
    s = np.arange(count) % 2
    last = np.arange(count) == count - 1
    seen = rl.Experience(s, 1 + 2 * s, np.full(count, -1.0), 1 - s, last, last)
    states = np.array(changed)
    change = Change(states, 0 * states + 1, 0.0 * states, -0.5 - states)
    return Told(rl.make("windy-gridworld"), Steps(seen, np.full(count, -1.0), (change,) * count), learns, 0.5)


def test_a_step_is_told_in_a_row():
    assert made_up(3).head == (
        "step",
        "state S",
        "action A",
        "reward R",
        "next state S'",
        "error δ",
        "what changed",
    )
    assert made_up(3).row(0) == ("1", "(0, 0)", "→", "−1", "(0, 1)", "−1", "Q(S, A): 0 to −0.5")
    assert made_up(3).row(1)[1:] == ("(0, 1)", "←", "−1", "(0, 0)", "−1", "Q((0, 0), →): 0 to −0.5")
    of_states = made_up(3, Learns.STATES)
    assert [of_states.row(i)[-1] for i in (0, 1)] == ["V(S): 0 to −0.5", "V((0, 0)): 0 to −0.5"]


def test_of_many_changes_the_largest_are_named():
    """Broken once: the first ones instead -> fails."""
    told = made_up(1, changed=(0, 2, 4, 12, 3)).row(0)[-1]
    assert told == "Q((1, 2), →): 0 to −12.5, Q((0, 4), →): 0 to −4.5, and 3 more"
    assert made_up(1, changed=np.empty(0, int)).row(0)[-1] == "nothing"


@pytest.mark.parametrize(("count", "left_out"), [(1, 0), (30, 0), (31, 11), (1250, 1230)])
def test_of_a_long_episode_the_middle_is_left_out(count, left_out):
    """Broken once: one step told twice -> fails."""
    rows = list(made_up(count).rows())
    numbers = [row[0] for row in rows]
    if not left_out:
        assert numbers == [str(i) for i in range(1, count + 1)]
    else:
        assert numbers == [*map(str, range(1, 11)), "…", *map(str, range(count - 9, count + 1))]
        assert rows[10] == ("…", "", "", "", "", "", f"{left_out:,} steps are left out".replace(",", " "))


def test_how_an_episode_ends():
    assert made_up(3).end == "It ends in a terminal state after 3 steps; its return is −1.75."
    cut = watched(rl.make("windy-gridworld", max_steps=5), rl.QLearning(), num_episodes=1)
    assert cut.told.end == "It ends at the time limit after 5 steps; its return is −5."
    one = watched(rl.make("two-doors"), rl.QLearning(), num_episodes=1)
    assert "in a terminal state after 1 step;" in one.told.end


def test_states_have_the_names_that_people_know():
    blackjack = rl.make("blackjack")
    name = state_names(blackjack)
    assert name(blackjack.state(13, 2, usable=True)) == "player 13, dealer shows 2, usable ace"
    assert name(blackjack.state(20, 1)) == "player 20, dealer shows A, no usable ace"
    assert name(blackjack.num_states - 1) == "end"
    assert state_names(rl.make("windy-gridworld"))(37) == "(3, 7)"
    assert state_names(rl.make("random-walk"))(7) == "7"


def test_what_is_watched_has_a_short_repr(windy):
    seen = watched(windy, rl.Sarsa(alpha=0.5), num_episodes=2)
    assert repr(seen) == (
        "<Watched: Sarsa, α = 0.5, ε = 0.1, γ = 1, q0 = 0, in Windy gridworld: episode 2 of 2, seed 2, "
        f"{len(seen.steps)} steps>"
    )


@rl.pytree
class Tagged(rl.WindyGridworld):
    """An environment whose names are HTML."""

    @property
    def action_names(self):
        return ("<script>alert(1)</script>", "<b>", "&", "'\"")


Tagged.__name__ = "<script>alert(0)</script>"


def check_nothing_is_injected(page, scripts):
    """Broken once: `autoescape=False` -> fails."""
    assert page.count("<script>") == scripts and "alert(" in page and "<b>&" not in page
    assert not re.search(r"<script>alert", page)


def test_in_a_notebook_it_shows_its_steps_and_names_inject_nothing():
    seen = watched(Tagged(max_steps=100), rl.Sarsa(), num_episodes=1)
    page = seen._repr_html_()
    check_nothing_is_injected(page, scripts=0)
    assert page.count("<tr>") == 1 + 10 + 1 + 10
    assert "80 steps are left out" in page and seen.told.end in page


# --- the animation -----------------------------------------------------------------------------------


def test_learning_over_time_is_written_as_an_animation(tmp_path):
    """Broken once: the last picture left out -> fails."""
    seen = watched(Tagged(max_steps=100), rl.Sarsa(), num_episodes=3)
    assert seen.save(tmp_path / "learning.gif") == tmp_path / "learning.gif"
    seen.save(str(tmp_path / "learning.html"))
    with Image.open(tmp_path / "learning.gif") as gif:
        assert gif.n_frames == 4
        pictures = []
        for i in range(4):
            gif.seek(i)
            pictures.append(np.asarray(gif.convert("RGB")))
            assert gif.info["duration"] == (3000 if i == 3 else 250)
    assert all((x != y).any() for x, y in itertools.pairwise(pictures))
    page = (tmp_path / "learning.html").read_text()
    check_nothing_is_injected(page, scripts=1)
    assert len(set(re.findall(r'"(data:image/png;base64,[^"]*)"', page))) == 4
    assert '["after 0 of 3 episodes","after 1 of 3 episodes"' in page
    assert '<img id="picture" src="data:image/png' in page  # without JavaScript: what was learned by the end


@pytest.mark.parametrize(
    ("env", "method"),
    [
        pytest.param(rl.make("easy21"), rl.MonteCarlo(), marks=pytest.mark.slow),
        (rl.make("trace-gridworld", max_steps=40), rl.prediction.TD()),
        (rl.make("two-doors"), rl.prediction.TD()),
    ],
)
def test_each_kind_of_environment_has_pictures(env, method, tmp_path):
    seen = watched(env, method, num_episodes=1)
    with Image.open(seen.save(tmp_path / "learning.gif")) as gif:
        assert gif.n_frames == 2


@rl.pytree
class Endless:
    """An environment that can only be sampled."""

    num_states, num_actions, max_steps = 2, 1, 4

    def reset(self, key):
        return jnp.int32(0)

    def step(self, key, s, a):
        return rl.Outcome(jnp.int32(1), jnp.float32(-1), jnp.bool(False))


def test_what_has_no_picture_is_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "train", None)  # nothing is computed for it
    sampled = watched(Endless(), rl.QLearning(), num_episodes=1)
    assert len(sampled.steps) == 4
    large = dataclasses.replace(sampled, env=rl.make("random-walk", states=999))
    (tmp_path / "there.gif").touch()
    for seen, name, said in (
        (sampled, "learning.gif", "there is no picture of Endless, which does not state its outcomes"),
        (large, "learning.gif", "there is no picture of RandomWalk: it has 1001 states, more than 500"),
        (large, "learning.png", "an animation is a file that ends in .gif or .html, not .*learning.png"),
        (large, "there.gif", "there.gif exists already; name a new file"),
        (large, "nowhere/learning.gif", "cannot be written: there is no folder .*nowhere"),
    ):
        with pytest.raises(rl.InputError, match=said):
            seen.save(tmp_path / name)
    assert [file.name for file in tmp_path.iterdir()] == ["there.gif"]


# --- what is refused ---------------------------------------------------------------------------------


@pytest.fixture
def nothing_compiled(monkeypatch):
    """Whoever computes something fails."""
    for where, name in ((module, "train"), (stepwise, "at_start"), (stepwise, "next_step")):
        monkeypatch.setattr(where, name, None)


PI = np.full((1, 70, 4), 0.25)
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "at 0": ({"at": 0}, "watch: at must be a whole number of at least 1, not 0"),
    "at beyond": ({"at": 21}, "watch: episode 21 is beyond the 20 episodes of the run: let it have more"),
    "no episodes": ({"num_episodes": 0}, "watch: num_episodes must be a whole number of at least 1, not 0"),
    "seed": ({"seed": -1}, "watch: seed must be a whole number of at least 0, not -1"),
    "root": ({"root_seed": 0.5}, "watch: root_seed must be a whole number of at least 0, not 0.5"),
    "a batch": ({"algorithm": rl.Sarsa(alpha=np.ones(2))}, "Sarsa: alpha"),
    "a class": ({"algorithm": rl.Sarsa}, "algorithm must be an instance, such as Sarsa"),
    "a name": ({"algorithm": "sarsa"}, "algorithm must be an instance, such as Sarsa"),
    "no method": ({"algorithm": {}}, "algorithm must be a method such as Sarsa(), not {}"),
    "no environment": ({"env": None}, "env must be an environment such as make('windy-gridworld'), not None"),
    "several tables": ({"algorithm": rl.ManyTargets(targets=PI)}, "ManyTargets has several"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_refused_before_anything_is_compiled(case, windy, nothing_compiled):
    wrong, said = WRONG[case]
    with pytest.raises(rl.InputError) as error:
        rl.watch(**{"env": windy, "algorithm": rl.Sarsa(), "num_episodes": 20} | wrong)
    assert said in str(error.value) and "\n" not in str(error.value)


REFUSALS = {
    "": "name an environment: windy-gridworld",
    "windy-gridworld": "name a method: sarsa",
    "windy-gridwrld sarsa": "did you mean 'windy-gridworld'?",
    "windy-gridworld sarsaa": "did you mean 'sarsa'?",
    "windy-gridworld sarsa q-learning": "unexpected argument 'q-learning'",
    "windy-gridworld sarsa --at 0": "watch: at must be a whole number of at least 1, not 0",
    "windy-gridworld sarsa --at 501": "episode 501 is beyond the 500 episodes of the run",
    "windy-gridworld sarsa --at last": "--at takes a whole number, not 'last'",
    "windy-gridworld sarsa --lam 0.5": "sarsa has no --lam, which belongs to",
    "windy-gridworld sarsa --alpha 0": "sarsa: alpha must be greater than 0, not 0.0",
    "windy-gridworld sarsa --moves knight": "did you mean 'king'?",
    "windy-gridworld sarsa --gif a.html": "--gif names a file that ends in .gif",
    "windy-gridworld sarsa --html a.png": "ends in .gif or .html, not a.png",
    "random-walk td --states 999 --gif a.gif": "there is no picture of RandomWalk: it has 1001 states",
}


@pytest.mark.parametrize("typed", REFUSALS)
def test_the_command_refuses_in_one_line(typed, capsys, nothing_compiled):
    assert main(["watch", *typed.split()]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("jaxrl-tab: ") and printed.err.count("\n") == 1
    assert REFUSALS[typed] in printed.err


# --- the command -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_all_steps_where_nobody_looks_on(capsys, tmp_path):
    """Those of the library, of the same run. Broken once: `seed` and `root_seed` exchanged -> fails."""
    file = tmp_path / "learning.gif"
    options = ["--alpha", "0.5", "--episodes", "4", "--at", "2", "--seed", "2", "--root-seed", "3"]
    assert (
        main(
            [
                "watch",
                "windy-gridworld",
                "sarsa",
                "--moves",
                "king",
                "--max-steps",
                "50",
                *options,
                "--gif",
                str(file),
            ]
        )
        == 0
    )
    lines = capsys.readouterr().out.splitlines()
    seen = watched(
        rl.make("windy-gridworld", moves="king", max_steps=50), rl.Sarsa(alpha=0.5), num_episodes=4, at=2
    )
    assert lines[0] == f"{seen.name}: episode 2 of 4, seed 2"
    told = iter(lines)
    for row in seen.told.rows():
        assert any(all(cell in line for cell in row) for line in told), row  # in this order
    assert seen.told.end in lines
    assert any(line.endswith("learning.gif: what it learns over time") for line in lines)
    assert file.read_bytes().startswith(b"GIF89a")


def test_in_a_terminal_the_steps_are_played_one_by_one(monkeypatch, capsys):
    """Broken once: no pause -> fails."""
    paused = []
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr(time, "sleep", paused.append)
    options = ["--alpha", "0.5", "--episodes", "1", "--max-steps", "50"]
    assert main(["watch", "windy-gridworld", "sarsa", *options]) == 0
    seen = rl.watch(rl.make("windy-gridworld", max_steps=50), rl.Sarsa(alpha=0.5), num_episodes=1)
    assert paused == [20 / 50] * 50
    assert seen.told.end in capsys.readouterr().out


def test_while_it_is_played_the_agent_is_where_it_is():
    """Broken once: the state before the step -> fails."""
    seen = watched(rl.make("windy-gridworld", max_steps=50), rl.Sarsa(alpha=0.5), num_episodes=1)
    frames = list(command._frames(seen, seen.told))
    assert len(frames) == 50
    for i in (0, 12, 49):
        out = Console(file=io.StringIO(), width=140)
        out.print(frames[i])
        text = out.file.getvalue()
        row, column = divmod(int(seen.steps.experience.s_next[i]), 10)
        of_row = next(line for line in text.splitlines() if line.startswith(f"│ {row}  │"))
        assert text.count("●") == 1 and "●" in of_row.split("│")[2 + column]
        assert text.count("Q(S, A)") == min(i + 1, command.LAST_STEPS)


def test_blackjack_is_played_on_the_table_of_its_hand():
    """With a usable ace that is another table. Broken once: all tables -> fails."""
    env = rl.make("blackjack")
    shown = [tables.position(env, None, env.state(15, 4, usable=usable)) for usable in (True, False)]
    assert [[table.title for table in of_state] for of_state in shown] == [
        ["usable ace: player ↓, dealer shows →"],
        ["no usable ace: player ↓, dealer shows →"],
    ]


# --- where states cannot be counted ------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive():
    """Three steps of a car, as nobody drove it."""
    s = np.array([[-0.5, 0.0], [-0.52, -0.02], [-0.5, 0.01], [0.5, 0.06]])
    truth = np.array([False, False, True])
    seen = Seen(s[:3], np.array([0, 2, 1]), np.full(3, -1.0), s[1:], truth, truth)
    change = Change(np.array([3, 8]), np.array([2, 2]), np.array([0.5, 1.0]), np.array([0.25, 1.125]))
    steps = Steps(seen, np.array([0.5, -1, np.nan]), (change, change, Change(*[np.array([])] * 4)))
    method = rl.approx.SemiGradientSarsa(features="tile-coding(1, 2)")
    return module.Watched(rl.MountainCar(), method, 0, 0, 1, 1, np.zeros((9, 3)), steps, None)


def test_states_that_are_numbers_are_told_as_such(drive):
    """Broken once: the names of states from their numbers -> TypeError."""
    rows = [*drive.told.rows()]
    told = ("2", "−0.52, −0.02", "forward", "−1", "−0.5, 0.01", "−1", "2 weights, ≤ 0.25")
    assert rows[1] == told
    assert rows[2][-1] == "nothing"
    assert drive.told.end == "It ends in a terminal state after 3 steps; its return is −3."
    # From -0.52 to 0.5, and from -0.02 to 0.06, in eight heights.
    assert [*command._courses(drive)] == ["position ▁▁▁█ −0.52 to 0.5", "velocity ▃▁▄█ −0.02 to 0.06"]


def test_the_car_is_drawn_on_its_hill():
    """sin(3 x) is least at -pi / 6, the 24th of 60 columns, and 0.44 at the left end."""
    lines = rl.MountainCar().picture(np.array([-np.pi / 6, 0.0]))
    assert len(lines) == 9
    assert lines[8].index("●") == 23
    assert lines[0].endswith("⚑")
    assert lines[2].startswith("·")
    assert rl.MountainCar().picture(np.array([-1.2, 0.0]))[2].startswith("●")
    assert sum(line.count("●") for line in lines) == 1


@pytest.mark.slow
def test_the_car_is_driven_as_in_a_sweep():
    """To the last bit; of a network there is nothing to be told."""
    car, grid = rl.MountainCar(max_steps=200), {"features": "tile-coding(2, 3)", "alpha": 0.2}
    seen = rl.watch(car, rl.approx.SemiGradientSarsa(**grid), num_episodes=3, seed=1)
    swept = rl.sweep(car, "semi-gradient-sarsa", grid, num_seeds=2, num_episodes=3, progress=False)
    np.testing.assert_array_equal(seen.q, swept.q[1])
    assert len(seen.steps) == swept.log.lengths[1, -1]
    with pytest.raises(rl.InputError, match="and DeepSarsa has a network"):
        rl.watch(car, rl.approx.DeepSarsa(), num_episodes=1)
