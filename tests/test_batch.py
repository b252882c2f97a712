"""A result depends on (seed, hyperparameters) alone, to the last bit."""

import itertools
import os
import subprocess
import sys

import batches
import jax
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab.engine import backend
from jaxrl_tab.engine.budget import Budget

BUDGET = Budget(num_steps=500, num_episodes=None, log_every=100, exact=False)
ALPHAS = np.array([0.1, 0.3, 0.7, 1.0], np.float32)  # not dyadic: any other rounding would show


def many(seeds, kind, devices=None):
    """Run i has seed seeds[i] and a step size that goes with it; `kind` is the method, and what compiles it."""
    (method, compiled_by), n = kind, len(seeds)
    full = lambda x: np.full(n, x, np.float32)
    algorithms = method(alpha=ALPHAS[seeds % 4], epsilon=full(0.1), gamma=full(0.9), q0=full(0))
    with backend.using(compiled_by):
        return batches.run(rl.WindyGridworld(), algorithms, seeds, BUDGET, devices=devices)


KINDS = list(itertools.product([rl.Sarsa, rl.ExpectedSarsa], ["lanes", "xla"]))


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: f"{kind[0].__name__} by {kind[1]}")
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def all_runs(kind):
    return many(np.arange(500), kind)


def same(got, want, of):
    for x, y in zip(jax.tree.leaves(got), jax.tree.leaves(want), strict=True):
        np.testing.assert_array_equal(x, y[of])


@pytest.mark.one_in(2)
@pytest.mark.parametrize("size", [1, 2, 64, 129])
def test_in_a_batch_of_any_size(all_runs, kind, size):
    seeds = np.arange(size) + 7
    same(many(seeds, kind), all_runs, seeds)


def test_in_any_order(all_runs, kind):
    """Broken once: keys from a run's place in the batch instead of its seed -> fails, as does any size."""
    seeds = np.random.default_rng(0).permutation(500)
    same(many(seeds, kind), all_runs, seeds)


def test_results_stand_at_the_number_of_the_run_and_not_at_the_value_of_its_seed(all_runs, kind):
    """Seeds not counted from 0, one of them twice. Broken once: results in the order of seeds -> fails."""
    seeds = np.array([401, 7, 401, 130])
    same(many(seeds, kind), all_runs, seeds)


def test_on_one_device_and_on_two(all_runs, kind):
    """Or in one thread and in two."""
    assert len(jax.devices()) == 2
    seeds = np.arange(100)
    same(many(seeds, kind, devices=jax.devices()[1:]), all_runs, seeds)


def test_runs_differ(all_runs):
    assert len(np.unique(all_runs[0][::4], axis=0)) == 125


def test_progress_ends_with_all_runs():
    seen = []
    algorithms = rl.Sarsa(*(np.full(300, x, np.float32) for x in (0.5, 0.1, 1, 0)))
    batches.run(rl.WindyGridworld(), algorithms, np.arange(300), BUDGET, progress=seen.append)
    assert seen == sorted(set(seen)) and seen[-1] == 300


def python(code, **env):
    """Runs `code` in a process of its own, where JAX has not started."""
    env = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAXRL_TAB_XLA")} | env
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    return done.stdout.split("\n")[:-1]


@pytest.mark.slow
def test_flags_and_devices_are_set_before_jax_starts_and_never_over_the_users():
    show = "import os, jax, jaxrl_tab as rl; print(os.environ.get('XLA_FLAGS')); "
    devices = "print(rl.use_all_cores(), len(jax.devices()) == len(os.sched_getaffinity(0)))"
    flag = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold="
    assert python(show + devices) == [f"{flag}16777216", "True True"]
    assert python(show, XLA_FLAGS=f"{flag}5") == [f"{flag}5"]
    assert python(show, JAXRL_TAB_XLA="0") == ["None"]
    late = (
        "import warnings, os, jax; jax.numpy.zeros(1).block_until_ready(); warnings.simplefilter('error')\n"
        "try: import jaxrl_tab\nexcept UserWarning as w: print(w, 'XLA_FLAGS' in os.environ)"
    )
    (line,) = python(late)
    assert line.startswith("JAX had computed something before jaxrl_tab was imported") and line.endswith(
        "False"
    )
    started = "jax.numpy.zeros(1).block_until_ready(); print(rl.use_all_cores())"
    assert python(show + started, XLA_FLAGS="--xla_cpu_enable_fast_math=false") == [
        f"--xla_cpu_enable_fast_math=false {flag}16777216",
        "False",
    ]
