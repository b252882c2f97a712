"""What can be typed, kept in a file, so that it is known before JAX and the classes are imported.

`catalogue.json` is made of the classes and lies beside this module. It is used only where the sources are those
that it was made of. After a change to them make it again:

    python -m jaxrl_tab.cli.catalogue
"""

import hashlib
import importlib
import json
import sys
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from jaxrl_tab.cli.options import Command, Entry, Group, Option, Place
from jaxrl_tab.core.errors import InputError

PACKAGE = Path(__file__).parent.parent
FILE = Path(__file__).with_name("catalogue.json")
SOURCES = ("core", "envs", "algorithms", "figures", "experiment/executors", "cli")  # of what is in the file
# Command -> the module, the class that describes it, and its groups: title in the help -> which it is, and where the
# names of its entries are typed: a place of the command, or an option.
_ENVIRONMENT, _EXECUTOR = ("environments", "env"), ("executors", "--executor")
_ONE = {"hyperparameters": ("one method", "method"), "environment": _ENVIRONMENT}
COMMANDS = {
    "bridge": ("bridge", "Bridge", _ONE),
    "schedule": ("schedule", "Schedule", {}),
    "solve": ("solve", "Solve", {"environment": _ENVIRONMENT}),
    "watch": ("watch", "Watch", _ONE),
    "sweep": (
        "sweep",
        "Sweep",
        {"hyperparameters": ("methods", "methods"), "environment": ("grids", "env"), "executor": _EXECUTOR},
    ),
    "search": ("search", "Search", {"hyperparameters": ("ranges", "methods"), "environment": _ENVIRONMENT}),
    "resume": ("sweep", "Resume", {"executor": _EXECUTOR}),
    "moments": (
        "moments",
        "Moments",
        {"hyperparameters": ("exact methods", "method"), "environment": _ENVIRONMENT},
    ),
    "explain": ("explain", "Explain", {}),
    "seeds": ("seeds", "Seeds", {}),
    "compare": ("compare", "Compare", {}),
    "read": ("read", "Read", {}),
    "figure": ("figure", "Figure", {}),
}


class Catalogue(NamedTuple):
    """What can be typed.

    Attributes:
        commands: by their names.
        groups: "environments", "grids" (of environments), "methods", "one method" (of which each option has one value),
            "exact methods" (of `moments`), "ranges" (of methods, for `search`) and "executors".
        listed: for `list`: "environments", "methods" (of control) and "prediction" -> name -> entry, with the
            defaults of the classes.
        facts: the same as JSON: name -> summary, parameters, those included that cannot be typed, and of methods the
            backup diagram, as what `Backup` is made of.
        figures: name -> title and source.
        elsewhere: names by which people look for an environment of another library.
        unavailable: a line for each entry point of another package that cannot be loaded.
    """

    commands: dict[str, Command]
    groups: dict[str, Group]
    listed: dict[str, dict[str, Entry]]
    facts: dict[str, Any]
    figures: dict[str, str]
    elsewhere: tuple[str, ...]
    unavailable: tuple[str, ...] = ()


@cache
def current() -> Catalogue | None:
    """The catalogue in the file; None where it is another one, or classes were imported, and perhaps added, by now."""
    if "jaxrl_tab.envs" in sys.modules:
        return None
    try:
        data = json.loads(FILE.read_text(encoding="utf-8"))
        return _from_data(data["catalogue"]) if data["sources"] == checksum() else None
    except (OSError, ValueError, KeyError, TypeError):  # it is not there, or damaged
        return None


def everything() -> Catalogue:
    """What can be typed here, with what other packages add."""
    if (kept := current()) and not any(_added_to(group) for group in kept.groups.values()):
        return kept
    return live()


def _added_to(group: Group) -> bool:
    """Whether other packages add entries to a group."""
    return bool(group.entry_points and metadata.entry_points(group=group.entry_points))


def live() -> Catalogue:
    """The same, of the classes."""
    from jaxrl_tab import interop  # noqa: F401  which adds its libraries
    from jaxrl_tab.cli.common import ENVIRONMENT, ENVIRONMENTS, EXECUTOR, HYPERPARAMETERS, OF_ONE_METHOD
    from jaxrl_tab.cli.moments import EXACT
    from jaxrl_tab.cli.search import RANGES
    from jaxrl_tab.cli.typed import Classes, command_of
    from jaxrl_tab.core import names
    from jaxrl_tab.envs import ENVS, GYMNASIUM
    from jaxrl_tab.figures import FIGURES
    from jaxrl_tab.methods import ALGORITHMS, PREDICTION

    unavailable = [line for kind in names.KINDS for line in names.add_entry_points(kind)]
    registries = {"environments": ENVS, "methods": ALGORITHMS, "prediction": PREDICTION}
    classes = {
        name: getattr(importlib.import_module(f"jaxrl_tab.cli.{module}"), of)
        for name, (module, of, _) in COMMANDS.items()
    }
    return Catalogue(
        {name: command_of(cls) for name, cls in classes.items()},
        {
            "environments": ENVIRONMENT.group,
            "grids": ENVIRONMENTS.group,
            "methods": HYPERPARAMETERS.group,
            "one method": OF_ONE_METHOD.group,
            "exact methods": EXACT.group,
            "ranges": RANGES.group,
            "executors": EXECUTOR.group,
        },
        {kind: dict(Classes(registry, "").group.entries) for kind, registry in registries.items()},
        {kind: {name: _facts(cls) for name, cls in r.items()} for kind, r in registries.items()},
        {name: f"{figure.title} ({figure.source})" for name, figure in FIGURES.items()},
        tuple(GYMNASIUM),
        tuple(unavailable),
    )


def of_own(name: str) -> Catalogue:
    """What there is to know of a method or an environment of somebody's own, "mine.py:Mine", as `live` has it of all.

    Raises:
        InputError: the name stands for neither.
    """
    from jaxrl_tab import interop  # noqa: F401  which adds its libraries
    from jaxrl_tab.cli.typed import Classes
    from jaxrl_tab.core import names
    from jaxrl_tab.core.declared import Learns, of_method
    from jaxrl_tab.core.modules import is_table
    from jaxrl_tab.envs import ENVIRONMENT
    from jaxrl_tab.methods import METHOD

    no_method = is_table(name) or name.partition(":")[0] in (*ENVIRONMENT.libraries, *ENVIRONMENT.around)
    refusals = []
    for one in (ENVIRONMENT,) if no_method else (METHOD, ENVIRONMENT):
        try:
            cls = names.find(one, name).cls
            break
        except InputError as error:
            refusals.append(error)
    else:
        raise refusals[0]
    if one is ENVIRONMENT:
        kind = "environments"
    else:
        kind = "prediction" if of_method(cls).learns is Learns.STATES else "methods"
    listed = {kind: dict(Classes({name: cls}, "").group.entries)}
    return Catalogue({}, {}, listed, {kind: {name: _facts(cls)}}, {}, ())


def _facts(cls: type) -> dict[str, Any]:
    """What `list --json` says of a class; of an environment without an end also that it is "continuing"."""
    from jaxrl_tab.core import describe
    from jaxrl_tab.core.declared import of_method
    from jaxrl_tab.engine.results import label

    default = lambda p: None if p.default is describe.MISSING else label(p.default)
    parameters = {p.name: {"default": default(p), "help": p.help} for p in describe.parameters(cls)}
    backup = of_method(cls).backup if hasattr(cls, "update") else None
    drawn = {} if backup is None else {"backup": to_data(backup)}
    goes_on = {"continuing": True} if getattr(cls, "continuing", False) is True else {}
    return {"summary": describe.summary(cls), "parameters": parameters, **drawn, **goes_on}


def checksum() -> str:
    """Of the sources of all that is in the catalogue."""
    digest = hashlib.sha256()
    for wing in SOURCES:
        for path in sorted((PACKAGE / wing).rglob("*.py")):
            digest.update(f"{path.relative_to(PACKAGE).as_posix()}\n".encode())
            digest.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()


def write() -> None:
    """Makes the file again."""
    data = {"sources": checksum(), "catalogue": to_data(live())}
    FILE.write_text(json.dumps(data, ensure_ascii=False, indent=0) + "\n", encoding="utf-8")


def to_data(x: Any) -> Any:
    """Named tuples as mappings, so that JSON keeps the names."""
    if hasattr(x, "_asdict"):
        # What is as usual is left out.
        x = {key: value for key, value in x._asdict().items() if value != x._field_defaults.get(key, ...)}
    if isinstance(x, Mapping):
        return {key: to_data(value) for key, value in x.items()}
    return [to_data(value) for value in x] if isinstance(x, list | tuple) else x


def _from_data(data: Mapping[str, Any]) -> Catalogue:
    commands = {
        name: Command(
            x["name"], x["about"], [Place(**place) for place in x["places"]], _options(x["options"])
        )
        for name, x in data["commands"].items()
    }
    groups = {name: Group(**(x | {"entries": _entries(x["entries"])})) for name, x in data["groups"].items()}
    listed = {kind: _entries(x) for kind, x in data["listed"].items()}
    return Catalogue(commands, groups, listed, data["facts"], data["figures"], tuple(data["elsewhere"]))


def _entries(data: Mapping[str, Any]) -> dict[str, Entry]:
    return {name: Entry(x["summary"], _options(x["options"])) for name, x in data.items()}


def _options(data: Any) -> list[Option]:
    return [Option(**x) for x in data]


if __name__ == "__main__":
    write()
