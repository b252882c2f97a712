"""What is said of the package in several files is the same in all of them."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import jaxrl_tab as rl

ROOT = Path(__file__).parent.parent
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


def test_the_lock_file_has_all_that_is_wanted():
    lines = (ROOT / "requirements-dev.txt").read_text().splitlines()
    locked = dict(line.split("==") for line in lines if not line.startswith("#"))
    extras = PROJECT["optional-dependencies"]
    wanted = PROJECT["dependencies"] + [line for name in extras if name != "bench" for line in extras[name]]
    for requirement in map(Requirement, wanted):
        if requirement.name != "jaxrl-tab":
            assert requirement.specifier.contains(locked[requirement.name]), requirement


@pytest.mark.parametrize(
    "name", ["CITATION.cff", "CONTRIBUTING.md", "SECURITY.md", "LICENSE", "CHANGELOG.md"]
)
def test_the_archive_holds_what_people_look_for(name):
    with (ROOT / "pyproject.toml").open("rb") as file:
        included = tomllib.load(file)["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert name in included and all((ROOT / path).exists() for path in included)
