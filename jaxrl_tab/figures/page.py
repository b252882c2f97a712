"""The page that shows many figures: their pictures, and the numbers that they must show."""

from collections.abc import Mapping, Sequence

from jaxrl_tab.figures.figure import Check, Figure


def page(checked: Mapping[str, tuple[Figure, Sequence[Check]]], version: str) -> str:
    """An HTML page of the figures by their names, each with its checks; its picture is beside it, NAME.png.

    The page needs nothing else: no script, no font, no style sheet.
    """
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("jaxrl_tab.figures", ".")
    templates = Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    templates.globals["cells"] = cells
    return templates.get_template("page.html").render(figures=checked, version=version)


def cells(check: Check) -> tuple[str, ...]:
    """A check as text: number, got, its standard error, expected, its standard error, apart."""
    bound = {"is": "", "at most": "≤ ", "at least": "≥ "}[check.relation]
    apart = f"{check.apart:.2f}"
    if check.ok and not check.standard_error:
        apart = "equal" if check.relation == "is" else "holds"
    return (
        check.what,
        six_digits(check.got),
        f"{check.standard_error:.2g}" if check.standard_error else "exact",
        bound + six_digits(check.expected),
        _expected_error(check),
        apart,
    )


def _expected_error(check: Check) -> str:
    if check.relation != "is":
        return "bound"
    return f"{check.expected_standard_error:.2g}" if check.standard_error else "exact"


def six_digits(x: float) -> str:
    """`x` with six significant digits; what is rounding around 0 is 0."""
    return f"{round(x, 9) + 0:.6g}"
