"""For the tests of what outlives the process."""

import contextlib
import os

import jax
import pytest

from jaxrl_tab.engine import by_lanes, by_xla, programs, room
from jaxrl_tab.exact import model


def forget():
    """As a new process would."""
    for cached in (room.traced_program, by_xla._compiled, by_lanes.kernel):
        cached.cache_clear()
    model._kept.clear()
    look_again()


def look_again():
    """As a new process would at the folder and its key; and what was said may be said again."""
    for cached in (programs._is_usable, programs._key, programs._warn):
        cached.cache_clear()


def kept_in(folder):
    """The files in it, without the key."""
    return [file for file in folder.iterdir() if file.name != "key"]


def thing(name="a", value=b"compiled" * 20):
    """What is kept under a name; or `None`, where it was there already."""
    made = []
    found = programs.kept(name, lambda: made.append(value) or value, pack=lambda x: x, unpack=lambda x: x)
    assert found == value
    return value if made else None


def plant(file, data):
    """Puts it there as if it had been written here: with the key."""
    programs._write(file, (file.parent / "key").read_bytes(), data)


@contextlib.contextmanager
def optimising():
    """XLA optimises what it compiles, as for a user: in tests it does not, for that takes more than twice as long.

    Where it does not, it rounds a product before it adds it to something, and so does `lanes`.
    """

    def optimise(chosen):
        forget()
        jax.clear_caches()
        jax.config.update("jax_disable_most_optimizations", not chosen)
        os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(not chosen))  # for other processes

    optimise(True)
    try:
        yield
    finally:
        optimise(False)


@pytest.fixture(scope="module")
def optimised():
    """For files that compare to the last bit what different programs give, or ask what is compiled."""
    with optimising():
        yield


@pytest.fixture
def programs_folder(tmp_path, monkeypatch):
    """Where programs are kept in a test; it is made when something is."""
    monkeypatch.setattr(programs, "_folder", None)  # and back again after the test
    programs.keep(tmp_path)
    forget()
    yield tmp_path / "programs"
    forget()


@pytest.fixture
def said(caplog):
    """The lines that were said since this was last called, each of which is said once in a process."""

    def lines():
        found = [record.getMessage() for record in caplog.records]
        caplog.clear()
        programs._warn.cache_clear()
        return found

    return lines
