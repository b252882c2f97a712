"""docs/files.md is true: its file is read, its Python runs and prints what the page says."""

import re
from pathlib import Path

import pytest

from jaxrl_tab import cli

PAGE = (Path(__file__).parent.parent / "docs/files.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


PRINTED = ["[200. 200.]", "[26.244 29.484 33.484]", "[ -8.5714 -20. ]", "1.0 1.0", blocks("text")[1]]


@pytest.mark.parametrize(("code", "printed"), [*zip(blocks("python"), PRINTED, strict=True)])
def test_its_python_prints_what_it_says(code, printed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiger.POMDP").write_text(blocks("text")[0])
    exec(code, {})
    assert capsys.readouterr().out.split() == printed.split()


def test_its_command_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiger.POMDP").write_text(blocks("text")[0])
    first, *_ = blocks("console")[0].splitlines()
    assert cli.main(first.split()[1:]) == 0
    assert "value from the start 200" in capsys.readouterr().out
