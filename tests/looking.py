"""Looking at a report in a browser, as its readers do."""

import json

import pytest


def look_at(browser, file, address=""):
    browser.messages.clear()
    browser.resize(1200)
    browser.open(file, address)
    browser.wait("$('.explorer')?.dataset.ready === 'yes'")


def choose(page, card, name, value):
    """Chooses a value in the list of this name, and tells the page as a user's choice would."""
    page(
        f"""(() => {{
        const labels = [...$$({json.dumps(card + " label.field")})];
        const box = labels.find(label => label.textContent.startsWith({json.dumps(name)})).querySelector("select");
        box.value = {json.dumps(value)};
        if (box.value !== {json.dumps(value)}) throw Error("no such choice");
        box.dispatchEvent(new Event("change", {{ bubbles: true }}));
        }})()"""
    )


def slide(page, moment):
    page(f"(s => {{ s.value = {moment}; s.dispatchEvent(new Event('input')) }})($('.player input'))")


def number(text):
    return float(text.replace("−", "-").replace("\u202f", "").replace("∞", "inf").replace("–", "nan"))


def at_cursor(page):
    """What the legend of the curves says: name -> number."""
    cells = page("$$('.legend td[data-curve]').map(x => [x.dataset.curve, x.textContent, x.dataset.value])")
    for _, text, value in cells:
        if value is not None:
            assert number(text) == pytest.approx(float(value), rel=1e-3, nan_ok=True)
    return {name: float(value) for name, _, value in cells if value is not None}


def column_of(page, what):
    """The numbers of a column of the table of the cell that is looked at."""
    return [number(x) for x in page(f"$$('.about td[data-of=\"{what}\"]').map(x => x.textContent)")]
