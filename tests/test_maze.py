"""Drawn mazes: against tables worked by hand, published values, and the same task built in another way."""

import json
from pathlib import Path

import gymnasium
import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxrl_tab as rl
from jaxrl_tab import planning, plot
from jaxrl_tab.cli import main
from jaxrl_tab.envs.drawing import MAPS
from jaxrl_tab.show.explorer.scene import scene
from jaxrl_tab.show.heat import heats

UP, RIGHT, DOWN, LEFT = range(4)
TWO = ["S.A#G", "SO..b"]  # 5 columns: states 0 to 4, and 5 to 9
LEGEND = {"A": {"to": "b", "reward": -3}, "O": {"reward": -10, "terminal": True}}
TEXT = "\n".join([*TWO, "", "A: to b, reward -3", "O: reward -10, terminal", "slip: 0.2", ""])


def table_of(env):
    """What each move may lead to, by hand-readable numbers: (s, a) -> {(s', reward, terminal): probability}."""
    model = planning.exact_model(env)
    rows = {}
    for s, a in np.ndindex(env.num_states, env.num_actions):
        out = zip(model.prob[s, a], model.s_next[s, a], model.reward[s, a], model.terminal[s, a], strict=True)
        row = rows.setdefault((s, a), {})
        for p, *x in out:
            key = int(x[0]), float(x[1]), bool(x[2])
            row[key] = row.get(key, 0.0) + float(p)
    return {k: {x: round(p, 6) for x, p in row.items() if p > 0} for k, row in rows.items()}


def same_tables(one, other):
    """Whether two environments are the same, state by state and outcome by outcome."""
    (a, b), starts = map(planning.exact_model, (one, other)), (one.initial(), other.initial())
    np.testing.assert_array_equal(*starts)
    np.testing.assert_allclose(a.prob, b.prob, rtol=1e-12)
    for field in ("s_next", "reward", "terminal"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


# --- outcomes -----------------------------------------------------------------------------------------


def test_walls_doors_ends_and_starts_by_hand():
    """Broken once: a door without its own reward; walls that are not in the way; bumps that are not priced -> fails."""
    env = rl.make("maze", map=TWO, legend=LEGEND, goal_reward=5, bump_reward=-2)
    table = table_of(env)
    assert table[0, RIGHT] == {(1, -1, False): 1}
    assert table[0, UP] == table[0, LEFT] == {(0, -2, False): 1}  # the edge
    assert table[1, RIGHT] == {(9, -3, False): 1}  # the door
    assert table[1, DOWN] == table[7, LEFT] == {(6, -10, True): 1}  # the hole
    assert table[8, UP] == {(8, -2, False): 1}  # the wall
    assert table[9, UP] == {(4, 5, True): 1}  # the goal
    assert all(table[s, a] == {(s, 0, True): 1} for s in (3, 4, 6) for a in range(4))  # wall, goal, hole
    np.testing.assert_array_equal(env.initial(), np.eye(10)[[0, 5]].sum(0) / 2)
    assert (env.starts, env.goals, env.walls) == (((0, 0), (1, 0)), ((0, 4),), ((0, 3),))
    assert env.letters == {0: "S", 2: "A", 4: "G", 5: "S", 6: "O", 9: "b"}
    first = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 400))
    assert abs((np.asarray(first) == 0).sum() - 200) < 4 * 10  # four standard errors


def test_slips_are_to_both_sides_and_a_letter_can_have_its_own():
    """Broken once: sides of a diagonal move among the four straight ones -> fails."""
    table = table_of(
        rl.make("maze", map=["...", ".iG", "..."], legend={"i": "slip 0"}, slip=0.2, moves="king+stay")
    )
    assert table[3, RIGHT] == {(4, -1, False): 0.8, (0, -1, False): 0.1, (6, -1, False): 0.1}
    # Down-right; up-right and down-left slide along the edge, as in the windy gridworld.
    assert table[0, 5] == {(4, -1, False): 0.8, (1, -1, False): 0.1, (3, -1, False): 0.1}
    assert table[3, 4] == {(1, -1, False): 0.8, (7, -1, False): 0.1, (0, -1, False): 0.1}
    assert table[3, 8] == {(3, -1, False): 1}  # who stays does not slip
    assert table[4, RIGHT] == {(5, -1, True): 1}  # on i nothing slips
    assert planning.exact_model(rl.make("maze")).prob.shape[-1] == 1


def test_wind_goes_no_further_than_a_wall_and_a_letter_can_have_its_own():
    """Broken once: the wind carries across a wall -> fails."""
    rows = ["....G", "#.#..", ".....", ".u...", "S...."]
    table = table_of(rl.make("maze", map=rows, wind=[0, 1, 3, 0, 0], legend={"u": "wind 2"}))
    assert table[20, RIGHT] == {(21, -1, False): 1}  # of the column that is left
    assert table[21, RIGHT] == {(17, -1, False): 1}
    assert table[22, UP] == {(12, -1, False): 1}  # four rows up there is a wall in between
    assert table[22, RIGHT] == {(8, -1, False): 1}  # one column further there is none: three rows
    assert table[16, UP] == {(1, -1, False): 1}  # u: one row and two
    assert table[16, LEFT] == {(10, -1, False): 1}  # two rows up, and the wall at (1, 0) is beyond
    assert table[2, DOWN] == {(2, -1, False): 1}  # the wind is the stronger
    storm = planning.exact_model(rl.make("maze", map=["S.G", "..."], wind=[10**20] * 3)).s_next[..., 0]
    assert storm[3].tolist() == [0, 1, 0, 0]


@pytest.mark.parametrize("moves", ["four", "king", "king+stay"])
def test_with_wind_it_is_the_windy_gridworld(moves):
    windy = rl.make("windy-gridworld", moves=moves)
    rows = [list("." * 10) for _ in range(7)]
    rows[3][0], rows[3][7] = "SG"
    same_tables(rl.make("maze", map=["".join(row) for row in rows], wind=windy.wind, moves=moves), windy)


def test_the_cliff_is_cliff_walking():
    same_tables(rl.make("maze", map="cliff"), rl.make("cliff-walking"))


@pytest.mark.parametrize("name", ["4x4", "8x8"])
@pytest.mark.parametrize("given", [{}, {"is_slippery": False}, {"success_rate": 0.8}])
def test_frozen_lakes_are_those_of_gymnasium(name, given):
    """State by state; Gymnasium's actions are left, down, right, up. Broken once: their order kept -> fails."""
    theirs = gymnasium.make("FrozenLake-v1", map_name=name, **given).unwrapped
    ours = rl.make("frozen-lake", map_name=name, **given)
    table = table_of(ours)
    for s, actions in theirs.P.items():
        for a, outcomes in actions.items():
            row = {}
            for p, *x in outcomes:
                row[tuple(x)] = row.get(tuple(x), 0.0) + p
            own = table[s, (LEFT, DOWN, RIGHT, UP)[a]]
            assert own == pytest.approx({x: p for x, p in row.items() if p > 0}, abs=2e-6)
    np.testing.assert_array_equal(ours.initial(), theirs.initial_state_distrib)
    if not given:
        same_tables(ours, rl.make("maze", map=f"frozen-lake-{name}"))


def test_a_lake_of_ones_own(tmp_path):
    (tmp_path / "lake.txt").write_text("SFH\nF#F\nFFG\n")
    for lake in (["SFH", "F#F", "FFG"], str(tmp_path / "lake.txt")):
        env = rl.make("frozen-lake", map=lake, is_slippery=False)
        assert (env.walls, env.letters) == (((1, 1),), {0: "S", 2: "H", 8: "G"})
    with pytest.raises(rl.InputError, match="frozen-lake: a lake has no settings below its map"):
        rl.make("frozen-lake", map="dyna")


# --- published values -----------------------------------------------------------------------------------


def test_the_values_of_example_3_5_and_3_8():
    """Figures 3.2 and 3.5 of the book, gamma = 0.9. Broken once: A gives its reward when it is entered -> fails."""
    env = rl.make("maze", map="example-3.5")
    v = planning.evaluate(env, np.full((25, 4), 0.25), 0.9)
    np.testing.assert_allclose(
        v[[0, 1, 2, 3, 4, 5, 6, 24]], [3.3, 8.8, 4.4, 5.3, 1.5, 1.5, 3.0, -2.0], atol=0.05
    )
    best, _ = planning.value_iteration(env, 0.9)
    np.testing.assert_allclose(best[[0, 1, 2, 3, 4, 24]], [22.0, 24.4, 22.0, 19.4, 17.5, 11.7], atol=0.05)
    with pytest.raises(rl.InputError):
        planning.value_iteration(env)  # it never ends


def test_the_values_of_the_other_maps():
    v = planning.evaluate(rl.make("maze", map="grid-4x4"), np.full((16, 4), 0.25))
    np.testing.assert_allclose(v[:8], [0, -14, -20, -22, -14, -18, -20, -20], atol=1e-6)  # figure 4.1
    dyna = rl.make("maze", map="dyna")
    assert -planning.value_iteration(rl.make("maze", map="dyna", step_reward=-1, goal_reward=-1))[0][18] == 14
    assert planning.value_iteration(dyna, 0.95)[0][dyna.start_state] == pytest.approx(0.95**13)  # figure 8.2
    rooms = rl.make("maze", map="four-rooms")
    assert (rooms.num_states - len(rooms.walls), planning.reachable(planning.exact_model(rooms)).sum()) == (
        104,
        104,
    )
    assert all(rl.make("maze", map=name).shape for name in MAPS)


def test_a_goal_out_of_reach_and_a_task_without_a_goal_have_values_below_gamma_1():
    for rows in (["S..#G"], ["S.."], ["..."]):
        env = rl.make("maze", map=rows)
        np.testing.assert_allclose(planning.value_iteration(env, 0.9)[0][:3], -10)
        with pytest.raises(rl.InputError, match="at gamma = 1 the optimal value is not finite"):
            planning.value_iteration(env)


# --- the ways to write one ----------------------------------------------------------------------------------


def test_a_file_a_text_and_a_list_are_the_same(tmp_path, monkeypatch):
    """What is in a file is kept, for the file may change. Broken once: the name of the file is kept -> fails."""
    (tmp_path / "my.txt").write_text(TEXT)
    monkeypatch.chdir(tmp_path)
    envs = [
        rl.make("maze", map=TWO, legend=LEGEND, slip=0.2),
        rl.make("maze", map=tuple(TWO), legend=["A: to b, reward -3", "O: reward -10, terminal"], slip=0.2),
        rl.make("maze", map=TWO, legend={"A": "to b, reward -3", "O": "reward -10, terminal"}, slip=1 / 5),
        rl.make("maze", map=TEXT),
        rl.make("maze", map=TEXT.splitlines()),
        rl.make("maze", map="my.txt"),
        rl.make("maze", map=Path("my.txt")),
    ]
    (tmp_path / "my.txt").write_text("S.G")
    assert len({jax.tree.structure(env) for env in envs}) == 1
    assert len({env.plan for env in envs}) == 1
    assert repr(rl.make("maze")) == "Maze()" and repr(rl.make("maze", map=["dyna"])) == "Maze(map='dyna')"
    # What is given beside a text comes before what it says.
    assert rl.make("maze", map=TEXT, slip=0.5).plan.slip == 0.5
    assert rl.make("maze", map=TEXT, legend={"O": "free"}).letters.keys() == {0, 2, 4, 5, 9}
    assert rl.make("maze", map="S.G\n\nslip: 2/3\nwind: 0 1 0\nstep-reward: -2").plan[3:] == (
        -2,
        -2,
        None,
        2 / 3,
        (0, 1, 0),
    )
    np.testing.assert_array_equal(rl.make("maze", map=["S G"]).initial(), [1, 0, 0])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"map": ["S..", ".Q.", "..G"]},
            "row 1, column 1: the letter 'Q' is not in the legend; there are # S G .; write",
        ),
        (
            {"map": ["S..", "..G", "."]},
            "row 2 has 1 cell, and row 0 has 3; write '.' for free cells at the end",
        ),
        ({"map": []}, "the map has no cells"),
        ({"map": "dyan"}, "there is no map 'dyan'; did you mean 'dyna'?"),
        ({"map": ["dyan"]}, "there is no map 'dyan'; did you mean 'dyna'?"),
        (
            {"map": "mine"},
            "there is no map 'mine'; choose one of barrier-left, .*, a file such as maze.txt, or draw its rows",
        ),
        (
            {"map": ["dyna", "cliff"]},
            r"it has one map, and 2 are named; a sweep tries several, in a file as \[\['dyna'\], \['cliff'\]",
        ),
        ({"map": ["dyna", "S.G"]}, "'dyna' names a map, and stands among the rows of one"),
        ({"map": ["#G"]}, "there is no free cell to start in"),
        ({"map": 3}, "map must be a name, or the rows of one map as texts, not 3"),
        ({"map": ["S.G", "step: 1"]}, "'step: 1' below the map is neither .*; did you mean 'step_reward'?"),
        ({"map": ["S.G", "slip: much"]}, "slip must be a number, not 'much'"),
        ({"map": ["S.G", "slip: 1 2"]}, "slip below the map must be one number, not ' 1 2'"),
        ({"map": ["S.G", "slip: 2"]}, "slip must be between 0 and 1, not 2"),
        ({"map": ["S.G"], "wind": [1]}, "wind must have one strength for each of the 3 columns, not 1"),
        ({"map": ["S.G"], "wind": [0.5, 0, 0]}, "wind must be whole numbers of cells, not 0.5"),
        ({"map": ["S.G"], "wind": "up"}, "wind must be a list of whole numbers of cells, not 'up'"),
        ({"step_reward": "x"}, "step_reward must be a number, not 'x'"),
        ({"legend": 3}, "legend must be a table, or lines such as"),
        ({"legend": {"AB": "free"}}, "the legend is of single letters, but for # S G . , and :, not of 'AB'"),
        ({"legend": {"S": "slip 1"}}, "the legend is of single letters"),
        ({"legend": ["A: free", "A: terminal"]}, "the legend has 'A' twice"),
        ({"legend": ["A: teminal"]}, "the legend says 'teminal' of 'A'; a letter can be"),
        ({"legend": {"A": {"rewrd": 1}}}, "the legend says 'rewrd' of 'A'; a letter can be"),
        ({"legend": {"A": {"reward": "x"}}}, "the reward of 'A' must be a number, not 'x'"),
        ({"legend": {"A": {"terminal": 1}}}, "the terminal of 'A' must be true or false, not 1"),
        ({"legend": {"A": {"to": "SS"}}}, "the to of 'A' must be the letter of a cell, not 'SS'"),
        ({"legend": {"A": {"slip": 2}}}, "the slip of 'A' must be between 0 and 1, not 2"),
        ({"legend": {"A": "terminal, to S"}}, "'A' can be one of terminal, to and jump"),
        ({"legend": {"A": 3}}, "the legend of 'A' must be a text or a table, not 3"),
        (
            {"map": ["SA.G"], "legend": {"A": "to X"}},
            "'A' leads to 'X', which must be one cell, and there are 0",
        ),
        ({"map": ["SA.G"], "legend": {"A": "to #"}}, "'A' leads to '#', where nobody can stand"),
    ],
)
def test_mistakes_are_told_where_they_are(given, message):
    with pytest.raises(rl.InputError, match=f"^maze: {message}"):
        rl.make("maze", **given)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(rl.InputError, match=r"no.txt cannot be read: No such file or directory"):
        rl.make("maze", map=str(tmp_path / "no.txt"))


def test_in_a_toml_file(tmp_path):
    """A list of rows is one map, a list of lists several; a file lies beside the file. It comes back as it was.

    Broken once: files looked for where the process is; rows tried one by one -> fails.
    """
    (tmp_path / "my.txt").write_text(TEXT)
    text = """
seeds = 1
steps = 5
method = "sarsa"
[[environment]]
name = "maze"
map = ["S.A#G", "SO..b"]
slip = 0.2
[environment.legend]
A = {to = "b", reward = -3}
O = "reward -10, terminal"
[[environment]]
name = "maze"
label = "of a file"
map = "my.txt"
[[environment]]
name = "maze"
label = "several"
map = [["S.G"], ["dyna"], ["my.txt"]]
"""
    (tmp_path / "experiment.toml").write_text(text)
    experiment = rl.Experiment.load(tmp_path / "experiment.toml")
    (tmp_path / "my.txt").unlink()
    again = rl.Experiment.from_data(json.loads(json.dumps(experiment.data())))
    (tmp_path / "again.toml").write_text(experiment.to_toml())
    assert again == experiment == rl.Experiment.load(tmp_path / "again.toml")
    envs = {key.rpartition("/")[0]: part.env for key, part in experiment.parts().items()}
    assert list(envs) == ["maze", "of a file", "several,map=S.G", "several,map=dyna", "several,map=3"]
    drawn, of_file, one, dyna, third = envs.values()
    assert drawn.plan == of_file.plan == third.plan
    assert (one.shape, dyna.shape) == ((1, 3), (6, 9))
    given = rl.Experiment(
        environment=[drawn, {"name": dyna, "label": "dyna"}], method="sarsa", seeds=1, steps=5
    )
    assert [part.env.plan for part in given.parts().values()] == [drawn.plan, dyna.plan]


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("3", "map takes a text, a list of lines"),
        ('"no.txt"', "no.txt cannot be read"),
        ('["S.Q"]', "row 0, column 2"),
    ],
)
def test_mistakes_in_a_toml_file(tmp_path, written, message):
    text = f'seeds = 1\nsteps = 5\nmethod = "sarsa"\n[[environment]]\nname = "maze"\nmap = {written}\n'
    (tmp_path / "experiment.toml").write_text(text)
    with pytest.raises(rl.InputError, match=f"line 6.*{message}"):
        rl.Experiment.load(tmp_path / "experiment.toml")


def test_on_the_command_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "my.txt").write_text(TEXT)
    monkeypatch.chdir(tmp_path)

    def solved(*words):
        assert main(["solve", "maze", "--json", *words]) == 0
        return json.loads(capsys.readouterr().out)["optimal"]["start_value"]

    by_rows = ["--map", *TWO, "--slip", "0.2", "--legend", "A: to b, reward -3", "O: reward -10, terminal"]
    assert solved("--map", "my.txt") == solved(*by_rows)
    assert solved("--map", "dyna", "--gamma", "0.95") == pytest.approx(0.95**13)
    assert main(["solve", "maze", "--map", "my.txt"]) == 0
    text = capsys.readouterr().out
    assert "▒▒▒▒▒" in text and "O" in text and text.count("S ") == 2
    assert main(["solve", "maze", "--map", "dyan"]) == 2
    assert capsys.readouterr().err == "jaxrl-tab: maze: there is no map 'dyan'; did you mean 'dyna'?\n"


def test_a_sweep_over_maps_is_typed(tmp_path, monkeypatch, capsys):
    """Names are maps, and rows are one. Broken once: all words of --map taken for rows of one map -> fails."""
    (tmp_path / "my.txt").write_text("S.G")
    monkeypatch.chdir(tmp_path)

    def planned(*words):
        command = ["sweep", *words, "--steps", "50", "--seeds", "1", "--alpha", "0.1", "--dry-run", "--json"]
        assert main(command) == 0
        return list(json.loads(capsys.readouterr().out)["parts"])

    several = ["maze,map=dyna/sarsa", "maze,map=S.G/sarsa"]
    assert planned("maze", "sarsa", "--map", "dyna", "my.txt") == several
    assert planned("maze", "sarsa", "--map", "S..", ".#G") == ["maze/sarsa"]
    rows = ["--map", "S#", ".G", "--after", "S.", "#G"]
    assert planned("blocking-maze", "sarsa", *rows) == ["blocking-maze/sarsa"]
    assert main(["sweep", "maze", "sarsa", "--map", "dyna", "dyna", "--dry-run"]) == 2
    assert "the grid of map holds one text more than once" in capsys.readouterr().err


# --- runs and pictures ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_lanes_and_xla_give_the_same_bits():
    """With slips, two starts, a door and walls."""
    env = rl.make("maze", map=TEXT)
    runs = [
        rl.sweep(env, "sarsa", {"alpha": [0.1, 0.5]}, num_seeds=3, num_steps=200, log_every=100, backend=by)
        for by in ("lanes", "xla")
    ]
    one, other = (run.to_xarray() for run in runs)
    np.testing.assert_array_equal(one.q, other.q)
    np.testing.assert_array_equal(one.rewards, other.rewards)
    assert (one.rewards < -100).any()


@pytest.fixture
def solved():
    """A maze with two starts, a door and a slip, and q*."""
    env = rl.make("maze", map=TEXT)
    return env, planning.value_iteration(env)[1]


def drawn(draw):
    ax = Figure().subplots()
    draw(ax)
    return ax


def test_pictures_have_walls_letters_and_a_path_from_each_start(solved):
    """Broken once: walls hatched; a path from the first start alone; one straight on through the door -> fails."""
    env, q = solved
    ax = drawn(lambda ax: plot.greedy_path(ax, env, q))
    assert ax.get_title() == "greedy path\nlikeliest outcomes: 3 to 4 steps to the goal"
    cells = [(x.get_x() + 0.5, x.get_y() + 0.5, bool(x.get_hatch())) for x in ax.patches]
    assert cells == [(2, 0, True), (3, 0, False)]  # the door, in which nobody ever is, and the wall
    assert sorted(x.get_text() for x in ax.texts if len(x.get_text()) == 1) == sorted("SSAOGb")
    bands = [line.get_xydata().tolist() for line in ax.lines if line.get_linestyle() == "-"]
    assert [[0, 0], [1, 0]] in bands and [[4, 1], [4, 0]] in bands
    assert [line.get_xydata().tolist() for line in ax.lines if line.get_linestyle() == ":"] == [
        [[1, 0], [4, 1]]
    ] * 2
    values = drawn(lambda ax: plot.values(ax, env, q.max(1), q))
    assert [bool(x.get_hatch()) for x in values.patches[:2]] == [True, False]


def test_paths_that_do_not_arrive_and_tasks_that_do_not_end():
    round_and_round = np.tile([0.0, 0, 0, 1], (9, 1))
    env = rl.make("maze", map=["S.G", "S..", ".G."])
    assert drawn(lambda ax: plot.greedy_path(ax, env, round_and_round)).get_title() == (
        "greedy path\ngoes round for ever from 2 of 2 starts"
    )
    many = drawn(lambda ax: plot.greedy_path(ax, rl.make("maze", map=["..G", "...", "..."]), round_and_round))
    assert many.get_title() == "greedy path\ngoes round for ever from 8 of 8 starts" and not many.lines
    endless = drawn(
        lambda ax: plot.greedy_path(ax, rl.make("maze", map=["S#.", "...", "..."]), round_and_round)
    )
    assert endless.get_title() == "greedy path" and not endless.lines


def test_the_report_shows_walls_and_letters(tmp_path):
    """Broken once: walls among the cells that are out of reach; the letters of one start -> fails."""
    env = rl.make("maze", map=TEXT)
    swept = rl.sweep(env, "sarsa", {"alpha": 0.5}, num_seeds=2, num_steps=300, log_every=100)
    ds = swept.to_xarray()
    found = scene(env, {"sarsa": ds}, ds.q.mean("seed").max("action").values).data
    assert found["grid"]["walls"] == [3] and found["start"] == [0, 5]
    assert dict(found["grid"]["letters"]) == env.letters and found["unreachable"] == [2, 3]
    (heat,) = heats(swept.explain(), "maze")
    (shown,) = heat.maps
    assert (shown.walls, shown.out) == ([(3, 0)], [(2, 0)])
    assert dict(shown.letters) == {divmod(s, 5): letter for s, letter in env.letters.items()}


def test_many_cells_are_drawn_in_a_moment():
    """A hundred rows of a hundred: the table is made at once, not cell by cell."""
    env = rl.make("maze", map=["S" + "." * 99, *["." * 100] * 98, "." * 99 + "G"], slip=0.1)
    assert (env.num_states, env.num_actions, len(env.starts)) == (10_000, 4, 1)
