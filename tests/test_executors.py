"""Executors: what is the same for all of them, and the one in this process."""

import functools
import platform
from contextvars import ContextVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shards

from jaxrl_tab import executors
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.engine import backend, provenance
from jaxrl_tab.experiment.executors import base


def test_local_gives_what_work_gives_one_at_a_time(tmp_path):
    given = executors.get("local").run(functools.partial(shards.begun, folder=tmp_path), [3, 1, 2])
    assert next(given)[0] == 3
    assert shards.times(1, tmp_path) == 0  # it is not asked for yet
    assert [task for task, _ in given] == [1, 2]


def test_local_lets_errors_through(tmp_path):
    with pytest.raises(ValueError, match=r"no such thing"):
        dict(executors.Local().run(functools.partial(shards.fails, folder=tmp_path), [0, 1]))


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("rays", {}, "no executor is called 'rays'; did you mean 'ray'"),
        ("local", {"cores": 2}, "local has no parameter 'cores'"),
        ("ray", {"adress": "10.0.0.1:6379"}, "did you mean 'address'"),
    ],
)
def test_what_is_not_there_is_refused(name, options, said):
    with pytest.raises(InputError, match=said):
        executors.get(name, **options)


@pytest.mark.parametrize(
    ("name", "package", "options"), [("ray", "ray", {}), ("slurm", "submitit", {"folder": "x"})]
)
def test_a_missing_package_is_named_with_its_extra(monkeypatch, name, package, options):
    monkeypatch.setattr(base.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=rf"{package} is not installed: pip install 'jaxrl-tab\[{name}\]'"):
        executors.get(name, **options)


@pytest.fixture(autouse=True)
def preferred_as_before(monkeypatch):
    """A job prefers the backend of those who sent it for good: no other test is to have it."""
    monkeypatch.setattr(backend, "_preferred", ContextVar("preferred backend", default=None))


def test_a_job_does_the_work_and_returns_its_errors(tmp_path):
    job = base.Job.of(functools.partial(shards.fails, folder=tmp_path))
    assert base.result_of(3, job(3)) == (3, {"square": np.array(9)})
    with pytest.raises(RunError, match=r"(?m)^shard 1 failed: ValueError: no such thing$") as raised:
        base.result_of(1, job(1))
    assert "in fails" in str(raised.value.__cause__)  # where it happened


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("jax", "0.9.0", f"jax was 0.9.0, and is {jax.__version__} there"),
        ("digest of jaxrl_tab's sources", "abc", "sources was abc, and is"),
        ("XLA_FLAGS", "--xla_cpu_max_isa=AVX2", "XLA_FLAGS was --xla_cpu_max_isa=AVX2, and is"),
        ("instruction set", "x86_64 avx9", "instruction set was "),
    ],
)
def test_a_job_refuses_to_compute_other_numbers(name, value, said):
    """Where the driver has something else: in one line with the name of this machine, before any work."""
    job = base.Job.of(lambda _: pytest.fail("it was begun"))
    result = job._replace(surroundings=job.surroundings | {name: value})(0)
    with pytest.raises(InputError, match=f"^{platform.node()} would not compute as .*{said}"):
        base.result_of(0, result)


def test_a_job_sets_what_can_be_set():
    job = base.Job.of(lambda _: {"x": jnp.ones(2) / 3})
    with jax.enable_x64(True):
        other = base.Job.of(job.work)
    with provenance.using(provenance.settings()):  # and back again after the test
        assert other(0)["x"].dtype == np.float64
        assert job(0)["x"].dtype == np.float32
