"""Help and refusals before JAX is imported: from the catalogue, in the same words as with the classes at hand."""

import json
import random
import subprocess
import sys

import pytest
from test_cli import REFUSALS
from test_fuzz import idle, run, some_words  # noqa: F401  A fixture.

import jaxrl_tab as rl
from jaxrl_tab.cli import catalogue, front
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import GYMNASIUM

AGAIN = "make it again: python -m jaxrl_tab.cli.catalogue"


def test_the_catalogue_is_that_of_the_classes():
    """In a process of its own, where no other test has added anything."""
    code = (
        "import json; from jaxrl_tab.cli import catalogue as c;"
        "kept = json.loads(c.FILE.read_text(encoding='utf-8'));"
        "now = json.loads(json.dumps(c.to_data(c.live()._replace(unavailable=()))));"
        "print(json.dumps([kept['catalogue'] == now, kept['sources'] == c.checksum(),"
        " c.to_data(c._from_data(now)) == c.to_data(c.live()._replace(unavailable=()))]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    same, current, read = json.loads(done.stdout)
    assert same and current, AGAIN
    assert read


@pytest.fixture
def first(monkeypatch):
    """What the front says of what is typed, as in a process that has imported nothing; None where it says nothing."""
    data = json.loads(catalogue.FILE.read_text(encoding="utf-8"))
    kept = catalogue._from_data(data["catalogue"])

    def refusal(words):
        with monkeypatch.context() as patch:
            patch.setattr(front, "current", lambda: kept)
            try:
                front.answer(words[0], words[1:])
            except InputError as error:
                return f"jaxrl-tab: {error}"
            except SystemExit:
                return "help"
        return None

    return refusal


def of_the_command(words):
    """What the command says, in a process where the front says nothing."""
    assert catalogue.current() is None
    try:
        run(words)
    except InputError as error:
        return str(error)
    return "help" if {"-h", "--help"} & set(words) else None


# What needs more than a look at each word: the rest is refused at once.
LATER = (
    *(
        "resume",
        "figure",
        "explain",
        "explain nowhere",
        "compare",
        "compare runs",
        "sweep windy-gridworld sarsa --executor slurm",
        "list --jsn",
        "list --json=1",
        "list sara",
        "list --out x",
        "list --backups two-doors",
        "bridge --alpha 0.1",
        "bridge --steps 10",
        "bridge windy-gridworld n-step-sarsa",
        "random-walk td --v0 0 1",
        "moments random-walk td-lambda",
        "moments random-walk monte-carlo-prediction",
        "k-armed-testbed td --alpha 0.1",
    ),
    *(
        "memory",
        "--formats",
        "--wind 0 1",
        "--shape 7",
        "--states 4",
        "sarsa sarsa",
        "0.10",
        "glie",
        "small",
        "nowhere",
    ),
    *("--steps 10 --episodes 10", "--behaviour", "--offline", "--slurm y", "td sarsa", "swep", "xyzzy"),
)


@pytest.mark.parametrize("command", [*REFUSALS, *(f"solve {name}" for name in GYMNASIUM)])
def test_refusals_are_in_the_same_words(command, first, idle, capsys):  # noqa: F811
    """Broken once: `check_words` calls the option and not the parameter by its name -> fails."""
    words = command.split()
    if words[0] not in catalogue.COMMANDS:
        return
    said = first(words)
    assert said in (None, of_the_command(words))
    of_schedules = words[0] == "schedule"  # of which the front knows nothing
    plain = not of_schedules and not any(
        command == later or later in command.split(" ", 1)[-1] for later in LATER
    )
    if command in REFUSALS and plain:
        assert said, "it is refused only after a second"


@pytest.mark.parametrize(
    "command",
    [
        "solve windy-gridworld --gamma 0 --epsilon 1",
        "sweep windy-gridworld sarsa q-learning --alpha 1e-3 7 glie --epsilon 0 1 --gamma 1 --q0 -1e5",
        "sweep windy-gridworld sarsa-lambda --lam 0 1 --trace dutch --moves king --wind 0 0 0 1 1 1 2 2 1 0",
        "sweep blackjack monte-carlo --seeds 2147483647 --log_every=1 --alpha sample-average",
        "sweep random-walk td --left-reward -1 --states 5",
        "resume nowhere --executor ray --num-cpus 1",
        "bridge",
        "bridge --steps 10 --json",
        "schedule glie 0.1 --json",
        "bridge random-walk td --alpha 0.5",
        "moments random-walk td-lambda --offline --lam 0 0.5 --alpha 0.1 0.2",
    ],
)
def test_what_is_right_goes_on(command, first):
    """At the limits as well. Broken once: "at most" checked as "less than" -> fails."""
    assert first(command.split()) is None


def test_whatever_is_typed_the_front_says_what_the_command_says(first, idle):  # noqa: F811
    """Or nothing; of several mistakes it may name another one."""
    draw, refused = random.Random(5), 0
    for _ in range(300):
        words = some_words(draw)
        if words[0] in catalogue.COMMANDS and first(words):
            refused += 1
            assert of_the_command(words), words
    assert refused > 100


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("--help", 0),
        ("--version", 0),
        ("list", 0),
        ("list --json", 0),
        ("list q-learning", 0),
        ("list --backups", 0),
        ("bridge --help", 0),
        ("schedule --help", 0),
        ("sweep --help", 0),
        ("swep", 2),
        ("sweep windy-gridwrld sarsa", 2),
        ("sweep windy-gridworld sara", 2),
        ("sweep windy-gridworld sarsa --alpha 0", 2),
        ("solve windy-gridworld --gamma 1.5", 2),
        ("figure windy", 2),
        ("list sara", 2),
        ("bridge windy-gridworld sara", 2),
    ],
)
def test_nothing_slow_is_imported_for_it(words, code):
    """Broken once: `cli.streams` imports NumPy -> fails."""
    slow = "{'jax', 'numpy', 'scipy', 'pandas', 'xarray', 'matplotlib'}"
    program = (
        "import sys, jaxrl_tab.cli\n"
        "try: code = jaxrl_tab.cli.main(sys.argv[1:])\n"
        "except SystemExit as stop: code = stop.code\n"
        f"assert not {slow} & set(sys.modules), sorted({slow} & set(sys.modules)); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", program, *words.split()], capture_output=True, text=True)
    assert done.returncode == code, done.stderr


@pytest.mark.slow
def test_without_pictures_matplotlib_is_not_imported(tmp_path):
    """The report needs none. Broken once: `write_files` imports `show.plot` always -> fails."""
    program = (
        "import sys; from jaxrl_tab.cli import main;"
        "code = main(sys.argv[1:]); assert 'matplotlib' not in sys.modules; sys.exit(code)"
    )
    words = "sweep windy-gridworld sarsa --seeds 2 --steps 100 --no-pictures --quiet --out run"
    done = subprocess.run(
        [sys.executable, "-c", program, *words.split()], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "report.html").exists()


def test_where_the_sources_are_others_the_classes_decide(monkeypatch, tmp_path):
    """Or where the file is damaged, or classes were imported, and perhaps registered, already."""
    monkeypatch.delitem(sys.modules, "jaxrl_tab.envs")
    read = catalogue.current.__wrapped__
    assert read() is not None, AGAIN
    monkeypatch.setattr(catalogue, "FILE", tmp_path / "catalogue.json")
    assert read() is None  # there is none
    for damaged in ("", "[]", "{}", '{"sources": 1, "catalogue": {}}', "\0"):
        catalogue.FILE.write_text(damaged)
        assert read() is None
    monkeypatch.undo()
    assert read() is None  # classes are imported
    monkeypatch.delitem(sys.modules, "jaxrl_tab.envs")
    monkeypatch.setattr(catalogue, "checksum", lambda: "another")
    assert read() is None


def test_the_package_is_imported_when_it_is_used():
    """Broken once: `from jaxrl_tab import envs` in `jaxrl_tab/__init__.py` -> fails."""
    code = (
        "import sys, os, jaxrl_tab as rl; assert not {'jax', 'numpy'} & set(sys.modules);"
        "assert 'xla_cpu_small_while_loop_byte_threshold' in os.environ['XLA_FLAGS'];"
        "from jaxrl_tab import *; print(callable(sweep), callable(rl.Sarsa), rl.ENVS is ENVS)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"] * 3
    assert not hasattr(rl, "nothing")
    with pytest.raises(AttributeError, match="module 'jaxrl_tab' has no attribute 'nothing'"):
        _ = rl.nothing
