"""Mazes that change while a run goes on."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning, policies
from jaxrl_tab.cli import main

UP, RIGHT = 0, 1
START, NEW_WALL = 48, 35  # cells (5, 3) and (3, 8)


def by_the_right():
    """The policy that walks along the bottom and up the right edge, 10 steps; [S, A]."""
    at_right = np.arange(54) % 9 == 8
    return np.eye(4)[np.where(at_right, UP, RIGHT)]


@pytest.mark.parametrize(("backend", "change_at", "last"), [("lanes", 246, 4), ("xla", 247, 5)])
def test_it_changes_in_its_step_of_the_run_and_not_of_the_episode(backend, change_at, last):
    """The seventh of ten steps leads into the opening, in step 246 of the run for the 25th time: there it is closed.
    One step later the walker stands in it, and walks on. Broken once: the length of the episode for the number of the
    step; the change one step later; whoever stands in a new wall is caught -> fails.
    """
    method = {"behaviour": policies.Table(by_the_right())}
    env = rl.make("blocking-maze", change_at=change_at)
    log = rl.sweep(env, "q-learning", method, num_seeds=3, num_steps=400, log_every=50, backend=backend).log
    np.testing.assert_array_equal(log.rewards, [[5, 5, 5, 5, last, 0, 0, 0]] * 3)


def tabulated(env):
    model = planning.exact_model(env)
    return model.prob, model.s_next, model.reward, model.terminal


def test_before_and_after_it_is_the_maze_of_its_map():
    """But for the cell that becomes a wall, out of which one walks as before."""
    before, after = (rl.make("maze", map=name) for name in ("barrier-left", "barrier-right"))
    env = rl.make("blocking-maze")
    others = np.arange(54) != NEW_WALL
    for maze, same, where in (
        (env.at(jnp.int32(999)), before, slice(None)),
        (env.at(jnp.int32(1000)), after, others),
        (env, before, slice(None)),
        (rl.make("blocking-maze", changed=1), after, others),
        (rl.make("blocking-maze", changed=1).at(jnp.int32(0)), after, others),
    ):
        for x, y in zip(tabulated(maze), tabulated(same), strict=True):
            np.testing.assert_array_equal(x[where], y[where])
        assert maze.walls == same.walls
    _, s_next, _, terminal = tabulated(env.at(jnp.int32(1000)))
    assert s_next[NEW_WALL, UP] == NEW_WALL - 9 and not terminal[NEW_WALL, UP]
    assert s_next[NEW_WALL + 9, UP] == NEW_WALL + 9  # and nobody walks into it


@pytest.mark.parametrize(("name", "lengths"), [("blocking-maze", (10, 16)), ("shortcut-maze", (16, 10))])
def test_the_shortest_ways_are_the_book_s(name, lengths):
    for changed, length in enumerate(lengths):
        env = rl.make(name, changed=changed)
        assert planning.start_value(env, planning.value_iteration(env, 0.5)[0]) == 0.5 ** (length - 1)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            "sweep blocking-maze sarsa --steps 10 --exact",
            "BlockingMaze changes while a run goes on, so that no exact",
        ),
        (
            "sweep blocking-maze sarsa --after cliff",
            "the map after the change is 4 x 12, and the first one 6 x 9",
        ),
        ("sweep blocking-maze sarsa --after dyna", "both maps must have the same starts, and the same rules"),
        ("sweep blocking-maze sarsa --after dyan", "there is no map 'dyan'; did you mean 'dyna'?"),
        (
            "bridge shortcut-maze sarsa",
            "the task changes while a run goes on in shortcut-maze, so that no backup",
        ),
        (
            "moments blocking-maze td --alpha 0.1",
            "the task changes while a run goes on there, so that no curve",
        ),
    ],
)
def test_what_a_maze_that_changes_does_not_have_is_refused(command, message, capsys):
    assert main(command.split()) == 2
    assert message in capsys.readouterr().err


def test_nothing_exact_is_said_of_its_sweeps():
    """Broken once: the optimum of the first maze shown -> fails."""
    result = rl.sweep(rl.make("blocking-maze"), "sarsa", {"gamma": 0.9}, num_seeds=2, num_steps=20)
    assert np.isnan(result.optimal_value).all()
