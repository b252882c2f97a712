"""docs/why.md is true: what it shows is what its scripts print."""

import re
import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("optimised")  # the numbers of the page are those of a user

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs/why.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def test_the_page_shows_what_the_script_prints(capsys):
    """Words are the same; numbers may differ a little on another processor."""
    runpy.run_path(str(ROOT / "examples/why.py"))
    printed, shown = capsys.readouterr().out, "\n".join(blocks("text"))
    assert NUMBER.sub("N", printed).split() == NUMBER.sub("N", shown).split()
    new, old = ([float(x) for x in NUMBER.findall(text)] for text in (printed, shown))
    assert new == pytest.approx(old, rel=0.02, abs=1)


def test_its_python_runs():
    for code in blocks("python"):
        names = {}
        exec(code, names)
        assert names["planning"]
