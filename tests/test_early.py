"""How methods learn early: numbers worked by hand, what is compared, and what the table says of it."""

import io
import re

import numpy as np
import pytest
import xarray as xr
from made_up import make_result
from rich.console import Console

import jaxrl_tab as rl
from jaxrl_tab import stats
from jaxrl_tab.cli import screen
from jaxrl_tab.show import report
from jaxrl_tab.stats.columns import Methods

inf, nan = np.inf, np.nan


def log(episodes, *, length=10, step=-1.0, end=0.0, by_episodes=False, **attrs):
    """A log, [alphas, seeds, rows], with `length` steps in each row, of which each earns `step`, and each end `end`."""
    episodes = np.asarray(episodes)
    steps = np.broadcast_to(length, episodes.shape)
    rewards = step * steps + end * episodes
    fields = {"steps": steps, "episodes": episodes, "lengths": steps, "rewards": rewards, "returns": rewards}
    coords = {"alpha": np.arange(1, 1 + len(episodes)) / 10, "seed": np.arange(episodes.shape[1])}
    rows = episodes.shape[2]
    budget = (
        {"num_episodes": rows, "log_every": 1} if by_episodes else {"num_steps": 10 * rows, "log_every": 10}
    )
    return xr.Dataset(
        {name: (("alpha", "seed", "row"), field) for name, field in fields.items()}, coords, budget | attrs
    )


def row_of(name, datasets):
    return next(row for row in Methods(datasets).rows if row.method == name)


def test_numbers_by_hand():
    """Twenty rows of ten steps; in the first two of them one run ends two episodes, one a single one, one none."""
    episodes = np.zeros((1, 3, 20), int)
    episodes[0, 0, [0, 1, 19]] = 1, 1, 5
    episodes[0, 1, [1, 18]] = 1, 2
    ds = log(episodes)
    assert stats.first_tenth(ds) == slice(2)
    assert stats.first_tenth(ds.assign_attrs(log_every=40)) == slice(1)  # where no row is as short
    np.testing.assert_array_equal(stats.first_episode(ds), [[10, 10, inf]])
    np.testing.assert_array_equal(stats.steps_per_episode(ds, slice(2)), [[10, 20, inf]])
    np.testing.assert_array_equal(stats.pace(ds), [[2, 1, 0]])
    np.testing.assert_array_equal(
        stats.early_score(ds), [[-10, -20, -20]]
    )  # the third: all that it collected
    np.testing.assert_allclose(stats.interim_return(ds), [[-200 / 7, -200 / 3, -200]])
    table = stats.summary({"sarsa": ds}).iloc[0]
    assert table.first_episode_steps == 10
    assert table.first_tenth_steps == 3 * 20 / 3
    assert table.last_tenth_steps == 3 * 20 / 7
    assert table.first_tenth_unfinished == 1
    assert table.first_tenth_return == pytest.approx(-50 / 3)
    assert table.interim_return == pytest.approx(-200 * (1 / 7 + 1 / 3 + 1) / 3)
    assert table.interim_low < table.interim_return < table.interim_high <= 0
    diverged = ds.assign(diverged=(("alpha", "seed"), [[False, True, True]]))
    table = stats.summary({"sarsa": diverged}).iloc[0]
    assert (table.first_tenth_steps, table.first_episode_steps) == (10, 10)


def test_where_no_episode_ended_there_is_none_yet():
    ds = log(np.zeros((1, 2, 10), int))
    row = row_of("sarsa", {"sarsa": ds})
    assert (row["first_episode_steps"], row["early_steps"], row["early_unfinished"]) == (inf, inf, 2)
    assert row["interim"][0] == -100
    everywhere = log(np.zeros((1, 2, 10), int), diverged=1).assign(diverged=(("alpha", "seed"), [[True] * 2]))
    assert np.isnan(row_of("sarsa", {"sarsa": everywhere})["early_steps"])


def test_episodes_as_the_budget():
    ds = log(np.ones((1, 2, 20), int), length=[[30] * 10 + [5] * 10, [20] * 10 + [5] * 10], by_episodes=True)
    assert stats.first_tenth(ds) == slice(2)
    np.testing.assert_array_equal(stats.pace(ds), [[-60, -40]])
    row = row_of("sarsa", {"sarsa": ds})
    assert (row["first_episode_steps"], row["early_steps"], row["late_steps"]) == (25, 25, 5)


def test_of_prediction_there_is_the_error_alone():
    error = np.linspace(1, 0.05, 20) * np.array([1, 2])[:, None]
    ds = log(np.ones((1, 2, 20), int)).assign(v_error=(("alpha", "seed", "row"), error[None]))
    row = row_of("td", {"td": ds})
    assert row["early_score"][0] == pytest.approx(error[:, :2].mean())
    assert not any(row.has(name) for name in ("first_episode_steps", "early_steps", "interim"))


# --- what is compared --------------------------------------------------------------------------------


def test_whether_episodes_earn_by_their_length():
    """Broken once: the end need not pay the same -> fails."""
    some = np.arange(40).reshape(1, 2, 20) % 3
    assert stats.by_length(log(some, step=-0.1))
    assert stats.by_length(log(some, step=0.0, end=1.0))
    assert stats.by_length(log(some, step=-1.0, end=20.0))
    assert not stats.by_length(log(some, step=1.0))
    assert not stats.by_length(log(some, step=0.0))
    assert not stats.by_length(log(some).drop_vars("rewards"))
    assert not stats.by_length(log(some, step=-inf))
    falls = log(some)
    falls["rewards"][0, 1, 7] -= 99
    assert not stats.by_length(falls)
    assert stats.by_length(falls.assign(diverged=(("alpha", "seed"), [[False, True]])))
    wins = log(some, step=0.0, end=1.0)
    wins["rewards"][0, 1, 2] = 0
    assert not stats.by_length(wins)


def crossing(early, late, seeds=20):
    """Runs of ten rows, of which so many episodes end in the first and in each of the others, give or take one."""
    luck = np.random.default_rng(seeds).integers(-1, 2, (1, seeds, 10))
    return log(np.r_[early, [late] * 9] + luck)


def test_the_setting_that_is_better_early_is_found():
    quick, steady = crossing(8, 4), crossing(3, 9)
    found = stats.better_early({"steady": steady, "quick": quick})
    assert (found.quick, found.winner) == (("quick", {"alpha": 0.1}), ("steady", {"alpha": 0.1}))
    assert found.by is stats.pace
    apart = (quick.episodes - steady.episodes).isel(row=0).mean()
    assert float(found.difference.interval.estimate) == pytest.approx(float(apart))
    of_one = xr.concat([steady, quick.assign_coords(alpha=[0.2])], "alpha")
    assert stats.better_early({"mine": of_one}).quick == ("mine", {"alpha": 0.2})


def test_nothing_is_said_of_what_is_best_in_both_or_of_luck():
    """Broken once: the interval is that of one pair alone -> fails."""
    assert stats.better_early({"quick": crossing(8, 9), "slow": crossing(3, 4)}) is None
    steady, lucky = crossing(3, 9), crossing(3, 4)
    lucky["episodes"][0, :8, 0] += 2
    several = {f"slow {i}": crossing(2, 3) for i in range(7)} | {"steady": steady, "lucky": lucky}
    alone = stats.paired_difference(*(stats.pace(ds).isel(alpha=0) for ds in (lucky, steady)))
    assert alone.interval.low > 0
    assert stats.better_early(several) is None
    assert (
        stats.better_early({"a": steady, "b": crossing(8, 4).assign_coords(seed=np.arange(20) + 7)}) is None
    )


def test_elsewhere_returns_are_compared():
    """Where falls cost more than steps: the quick one falls, and earns less."""
    quick, steady = crossing(8, 4), crossing(3, 9)
    for name in ("rewards", "returns"):
        quick[name][0, :, 0] -= 900
        steady[name][0, :, 1:] += 1
    assert stats.better_early({"steady": steady, "quick": quick}) is None
    cheap = crossing(3, 4)
    cheap["returns"][0, :, 0] += 5
    cheap["rewards"][0, :, 0] += 5
    found = stats.better_early({"steady": steady, "cheap": cheap})
    assert (found.quick[0], found.by) == ("cheap", stats.early_score)


def test_traces_learn_faster_in_the_trace_gridworld_whatever_gamma_is():
    """Sarsa is better in the end where gamma is .9, and neither is at 1; in episode 2 it needs 187 steps and not 27."""
    env, options = rl.make("trace-gridworld"), {"num_seeds": 20, "num_steps": 8000}
    grid = {"alpha": 0.2, "gamma": [0.9, 1.0]}
    datasets = {name: rl.sweep(env, name, grid, **options).to_xarray() for name in ("sarsa", "sarsa-lambda")}
    for gamma in (0.9, 1.0):
        of_gamma = {name: ds.sel(gamma=gamma) for name, ds in datasets.items()}
        methods = Methods(of_gamma, env)
        assert methods.by_length
        quick, winner = methods.early
        assert (quick.method, winner.method) == ("sarsa-lambda", "sarsa")
        assert 4 * quick["early_steps"] < winner["early_steps"]


# --- what people see ---------------------------------------------------------------------------------


@pytest.fixture
def methods(windy):
    q = np.zeros((70, 4))
    datasets = {name: make_result(windy, q, seeds=30).to_xarray() for name in ("sarsa", "expected-sarsa")}
    slow = datasets["expected-sarsa"]
    slow["episodes"][:, :, :2] = 0
    slow["returns"][:, :, :2] = 0
    slow["returns"][:, :, -2:] *= 0.9
    return Methods(datasets, windy)


def test_the_screen_shows_both(methods, capsys):
    """The table is no wider than 120 columns. Broken once: no sentence; the last tenth twice -> fails."""
    screen.print_summary("windy", methods)
    out = capsys.readouterr().out
    lines = [line.split("│") for line in out.splitlines() if re.match("│ [a-z]", line)]
    assert max(map(len, out.splitlines()[1:12])) <= 120
    numbers = stats.summary(methods)
    shown = [[line[4].strip(), line[5].strip()] for line in lines]
    assert [cells[0] for cells in shown[3:]] == ["none yet"] * 3
    read = lambda cells: [inf if cell == "none yet" else float(cell) for cell in cells]
    early, late = (read(cells) for cells in zip(*shown, strict=True))
    np.testing.assert_allclose(early, numbers.first_tenth_steps, atol=0.51)
    np.testing.assert_allclose(late, numbers.last_tenth_steps, atol=0.51)
    said = f"over the first tenth of the run the steps an episode are {shown[2][0]} with Sarsa, α = 0.9; with Expected"
    assert f"better: {said} Sarsa, α = 0.9, the best at the end, no episode ends." in " ".join(out.split())


def test_a_narrow_window_has_the_columns_that_matter(methods, monkeypatch):
    """Broken once: no column goes -> fails."""
    written = io.StringIO()
    monkeypatch.setattr(screen, "console", lambda: Console(file=written, width=80, highlight=False))
    screen.print_summary("windy", methods)
    table = written.getvalue().splitlines()[1:14]
    assert all(len(line) <= 80 for line in table)
    assert len({line.count("│") for line in table if "│" in line}) == 1
    assert sum("sarsa" in line for line in table) == 6  # no row is broken
    assert "In a wider window the table has: episodes" in written.getvalue()


def test_the_report_has_a_table_of_early_learning(methods, tmp_path):
    sets = {f"windy/{name}": ds for name, ds in methods.items()}
    page = report.write(tmp_path, sets, {"windy": methods.env}, {}).read_text(encoding="utf-8")
    section = page.split('<h3 id="early-1">')[1].split("<h3")[0]
    assert "Early on another is better" in section
    cells = re.findall(r"<td[^>]*><span>(.*?)\s*</span>", section.replace("\xa0", " "))
    assert cells[:3] == ["Expected Sarsa", "α = 0.9", "200"]
    assert cells[3] == "none yet"
    assert "runs without an episode in the first tenth" in section
    assert "all steps that the runs took in their first tenth" in page
