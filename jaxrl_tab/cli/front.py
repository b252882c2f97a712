"""Help, and the refusal of what is plainly wrong, before JAX and everything else is imported: at once.

What is not refused here is checked again by the commands themselves, with the classes at hand. They alone decide
about files, classes of somebody's own, schedules, policies, and what involves several parameters.
"""

import itertools
import os
import re
from collections.abc import Sequence
from importlib import metadata

from jaxrl_tab.cli.catalogue import COMMANDS, Catalogue, current
from jaxrl_tab.cli.options import (
    Entry,
    Group,
    Typed,
    check_owners,
    check_words,
    checked_name,
    environments_first,
    parse,
)


def answer(command: str, argv: Sequence[str]) -> None:
    """Returns where the command is to go on.

    Raises:
        InputError: what is typed is wrong, and that can be told from the catalogue. The message is that of the
            command.
        SystemExit: help was asked for, and printed.
    """
    catalogue = current()
    if catalogue is None or any(map(_needs_more, argv)):
        return
    groups = {title: (catalogue.groups[name], where) for title, (name, where) in COMMANDS[command][2].items()}
    described = catalogue.commands[command]
    places, typed = parse(described, argv, {title: group for title, (group, _) in groups.items()})
    _check(command, Entry("", described.options), typed["options"])
    if not any(places.values()) and all(place.metavar.startswith("[") for place in described.places):
        return  # what stands in its place may be left out, as all of it is
    if "--write-template" in typed["options"] or "--memory" in typed["options"]:
        return
    if command == "figure" and (name := places.get("name")):
        checked_name("a figure", name, catalogue.figures)
    if command == "sweep":
        named = environments_first(
            places.get("env", ""), places.get("methods", ()), groups["environment"][0].entries
        )
        places |= dict(zip(("env", "methods"), named, strict=True))
    # In the order in which the commands look at them.
    for title in ("executor", "environment", "hyperparameters"):
        if title not in groups:
            continue
        group, where = groups[title]
        names = typed["options"].get(where, ("local",)) if title == "executor" else places.get(where, ())
        names = (names,) if isinstance(names, str) else names
        for name in names or ("",):
            if name and name not in group.entries and _may_be_elsewhere(name, group, catalogue):
                return
            checked_name(group.noun, name, group.entries)
        _check_entries(names, typed[title], group)


def _needs_more(word: str) -> bool:
    """Whether a word may be a file, a class of somebody's own, or a schedule or a policy with its number."""
    return (
        ":" in word
        or "(" in word
        or word.lower().endswith((".py", ".npz", ".mdp", ".pomdp", ".toml"))
        or os.path.isfile(word)
    )


def _may_be_elsewhere(name: str, group: Group, catalogue: Catalogue) -> bool:
    """Whether the command may know more of a name: as one of another package, or of another library."""
    if not group.entry_points:
        return False
    plain = re.fullmatch("[a-z-]+", name) and name.replace("-", "") not in catalogue.elsewhere
    return not plain or bool(metadata.entry_points(group=group.entry_points, name=name))


def _check_entries(names: Sequence[str], typed: Typed, group: Group) -> None:
    check_owners(names, typed, group)
    for name, flag in itertools.product(names, typed):
        _check(name, group.entries[name], {flag: typed[flag]})


def _check(who: str, entry: Entry, typed: Typed) -> None:
    for flag, words in typed.items():
        if option := entry.by_flag.get(flag):
            check_words(who, option, words)
