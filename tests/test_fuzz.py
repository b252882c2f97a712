"""Whatever a person gives: the command line, files and functions answer, or say in one short line what is wrong.

All is drawn from fixed seeds, and nothing is compiled or computed. To look further, by hand:

    python test_fuzz.py SEED TIMES
"""

import contextlib
import dataclasses
import datetime
import io
import math
import os
import random
import sys
import tempfile
import time
import tomllib
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import cli, planning, policies, schedules, stats
from jaxrl_tab.cli import bridge, figure, listing, schedule, sweep, watch
from jaxrl_tab.cli.bridge import Bridge
from jaxrl_tab.cli.figure import Figure
from jaxrl_tab.cli.schedule import Schedule
from jaxrl_tab.cli.solve import Solve
from jaxrl_tab.cli.sweep import Resume, Sweep
from jaxrl_tab.cli.watch import Watch
from jaxrl_tab.core import describe
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import axes
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment import runner
from jaxrl_tab.experiment.resolve import Selection
from jaxrl_tab.experiment.spec import Experiment, template
from jaxrl_tab.figures import FIGURES
from jaxrl_tab.methods import METHODS

pytestmark = pytest.mark.filterwarnings("ignore:Python iterable type:DeprecationWarning")  # JAX, of iterators
LONGEST = 400  # characters of a message
SECONDS = 60.0  # of computing: what takes longer hangs. How fast it is, benchmarks say

CYCLE: list = []
CYCLE.append(CYCLE)

KINDS = [
    *(None, True, "", "0.5", "glie", "softmax:0.5", "x" * 10_000, "a\nb", "\0", "\ud800", b"x", 1j, math.nan),
    *(math.inf, -math.inf, -1, 0, 1, 1.5, -0.5, 1e39, -1e39, 1e-50, 10**400, 10**5000, 2**31, 2**63, []),
    *(
        [0.1, 0.2],
        (1, 2),
        [[1], [1, 2]],
        CYCLE,
        {},
        {"a": 1},
        {1: 2},
        set(),
        object(),
        len,
        lambda n: n,
        float,
    ),
    *(rl.Sarsa, rl.Sarsa(), rl.ENVS["two-doors"](), policies.Softmax, policies.Softmax(), schedules.Power),
    *(
        schedules.glie(),
        np.ones(2),
        np.ones((2, 2)),
        np.array("x"),
        np.array(None),
        np.float32(0.5),
        jnp.ones(3),
    ),
    *(datetime.date(2026, 1, 1), Fraction(1, 2), Fraction(10**400, 3), Decimal(1), range(3), iter([1])),
    *(Path("x"), np.datetime64("2026"), xr.DataArray([1.0, 2.0], dims="seed"), xr.Dataset(), NotImplemented),
    *(rl.LogGrid(0.01, 1, 5), rl.Uniform(0, 1), np.array([1, "x", None], object), np.zeros(0), slice(None)),
]


def said(what, call, *given, **named):
    """What `call` says where it refuses; nothing where it does not. Fails at any other error, or where it hangs."""
    begun = time.process_time()
    try:
        with np.errstate(all="ignore"):
            call(*given, **named)
        message = ""
    except InputError as error:
        message = str(error)
    except BaseException as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {str(error)[:300]}") from error
    took = time.process_time() - begun
    assert took < SECONDS, f"{what}: took {took:.1f} s"
    assert "\n" not in message, f"{what}: {message!r}"
    assert len(message) < LONGEST, f"{what}: {len(message)} characters: {message}"
    return message


def brief(value):
    try:
        return repr(value)[:80]
    except Exception:
        return type(value).__name__


# --- the command line --------------------------------------------------------------------------------

WORDS = [
    *(
        "",
        "-",
        "--",
        "None",
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "1",
        "0.5",
        "1e39",
        "1e-50",
        "1e400",
        "9" * 5000,
    ),
    *(
        "2147483647",
        "2147483648",
        "x" * 5000,
        "ä",
        "☃",
        "\udcff",
        "\0",
        "a\nb",
        "[bold]",
        "glie",
        "softmax:0.5",
    ),
    *(
        "harmonic:nan:visit",
        "power:::",
        "ucb:-1",
        "--alpha",
        "--alpha=0.1",
        "--=",
        "--json=1",
        "4GB",
        "1e9 TB",
    ),
    *("true", "0x10", "1_000", " 1", "٣", "0.1,0.2", "[0.1]", "{}", "a=b", "=", "..", "/", "x.toml", "-h"),
]


def options_of(command):
    """The options of a command as they are spelled."""
    if command is None:
        return ["--json", "--backups", "--out"]
    own = ["--" + field.name.replace("_", "-") for field in dataclasses.fields(command)]
    classes = [*ENVS.values(), *METHODS.values()] if command in (Sweep, Solve, Watch, Bridge) else []
    return [*own, *("--" + p.name.replace("_", "-") for cls in classes for p in describe.parameters(cls))]


COMMANDS = {
    "list": None,
    "bridge": Bridge,
    "schedule": Schedule,
    "solve": Solve,
    "watch": Watch,
    "sweep": Sweep,
    "resume": Resume,
    "figure": Figure,
}
OPTIONS = {name: options_of(command) for name, command in COMMANDS.items()}
NAMES = {
    "list": [*ENVS, *METHODS],
    "bridge": list(ENVS),
    "schedule": [*schedules.SHORT, "0.1", "power:0.5:step"],
    "solve": list(ENVS),
    "watch": list(ENVS),
    "figure": list(FIGURES),
    "sweep": list(ENVS),
    "resume": ["."],
}


def some_words(draw):
    """A command as somebody might type it."""
    name = draw.choice(list(COMMANDS)) if draw.random() < 0.95 else draw.choice(WORDS)
    words = [name]
    if names := NAMES.get(name, []):
        words.append(draw.choice(names))
    if name in ("sweep", "watch", "bridge"):
        words += draw.choices(list(METHODS), k=draw.randint(1, 2 if name == "sweep" else 1))
    for _ in range(draw.randint(0, 3)):
        words.append(draw.choice(OPTIONS.get(name, WORDS)))
        words += draw.choices(WORDS, k=draw.choice([0, 1, 1, 1, 2]))
    if draw.random() < 0.3:
        words[draw.randrange(len(words))] = draw.choice(WORDS)
    return words


def run(words):
    """Runs a command. Raises InputError with what it says where that is one line and the exit code 2."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = cli.main(words)
        except SystemExit as stop:  # help
            code = stop.code or 0
    line = err.getvalue()
    if code == 0:
        assert line == ""
        return
    assert code == 2, f"exit code {code}: {line}"
    assert out.getvalue() == ""
    assert line.startswith("jaxrl-tab: ")
    assert line.endswith("\n")
    raise InputError(line.removesuffix("\n"))


def type_commands(seed, times):
    draw = random.Random(seed)
    for _ in range(times):
        words = some_words(draw)
        said(words, run, words)


@pytest.fixture
def idle(monkeypatch, tmp_path):
    """Nothing is computed, and what is written is in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    for env in (WINDY, WALK):
        planning.exact_model(env)  # is compiled now, so that the time does not count
    make_idle(monkeypatch.setattr)


def make_idle(put):
    def stop(*_, **__):
        raise InputError("so far it was right")

    put(sweep, "_conduct", stop)
    put(watch, "watch", stop)
    put(bridge, "_compare", stop)
    put(bridge, "_draw", stop)
    put(listing, "_draw", stop)
    put(schedule, "_draw", stop)
    put(figure, "make_runs", stop)
    get = rl.executors.get

    def get_or_stop(name, **given):
        executor = get(name, **given)
        return executor if name == "local" else stop()  # or no sweep would be read any further

    put(rl.executors, "get", get_or_stop)
    for name in ("policy_iteration", "epsilon_soft"):
        put(planning, name, stop)


def test_commands_end_well_or_in_one_line(idle):
    type_commands(seed=0, times=200)


@pytest.mark.parametrize("command", ["sweep", "sweep x.toml --out", "resume", "solve two-doors --out"])
@pytest.mark.parametrize("name", ["\0", "x" * 5000, "\ud800"], ids=["NUL", "long", "half"])
def test_names_that_no_file_can_have_are_refused(tmp_path, monkeypatch, command, name):
    """Broken once: NUL and halves of characters let through; a name of 5000 characters said whole -> fails."""
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(SMALL)
    assert said(command, run, [*command.split(), f"{name}.toml"])
    assert [path.name for path in tmp_path.iterdir()] == ["x.toml"]


# --- files -------------------------------------------------------------------------------------------

PIECES = [
    *(
        "nan",
        "inf",
        "-1",
        "1e400",
        "9" * 5000,
        "true",
        "2026-01-01",
        "2026-13-01",
        "[]",
        "{}",
        '""',
        '"x"',
        "[[]]",
    ),
    *(
        "[" * 40,
        "]",
        "{",
        "'''",
        '"""',
        '"',
        "=",
        ".",
        "a.b.c=1",
        "a." * 40 + "a=1",
        "\0",
        "\ud7ff",
        "\\u0000",
        "#",
    ),
    *(
        "{log = [0.01, 1], points = 5}",
        "{log = [0.01, 1], points = 100000000}",
        "{uniform = [0, 1]}",
        "[0.1, 0.1]",
    ),
    *(
        "draws = 1000000000",
        "draws = 2",
        "points = 200000",
        "[select]",
        "[[method]]",
        "[[environment]]",
        "\r",
        "é",
    ),
    *(
        'label = "a/b"',
        'label = "%s"' % ("x" * 500),
        'label = "$"',
        "seeds = 4000000000",
        "select = 3",
        "x = 1\n",
    ),
]


def some_text(draw):
    """The template, or a small file, with some damage."""
    lines = draw.choice(FILES).split("\n")
    for _ in range(draw.randint(1, 4)):
        i = draw.randrange(len(lines))
        line = lines[i]
        match draw.randrange(7):
            case 0:
                del lines[i : i + draw.choice([1, 1, 5])]
                lines = lines or [""]
            case 1:
                lines.insert(draw.randrange(len(lines)), line)
            case 2:
                lines[i] = draw.choice(PIECES)
            case 3:
                lines[i] = line.partition("=")[0] + "= " + draw.choice(PIECES)
            case 4 if line:
                at = draw.randrange(len(line))
                lines[i] = line[:at] + chr(ord(line[at]) ^ (1 << draw.randrange(7))) + line[at + 1 :]
            case 5 if line:
                at = draw.randrange(len(line))
                lines[i] = line[:at] + draw.choice(PIECES) + line[at + draw.randrange(3) :]
            case _:
                lines.insert(i, draw.choice(PIECES))
    return "\n".join(lines)


SMALL = """seeds = 3
steps = 100
[[environment]]
name = "windy-gridworld"
moves = ["four", "king"]
wind = [0, 0, 0, 1, 1, 1, 2, 2, 1, 0]
[[method]]
name = "sarsa"
label = "first"
alpha = {log = [0.01, 1], points = 5}
epsilon = ["glie", "optax:linear_schedule(1, 0, 5)"]
[[method]]
name = "q-learning"
draws = 3
alpha = {uniform = [0.1, 0.5]}
behaviour = "softmax:0.5"
[select]
fresh_seeds = 5
"""
FILES = [template(), SMALL, SMALL]


def read_files(seed, times):
    draw, file = random.Random(seed), Path("x.toml")
    for _ in range(times):
        text = some_text(draw)
        file.write_text(text, encoding="utf-8", newline="")
        said(text, Experiment.load, file)


def test_damaged_files_are_read_or_refused_in_one_line(idle):
    """Broken once: numbers of 5000 digits as tomllib leaves them -> fails."""
    read_files(seed=0, times=250)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = " + "[" * 3000 + "]" * 3000, "line 1: more than 32 brackets are in one another"),
        (".".join(["a"] * 20_000) + " = 1", "line 1: more than 32 parts are in a key"),
        (
            SMALL.replace("points = 5", "points = 200000"),
            "line 10: alpha: 200000 points are 200,000 settings",
        ),
        (SMALL.replace("draws = 3", "draws = 1e9"), "the number of draws must be a whole number"),
        (
            SMALL.replace("draws = 3", "draws = 1000000000"),
            "are 1,000,000,000 settings, and there may be 100,000",
        ),
        (SMALL.replace("points = 5", "points = 50000"), "the methods in 2 environments are 200,000 settings"),
        (SMALL + "x = " + "9" * 5000, "a whole number has more digits than Python reads"),
        (SMALL.replace('"first"', f'"{"x" * 10_000}"'), "line 9: a label may have 200 characters"),
        (SMALL.replace('"first"', '"a\\u0085b"'), "a label must be a text in one line"),
        ("#" * (2**26 + 1), "is larger than 67.1 MB: that is not an experiment"),
    ],
    ids=lambda x: x[-60:],
)
def test_what_is_absurd_is_refused_before_it_is_expanded(idle, text, message):
    """Broken once: brackets in one another as tomllib leaves them -> fails, as does each without its limit."""
    Path("x.toml").write_text(text)
    assert message in said(message, Experiment.load, "x.toml")


@pytest.mark.parametrize(
    ("method", "mistake", "message", "most"),
    [
        (1999, "alhpa = 1", "line 6007: m1999 has no parameter 'alhpa'", 15),
        (1000, "alpha = -1", "line 3010: sarsa: alpha must be greater than 0, not -1", 15),
        (1000, "alpha = = 1", "line 3010: invalid value", 1),
        (1999, "alpha = [\n0.1,", "line 6007: invalid value", 1),
    ],
)
def test_a_mistake_in_a_long_file_is_found_in_few_parses(idle, monkeypatch, method, mistake, message, most):
    """2000 methods: to read it, to look for the keys, and log2(6007) times. Broken once: no bisection -> fails."""
    parses, loads = [], tomllib.loads
    monkeypatch.setattr(tomllib, "loads", lambda text: parses.append(text) or loads(text))
    methods = [f'[[method]]\nname = "sarsa"\nlabel = "m{i}"\n' for i in range(2000)]
    methods[method] += f"{mistake}\n"
    Path("x.toml").write_text(SMALL.partition("[[method]]")[0] + "".join(methods))
    assert f"x.toml, {message}" in said(mistake, Experiment.load, "x.toml")
    assert len(parses) <= most


# --- functions ---------------------------------------------------------------------------------------

CLASSES = {
    **ENVS,
    **METHODS,
    **schedules.FAMILIES,
    **policies.POLICIES,
    **axes.WRITTEN,
    "table": policies.Table,
    "optax": schedules.Optax,
    "selection": Selection,
    "many-targets": rl.ManyTargets,
}
NEEDED = {
    "linear": {"low": 0, "high": 1, "points": 3},
    "exponential": {"start": 1.0, "rate": 0.5},
}
WINDY, WALK = rl.make("windy-gridworld"), rl.make("random-walk")
POLICY = np.full((70, 4), 0.25)
SHORT = {"num_seeds": 2, "num_steps": 10}


def made():
    """Each class with each of its fields."""
    for name, cls in CLASSES.items():
        fields = [field for field in dataclasses.fields(cls) if field.init]
        needed = {f.name for f in fields if f.default is dataclasses.MISSING}
        for field in fields:
            if not needed - {field.name}:
                yield f"{name}({field.name})", lambda x, cls=cls, field=field: cls(**{field.name: x})
    linear = {"start": 1.0, "end": 0.1, "steps": 5}
    for name in linear:
        yield f"Linear({name})", lambda x, name=name: schedules.Linear(**{**linear, name: x})
    for name in ("start", "rate", "end"):
        given = {"start": 1.0, "rate": 0.5}
        yield (
            f"Exponential({name})",
            lambda x, name=name, given=given: schedules.Exponential(**{**given, name: x}),
        )
    for cls, ends in ((axes.LinearGrid, (0, 1, 3)), (axes.LogGrid, (0.1, 1, 3)), (axes.Uniform, (0, 1))):
        for i in range(len(ends)):
            yield f"{cls.__name__} {i}", lambda x, i=i, cls=cls, ends=ends: cls(*ends[:i], x, *ends[i + 1 :])


def called():
    """Functions with one argument that may be anything."""
    yield "make", rl.make
    yield "parse", schedules.parse
    yield "parse", policies.parse
    yield "is_glie", schedules.is_glie
    yield "is_robbins_monro", schedules.is_robbins_monro
    yield "grid", lambda x: rl.sweep(WINDY, rl.Sarsa, x, **SHORT)
    yield "grid of alpha", lambda x: rl.sweep(WINDY, rl.Sarsa, {"alpha": x}, **SHORT)
    yield "grid of alphas", lambda x: rl.sweep(WINDY, rl.Sarsa, {"alpha": [0.5, x]}, **SHORT)
    yield "grid of n", lambda x: rl.sweep(WINDY, rl.NStepSarsa, {"n": x}, **SHORT)
    yield "draw", lambda x: rl.sweep(WINDY, rl.Sarsa, {"draw": x}, **SHORT)
    yield "draws", lambda x: rl.sweep(WINDY, rl.Sarsa, {"draw": [x]}, **SHORT)
    yield "sweep env", lambda x: rl.sweep(x, rl.Sarsa, **SHORT)
    yield "sweep algorithm", lambda x: rl.sweep(WINDY, x, **SHORT)
    for name in ("num_seeds", "num_steps", "num_draws", "log_every", "seed", "memory", "num_episodes"):
        yield f"sweep {name}", lambda x, name=name: rl.sweep(WINDY, rl.Sarsa, **SHORT | {name: x})
    key = jax.random.key(0)
    yield "train key", lambda x: rl.train(x, rl.Sarsa(alpha=np.ones(2)), WINDY, num_steps=10)
    yield "train algorithm", lambda x: rl.train(key, x, WINDY, num_steps=0)
    yield "train env", lambda x: rl.train(key, rl.Sarsa(alpha=np.ones(2)), x, num_steps=10)
    for name in ("num_steps", "log_every", "num_episodes"):
        given = {"num_steps": 10}
        batch = rl.Sarsa(alpha=np.ones(2))
        yield f"train {name}", lambda x, n=name, b=batch, g=given: rl.train(key, b, WINDY, **g | {n: x})
    yield "watch env", lambda x: rl.watch(x, rl.Sarsa(), at=0)
    yield "watch algorithm", lambda x: rl.watch(WINDY, x, at=0)
    for name in ("num_episodes", "at", "seed", "root_seed"):
        given = {"root_seed": -1} if name != "root_seed" else {"seed": -1}
        yield f"watch {name}", lambda x, n=name, g=given: rl.watch(WINDY, rl.Sarsa(), **g | {n: x})
    yield "load", Experiment.load
    yield "from_data", Experiment.from_data
    whole = {"environment": "windy-gridworld", "method": "sarsa", "steps": 10}
    for name in [
        field.name for field in dataclasses.fields(Experiment) if field.init and field.name != "source"
    ]:
        yield f"Experiment {name}", lambda x, name=name: Experiment(**whole | {name: x})
    for key_ in ("name", "label", "moves", "wind", "shape", "stochastic", "x"):
        table = {"name": "windy-gridworld"}
        yield (
            f"environment {key_}",
            lambda x, k=key_, t=table: Experiment(**whole | {"environment": t | {k: x}}),
        )
    for key_ in ("name", "label", "alpha", "n", "behaviour", "draws", "draw", "x"):
        table = {"name": "n-step-sarsa"}
        yield f"method {key_}", lambda x, k=key_, t=table: Experiment(**whole | {"method": t | {k: x}})
        yield f"methods {key_}", lambda x, k=key_, t=table: Experiment(**whole | {"method": t | {k: [x, 1]}})
    for key_ in ("log", "points", "uniform", "choice", "integers", "linear"):
        yield (
            f"axis {key_}",
            lambda x, k=key_: Experiment(
                **whole | {"method": {"name": "sarsa", "alpha": {"log": [0.1, 1], "points": 2} | {k: x}}}
            ),
        )
    yield "run", lambda x: rl.run(x, "out")
    yield "run in", lambda x: rl.run(Experiment(**whole), x, memory=1)
    yield "resume", rl.resume
    for name in ("value_iteration", "policy_iteration", "generalized_policy_iteration"):
        yield name, getattr(planning, name)
        yield f"{name} gamma", lambda x, name=name: getattr(planning, name)(WALK, x)
    for name in ("sweeps", "epsilon", "policy", "improvements", "tol"):
        yield f"iterates {name}", lambda x, k=name: planning.generalized_policy_iteration(WALK, **{k: x})
    yield "evaluate", lambda x: planning.evaluate(WINDY, x)
    yield "evaluate env", lambda x: planning.evaluate(x, POLICY)
    yield "evaluate gamma", lambda x: planning.evaluate(WINDY, POLICY, x)
    yield "policy_value", lambda x: planning.policy_value(WINDY, x)
    yield "epsilon_soft", lambda x: planning.epsilon_soft(WALK, x)
    yield "greedy_policy", planning.greedy_policy
    yield "epsilon_greedy_policy", lambda x: planning.epsilon_greedy_policy(np.ones((2, 2)), x)
    yield "start_value", lambda x: planning.start_value(WINDY, x)
    values = xr.DataArray(np.arange(10.0), dims="seed")
    for function in (
        stats.mean_interval,
        stats.median_interval,
        stats.iqm_interval,
        stats.proportion_interval,
    ):
        yield f"{function.__name__} dim", lambda x, f=function: f(values, x)
        yield f"{function.__name__} confidence", lambda x, f=function: f(values, confidence=x)


def call_functions(pairs, kinds=KINDS):
    for name, call in pairs:
        for value in kinds:
            said(f"{name}: {brief(value)}", call, value)


@pytest.fixture
def stubbed(idle, monkeypatch):
    make_still(monkeypatch.setattr)


def make_still(put):
    """Sweeps are prepared, and end there."""

    def stop(*_, **__):
        raise InputError("so far it was right")

    put(sys.modules["jaxrl_tab.engine.sweep"], "compute", stop)
    put(runner, "_begin", stop)


@pytest.mark.slow
def test_every_field_of_every_class_takes_a_value_or_refuses_it_in_one_line(stubbed):
    """Broken once: a list as a number, a text as a schedule -> fails."""
    call_functions(made())


def test_functions_answer_or_refuse_in_one_line(stubbed):
    """Broken once: NUL in a path let through -> fails."""
    call_functions(called())


if __name__ == "__main__":
    planning.exact_model(WINDY), planning.exact_model(WALK)  # compiled by now
    os.environ["JAXRL_TAB_TRACEBACK"] = "1"
    os.chdir(tempfile.mkdtemp())
    make_idle(setattr)
    make_still(setattr)
    start, many = map(int, sys.argv[1:3])
    wrong: dict[str, int] = {}
    for what in (type_commands, read_files):
        for number in range(start, start + many):
            try:
                what(number, 1)
            except AssertionError as error:
                line = str(error)[-600:]
                wrong[line] = wrong.get(line, 0) + 1
    for name, call in [*made(), *called()]:
        for value in KINDS:
            try:
                said(f"{name}: {brief(value)}", call, value)
            except AssertionError as error:
                wrong[str(error)[:300]] = 1
    for line in wrong:
        print("*", line, "\n")
    print(
        f"{many} commands, {many} files, {len([*made(), *called()]) * len(KINDS)} calls: {len(wrong)} wrong"
    )
