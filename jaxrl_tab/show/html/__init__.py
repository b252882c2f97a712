"""Pages that a browser shows without any other file.

What stands in a page may come from anybody: names out of a TOML file, or a path. So text is escaped, data are JSON
in which nothing can end its element, and the page itself says what a browser may run and load (its Content
Security Policy): the one style and the one script that are in it, by their checksums, and pictures
that lie beside it.
"""

import json
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from importlib.resources import files
from typing import Any

# In the order in which they are joined to one script.
SCRIPTS = (
    "data",
    "elements",
    "axes",
    "curves",
    "settings",
    "states",
    "scene",
    "python",
    "listing",
    "explorer",
)


def render(template: str, *, styles: Sequence[str] = (), script: str = "", **values: Any) -> str:
    """The page that a template of this folder makes; text in `values` is escaped.

    Args:
        template: its name.
        styles: the names of style sheets of this folder, after that of all pages.
        script: what the page runs.
        values: what the template asks for.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    templates = Environment(
        loader=PackageLoader("jaxrl_tab.show.html", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style = "\n" + "".join(_read(name) for name in ("page.css", *styles))
    page = {
        "policy": f"default-src 'none'; img-src 'self' file:; style-src {_checksum(style)}"
        + (f"; script-src {_checksum(script)}" if script else ""),
        "style": Markup(style),
        "script": Markup(script),
    }
    return templates.get_template(template).render(**page, **values)


def explorer_script() -> str:
    """The script of a page in which one looks around."""
    parts = "\n".join(_read(f"explorer/{name}.js") for name in SCRIPTS)
    return f'\n"use strict";\n(() => {{\n{parts}}})();\n'


def as_json(data: Any) -> Any:
    """Data as JSON that can stand in a script element: nothing in it ends that, or begins a comment."""
    from markupsafe import Markup

    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


def _read(name: str) -> str:
    return (files(__name__) / name).read_text(encoding="utf-8")


def _checksum(text: str) -> str:
    """As a Content Security Policy names what stands in a page."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"
