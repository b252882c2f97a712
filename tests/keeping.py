"""For the tests of what outlives the process."""

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


@pytest.fixture(scope="module")
def unoptimised():
    """XLA compiles the programs of a file without optimising them: in two fifths of the time, but with other bits.

    `lanes` then gives these, too. What both give to a user is compared in tests/test_lanes_*.py, which do without it.
    """

    def optimise(chosen):
        forget()
        by_lanes.kernel.cache_clear()  # parts of which XLA compiled
        jax.clear_caches()
        jax.config.update("jax_disable_most_optimizations", not chosen)

    optimise(False)
    yield
    optimise(True)


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
