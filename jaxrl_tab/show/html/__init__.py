"""Pages that a browser shows without any other file.

What stands in a page may come from anybody: names out of a TOML file, or a path. So text is escaped, data are JSON
in which nothing can end its element, and the page itself says what a browser may run and load (its Content
Security Policy): the one style and the one script that are in it, by their checksums, and pictures
that are in it or lie beside it.
"""

import json
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from importlib.resources import files
from typing import Any

# Of a page in which one looks around: what comes later uses what comes before.
EXPLORER = tuple(
    f"explorer/{name}.js"
    for name in [
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
    ]
)


def render(template: str, *, styles: Sequence[str] = (), scripts: Sequence[str] = (), **values: Any) -> str:
    """The page that a template of this folder makes; text in `values` is escaped.

    Args:
        template: its name.
        styles: the names of style sheets of this folder, after that of all pages.
        scripts: the names of what the page runs, joined in this order.
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
    script = '\n"use strict";\n(() => {\n' + "\n".join(_read(name) for name in scripts) + "})();\n"
    page = {
        "policy": f"default-src 'none'; img-src 'self' file: data:; style-src {_checksum(style)}; "
        + (f"script-src {_checksum(script)}" if scripts else "script-src 'none'"),
        "style": Markup(style),
        "script": Markup(script),
    }
    return templates.get_template(template).render(**page, **values)


def as_json(data: Any) -> Any:
    """Data as JSON that can stand in a script element: nothing in it ends that, or begins a comment."""
    from markupsafe import Markup

    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


def as_data(content: bytes, mime: str) -> str:
    """The address of a file that holds the file itself (a data URI)."""
    return f"data:{mime};base64,{b64encode(content).decode('ascii')}"


def _read(name: str) -> str:
    return (files(__name__) / name).read_text(encoding="utf-8")


def _checksum(text: str) -> str:
    """As a Content Security Policy names what stands in a page."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"
