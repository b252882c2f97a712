"""The command line as a person or a program meets it: what it prints, its exit codes, its folder."""

import dataclasses
import json
import os
import re
import shlex
import subprocess
import sys

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from made_up import make_result
from rich.console import Console

import jaxrl_tab as rl
from jaxrl_tab import planning, plot, stats
from jaxrl_tab.cli import main, screen
from jaxrl_tab.cli import sweep as sweep_module
from jaxrl_tab.cli.solve import Solve
from jaxrl_tab.cli.sweep import Sweep
from jaxrl_tab.cli.tables import best_actions
from jaxrl_tab.cli.typed import flag_of
from jaxrl_tab.core import describe
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.envs import ENVS
from jaxrl_tab.experiment import runner, shards
from jaxrl_tab.figures import FIGURES, figure
from jaxrl_tab.lanes import versions
from jaxrl_tab.methods import ALGORITHMS, METHODS, PREDICTION
from jaxrl_tab.show import rows as of_report
from jaxrl_tab.stats.columns import Methods

TINY = ["--alpha", "0.5", "1", "--seeds", "3", "--steps", "1000", "--log-every", "250"]

KEPT = {"experiment.toml", "resolved.json", "provenance.json", "manifest.json", "shards", ".lock"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder that a small sweep of two methods leaves."""
    folder = tmp_path_factory.mktemp("cli") / "runs" / "windy"
    assert main(["sweep", "windy-gridworld", "sarsa", "q-learning", *TINY, "--out", str(folder)]) == 0
    return folder


def call(command, *more):
    return main([*command.split(), *more])


def refused(capsys, command, *more):
    """The one line on stderr of a command that is refused with exit code 2."""
    assert call(command, *more) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("jaxrl-tab: ")
    assert printed.err.count("\n") == 1
    assert printed.err.endswith("\n")
    return printed.err


# --- sweep: what it leaves and prints ----------------------------------------------------------------


def test_sweep_leaves_data_summary_and_pictures_and_nothing_else(run):
    names = {file.name for file in run.iterdir()}
    pictures = {"episodes.png", "learning_curves.png", "sensitivity.png", "greedy_path.png", "overview.png"}
    assert names == {"results.nc", "summary.csv", "report.html"} | KEPT | pictures
    assert [file.name for file in run.parent.iterdir()] == ["windy"]
    assert all((run / name).read_bytes().startswith(b"\x89PNG") for name in pictures)


def test_the_data_on_disk_are_those_of_the_library(run, windy):
    tree = xr.open_datatree(run / "results.nc")
    assert set(tree.children) == {"sarsa", "q-learning"}
    assert "--log-every 250" in tree.attrs["command"]
    assert tree.attrs["version"] == rl.__version__
    for name in ("sarsa", "q-learning"):
        saved = tree[name].to_dataset()
        expected = rl.sweep(windy, name, {"alpha": [0.5, 1.0]}, num_seeds=3, num_steps=1000, log_every=250)
        xr.testing.assert_equal(saved, expected.to_xarray())
        timed = ("seconds", "compile_seconds", "steps_per_second")
        for attribute, value in expected.to_xarray().attrs.items():
            assert attribute in timed or saved.attrs[attribute] == value


def test_the_summary_on_disk_is_that_of_stats(run):
    tree = xr.open_datatree(run / "results.nc")
    expected = stats.summary({name: tree[name].to_dataset() for name in ("sarsa", "q-learning")})
    pd.testing.assert_frame_equal(pd.read_csv(run / "summary.csv"), expected, check_dtype=False)


def test_sweep_prints_a_table_and_as_json_the_summary(run, capsys):
    argv = ["sweep", "windy-gridworld", "sarsa", "q-learning", *TINY]
    assert main(argv) == 0
    printed = capsys.readouterr()
    summary = pd.read_csv(run / "summary.csv")
    for method, rows in summary.groupby("method"):
        lines = [line.split("│") for line in printed.out.splitlines() if f"│ {method} " in line]
        assert [float(line[2]) for line in lines] == [0.5, 1.0]
        np.testing.assert_allclose([float(line[3]) for line in lines], rows.episodes, atol=0.05)
        bounds = [line[7].replace("–", "nan to nan").strip(" !").split(" to ") for line in lines]
        means = [line[6].replace("–", "nan") for line in lines]
        shown = [[float(mean), *map(float, ends)] for mean, ends in zip(means, bounds, strict=True)]
        columns = rows[["last_tenth_return", "last_tenth_low", "last_tenth_high"]]
        np.testing.assert_allclose(shown, columns, atol=0.005)
        starred = [row for row, line in enumerate(lines) if "*" in line[1]]
        assert starred == [rows.last_tenth_return.to_numpy().argmax()]
    assert "epsilon 0.1, gamma 1, q0 0, exact optimum -15, 3 seeds, 1000 steps each" in printed.out
    assert printed.err == ""  # no bar where stderr is no terminal

    assert main([*argv, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["folder"] is None
    numbers = [{name: np.nan if x is None else x for name, x in row.items()} for row in found["summary"]]
    frame = pd.DataFrame(numbers).drop(columns="steps_per_second")
    expected = summary.drop(columns="steps_per_second").replace({np.inf: np.nan})  # JSON has no infinity
    pd.testing.assert_frame_equal(frame, expected, check_dtype=False)

    assert main([*argv, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_the_table_says_what_its_numbers_rest_on(windy, capsys):
    """Eight seeds, one run of which is unfinished: -400 in the last two rows. Alpha 0.2 is 0.9, with other luck."""
    ds = make_result(windy, np.zeros((70, 4)), seeds=8).to_xarray()
    ds["episodes"][2, 0, -2:] = 0
    ds["returns"][2, 0, -2:] = 0
    everything = ds
    ds = ds.isel(alpha=[2, 2]).copy(deep=True).assign_coords(alpha=[0.2, 0.9])
    for name in ("returns", "episodes"):
        ds[name][0] = ds[name][1].roll(seed=1)
    ds["returns"][0] += 0.1 * ds.episodes[0]
    screen.print_summary("windy", Methods({"sarsa": ds}, windy))
    out = capsys.readouterr().out
    marks = [line.split("│")[1].strip() for line in out.splitlines() if "│ sarsa" in line]
    assert marks == ["sarsa *", "sarsa ~"]
    assert "unfinished runs end no episode in the last tenth" in out
    assert "up to 38% of all runs may be stuck, which 8 seeds need not show" in out
    assert "! Sarsa: the median is -1" in out
    assert "With ε = 0.1 and γ = 1, no policy that goes on exploring is worth more than -17.0483." in out
    ds = everything.isel(alpha=[0, 2])
    screen.print_summary("windy", Methods({"sarsa": ds}, windy))
    assert "The best α of Sarsa is the largest that was tried" in capsys.readouterr().out


def test_a_narrow_window_cuts_no_number(windy, capsys, monkeypatch):
    """Nor a name: where columns have no room, the rows stand one below the other.

    Broken once, each: columns as rich makes them narrower; rows never one below the other -> fails.
    """
    ds = make_result(windy, np.zeros((70, 4)), seeds=3).to_xarray().isel(alpha=[0, 2])
    methods = Methods({"differential-semi-gradient-sarsa": ds}, windy)

    def printed(width):
        monkeypatch.setattr(
            screen, "console", lambda: Console(width=width, force_terminal=True, color_system=None)
        )
        screen.print_summary("windy", methods)
        return capsys.readouterr().out

    numbers = lambda out: {*re.findall(r"-?\d+\.\d+", out)}
    wide, narrow, rows = printed(160), printed(76), printed(40)
    for out, width in ((narrow, 76), (rows, 40)):
        assert "…" not in out and max(map(len, out.splitlines())) <= width
        assert len(numbers(out)) > 6 and numbers(out) <= numbers(wide)
        assert "differential-semi-gradient-sarsa" in out
    assert "│" in narrow and "│" not in rows
    assert "\n  mean return, last tenth: " in rows


def test_of_a_task_that_does_not_end_nothing_is_unfinished(windy):
    """In the report either. Broken once: `Column.fits` always true -> fails."""
    ds = make_result(windy, np.zeros((70, 4)), seeds=3).to_xarray()
    ds["episodes"][:] = 0

    def told(env):
        ranked = Methods({"sarsa": ds}, env).rows
        view = of_report.View(False, ["alpha"], 2)
        return of_report.settings_table(ranked, [], view).head, of_report.notes([ranked[0]], {}, view)

    head, notes = told(windy)
    assert {"unfinished", "episodes"} <= {*head} and any("finished no episode" in note for note in notes)
    head, (first, *others) = told(rl.make("two-loops"))
    assert "unfinished" not in head and "episodes" not in head
    assert first.startswith("The task does not end.") and not [x for x in others if "finished" in x]


@pytest.fixture
def asked(monkeypatch):
    """The data of the experiments that were asked for, none of which is run."""
    experiments = []
    monkeypatch.setattr(
        sweep_module, "_conduct", lambda experiment, *_: experiments.append(experiment.data()) or 0
    )
    return experiments


def test_sweep_without_options_has_sensible_ones(asked):
    main(["sweep", "windy-gridworld", "sarsa"])
    ((data,), (environment,), (method,)) = asked, asked[0].pop("environment"), asked[0].pop("method")
    assert environment["name"] == environment["label"] == "windy-gridworld"
    assert (method["name"], method["alpha"]) == ("sarsa", [0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0])
    assert data == {
        "seeds": 100,
        "steps": 8000,
        "log_every": 100,
        "seed": 0,
        "exact": False,
        "backend": "auto",
    }


def test_sweep_hands_every_option_on(asked):
    argv = (
        "sweep windy-gridworld q-learning --moves king --stochastic --wind 0 0 0 1 1 -1 2 2 1 0 --start 2 0"
    )
    argv += " --epsilon 0 0.1 --alpha sample-average --q0 -1 --episodes 7 --log-every 2 --seed 5 --exact"
    main(argv.split())
    ((data,), (environment,), (method,)) = asked, asked[0].pop("environment"), asked[0].pop("method")
    given = {"moves": "king", "stochastic": True, "start": [2, 0], "wind": [0, 0, 0, 1, 1, -1, 2, 2, 1, 0]}
    assert given.items() <= environment.items()
    given = {"alpha": "sample-average", "epsilon": [0.0, 0.1], "gamma": 1.0, "q0": -1.0}
    assert method == {"name": "q-learning", "label": "q-learning", **given}
    assert data == {"seeds": 100, "episodes": 7, "log_every": 2, "seed": 5, "exact": True, "backend": "auto"}


def test_glie_is_one_over_the_number_of_the_episode(asked):
    call("sweep windy-gridworld sarsa --epsilon glie")
    epsilon = rl.schedules.parse(asked[0]["method"][0]["epsilon"])
    assert epsilon.clock == "episode"
    assert float(epsilon(jax.numpy.int32(4))) == 0.25


@pytest.mark.slow
def test_sweep_records_exact_values_and_schedules(tmp_path):
    """With a device for each core, where batches of linear systems once waited for each other for ever.

    As a program of its own, because a hang cannot be interrupted.
    """
    out = tmp_path / "cliff"
    command = "-m jaxrl_tab sweep cliff-walking sarsa --alpha 0.5 --epsilon glie"
    command += " --steps 3000 --log-every 100 --seeds 128 --exact"
    argv = [sys.executable, *command.split(), "--out", str(out)]
    done = subprocess.run(argv, capture_output=True, text=True, check=True, timeout=100)
    assert "epsilon glie" in done.stdout
    ds = xr.open_datatree(out / "results.nc")["sarsa"].to_dataset()
    assert ds.greedy_value.dims == ds.q_error.dims == ("seed", "row")
    assert float(ds.greedy_value.max()) <= -13
    assert np.isfinite(ds.q_error).all()
    assert (ds.q_error.isel(row=0) != ds.q_error.isel(row=-1)).all()
    assert json.loads(ds.attrs["fixed"])["epsilon"] == "glie"


@pytest.mark.slow
def test_prediction_is_compared_by_its_error_beside_the_value_of_the_policy(tmp_path, capsys):
    """The random walk with ends 0 and 1: v_pi from the middle is 1/2, and there is no optimum to reach."""
    out = tmp_path / "walk"
    command = "sweep random-walk td-lambda --states 5 --left-reward 0 --lam 0 1 --alpha 0.1 --episodes 30"
    assert call(command, "--seeds", "3", "--out", str(out)) == 0
    text = capsys.readouterr().out
    assert (
        "random-walk, alpha 0.1, gamma 1, v0 0, trace accumulating, offline off, value of the policy 0.5, 3 seeds"
        in text
    )
    ds = xr.open_datatree(out / "results.nc")["td-lambda"].to_dataset()
    lines = [line.split("│") for line in text.splitlines() if "│ td-lambda " in line]
    error = ds.v_error.mean(("row", "seed")).values
    shown = np.array([[float(line[3]), float(line[4]), float(line[6])] for line in lines])
    early, late = (ds.v_error[..., rows].mean(("row", "seed")) for rows in (slice(3), slice(-1, None)))
    np.testing.assert_allclose(shown, np.c_[early, error, late], atol=5.1e-4)
    assert ["*" in line[1] for line in lines] == [i == error.argmin() for i in range(2)]
    assert ds.attrs["optimal_value"] == pytest.approx(0.5)
    names = {file.name for file in out.iterdir()}
    pictures = {"learning_curves.png", "sensitivity.png", "values.png", "overview.png"}
    assert names == {"results.nc", "summary.csv", "report.html"} | KEPT | pictures


@pytest.mark.slow
def test_policies_and_mixed_rates_make_grids_beside_the_mean_optimum_over_problems(capsys):
    """Broken once: v* of the problem whose means are 0 beside runs that each draw their own -> fails."""
    command = "sweep k-armed-testbed q-learning --alpha 0.1 sample-average --behaviour softmax:0.5"
    assert call(command, "--steps", "50", "--log-every", "50", "--seeds", "2", "--json") == 0
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert [row["alpha"] for row in summary] == [0.1, "sample-average"]
    assert [row["optimum"] for row in summary] == pytest.approx([1.538753] * 2)
    assert {row["behaviour"] for row in summary} == {"softmax:0.5"}
    assert "epsilon" not in summary[0]  # it is not looked at where the behaviour is given


def test_values_of_an_environment_are_environments_of_their_own(asked):
    """Names may stand after the values of an option. Broken once: only the first value taken -> fails."""
    argv = "sweep --moves four king windy-gridworld --alpha 0.5 sarsa --steps 50 --seeds 2 q-learning"
    main(argv.split())
    main(["sweep", "cliff-walking", "--shape", "3", "5", "sarsa"])  # several numbers are one shape
    (two, methods), (cliff, _) = [(data["environment"], data["method"]) for data in asked]
    assert [env["label"] for env in two] == ["windy-gridworld,moves=four", "windy-gridworld,moves=king"]
    assert [env["moves"] for env in two] == ["four", "king"]
    assert [method["name"] for method in methods] == ["sarsa", "q-learning"]
    assert [env["shape"] for env in cliff] == [[3, 5]]


def test_options_of_some_methods_go_to_those(asked):
    call("sweep random-walk td n-step-td --n 1 4 --alpha 0.5")
    td, n_step = asked[0]["method"]
    assert (td["alpha"], n_step["alpha"], n_step["n"], "n" in td) == (0.5, 0.5, [1, 4], False)
    assert asked[0]["exact"]  # nothing else tells methods of prediction apart


def test_words_and_options_may_stand_in_any_order_and_a_value_may_begin_with_a_minus(asked):
    """Broken once: parse_known_args, which reads the words only once -> fails; argparse's own numbers -> fails."""
    call("sweep --log_every=7 windy-gridworld sarsa --q0 -1e5 -.5 --seeds 3 q-learning --steps 70")
    (data,) = asked
    assert [method["name"] for method in data["method"]] == ["sarsa", "q-learning"]
    assert [method["q0"] for method in data["method"]] == [[-1e5, -0.5]] * 2
    assert (data["seeds"], data["steps"], data["log_every"]) == (3, 70, 7)


def test_a_parameter_of_ones_own_that_is_an_option_already_is_refused(monkeypatch, capsys):
    """Broken once: as argparse refuses it, which would be a defect -> fails."""
    seeded = pytree(type("Seeded", (rl.Sarsa,), {"__annotations__": {"seed": float}, "seed": 0.5}))
    monkeypatch.setitem(ALGORITHMS, "seeded", seeded)
    error = refused(capsys, "sweep windy-gridworld seeded --seed 3")
    assert "seeded cannot have --seed on the command line, where it means something else" in error


# --- nothing computed is lost ------------------------------------------------------------------------


@pytest.fixture
def stopped(monkeypatch):
    """Ctrl-C where Q-learning begins."""
    real = shards.compute

    def compute(part, *args, **kwargs):
        if part.algorithm is rl.QLearning:
            raise KeyboardInterrupt
        return real(part, *args, **kwargs)

    monkeypatch.setattr(shards, "compute", compute)


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done_and_says_how_to_go_on(run, stopped, monkeypatch, tmp_path, capsys):
    out = tmp_path / "windy"
    assert main(["sweep", "windy-gridworld", "sarsa", "q-learning", *TINY, "--out", str(out)]) == 130
    kept = f"what is finished is kept, `jaxrl-tab resume {out}` goes on"
    assert capsys.readouterr() == ("", f"jaxrl-tab: interrupted; {kept}\n")
    assert [file.name for file in out.glob("shards/*")] == ["000000.npz"]
    monkeypatch.undo()
    assert call("resume", str(out), "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert {file.name for file in out.iterdir()} == {file.name for file in run.iterdir()}
    for method in ("sarsa", "q-learning"):
        ds, expected = (xr.open_datatree(x / "results.nc")[method].to_dataset() for x in (out, run))
        xr.testing.assert_equal(ds, expected)


def test_to_go_on_all_is_asked_for_again_that_was(monkeypatch, tmp_path, capsys):
    """It may have stopped before the folder knew of it. Broken once: the folder alone is named -> fails."""

    def resume(*_, **__):
        raise RunError("no space left on device")

    monkeypatch.setattr(runner, "resume", resume)
    assert main(["resume", str(tmp_path), "--seeds", "90"]) == 1
    assert f"`jaxrl-tab resume {tmp_path} --seeds 90` goes on" in capsys.readouterr().err


def test_without_a_folder_ctrl_c_leaves_nothing(stopped, tmp_path, capsys):
    assert main(["sweep", "windy-gridworld", "q-learning", *TINY]) == 130
    assert capsys.readouterr() == ("", "jaxrl-tab: interrupted\n")


def test_when_drawing_fails_the_data_are_kept_and_the_traceback_is_shown(monkeypatch, tmp_path, capsys):
    """The table is shown before. Broken once: shown when `run` has returned -> fails."""

    def fail(*_):
        raise RuntimeError("no ink")

    monkeypatch.setattr(plot, "save_all", fail)
    out = tmp_path / "windy"
    with pytest.raises(RuntimeError, match="no ink") as error:
        main(["sweep", "windy-gridworld", "sarsa", *TINY, "--out", str(out)])
    assert error.value.__notes__ == [f"what is finished is kept, `jaxrl-tab resume {out}` goes on"]
    assert {file.name for file in out.iterdir()} == {"results.nc", "summary.csv"} | KEPT
    table = capsys.readouterr().out
    assert "│ sarsa" in table
    assert "results.nc" not in table


@pytest.mark.slow
def test_where_nobody_reads_the_table_the_files_are_written(tmp_path):
    """As with `| head -0`. Broken once: `show` lets the error through -> fails."""
    command = [sys.executable, "-m", "jaxrl_tab", "sweep", "windy-gridworld", "sarsa", *TINY, "--out", "run"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path)
    assert process.stdout and process.stderr
    process.stdout.close()
    assert (process.stderr.read(), process.wait()) == (b"", 1)
    process.stderr.close()
    assert {"results.nc", "summary.csv", "overview.png", "report.html"} <= {
        file.name for file in (tmp_path / "run").iterdir()
    }


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("options", "endings"),
    [
        ("--formats svg pdf", {".svg", ".pdf"}),
        ("--no-pictures", set()),
        ("--formats svg --no-pictures", set()),
    ],
)
def test_pictures_are_of_the_formats_that_are_wanted(options, endings, tmp_path, monkeypatch):
    """What is resumed has the same, or those that are wanted then.

    Broken once, each: the formats are not handed on; what is resumed is PNG -> fails.
    """
    monkeypatch.setattr(plot, "save", lambda figure, file: file.touch())
    out = tmp_path / "run"
    call("sweep windy-gridworld sarsa", *TINY, "--quiet", "--out", str(out), *options.split())
    pictures = {file.suffix for file in out.iterdir()} & {".png", ".svg", ".pdf"}
    assert pictures == endings
    assert {"results.nc", "summary.csv", "report.html"} <= {file.name for file in out.iterdir()}
    for more, now in (([], endings), (["--formats", "png"], endings | {".png"})):
        (out / "results.nc").unlink()
        call("resume", str(out), "--quiet", *more)
        assert {file.suffix for file in out.iterdir()} & {".png", ".svg", ".pdf"} == now


def test_a_sweep_over_several_environments_takes_the_options_of_each(capsys):
    """Broken once: the second name stays a method -> refused."""
    command = "sweep windy-gridworld cliff-walking sarsa q-learning --moves king --alpha 0.5 --dry-run --json"
    assert main(command.split()) == 0
    parts = json.loads(capsys.readouterr().out)["parts"]
    assert [*parts] == [
        f"{env}/{m}" for env in ("windy-gridworld", "cliff-walking") for m in ("sarsa", "q-learning")
    ]
    assert {part["runs"] for part in parts.values()} == {100}


# --- refusals ----------------------------------------------------------------------------------------

REFUSALS = {
    "resume": "name the folder of a sweep",
    "resume nowhere": "there is no folder nowhere",
    "resume nowhere --memory x": "memory must be a number with a unit",
    "explain": "name the folder of a sweep",
    "explain nowhere": "there is no folder nowhere",
    "explain nowhere --jsn": "did you mean '--json'?",
    "compare": "name two or more folders of sweeps",
    "compare runs": "name two or more folders of sweeps",
    "compare nowhere nothing": "there is no folder nowhere",
    "compare a b --fail-if-wors": "did you mean '--fail-if-worse'?",
    "compare a b --html nowhere/x.html": "there is no folder nowhere for x.html",
    "sweep windy-gridworld cliff-walking": "name a method: sarsa",
    "sweep windy-gridworld cliff-walking sarsa --states 4": "none of windy-gridworld, cliff-walking has --states",
    "sweep windy-gridworld clif-walking sarsa": "'clif-walking' is not a method",
    "swep": "did you mean 'sweep'?",
    "xyzzy": "explain, seeds, compare, read, moments, figure, check",
    "list --jsn": "did you mean '--json'?",
    "list sara": "'sara' is not an environment, a method or a figure; did you mean 'sarsa'?",
    "list mine.py:Mine": "there is no file",
    "list --out x": "--out goes with --backups",
    "list --backups two-doors": "two-doors is no method, and only methods have a backup diagram",
    "schedule": "name a schedule: one of glie, sample-average, power[:POWER[:SCALE]]:CLOCK,",
    "schedule gile": "'gile' is neither a number nor a schedule; did you mean 'glie'?",
    "schedule hamonic:1:visit": "there is no schedule 'hamonic:1:visit'; did you mean 'harmonic'?",
    "schedule glie power:0.5": "not of the form power[:POWER[:SCALE]]:CLOCK",
    "schedule -0.1": "a step size or an exploration rate is a number of at least 0, not -0.1",
    "schedule nan": "a step size or an exploration rate is a number of at least 0, not nan",
    "schedule 1 2 3 4 5 6 7 8 9": "at most 8 schedules stand side by side, not 9",
    "schedule glie --jsn": "did you mean '--json'?",
    "bridge --alpha 0.1": "name an environment: windy-gridworld",
    "bridge --steps 10": "name an environment: windy-gridworld",
    "bridge windy-gridworld": "name a method: sarsa",
    "bridge windy-gridworld sara": "did you mean 'sarsa'?",
    "bridge windy-gridworld sarsa --alpha 0": "alpha must be greater than 0, not 0.0",
    "bridge windy-gridworld sarsa --steps 0": "bridge: steps must be a whole number of at least 1, not 0",
    "bridge windy-gridworld n-step-sarsa": "NStepSarsa is on no row of the table, whose methods are td, off-policy-td,",
    "solve": "name an environment: windy-gridworld",
    "solve windy-gridwrld": "did you mean 'windy-gridworld'?",
    "solve windy-gridworld more": "unexpected argument 'more'",
    "solve windy-gridworld --gamma 1.5": "solve: gamma must be between 0 and 1, not 1.5",
    "solve windy-gridworld --gamma x": "--gamma takes a number, not 'x'",
    "solve windy-gridworld --epsilon -0.1": "solve: epsilon must be between 0 and 1, not -0.1",
    "solve windy-gridworld --moves knight": "did you mean 'king'?",
    "solve windy-gridworld --wind 0 1": "one strength for each of the 10 columns",
    "solve windy-gridworld --wind 0.5": "--wind takes a whole number, not '0.5'",
    "solve windy-gridworld --shape 7": "shape must be (rows, columns)",
    "solve windy-gridworld --moves": "--moves: expected one argument",
    "solve windy-gridworld --moves king four": "unexpected argument 'four'",
    "solve cliff-walking --moves king": "cliff-walking has no --moves, which belongs to windy-gridworld, maze,",
    "solve cliff-walking --moves four": "; cliff-walking has --shape, --is-slippery, --max-steps",
    "solve random-walk --states 4": "states must be odd",
    "moments": "name an environment: windy-gridworld",
    "moments random-walk": "name a method with exact learning curves: td, n-step-td, td-lambda, true-online-td-lambda,",
    "moments random-walk sarsa": "'sarsa' is not a method with exact learning curves; choose one of td,",
    "moments random-walk td-lamda": "did you mean 'td-lambda'?",
    "moments random-walk td --n 4": "td has no --n, which belongs to n-step-td",
    "moments random-walk td --episodes 0": "moments: episodes must be a whole number of at least 1, not 0",
    "moments random-walk td --v0 0 1": "td: v0 has one value here; only alpha, lam and n may have several",
    "moments random-walk td-lambda": "the traces of on-line TD(lambda) remember the whole episode",
    "moments random-walk monte-carlo-prediction": "alpha must be a number, for a schedule is not the same",
    "moments k-armed-testbed td --alpha 0.1": "each run has a problem of its own there",
    "figure": "name a figure: "
    + ", ".join([*FIGURES][:8])
    + f", ... (`jaxrl-tab list` shows all {len(FIGURES)})",
    "figure windy": "did you mean 'windy-gridworld'?",
    "check": "name a file to check",
    "check nowhere.py": "there is no file nowhere.py",
    "check agent.txt": "agent.txt is no file of Python",
    "check agent.py --hand-out x": "--hand-out writes the exercises, and checks none",
    "check agent.py --exercise": "--exercise: expected one argument",
    "sweep": "name an environment",
    "sweep sarsa": "'sarsa' is not an environment",
    "sweep windy-gridworld": "name a method: sarsa",
    "sweep windy-gridworld sara": "did you mean 'sarsa'?",
    "sweep windy-gridworld sarsa sarsa": "sarsa is named more than once",
    "sweep windy-gridworld sarsa --alhpa 0.1": "there is no option --alhpa; did you mean '--alpha'?",
    "sweep windy-gridworld sarsa --horizon 9": "a task that ends after 20 steps is named finite-horizon:20:NAME",
    "sweep windy-gridworld sarsa --methods 2": "there is no option --methods",
    "sweep windy-gridworld sarsa --alpha": "--alpha: expected at least one argument",
    "sweep windy-gridworld sarsa --alpha 0": "alpha must be greater than 0, not 0.0",
    "sweep windy-gridworld sarsa --alpha 0.1 -1": "alpha must be greater than 0, not -1.0",
    "sweep windy-gridworld sarsa --alpha nan": "alpha must be greater than 0, not nan",
    "sweep windy-gridworld sarsa --alpha small": "--alpha: 'small' is neither a number nor a schedule",
    "sweep windy-gridworld sarsa --alpha 0.1 0.10": "alpha holds 0.1 more than once",
    "sweep windy-gridworld sarsa --alpha glie glie": "alpha holds glie more than once",
    "sweep windy-gridworld sarsa --epsilon 1.1": "epsilon must be between 0 and 1, not 1.1",
    "sweep windy-gridworld sarsa --gamma glie": "--gamma takes a number, not 'glie'",
    "sweep windy-gridworld sarsa --seeds 0": "sweep: seeds must be a whole number of at least 1, not 0",
    "sweep windy-gridworld sarsa --seeds 2.5": "--seeds takes a whole number, not '2.5'",
    "sweep windy-gridworld sarsa --seeds 2147483648": "of at least 1 and below 2**31, not 2147483648",
    "sweep windy-gridworld sarsa --address x": "local has no --address, which belongs to ray, distributed",
    "sweep windy-gridworld sarsa --executor slurm": "--executor slurm needs --out",
    "sweep windy-gridworld sarsa --executor slurm --out x --slurm y": "--slurm takes KEY=VALUE, not 'y'",
    "sweep windy-gridworld sarsa --executor x": "choose one of local, ray, slurm, distributed",
    "resume nowhere --executor ray --num-cpus 0": "num_cpus must be a whole number of at least 1, not 0",
    "list --json=1": "--json: ignored explicit argument '1'",
    "sweep windy-gridworld sarsa --seeds": "--seeds: expected one argument",
    "sweep windy-gridworld sarsa --formats png gif": "formats 'gif' is unknown; choose one of png, svg, pdf",
    "sweep windy-gridworld sarsa --steps 0": "steps must be a whole number of at least 1, not 0",
    "sweep windy-gridworld sarsa --episodes -1": "episodes must be a whole number of at least 1, not -1",
    "sweep windy-gridworld sarsa --log-every 0": "log_every must be a whole number of at least 1, not 0",
    "sweep windy-gridworld sarsa --seed -1": "seed must be a whole number of at least 0, not -1",
    "sweep windy-gridworld sarsa --memory 4": "memory must be a number with a unit (B, kB, MB, GB, TB",
    "sweep windy-gridworld sarsa --steps 10 --episodes 10": "give --steps or --episodes, not both",
    "sweep windy-gridworld sarsa --behaviour sofmax:1": "did you mean 'softmax'?",
    "sweep windy-gridworld sarsa --behaviour ucb:2 --epsilon 0.2": "give epsilon or behaviour, not both",
    "sweep windy-gridworld sarsa --behaviour ucb:2 ucb": "behaviour holds ucb:2 more than once",
    "sweep windy-gridworld sarsa --target greedy": "sarsa has no --target, which belongs to expected-sarsa,",
    "sweep windy-gridworld sarsa-lambda --lam 0.5 2": "lam must be between 0 and 1, not 2.0",
    "sweep windy-gridworld sarsa-lambda --trace x": "choose one of accumulating, replacing, clearing, dutch",
    "sweep windy-gridworld sarsa-lambda --offline --trace dutch": "accumulating traces only, not dutch",
    "sweep windy-gridworld n-step-sarsa --n 0": "n must be a whole number of at least 1, not 0",
    "sweep windy-gridworld n-step-sarsa --n 1.5": "--n takes a whole number, not '1.5'",
    "sweep blackjack monte-carlo --batch 0": "batch must be a whole number of at least 1, not 0",
    "sweep blackjack off-policy-monte-carlo --weighting x": "choose one of weighted, ordinary, per-decision",
    "sweep random-walk td --epsilon 0.1": "td has no --epsilon, which belongs to the methods of control that learn",
    "sweep random-walk td-lambda --lam -1": "td-lambda: lam must be between 0 and 1, not -1.0",
    "sweep random-walk td --pi 0.5": "there is no option --pi",
    "sweep random-walk td sarsa": "sweep methods of prediction and of control apart",
}


@pytest.fixture
def idle(monkeypatch):
    """Makes everything fail that would compile or compute."""

    def fail(*_, **__):
        pytest.fail("something was computed before the refusal")

    monkeypatch.setattr(figure, "sweep", fail)
    monkeypatch.setattr(jax, "jit", fail)
    for name in ("exact_model", "policy_iteration", "epsilon_soft"):
        monkeypatch.setattr(planning, name, fail)


@pytest.mark.parametrize("command", REFUSALS)
def test_wrong_input_is_refused_in_one_line_before_anything_is_computed(command, idle, capsys):
    assert REFUSALS[command] in refused(capsys, command)


@pytest.mark.parametrize(
    "command",
    [
        "solve windy-gridworld",
        "sweep windy-gridworld sarsa",
        "figure windy-gridworld",
        "list --backups",
        "bridge",
        "schedule 0.1",
    ],
)
def test_a_folder_that_cannot_be_made_is_refused(command, idle, tmp_path, capsys):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for out in ("folder", "file", "link", ".", "new/.."):
        assert "exists already; name a new folder" in refused(capsys, command, "--out", str(tmp_path / out))
    for out in ("file/x", "x" * 300):
        assert "cannot be made" in refused(capsys, command, "--out", str(tmp_path / out))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder", "link"]


def test_values_that_have_no_finite_answer_are_refused_and_leave_no_folder(monkeypatch, tmp_path, capsys):
    def endless(*_):
        raise InputError("never ends")

    monkeypatch.setattr(planning, "policy_iteration", endless)
    assert "never ends" in refused(capsys, "solve windy-gridworld --out", str(tmp_path / "x"))
    assert list(tmp_path.iterdir()) == []


# --- options come from the registries ----------------------------------------------------------------


@pytree
class Eager(rl.Sarsa):
    """Sarsa that is eager.

    Attributes:
        recall: how long it remembers,
            in steps.
        traces: "replacing" or "accumulating".
        cut: whether it forgets.
        patience: a limit.
    """

    recall: float = 0.9
    traces: str = static("replacing")
    cut: bool = static(True)
    patience: int = static(10)


def test_a_new_method_brings_its_options(monkeypatch, asked, capsys):
    monkeypatch.setitem(ALGORITHMS, "eager", Eager)
    call("sweep windy-gridworld eager --recall 0 0.5 --traces accumulating --no-cut --patience 3")
    given = {"recall": [0.0, 0.5], "traces": "accumulating", "cut": False, "patience": 3}
    assert ({"label": "eager"} | given).items() <= asked[0]["method"][0].items()
    capsys.readouterr()

    error = refused(capsys, "sweep windy-gridworld sarsa --recall 0.5")
    assert (
        "sarsa has no --recall, which belongs to eager; sarsa has --alpha, --epsilon, --gamma, --q0" in error
    )
    error = refused(capsys, "sweep windy-gridworld eager --patience x")
    assert "--patience takes a whole number, not 'x'" in error

    with pytest.raises(SystemExit) as stop:
        main(["sweep", "--help"])
    assert not stop.value.code
    text = " ".join(capsys.readouterr().out.split())
    assert "--recall X [X ...] how long it remembers, in steps. (of eager; default: 0.9)" in text
    assert "--no-cut whether it forgets. (of eager)" in text


@pytest.mark.parametrize("command", [Sweep, Solve])
def test_no_two_options_have_the_same_name(command):
    """Parameters of the registries beside each other and beside the options of the command itself."""
    groups = [ENVS, METHODS] if command is Sweep else [ENVS]
    own = {f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(command)}
    for registry in groups:
        names = {flag_of(p) for cls in registry.values() for p in describe.parameters(cls)}
        assert not names & own
        own |= names


def test_every_parameter_of_the_registries_is_explained():
    for cls in [*ENVS.values(), *METHODS.values()]:
        assert (
            describe.summary(cls).endswith(".")
            or "=" in describe.summary(cls)
            or ":" in describe.summary(cls)
        )
        for parameter in describe.parameters(cls):
            assert parameter.help, f"{cls.__name__}.{parameter.name} is not in the section Attributes"


def test_list_names_everything(capsys):
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    assert main(["list", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    for kind, registry in (("environments", ENVS), ("methods", ALGORITHMS), ("prediction", PREDICTION)):
        assert list(found[kind]) == list(registry)
        for name, facts in found[kind].items():
            assert f"{name}  {facts['summary']}" in text
    assert found["methods"]["sarsa"]["parameters"]["alpha"] == {
        "default": 0.1,
        "help": "Step size. A number greater than 0, or a schedule.",
    }
    assert found["environments"]["windy-gridworld"]["parameters"]["wind"]["default"][6] == 2
    assert set(found["figures"]) == set(FIGURES)
    assert "methods of prediction, of the policy in which all actions are equally likely" in text
    # What all have stands there once, and again where it has another default.
    others = [cls for cls in ALGORITHMS.values() if getattr(cls(), "epsilon", 0.1) != 0.1]
    assert text.count("--epsilon ") == 1 + len(others)
    assert text.count("--alpha ") == 3 + sum(
        not isinstance(getattr(cls(), "alpha", 0.1), float) for cls in METHODS.values()
    )  # for control, of values and of policies, for prediction, and where it is by default a schedule
    (r_max,) = re.findall(r"\n  r-max .*?\n\n", text, re.DOTALL)
    assert "without --alpha\n" in r_max and "--alpha " not in r_max
    assert "A policy is one of greedy, epsilon-greedy[:EPSILON], softmax[:TEMPERATURE], ucb[:C]." in text
    line, *_ = [line for line in text.splitlines() if "--wind " in line]
    assert "0 0 0 1 1 1 2 2 1 0  Strength of each column" in line


# --- solve -------------------------------------------------------------------------------------------


def cells(text, row):
    """The cells of a row of the printed grid: (values, actions), each a list of texts."""
    lines = text.splitlines()
    (first,) = [
        i for i, line in enumerate(lines) if line.startswith(f"│ {row} ") or line.startswith(f"│{row}")
    ]
    return [[cell.strip() for cell in lines[i].split("│")[2:-1]] for i in (first, first + 1)]


def test_where_a_run_has_diverged_no_action_is_the_best():
    """`watch` shows such a table. Broken once: the maximum of no number -> fails."""
    assert best_actions(np.full(4, np.nan)).size == 0
    assert best_actions(np.array([0.0, -1.0, 0.0])).tolist() == [0, 2]


def test_solve_draws_values_and_best_actions_where_they_are(capsys):
    assert main(["solve", "cliff-walking", "--epsilon", "0.1"]) == 0
    optimal, soft = capsys.readouterr().out.split("cliff-walking, ")[1:]
    assert "optimal: value from the start -13" in optimal
    assert "best epsilon-soft, epsilon 0.1: value from the start -20.7077" in soft
    values, actions = cells(optimal, 2)
    assert values == [str(-12 + i) for i in range(12)]
    assert actions == ["→"] * 11 + ["↓"]
    values, actions = cells(optimal, 3)
    assert values == ["-13", *[""] * 10, "G"]  # nobody is ever on the cliff
    assert actions == ["S ↑", *[""] * 11]
    assert cells(soft, 2)[1] == [*["↑"] * 10, "→", "↓"]


def test_solve_shows_the_wind_below_the_grid(capsys):
    assert main(["solve", "windy-gridworld"]) == 0
    text = capsys.readouterr().out
    assert "value from the start -15" in text
    (wind,) = [line for line in text.splitlines() if "wind" in line and "│" in line]
    assert [cell.strip() for cell in wind.split("│")[2:-1]] == list("0001112210")


def test_solve_lists_the_states_of_what_is_no_grid(capsys, tmp_path):
    out = tmp_path / "walk"
    assert main(["solve", "random-walk", "--states", "3", "--left-reward", "0", "--out", str(out)]) == 0
    lines = [line.split("│") for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert [float(line[2]) for line in lines] == [0.25, 0.5, 0.75]  # terminal states have no value to show
    assert len(lines[0]) == 4  # and where there is one action none is the best
    assert (out / "values.png").read_bytes().startswith(b"\x89PNG")


def tables(text):
    """The tables that were printed, by title: rows of (name, values, actions)."""
    found, rows = {}, []
    for line in text.splitlines():
        if "→" in line and "┃" not in line:
            rows = found[line.strip()] = []
        elif line.startswith("│"):
            name, *cells = [cell.strip() for cell in line.split("│")[1:-1]]
            if name:
                rows.append((name, [float(cell) for cell in cells]))
            else:
                rows[-1] += (cells,)
    return found


def test_solve_shows_card_games_as_tables_of_the_players_hand_by_the_dealers_card(capsys, tmp_path):
    """Where to stick: the numbers of GROUND_TRUTH.md. Broken once: rows the other way round -> fails."""
    assert main(["solve", "blackjack", "--rules", "natural", "--out", str(tmp_path / "cards")]) == 0
    found = tables(capsys.readouterr().out)
    usable, hard, natural = found.values()
    assert list(found) == [
        f"{title}: player ↓, dealer shows →" for title in ("usable ace", "no usable ace", "natural")
    ]
    assert [name for name, _, _ in usable] == [str(n) for n in range(21, 11, -1)]
    sticks = [
        [min(int(name) for name, _, actions in table if actions[card] == "stick") for card in range(10)]
        for table in (usable, hard)
    ]
    assert sticks[0] == [19, 18, 18, 18, 18, 18, 18, 18, 19, 19]
    assert sticks[1] == [17, 13, 13, 12, 12, 12, 17, 17, 17, 17]
    ((_, wins, actions),) = natural
    assert min(wins[1:]) > 1.3 and set(actions) == {"stick"}
    assert (tmp_path / "cards" / "values.png").read_bytes().startswith(b"\x89PNG")

    assert main(["solve", "easy21"]) == 0
    ((title, rows),) = tables(capsys.readouterr().out).items()
    assert title == "player ↓, dealer shows →"
    assert len(rows) == 21 and all(len(values) == 10 for _, values, _ in rows)


def test_solve_says_where_each_run_has_a_problem_of_its_own(capsys):
    assert main(["solve", "k-armed-testbed"]) == 0
    text = capsys.readouterr().out
    assert "Each run of a sweep draws a problem of its own; the mean over them is 1.53875." in text


def test_solve_as_json(capsys, tmp_path):
    out = tmp_path / "solved"
    argv = ["solve", "windy-gridworld", "--moves", "king", "--epsilon", "0.1", "--gamma", "0.9", "--json"]
    assert main([*argv, "--out", str(out)]) == 0
    found = json.loads(capsys.readouterr().out)
    env = rl.make("windy-gridworld", moves="king")
    v, q = planning.value_iteration(env, 0.9)
    np.testing.assert_allclose(found["optimal"]["v"], v, atol=1e-8)
    np.testing.assert_allclose(found["optimal"]["q"], q, atol=1e-8)
    assert found["optimal"]["start_value"] == pytest.approx(v[30])
    soft = found["epsilon_soft"]
    assert np.min(soft["policy"]) == pytest.approx(0.1 / 8)
    np.testing.assert_allclose(planning.evaluate(env, soft["policy"], 0.9), soft["v"], atol=1e-8)
    assert [file.name for file in out.iterdir()] == ["values.png"]


# --- the program -------------------------------------------------------------------------------------


def test_help_and_version(capsys):
    for argv in ([], ["--help"]):
        assert main(argv) == 0
        assert "jaxrl-tab sweep windy-gridworld sarsa q-learning" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxrl-tab {rl.__version__}\n"
    for command in ("list", "solve", "watch", "sweep", "resume", "figure"):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert not stop.value.code
        assert f"Examples:\n  jaxrl-tab {command}" in capsys.readouterr().out


def test_as_a_program_it_ends_with_its_exit_code_and_no_traceback():
    wrong = [sys.executable, "-m", "jaxrl_tab", "sweep", "windy-gridworld", "sarsa", "--alpha", "0"]
    done = subprocess.run(wrong, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "jaxrl-tab: sarsa: alpha must be greater than 0, not 0.0\n"


@pytest.mark.parametrize("command", ["list", "sweep -h"])
def test_a_reader_that_goes_away_ends_it_quietly(command):
    """As `| head` does; here the reader is gone before the first line. Broken once: not caught -> fails."""
    program = [sys.executable, "-m", "jaxrl_tab", *command.split()]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout and running.stderr
        running.stdout.close()
        assert running.stderr.read() == ""
    assert running.returncode == 1


def test_a_command_that_shows_no_table_does_not_import_what_tables_need():
    """As `--dry-run`. Broken once: the sentence on early learning imported with the rest -> fails."""
    code = "import sys, jaxrl_tab.cli.sweep; print({'xarray', 'pandas', 'scipy'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "set()", done.stderr


def test_listing_imports_nothing_heavy():
    code = (
        "import sys; from jaxrl_tab.cli import main; main(['list', '--json']);"
        "print(*{'matplotlib', 'xarray', 'pandas', 'scipy', 'gymnax'} & set(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == ""


# --- what it writes to -------------------------------------------------------------------------------


def in_a_shell(words, tmp_path, **environment):
    """The exit code of a command in a shell, and what it wrote to the files `out` and `err` there."""
    command = f"{shlex.quote(sys.executable)} -m jaxrl_tab {words}"
    unset = {"JAXRL_TAB_TRACEBACK": "", "PYTHONUNBUFFERED": ""}
    code = subprocess.run(command, shell=True, cwd=tmp_path, env=os.environ | unset | environment).returncode
    texts = [(tmp_path / name).read_text() if (tmp_path / name).exists() else "" for name in ("out", "err")]
    return code, *texts


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            "list --json > /dev/full 2> err",
            1,
            "jaxrl-tab: reading or writing failed: No space left on device\n",
        ),
        (
            "--version > /dev/full 2> err",  # which is found out when it is flushed
            1,
            "jaxrl-tab: reading or writing failed: No space left on device\n",
        ),
        ("--version >&- 2> err", 0, ""),
        ("swep > out 2>&-", 2, ""),
        ("swep > out 2> /dev/full", 2, ""),
    ],
)
def test_what_cannot_be_written_to_ends_it_without_a_traceback(tmp_path, words, code, said):
    """Broken once: as Python leaves it, which raises, and exits with 1 or 120 -> fails."""
    assert in_a_shell(words, tmp_path) == (code, "", said)


def test_a_terminal_of_other_characters_gets_lookalikes(tmp_path):
    code, out, err = in_a_shell("solve windy-gridworld > out 2> err", tmp_path, PYTHONIOENCODING="ascii")
    assert (code, err) == (0, "")
    assert out.isascii() and "> " in out and "?" not in out


def test_a_defect_is_said_in_one_line_with_the_way_to_its_traceback(monkeypatch, capsys):
    def fail(*_):
        raise ZeroDivisionError("by nothing\nat all")

    monkeypatch.setattr(sweep_module, "_conduct", fail)
    monkeypatch.delenv("JAXRL_TAB_TRACEBACK")
    assert call("sweep windy-gridworld sarsa") == 1
    said = capsys.readouterr().err
    assert "this is a defect of jaxrl-tab: ZeroDivisionError: by nothing at all; please report it" in said
    assert said.count("\n") == 1
    monkeypatch.setattr(versions, "JAX", (99, 0))  # where it may well be none
    assert call("sweep windy-gridworld sarsa") == 1
    assert re.search(
        r"nothing at all; JAX [\d.]+ is newer than [\d.]+, the newest known here; please",
        capsys.readouterr().err,
    )


@pytest.mark.parametrize("words", ["--alpha", "--out x --seeds", "--memory", "--log-every"])
def test_none_is_not_the_same_as_not_given(capsys, words):
    assert "'None'" in refused(capsys, f"sweep windy-gridworld sarsa {words} None")


def test_help_in_a_narrow_terminal_ends(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "1")
    with pytest.raises(SystemExit):
        main(["list", "--help"])
    assert "Print JSON" in " ".join(capsys.readouterr().out.split())
    assert os.environ["COLUMNS"] == "1"
