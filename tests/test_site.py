"""The site has a page for every public name, method, environment and figure; and what it says is run."""

import importlib.util
import inspect
import json
import re
import shlex
import types
from pathlib import Path
from typing import TypeVar

import pytest

import jaxrl_tab as rl
from jaxrl_tab.cli import main
from jaxrl_tab.figures import FIGURES

ROOT = Path(__file__).parent.parent
MAKE = ROOT / "docs/make"
METHODS = {**rl.ALGORITHMS, **rl.PREDICTION}


def made_by(name):
    """A module of docs/make, which is no package."""
    spec = importlib.util.spec_from_file_location(f"site_{name}", MAKE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


docstrings, site = made_by("docstrings"), made_by("pages")


@pytest.fixture(scope="module")
def pages():
    return site.pages()


# --- the reference -----------------------------------------------------------------------------------
def public_names():
    """What a person finds with tab after `rl.`, and after the modules there."""
    for name in dir(rl):
        yield name
        module = getattr(rl, name)
        if isinstance(module, types.ModuleType):
            of_module = getattr(module, "__all__", None) or [
                x for x in dir(module) if getattr(getattr(module, x), "__module__", None) == module.__name__
            ]
            yield from (f"{name}.{x}" for x in of_module if not x.startswith("_"))


def test_every_public_name_has_a_page(pages):
    """Broken once: a name left out of `public_names` of pages.py -> fails."""
    reference = "\n".join(text for path, text in pages.items() if path.startswith("api/"))
    shown = set(re.findall(r"^(?:## |\| \[)`(?:rl\.)?([\w.]+)`", reference, re.MULTILINE))
    there = [
        x for x in public_names() if not ("." in x and isinstance(_thing(x), types.ModuleType | TypeVar))
    ]
    assert len(there) > 400
    assert [name for name in there if name not in shown] == []


def _thing(name):
    thing = rl
    for part in name.split("."):
        thing = getattr(thing, part)
    return thing


def test_links_between_pages_lead_somewhere(pages):
    """Anything else is for `mkdocs build --strict`.

    Broken once: a wrong folder in `_place` -> fails; Markdown not among the files of `in_the_site` -> fails.
    """
    docs = ROOT / "docs"
    written = {path.relative_to(docs).as_posix(): path for path in docs.rglob("*.*")}
    texts = {name: path.read_text("utf-8") for name, path in written.items() if name.endswith(".md")}
    for path, text in (pages | {name: site.in_the_site(text) for name, text in texts.items()}).items():
        prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
        for link in re.findall(r"\]\(([\w./-]+)[)#]", prose):
            target = (Path("/") / path).parent / link
            assert target.resolve().relative_to("/").as_posix() in {*written, *pages}, (path, link)


def test_lists_in_lists_are_told_apart():
    """By four blanks, for Markdown as the site reads it. Broken once: by two -> one list, and fails."""
    for file in (*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")):
        assert not re.search(r"^ {1,3}[-*] ", file.read_text(encoding="utf-8"), re.MULTILINE), file


# --- methods, environments, figures --------------------------------------------------------------------
def test_every_method_has_its_equation_its_diagram_and_its_parameters(pages):
    """Broken once: `FORMULA` without "=" -> fails."""
    assert docstrings.formula  # what the fence is for
    for name, cls in METHODS.items():
        page = pages[f"methods/{name}.md"]
        assert "```formula" in docstrings.prepared(inspect.cleandoc(cls.__doc__)), name
        assert "## Backup diagram" in page and "## Parameters" in page, name
    assert "[Sarsa and Q-learning on the cliff](../figures/cliff-walking.md)" in pages["methods/sarsa.md"]


def test_a_formula_is_typeset():
    """Broken once: indices before letters in `TOKEN` -> fails."""
    text = "Q_i(S, A) <- R_{t+1} + gamma^{n-1} max_a Q(S', a)      (book, equation 7.4)"
    assert docstrings.formula(text) == (
        '<div class="formula"><p><i>Q</i><sub><i>i</i></sub>(<i>S</i>, <i>A</i>) ← '
        "<i>R</i><sub><i>t</i>+1</sub> + <i>γ</i><sup><i>n</i>−1</sup> max<sub><i>a</i></sub> "
        '<i>Q</i>(<i>S</i>\', <i>a</i>) <span class="source">(book, equation 7.4)</span></p></div>'
    )


@pytest.mark.parametrize(
    ("docstring", "markdown"),
    [
        ("n = 1 is Sarsa; with more it is not.", "n = 1 is Sarsa; with more it is not."),
        ("q* and P[s][a], but `q*`", r"q\* and P[s]\[a], but `q*`"),
        ("V(S) <- V(S) + x\nor so.", "```formula\nV(S) <- V(S) + x\n```\n\nor so."),
        ("Args:\n    x: what\n        it is.", "Args:\n    x: what\n        it is."),
    ],
)
def test_a_docstring_becomes_markdown(docstring, markdown):
    assert docstrings.prepared(docstring) == markdown


def test_every_environment_and_every_figure_has_a_page(pages):
    """What is kept of the figures is of those that there are. Broken once: a number renamed in its file -> fails."""
    assert {f"environments/{name}.md" for name in rl.ENVS} <= set(pages)
    assert {f"figures/{name}.md" for name in FIGURES} <= set(pages)
    kept = json.loads((ROOT / "docs/figures/numbers.json").read_text())
    for name, rows in kept.items():
        assert [row["what"] for row in rows] == [number.what for number in FIGURES[name].numbers], name
    assert {path.stem for path in (ROOT / "docs/figures").glob("*.png")} == set(kept)


def test_what_a_sweep_of_a_page_gave_is_shown(pages):
    """`python docs/make/given.py` makes it where it is not there. Broken once: of what there is not -> fails."""
    there = {
        path.relative_to(ROOT / "docs")
        for kind in ("methods", "environments")
        for path in (ROOT / "docs" / kind).glob("*.png")
    }
    assert {f"{path.with_suffix('.md')}" for path in there} <= set(pages)
    assert {f"methods/{name}.png" for name in METHODS} <= {*map(str, there)}
    assert {f"environments/{name}.png" for name in rl.ENVS} <= {*map(str, there)}
    for path in there:
        assert f"]({path.name})" in pages[f"{path.with_suffix('.md')}"]


def test_the_notebook_is_shown_with_what_it_gave(pages):
    notebook = pages["examples/quick_start.md"]
    assert notebook.count("data:image/png") == 2
    assert "```text\n" in notebook and "HTML object" not in notebook
    cells = [{"cell_type": "code", "source": "x", "outputs": [{"data": {"text/html": "<p>\n\n<b>1</b>"}}]}]
    assert site.notebook({"cells": cells}) == "```python\nx\n```\n\n<p> <b>1</b>\n"


# --- what is typed ------------------------------------------------------------------------------------
COMMANDS = [
    *(site.method_commands(name)[-1] for name in METHODS),
    *(line for name in rl.ENVS for line in site.environment_commands(name)),
]


@pytest.mark.slow
@pytest.mark.one_in(8)
@pytest.mark.parametrize("command", COMMANDS)
def test_what_a_page_says_to_type_can_be_typed(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    type_in(command)


def type_in(command):
    """What takes long is not done: a sweep is planned only, its folder not explained, and nothing is watched."""
    words = shlex.split(command, comments=True)[1:]
    if words[0] == "figure":  # which have tests of their own
        assert words[1] in FIGURES
    elif words[0] not in ("explain", "watch"):
        assert main([*words, *(["--dry-run"] if words[0] == "sweep" else [])]) == 0, command


@pytest.mark.slow
@pytest.mark.parametrize("page", ["start-student", "start-researcher", "start-teacher", "lecture"])
def test_a_page_that_is_followed_to_the_letter_works(page, tmp_path, monkeypatch):
    """Its commands and its Python, one after another in one folder."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    names = {}
    for kind, block in re.findall(r"^```(console|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if kind == "python":
            exec(block, names)
        else:
            for line in block.splitlines():
                type_in(line)
