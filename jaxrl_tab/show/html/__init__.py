"""Pages that a browser shows without any other file: scripts, fonts and style sheets are not needed."""

from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def render(template: str, **values: Any) -> str:
    """The page that a template of this folder makes; text in `values` is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("jaxrl_tab.show.html", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return templates.get_template(template).render(values)


def as_data(content: bytes, mime: str) -> str:
    """The address of a file that holds the file itself (a data URI)."""
    return f"data:{mime};base64,{b64encode(content).decode('ascii')}"


def embedded(figure: "Figure", kind: Literal["svg", "png"]) -> str:
    """A figure as the address of a picture that holds the picture itself (a data URI).

    SVG is sharp at any size; PNG is smaller where there are hundreds of texts. The same figure gives the same
    bytes.
    """
    import matplotlib as mpl

    from jaxrl_tab.show.style import lay_out

    lay_out(figure)
    file, date = BytesIO(), {"svg": {"Date": None}, "png": None}
    with mpl.rc_context({"svg.hashsalt": "jaxrl_tab"}):
        figure.savefig(file, format=kind, metadata=date[kind])
    mime = {"svg": "image/svg+xml", "png": "image/png"}[kind]
    return as_data(file.getvalue(), mime)
