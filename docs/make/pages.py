"""The pages of the site that are made, so that nothing is written twice: from the registries, docstrings and README.

`pages()` gives them all; `hook.py` hands them to MkDocs. They are Markdown, in which `::: name` stands for the
docstring of that name. This needs the package, and no tool of the site.
"""

import ast
import dataclasses
import functools
import importlib
import inspect
import json
import re
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jaxrl_tab as rl
from jaxrl_tab.core import describe
from jaxrl_tab.core.declared import Learns, LearnsFrom, of_environment, of_method
from jaxrl_tab.core.errors import one_line
from jaxrl_tab.engine.results import label
from jaxrl_tab.figures import FIGURES
from jaxrl_tab.show.words import title_of

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "docs/figures"  # pictures of the figures, and what their numbers came to: see `figures.py`
AT_THE_ROOT = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
}
METHODS = {**rl.ALGORITHMS, **rl.PREDICTION}
PAGE_OF = {cls: f"methods/{name}.md" for name, cls in METHODS.items()}
PAGE_OF |= {cls: f"environments/{name}.md" for name, cls in rl.ENVS.items()}

TABLE = {
    Learns.ACTIONS: "action values Q [S, A], and acts by them",
    Learns.PREFERENCES: "preferences θ [S, A], whose softmax is the policy that acts",
    Learns.STATES: "state values V [S] of a policy that it is given (prediction)",
}
FROM = {
    LearnsFrom.ITSELF: "its own experience alone",
    LearnsFrom.TRANSITIONS: "any transitions, in any order, whoever acted",
    LearnsFrom.TRANSITIONS_OF_B: "any transitions, in any order, if it is told the policy b that acted",
    LearnsFrom.EPISODES: "episodes in order, whoever acted",
    LearnsFrom.EPISODES_OF_B: "episodes in order, if it is told the policy b that acted",
}


def pages() -> dict[str, str]:
    """Every page that is made: its path in the site -> its Markdown."""
    return {
        **{page: _linked((ROOT / file).read_text(encoding="utf-8")) for file, page in AT_THE_ROOT.items()},
        **_examples(),
        **_shown_files(),
        **_methods(),
        **_environments(),
        **_figures(),
        **api(),
    }


def _linked(text: str) -> str:
    """A page of the repository's root with links as they are in the site."""
    text = re.sub(r"\]\(docs/", "](", text)
    for file, page in AT_THE_ROOT.items():
        text = text.replace(f"]({file})", f"]({page})")
    text = re.sub(r"\]\(examples/(\w+)\.ipynb\)", r"](examples/\1.md)", text)
    return re.sub(r"\]\(examples/?\)", "](examples/index.md)", text)


# --- methods, environments, figures --------------------------------------------------------------------
def _methods() -> dict[str, str]:
    made = {}
    kinds = {"Control": [], "Policy gradient": [], "Prediction": []}
    for name, cls in METHODS.items():
        declared = of_method(cls)
        kind = {Learns.ACTIONS: "Control", Learns.PREFERENCES: "Policy gradient", Learns.STATES: "Prediction"}
        kinds[kind[declared.learns]].append(_row(name, cls))
        made[f"methods/{name}.md"] = _page(
            f"# {title_of(name)}",
            f"`{name}` on the command line, `rl.{_in_python(cls)}` in Python.",
            _of(cls, source="update" in vars(cls)),
            _diagram(declared.backup),
            _parameters(cls),
            "## What it learns, and from what",
            f"It learns {TABLE[declared.learns]}. `update` learns rightly from {FROM[declared.learns_from]}.",
            _seen_in(cls, name),
            "## Run it",
            _console(method_commands(name)),
            _given("methods", name),
        )
    sections = [f"## {kind}\n\n{_table(('method', 'what it is'), rows)}" for kind, rows in kinds.items()]
    return {"methods/index.md": _page("# Methods", *sections), **made}


def method_commands(name: str) -> list[str]:
    """What a person may type to see a method at work, in a task that suits it."""
    declared = of_method(METHODS[name])
    if declared.features is not None and declared.in_the_long_run:
        told = '--features one-hot "aggregation(11)" --alpha 0.02 --steps 200000 --log-every 2000 --seeds 20'
        return [f"jaxrl-tab sweep access-control {name} {told} --out runs/{name}"]
    if name.startswith("deep-"):  # which have an optimiser in place of a step size
        told = (
            '--network "mlp(32)" --optimizer "optax:adam(0.005)" --batch 16 --buffer 2000 --target-every 100'
        )
        budget = "--gamma 0.99 --steps 8000 --log-every 200 --seeds 32"
        return [f"jaxrl-tab sweep gymnax:CartPole-v1 {name} {told} {budget} --out runs/{name}"]
    if name == "lspi":  # which has no step size, and a cost that grows with the square of the weights
        told = "--gamma 0.99 --q0 0 1 --episodes 300 --seeds 20"
        return [f"jaxrl-tab sweep frozen-lake {name} {told} --out runs/{name}"]
    if declared.features is not None and declared.learns is Learns.ACTIONS:
        return [_of_features("mountain-car", name, out=name)]
    if declared.features is not None and declared.learns_from.needs_behaviour:
        return [_off_policy("baird", name, out=name)]
    if declared.features is not None:
        told, episodes = '--states 99 --features one-hot "aggregation(9)" "fourier(3)" --alpha 0.02', 200
        if not any(
            p.name == "alpha" for p in describe.parameters(METHODS[name])
        ):  # a step of which takes longer
            told, episodes = '--states 19 --features one-hot "aggregation(5)" "fourier(3)"', 50
        return [f"jaxrl-tab sweep random-walk {name} {told} --episodes {episodes} --exact --out runs/{name}"]
    if declared.learns is Learns.STATES:
        return [
            f"jaxrl-tab watch random-walk {name} --episodes 20",
            f"jaxrl-tab sweep random-walk {name} --episodes 100 --out runs/{name}",
        ]
    if declared.needs_horizon:
        task, budget = "finite-horizon:20:windy-gridworld", "--steps 8000"
    elif declared.in_the_long_run:
        task, budget = "river-swim", "--steps 8000"
    elif name == "gradient-bandit":
        task, budget = "k-armed-testbed", "--steps 1000"
    elif declared.learns is Learns.PREFERENCES:
        task, budget = "short-corridor", "--episodes 500"
    else:
        task, budget = "windy-gridworld", "--steps 8000"
    return [
        f"jaxrl-tab watch {task} {name}",
        f"jaxrl-tab sweep {task} {name} {budget} --seeds 20 --out runs/{name}",
    ]


def _environments() -> dict[str, str]:
    made = {}
    for name, cls in rl.ENVS.items():
        env = rl.make(name)
        states = f"{env.num_states} states" if env.num_states else "states that cannot be counted,"
        size = f"{states} and {env.num_actions} actions, as it is by default"
        ends = (
            "it does not end"
            if of_environment(env).continuing
            else f"at most {env.max_steps} steps an episode"
        )
        made[f"environments/{name}.md"] = _page(
            f"# {title_of(name)}",
            f"`{name}` on the command line, `rl.make({name!r})` in Python: {size}; {ends}.",
            _of(cls),
            _parameters(cls),
            _seen_in(cls, name),
            "## Run it",
            _console(environment_commands(name)),
            _given("environments", name),
        )
    table = _table(("environment", "what it is"), [_row(name, cls) for name, cls in rl.ENVS.items()])
    return {"environments/index.md": _page("# Environments", table), **made}


def _of_features(env: str, method: str, out: str) -> str:
    """A sweep where states cannot be counted."""
    told = '--features "tile-coding(8, 8)" --per-tiling --alpha 0.1 0.2 0.5 --epsilon 0'
    return f"jaxrl-tab sweep {env} {method} {told} --episodes 200 --seeds 20 --out runs/{out}"


def _off_policy(env: str, methods: str, out: str) -> str:
    """A sweep in a task that states its features and its policies."""
    second = " --beta 0.05" if {"gtd2", "tdc"} & {*methods.split()} else ""
    told = f"--features own --w0 1,1,1,1,1,1,10,1 --gamma 0.99 --alpha 0.005{second}"
    return f"jaxrl-tab sweep {env} {methods} {told} --steps 1000 --exact --out runs/{out}"


# Tasks in which there is nothing to choose, and with which features.
TO_PREDICT = {
    "long-walk": '--features "aggregation(10)" "aggregation(50)" --alpha 0.02 0.1 --episodes 200',
    "square-wave": '--features "tile-coding(5, 10)" --per-tiling --alpha 0.05 0.2 --steps 2000',
}


def environment_commands(name: str) -> list[str]:
    """What a person may type to see an environment."""
    env = rl.make(name)
    if told := TO_PREDICT.get(name):
        return [f"jaxrl-tab sweep {name} semi-gradient-td {told} --seeds 20 --out runs/{name}"]
    if not env.num_states:
        return [_of_features(name, "semi-gradient-sarsa", out=name)]
    declared = of_environment(env)
    if declared.behaviour_policy is not None:
        return [f"jaxrl-tab solve {name}", _off_policy(name, "semi-gradient-off-policy-td tdc", out=name)]
    method = "r-learning" if declared.continuing else "q-learning"
    solve = [] if declared.at else [f"jaxrl-tab solve {name}"]
    return [*solve, f"jaxrl-tab sweep {name} {method} --steps 8000 --seeds 20 --out runs/{name}"]


def _given(folder: str, name: str) -> str:
    """The picture that the last command on a page gave, where it is kept: see `given.py`."""
    there = (ROOT / f"docs/{folder}/{name}.png").exists()
    return (
        f"Of its pictures this is `overview.png`:\n\n![What the sweep above gave]({name}.png)"
        if there
        else ""
    )


def _figures() -> dict[str, str]:
    kept = json.loads((KEPT / "numbers.json").read_text(encoding="utf-8"))
    made, gallery = {}, []
    for name, figure in FIGURES.items():
        here = {row["what"]: row for row in kept.get(name, [])}
        nothing = {"got": "–", "error": "–", "expected": ""}
        rows = [
            (x.what, x.published or "–", *((here.get(x.what) or nothing)[y] for y in nothing))
            for x in figure.numbers
        ]
        picture = f"![{figure.title}]({name}.png)" if (KEPT / f"{name}.png").exists() else ""
        made[f"figures/{name}.md"] = _page(
            f"# {figure.title}",
            f"{figure.source}. `{name}` on the command line.",
            figure.shows,
            picture,
            _table(("number", "published", "here", "± standard error", "expected"), rows),
            "*Expected* is what long simulations with plain loops say, or exact enumeration; *published* what the "
            "source prints, where it prints a number.",
            _console([f"jaxrl-tab figure {name} --out runs/{name}"]),
        )
        gallery.append(
            _page(
                f"### [{figure.title}]({name}.md)",
                figure.source,
                f"[{picture}]({name}.md)" if picture else "",
            )
        )
    about = (
        f"{len(FIGURES)} figures of the book, of papers and of the lecture, made again by `jaxrl-tab figure --all "
        "--out runs/figures`, each with the numbers that it must show."
    )
    return {"figures/index.md": _page("# Figures", about, *gallery), **made}


def _of(cls: type, source: bool = False) -> str:
    """The docstring of a class, and its code, where its update is its own."""
    options = {
        "show_root_heading": False,
        "show_root_toc_entry": False,
        "members": False,
        "show_source": source,
    }
    return _docstring(_path(cls), **options)


def _diagram(backup: Any) -> str:
    if backup is None:
        return ""
    return _page("## Backup diagram", "```text\n" + "\n".join(backup.diagram()) + "\n```", backup.words)


def _parameters(cls: type, heading: str = "## Parameters") -> str:
    rows = [(f"`{p.name}`", _default(p.default), p.help) for p in describe.parameters(cls)]
    return _page(heading, _table(("parameter", "default", "what it is"), rows)) if rows else ""


def _seen_in(cls: type, name: str) -> str:
    """The figures whose file names the class, or the name that it is registered by."""
    keys = [key for key in FIGURES if {cls.__name__, name} & _named(key)]
    found = [f"- [{FIGURES[key].title}](../figures/{key}.md)" for key in keys]
    return _page("## Figures in which it appears", "\n".join(found)) if found else ""


@functools.cache
def _named(figure: str) -> frozenset[str]:
    """All names and texts in the file of a figure."""
    module = inspect.getmodule(FIGURES[figure].draw)
    assert module
    nodes = [*ast.walk(ast.parse(inspect.getsource(module)))]
    texts = [node.value for node in nodes if isinstance(node, ast.Constant)]
    return frozenset(
        [node.id for node in nodes if isinstance(node, ast.Name)] + [x for x in texts if isinstance(x, str)]
    )


def _in_python(cls: type) -> str:
    if getattr(rl, cls.__name__, None) is cls:
        return cls.__name__
    return f"{'approx' if hasattr(rl.approx, cls.__name__) else 'prediction'}.{cls.__name__}"


# --- examples ------------------------------------------------------------------------------------------
def _examples() -> dict[str, str]:
    folder = ROOT / "examples"
    made = {"examples/index.md": _to_pages(_of_examples(folder / "README.md"))}
    for file in sorted(folder.iterdir()):
        if file.suffix in (".py", ".toml"):
            code = f"```{file.suffix[1:]}\n{file.read_text(encoding='utf-8')}```"
            key = f"examples/{file.stem}.md"
            made[key] = _page(made.get(key, f"# {file.name}"), code)
        elif file.suffix == ".ipynb":
            made[f"examples/{file.stem}.md"] = notebook(json.loads(_of_examples(file)))
    return made


def _of_examples(file: Path) -> str:
    """The text of a file beside the pages of docs/, as if it were among them."""
    return file.read_text(encoding="utf-8").replace("](../docs/", "](../")


def _shown_files() -> dict[str, str]:
    """A page for each file of the repository that a page of docs/ links to, and that has none."""
    written = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    made = {}
    for name in re.findall(r"\]\(\.\./((?!examples/)[\w./-]+\.(?:py|toml))\)", written):
        file = ROOT / name
        code = f"```{file.suffix[1:]}\n{file.read_text(encoding='utf-8')}```"
        made[page_of_file(name)] = _page(f"# {file.name}", code)
    return made


def in_the_site(text: str) -> str:
    """A page of docs/, whose links to files elsewhere in the repository lead to the pages that show them."""
    to_page = lambda link: f"]({page_of_file(link[1])}"
    return re.sub(r"\]\(\.\./([\w./-]+\.(?:py|ipynb|toml|md))(?=[)#])", to_page, text)


def page_of_file(name: str) -> str:
    """Where a file of the repository is shown, by its path."""
    if name in AT_THE_ROOT:
        return AT_THE_ROOT[name]
    stem = name.rpartition(".")[0]
    return f"{stem}.md" if name.startswith("examples/") else f"files/{stem}.md"


def notebook(content: Mapping[str, Any]) -> str:
    """A notebook as it was saved, with what its cells gave."""
    return _page(*[part for cell in content["cells"] for part in _cell(cell)])


def _to_pages(text: str) -> str:
    """Links to files of examples as links to their pages."""
    return re.sub(r"\]\((\w+)\.(py|ipynb|toml)\)", r"](\1.md)", text)


def _cell(cell: Mapping[str, Any]) -> Iterator[str]:
    text = "".join(cell["source"])
    if cell["cell_type"] != "code":
        yield _to_pages(text)
        return
    yield f"```python\n{text}\n```"
    for output in cell["outputs"]:
        data = output.get("data", {})
        if "image/png" in data:
            yield f"![What the cell above shows](data:image/png;base64,{''.join(data['image/png']).strip()})"
        elif "text/html" in data:  # "" where a bar was
            yield re.sub(r"\n\s*", " ", "".join(data["text/html"]))
        elif printed := "".join(output.get("text", data.get("text/plain", ""))).strip("\n"):
            yield f"```text\n{printed}\n```"


# --- the reference of the interface --------------------------------------------------------------------
# Of what is public and in no public module: wing -> its page, its title.
WINGS = {
    "engine": ("runs", "Runs and sweeps"),
    "experiment": ("experiments", "Experiments"),
    "core": ("blocks", "What methods and environments are made of"),
    "envs": ("envs", ""),
}
INTEROP = ("interop.gymnasium", "interop.gymnax")  # modules that one imports by their own name


def public_modules() -> dict[str, types.ModuleType]:
    """The modules that people use: their names after `rl.` -> the module."""
    found = {name: getattr(rl, name) for name in dir(rl) if isinstance(getattr(rl, name), types.ModuleType)}
    return found | {name: importlib.import_module(f"jaxrl_tab.{name}") for name in INTEROP}


@functools.cache
def public_names(module: types.ModuleType) -> tuple[str, ...]:
    """The public names of a module: those in its `__all__`, or all that it defines without an underscore."""
    if hasattr(module, "__all__"):
        return tuple(
            name for name in module.__all__ if not isinstance(getattr(module, name), types.ModuleType)
        )
    names: list[str] = []
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names += [
                name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)
            ]
    public = dict.fromkeys(name for name in names if not name.startswith("_"))
    return tuple(name for name in public if not isinstance(getattr(module, name), TypeVar))


def api() -> dict[str, str]:
    """The reference: a page for each public module, one for each wing with public names, and one that lists all."""
    modules = public_modules()
    made, rows = {}, []
    in_wings: dict[str, list[str]] = {page: [] for page, _ in WINGS.values()}
    for name in dir(rl):
        page, in_module = _place(name, modules)
        if not in_module:
            in_wings[page].append(_entry(rl, f"jaxrl_tab.api.{name}", name, f"rl.{name}"))
        link = f"../{page}" if page.endswith(".md") else f"{page}.md"
        rows.append((f"[`rl.{name}`]({link})", _first_line(getattr(rl, name))))
    for page, title in WINGS.values():
        if title:
            made[f"api/{page}.md"] = _page(f"# {title}", *in_wings[page])
    for name, module in modules.items():
        entries = [_entry(module, f"{module.__name__}.{x}", x, f"{name}.{x}") for x in public_names(module)]
        about = _docstring(module.__name__, members=False, show_root_heading=False, show_root_toc_entry=False)
        made[f"api/{name}.md"] = _page(f"# rl.{name}", about, *entries)
    about = "All that `import jaxrl_tab as rl` gives, and where it is described. Nothing else is public."
    return {
        "api/index.md": _page("# The interface in Python", about, _table(("name", "what it is"), rows)),
        **made,
    }


def _place(name: str, modules: Mapping[str, types.ModuleType]) -> tuple[str, bool]:
    """The page of a name of `rl`, and whether that of a module has it already."""
    thing = getattr(rl, name)
    if name in modules:
        return name, True
    if isinstance(thing, type) and thing in PAGE_OF:
        return PAGE_OF[thing], True
    if thing is rl.ALGORITHMS or thing is rl.PREDICTION:
        return "methods/index.md", True
    for other, module in modules.items():
        if name in public_names(module) and getattr(module, name) is thing:
            return other, True
    return WINGS[thing.__module__.split(".")[1]][0], False


def _entry(module: Any, path: str, name: str, shown: str) -> str:
    """A name of the reference: its docstring, or a link to its own page."""
    thing = getattr(module, name)
    if isinstance(thing, type) and thing in PAGE_OF:
        return f"## `{shown}`\n\n[{_first_line(thing)}](../{PAGE_OF[thing]})"
    if not (callable(thing) and hasattr(thing, "__name__")):
        plain = isinstance(thing, str | int | float | tuple | frozenset)
        keys = [f"`{key}`" for key in thing if isinstance(key, str)] if isinstance(thing, dict) else []
        is_what = (
            f"`{one_line(repr(thing))}`"
            if plain
            else f"A {type(thing).__name__}{': ' * bool(keys)}{', '.join(keys)}."
        )
        return _page(f"## `{shown}`", is_what, _comment(module, name))
    fields = _parameters(thing, "") if isinstance(thing, type) and dataclasses.is_dataclass(thing) else ""
    return _page(
        f"## `{shown}`", _docstring(path, show_root_toc_entry=False, show_root_heading=False), fields
    )


def _comment(module: Any, name: str) -> str:
    """What the source says of a constant: the comment behind it, or above, wherever it was imported from."""
    lines = inspect.getsource(module).splitlines()
    for node in ast.parse("\n".join(lines)).body:
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and name in [x.asname or x.name for x in node.names]
        ):
            return _comment(importlib.import_module(node.module), name)
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if name in [getattr(target, "id", None) for target in targets]:
            above = (
                lines[node.lineno - 2].removeprefix("# ") if lines[node.lineno - 2].startswith("# ") else ""
            )
            comment = lines[node.lineno - 1].partition("  # ")[2] or above
            return f"{comment[:1].upper()}{comment[1:].rstrip('.')}." if comment else ""
    return ""


def _first_line(thing: Any) -> str:
    if not callable(thing) and not isinstance(thing, types.ModuleType):
        return f"a {type(thing).__name__}"
    return (
        describe.summary(thing)
        if isinstance(thing, type)
        else (inspect.getdoc(thing) or "").partition("\n")[0]
    )


# --- Markdown ------------------------------------------------------------------------------------------
def _page(*parts: str) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"


def _path(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


def _docstring(path: str, **options: Any) -> str:
    lines = [f"      {key}: {json.dumps(value)}" for key, value in options.items()]
    return "\n".join([f"::: {path}", "    options:", *lines])


def _row(name: str, cls: type) -> tuple[str, str]:
    return f"[`{name}`]({name}.md)", describe.summary(cls)


def _table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell_text(str(x)) for x in line) + " |" for line in lines)


def _cell_text(text: str) -> str:
    return re.sub(r"(?<!\\)\|", r"\\|", text).replace("\n", " ")


def _default(value: Any) -> str:
    if value is describe.MISSING:
        return "must be given"
    shown = label(value)
    return "–" if shown is None else f"`{shown:g}`" if isinstance(shown, float) else f"`{shown}`"


def _console(commands: list[str]) -> str:
    return "```console\n" + "\n".join(commands) + "\n```"
