"""The house rules: dependencies point one way, and importing the package stays cheap."""

import ast
import subprocess
import sys
from pathlib import Path

import jaxrl_tab

ROOT = Path(jaxrl_tab.__file__).parent
# Each module may import only from those in earlier rows (its own row only where it is a package).
LAYERS = [
    ["types"],
    ["storage", "interrupt", "provenance"],
    ["tables", "rng", "memory", "programs"],
    ["episode"],
    ["schedules"],
    ["policies"],
    ["planning"],
    ["envs", "algorithms"],
    ["prediction"],
    ["train", "bridge", "interop"],
    ["offline"],
    ["stats"],
    ["export"],
    ["axes", "importance", "batch"],
    ["results"],
    ["sweep", "describe", "executors"],
    ["experiment"],
    ["plot", "html"],
    ["figures", "report"],
    ["runner"],
    ["options"],
    ["cli"],
    ["__main__"],
]
LAYER = {name: i for i, row in enumerate(LAYERS) for name in row}


def imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("jaxrl_tab"):
            parts = node.module.split(".")
            yield from [parts[1]] if len(parts) > 1 else [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("jaxrl_tab."))


def test_dependencies_point_one_way():
    wrong = []
    for path in ROOT.rglob("*.py"):
        module = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if module == "__init__":
            continue
        for used in imports(path):
            if used in LAYER and used != module and LAYER[used] >= LAYER[module]:
                wrong.append(f"{path.relative_to(ROOT)} imports {used}")
        assert module in LAYER, f"{module} has no layer"
    assert not wrong


def test_importing_the_package_is_cheap_and_starts_nothing():
    """No plotting, no tables, no other framework; and JAX's backend is still to be configured."""
    code = (
        "import sys, jax; before = set(sys.modules); import jaxrl_tab;"
        "print(*sorted({m.split('.')[0] for m in set(sys.modules) - before}));"
        "jax.config.update('jax_num_cpu_devices', 3); print(len(jax.devices()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules, devices = done.stdout.splitlines()
    heavy = {"scipy", "xarray", "pandas", "matplotlib", "optax", "rich", "tyro", "h5py", "numba"}
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
