"""The command line as a person meets it: how long it takes until something is on the screen, and until it ends.

Each start is a fresh process. The first has empty caches, the later ones those that it has filled. The basis is a
fresh process that imports what every tool of this kind imports: JAX, pyplot, xarray and the statistics of SciPy.
JAX's own variable says where the cache is, as for any program.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.rounds import Round, Timing

SWEEP = "sweep windy-gridworld sarsa q-learning expected-sarsa"
PROGRAMS = "sweep windy-gridworld n-step-sarsa --n " + " ".join(map(str, range(1, 49)))  # 48 of them
SHORT = {
    "--help": "--help",
    "list": "list",
    "a wrong name": "sweep windy-gridwrld sarsa",
    "a value out of range": "sweep windy-gridworld sarsa --alpha 0",
    "--dry-run of 48 programs": f"{PROGRAMS} --dry-run",
}
ROOT = Path(__file__).parent.parent
SCRATCH = tempfile.TemporaryDirectory()  # of this process; each round has a folder of its own in it
# What a second start does, in its order: the line, and the function whose time it is.
PHASES = {
    "reads what is to be run": "cli.sweep:_experiment",
    "plans, compiles, computes": "experiment.runner:_results",
    "works out and shows the table": "cli.sweep:show_outcome",
    "writes results.nc": "experiment.files:_write_data",
    "writes the report": "show.report:write_methods",
    "waits for the pictures, which another process draws": "experiment.painter:_has_drawn",
}


def imports() -> Round:
    """The basis."""
    return lambda number: Timing(
        _seconds("-c", "import jax, matplotlib.pyplot, xarray, scipy.stats", cache=folder(number))
    )


def first_start() -> Round:
    """The README's sweep with empty caches, until it has ended."""
    return lambda number: Timing(_seconds(*_sweep(number, "first"), cache=folder(number)))


def second_start() -> Round:
    """To be run after the first start, which fills the caches."""
    return lambda number: Timing(_seconds(*_sweep(number, "again"), cache=folder(number)))


def table_shown() -> Round:
    """A second start, until the last line of the table is on the screen."""

    def run(number: int) -> Timing:
        begun = time.perf_counter()
        with _started(*_sweep(number, "shown"), cache=folder(number)) as process:
            assert process.stdout
            while not process.stdout.readline().startswith("└"):
                pass
            seconds = time.perf_counter() - begun
            process.stdout.read()
        return Timing(seconds)

    return run


def short(command: str) -> Round:
    """A command that computes nothing; it may be refused."""
    return lambda number: Timing(
        _seconds("-m", "jaxrl_tab", *command.split(), cache=folder(number), checked=False)
    )


def phases(number: int = 0) -> str:
    """Where the time of a second start goes, a line for each phase."""
    _seconds(*_sweep(number, "first"), cache=folder(number))
    program = (
        "import sys, time, importlib\n"
        "begun = time.perf_counter(); import jax; done = time.perf_counter()\n"
        "lines = [('imports JAX', done - begun)]; begun = done\n"
        f"phases = {PHASES!r}\n"
        "def timed(line, place):\n"
        "    module, name = place.split(':'); module = importlib.import_module('jaxrl_tab.' + module)\n"
        "    function = getattr(module, name)\n"
        "    def wrapped(*given, **named):\n"
        "        begun = time.perf_counter()\n"
        "        try: return function(*given, **named)\n"
        "        finally: lines.append((line, time.perf_counter() - begun))\n"
        "    setattr(module, name, wrapped)\n"
        "from jaxrl_tab.cli import main, sweep\n"
        "lines.append(('imports the package', time.perf_counter() - begun)); begun = time.perf_counter()\n"
        "for item in phases.items(): timed(*item)\n"
        "lines.append(('imports pandas, xarray', time.perf_counter() - begun))\n"
        "main(sys.argv[1:])\n"
        "print(*(f'{seconds:6.2f} s  {line}' for line, seconds in lines), sep='\\n', file=sys.stderr)"
    )
    command = ["-c", program, *_sweep(number, "phases")[2:]]
    with _started(*command, cache=folder(number), stderr=subprocess.PIPE) as process:
        return process.communicate()[1].rstrip()


def _sweep(number: int, out: str) -> list[str]:
    return ["-m", "jaxrl_tab", *SWEEP.split(), "--out", str(folder(number) / out)]


def _seconds(*arguments: str, cache: Path, checked: bool = True) -> float:
    """How long a fresh Python takes, from its start to its end."""
    begun = time.perf_counter()
    with _started(*arguments, cache=cache, stderr=None if checked else subprocess.DEVNULL) as process:
        process.communicate()
    if checked and process.returncode:
        raise SystemExit(f"a command of the benchmark failed: {' '.join(arguments)}")
    return time.perf_counter() - begun


def _started(*arguments: str, cache: Path, stderr: int | None = None) -> "subprocess.Popen[str]":
    variables = {"JAX_COMPILATION_CACHE_DIR": str(cache / "cache"), "COLUMNS": "160"}
    # Where Python may not keep what it compiles of the package, each start compiles it anew.
    environment = {key: x for key, x in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"} | variables
    return subprocess.Popen(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )


def folder(number: int) -> Path:
    return Path(SCRATCH.name) / str(number)
