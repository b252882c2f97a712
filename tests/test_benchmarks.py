"""The benchmark: ratios within rounds, verdicts, and whether all learn the same. Nothing is timed here."""

import numpy as np
import pytest

import jaxrl_tab as rl
from benchmarks import problems, report
from benchmarks.rounds import Party, Record, Target, Task
from benchmarks.tasks import QUICK, ROWS, SLOW


def task(*targets, outcome="episodes"):
    parties = tuple(Party(name, name, f"{name}:run", {}) for name in ("we", "they"))
    return Task("a task", 2, work=60, unit="steps", parties=parties, targets=targets, outcome=outcome)


def records(party, seconds, mean=100.0, variance=25.0, lanes=400):
    return [Record("a task", 2, i, party, s, mean, variance, lanes) for i, s in enumerate(seconds)]


def test_a_ratio_is_the_median_of_those_within_a_round():
    """The machine slows down from round to round: the ratio of the medians would be 30 / 3."""
    found = records("we", [1, 3, 30]) + records("they", [2, 30, 60])
    (row,) = report.rows(task(Target("we", "they", least=2.0, aim=3.0)), found)
    assert (row.ratio, row.low, row.high) == (2.0, 2.0, 10.0)
    assert (row.speed, row.speed_against, row.verdict) == (20.0, 2.0, "met")


@pytest.mark.parametrize(
    ("target", "ratio", "expected"),
    [
        (Target("we", "they"), 5.0, ""),
        (Target("we", "they", least=1.0, aim=2.0), 0.99, "missed"),
        (Target("we", "they", least=1.0, aim=2.0), 1.0, "met"),
        (Target("we", "they", least=1.0, aim=2.0), 2.0, "aim"),
        (Target("we", "they", least=2.0, times=True), 1.9, "met"),
        (Target("we", "they", least=2.0, times=True), 2.0, "missed"),
    ],
)
def test_verdict(target, ratio, expected):
    assert report.verdict(target, ratio) == expected


def test_a_start_that_takes_longer_has_the_larger_ratio_of_times():
    found = records("we", [3.0]) + records("they", [2.0])
    (row,) = report.rows(task(Target("we", "they", least=2.0, times=True)), found)
    assert row.ratio == 1.5


def test_parties_agree_within_four_standard_errors():
    """A standard error of each mean is 5 / 20 in one round of 400 lanes, so of their difference 0.354."""

    def differing_by(difference):
        found = records("we", [1]) + records("they", [1], mean=100 + difference)
        return report.disagreements(task(), found)

    assert not differing_by(1.4)
    assert len(differing_by(1.45)) == 1
    assert "we 100, they 101.45" in differing_by(1.45)[0]
    assert len(differing_by(float("nan"))) == 1
    assert not report.disagreements(task(outcome=None), records("we", [1]))


def test_more_rounds_tell_smaller_differences():
    found = records("we", [1] * 4) + records("they", [1] * 4, mean=100.8)
    assert report.disagreements(task(), found)
    assert not report.disagreements(task(), records("we", [1]) + records("they", [1], mean=100.8))


def test_of_few_lanes_more_is_put_down_to_chance():
    """Two rounds of one lane: with one degree of freedom 4 standard errors are nothing."""

    def one_run(party, means):
        return [Record("a task", 2, i, party, 1.0, mean, 0.0, 1) for i, mean in enumerate(means)]

    found = one_run("we", [99, 101]) + one_run("they", [109, 111])
    assert not report.disagreements(task(), found)


def test_peers_walk_in_our_windy_gridworld():
    model = rl.planning.exact_model(rl.make("windy-gridworld"))
    ours, theirs = (
        np.delete(x, problems.GOAL, axis=0) for x in (model.s_next[..., 0], problems.windy_successors())
    )
    np.testing.assert_array_equal(ours, theirs)


def test_garnet_is_a_finite_mdp():
    mdp = problems.garnet(states=30, terminal=2)
    assert mdp.successors.shape == mdp.prob.shape == (30, 4, 5)
    assert all(len(set(row)) == 5 for row in mdp.successors.reshape(-1, 5))
    np.testing.assert_allclose(mdp.prob.sum(-1), 1)
    assert (mdp.prob > 0).all() and ((mdp.reward <= 0) & (mdp.reward >= -1)).all()
    assert np.flatnonzero(mdp.terminal).tolist() == [28, 29]


def test_every_target_names_parties_of_its_task():
    for name in set(ROWS) - {"methods"}:  # which asks another process for names
        for row in ROWS[name](QUICK, 2):
            names = [party.name for party in row.parties]
            assert len(set(names)) == len(names)
            assert {target.party for target in row.targets} | {t.against for t in row.targets} <= set(names)
    assert set(SLOW) <= set(ROWS)
