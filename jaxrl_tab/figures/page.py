"""The page that shows many figures: their pictures, and the numbers that they must show."""

from collections.abc import Mapping, Sequence

from jaxrl_tab.figures.figure import EXACT, Check, Figure
from jaxrl_tab.show.html import render
from jaxrl_tab.show.words import six_digits


def page(checked: Mapping[str, tuple[Figure, Sequence[Check]]], version: str) -> str:
    """An HTML page of the figures by their names, each with its checks; its picture is beside it, NAME.png and .pdf.

    The page needs nothing else: no script, no font, no style sheet.
    """
    return render("figures.html", figures=checked, differ=differing(checked), version=version, cells=cells)


def differing(checked: Mapping[str, tuple[Figure, Sequence[Check]]]) -> list[tuple[str, Check]]:
    """What was published and does not come out, each with the name of its figure."""
    return [
        (name, check)
        for name, (_, checks) in checked.items()
        for check in checks
        if check.reproduces is False
    ]


def cells(check: Check) -> tuple[str, ...]:
    """A check as text: number, published, got, its standard error, expected, its standard error, apart."""
    bound = {"is": "", "at most": "≤ ", "at least": "≥ "}[check.relation]
    apart = f"{check.apart:.2f}"
    if check.ok and not check.standard_error:
        apart = "equal" if check.relation == "is" else "holds"
    return (
        check.what,
        check.published or "",
        six_digits(check.got),
        _error(check.standard_error),
        bound + six_digits(check.expected),
        # An exact number is compared up to the rounding of the one expected, which then is no standard error.
        _error(check.expected_standard_error if check.standard_error else 0),
        apart,
    )


def _error(standard_error: float) -> str:
    return f"{standard_error:.2g}" if standard_error > EXACT else "exact"
