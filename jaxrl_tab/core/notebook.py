"""Objects as people see them: short in a line, and as a table in a notebook."""

import dataclasses
import html
import inspect
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from jaxrl_tab.core.checks import as_array, explained
from jaxrl_tab.core.errors import shown

FEW = 12  # numbers of an array that are shown
LEFT = ' style="text-align: left"'


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in HTML under a title. All is text: what looks like HTML in it is escaped."""
    line = lambda tag, cells: "".join(f"<{tag}{LEFT}>{html.escape(cell)}</{tag}>" for cell in cells)
    body = "\n".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    return (
        f"<p>{html.escape(title)}</p>\n<table>\n<thead><tr>{line('th', head)}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody>\n</table>"
    )


class Shown:
    """A dataclass that shows the fields that are not as they are by default, and in a notebook all of them.

    It is a base of methods and environments.
    """

    def __repr__(self) -> str:
        values = {f.name: (f.default, getattr(self, f.name)) for f in dataclasses.fields(self)}  # pyright: ignore[reportArgumentType]
        own = [f"{name}={_short(x)}" for name, (default, x) in values.items() if not _same(x, default)]
        return f"{type(self).__name__}({', '.join(own)})"

    def _repr_html_(self) -> str:
        about = inspect.cleandoc(type(self).__doc__ or "").partition("\n")[0]
        fields = dataclasses.fields(self)  # pyright: ignore[reportArgumentType]
        rows = [(f.name, _short(getattr(self, f.name)), explained(f)) for f in fields]
        return table(f"{type(self).__name__}: {about}", ("parameter", "value", "what it is"), rows)


def _short(x: Any) -> str:
    """A value in a few characters; a large array by its kind and its shape."""
    array = as_array(x)
    if array is None or array.ndim == 0 or array.dtype.kind not in "biuf":
        return shown(x)
    return str(array.tolist()) if array.size <= FEW else f"{array.dtype}{list(array.shape)}"


def _same(x: Any, default: Any) -> bool:
    """Whether a field has its default value, be it kept in another form."""
    if x is default:
        return True
    one, other = as_array(x), as_array(default)
    if one is None or other is None:  # it is traced
        return False
    if one.dtype.kind in "biuf" and other.dtype.kind in "biuf":
        return other.shape in ((), one.shape) and bool(np.all(one == other))
    return repr(x) == repr(default) or str(x) == default
