"""Where in a TOML file something is wrong."""

import bisect
import contextlib
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from jaxrl_tab.core.errors import InputError, one_line

DEEPEST = 32  # levels of nested brackets, and parts of a dotted key


class Source(NamedTuple):
    """Where an experiment was read from.

    Attributes:
        path: the file. Paths in it start from its folder.
        text: what stood in it.
        pinned: names in it whose meaning is settled -> that, as `sources.read` gives it.
    """

    path: Path
    text: str
    pinned: Mapping[str, Mapping[str, Any]] = MappingProxyType({})

    def __str__(self) -> str:
        return one_line(str(self.path))


@contextlib.contextmanager
def at(*path: str | int) -> Iterator[None]:
    """Puts `path` before the path of an InputError that is raised inside the block."""
    try:
        yield
    except InputError as error:
        error.path = (*path, *error.path)
        raise


@contextlib.contextmanager
def blame(names: Collection[Any]) -> Iterator[None]:
    """Makes the wrong field the path of an InputError from the block, where that is one of `names`."""
    try:
        yield
    except InputError as error:
        error.path = (error.field,) if error.field is not None and error.field in names else ()
        raise


@contextlib.contextmanager
def located(source: Source | None) -> Iterator[None]:
    """Adds the file and the line to an InputError that is raised inside the block, if there is a file."""
    try:
        yield
    except InputError as error:
        if not source:
            raise
        line = _line(source, error.path)
        where = f"{source}, line {line}" if line else f"{source}"
        raise error.renamed(f"{where}: {error.who}" if error.who else where) from None


# What a file is made of as far as it must be known where statements end: texts, comments, and single characters.
_PIECE = re.compile(
    r'''"""(?:\\.|[^\\])*?(?:"{3,5}|\Z)|'{3}.*?(?:'{3,5}|\Z)|"(?:\\.|[^"\\\n])*"?|'[^'\n]*'?|\#[^\n]*|[][{}=.,\n]''',
    re.DOTALL,
)


class _Statement(NamedTuple):
    line: int  # on which it begins
    end: int  # of the text up to and with it


def split_statements(source: Source) -> list[_Statement]:
    """The statements of a file, blank lines among them; the last one may be left open.

    tomllib tells the line of a mistake in the syntax, but not where a key stands, nor where a bracket was opened
    that is never closed. But the beginning of a file, up to the end of any statement, is TOML itself.

    Raises:
        InputError: brackets are in one another, or a key has parts, beyond `DEEPEST`.
    """
    statements, line, first, depth, parts = [], 1, 1, 0, 0
    for piece in _PIECE.finditer(source.text):
        text = piece[0]
        depth += (text in ("[", "{")) - (text in ("]", "}"))
        parts = parts + 1 if text == "." else parts if text[0] in "\"'" else 0
        if max(depth, parts) > DEEPEST:
            what = "brackets are in one another" if depth > DEEPEST else "parts are in a key"
            raise InputError(f"{source}, line {line}: more than {DEEPEST} {what}")
        line += text.count("\n")
        if text == "\n" and depth <= 0:
            statements.append(_Statement(first, piece.end()))
            first, depth = line, 0
    if not statements or statements[-1].end < len(source.text):
        statements.append(_Statement(first, len(source.text)))
    return statements


def _line(source: Source, path: Sequence[str | int]) -> int | None:
    """The line on which what is at `path` begins, or as much of the way there as there is."""
    data = tomllib.loads(source.text)
    while path and not _has_entry(data, path):
        path = path[:-1]
    if not path:
        return None
    # What is at the path stays there as the file goes on: so the first statement with which it is there is found
    # by bisection. To parse the file up to each statement would take half a minute for 2,400 lines.
    has_entry = lambda statement: _has_entry(tomllib.loads(source.text[: statement.end]), path)
    statements = split_statements(source)
    return statements[bisect.bisect_left(statements, True, key=has_entry)].line


def _has_entry(data: Any, path: Sequence[Any]) -> bool:
    """Whether there is something at `path` in the data."""
    for key in path:
        if isinstance(key, int) and not isinstance(data, list):
            continue  # a single table stands for a list of one
        try:
            data = data[key]
        except (LookupError, TypeError):
            return False
    return True
