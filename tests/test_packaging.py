"""What is said of the package in several files is the same in all of them."""

import importlib
import re
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import jaxrl_tab as rl
from jaxrl_tab.lanes import versions

ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT))
readme = importlib.import_module("hatch_build").readme
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CLASSIFIED = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))


def test_the_version_is_that_of_the_installed_package():
    assert rl.__version__ == version("jaxrl-tab")
    assert "version" not in PROJECT and Version(rl.__version__)


def test_the_same_versions_of_python_are_promised_and_tested():
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    (tested,) = re.findall(r"python: \[(.*)\]", workflow)
    assert re.findall(r"[\d.]+", tested) == CLASSIFIED
    assert PROJECT["requires-python"] == f">={CLASSIFIED[0]}"
    ours = (ROOT / ".ci").iterdir()
    assert {file.name for file in ours} == set(re.findall(r"bash \.ci/(\w+)", workflow))


def requirements(*extras):
    """What is wanted, also by these extras, but for the package itself."""
    lines = PROJECT["dependencies"] + [x for name in extras for x in PROJECT["optional-dependencies"][name]]
    return [x for x in map(Requirement, lines) if x.name != "jaxrl-tab"]


def test_the_lock_file_has_all_that_is_wanted():
    lines = (ROOT / "requirements-dev.txt").read_text().splitlines()
    locked = dict(line.split("==") for line in lines if not line.startswith("#"))
    for requirement in requirements("dev", "docs", "parquet", "ray", "slurm"):
        assert requirement.specifier.contains(locked[requirement.name]), requirement


def test_all_that_is_wanted_has_a_lowest_version():
    """Which `.ci/lowest` installs: without one it takes the first that there ever was."""
    for requirement in requirements(*PROJECT["optional-dependencies"]):
        assert any(x.operator == ">=" for x in requirement.specifier), requirement


def test_the_newest_jax_that_is_known_is_no_older_than_that_of_the_lock_file():
    (locked,) = re.findall(r"^jax==(\d+)\.(\d+)", (ROOT / "requirements-dev.txt").read_text(), re.MULTILINE)
    assert tuple(map(int, locked)) <= versions.NEWEST


@pytest.mark.parametrize(
    "name", ["CITATION.cff", "CONTRIBUTING.md", "SECURITY.md", "LICENSE", "CHANGELOG.md"]
)
def test_the_archive_holds_what_people_look_for(name):
    with (ROOT / "pyproject.toml").open("rb") as file:
        included = tomllib.load(file)["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert name in included and all((ROOT / path).exists() for path in included)


def test_links_of_the_readme_lead_to_the_repository_once_it_has_an_address():
    """Broken once, each: pictures as pages; links within it as well -> fails."""
    text = "![A x](docs/a.png) [b](docs/b.md#c) [d](https://e.org/f) [g](#g)"
    assert readme(text, None) == text
    assert readme(text, "https://e.org/us/it/") == (
        "![A x](https://e.org/us/it/raw/HEAD/docs/a.png) [b](https://e.org/us/it/blob/HEAD/docs/b.md#c) "
        "[d](https://e.org/f) [g](#g)"
    )
    whole = readme((ROOT / "README.md").read_text(), "https://e.org/us/it")
    assert not re.findall(
        r"\]\((?!https:|#)[^)]*\)", re.sub(r"```.*?```|`[^`]*`", "", whole, flags=re.DOTALL)
    )
