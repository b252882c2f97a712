"""Experiments as data: a file and Python say the same, and what is wrong is named with its line."""

import json
import tomllib

import jax
import numpy as np
import pytest
import quick

import jaxrl_tab as rl
from jaxrl_tab import planning, plot
from jaxrl_tab.cli import main
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.policies import EpsilonGreedy, Softmax, Table
from jaxrl_tab.engine import speeds
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.sweep import compute, result
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment.plan import plan
from jaxrl_tab.experiment.progress import seconds_left
from jaxrl_tab.experiment.resolve import Selection
from jaxrl_tab.experiment.spec import Experiment, difference, template
from jaxrl_tab.methods import METHODS, PREDICTION

FILE = """\
seeds = 10
steps = 800

[[environment]]
name = "windy-gridworld"
moves = "king"
stochastic = [false, true]

[[method]]
name = "sarsa"
alpha = [
    0.1,
    0.5,
]
epsilon = {log = [0.01, 1], points = 3}

[[method]]
name = "n-step-sarsa"
n = [1, 4]
draws = 3
alpha = {log_uniform = [0.01, 1]}
epsilon = {choice = ["glie", 0.1]}

[select]
fresh_seeds = 7
"""
PYTHON = {
    "seeds": 10,
    "steps": 800,
    "environment": {"name": "windy-gridworld", "moves": "king", "stochastic": (False, True)},
    "method": [
        {"epsilon": rl.LogGrid(0.01, 1, 3), "name": "sarsa", "alpha": np.array([0.1, 0.5])},
        {
            "name": "n-step-sarsa",
            "epsilon": rl.Choice([rl.schedules.glie(), 0.1]),
            "alpha": rl.LogUniform(0.01, 1),
            "draws": 3,
            "n": [1, 4],
        },
    ],
    "select": Selection(fresh_seeds=7),
}


@pytest.fixture
def load(tmp_path):
    """Loads an experiment from a text, by way of a file x.toml."""

    def load(text):
        (tmp_path / "x.toml").write_text(text, encoding="utf-8")
        return Experiment.load(tmp_path / "x.toml")

    return load


def small(**given):
    """An experiment of one method in one environment."""
    return Experiment(**({"environment": "windy-gridworld", "method": "sarsa", "steps": 100} | given))


# --- the data ----------------------------------------------------------------------------------------


def test_all_is_resolved_in_plain_data(load):
    data = load(FILE).data()
    wind = {"wind": [0, 0, 0, 1, 1, 1, 2, 2, 1, 0], "shape": [7, 10], "start": [3, 0], "goal": [3, 7]}
    same = {"name": "windy-gridworld", "moves": "king", "max_steps": 10_000} | wind
    assert data.pop("environment") == [
        same | {"label": f"windy-gridworld,stochastic={text}", "stochastic": text == "true"}
        for text in ("false", "true")
    ]
    sarsa, n_step = data.pop("method")
    fixed = {"gamma": 1.0, "q0": 0.0}
    assert sarsa == {
        "name": "sarsa",
        "label": "sarsa",
        "alpha": [0.1, 0.5],
        "epsilon": [0.01, 0.1, 1.0],
        **fixed,
    }
    draws = n_step.pop("draw")
    assert n_step == {"name": "n-step-sarsa", "label": "n-step-sarsa", "n": [1, 4], **fixed}
    assert [list(draw) for draw in draws] == [["alpha", "epsilon"]] * 3
    assert len({draw["alpha"] for draw in draws}) == 3
    assert {draw["epsilon"] for draw in draws} <= {"glie", 0.1}
    assert data == {
        "seeds": 10,
        "steps": 800,
        "log_every": 100,
        "seed": 0,
        "exact": False,
        "backend": "auto",
        "select": {"by": "score", "fresh_seeds": 7},
    }


def test_a_file_and_python_say_the_same_in_any_order(load):
    """The order decides which run has which number. Broken once: that of the file -> fails."""
    assert load(FILE) == Experiment(**PYTHON)
    assert json.dumps(load(FILE).data()) == json.dumps(Experiment(**PYTHON).data())
    assert load(FILE).fingerprint == Experiment(**PYTHON).fingerprint
    assert Experiment(**PYTHON | {"seed": 1}).fingerprint != Experiment(**PYTHON).fingerprint
    assert len(load(FILE).fingerprint) == 64


def test_what_was_added_since_leaves_old_fingerprints_as_they_are():
    """Folders are known by them. Broken once: `first_seed` in the data where it is 0 -> fails."""
    assert small(first_seed=0).data() == small().data() and "first_seed" not in small().data()
    assert small(first_seed=3).data()["first_seed"] == 3


def test_what_is_resolved_comes_back_from_json_and_from_a_file(load):
    given = Experiment(**PYTHON)
    again = Experiment.from_data(json.loads(json.dumps(given.data())))
    assert again == load(given.to_toml()) == given
    assert again.fingerprint == load(given.to_toml()).fingerprint == given.fingerprint


@pytest.mark.parametrize("name", METHODS)
def test_every_method_and_every_environment_comes_back(load, name):
    environment = "random-walk" if name in PREDICTION else list(ENVS)
    given = small(environment=environment, method=name)
    assert load(given.to_toml()) == Experiment.from_data(json.loads(json.dumps(given.data()))) == given


def test_whatever_can_be_typed_can_be_in_a_file(load):
    """Also policies as probabilities, which are one value, or several."""
    tables = [[[0.5, 0.5]] * 2, [[0.25, 0.75]] * 2]
    given = small(
        environment="two-doors",
        method=[
            {"name": "q-learning", "alpha": ["sample_average", 0.5], "behaviour": Table(np.array(tables[0]))},
            {"name": "expected-sarsa", "target": ["softmax:0.5", EpsilonGreedy(0.25), tables[1], "greedy"]},
            {"name": "q-learning", "label": "more", "alpha": "harmonic:10:step", "behaviour": Softmax()},
        ],
    )
    first, second, third = given.method
    assert (first["alpha"], first["behaviour"]) == (["sample-average", 0.5], tables[0])
    assert second["target"] == ["softmax:0.5", "epsilon-greedy:0.25", tables[1], "greedy"]
    assert (third["alpha"], third["behaviour"]) == ("harmonic:10:step", "softmax:1")
    assert load(given.to_toml()) == given
    walk = small(environment="random-walk", method={"name": "td", "pi": [[[1.0]] * 21]})
    assert load(walk.to_toml()) == walk
    assert walk.exact


def test_draws_of_one_method_do_not_depend_on_the_others():
    """They do on its label, so that two such methods are not tried at the same points."""
    drawn = {"draws": 4, "alpha": rl.LogUniform(0.01, 1)}
    alone = small(method={"name": "sarsa"} | drawn).method[0]
    before = {"name": "q-learning"} | drawn
    beside = small(method=[before, {"name": "sarsa", "q0": [0, 1]} | drawn]).method
    assert beside[1]["draw"] == alone["draw"] != beside[0]["draw"]
    more = small(method={"name": "sarsa"} | drawn | {"draws": 6}).method[0]
    assert more["draw"][:4] == alone["draw"] and len(more["draw"]) == 6
    other = small(method={"name": "sarsa", "label": "other"} | drawn).method[0]
    assert other["draw"] != alone["draw"]


def test_the_difference_of_two_is_told_in_lines():
    old = Experiment(**PYTHON).data()
    new = json.loads(json.dumps(old))
    assert difference(old, new) == []
    new |= {"seeds": 20, "exact": True}
    del new["select"]
    new["method"][0] |= {"alpha": [0.1], "behaviour": "ucb:2"}
    new["method"][1] |= {"label": "other"}
    new["environment"].reverse()
    assert difference(old, new) == [
        "environment: the order is another one",
        "method n-step-sarsa is gone",
        "method other is new",
        "method sarsa: alpha was [0.1, 0.5], and is [0.1]",
        'method sarsa: behaviour was not given, and is "ucb:2"',
        "seeds was 10, and is 20",
        "exact was false, and is true",
        'select was {by = "score", fresh_seeds = 7}, and is not given',
    ]
    long = [{"alpha": i / 100} for i in range(50)]
    other = json.loads(json.dumps(old))
    old["method"][1]["draw"], other["method"][1]["draw"] = long, long[:-1]
    assert difference(old, other) == ["method n-step-sarsa: draw was 50 values, and is 49 values"]
    other["method"][1]["draw"] = long[::-1]
    assert difference(old, other) == ["method n-step-sarsa: draw has other values"]


# --- what is wrong, with its line --------------------------------------------------------------------

SCHEDULES = "one of glie, sample-average, power[:POWER[:SCALE]]:CLOCK,"
WRONG = [  # what stands in the file, what stands there instead, the line, and what is said
    ("seeds = 10", "seds = 10", 1, "an experiment has no 'seds'; did you mean 'seeds'?"),
    ("seeds = 10", "seeds = 0", 1, "seeds must be a whole number of at least 1, not 0"),
    ("seeds = 10", "seeds = 2.5", 1, "seeds must be a whole number of at least 1, not 2.5"),
    ("seeds = 10", "seeds = true", 1, "seeds must be a whole number"),
    ("seeds = 10", "seed = -1", 1, "seed must be a whole number of at least 0, not -1"),
    ("seeds = 10", "log_every = '1'", 1, "log_every must be a whole number of at least 1"),
    ("seeds = 10", "exact = 1", 1, "exact must be true or false, not 1"),
    ("seeds = 10", "alpha = 10", 1, "an experiment has no 'alpha'; write it below a [[method]] that has it"),
    ("seeds = 10", "moves = 1", 1, "an experiment has no 'moves'; write it below a [[environment]] that"),
    ("seeds = 10", "seeds = ", 1, "invalid value"),
    ("seeds = 10", "seeds = 10\nseeds = 3", 2, "cannot overwrite a value"),
    ("steps = 800", "steps = 0", 2, "steps must be a whole number of at least 1, not 0"),
    (
        "steps = 800",
        "episodes = 8\nsteps = 800",
        2,
        "give either a number of steps or one of episodes: how long a run is",
    ),
    ("steps = 800", "", None, "give either a number of steps or one of episodes: how long a run is"),
    ("[[environment]]", "[[environments]]", 4, "an experiment has no 'environments'; did you mean 'environm"),
    ('"windy-gridworld"', '"windy"', 5, "'windy' is not an environment; did you mean 'windy-gridworld'?"),
    ('name = "windy-gridworld"\n', "", 4, "the environment has no name: one of windy-gridworld, cliff-"),
    ('moves = "king"', 'moves = "knight"', 6, "moves 'knight' is unknown; did you mean 'king'?"),
    ('moves = "king"', "moves = 8", 6, "moves takes text, not 8"),
    ('moves = "king"', 'move = "king"', 6, "windy-gridworld has no parameter 'move'; did you mean 'moves'?"),
    ('moves = "king"', "draws = 3", 6, "windy-gridworld has no parameter 'draws'"),
    ('moves = "king"', "wind = [1, 2]", 6, "wind must have one strength for each of the 10 columns"),
    ('moves = "king"', "wind = 1", 6, "wind takes a list, or a list of lists to be tried one by one, not 1"),
    ('moves = "king"', "wind = [0.5]", 6, "wind takes a whole number, not 0.5"),
    ('moves = "king"', "max_steps = []", 6, "the grid of max_steps is empty"),
    ('moves = "king"', "max_steps = [[9]]", 6, "max_steps takes a value, or a list to be tried one by one"),
    ('moves = "king"', "max_steps = {integers = [1, 9]}", 6, "can have grids, but nothing random"),
    ("[false, true]", "[false, 1]", 7, "stochastic takes true or false, not 1"),
    ("[false, true]", "[true, true]", 7, "the grid of stochastic holds True more than once"),
    ('[[method]]\nname = "sarsa"', '[method]\nname = "sarsa"', 17, "cannot overwrite a value"),
    ('"sarsa"', '"sara"', 10, "'sara' is not a method; did you mean 'sarsa'?"),
    ('"sarsa"', "3", 10, "3 is not a method; choose one of sarsa, q-learning"),
    ('"sarsa"', '"sarsa"\nlabel = "a/b"', 11, "a label must be a text in one line that begins with a letter"),
    ('"sarsa"', '"n-step-sarsa"', 17, "the method n-step-sarsa is named more than once: give each a label"),
    ("    0.1", "    0", 11, "alpha must be greater than 0, not 0.0"),
    ("    0.1", "    nan", 11, "alpha must be greater than 0, not nan"),
    ("    0.1", "    0.5", 11, "the grid of alpha holds 0.5 more than once"),
    (
        "    0.1",
        "    'small'",
        11,
        f"alpha: 'small' is neither a number nor a schedule; a schedule is {SCHEDULES}",
    ),
    ("    0.1", "    'gli:1'", 11, "alpha: there is no schedule 'gli:1'; did you mean 'glie'?"),
    ("    0.1", "    [1, 2]", 11, f"alpha takes a number or a schedule ({SCHEDULES}"),
    ("    0.1,", "    0.1", 13, "unclosed array"),
    ("points = 3", "point = 3", 15, "epsilon: log has no 'point'; did you mean 'points'?"),
    (", points = 3", "", 15, "epsilon: say how many points, {log = [0.1, 1], points = 5}"),
    ("points = 3", "points = 1", 15, "epsilon: points must be a whole number of at least 2, not 1"),
    ("{log =", "{lg =", 15, "is not a way to give values to try; did you mean 'log'?"),
    ("[0.01, 1]", "[0, 1]", 15, "epsilon: the ends must be above 0 on a logarithmic scale, not 0"),
    ("[0.01, 1]", "[0.01, 1.5]", 15, "epsilon must be between 0 and 1, not 1.5"),
    ("[0.01, 1]", "0.01", 15, "epsilon: log must be the two ends, such as [0.1, 1], not 0.01"),
    ("points = 3}", "points = 3", 15, "unclosed"),
    ('"n-step-sarsa"', '"sarsa"', 19, "sarsa has no parameter 'n'; choose one of alpha, epsilon,"),
    ('"n-step-sarsa"', '"n-step-td"', 17, "sweep methods of prediction and of control apart"),
    ("n = [1, 4]", "n = [1, 0]", 19, "n must be a whole number of at least 1, not 0"),
    ("n = [1, 4]", "n = 1.5", 19, "n takes a whole number, not 1.5"),
    ("n = [1, 4]", "n = {uniform = [1, 4]}", 19, "n takes a whole number, not "),
    ("n = [1, 4]", "behaviour = 'ucb'", 22, "give epsilon or behaviour, not both"),
    (
        "n = [1, 4]",
        "behaviour = 'sofmax'",
        19,
        "behaviour: there is no policy 'sofmax'; did you mean 'softmax'",
    ),
    (
        "n = [1, 4]",
        "behaviour = 0.5",
        19,
        "behaviour: a policy is written as a text, such as 'softmax:0.5', not 0.5",
    ),
    ("n = [1, 4]", "behaviour = [[0.5, 0.6]]", 19, "the probabilities in state 0 are not a distribution"),
    ("n = [1, 4]", "draw = [{beta = 1}]", 20, "alpha is drawn at random, and there are draws already"),
    ("draws = 3", "draws = 0", 20, "the number of draws must be a whole number of at least 1, not 0"),
    ("draws = 3", "", 17, "alpha is drawn at random: say how many draws"),
    ("draws = 3", "draw = 3", 17, "alpha is drawn at random: say how many draws"),
    ('"glie"', '"gli"', 22, "epsilon: 'gli' is neither a number nor a schedule; did you mean 'glie'?"),
    (
        "[select]",
        "seeds = 3\n\n[select]",
        24,
        "it is of the whole experiment: write it above the first table",
    ),
    ("[select]", "[selct]", 24, "an experiment has no 'selct'; did you mean 'select'?"),
    ("fresh_seeds", "fresh", 25, "select has no parameter 'fresh'; did you mean 'fresh_seeds'?"),
    ("= 7", "= 0", 25, "fresh_seeds must be a whole number of at least 1"),
    ("fresh_seeds = 7", "by = 'scor'", 25, "by 'scor' is unknown; did you mean 'score'?"),
]


@pytest.mark.parametrize(("there", "instead", "line", "message"), WRONG, ids=[w[1] or w[0] for w in WRONG])
def test_what_is_wrong_is_named_with_its_line(load, monkeypatch, there, instead, line, message):
    for name in ("exact_model", "value_iteration"):
        monkeypatch.setattr(planning, name, lambda *_, **__: pytest.fail("something was computed"))
    monkeypatch.setattr(jax, "jit", lambda *_, **__: pytest.fail("something was compiled"))
    assert there in FILE
    with pytest.raises(InputError) as error:
        load(FILE.replace(there, instead, 1))
    said = str(error.value)
    assert "\n" not in said
    assert f"x.toml{f', line {line}' if line else ''}: " in said
    assert message in said


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"method": []}, "there is no method: name one or more of sarsa,"),
        (
            {"method": [3]},
            "method must be a name, a class, an instance, or a table with one of them",
        ),
        ({"method": "sara"}, "'sara' is not a method; did you mean 'sarsa'?"),
        ({"environment": "windy"}, "'windy' is not an environment"),
        ({"seeds": None}, "seeds must be a whole number"),
        ({"method": {"name": "sarsa", "q0": 10**400}}, "q0 takes a number, not 1000"),
        ({"select": 3}, "select must be a table of by, fresh_seeds, not 3"),
        (
            {"method": {"name": "sarsa", "alpha": rl.schedules.Optax(abs)}},
            "cannot be written in a file; sweep",
        ),
        ({"method": {"name": "sarsa", "draw": [{"beta": 1}]}}, "sarsa has no parameter 'beta'"),
        (
            {"method": {"name": "sarsa", "draw": [{"alpha": "x"}]}},
            f"alpha: 'x' is neither a number nor a schedule; a schedule is {SCHEDULES}",
        ),
        (
            {"environment": "random-walk", "method": {"name": "td", "pi": 0.5}},
            "pi takes probabilities, a list",
        ),
    ],
)
def test_the_same_is_said_in_python_without_a_line(given, message):
    with pytest.raises(InputError) as error:
        small(**given)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_method_that_does_not_fit_the_environment_is_refused_with_its_line(load):
    text = '# a walk\nsteps = 9\nenvironment = "random-walk"\n[method]\nname = "td"\npi = [[1.0], [1.0]]\n'
    with pytest.raises(InputError, match=r"x\.toml, line 4: .*21 states"):
        plan(load(text).parts())


def test_files_that_cannot_be_read_are_named(tmp_path):
    for path, message in ((tmp_path, "Is a directory"), (tmp_path / "none.toml", "No such file")):
        with pytest.raises(InputError, match=message):
            Experiment.load(path)
    (tmp_path / "x.toml").write_bytes(b"seeds = '\xff'")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        Experiment.load(tmp_path / "x.toml")


def test_what_is_missing_is_named(load):
    with pytest.raises(
        InputError, match=r"x\.toml: there is no \[\[environment\]\]: name one or more of windy"
    ):
        load("steps = 3")


# --- what it will take -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def parts():
    return Experiment(**PYTHON).parts()


def test_parts_are_every_method_in_every_environment_with_its_grid(parts):
    names = ["sarsa", "n-step-sarsa"]
    assert list(parts) == [
        f"windy-gridworld,stochastic={x}/{name}" for x in ("false", "true") for name in names
    ]
    sarsa, n_step = list(parts.values())[2:]
    assert sarsa.env.stochastic and sarsa.env.moves == "king"
    assert sarsa.axes == {"alpha": (0.1, 0.5), "epsilon": (0.01, 0.1, 1.0)}
    assert list(n_step.axes) == ["n", "draw"]
    assert (n_step.runs, n_step.num_seeds, n_step.seed) == (60, 10, 0)
    assert n_step.budget == Budget(800, None, 100, False)


def test_the_plan_counts_programs_runs_blocks_and_bytes(parts, monkeypatch):
    """n and schedules beside numbers make programs of their own; 64 runs are a block. Of 8 rows a run gives

    5 sums in 4 bytes each, and a table [70, 8].
    """
    monkeypatch.setattr(speeds, "read", speeds.Known)  # whatever other tests have kept; see test_forecast.py
    found = plan(parts)
    sarsa, n_step = list(found.parts.values())[:2]
    each = 4 * (8 * 5 + 70 * 8)
    kinds = len(
        {
            isinstance(trial["epsilon"], float)
            for trial in parts[next(iter(parts))[:-5] + "n-step-sarsa"].axes["draw"]
        }
    )
    assert sarsa[:5] == (1, 60, 1, 48_000, 60 * each)
    assert n_step[:5] == (2 * kinds, 60, 2 * kinds, 48_000, 60 * each)
    assert each * 64 < sarsa.working < 20 * each * 64
    assert found.unit == "steps" and found.devices == "2 cores"
    head, *lines, total, where, about = found.text().splitlines()
    assert head.split() == ["programs", "runs", "blocks", "steps", "results", "working", "memory", "time"]
    assert len(lines) == 4 and total.split()[:3] == ["all", "together", str(2 + 4 * kinds)]
    assert where.startswith("on 2 cores; the time is that of computing")
    assert " about " in total and "it may take twice as long, or half" in about


def test_the_plan_says_what_a_run_takes(parts):
    """The bytes of the results are those that a sweep then holds."""
    name = "windy-gridworld,stochastic=false/sarsa"
    done = result(parts[name], compute(parts[name]))
    arrays = [done.q, *(x for x in done.log if x is not None)]
    assert plan({name: parts[name]}).parts[name].results == sum(x.nbytes for x in arrays)
    assert done.to_xarray().sizes["epsilon"] == 3


def test_the_time_left_goes_by_what_was_measured(parts):
    found = plan(parts)
    first, second, *_ = found.parts
    runs = {name: x.runs for name, x in found.parts.items()}
    assert seconds_left(runs, {}) is None
    assert seconds_left(runs, {first: (0, 3.0)}) is None  # compiling
    assert seconds_left(runs, {first: (30, 2.0)}) == pytest.approx(2 + 3 * 4)
    assert seconds_left(runs, {first: (60, 4.0), second: (30, 1.0)}) == pytest.approx(1 + 2 * 60 * 5 / 90)
    assert seconds_left(runs, dict.fromkeys(found.parts, (60, 1.0))) == 0


# --- on the command line -----------------------------------------------------------------------------


def test_the_template_is_a_file_that_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "--write-template", "mine.toml"]) == 0
    assert capsys.readouterr().out == "mine.toml is written; try jaxrl-tab sweep mine.toml --dry-run\n"
    assert (tmp_path / "mine.toml").read_text() == template()
    assert main(["sweep", "--write-template", "mine.toml"]) == 2
    assert capsys.readouterr().err == "jaxrl-tab: mine.toml exists already; name a new file\n"
    assert main(["sweep", "--write-template"]) == 0
    assert capsys.readouterr().out == template()
    assert main(["sweep", "mine.toml", "--dry-run"]) == 0
    assert capsys.readouterr().out == plan(Experiment.load("mine.toml").parts()).text() + "\n"


@pytest.mark.weekly
def test_the_template_gives_results(tmp_path, monkeypatch):
    """As it is, but with shorter runs, and fewer; and without its pictures, which others draw."""
    monkeypatch.setattr(plot, "save_all", quick.picture)
    short = template().replace("seeds = 20 ", "seeds = 2 ").replace("steps = 4000 ", "steps = 200 ")
    (tmp_path / "x.toml").write_text(short)
    assert main(["sweep", str(tmp_path / "x.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert len((tmp_path / "out" / "summary.csv").read_text().splitlines()) == 41


def test_all_of_the_template_is_true_with_its_comments_taken_away(load, tmp_path):
    """What it proposes in comments can be written as it stands there."""
    (tmp_path / "mine.py").write_text('def q_of_start(state):\n    return {"q_start": state.q[0]}\n')
    lines = template().splitlines()
    code = [line[2:] if line.startswith("# ") and _is_toml(line[2:]) else line for line in lines]
    whole = load("\n".join(code))
    assert len(whole.environment) == 3
    assert whole.environment[2]["label"] == "strong wind"
    assert whole.select == {"by": "score", "fresh_seeds": 20}
    assert whole.record["name"] == "mine.py:q_of_start"


def _is_toml(line):
    try:
        return bool(tomllib.loads(line))
    except tomllib.TOMLDecodeError:
        return False


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        ("x.toml sarsa", "sarsa cannot be given together with a file: x.toml alone says what is run"),
        ("x.toml --seeds 3", "--seeds cannot be given together with a file: x.toml alone says what is run"),
        (
            "x.toml --log-every 3",
            "--log-every cannot be given together with a file: x.toml alone says what is run",
        ),
        ("x.toml --alpha 0.1", "--alpha cannot be given together with a file: x.toml alone says what is run"),
        (
            "x.toml --moves king",
            "--moves cannot be given together with a file: x.toml alone says what is run",
        ),
        ("none.toml", "none.toml cannot be read: No such file or directory"),
        ("--write-template no/x.toml", "no/x.toml cannot be written: No such file or directory"),
    ],
)
def test_wrong_commands_are_refused(tmp_path, monkeypatch, capsys, argv, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.toml").write_text(FILE)
    assert main(["sweep", *argv.split()]) == 2
    assert capsys.readouterr().err == f"jaxrl-tab: {message}\n"


def test_what_is_typed_is_an_experiment_like_any(tmp_path, monkeypatch, capsys):
    """It would take what the same file does"""
    monkeypatch.chdir(tmp_path)
    typed = "windy-gridworld sarsa --moves king --alpha 0.1 0.5 --seeds 7 --first-seed 20 --steps 900"
    assert main(["sweep", *typed.split(), "--dry-run"]) == 0
    given = Experiment(
        environment={"name": "windy-gridworld", "moves": "king"},
        method={"name": "sarsa", "alpha": [0.1, 0.5]},
        seeds=7,
        first_seed=20,
        steps=900,
    )
    assert given.parts()["windy-gridworld/sarsa"].first_seed == 20
    (tmp_path / "x.toml").write_text(given.to_toml())
    said = capsys.readouterr().out
    assert main(["sweep", "x.toml", "--dry-run"]) == 0
    assert capsys.readouterr().out == said
    assert main(["sweep", "x.toml", "--dry-run", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["unit"] == "steps" and found["parts"]["windy-gridworld/sarsa"]["work"] == 2 * 7 * 900
