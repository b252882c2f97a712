"""A search: runs that go on give the bits of longer ones, rungs choose as a plain loop does, and it survives."""

import dataclasses
import json
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest
import quick
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import cli, plot, report, stats
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.engine import backend
from jaxrl_tab.engine import part as parts
from jaxrl_tab.engine.axes import Integers, LogUniform, Uniform
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.sweep import prepare
from jaxrl_tab.experiment import samplers, searching
from jaxrl_tab.experiment.samplers import Optuna, Told
from jaxrl_tab.experiment.search import Halving, Search
from jaxrl_tab.stats.early import promise
from jaxrl_tab.stats.settings import Settings

METHODS = {**rl.ALGORITHMS, **rl.PREDICTION}
NETWORKS = ("deep-q-network", "deep-sarsa")  # which take longer
# Of a task that ends, and may be learned in it.
FIT = [
    name
    for name, cls in METHODS.items()
    if name not in NETWORKS and not (of_method(cls).in_the_long_run or of_method(cls).needs_horizon)
]
SARSA = {"name": "sarsa", "alpha": {"log_uniform": [0.05, 1]}, "epsilon": [0.05, 0.1]}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """A picture and a report that take no time."""
    monkeypatch.setattr(plot, "save_all", quick.picture)
    monkeypatch.setattr(report, "write_methods", quick.page)


def wanted(**more):
    """Six settings of Sarsa: for 40 steps, then three for 120, then two for 360."""
    given = {
        "seeds": 4,
        "steps": 360,
        "log_every": 20,
        "draws": 3,
        "one_in": 3,
        "fresh_seeds": 3,
        "grow": "steps",
    }
    return Search("windy-gridworld", SARSA, **(given | more))


# --- runs that go on ------------------------------------------------------------------------------------
def assert_goes_on(method, unit, stages, by="auto"):
    """Runs that go on, stage by stage, are to the last bit those that are made at once."""
    env = rl.make("random-walk" if method in rl.PREDICTION else "windy-gridworld")
    with backend.using(by):
        budget = Budget(**{unit: stages[-1]}, log_every=stages[0], exact=method in rl.PREDICTION)
        part = prepare(env, METHODS[method], {}, budget, num_seeds=3, first_seed=5)
        whole, begun, done, logs = parts.compute(part), None, 0, []
        for until in stages:
            budget = dataclasses.replace(part.budget, **{unit: until - done})
            stage = parts.compute(dataclasses.replace(part, budget=budget, goes_on=True), begun=begun)
            begun, done = stage.begun, until
            logs.append(stage.log)
    log = jax.tree.map(lambda *rows: np.concatenate(rows, axis=1), *logs)
    for one, two in zip(jax.tree.leaves((stage.q, log)), jax.tree.leaves((whole.q, whole.log)), strict=True):
        assert one.dtype == two.dtype and one.tobytes() == two.tobytes()


def test_a_run_that_goes_on_is_the_run_that_is_made_at_once():
    assert_goes_on("n-step-sarsa", "num_steps", (40, 80, 160))


@pytest.mark.slow
@pytest.mark.one_in(41)  # odd: by steps and by episodes in turn
@pytest.mark.parametrize("unit", ["num_steps", "num_episodes"])
@pytest.mark.parametrize("method", FIT)
def test_so_it_is_of_every_method(method, unit):
    assert_goes_on(method, unit, (40, 80, 160) if unit == "num_steps" else (2, 4, 8))


@pytest.mark.weekly
def test_so_it_is_of_a_network():
    """By steps alone: its first episodes are long, and XLA takes its time for them."""
    assert_goes_on("deep-q-network", "num_steps", (40, 80))


@pytest.mark.slow
@pytest.mark.one_in(2)
@pytest.mark.parametrize("unit", ["num_steps", "num_episodes"])
def test_so_it_is_where_xla_compiles(unit):
    assert_goes_on("sarsa-lambda", unit, (40, 80) if unit == "num_steps" else (2, 4), by="xla")


# --- how it is searched ---------------------------------------------------------------------------------
def test_rungs_end_where_rows_do_and_the_last_is_a_whole_run():
    assert wanted().ladder == [(40, 4), (120, 4), (360, 4)]
    assert wanted(steps=400).ladder == [(60, 4), (140, 4), (400, 4)]
    assert wanted(grow="seeds", seeds=20).ladder == [(360, 3), (360, 7), (360, 20)]


@pytest.mark.parametrize(
    ("settings", "sizes"), [(27, [27, 9, 3]), (10, [10, 4, 2]), (4, [4, 2, 2]), (2, [2, 2, 2])]
)
def test_one_in_so_many_goes_on_and_two_at_least(settings, sizes):
    assert Halving().sizes(settings) == sizes


def test_what_a_search_takes_is_known_before():
    """6 x 4 x 40 steps, 2 x 4 x 80 more, and 2 x 4 x 240 more."""
    assert wanted().work("sarsa") == 960 + 640 + 1920


def test_a_budget_says_how_many_settings_are_drawn():
    search = wanted(draws=None, budget=10_000)
    assert search.work("sarsa") <= 10_000 < wanted(draws=search.settings("sarsa") // 2 + 1).work("sarsa")


# --- what is chosen -------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def computed():
    """How often runs of each stage were computed."""
    return []


def searched(search, folder=None, memory=None):
    """What `Searching` gives without a folder."""
    one = searching.Searching(
        search, folder, memory, lambda stage: parts.compute(stage.part, begun=stage.begun)
    )
    one.run()
    return one


@pytest.fixture(scope="module")
def whole():
    """All settings for all steps on the seeds of a search, with the prefix of each rung as a dataset."""
    part = next(iter(wanted().experiment.parts().values()))
    part = dataclasses.replace(part, first_seed=searching.FIRST_SEED)
    return part, parts.compute(part)


def until(whole, length, places):
    """The dataset of some settings, as if their runs had been so long."""
    from jaxrl_tab.engine.sweep import result

    part, computed = whole
    rows, some = length // 20, searching._subset(part, np.array(places))
    log = jax.tree.map(lambda x: x.reshape(6, 4, -1)[places, :, :rows].reshape(-1, rows), computed.log)
    q = computed.q.reshape(6, 4, *computed.q.shape[1:])[places].reshape(-1, *computed.q.shape[1:])
    budget = dataclasses.replace(part.budget, num_steps=length)
    return result(
        dataclasses.replace(some, budget=budget), parts.Computed(q, log, computed.seconds)
    ).to_xarray()


def test_rungs_choose_as_a_plain_loop_over_whole_runs_does(whole):
    found = searched(wanted())
    left, by_hand = list(range(6)), []
    for k, (length, keep) in enumerate([(40, 2), (120, 2), (360, 1)]):
        ds = until(whole, length, left)
        late = ds.isel(row=slice(ds.sizes["row"] // 2, None)).episodes.sum("row")
        merit = (late if k < 2 else stats.score(ds)).mean("seed").values
        best = sorted(sorted(range(len(left)), key=lambda i: (-merit[i], i))[:keep])
        by_hand += [(left[i], k, length, merit[i], i in best) for i in range(len(left))]
        left = [left[i] for i in best]
    tried = [(x.trial, x.rung, x.length, x.score, x.goes_on) for x in found.tried]
    assert tried == by_hand
    (winner,) = found.winners
    assert vars(winner.config) == vars(whole[0].configs[left[0]])


def test_more_seeds_are_the_seeds_that_follow(whole):
    """All runs have full length; the last rung has all seeds."""
    found = searched(wanted(grow="seeds", rungs=2, one_in=2))
    first, last = ([x for x in found.tried if x.rung == k] for k in (0, 1))
    ds = until(whole, 360, list(range(6)))
    score = stats.score(ds)
    assert [x.score for x in first] == score.isel(seed=slice(2)).mean("seed").values.tolist()
    assert [x.score for x in last] == score.mean("seed").values[[x.trial for x in last]].tolist()
    assert len(last) == 3 and sum(x.goes_on for x in last) == 1


def test_programs_of_other_shapes_are_searched_side_by_side():
    """Each n is a program of its own, whose runs remember other things."""
    search = Search(
        "windy-gridworld",
        {"name": "n-step-sarsa", "n": [1, 2], "alpha": [0.2, 0.5]},
        seeds=2,
        steps=80,
        log_every=20,
        rungs=2,
    )
    assert [x.goes_on for x in searched(search).tried].count(True) == 3


def test_promise_counts_the_episodes_of_the_second_half():
    """And where length is not all, it is the mean return there."""
    ds = rl.sweep(rl.make("windy-gridworld"), rl.Sarsa, {}, num_seeds=3, num_steps=800).to_xarray()
    np.testing.assert_array_equal(promise(ds), ds.episodes.isel(row=slice(4, None)).sum("row"))


def test_the_order_of_settings_is_that_of_best():
    """A setting of which a run diverged is behind all of which none did."""
    returns = xr.DataArray([[-3.0, -3], [-1, -1], [-2, -2]], dims=("alpha", "seed"))
    ds = xr.Dataset(
        {"returns": returns, "diverged": xr.zeros_like(returns, bool)}, {"alpha": [1, 2, 3], "seed": [0, 1]}
    )
    assert Settings(ds, lambda ds: ds.returns).order.tolist() == [1, 2, 0]
    ds.diverged[1, 0] = True
    assert Settings(ds, lambda ds: ds.returns).order.tolist() == [2, 0, 1]


# --- the folder -----------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("search") / "run"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(plot, "save_all", quick.picture)
        patched.setattr(report, "write_methods", quick.page)
        rl.search(wanted(), folder, command="searched", formats=(), progress=False)
    return folder


def test_what_was_found_is_run_on_seeds_that_had_no_part_in_the_choice(folder):
    found = rl.Experiment.load(folder / "experiment.toml")
    assert found.seeds == 3 and found.first_seed == 0
    ds = xr.open_datatree(folder / "results.nc")["sarsa"]
    assert ds.seed.values.tolist() == [0, 1, 2] and ds.sizes["seed"] == 3
    assert searching.FIRST_SEED == 2**31  # no seed of an experiment has a number so large
    table = (folder / "search.csv").read_text().splitlines()
    assert len(table) == 1 + 6 + 2 + 2


def test_an_interrupted_search_goes_on_with_the_same_bits(folder, tmp_path, monkeypatch):
    """Killed at each stage."""
    call, calls = searching.Stage.__call__, []

    def stop(stage, number):
        calls.append(number)
        if len(calls) in (2, 4):
            raise KeyboardInterrupt
        return call(stage, number)

    monkeypatch.setattr(searching.Stage, "__call__", stop)
    path = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        rl.search(wanted(), path, command="searched", formats=(), progress=False)
    with pytest.raises(KeyboardInterrupt):
        rl.resume(path, formats=(), progress=False)
    outcome = rl.resume(path, formats=(), progress=False)
    assert calls == [0, 1, 1, 2, 2]
    for file in ("search.csv", "experiment.toml"):
        assert (path / file).read_text() == (folder / file).read_text()
    assert len(outcome.tried) == 10
    assert not rl.resume(path, formats=(), progress=False).search.empty


def test_a_damaged_shard_is_computed_again_and_a_changed_plan_refused(folder, tmp_path):
    path = Path(shutil.copytree(folder, tmp_path / "run"))
    for name in ("experiment.toml", "resolved.json", "manifest.json"):
        (path / name).unlink()
    (path / "search" / "shards" / "000001.npz").write_bytes(b"damaged")
    rl.resume(path, formats=(), progress=False)
    assert (path / "search.csv").read_text() == (folder / "search.csv").read_text()
    for name in ("experiment.toml", "resolved.json"):
        (path / name).unlink()
    plan = path / "search" / "search.json"
    plan.write_text(plan.read_text().replace('"one_in": 3', '"one_in": 2'))
    with pytest.raises(rl.InputError, match=r"search\.json is damaged or missing: put it back"):
        rl.resume(path)


def test_more_is_asked_for_when_the_search_is_over(folder, tmp_path):
    path = Path(shutil.copytree(folder, tmp_path / "run"))
    assert (
        rl.resume(path, seeds=5, formats=(), progress=False).datasets["windy-gridworld/sarsa"].sizes["seed"]
        == 5
    )
    for name in ("experiment.toml", "resolved.json"):
        (path / name).unlink()
    with pytest.raises(rl.InputError, match="is not finished: resume it first, and then ask for more"):
        rl.resume(path, seeds=5)


# --- Optuna ---------------------------------------------------------------------------------------------
RANGES = {"alpha": {"log_uniform": [0.01, 1]}, "n": {"integers": [1, 8]}, "epsilon": ["glie", 0.1]}


def asked(rounds, file=None):
    """What Optuna proposes, round by round, where alpha is best at 0.3."""
    optuna = Optuna("sarsa", RANGES, 0, file)
    for _ in range(rounds):
        settings = optuna.ask(12)
        scores = [-abs(np.log(x["alpha"] / 0.3)) for x in settings]
        optuna.tell([Told({100: s - 1, 300: s}, True) for s in scores[:6]] + [Told({100: None}, False)] * 6)
        yield settings


def test_optuna_proposes_what_it_proposed_before_and_learns(tmp_path):
    in_memory, on_disk = list(asked(3)), list(asked(3, tmp_path / "optuna.log"))
    assert in_memory == on_disk and in_memory[0] != in_memory[1]
    assert in_memory[2] == list(asked(3))[2]
    off = [np.median([abs(np.log(x["alpha"] / 0.3)) for x in settings]) for settings in in_memory]
    assert off[2] < off[0]
    for x in in_memory[2]:
        assert 0.01 <= x["alpha"] <= 1 and 1 <= x["n"] <= 8 and x["epsilon"] in RANGES["epsilon"]
    import optuna

    storage = optuna.storages.JournalStorage(
        optuna.storages.journal.JournalFileBackend(str(tmp_path / "optuna.log"))
    )
    states = [x.state.name for x in optuna.load_study(study_name="sarsa", storage=storage).trials]
    assert states == (["COMPLETE"] * 6 + ["PRUNED"] * 6) * 3


def test_a_search_by_optuna_is_asked_again_where_it_was_interrupted(tmp_path):
    """Whatever is left in its storage."""
    search = wanted(sampler="optuna", rounds=2, draws=8, rungs=2)
    whole = searched(search)
    (tmp_path / searching.STUDIES).write_text("not what it was")
    assert searched(search, tmp_path).tried == whole.tried
    assert {x.round for x in whole.tried} == {0, 1} and sum(x.trial == 7 for x in whole.tried)


def test_without_optuna_a_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(samplers.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(rl.InputError, match="optuna is not installed: pip install"):
        rl.search(wanted(sampler="optuna"))


# --- what is refused, and how it is typed ---------------------------------------------------------------
@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"draws": None}, "alpha is drawn at random: say how many settings are tried, by draws or budget"),
        ({"budget": 100}, "give draws or budget, not both"),
        ({"draws": None, "budget": 100}, "two settings take .* more than 100"),
        ({"rounds": 2}, "only optuna learns from one round to the next"),
        ({"rungs": 5}, "5 rungs, each 3 times the one before, are too many for rows of 20 of 360"),
        ({"grow": "seeds", "seeds": 2}, "are too many for 2 seeds"),
        ({"one_in": 1}, "one_in must be a whole number of at least 2, not 1"),
        ({"sampler": "grid"}, "sampler 'grid' is unknown; choose one of random, optuna"),
        ({"select": {}}, "select cannot be given to a search"),
        ({"search": 3}, "search must be a table of"),
        ({"step": 3}, "step"),
    ],
)
def test_what_cannot_be_searched_is_refused(given, why):
    with pytest.raises((rl.InputError, TypeError), match=why):
        wanted(**given)


@pytest.mark.parametrize(
    ("environment", "method", "why"),
    [
        ("windy-gridworld", "sarsa", "there is nothing to search: sarsa has one setting"),
        (["windy-gridworld", "cliff-walking"], SARSA, "a search is of one environment, and these are 2"),
        ("windy-gridworld", {"name": "sarsa", "alpha": [0.1, 0.2]}, "draws says .* and nothing is random"),
    ],
)
def test_so_is_what_has_nothing_to_search(environment, method, why):
    with pytest.raises(rl.InputError, match=why):
        Search(environment, method, steps=900, draws=None if method == "sarsa" else 3)


def test_a_file_is_read_and_its_mistakes_have_a_line(tmp_path):
    file = tmp_path / "search.toml"
    text = (
        "steps = 900\nseeds = 4\n\n[search]\ndraws = 3\none_in = 2\n\n[[environment]]\nname = 'windy-gridworld'\n\n"
        "[[method]]\nname = 'sarsa'\nalpha = {log_uniform = [0.05, 1]}\n"
    )
    file.write_text(text)
    search = Search.load(file)
    assert search.ranges == {"sarsa": {"alpha": {"log_uniform": [0.05, 1]}}} and search.settings("sarsa") == 3
    file.write_text(text.replace("one_in", "one_on"))
    with pytest.raises(rl.InputError, match=r"search\.toml, line 6: .*one_on"):
        Search.load(file)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("--alpha 0.05:1:log", {"alpha": LogUniform(0.05, 1.0)}),
        ("--alpha 0.05:1 --epsilon 0.1 0.2", {"alpha": Uniform(0.05, 1.0), "epsilon": [0.1, 0.2]}),
        ("--n 1:8", {"n": Integers(1, 8), "alpha": LogUniform(0.01, 1.0)}),
        ("--epsilon harmonic:100:visit", {"alpha": LogUniform(0.01, 1.0)}),
    ],
)
def test_ranges_are_typed(words, found, monkeypatch):
    from jaxrl_tab.cli import search as command

    taken = []
    monkeypatch.setattr(command.search, "Search", lambda env, methods, **_: taken.extend(methods) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.main(["search", "windy-gridworld", "n-step-sarsa", *words.split()])
    assert {key: taken[0][key] for key in found} == found


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--alpha 0.1:1 0.5", "--alpha: a range stands alone"),
        ("--n 1:8:log", "--n takes a range of whole numbers, such as 1:8"),
        ("--alpha 1:0.1", "--alpha: the low end, 1.0, must be below the high end"),
        ("--epsilon 0.1:2", "epsilon must be between 0 and 1, not 2"),
        ("--behaviour 0.1:0.4", "--behaviour takes no range of numbers"),
        ("--alpha 0.1:e", "--alpha: 0.1:e is no range"),
    ],
)
def test_wrong_ranges_are_one_line(words, why, capsys):
    assert cli.main(["search", "windy-gridworld", "n-step-sarsa", *words.split()]) == 2
    assert why in capsys.readouterr().err


def test_the_command_says_what_it_will_do_and_what_it_found(tmp_path, capsys):
    words = (
        "search windy-gridworld sarsa --alpha 0.05:1:log --epsilon 0.05 0.1 --draws 3 --seeds 4 --steps 360"
    )
    words = [*words.split(), "--log-every", "20", "--fresh-seeds", "3"]
    assert cli.main([*words, "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["methods"] == {"sarsa": {"settings": 6, "work": 4320}}
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith(
        "sarsa: 6 for 360 steps on 1 seed, 2 for 360 steps on 2 seeds, 2 for 360 steps on 4 seeds"
    )
    assert "was found among 6 settings, with 50% of what it takes to run all of them to the end." in out
    assert "*" not in out.split("fresh seeds, which")[1]  # there was no choice on these seeds
