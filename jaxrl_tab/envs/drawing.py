"""Drawn maps: rows of letters, a legend that says what letters mean, and what is wrong with either.

As text, a map is its rows, and below them a line for each letter and each setting:

    S..O.
    .#..G

    O: reward -10, terminal
    step_reward: 0
    slip: 2/3
"""

import os
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core import describe
from jaxrl_tab.core.errors import InputError, nearest, shown, unfit

WALL, START, GOAL, FREE = "#", "S", "G", ". "
SETTINGS = ("step_reward", "goal_reward", "bump_reward", "slip", "wind")  # that a text may have below its map
MAPS = {path.stem: path for path in sorted((Path(__file__).parent / "maps").glob("*.txt"))}


class Letter(NamedTuple):
    """What the legend says of the cells with a letter; by default they are free cells.

    Attributes:
        reward: of a step that ends there; of a door, of passing it. None: as everywhere.
        terminal: whether the episode ends there.
        slip, wind: of the moves made there, as of `Maze`; None: as everywhere.
        to: the letter of the cell where one is put who enters; empty where one stays.
        jump: the letter of the cell to which every move leads that is made there; empty where it is as any.
    """

    reward: float | None = None
    terminal: bool = False
    slip: float | None = None
    wind: int | None = None
    to: str = ""
    jump: str = ""

    @property
    def words(self) -> str:
        """As it stands in a text."""
        said = [
            "terminal" if value is True else f"{name} {value!s}".removesuffix(".0")
            for name, value, default in zip(self._fields, self, self.__new__.__defaults__ or (), strict=True)
            if value != default
        ]
        return ", ".join(said) or "free"


Legend = dict[str, Letter]
_NUMBERS = ("reward", "slip", "wind")


class Drawn(NamedTuple):
    """What is in a text: the rows, what the letters mean, and the settings, as `Maze` has them."""

    rows: tuple[str, ...]
    legend: Legend
    settings: dict[str, Any]


def name_of(written: Any) -> str:
    """The name that is written in place of a map, that of a file or of a map of ours; empty where it is drawn."""
    words = describe.lines_of(written) or []
    word = words[0] if len(words) == 1 and isinstance(words[0], str) else ""
    is_alone = isinstance(written, str | os.PathLike)
    return word if is_alone or is_name(word) or word.islower() else ""


def is_name(word: str) -> bool:
    """Whether a word names a map of ours, or a file: then it is no row of a map."""
    return word in MAPS or word.endswith(".txt")


def read(who: str, written: Any) -> Drawn:
    """A map from its name, the name of its file, its text, or its lines. Raises InputError where it is none."""
    name = name_of(written)
    if name and name not in MAPS and not name.endswith(".txt"):
        choices = f"choose one of {', '.join(MAPS)}, a file such as maze.txt, or draw its rows in a list"
        raise InputError(
            f"there is no map {shown(name)}; {nearest(name, MAPS, choices)}", who=who, field="map"
        )
    lines = describe.lines_of(describe.read_lines(str(MAPS.get(name, name))) if name else written)
    if lines is None or not all(isinstance(line, str) for line in lines):
        raise unfit(who, "map", "a name, or the rows of one map as texts", written)
    if len(lines) > 1 and (names := [line for line in lines if is_name(line)]):
        problem = f"{shown(names[0])} names a map, and stands among the rows of one"
        if len(names) == len(lines):
            written = ", ".join(f"[{name!r}]" for name in names)
            problem = (
                f"it has one map, and {len(names)} are named; a sweep tries several, in a file as [{written}]"
            )
        raise InputError(problem, who=who, field="map")
    first = next((i for i, line in enumerate(lines) if ":" in line), len(lines))
    rows, settings = _rows(lines[:first]), {}
    about = [line for line in lines[first:] if line.strip()]
    for line in [line for line in about if _is_setting(line)]:
        key, _, value = line.partition(":")
        name = key.strip().replace("-", "_").replace(" ", "_")
        if name not in SETTINGS:
            problem = f"{shown(line)} below the map is neither a letter with its meaning nor a setting"
            raise InputError(f"{problem}; {nearest(name, SETTINGS)}", who=who, field="map")
        numbers = [_number(who, name, word) for word in value.split()]
        if name != "wind" and len(numbers) != 1:
            raise InputError(
                f"{name} below the map must be one number, not {shown(value)}", who=who, field="map"
            )
        settings[name] = tuple(numbers) if name == "wind" else numbers[0]
    return Drawn(rows, read_legend(who, [x for x in about if not _is_setting(x)]), settings)


def read_legend(who: str, written: Any) -> Legend:
    """A legend from lines such as "O: reward -10, terminal", or from a dict of dicts or texts."""
    if isinstance(written, Mapping):
        pairs = list(written.items())
    else:
        lines = describe.lines_of(written)
        if lines is None:
            raise unfit(who, "legend", "a table, or lines such as 'O: reward -10, terminal'", written)
        pairs = [(key.strip(), value) for key, _, value in (str(line).partition(":") for line in lines)]
    legend: Legend = {}
    for letter, meaning in pairs:
        if not isinstance(letter, str) or len(letter) != 1 or not letter.isprintable() or letter in "#SG. ,:":
            problem = f"the legend is of single letters, but for # S G . , and :, not of {shown(letter)}"
            raise InputError(problem, who=who, field="legend")
        if letter in legend:
            raise InputError(f"the legend has {letter!r} twice", who=who, field="legend")
        legend[letter] = _letter(who, letter, meaning)
    return legend


def as_lines(legend: Legend) -> tuple[str, ...]:
    """A legend as the lines from which it is read again."""
    return tuple(f"{letter}: {meaning.words}" for letter, meaning in legend.items())


def check_rows(who: str, rows: Sequence[str], legend: Legend) -> None:
    """Raises InputError unless the rows are a rectangle of known letters, and doors lead to one cell."""
    fail = lambda problem: InputError(problem, who=who, field="map")
    known = "#SG. " + "".join(letter + of.to + of.jump for letter, of in legend.items())
    if not rows or not rows[0]:
        raise fail("the map has no cells")
    for i, row in enumerate(rows):
        if len(row) != len(rows[0]):
            hint = "; write '.' for free cells at the end of a row" if len(row) < len(rows[0]) else ""
            cells = "1 cell" if len(row) == 1 else f"{len(row)} cells"
            raise fail(f"row {i} has {cells}, and row 0 has {len(rows[0])}{hint}")
        for k, letter in enumerate(row):
            if letter not in known:
                there_are = " ".join(["# S G .", *legend])
                problem = (
                    f"row {i}, column {k}: the letter {letter!r} is not in the legend; there are {there_are}"
                )
                raise fail(f'{problem}; write what it means, as in "{letter}: reward -10, terminal"')
    every = "".join(rows)
    for letter in filter(every.__contains__, legend):
        of = legend[letter]
        if not (target := of.to or of.jump):
            continue
        if target == WALL or (target in legend and (legend[target].to)):
            raise fail(f"{letter!r} leads to {target!r}, where nobody can stand")
        if (count := every.count(target)) != 1:
            raise fail(f"{letter!r} leads to {target!r}, which must be one cell, and there are {count}")


def number(who: str, what: str, value: Any) -> float:
    """`value` as a float. Raises InputError unless it is one finite number."""
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float | np.integer | np.floating)
        or not abs(value) < 1e30
    ):
        raise unfit(who, what, "a number", value)
    return float(value)


def whole_rows(who: str, what: str, value: Any) -> int:
    """`value` as a number of rows, upwards. Raises InputError unless it is a whole number."""
    cells = number(who, what, value)
    if cells != round(cells):
        raise unfit(who, what, "whole numbers of cells", value)
    return round(cells)


def _rows(lines: Sequence[str]) -> tuple[str, ...]:
    """The rows of a map, without empty lines around them."""
    full = [i for i, line in enumerate(lines) if line]
    return tuple(lines[full[0] : full[-1] + 1]) if full else ()


def _is_setting(line: str) -> bool:
    return len(line.partition(":")[0].strip()) > 1


def _number(who: str, what: str, word: str) -> float:
    """A number as it is typed, "-10" or "2/3"."""
    try:
        return number(who, what, float(Fraction(word)))
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise error if isinstance(error, InputError) else unfit(who, what, "a number", word) from None


def _letter(who: str, letter: str, meaning: Any) -> Letter:
    """What is said of a letter, as a text or as a dict."""
    if isinstance(meaning, str):
        parts = [part.split() for part in meaning.split(",") if part.split() not in ([], ["free"])]
        if wrong := [part for part in parts if len(part) != (1 if part[0] == "terminal" else 2)]:
            raise _unclear(who, letter, " ".join(wrong[0]))
        meaning = {part[0]: part[-1] if len(part) == 2 else True for part in parts}
    if not isinstance(meaning, Mapping):
        raise unfit(who, f"the legend of {letter!r}", "a text or a table", meaning)
    for key in meaning:
        if key not in Letter._fields:
            raise _unclear(who, letter, key)
    values = {key: _meaning(who, f"the {key} of {letter!r}", key, x) for key, x in meaning.items()}
    of = Letter(**values)
    if bool(of.to) + bool(of.jump) + of.terminal > 1:
        raise InputError(f"{letter!r} can be one of terminal, to and jump", who=who, field="legend")
    if of.slip is not None and not 0 <= of.slip <= 1:
        raise unfit(who, f"the slip of {letter!r}", "between 0 and 1", of.slip)
    return of


def _meaning(who: str, what: str, key: str, value: Any) -> Any:
    """What the legend says under one key, as a `Letter` has it."""
    if key in _NUMBERS:
        read = _number(who, what, value) if isinstance(value, str) else number(who, what, value)
        return whole_rows(who, what, read) if key == "wind" else read
    if key == "terminal":
        if not isinstance(value, bool):
            raise unfit(who, what, "true or false", value)
        return value
    if not isinstance(value, str) or len(value) != 1:
        raise unfit(who, what, "the letter of a cell", value)
    return value


def _unclear(who: str, letter: str, said: Any) -> InputError:
    hint = 'a letter can be "reward -10", "terminal", "slip 0.2", "wind 1", "to X", "jump X", or "free"'
    return InputError(f"the legend says {shown(said)} of {letter!r}; {hint}", who=who, field="legend")
