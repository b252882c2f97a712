"""Strict numerics, two devices, one compilation cache: set before JAX starts."""

import gc
import os
import signal
from collections import Counter
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"  # see `optimising`
os.environ["JAXRL_TAB_TRACEBACK"] = "1"  # no defect hides behind the one line that is said of it
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).parent.parent / ".pytest_cache")  # what the command keeps

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what the tests start must hear Ctrl-C

import jax

jax.config.update("jax_num_cpu_devices", 2)  # whatever the machine has: results must not depend on it

import annotations  # of the tests
import hasty
import pytest

annotations.check()
hasty.compile_hastily()

from exploring import explored  # noqa: F401  A fixture of several files.
from keeping import optimised, programs_folder, said  # noqa: F401  Fixtures of several files.

import jaxrl_tab as rl
from jaxrl_tab import cli

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_debug_key_reuse", False)
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parent.parent / ".pytest_cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# What is imported stays; and what is compiled has many small objects, among which there is little garbage.
gc.freeze()
gc.set_threshold(20_000, 20, 20)

# The files that take longest, which are begun first, so that no worker is left with one of them in the end.
LONG = (
    "ray",
    "survive",
    "lanes_same_bits",
    "examples",
    "cli",
    "traces",
    "search",
    "memory",
    "figures",
    "watch",
    "extend",
    "lanes_backend",
    "own",
    "approx",
    "lanes_covered",
    "lanes_rules",
    "stats_coverage",
    "second_start",
    "distributed",
    "slurm",
    "own_files",
    "contract",
    "provenance",
    "interop_gymnax",
    "comparing",
    "explain",
    "offline",
    "available",
    "exact",
    "policy_value",
    "record_experiment",
    "prediction",
    "going_on",
    "exact_every",
    "batch",
    "derivatives",
    "models",
    "within",
)


@pytest.fixture(autouse=True)
def drawn_here(monkeypatch):
    """Commands that run in this process have imported all that draws: another process would only take longer."""
    monkeypatch.setattr(cli, "_draws", lambda *_: False)


LEFT_OUT = "it takes long"


FURTHER = 8  # one in so many of the further cases of a test is run before anything lands


def pytest_addoption(parser):
    parser.addoption("--landing", action="store_true", help="run tests that take long, but few cases of each")
    parser.addoption("--slow", action="store_true", help="run everything, with all cases")


def pytest_configure(config):
    if config.option.slow:
        annotations.one_of, annotations.lets_go = 8, False


def pytest_collection_modifyitems(items, config):
    order = {f"test_{name}": k for k, name in enumerate(LONG)}
    items.sort(key=lambda item: order.get(item.path.stem, len(LONG)))
    if not config.option.slow:
        for item in left_out(items, config.option.landing):
            item.add_marker(pytest.mark.skip(reason=LEFT_OUT))


def left_out(items, landing):
    """What is not run: always what is for each week alone.

    By default also what is slow, and further cases; and of a test that is marked with `one_in(n)` all cases but the
    first, the one n after it, and so on. Before anything lands only the latter, and of further cases all but the
    first, the one `FURTHER` after it, and so on.
    """
    seen = Counter()
    for item in items:
        is_further, one_in = item.get_closest_marker("further"), item.get_closest_marker("one_in")
        is_slow = not landing and (is_further or item.get_closest_marker("slow"))
        if is_slow or item.get_closest_marker("weekly"):
            yield item
        elif is_further or one_in:
            test = item.path, item.originalname, bool(is_further)
            if seen[test] % (FURTHER if is_further else one_in.args[0]):
                yield item
            seen[test] += 1


def pytest_terminal_summary(terminalreporter):
    """Nobody takes the tests that were run for all that there are."""
    reasons = [report.longrepr[2] for report in terminalreporter.stats.get("skipped", ())]
    if number := sum(LEFT_OUT in reason for reason in reasons):
        terminalreporter.write_line(f"{number} tests that take long are left out; --slow runs them, too")


@pytest.fixture(scope="session")
def windy():
    return rl.make("windy-gridworld")
