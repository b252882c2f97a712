"""Jobs of submitit: its processes of this machine, and an array, as a stand-in for `sbatch` runs it."""

import functools
import os
import stat
from pathlib import Path

import jax
import pytest
import shards
import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import executors
from jaxrl_tab.core.errors import InputError, RunError

submitit = pytest.importorskip("submitit")

# Runs the jobs of an array one after another. `srun` runs what it is given, without its own options.
SBATCH = """#!/usr/bin/env bash
echo "Submitted batch job 7"
last=$(sed -n 's/^#SBATCH --array=0-\\([0-9]*\\)%.*/\\1/p' "$1")
(
for i in $(seq 0 "$last"); do
    SLURM_JOB_ID=7$i SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_ID=$i bash "$1" > "$0.out" 2>&1
done
) < /dev/null > /dev/null 2>&1 &
"""
SRUN = """#!/usr/bin/env bash
while [[ $1 == -* ]]; do
    case $1 in --output | --error) shift 2 ;; *) shift ;; esac
done
exec "$@"
"""


@pytest.fixture(autouse=True)
def surroundings(monkeypatch):
    """Jobs find `shards`, and the cache of the tests; one that died is seen to have given nothing at once."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent), prepend=os.pathsep)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
    monkeypatch.setattr(submitit.Job, "_results_timeout_s", 0)


@pytest.mark.slow
def test_a_job_that_dies_is_handed_in_again_with_what_it_had_not_finished(tmp_path):
    """Broken once: all of its shards once more -> shard 3 is computed twice."""
    noted = tmp_path / "noted"
    noted.mkdir()
    executor = executors.get("slurm", folder=tmp_path / "jobs", cluster="local", max_jobs=2)
    given = dict(executor.run(functools.partial(shards.dies, folder=noted, deaths=1), [0, 3, 2, 1]))
    assert {task: int(x["square"]) for task, x in given.items()} == {0: 0, 1: 1, 2: 4, 3: 9}
    assert [shards.times(task, noted) for task in range(4)] == [1, 2, 1, 1]


def test_a_job_that_always_dies_is_given_up_and_what_it_said_stays(tmp_path):
    work = functools.partial(shards.dies, folder=tmp_path, deaths=9)
    executor = executors.Slurm(tmp_path / "jobs", cluster="local", max_retries=0)
    with pytest.raises(
        RunError, match=r"the job of shards 1 died 1 times: what it said is in (.*)"
    ) as raised:
        list(executor.run(work, [1]))
    assert Path(str(raised.value).rpartition(" ")[2]).exists()


def test_an_error_is_raised_after_what_came_before_it(tmp_path):
    given = executors.Slurm(tmp_path / "jobs", cluster="local", max_jobs=1).run(
        functools.partial(shards.fails, folder=tmp_path), [0, 1, 2]
    )
    assert next(given)[0] == 0
    with pytest.raises(RunError, match=r"(?m)^shard 1 failed: ValueError: no such thing$"):
        next(given)
    assert shards.times(2, tmp_path) == 0
    assert not (tmp_path / "jobs").exists()


@pytest.mark.slow
def test_what_is_under_way_is_given_up(tmp_path):
    work = functools.partial(shards.waits, folder=tmp_path, wait=[0])
    executor = executors.Slurm(tmp_path / "jobs", cluster="local", max_jobs=2)
    given = executor.run(work, [0, 1])
    assert next(given)[0] == 1
    given.close()
    assert shards.ended(shards.the_process(tmp_path, 0))
    assert not (tmp_path / "jobs").exists()


@pytest.mark.slow
def test_what_was_begun_here_grows_and_is_decided_by_arrays_to_the_last_bit(tmp_path, monkeypatch):
    """Broken once: a job does the shards of another -> fails."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in {"sbatch": SBATCH, "srun": SRUN, "sacct": "#!/bin/sh\n"}.items():
        (programs / name).write_text(text)
        (programs / name).chmod(stat.S_IRWXU)
    monkeypatch.setenv("PATH", str(programs), prepend=os.pathsep)
    executor = executors.get(
        "slurm", folder=tmp_path / "jobs", max_jobs=2, parameters={"slurm_partition": "long"}
    )
    methods = ["sarsa", {"name": "sarsa", "label": "careless", "epsilon": 0.9}]
    small = rl.Experiment("windy-gridworld", methods, seeds=6, steps=400)
    larger = small.data() | {"seeds": 8, "until_decided": {"difference": 0.5, "most_seeds": 8}}
    rl.run(small, tmp_path / "run", formats=())
    found = rl.resume(tmp_path / "run", experiment=rl.Experiment(**larger), executor=executor, formats=())
    expected = rl.run(rl.Experiment(**larger))
    assert str(found.verdicts) == str(expected.verdicts) and found.fresh
    for name in expected.datasets:
        xr.testing.assert_equal(found.datasets[name], expected.datasets[name])
        xr.testing.assert_equal(found.fresh[name], expected.fresh[name])


def test_what_slurm_does_not_have_is_refused(tmp_path):
    with pytest.raises(InputError, match='slurm: Could not detect "srun"'):
        executors.get("slurm", folder=tmp_path)
    with pytest.raises(InputError, match="slurm: Unknown argument 'queue' for executor 'slurm'"):
        executors.get("slurm", folder=tmp_path, cluster="local", parameters={"slurm_queue": "long"})
    assert not list(tmp_path.iterdir())
