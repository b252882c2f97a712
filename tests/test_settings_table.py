"""The table of settings: a statistic is one entry, and what is worked out is worked out once."""

import re
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pandas as pd
import pytest
from made_up import ALPHAS, make_result

import jaxrl_tab as rl
from jaxrl_tab import plot
from jaxrl_tab.cli import screen
from jaxrl_tab.experiment import files
from jaxrl_tab.experiment.storage import Store
from jaxrl_tab.stats import columns, settings
from jaxrl_tab.stats.column import Column
from jaxrl_tab.stats.columns import COLUMNS

METHODS = {"sarsa": -17.0, "q-learning": -16.0, "expected-sarsa": -18.0}


@pytest.fixture
def outcome(windy):
    q = rl.planning.value_iteration(windy)[1]
    datasets = {
        f"windy/{name}": make_result(windy, q, best=best).to_xarray() for name, best in METHODS.items()
    }
    return files.Outcome(datasets, {}, {"windy": windy})


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A folder for an experiment's files, in which pictures are made, but not rendered."""
    monkeypatch.setattr(files, "_about", lambda *_: {})
    monkeypatch.setattr(plot, "save", lambda figure, file: file.touch())
    return Mock(spec=Store, path=tmp_path, keep_files=list)


def show(outcome, store=None):
    if store:
        with files.drawing(store, outcome) as pictures:
            files.write_files(store, outcome, {"sessions": [{"command": "jaxrl-tab sweep"}]}, pictures)
    screen.show_outcome(outcome, None, SimpleNamespace(json=False, quiet=False))


def test_of_very_many_chosen_settings_the_best_of_each_environment_are_printed(outcome, capsys, monkeypatch):
    """Broken once: by the score on the seeds of the choice, or all -> fails."""
    monkeypatch.setattr(screen, "MOST_CHOSEN", 2)
    several = {f"{env}/{name.partition('/')[2]}": ds for env in "ab" for name, ds in outcome.datasets.items()}
    fresh = {
        name: ds.isel(alpha=[2], drop=False).assign_coords(seed=ds.seed + 100) for name, ds in several.items()
    }
    fresh["a/sarsa"] = fresh["a/sarsa"].assign(returns=fresh["a/sarsa"].returns * 0.5)
    both = files.Outcome(several, fresh, dict.fromkeys("ab", outcome.envs["windy"]))
    table = screen._best_of(both.selection, both)
    assert table[["environment", "method"]].values.tolist() == [["a", "sarsa"], ["b", "q-learning"]]
    screen._print_selection(both, None)
    told = capsys.readouterr().out
    assert "Of 6 chosen settings only the best of each environment is shown: --json has all." in told
    alone = {f"windy/{name[2:]}": ds for name, ds in fresh.items() if name[0] == "a"}
    one = files.Outcome(outcome.datasets, alone, outcome.envs)
    screen._print_selection(one, Path("runs"))
    told = capsys.readouterr().out
    assert (
        "Of 3 chosen settings only the 2 best are shown: selection.csv, the report and --json have all."
        in told
    )


@pytest.fixture
def fewest():
    """One more statistic, for the time of the test."""
    column = Column(
        "fewest",
        lambda own: own.ds.episodes.sum("row").min("seed"),
        in_summary="fewest_episodes",
        screen="fewest\nepisodes",
        report="fewest episodes",
        written="count",
        help="how many episodes the slowest run finished.",
    )
    COLUMNS.append(column)
    yield
    COLUMNS.remove(column)


def test_a_statistic_is_one_entry(outcome, kept, fewest, capsys):
    """It is found in summary.csv, on the screen and in the report.

    Broken once: the tables of the report know their columns by heart; so does the screen -> fails.
    """
    show(outcome, kept)
    by_hand = [n for ds in outcome.datasets.values() for n in ds.episodes.values.sum(-1).min(-1).tolist()]
    assert len(by_hand) == len(METHODS) * len(ALPHAS)
    assert len(set(by_hand)) > len(ALPHAS)

    table = pd.read_csv(kept.path / "summary.csv")
    assert table.fewest_episodes.tolist() == by_hand
    assert table.columns[-2:].tolist() == ["steps_per_second", "optimum"]  # where programs look for them

    out = capsys.readouterr().out
    assert "fewest" in out
    lines = [line.split("│") for line in out.splitlines() if re.match("│ [a-z]", line)]
    assert [int(line[-2]) for line in lines] == by_hand

    page = (kept.path / "report.html").read_text(encoding="utf-8")
    assert page.count(">fewest episodes</th>") == 2  # of the chosen settings, and of all
    best_first = table.sort_values("last_tenth_return", ascending=False)
    last_cells = re.findall(r"(\d+)</td></tr>", page.split("</table>")[2])
    assert [*map(int, last_cells)] == best_first.fewest_episodes.tolist()
    assert "<b>Fewest episodes</b>: how many episodes the slowest run finished." in page


def test_what_is_worked_out_is_handed_on(outcome, kept, monkeypatch, capsys):
    """The best setting, its interval and the rest once for each method; by CSV, pictures, report and screen.

    Broken once: `save_all` makes its `Methods` anew -> fails.
    """
    counts = Counter()

    def count(module, name):
        original = getattr(module, name)

        def counted(*given, **options):
            counts[name] += 1
            return original(*given, **options)

        monkeypatch.setattr(module, name, counted)

    best = settings.Settings.__dict__["best"]
    count(best, "func")
    for name in ("iqm_interval", "median_interval", "tolerance_interval", "soft_optimum", "differences"):
        count(columns, name)
    for name in ("seeds_wanted", "mean_interval", "has_errors"):
        count(settings, name)
    show(outcome, kept)
    show(outcome)
    assert capsys.readouterr().out.count("With ε = 0.1 and γ = 1") == 2
    assert counts["func"] == 2 * len(METHODS)  # also by how they learned early
    once = ("iqm_interval", "median_interval", "tolerance_interval", "seeds_wanted", "mean_interval")
    assert {name: counts[name] for name in once} == dict.fromkeys(once, len(METHODS))
    assert counts["soft_optimum"] == counts["differences"] == 1  # all explore alike
