"""`train` within a program of somebody's own: `lanes` does the runs, and gives what XLA gives."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import NamedSharding, PartitionSpec
from lanes_tools import assert_same_bits

import jaxrl_tab as rl
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import backend, by_lanes, within
from jaxrl_tab.lanes.code import Unsupported

DOORS, WALK = rl.make("two-doors"), rl.make("random-walk", states=5)
KEYS = jax.random.split(jax.random.key(7), 70)  # more than a block of lanes


@pytest.fixture
def done(monkeypatch):
    """How many runs `lanes` has done, in each call."""
    numbers, before = [], within._done

    def noting(run, kernel, batch, *traced):
        numbers.append(batch)
        return before(run, kernel, batch, *traced)

    monkeypatch.setattr(within, "_done", noting)
    backend.tell.cache_clear()
    return numbers


def sarsa(key, alpha=0.1, env=DOORS, **options):
    return rl.train(key, rl.Sarsa(alpha=alpha), env, **{"num_steps": 20, "log_every": 10} | options)


def by_episodes(key):
    return rl.train(key, rl.ALGORITHMS["double-q-learning"](), WALK, num_episodes=3)


def both(program):
    """What a program gives by `lanes` and by XLA. It is made anew, for `jit` remembers what it has traced."""
    ours = program()()
    with backend.using("xla"):
        theirs = program()()
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    return [[np.asarray(x) for x in jax.tree.leaves(given)] for given in (ours, theirs)]


GRID = jnp.array([0.1, 0.4, 0.9])
PROGRAMS = {
    "jit": (lambda: lambda: jax.jit(lambda key: sarsa(key))(KEYS[0]), [()]),
    "jit of vmap": (lambda: lambda: jax.jit(jax.vmap(sarsa))(KEYS), [(70,)]),
    "vmap": (lambda: lambda: jax.vmap(sarsa)(KEYS), [(70,)]),
    "vmap of jit": (lambda: lambda: jax.vmap(jax.jit(lambda key: by_episodes(key)))(KEYS[:5]), [(5,)]),
    "a grid": (
        lambda: lambda: jax.jit(jax.vmap(jax.vmap(sarsa, (0, None)), (None, 0)))(KEYS[:4], GRID),
        [(3, 4)],
    ),
    "a grid by columns": (
        lambda: (
            lambda: jax.jit(jax.vmap(jax.vmap(sarsa, (None, 0)), (None, 1)))(
                KEYS[0], jnp.outer(GRID, GRID[:2])
            )
        ),
        [(2, 3)],
    ),
    "one after another": (lambda: lambda: jax.lax.map(sarsa, KEYS[:3]), [()] * 3),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", PROGRAMS)
def test_lanes_gives_what_xla_gives(name, done):
    """Broken once: axes that `vmap` puts elsewhere are not moved -> fails; batches the other way round -> fails."""
    program, batches = PROGRAMS[name]
    assert_same_bits(*both(program))
    assert done == batches


@pytest.mark.slow
def test_on_two_devices_each_does_its_own(done):
    mesh = jax.make_mesh((2,), ("devices",))
    split = PartitionSpec("devices")
    keys = jax.device_put(KEYS[:6], NamedSharding(mesh, split))

    def program():
        runs = jax.shard_map(jax.vmap(sarsa), mesh=mesh, in_specs=split, out_specs=split, check_vma=False)
        return lambda: jax.jit(runs)(keys)

    assert_same_bits(*both(program))
    assert done == [(3,)] * 2


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "program",
    [
        lambda key: jax.jit(lambda env, key: sarsa(key, env=env))(DOORS, key),
        lambda key: jax.jit(lambda key: sarsa(key, exact=True))(key),
        lambda key: jax.jit(lambda key: sarsa(key, record=lambda state: {"highest": state.q.max()}))(key),
    ],
    ids=["a traced environment", "exact values", "a record"],
)
def test_xla_does_what_a_kernel_cannot_do_there(program, done):
    """Broken once: `exact` goes to `lanes` -> a call that waits for XLA, within one."""
    with backend.using("lanes"):
        jax.block_until_ready(program(KEYS[0]))
    assert done == []


@pytest.mark.slow
def test_what_lanes_does_not_compile_xla_does_and_a_line_says_so(done, monkeypatch, caplog):
    def refuses(*_):
        raise Unsupported("not that")

    monkeypatch.setattr(by_lanes, "kernel", refuses)
    line = "Sarsa in TwoDoors is not compiled by lanes: not that"
    for program in (lambda: jax.jit(jax.vmap(sarsa)), lambda: jax.vmap(sarsa)):
        assert_same_bits(*both(lambda program=program: lambda: program()(KEYS[:3])))
        with backend.using("lanes"), pytest.raises(InputError, match=line):
            program()(KEYS[:3])
    assert done == [] and [x.getMessage() for x in caplog.records] == [f"{line}; XLA compiles it"]


ON_ONE_CORE = """
import os
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
import jax, jax.numpy as jnp
import jaxrl_tab as rl
run = jax.jit(jax.vmap(lambda key: rl.train(key, rl.Sarsa(), rl.make("two-doors"), num_steps=20)[0].q.sum()))
values = [run(jax.random.split(jax.random.key(k), 70)) @ jnp.ones((70, 300)) for k in range(50)]  # none is waited for
print(len(jax.block_until_ready(values)))
"""


def test_a_program_waits_for_python_on_one_core_too():
    """JAX warns that a callback may wait for ever where there is one thread; ours asks nothing of JAX."""
    done = subprocess.run([sys.executable, "-c", ON_ONE_CORE], capture_output=True, text=True, timeout=300)
    assert (done.stdout, done.returncode) == ("50\n", 0), done.stderr
