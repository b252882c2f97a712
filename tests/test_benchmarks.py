"""The benchmark: ratios within rounds, verdicts, and whether all learn the same. Nothing is timed here."""

import numpy as np
import pytest

import jaxrl_tab as rl
from benchmarks import machine, problems, report
from benchmarks.__main__ import ROUNDS
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
        (Target("we", "they", least=0.25, aim=0.125, times=True), 0.125, "met"),
        (Target("we", "they", least=0.25, aim=0.125, times=True), 0.12, "aim"),
    ],
)
def test_verdict(target, ratio, expected):
    assert report.verdict(target, ratio) == expected


def test_a_start_that_takes_longer_has_the_larger_ratio_of_times():
    found = records("we", [3.0]) + records("they", [2.0])
    (row,) = report.rows(task(Target("we", "they", least=2.0, times=True)), found)
    assert row.ratio == 1.5


def test_against_nobody_the_seconds_are_judged():
    """Broken once: with speeds instead, as in a target that is no time -> fails."""
    found = records("we", [0.02, 0.04, 0.025]) + records("they", [1.0] * 3)
    (row,) = report.rows(task(Target("we", None, least=0.03, aim=0.01, times=True)), found)
    assert (row.ratio, row.low, row.high, row.verdict) == (0.025, 0.02, 0.04, "met")
    assert row.speed_against is None
    shown = {column.header: [*column.cells] for column in report.table([row], rounds=3).columns}
    assert shown["ratio"] == ["0.025 s"] and shown["against"] == [""]
    assert shown["target"] == ["< 0.03 s, aim 0.01 s"]


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
            compared = {target.party for target in row.targets} | {target.against for target in row.targets}
            assert compared - {None} <= set(names)
    assert set(SLOW) <= set(ROWS)


@pytest.mark.parametrize(
    ("cpu", "model", "vectors"),
    [
        (
            {"model name": "EPYC", "cpu family": "25", "model": "1", "flags": "fma avx avx2"},
            "EPYC (cpu family 25, model 1)",
            "AVX2 (256 bits)",
        ),
        ({"model name": "Xeon", "flags": "avx2 avx512f avx512vl"}, "Xeon", "AVX-512 (512 bits)"),
        ({"model name": "Neoverse", "Features": "fp asimd"}, "Neoverse", "NEON (128 bits)"),
        ({"model name": "Atom", "flags": "sse4_2 avx2_not"}, "Atom", "vectors of unknown width"),
    ],
)
def test_the_processor_is_named_with_the_width_of_its_vectors(cpu, model, vectors):
    assert (machine.model(cpu), machine.vectors(cpu)) == (model, vectors)


def test_the_table_says_on_what_processor_it_was_measured():
    assert machine.processor() in report.table([], rounds=9).caption
    assert ROUNDS >= 9


def test_a_program_that_was_kept_is_measured_after_it_was_made():
    """By each backend in a folder of its own: one process of the benchmark has them all."""
    first, again = ROWS["compiling"](QUICK, 2)
    for made, kept in zip(first.parties, again.parties, strict=True):
        assert (made.library, made.arguments) == (kept.library, kept.arguments)
