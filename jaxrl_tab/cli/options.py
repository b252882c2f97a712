"""What can be typed: the options of the commands, of environments and of methods, as data, and how it is parsed.

A parameter `max_steps` is the option `--max-steps`, a switch `stochastic` is `--stochastic`, and one that is on
by default is `--no-...`. The options of all entries of a registry stand side by side in one parser; which of them
the chosen entry has is checked afterwards, so the error can say who has what.

Nothing here knows a class: `typed` makes these data of classes, `catalogue` keeps them, so that help and errors
need neither JAX nor any of the classes.
"""

import argparse
import contextlib
import itertools
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from jaxrl_tab.core.errors import (
    LIMITS,
    InputError,
    check_choice,
    in_words,
    listed,
    nearest,
    one_line,
    shown,
    unfit,
    whole,
)

Typed = dict[str, tuple[str, ...]]
"""The options that were typed, each with its words; none for a switch."""
MANY, SOME = 12, 6  # of more owners than many only some are named
MOST = 2 / 3  # of a part of a registry, from where on its name stands for those that are meant
NONE = "–"  # stands where there is no default
# What people look for among the options, and where it is.
ELSEWHERE = {"--horizon": "a task that ends after 20 steps is named finite-horizon:20:NAME"}


class Option(NamedTuple):
    """A parameter as it is typed.

    Attributes:
        flag: how it is typed.
        name: of the parameter.
        help: what it is and what it takes.
        default: its value where it is not typed, in words.
        metavar: stands for its value in the help; empty for a switch, which takes none.
        several: whether its value is made of several words.
        alone: whether it may stand without a value.
        takes: "int" or "float", where each word is a number; "rate", where it may be a schedule as well; else
            empty.
        limits: of a number, as `pytree.field` has them; None where any will do, or more is checked than each word.
        choices: the words that it takes; empty for any.
    """

    flag: str
    name: str
    help: str
    default: str = NONE
    metavar: str = "X"
    several: bool = False
    takes: str = ""
    limits: Mapping[str, float] | None = None
    choices: Collection[str] = ()
    alone: bool = False


class Entry(NamedTuple):
    """An entry of a registry: what it is, in one line, and its options."""

    summary: str
    options: Sequence[Option]

    @property
    def by_flag(self) -> dict[str, Option]:
        return {option.flag: option for option in self.options}


class Group(NamedTuple):
    """Options for the entries of a registry.

    Attributes:
        entries: name -> entry.
        help: what they are, one line.
        noun: what an entry is called, with its article.
        grids: whether every option takes any number of values, to be tried one by one; of an option whose value is made
            of several words they are one.
        parts: what people call parts of the registry -> the names in it.
        entry_points: the group of entry points by which other packages add entries; empty where they cannot.
    """

    entries: Mapping[str, Entry]
    help: str
    noun: str = ""
    grids: bool = False
    parts: Mapping[str, Collection[str]] = MappingProxyType({})
    entry_points: str = ""

    def owners(self, names: Sequence[str]) -> str:
        """Names of the registry in few words: the name of a part instead of all, or most, that are in it."""
        remaining, in_words = list(names), []
        for least, most_of in ((1, ""), (MOST, "most of ")):
            for part, members in self.parts.items():
                if len(set(members) & set(remaining)) >= least * len(members):
                    in_words.append(most_of + part)
                    remaining = [name for name in remaining if name not in members]
        if len(remaining) > MANY:
            remaining = [*remaining[:SOME], f"{len(remaining) - SOME} others"]
        return ", ".join(in_words + remaining)


class Place(NamedTuple):
    """A word, or any number of words, that a command takes in its place and not as an option."""

    name: str
    metavar: str
    help: str
    many: bool


class Command(NamedTuple):
    """A command: its name, what it does (of several paragraphs), its words and its options."""

    name: str
    about: str
    places: Sequence[Place]
    options: Sequence[Option]


def parse(
    command: Command, argv: Sequence[str], groups: Mapping[str, Group]
) -> tuple[dict[str, Any], dict[str, Typed]]:
    """The words in their places, and for each group the options that were typed.

    What was typed for the command itself is there as well, under "options".

    Raises:
        InputError: `argv` cannot be understood.
        SystemExit: help was asked for, and printed.
    """
    own = {"options": Group({command.name: Entry("", command.options)}, "")}
    parser, flags = _parser(command, own | dict(groups))
    # As people type them: --log_every=10 is --log-every 10.
    spelled = [re.sub("^--[^=]*", lambda flag: flag[0].replace("_", "-"), word) for word in argv]
    many = [flag for title, group in groups.items() if group.grids for flag in flags[title]]
    entries = [name for group in groups.values() for name in group.entries]
    try:
        namespace, rest = parser.parse_known_intermixed_args(_names_before(spelled, many, entries))
    except argparse.ArgumentError as error:
        raise InputError(f"{error.argument_name}: {one_line(error.message)}") from None
    if "--help" in namespace:
        print(parser.format_help(), end="")
        raise SystemExit(0)
    for unknown in rest:
        if not unknown.startswith("-"):
            raise InputError(f"unexpected argument {shown(unknown)}")
        flag = unknown.partition("=")[0]
        near = nearest(flag, [flag for of_group in flags.values() for flag in of_group])
        hint = ELSEWHERE.get(flag, near)
        raise InputError(f"there is no option {one_line(unknown)}; {hint}")
    read = vars(namespace)
    as_words = lambda x: (x,) if isinstance(x, str) else tuple(x or ())
    typed = {
        group: {flag: as_words(read[flag]) for flag in of_group if flag in read}
        for group, of_group in flags.items()
    }
    return {key: tuple(x) if isinstance(x, list) else x for key, x in read.items() if "-" not in key}, typed


def _names_before(words: Sequence[str], many: Collection[str], entries: Collection[str]) -> list[str]:
    """The words, where the name of an entry after an option that takes `many` values goes before all such options.

    No name is such a value: `sweep cliff-walking --alpha 0.1 0.2 sarsa` is `sweep cliff-walking sarsa --alpha 0.1 0.2`.
    """
    before, names, after, option = [], [], [], ""
    for word in words:
        option = word if word.startswith("--") else option
        if option in many and word in entries:
            names.append(word)
        elif option in many or after:
            after.append(word)
        else:
            before.append(word)
    return before + names + after


class _Help(argparse.RawDescriptionHelpFormatter):
    """Help in which names such as q-learning are not broken at their hyphens."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(text, width, break_on_hyphens=False)


def _parser(
    command: Command, groups: Mapping[str, Group]
) -> tuple[argparse.ArgumentParser, dict[str, list[str]]]:
    """The parser of a command, and the options of each group. Whatever is typed stays text, in words."""
    parser = argparse.ArgumentParser(
        prog=f"jaxrl-tab {command.name}",
        usage=" ".join(["%(prog)s [OPTIONS]", *(place.metavar for place in command.places)]),
        description=command.about,
        formatter_class=_Help,
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
        exit_on_error=False,
        add_help=False,  # which would hide that its reader has gone away
    )
    parser.add_argument("-h", "--help", dest="--help", action="store_true", help="Show this text, and stop.")
    # A word such as -1e5 or -inf is a value. argparse itself would take only -1 and -0.5 for numbers.
    parser._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)")
    for place in command.places:
        count = "*" if place.many else "?"
        parser.add_argument(place.name, nargs=count, metavar=place.metavar, help=place.help)
    width = max(40, shutil.get_terminal_size().columns - 4)
    flags: dict[str, list[str]] = {}
    for title, group in groups.items():
        about = textwrap.fill(group.help, width, break_on_hyphens=False)
        section = parser.add_argument_group(title, about) if group.help else parser
        owners: dict[str, dict[str, Option]] = {}
        for name, entry in group.entries.items():
            for option in entry.options:
                owners.setdefault(option.flag, {})[name] = option
        for flag, owned in owners.items():
            try:
                section.add_argument(flag, dest=flag, **_argument(owned, group))
            except argparse.ArgumentError:
                raise InputError(
                    f"{group.owners(list(owned))} cannot have {flag} on the command line, where it means "
                    "something else: set it in a file"
                ) from None
        flags[title] = list(owners)
    return parser, flags


def _argument(owned: Mapping[str, Option], group: Group) -> dict[str, Any]:
    """How argparse takes an option that these entries have."""
    option = next(iter(owned.values()))
    help = " ".join(filter(None, [option.help, _hint(owned, group)])).replace("%", "%%")
    if not option.metavar:
        return {"action": "store_const", "const": (), "help": help}
    count = {"nargs": "+"} if group.grids or option.several else {}
    count = {"nargs": "?", "const": ()} if option.alone else count
    return count | {"metavar": option.metavar, "help": help}


def _hint(owned: Mapping[str, Option], group: Group) -> str:
    """Whose option it is where not all have it, and its defaults: the most usual first."""
    notes = [] if len(owned) == len(group.entries) else [f"of {group.owners(list(owned))}"]
    entries: dict[str, list[str]] = {}
    for entry, option in owned.items():
        entries.setdefault(option.default if option.metavar else "", []).append(entry)
    usual, *others = sorted(entries, key=lambda default: -len(entries[default]))
    if usual not in ("", NONE):
        notes += [f"default: {usual}", *(f"{other} for {group.owners(entries[other])}" for other in others)]
    return f"({'; '.join(notes)})" if notes else ""


def checked_name(kind: str, name: str, choices: Collection[str]) -> str:
    """`name`, which must be one of `choices`."""
    if not name:
        raise InputError(f"name {kind}: {listed(choices)}")
    if name not in choices:
        raise InputError(f"{shown(name)} is not {kind}; {nearest(name, choices)}")
    return name


def environments_first(
    env: str, methods: Sequence[str], environments: Collection[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of environments, and of methods: `windy-gridworld cliff-walking sarsa` has two and one."""
    more = tuple(itertools.takewhile(lambda name: name in environments, methods))
    return (env, *more), tuple(methods[len(more) :])


def check_owners(names: Sequence[str], typed: Typed, group: Group) -> None:
    """Raises InputError where none of these entries has an option that was typed; it says who has it."""
    flags = {name: group.entries[name].by_flag for name in names}
    for flag in typed:
        if not any(flag in of_entry for of_entry in flags.values()):
            owners = [other for other, entry in group.entries.items() if flag in entry.by_flag]
            who, *others = names
            has_no = f"none of {', '.join(names)} has" if others else f"{who} has no"
            hint = "" if others or not flags[who] else f"; {who} has {', '.join(flags[who])}"
            raise InputError(f"{has_no} {flag}, which belongs to {group.owners(owners)}{hint}")


def check_words(who: str, option: Option, words: Sequence[str]) -> None:
    """Raises InputError where a word is plainly no value of an option of `who`.

    What needs more than the word to tell, such as a schedule, passes.
    """
    for word in words:
        if option.choices:
            check_choice(who, option.name, word, option.choices)
        if option.takes not in NUMBERS or len(word) > 300:
            continue
        make, wanted = NUMBERS[option.takes]
        number = None
        with contextlib.suppress(ValueError):
            number = make(word)
        if number is None and option.takes != "rate":
            raise InputError(f"{option.flag} takes {wanted}, not {shown(word)}")
        if number is None or option.limits is None:
            continue
        if option.takes == "int":
            whole(who, option.name, number, int(option.limits["at_least"]))
        elif not _within(option.limits, float(number)):
            raise unfit(who, option.name, in_words(option.limits) or "a number", number)


def whole_number(text: str) -> int:
    """The number of a text that is a whole one, also written as 1e4. Raises ValueError for any other."""
    with contextlib.suppress(ValueError):
        return int(text)
    number = float(text)
    if not number.is_integer() or abs(number) > 2**53:  # above, not each whole number has a float of its own
        raise ValueError(f"{text} is not a whole number")
    return int(number)


NUMBERS = {"int": (whole_number, "a whole number"), "float": (float, "a number"), "rate": (float, "a number")}


def _within(limits: Mapping[str, float], number: float) -> bool:
    """Whether a number is finite and within the limits, as `checks.within` tells of arrays."""
    in_size = abs(number) <= sys.float_info.max if not math.isnan(number) else False
    return in_size and all(LIMITS[name][1](number, limit) for name, limit in limits.items())
