"""Compiled programs that outlive the process: found again, never taken for another, not missed."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import batch, programs
from jaxrl_tab.types import pytree

BUDGET = {"num_steps": 40, "log_every": 20}


@pytree
class Stranger(rl.QLearning):
    """A method whose code is not in the package."""


def forget():
    """As a new process would."""
    for cached in (batch._needs, batch._traced, batch._compiled):
        cached.cache_clear()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", None)  # and back again after the test
    programs.keep(tmp_path)
    forget()
    yield tmp_path / "programs"
    forget()


def swept(method="q-learning", **grid):
    return rl.sweep(rl.make("random-walk"), method, {"epsilon": 0.25} | grid, num_seeds=3, **BUDGET)


def test_a_second_process_neither_traces_nor_compiles_and_has_the_same_bits(folder, monkeypatch):
    """Also with other values of the hyperparameters, which are no part of the program. Broken once: a name

    without the budget finds a program with other shapes.
    """
    first = swept(alpha=[0.5, 0.25])
    assert len(list(folder.iterdir())) == 2  # what it needs, and the program
    forget()
    with monkeypatch.context() as patched:
        patched.setattr(batch, "_traced", lambda *_: pytest.fail("it was traced"))
        again = swept(alpha=[0.5, 0.75])
    np.testing.assert_array_equal(first.q[0], again.q[0])
    np.testing.assert_array_equal(first.log.rewards[0], again.log.rewards[0])
    assert (first.q[1] != again.q[1]).any()
    other = rl.sweep(rl.make("random-walk"), "q-learning", num_seeds=3, num_steps=60, log_every=20)
    assert other.log.steps.shape == (3, 3)
    assert len(list(folder.iterdir())) == 4


def test_what_jax_itself_kept_is_not_written_down_again(folder):
    """The same program was compiled before without `keep`, and JAX has it in its own cache. Broken once:

    under one name for both, what is found a third time cannot be called.
    """
    programs._folder = None
    first = swept()
    for _ in range(2):
        forget()
        programs._folder = folder
        np.testing.assert_array_equal(swept().q, first.q)


def test_a_damaged_file_is_not_missed(folder):
    first = swept()
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[:100])
    forget()
    np.testing.assert_array_equal(swept().q, first.q)
    assert all(len(file.read_bytes()) > 100 for file in folder.iterdir())  # written anew


def test_the_code_of_others_may_change_so_its_programs_are_not_kept(folder):
    swept(Stranger)
    record = {"record": lambda state: {"largest": jnp.max(state.q)}}
    rl.sweep(rl.make("random-walk"), "q-learning", num_seeds=2, **BUDGET, **record)
    assert not folder.exists()


def test_settings_and_sources_are_part_of_the_name(folder, monkeypatch):
    name = programs._file("a")
    assert name == programs._file("a") != programs._file("b")
    monkeypatch.setenv("XLA_FLAGS", "--xla_another=1")
    assert programs._file("a") != name
    monkeypatch.undo()
    monkeypatch.setattr(programs, "_code_and_machine", lambda: b"another version")
    monkeypatch.setattr(programs, "_folder", folder)
    assert programs._file("a").parent == folder and programs._file("a") != name


def test_the_oldest_go(folder, monkeypatch):
    monkeypatch.setattr(programs, "AT_MOST", 2)
    for i in range(4):
        programs.kept(i, lambda _: 0, pack=lambda x: x, unpack=lambda x: x)
    assert len(list(folder.iterdir())) == 2


def test_where_nobody_asked_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", None)
    assert programs._file("a") is None
