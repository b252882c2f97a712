"""The package where gymnax and Gymnasium are missing, or break when they are imported."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import jaxrl_tab

CODE = """
import sys
for name in ("gymnax", "gymnasium", "flax"):
    sys.modules[name] = None

import jaxrl_tab as rl
from jaxrl_tab.cli import main

assert main(["list"]) == 0
assert main(["solve", "two-doors"]) == 0
assert main(["sweep", "two-doors", "sarsa", "--alpha", "0.5", "--seeds", "2", "--steps", "20"]) == 0
assert rl.sweep(rl.make("two-doors"), "sarsa", {"alpha": [0.5]}, num_seeds=2, num_steps=20)

def message(call):
    try:
        call()
    except rl.InputError as error:
        print("REFUSED", error)

message(lambda: rl.interop.from_gymnax("FrozenLake-misc"))
message(lambda: rl.interop.to_gymnax(rl.make("two-doors")))
message(lambda: rl.interop.from_gymnasium("FrozenLake-v1"))
message(lambda: rl.interop.make("gymnasium:FrozenLake-v1"))

del sys.modules["gymnax"]
sys.path.insert(0, sys.argv[1])  # where gymnax.py is broken
message(lambda: rl.interop.make("gymnax:FrozenLake-misc"))
"""


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    folder = tmp_path_factory.mktemp("broken")
    (folder / "gymnax.py").write_text("import jax\njax.what_was_there_once\n")
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(folder)], capture_output=True, text=True, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_all_else_works_without_them(lines):
    """Broken once: gymnasium imported at the top of envs/blackjack.py -> fails."""
    text = "\n".join(lines)
    assert "two-doors" in text and "mean return" in text


@pytest.mark.slow
def test_what_needs_them_says_in_one_line_what_to_install(lines):
    """Broken once: `ModuleNotFoundError` alone caught -> fails."""
    missing = (
        "cannot be imported (import of {} halted; None in sys.modules); python -m pip install --upgrade {}"
    )
    gymnax = f"REFUSED gymnax {missing.format('gymnax', 'gymnax six')}"
    gymnasium = f"REFUSED gymnasium {missing.format('gymnasium', 'gymnasium')}"
    broken = (
        "REFUSED gymnax cannot be imported (module 'jax' has no attribute 'what_was_there_once'); "
        "python -m pip install --upgrade gymnax six"
    )
    assert [line for line in lines if "REFUSED" in line] == [gymnax, gymnax, gymnasium, gymnasium, broken]


def test_nothing_outside_interop_imports_them():
    """Also within functions. Broken once: gymnasium imported in a method of envs/blackjack.py -> fails."""
    root = Path(jaxrl_tab.__file__).parent
    for path in {*root.rglob("*.py")} - {*(root / "interop").rglob("*.py")}:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [x.name for x in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & {"gymnax", "gymnasium", "flax"}, path
