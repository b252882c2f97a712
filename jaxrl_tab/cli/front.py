"""Help, and the refusal of what is plainly wrong, before JAX and everything else is imported: at once.

What is not refused here is checked again by the commands themselves, with the classes at hand. They alone decide
about files, classes of somebody's own, schedules, policies, and what involves several parameters.
"""

import itertools
import os
import re
from collections.abc import Sequence
from importlib import metadata

from jaxrl_tab.cli.catalogue import COMMANDS, ENTRY_POINTS, Catalogue, current
from jaxrl_tab.cli.options import Entry, Group, Typed, check_owners, check_words, parse
from jaxrl_tab.core.errors import InputError, nearest, shown


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
    titles = COMMANDS[command][2]
    groups = {title: catalogue.groups[name] for title, name in titles.items()}
    described = catalogue.commands[command]
    places, typed = parse(described, argv, groups)
    _check(command, Entry("", described.options), typed["options"])
    if "--write-template" in typed["options"] or "--memory" in typed["options"]:
        return
    if command == "figure" and (name := places.get("name")) and name not in catalogue.figures:
        raise InputError(f"{shown(name)} is not a figure; {nearest(name, catalogue.figures)}")
    if "executor" in groups:
        name, group = typed["options"].get("--executor", ("local",))[0], groups["executor"]
        if name not in group.entries:
            raise InputError(f"{shown(name)} is not an executor; {nearest(name, group.entries)}")
        _check_entries([name], typed["executor"], group)
    for title, noun in (("environment", "environments"), ("hyperparameters", "methods")):
        if title not in groups:
            continue
        place = "env" if title == "environment" else "method" if command == "watch" else "methods"
        names, group = places.get(place, ()), groups[title]
        for name in (names := (names,) if isinstance(names, str) else names):
            if name not in group.entries:
                if _may_be_elsewhere(name, noun, catalogue):
                    return
                raise InputError(f"{shown(name)} is not {group.noun}; {nearest(name, group.entries)}")
        if not names:
            raise InputError(f"name {group.noun}: {', '.join(group.entries)}")
        _check_entries(names, typed[title], group)


def _needs_more(word: str) -> bool:
    """Whether a word may be a file, a class of somebody's own, or a schedule or a policy with its number."""
    return ":" in word or "(" in word or word.endswith((".py", ".npz", ".toml")) or os.path.isfile(word)


def _may_be_elsewhere(name: str, kind: str, catalogue: Catalogue) -> bool:
    """Whether the command may know more of a name: as one of another package, or of another library."""
    plain = re.fullmatch("[a-z-]+", name) and name.replace("-", "") not in catalogue.elsewhere
    return not plain or bool(metadata.entry_points(group=ENTRY_POINTS[kind], name=name))


def _check_entries(names: Sequence[str], typed: Typed, group: Group) -> None:
    check_owners(names, typed, group)
    for name, flag in itertools.product(names, typed):
        _check(name, group.entries[name], {flag: typed[flag]})


def _check(who: str, entry: Entry, typed: Typed) -> None:
    for flag, words in typed.items():
        if option := entry.by_flag.get(flag):
            check_words(who, option, words)
