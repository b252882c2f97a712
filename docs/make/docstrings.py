"""How docstrings, which are written as plain text, are read for the site: formulas stand out, and `q*` is no emphasis.

Formulas are text in the sources, `Q(S, A) <- Q(S, A) + alpha delta`, and are set here as HTML: no script, no font and
no file from elsewhere is needed to read them.
"""

import html
import re
import textwrap
from typing import Any

GREEK = {
    **{
        "alpha": "α",
        "beta": "β",
        "gamma": "γ",
        "delta": "δ",
        "epsilon": "ε",
        "eta": "η",
        "theta": "θ",
        "kappa": "κ",
    },
    **{"lambda": "λ", "mu": "μ", "pi": "π", "rho": "ρ", "sigma": "σ", "tau": "τ"},
}
SIGNS = {name: f"<i>{sign}</i>" for name, sign in GREEK.items()} | {
    "sum": "Σ",
    "sqrt": "√",
    "grad": "∇",
    "<-": "←",
    "!=": "≠",
    ">=": "≥",
    "<=": "≤",
    "-": "−",
    "R-bar": '<i style="text-decoration: overline">R</i>',
}
TOKEN = re.compile(r"R-bar|<-|!=|>=|<=|\.\.\.|[_^]\{[^}]*\}|[_^][\w*]+'*|[A-Za-z]+|[0-9.]+|\s+|.")
SOURCE = re.compile(r" {3,}(\(.*\))$")  # where a formula is from stands behind it, after some blanks
LEFT = r"(increment of )?[A-Za-z][\w-]*\*?(_\{[^}]*\}|\^\{[^}]*\})?(\([^()]*\))?"
FORMULA = re.compile(rf"{LEFT} (<-|=|~) (?!\S+ (is|and|was) )")


def prepared(docstring: str) -> str:
    """Markdown of a docstring: formulas in blocks of their own, and signs that are not meant for Markdown escaped."""
    paragraphs = re.split(r"\n[ \t]*\n", docstring)
    return "\n\n".join(_paragraph(paragraph) for paragraph in paragraphs)


def _paragraph(text: str) -> str:
    lines = text.splitlines()
    indent = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
    if indent and not (
        indent == 4 and "<-" in text
    ):  # a block of code, or a paragraph of a section such as Args
        return text
    lines = textwrap.dedent(text).splitlines()
    count = 0
    while count < len(lines) and _is_formula(lines[count], bool(count)):
        count += 1
    prose = "\n".join(_escaped(line) for line in lines[count:])
    return "\n\n".join(
        filter(None, ["\n".join(["```formula", *lines[:count], "```"]) if count else "", prose])
    )


def _is_formula(line: str, continues: bool) -> bool:
    return bool(FORMULA.match(line) or SOURCE.search(line) or (continues and line.startswith("    ")))


def _escaped(line: str) -> str:
    """`q*`, `v*(s)` and `P[s][a]` as they are, outside code."""
    parts = line.split("`")
    parts[::2] = [re.sub(r"(?<=\w)\*(?![*\w])|(?<=\])\[", r"\\\g<0>", part) for part in parts[::2]]
    return "`".join(parts)


def formula(source: str, *_: Any, **__: Any) -> str:
    """The HTML of formulas, a line each: a fence of Markdown, so its signature is that of `pymdownx.superfences`."""
    return f'<div class="formula">{"".join(map(_line, source.splitlines()))}</div>'


def _line(line: str) -> str:
    if (alone := line.strip()).startswith("(") and alone.endswith(")") and not re.search(r"[=+]", alone):
        return f'<p class="source">{html.escape(alone)}</p>'
    source = SOURCE.search(line)
    text = line[: source.start()] if source else line
    behind = f' <span class="source">{html.escape(source[1])}</span>' if source else ""
    deeper = ' class="deeper"' if line.startswith("    ") else ""
    return f"<p{deeper}>{typeset(text.strip())}{behind}</p>"


def typeset(text: str) -> str:
    """A formula as HTML: letters in italics, Greek ones by their signs, indices below and powers above."""
    return "".join(_token(token) for token in TOKEN.findall(text))


def _token(token: str) -> str:
    if token in SIGNS:
        return SIGNS[token]
    if token[0] in "_^" and len(token) > 1:
        tag = "sub" if token[0] == "_" else "sup"
        return f"<{tag}>{typeset(token[1:].strip('{}'))}</{tag}>"
    return f"<i>{token}</i>" if len(token) == 1 and token.isalpha() else html.escape(token, quote=False)


try:
    import griffe
except ImportError:  # the tests look at formulas, and need no tools of the site
    pass
else:

    class Docstrings(griffe.Extension):
        """Prepares every docstring that the site shows."""

        def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
            if obj.docstring:
                obj.docstring.value = prepared(obj.docstring.value)
