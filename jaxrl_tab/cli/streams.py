"""Standard output and standard error, whatever they are connected to."""

import codecs
import contextlib
import io
import json
import os
import sys
from typing import Any, TextIO

from rich.console import Console

PROG = "jaxrl-tab"


def prepare_streams() -> None:
    """Makes stdout and stderr take all that may be printed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # it was closed
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  for as long as we run
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="lookalikes" if name == "stdout" else "backslashreplace")


def console() -> Console:
    """Where tables are printed. Text such as :100: is no emoji; a pipe or a file has room for all columns."""
    return Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else 160)


def too_narrow(characters: int) -> str:
    """What stands below a table that a window cuts off."""
    return f"The window is too narrow, and cuts columns off: {characters} characters are needed."


def print_json(value: Any) -> None:
    utf8 = (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    print(json.dumps(value, ensure_ascii=not utf8, indent=1))


LOOKALIKES = {"↑": "^", "→": ">", "↓": "v", "←": "<", "↗": "ne", "↘": "se", "↙": "sw", "↖": "nw", "·": "."}
LOOKALIKES |= {
    "–": "-",
    "−": "-",
    "±": "+-",
    "×": "x",
    "ε": "epsilon",
    "α": "alpha",
    "λ": "lambda",
    "γ": "gamma",
    "δ": "delta",
    "…": "...",
    "●": "@",
    "○": "o",
    "□": "#",
    "⋮": ":",
    "π": "pi",
    "²": "^2",
    "✓": "ok",
    "✗": "!!",
}
LOOKALIKES |= {"│": "|", "─": "-", "╱": "/", "╲": "\\"} | dict.fromkeys("┌┐┴╰╯┼", "+")


def _lookalikes(error: UnicodeError) -> tuple[str, int]:
    """What an encoding lacks, in characters that every one has."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    return "".join(LOOKALIKES.get(character, "?") for character in lacking), error.end


codecs.register_error("lookalikes", _lookalikes)


def give_up(stream: TextIO) -> None:
    """Discards what cannot be written to a stream: Python would flush it once more at its end, and fail."""
    with contextlib.suppress(OSError, ValueError):  # as where a test has put something else in its place
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def complain(what: str, error: BaseException, code: int = 1) -> int:
    """Prints one line on stderr, with the notes of the error, if that is possible. Returns the exit code."""
    try:
        # JAX adds a note of several lines, on its own frames, to whatever is raised within its functions.
        notes = [note for note in getattr(error, "__notes__", ()) if "\n" not in note]
        line = "; ".join([what, *notes])
        print(f"{PROG}: {line}", file=sys.stderr, flush=True)
    except OSError:
        give_up(sys.stderr)
    return code
