"""Tasks of their own length and gamma, scores that are kept, and new methods ranked among them."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import quick
import xarray as xr
from refusals import refused

import jaxrl_tab as rl
from benchmarks import suite
from jaxrl_tab import plot, report, stats
from jaxrl_tab.cli import main
from jaxrl_tab.engine import provenance
from jaxrl_tab.experiment import compare, files, scores, tasks
from jaxrl_tab.stats.columns import Methods
from jaxrl_tab.stats.ranking import ranking

TOML = """
seeds = 3
steps = 200
log_every = 20

[select]
fresh_seeds = 8

[[environment]]
name = "two-doors"

[[environment]]
name = "chain"
label = "a chain"
max_steps = 100
steps = 400
gamma = 0.9

[[method]]
name = "{}"
alpha = [0.1, 0.5]
"""
METHOD = {"name": "sarsa", "alpha": 0.1}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """What is kept of Sarsa in two tasks, and the results of Q-learning in them."""
    folder = tmp_path_factory.mktemp("suite")
    (folder / "tasks.toml").write_text(TOML.format("sarsa"))
    kept = suite.Files.beside(folder / "tasks.toml")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(plot, "save_all", quick.picture)
        patched.setattr(report, "write_methods", quick.page)
        rl.run(rl.Experiment.load(kept.toml), folder / "first", progress=False)
        suite.keep(folder / "first", kept, lambda _: None)
    (folder / "mine.toml").write_text(TOML.format("q-learning"))
    return kept, rl.run(rl.Experiment.load(folder / "mine.toml"), progress=False)


# --- tasks of their own length and gamma -------------------------------------------------------------
def test_a_task_has_a_length_and_a_gamma_of_its_own():
    tables = [{"name": "chain", "gamma": 0.9, "steps": 300, "log_every": 30}, "two-doors"]
    experiment = rl.Experiment(tables, METHOD, seeds=2, steps=1000)
    own, other = experiment.parts().values()
    assert (own.budget.num_steps, own.budget.row, own.configs[0].gamma) == (300, 30, 0.9)
    assert (other.budget.num_steps, other.budget.row, other.configs[0].gamma) == (1000, 100, 1.0)
    again = rl.Experiment(**experiment.data())
    assert again.fingerprint == experiment.fingerprint and "300 to 1000 steps" in experiment.in_words
    plain = rl.Experiment("chain", METHOD, seeds=2, steps=1000)
    assert not {"steps", "gamma"} & plain.environment[0].keys()  # so that fingerprints stay what they were


@pytest.mark.parametrize(
    ("own", "method", "message"),
    [
        (
            {"episodes": 5},
            METHOD,
            "chain: the length of these runs is a number of steps: give steps, not episodes",
        ),
        ({"steps": 0}, METHOD, "steps"),
        ({"gamma": 1.5}, METHOD, "gamma"),
        ({"gama": 0.5}, METHOD, "chain has no parameter 'gama'"),
        (
            {"gamma": 0.9},
            METHOD | {"gamma": [0.9, 1]},
            "chain has a gamma of its own, and sarsa is tried with several",
        ),
    ],
)
def test_what_cannot_be_is_refused(own, method, message):
    refused(lambda: rl.Experiment({"name": "chain", **own}, method, seeds=2, steps=10), message)


def test_a_class_of_ones_own_keeps_its_parameter():
    """Where a class has a parameter `gamma` itself, that is what is meant."""
    assert tasks.split({"label": "x", "gamma": 0.5, "states": 3}, rl.envs.Chain)[0] == {"gamma": 0.5}
    assert tasks.split({"label": "x", "gamma": 0.5}, rl.Sarsa)[0] == {}


# --- new methods among others ------------------------------------------------------------------------
def runs(values, gamma=1.0, seeds=None, **attrs):
    """A dataset of one setting, whose runs have these scores."""
    x = np.asarray(values, float)[:, None]
    log = {"steps": np.ones(x.shape, int), "episodes": np.ones(x.shape, int), "returns": x}
    coords = {"seed": np.arange(len(x)) if seeds is None else seeds, "row": [0]}
    about = {
        "environment": "two-doors",
        "environment_parameters": "{}",
        "fixed": json.dumps({"gamma": gamma}),
    }
    ds = xr.Dataset({name: (("seed", "row"), v) for name, v in log.items()}, coords)
    return ds.assign_attrs(
        about | {"num_steps": 1, "log_every": 1, "root_seed": 0, "optimal_value": 3.0} | attrs
    )


def test_a_new_method_among_two_by_hand():
    """Of two doors any action earns 2.5 and the best 3: 2.75 is 0.5. All differences are the same sign in ten seeds."""
    wobble, envs = np.linspace(-0.01, 0.01, 10), {"a": rl.make("two-doors"), "b": rl.make("two-doors")}
    first = {label: {"low": runs(2.6 + wobble), "high": runs(2.9 + wobble[::-1])} for label in envs}
    second = {"a": {"new": runs(2.75 + wobble)}, "b": {"new": runs(2.95 + wobble)}}
    found = ranking(first, second, envs, on_fresh=True)
    a, b = found.places
    assert (found.new, found.seeds) == (["new"], 10)
    assert (a.rank, a.better, a.worse, a.first) == (2, 1, 1, ("high", pytest.approx(0.8)))
    assert (b.rank, b.better, b.worse) == (1, 2, 0)
    assert a.score == pytest.approx(0.5) and a.low < 0.5 < a.high
    assert found.tasks.mean_rank.estimate.sel({"method": "new"}) == 1.5
    later = {label: {"new": runs(2.9 + wobble, seeds=np.arange(4, 14))} for label in envs}
    assert ranking(first, later, envs, True).seeds == 6


@pytest.mark.parametrize(
    ("attrs", "message"),
    [
        ({"seeds": np.arange(20, 30)}, "no seeds in common"),
        ({"gamma": 0.5}, "gamma is 1.0 and 0.5"),
        ({"num_steps": 2}, "the runs have other steps: 1 and 2"),
        ({"root_seed": 1}, "the runs have other root seeds: 0 and 1"),
        ({"environment": "chain"}, "it is not the same task in both"),
    ],
)
def test_what_cannot_be_ranked_says_why(attrs, message):
    envs = {"a": rl.make("two-doors"), "b": rl.make("two-doors")}
    first, second = (
        {label: {name: runs(range(10), **more)} for label in envs} for name, more in (("x", {}), ("y", attrs))
    )
    refused(lambda: ranking(first, second, envs, True), message)


def test_tasks_without_an_end_count_where_what_is_cut_off_hardly_does():
    x = {"m": runs(np.arange(10.0), gamma=0.9, optimal_value=30.0)}
    cut = {n: Methods(x, rl.make("chain", max_steps=n)) for n in (10, 100, 200)}
    tasks = stats.across_tasks({str(n): own for n, own in cut.items()})
    assert tasks.scores.environment.values.tolist() == ["100", "200"]
    assert "what comes after its 10 steps counts" in tasks.left_out["10"]


# --- what is kept ------------------------------------------------------------------------------------
def test_a_method_is_ranked_among_scores_that_were_kept(made, capsys, tmp_path):
    """The score in the file is that of the runs; the others' are of the same seeds, and nothing is computed again."""
    kept, mine = made
    found = rl.compare(kept.scores, mine)
    ranked = found.others[0].ranked
    assert ranked and ranked.new == ["q-learning"] and ranked.seeds == 8 and ranked.on_fresh
    x = ranked.tasks.scores.sel({"method": "sarsa", "environment": "two-doors"})
    first = scores.load(kept.scores)[0]["two-doors/sarsa"]
    np.testing.assert_allclose(x * 0.5 + 2.5, stats.score(first))
    assert "Q-learning is number" in str(found) and "Q-learning in each environment" in found.page().html
    json.dumps(found.to_dict(), allow_nan=False)


def test_the_command_prints_the_ranking(made, capsys, tmp_path, monkeypatch):
    kept, mine = made
    own = compare.side
    monkeypatch.setattr(compare, "side", lambda x: own(mine if x == "mine" else x))
    assert main(["compare", str(kept.scores), "mine"]) == 0
    printed = capsys.readouterr().out
    assert "over 2 environments" in printed and "beats Q-learning" in printed and "Only" not in printed


def test_scores_are_not_trusted_unchecked(made, tmp_path):
    kept, mine = made
    good = dict(np.load(kept.scores))
    about = json.loads(good["about"].tobytes())

    def with_(**changed):
        np.savez(tmp_path / "bad.npz", **good | changed)
        return refused(lambda: rl.compare(tmp_path / "bad.npz", mine), "bad.npz")

    told = lambda **changed: with_(about=np.frombuffer(json.dumps(about | changed).encode(), np.uint8))
    with_(score=good["score"][:1])
    with_(score=good["score"].astype(object))
    with_(seed=np.zeros_like(good["seed"]))
    told(format="something else")
    told(experiment={"environment": 3})
    told(parts={"two-doors/sarsa": {"environment": 7}})
    (tmp_path / "bad.npz").write_bytes(kept.scores.read_bytes()[:200])
    refused(lambda: rl.compare(tmp_path / "bad.npz", mine), "bad.npz")


def test_without_fresh_seeds_it_says_what_to_do(made):
    kept, _ = made
    datasets = {f"{label}/q-learning": runs(range(2)) for label in ("two-doors", "a chain")}
    line = refused(lambda: rl.compare(kept.scores, files.Outcome(datasets, {}, {})), "no fresh seeds")
    assert "[select]" in line


def test_every_run_comes_out_again_with_the_same_bits(made, tmp_path):
    """All of the drawn ones; and one whose bits are others is found."""
    kept, _ = made
    told = []
    assert suite.check(0.3, 1, kept, told.append) == []
    assert told[-1] == "9 of 9 runs, drawn from 28, have the same bits"
    for path in kept:
        shutil.copy(path, tmp_path / path.name)
    copy = suite.Files.beside(tmp_path / kept.toml.name)
    bits = np.load(copy.bits)["bits"]
    bits[0] ^= 1
    np.savez(copy.bits, bits=bits)
    assert suite.check(1, 0, copy, told.append) == ["two-doors/sarsa, setting 0, seed 0: other bits"]
    copy.toml.write_text(TOML.format("q-learning"))
    assert suite.check(0.3, 0, copy, told.append) == [
        "tasks.toml is not the experiment whose results are kept"
    ]


# --- the public results ------------------------------------------------------------------------------
def test_the_public_results_are_of_the_file_and_on_the_page():
    """Sizes, names, and the numbers of the first table."""
    files, page = suite.SUITE, (Path(__file__).parents[1] / "docs/suite.md").read_text(encoding="utf-8")
    experiment, about = rl.Experiment.load(files.toml), json.loads(files.about.read_text(encoding="utf-8"))
    names = [f"{e['label']}/{m['label']}" for e in experiment.environment for m in experiment.method]
    assert experiment.fingerprint == about["fingerprint"] and len(names) == 400
    fresh, data, _ = scores.load(files.scores)
    assert list(fresh) == names == list(about["parts"]) and data == experiment.data()
    assert (
        sum(suite.Sizes(*x).runs for x in about["parts"].values())
        == len(np.load(files.bits)["bits"])
        == 932_000
    )
    methods = about["over_environments"]["methods"]
    shown = {x for line in page.splitlines() if line.startswith("| ") for x in line.split(" | ")}
    assert len(methods) == 20
    for own in methods.values():
        assert "{:.3f} ({:.3f} to {:.3f})".format(*own["iqm"]) in shown
        assert "{:.2f} ({:.2f} to {:.2f})".format(*own["mean_rank"]) in shown


@pytest.mark.slow
def test_some_of_the_public_results_come_out_again():
    """Six of all runs, where versions and the kind of the processor are those of the results."""
    about = json.loads(suite.SUITE.about.read_text(encoding="utf-8"))
    was = {k: x for k, x in about["session"]["surroundings"].items() if "digest" not in k}
    with provenance.using({name: was[name] for name in provenance.settings() if name in was}):
        now = provenance.surroundings()
    if others := provenance.differences(was, {k: now.get(k) for k in was}):
        pytest.skip(f"bits may be others: {'; '.join(others)}")
    told = []
    assert suite.check(6 / 932_000, 3, suite.SUITE, told.append) == []
    assert told[-1].startswith("6 of 6 runs")
