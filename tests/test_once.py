"""What a command works out is worked out once, and handed on."""

import sys
from collections import Counter

import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import cli, planning
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.exact import model, optimum
from jaxrl_tab.experiment import resolve, shards, spec
from jaxrl_tab.stats import measures, settings

# As `quick.SELECTED`, so that its programs serve.
COMMAND = "sweep windy-gridworld sarsa q-learning --alpha 0.25 0.5 --seeds 70 --steps 200 --select --out"
METHODS = 2


@pytest.fixture
def counts(monkeypatch):
    """How often functions are called; nothing is known from before, nor from an earlier process."""
    counts = Counter()

    def count(module, name, called=None):
        original = getattr(module, name)

        def counted(*given, **options):
            counts[called or name] += 1
            return original(*given, **options)

        monkeypatch.setattr(module, name, counted)

    monkeypatch.setattr(model, "_kept", {})
    monkeypatch.setattr(model, "_keeper", lambda name, make, *_: make())
    monkeypatch.setattr(model, "keep_with", lambda keeper: None)
    shards.forget_parts()
    count(model, "_check_model")
    count(optimum, "iterate_policies")
    count(spec.Experiment, "__post_init__", "Experiment")
    count(spec, "prepare")
    for module in (resolve, sys.modules["jaxrl_tab.engine.sweep"]):
        count(module, "configurations")
    for module in (measures, settings):
        count(module, "mean_interval", f"mean_interval of {module.__name__.rpartition('.')[2]}")
    for name in ("best", "score", "seeds_wanted"):
        count(settings.Settings.__dict__[name], "func", name)
    return counts


@pytest.mark.slow
def test_a_sweep_works_out_each_thing_once(counts, tmp_path, monkeypatch, capsys):
    """For a person who looks on: the plan, the runs, the choice, fresh seeds, tables, pictures and the report.

    Broken once, each fails: the model is not kept; nor is what is solved in it; the shards read the
    experiment from its data; the overview has no settings of its own (curves twice); the choice asks `stats.best`
    again; `selection` works out the interval of the fresh seeds anew.
    """
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert cli.main([*COMMAND.split(), str(tmp_path / "run")]) == 0
    said = capsys.readouterr()
    assert "working memory" in said.err
    assert "on fresh" in said.out
    assert counts == {
        "_check_model": 1,
        "iterate_policies": 2,  # for the optimum, and the best policy that explores
        "Experiment": 1,
        "prepare": METHODS,
        "configurations": 2 * METHODS,  # of what was typed, and of the data that it became
        "mean_interval of settings": 2 * METHODS,  # the scores on the seeds of the choice, and on fresh ones
        "mean_interval of measures": 2 * METHODS,  # returns, and episodes against steps
        "best": 3 * METHODS,  # in the end, early on, and on fresh seeds
        "score": 3 * METHODS,
        "seeds_wanted": 2 * METHODS,
    }


def test_a_model_is_known_by_the_value_of_its_environment(counts):
    """Of two that are alike it is the same; of one whose arrays were written to it is another.

    Broken once: kept by identity -> fails; by class alone -> fails.
    """
    pays = lambda reward: rl.FiniteMDP([[[0.5, 0.5]], [[0.0, 1.0]]], [[reward], [0.0]], terminal=[1])
    one, other = pays(1.0), pays(2.0)
    assert planning.value_iteration(one)[0].tolist() == [2, 0]  # v = 1 + v / 2
    assert planning.value_iteration(pays(1.0))[0].tolist() == [2, 0]
    assert counts["_check_model"] == 1
    assert planning.value_iteration(other)[0].tolist() == [4, 0]
    one.reward[0] = 3.0
    assert planning.value_iteration(one)[0].tolist() == [6, 0]
    assert counts["_check_model"] == counts["iterate_policies"] == 3


def test_what_is_kept_is_not_written_to(counts):
    """Broken once: `epsilon_soft` gives the policy that is kept -> fails."""
    env = rl.make("two-doors")
    exact = planning.exact_model(env)
    with pytest.raises(ValueError, match="read-only"):
        exact.prob[0] = 0
    policy, v, q = planning.policy_iteration(env)
    before = [x.copy() for x in (policy, v, q)]
    for x in (policy, v, q):
        x[:] = 7
    np.testing.assert_equal(planning.policy_iteration(env), before)


def test_models_that_are_too_large_are_not_kept(counts, monkeypatch):
    """The oldest go first. Broken once: all are kept -> fails."""
    walks = [rl.make("random-walk", states=n) for n in (3, 5, 7)]
    sizes = [model.memory.size(planning.exact_model(env)) for env in walks]
    monkeypatch.setattr(model, "_kept", {})
    monkeypatch.setattr(model, "KEPT_BYTES", sum(sizes[1:]))
    for env in (*walks, *walks[1:], walks[0]):
        planning.exact_model(env)
    assert counts["_check_model"] == 3 + 4
    monkeypatch.setattr(model, "KEPT_BYTES", 0)
    planning.exact_model(walks[1])
    assert not model._kept


def test_environments_that_have_no_value_to_compare_are_worked_out_anew(counts):
    """Such as one with a key of JAX in it."""

    @pytree
    class Keyed(rl.RandomWalk):
        key: object = None

    env = Keyed(key=jax.random.key(0))
    for _ in range(2):
        planning.exact_model(env)
    assert counts["_check_model"] == 2


def test_exact_values_are_kept_for_a_later_process(programs_folder, monkeypatch):
    """To the last bit, and as read-only; by the contents of its arrays. Broken once: arrays have no name -> fails."""
    env = rl.make("windy-gridworld", stochastic=True)
    solve = lambda env: jax.tree.leaves((planning.exact_model(env), planning.policy_iteration(env)))
    first = solve(env)
    model._kept.clear()
    with monkeypatch.context() as patched:
        for name in ("_check_model", "iterate_policies"):
            module = model if name == "_check_model" else optimum
            patched.setattr(module, name, lambda *_: pytest.fail("it was worked out again"))
        again = solve(env)
    for x, y in zip(first, again, strict=True):
        assert x.dtype == y.dtype and x.tobytes() == y.tobytes() and x.flags.writeable == y.flags.writeable
    assert len(list((programs_folder.parent / "exact").glob("*.program"))) == 2
    calm = rl.make("windy-gridworld", stochastic=True, wind=np.zeros(10))
    assert planning.value_iteration(calm)[0][30] != planning.value_iteration(env)[0][30]


def test_exact_values_of_others_and_large_ones_are_not_kept(programs_folder, monkeypatch):
    @pytree
    class Other(rl.RandomWalk):
        pass

    planning.value_iteration(Other())
    monkeypatch.setattr(model, "FILE_BYTES", 100)
    planning.value_iteration(rl.make("random-walk"))
    assert not list(programs_folder.parent.rglob("*.program"))
