"""The house rules: dependencies point one way, and importing the package stays cheap."""

import ast
import graphlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jaxrl_tab

ROOT = Path(jaxrl_tab.__file__).parent
# From the ground up. A wing may import from itself, from the floors below, and from those of its own floor
# that are named before it.
FLOORS = [
    ["core"],
    ["lanes"],
    ["exact", "envs", "stats"],
    ["algorithms", "approx", "interop", "methods", "show"],
    ["engine"],
    ["experiment", "figures", "course"],
    ["api"],
    ["__init__"],
    ["cli"],
    ["__main__"],
]
WINGS = [wing for floor in FLOORS for wing in floor]


def imports(path):
    """The modules of this package that a file imports, also within functions: their names, without the package."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "jaxrl_tab":
            parts = node.module.split(".")[1:]
            yield from [".".join(parts)] if parts else [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [a.name.split(".") for a in node.names]
            yield from (".".join(parts[1:]) or "__init__" for parts in names if parts[0] == "jaxrl_tab")


def test_imports_go_down_the_floors_only():
    wrong = []
    for path in ROOT.rglob("*.py"):
        wing = path.relative_to(ROOT).parts[0].removesuffix(".py")
        assert wing in WINGS, f"{wing} is on no floor"
        for used in imports(path):
            other = used.split(".")[0]
            if WINGS.index(other) > WINGS.index(wing):
                wrong.append(f"{path.relative_to(ROOT)} imports {used}")
    assert not wrong


def modules():
    """name -> the modules that it imports when it is imported itself: functions may import later."""
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in ROOT.rglob("*.py")}
    paths = {name.removesuffix(".__init__"): path for name, path in paths.items()}
    for name, path in paths.items():
        used = set()
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxrl_tab."):
                module = node.module.removeprefix("jaxrl_tab.")
                used |= {m if (m := f"{module}.{a.name}") in paths else module for a in node.names}
        yield name, used - {name}


def test_no_private_name_of_jax_is_used():
    """Those that are public, and may change nevertheless, are in docs/design.md, with what guards them."""
    for file in ROOT.rglob("*.py"):
        assert not re.search(r"\bjax(lib)?\.(\w+\.)*_[a-z]", file.read_text()), file


def test_no_modules_import_each_other_in_a_circle():
    """Broken once: `core.schedules` imports `core.policies`, which imports it -> fails."""
    graph = dict(modules())
    list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError, which names the circle


def test_no_file_is_long():
    """A file is what one can hold in one's head."""
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text().splitlines()) for path in ROOT.rglob("*.py")
    }
    assert not {name for name, lines in lengths.items() if lines > 470}


@pytest.mark.parametrize("wing", ["core", "lanes", "exact", "engine", "show", "experiment", "course"])
def test_a_wing_says_what_each_of_its_modules_is_for(wing):
    """Those that show no names of their own. Broken once: a module more, in `engine` -> fails."""
    described = re.findall(r"^ {4}(\w+) ", (ROOT / wing / "__init__.py").read_text(), re.MULTILINE)
    modules = {m.name for m in pkgutil.iter_modules([str(ROOT / wing)])}
    assert len(described) == len(modules)
    assert set(described) == modules


def test_importing_the_package_is_cheap_and_starts_nothing():
    """No plotting, no tables, no other framework; and JAX's backend is still to be configured."""
    code = (
        "import sys, jax; before = set(sys.modules); import jaxrl_tab;"
        "print(*sorted({m.split('.')[0] for m in set(sys.modules) - before}));"
        "jax.config.update('jax_num_cpu_devices', 3); print(len(jax.devices()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules, devices = done.stdout.splitlines()
    heavy = {"scipy", "xarray", "pandas", "matplotlib", "optax", "rich", "h5py", "numba"}
    assert not (heavy | {"gymnax", "gymnasium", "flax"}) & set(modules.split())
    assert devices == "3"


def test_what_takes_long_to_import_is_there_when_it_is_used():
    code = (
        "import sys, jaxrl_tab as rl; assert 'jaxrl_tab.stats' not in sys.modules;"
        "print(callable(rl.stats.best), callable(rl.plot.overview), callable(rl.export.load),"
        " callable(rl.report.write), hasattr(rl.figures, 'FIGURES'), hasattr(rl, 'nothing'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"] * 5 + ["False"]


def test_tab_completion_shows_public_names_alone():
    """Also what is loaded when it is first used. Broken once: without `__dir__` in `stats.export` -> fails."""
    assert {"stats", "plot", "figures", "export", "report", "sweep", "Sarsa", "register"} <= set(
        dir(jaxrl_tab)
    )
    for name in ("stats", "plot", "figures", "export", "report"):
        module = getattr(jaxrl_tab, name)
        assert dir(module) == sorted(module.__all__)
        assert all(hasattr(module, public) for public in dir(module))
    assert not {"np", "Any", "importlib"} & set(dir(jaxrl_tab))
