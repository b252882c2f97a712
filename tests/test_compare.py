"""Results beside other results: the same bits, better or worse, by which differences, and what the command says."""

import json
import shutil

import numpy as np
import pytest
import quick
import xarray as xr
from refusals import refused
from rich.console import Console
from scipy import stats as oracle

import jaxrl_tab as rl
from jaxrl_tab import plot, report, stats
from jaxrl_tab.cli import compare as compare_module
from jaxrl_tab.cli import main
from jaxrl_tab.experiment import shards
from jaxrl_tab.experiment.files import Outcome

NAME = "windy-gridworld/sarsa"
EXPERIMENT = rl.Experiment("windy-gridworld", {"name": "sarsa", "alpha": [0.25, 0.5]}, seeds=40, steps=20)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A finished folder with two shards: runs 0 to 63 of 80, that is all seeds of α = 0.25, and 24 of the other."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(shards, "SHARD_STEPS", 64 * 20)
        patched.setattr(plot, "save_all", quick.picture)
        patched.setattr(report, "write_methods", quick.page)
        shards._shards.cache_clear()
        path = tmp_path_factory.mktemp("compare") / "a"
        rl.run(EXPERIMENT, path, progress=False)
        yield path
    shards._shards.cache_clear()


def made_up(scores, root=0, first=0, alphas=(0.25, 0.5), **attrs):
    """A sweep whose runs score these numbers, [alphas, seeds]: each has one episode in each of ten rows."""
    scores = np.asarray(scores, float)
    shape = (*scores.shape, 10)
    rows = np.broadcast_to(scores[..., None], shape)
    axes = ("alpha", "seed", "row")
    variables = {"steps": np.full(shape, 2), "episodes": np.ones(shape, int), "returns": rows.copy()}
    variables |= {"lengths": np.full(shape, 2), "rewards": rows.copy()}
    ds = xr.Dataset(
        {name: (axes, x) for name, x in variables.items()} | {"q": (axes[:2], scores)},
        {"alpha": list(alphas), "seed": first + np.arange(scores.shape[1]), "row": np.arange(10)},
        {"environment": "windy-gridworld", "environment_parameters": "{}", "algorithm": "sarsa"},
    )
    return ds.assign_attrs(
        {"num_episodes": 10, "log_every": 1, "root_seed": root, "learns": "actions"} | attrs
    )


def column(*numbers):
    """A number for each alpha, to be added to scores."""
    return np.array(numbers, float)[:, None]


def outcome(ds, name=NAME, fresh=None):
    return Outcome({name: ds}, {} if fresh is None else {name: fresh}, {})


RNG = np.random.default_rng(0)
SCORES = RNG.normal(-20, 1, (2, 30))


# --- the same bits -----------------------------------------------------------------------------------


def test_a_folder_is_the_same_as_its_copy_which_is_only_looked_at(folder, tmp_path):
    """In the copy another version is recorded. Broken once: `rewards` are left out -> the next one fails."""
    shutil.copytree(folder, other := tmp_path / "b")
    records = json.loads((other / "provenance.json").read_text())
    records["sessions"][0]["surroundings"] |= {"jax": "0.0.1", "backend": "xla", "device": "cpu other"}
    (other / "provenance.json").write_text(json.dumps(records))
    before = sorted((path, path.stat().st_mtime_ns) for path in other.rglob("*"))
    found = rl.compare(folder, other)
    assert [(row.verdict, row.same, row.common) for row in found.others[0].rows] == [("same", 40, 40)] * 2
    assert found.whole and not found.worse
    assert str(found).endswith(
        "B is the same as A, to the last bit, in all 2 settings that both have: 80 runs."
    )
    (beside,) = found.others
    assert [line.split(" was ")[0] for line in beside.differs["versions"]] == ["jax"]
    assert beside.differs["settings"][0].endswith("and is xla")
    assert beside.differs["machine"] == ["device was without other, and is with it"]
    assert not beside.differs["experiment"]
    assert sorted((path, path.stat().st_mtime_ns) for path in other.rglob("*")) == before


def test_the_first_place_that_is_not_the_same_is_told():
    other = made_up(SCORES)
    other.rewards[1, 4, 7] += 1
    other.returns[1, 9, 2] += 1
    equal, changed = rl.compare(outcome(made_up(SCORES)), outcome(other)).others[0].rows
    assert equal.verdict == "same"
    assert (changed.verdict, changed.same) == ("open", 28)
    assert changed.first == (4, 7, "rewards", SCORES[1, 4], SCORES[1, 4] + 1)


def test_runs_of_another_length_are_the_same_as_far_as_both_go():
    longer = made_up(SCORES, num_episodes=20)
    rows = rl.compare(outcome(made_up(SCORES)), outcome(longer)).others[0].rows
    assert [(row.same, row.verdict) for row in rows] == [(30, "open")] * 2


# --- better and worse --------------------------------------------------------------------------------


@pytest.mark.parametrize("prediction", [False, True])
def test_what_is_worse_depends_on_what_is_measured(prediction):
    """B scores 2 more at the first alpha and 1 less at the second one, give or take; of errors more is worse."""
    more = column(2, -1) + RNG.normal(0, 0.1, (2, 30))
    a, b = made_up(SCORES), made_up(SCORES + more)
    if prediction:
        a, b = (ds.assign(v_error=-ds.returns, optimum=0).assign_attrs(learns="states") for ds in (a, b))
        assert (stats.score(a).values > 0).all()
    rows = rl.compare(outcome(a), outcome(b)).others[0].rows
    assert [row.verdict for row in rows] == ["better", "worse"]
    sign = -1 if prediction else 1
    for row, x, alpha in zip(rows, more, (0.25, 0.5), strict=True):
        assert row.setting == {"alpha": alpha}
        assert row.paired and row.difference == pytest.approx(sign * x.mean())
        assert row.low < row.difference < row.high
        assert row.means[1] - row.means[0] == pytest.approx(row.difference)


def test_holm_over_all_comparisons_and_intervals_that_say_the_same():
    """Three differences, of which the middle one is held back by Holm's rule: p and intervals agree in each."""
    scores, noise = RNG.normal(0, 1, (4, 20)), RNG.normal(0, 1, (4, 20))
    noise -= noise.mean(1, keepdims=True)
    alphas = (0.1, 0.2, 0.3, 0.4)
    a = made_up(scores, alphas=alphas)
    b = made_up(scores + noise * column(1, 1, 1, 0) + column(2.0, 0.45, 0.1, 0), alphas=alphas)
    rows = rl.compare(outcome(a), outcome(b)).others[0].rows
    p = [row.p for row in rows[:3]]
    assert p[0] < p[1] < 0.1 < p[2]
    np.testing.assert_allclose([x.corrected for x in rows[:3]], [3 * p[0], 2 * p[1], max(2 * p[1], p[2])])
    assert np.isnan(rows[3].p) and rows[3].verdict == "same"  # no comparison, so not corrected for
    for row in rows[:3]:
        assert (row.corrected <= 0.05) == (not row.low <= 0 <= row.high) == (row.verdict == "better")


def test_other_seeds_are_compared_unpaired():
    """Symmetric scores have no skewness, so it is Welch's test; root 1 has other seeds with the same numbers."""
    half = np.abs(RNG.normal(0, 1, (2, 10)))
    x, y = np.hstack([half, -half]), 2 * np.hstack([half, -half]) + 3
    found = rl.compare(outcome(made_up(x)), outcome(made_up(y, root=1)))
    for i, row in enumerate(found.others[0].rows):
        assert (row.paired, row.common, row.same) == (False, 0, 0)
        assert row.p == pytest.approx(oracle.ttest_ind(y[i], x[i], equal_var=False)[1])
    assert "Unpaired, for fewer than 6 seeds are in both: 2 comparisons." in found.sentences
    later = rl.compare(outcome(made_up(x)), outcome(made_up(y, first=10))).others[0].rows
    assert [(row.paired, row.common) for row in later] == [(True, 10)] * 2


def test_where_other_values_were_tried_the_best_settings_are_compared():
    """Corrected for the choice among 2 x 2 pairs; what both have is compared as well, but nothing twice."""
    a = made_up(SCORES + column(0, 3))
    b = made_up(SCORES + column(0, 2), alphas=(0.25, 0.7))
    equal, chosen = rl.compare(outcome(a), outcome(b)).others[0].rows
    assert (equal.kind, equal.verdict) == ("setting", "same")
    assert (chosen.kind, chosen.setting, chosen.other) == ("chosen", {"alpha": 0.5}, {"alpha": 0.7})
    assert chosen.difference == pytest.approx(-1) and chosen.verdict == "worse"
    alone = stats.paired_difference(stats.score(b)[1], stats.score(a)[1], worst=np.inf).p
    assert chosen.p == pytest.approx(4 * float(alone))
    best_in_both = made_up(SCORES + column(5, 0), alphas=(0.25, 0.7))
    (row,) = rl.compare(outcome(made_up(SCORES + column(5, 0))), outcome(best_in_both)).others[0].rows
    assert row.setting == {"alpha": 0.25}


def test_fresh_seeds_are_compared_where_both_have_some():
    a, b = (
        outcome(made_up(SCORES), fresh=made_up(SCORES[:1] + x, alphas=(0.25,), fresh_seeds=1))
        for x in (0, -2)
    )
    *_, fresh = rl.compare(a, b).others[0].rows
    assert (fresh.kind, fresh.verdict, fresh.paired) == ("fresh", "worse", True)


def test_runs_that_are_lost_count():
    """12 of 30 runs of B diverged, and score as the worst one there is, which is hardly worse than the others."""
    a, b = (ds.assign(diverged=xr.zeros_like(ds.q, bool)) for ds in (made_up(SCORES), made_up(SCORES)))
    b.diverged[1, :12] = True
    found = rl.compare(outcome(a), outcome(b))
    row = found.others[0].rows[1]
    assert (row.lost, row.verdict) == ((0, 12), "worse")
    assert "0 and 12 runs diverged" in str(found)


def test_what_only_one_has_and_what_is_another_task():
    a = Outcome({NAME: made_up(SCORES), "x/sarsa": made_up(SCORES)}, {}, {})
    king = made_up(SCORES, environment_parameters='{"moves": "king"}')
    b = Outcome({"x/sarsa": king, "x/td": king}, {}, {})
    a.datasets["x/sarsa"].attrs["environment_parameters"] = '{"moves": "four", "new": 1}'
    refused(lambda: rl.compare(a, b), "x/sarsa is not the same task")
    b.datasets[NAME] = made_up(SCORES)
    found = rl.compare(a, b, outcome(made_up(SCORES)))
    assert found.others[0].not_alike == ["x/sarsa"] and not found.others[0].whole
    assert [x.alone for x in found.others] == [([], ["x/td"]), (["x/sarsa"], [])]
    assert [x.letter for x in found.others] == ["B", "C"]


# --- folders -----------------------------------------------------------------------------------------


def test_of_an_unfinished_folder_what_is_there_is_compared(folder, tmp_path):
    """Without the second shard there are 24 seeds of both settings, more than 40 of the first."""
    shutil.copytree(folder, other := tmp_path / "b")
    (other / "results.nc").unlink()
    (beside,) = rl.compare(folder, other).others
    assert beside.complete and "results.nc is missing" in beside.notes[0]
    assert [(row.verdict, row.common) for row in beside.rows] == [("same", 40)] * 2
    (other / "shards" / "000001.npz").unlink()
    (beside,) = rl.compare(folder, other).others
    assert "not finished: 1 of 2 shards are there" in beside.notes
    assert [(row.verdict, row.common) for row in beside.rows] == [("same", 24)] * 2
    assert not beside.whole
    turned = rl.compare(
        other, folder
    )  # broken once: only the others are asked whether they are whole -> fails
    assert not (turned.whole or turned.complete) and turned.others[0].whole
    assert main(["compare", str(other), str(folder), "--fail-if-worse"]) == 2
    (other / "shards" / "000000.npz").write_bytes(b"damaged")
    refused(lambda: rl.compare(folder, other), f"nothing is finished in {other}", "jaxrl-tab resume")


@pytest.mark.parametrize(
    ("now", "note"),
    [
        ({"select": {"by": "score", "fresh_seeds": 9}}, "the runs on fresh seeds are not all there"),
        ({"seeds": 50}, "not finished: 2 of 3 shards are there"),
    ],
)
def test_what_was_to_be_added_and_is_not_there_is_told(folder, tmp_path, now, note):
    """A process was killed after it had written what the sweep is to be. Broken once: `results.nc` of what it was
    before passes for all of that -> fails.
    """
    shutil.copytree(folder, other := tmp_path / "b")
    was = json.loads((other / "resolved.json").read_text())
    entry = {"experiment": was, "files": {}, "time": "", "command": ""}
    (other / "resolved.json").write_text(json.dumps(was | now | {"history": [entry]}))
    (beside,) = rl.compare(folder, other).others
    assert note in " ".join(beside.notes) and not beside.whole
    assert [(row.verdict, row.common) for row in beside.rows] == [("same", 40)] * 2


def test_what_cannot_be_compared_is_one_line(folder, tmp_path):
    refused(lambda: rl.compare(folder), "compare takes two results or more", "not 1")
    refused(lambda: rl.compare(folder, tmp_path / "no"), "there is no folder")
    refused(lambda: rl.compare(folder, tmp_path), "there is no experiment in")
    refused(lambda: rl.compare(folder, 3), "compare takes folders of results", "not 3")
    foreign = made_up(SCORES).drop_vars("returns")
    rl.export.save({NAME: foreign}, tmp_path / "foreign.nc")
    refused(lambda: rl.compare(folder, tmp_path / "foreign.nc"), f"{NAME} is not what a sweep writes")
    shutil.copytree(folder, other := tmp_path / "b")
    (other / "resolved.json").write_text('{"environment": [3], "method": []}')
    refused(lambda: rl.compare(folder, other), "resolved.json is missing or damaged")
    (other / "manifest.json").write_text("{")
    refused(lambda: rl.compare(folder, other), "manifest.json is missing or damaged", "jaxrl-tab resume")


# --- the command -------------------------------------------------------------------------------------


@pytest.fixture
def in_files(tmp_path):
    """results.nc of two sweeps, of which the second is worse."""
    for name, more in (("a", 0), ("worse", -2)):
        stats_file = {NAME: made_up(SCORES + more)}
        rl.export.save(stats_file, tmp_path / f"{name}.nc")
    return [str(tmp_path / f"{name}.nc") for name in ("a", "worse")]


def test_the_command_says_what_is_worse_and_ends_with_1_if_asked(in_files, tmp_path, capsys):
    a, worse = in_files
    assert main(["compare", a, worse]) == 0
    assert "B beside A, in 2 comparisons: 2 WORSE." in capsys.readouterr().out
    page = tmp_path / "page.html"
    assert main(["compare", a, worse, "--fail-if-worse", "--html", str(page), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert (said["worse"], said["whole"], said["others"][0]["comparisons"][0]["verdict"]) == (
        2,
        True,
        "worse",
    )
    assert 'class="worse"' in page.read_text() and "<script" not in page.read_text()
    assert "to the right of the line is better" in page.read_text()
    assert "of the line" not in rl.compare(a, a).page().html  # there is none
    assert main(["compare", worse, a, "--fail-if-worse"]) == 0
    assert main(["compare", a, a, "--html", str(page)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_file_is_compared_whatever_the_environment_is_called_elsewhere(in_files):
    """Broken once: by the names alone -> there is nothing to compare; whatever the environment is -> it is renamed."""
    labelled = outcome(made_up(SCORES), "my wind/sarsa")
    rows = rl.compare(labelled, in_files[0]).others[0].rows
    assert [(row.name, row.verdict) for row in rows] == [("my wind/sarsa", "same")] * 2
    elsewhere = outcome(made_up(SCORES, environment="taxi"), "taxi/sarsa")
    refused(lambda: rl.compare(labelled, elsewhere), "has my wind/sarsa", "has taxi/sarsa")


def test_in_a_narrow_window_the_table_leaves_columns_out_and_says_so(in_files, monkeypatch, capsys):
    """Broken once: all columns in 44 characters -> the difference is cut off."""
    monkeypatch.setattr(compare_module, "console", lambda: Console(width=44))
    assert main(["compare", *in_files]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert (
        "│ −2.00 │" in out
        and "…" not in out
        and "In a wider window the table has: same runs; p (Holm)" in out
    )


def test_what_is_missing_ends_with_2_if_asked(in_files, tmp_path, capsys):
    rl.export.save({NAME: made_up(SCORES), "x/td": made_up(SCORES)}, tmp_path / "more.nc")
    more = str(tmp_path / "more.nc")
    assert main(["compare", more, in_files[0], "--fail-if-worse"]) == 2
    assert "Only A has TD(0) in x." in capsys.readouterr().out
    assert main(["compare", in_files[0], more, "--fail-if-worse"]) == 0


# --- error rates -------------------------------------------------------------------------------------


def test_unpaired_difference_by_hand():
    """x: 1, 2, 3, y: 0, 4. s² = 1 and 8: error sqrt(1/3 + 4), degrees (13/3)² / (1/18 + 16) = 1.1696."""
    x, y = (xr.DataArray([*map(float, z)], dims="seed") for z in ([1, 2, 3], [0, 4]))
    found = stats.unpaired_difference(x, y)
    assert (float(found.interval.estimate), int(found.interval.n)) == (0, 5)
    half = oracle.t.ppf(0.975, (13 / 3) ** 2 / (1 / 18 + 16)) * (13 / 3) ** 0.5
    np.testing.assert_allclose([found.interval.low, found.interval.high], [-half, half])
    far = stats.unpaired_difference(x + 1000, y).p
    assert far == pytest.approx(2 / 10)  # of ten ways to divide five values
    assert np.isnan(stats.unpaired_difference(x, y[:1]).p)


def test_unpaired_difference_knows_of_runs_that_no_seed_has_shown():
    """The scores of x rest on few bad runs, so one more as bad as `worst` moves the low end."""
    x = xr.DataArray(-(RNG.exponential(1, 30) ** 3), dims="seed")
    y = xr.DataArray(RNG.normal(-20, 1, 30), dims="seed")
    plain, wider = (stats.unpaired_difference(x, y, worst=w) for w in (np.inf, -500.0))
    assert float(wider.interval.low) < float(plain.interval.low)
    assert float(wider.interval.high) == float(plain.interval.high)
    assert float(wider.p) > float(plain.p)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "m"), [(10, 10), (30, 30)])
def test_so_often_the_unpaired_interval_holds_the_difference(n, m):
    """Of exponential and of normal values: between 94.5% and 96.5%, give or take three standard errors of 0.3%."""
    rng, runs = np.random.default_rng(0), 5000
    x = xr.DataArray(rng.exponential(1, (runs, n)), dims=("experiment", "seed"))
    y = xr.DataArray(rng.normal(1, 1, (runs, m)), dims=("experiment", "seed"))
    (_, low, high, _), p, _ = stats.unpaired_difference(x, y)
    held = float(((low <= 0) & (high >= 0)).mean())
    assert 0.945 - 0.009 < held < 0.965 + 0.009
    assert float((p > 0.05).mean()) == pytest.approx(held, abs=1e-3)
