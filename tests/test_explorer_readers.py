"""The report for all its readers: on a phone, in the dark, by keyboard, by ear, whatever colours they see."""

import itertools
import re
from importlib.resources import files

import numpy as np
import pytest
from browser import Browser, needs_browser
from looking import choose, look_at, slide

import jaxrl_tab as rl
from jaxrl_tab import report

READABLE, VISIBLE = 4.5, 3.0  # contrast of text, and of what is drawn (WCAG 2.1)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def pages(explored, tmp_path_factory):
    """Reports by what is special about them: a grid, panels, a list of states."""

    def page(name, env, method, swept, **budget):
        result = rl.sweep(env, method, swept, num_seeds=3, progress=False, **budget)
        folder = tmp_path_factory.mktemp(name)
        return report.write(folder, {f"{name}/{method}": result.to_xarray()}, {name: env}, {"seeds": [1, 2]})

    many = {"alpha": [0.1, 0.2], "epsilon": [0.1, 0.2]}
    return {
        "grid": explored[0],
        "panels": page(
            "blackjack", rl.make("blackjack"), "monte-carlo", {"epsilon": [0.1, 0.2]}, num_episodes=400
        ),
        "list": page("walk", rl.RandomWalk(), "td", {"alpha": [0.1, 0.2]}, num_episodes=20, exact=True),
        "arms": page("arms", rl.make("k-armed-testbed"), "sarsa", {"epsilon": 0.1}, num_steps=200),
        "wide": page("cliff", rl.make("cliff-walking"), "sarsa", many, num_steps=3000, exact=True),
    }


@pytest.fixture
def usual(browser):
    """The browser, which is as usual afterwards."""
    yield browser
    browser.media()
    browser.resize(1200)
    assert browser.messages == []


# --- on a phone --------------------------------------------------------------------------------------
@needs_browser
@pytest.mark.parametrize("width", [320, 390, 1100])
@pytest.mark.parametrize("name", ["grid", "panels", "list", "wide", "arms"])
def test_nothing_is_wider_than_the_window(usual, pages, name, width):
    """Nor does a table have to be moved aside. Broken once: rows of a table as rows; numbers as on a desk -> fails."""
    look_at(usual, pages[name])
    usual.resize(width, 800, phone=width < 1000)
    usual.wait(f"innerWidth === {width}")
    usual.wait("$$('.card svg').every(x => x.getBoundingClientRect().right <= innerWidth)")
    assert usual("document.documentElement.scrollWidth") <= width
    assert usual("$$('.wide').filter(x => x.scrollWidth > x.clientWidth + 1).map(x => x.textContent)") == []
    # Numbers keep to their cells, and can be read.
    texts = usual("""$$('.above .v').filter(x => x.textContent.length > 1).map(x => {
        const text = x.getBoundingClientRect();
        const cell = [...$$('.cell')].find(y => {
          const box = y.getBoundingClientRect(), middle = (text.left + text.right) / 2;
          return box.left < middle && middle < box.right && box.top < text.bottom && text.bottom <= box.bottom + 1;
        })?.getBoundingClientRect();
        return [x.textContent, text.width / cell?.width, parseFloat(getComputedStyle(x).fontSize)
          * x.getScreenCTM().a];
    })""")
    assert bool(texts) == (name not in ("list", "arms"))
    for text, share, size in texts:
        assert share < 1 and size >= 8.4, text


@needs_browser
def test_rows_are_cards_on_a_phone(usual, pages):
    """Each number stands behind its name, and they sort. Broken once: names of the next column -> fails."""
    look_at(usual, pages["grid"])
    usual.resize(390, 800, phone=True)
    usual.wait("innerWidth === 390")
    for table in ("chosen-table", "settings"):
        heads = usual(f"$$('table.{table} thead th').map(x => x.textContent)")
        labels = usual(f"[...$('table.{table} tbody tr').cells].map(x => x.dataset.label || '')")
        assert labels[1:] == heads[1:] and labels[0] == ""
        shown = usual(f"getComputedStyle($('table.{table} tbody td:nth-child(2)'), '::before').content")
        assert shown == f'"{heads[1]}"'
        assert usual(f"getComputedStyle($('table.{table} tbody tr')).display") in ("block", "flex")
    assert usual("$('table.settings .sort').checkVisibility()")
    roles = [role for role, *_ in usual.read_out()]
    assert roles.count("table") >= 2 and roles.count("columnheader") >= 8  # tables they stay


@needs_browser
def test_a_tap_on_a_cell_tells_what_a_mouse_does(usual, pages):
    """What is tapped is large enough. Broken once: no pointer is listened to; points as for a mouse -> fails."""
    look_at(usual, pages["grid"])
    usual.resize(390, 800, phone=True)
    usual.wait("innerWidth === 390")
    usual("$('.panel').scrollIntoView({ block: 'center' })")
    middle = (
        "(b => [b.x + b.width / 2, b.y + b.height / 2])($('.cell[data-s=\"33\"]').getBoundingClientRect())"
    )
    usual.wait("$('.panel').getBoundingClientRect().top > 0")
    usual.tap(*usual(middle))
    usual.wait("$('.about h6').textContent === 'Row 3, column 3'")
    small = """$$('select, button, input:not([type=checkbox]), .point .halo').filter(x => x.checkVisibility())
        .map(x => x.getBoundingClientRect()).map(b => [b.width, b.height]).filter(b => b[0] < 24 || b[1] < 30)"""
    assert usual(small) == []


# --- in the dark -------------------------------------------------------------------------------------
def light(colour):
    """The relative luminance of a colour as "#rgb" or "#rrggbb"."""
    return linear(rgb(colour) / 255) @ [0.2126, 0.7152, 0.0722]


def rgb(colour):
    digits = colour.lstrip("#")
    digits = "".join(2 * x for x in digits) if len(digits) == 3 else digits
    return np.array([int(digits[i : i + 2], 16) for i in (0, 2, 4)])


def linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def contrast(a, b):
    low, high = sorted([light(a), light(b)])
    return (high + 0.05) / (low + 0.05)


def colours(mode):
    """The variables of the style sheet of all pages."""
    style = (files("jaxrl_tab.show.html") / "page.css").read_text(encoding="utf-8")
    day, night = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
    variables = re.compile(r"--([\w]+): (#\w+)")
    found = dict(variables.findall(day))
    dark = dict(variables.findall(night))
    assert dark.keys() == found.keys()
    return dark if mode == "dark" else found


@pytest.mark.parametrize("mode", ["light", "dark"])
def test_colours_have_contrast(mode):
    """Broken once: the ink of the day at night; a paler green -> fails."""
    color = colours(mode)
    for text, ground in itertools.product(
        ("ink", "soft", "accent", "good", "bad"), ("back", "card", "faint")
    ):
        assert contrast(color[text], color[ground]) >= READABLE, (text, ground)
    for i in range(7):
        assert contrast(color[f"c{i}"], color["card"]) >= VISIBLE, i
    lost = 0.9 * rgb(color["lost"]) + 0.1 * rgb(color["card"])  # the strongest that `heat.html` has
    strongest = "#" + "".join(f"{round(x):02x}" for x in lost)
    assert contrast(color["ink"], strongest) >= READABLE


@pytest.mark.parametrize("mode", ["light", "dark"])
def test_colours_of_curves_can_be_told_apart(mode):
    """By people who see no red, no green, or no blue, as Machado, Oliveira and Fernandes (2009) have it.

    No two of the seven are nearer than 0.08, in the distance of OKLab: of Okabe and Ito's own the nearest are 0.076
    apart, and some of those are too pale on white.
    Broken once: a violet like the blue -> fails.
    """
    machado = {
        "all": np.eye(3),
        "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
        "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
    }  # fmt: skip
    to_cones = [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005]]  # fmt: skip
    to_lab = [[0.2104542553, 0.793617785, -0.0040720468], [1.9779984951, -2.428592205, 0.4505937099],
              [0.0259040371, 0.7827717662, -0.808675766]]  # fmt: skip
    color = colours(mode)
    shown = linear(np.array([rgb(color[f"c{i}"]) for i in range(7)]) / 255)
    for who, seen in machado.items():
        lab = np.cbrt(np.clip(shown @ np.array(seen).T, 0, 1) @ np.array(to_cones).T) @ np.array(to_lab).T
        for i, j in itertools.combinations(range(7), 2):
            assert np.linalg.norm(lab[i] - lab[j]) >= 0.08, (who, i, j)


# Text with its colour and what is behind it: [text, contrast] where that is below `least`.
UNREADABLE = """(least => {
  const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const over = (...colours) => {
    for (const colour of colours) context.fillStyle = colour, context.fillRect(0, 0, 1, 1);
    return [...context.getImageData(0, 0, 1, 1).data].slice(0, 3).map(x => x / 255)
      .map(x => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
  };
  const light = ([r, g, b]) => 0.2126 * r + 0.7152 * g + 0.0722 * b;
  const grounds = e => e ? [...grounds(e.parentElement), getComputedStyle(e).backgroundColor] : ["white"];
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const e = walker.currentNode.parentElement;
    if (e.closest("script, option, noscript, .above") || !e.checkVisibility()) continue;
    if (!walker.currentNode.data.trim()) continue;
    const style = getComputedStyle(e), ground = grounds(e);
    const a = light(over(...ground, e.closest("svg") ? style.fill : style.color)), b = light(over(...ground));
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < least) found.push([walker.currentNode.data, contrast]);
  }
  const ink = light(over(getComputedStyle($(".above .v")).fill));
  for (const box of $$(".cell .box")) {
    const behind = light(over("white", getComputedStyle(box).fill));
    const contrast = (Math.max(ink, behind) + 0.05) / (Math.min(ink, behind) + 0.05);
    if (contrast < least) found.push([box.parentNode.dataset.s, contrast]);
  }
  return found;
})(%s)"""


@needs_browser
@pytest.mark.parametrize("mode", ["light", "dark"])
def test_all_text_can_be_read(usual, pages, mode):
    """On all there is behind it, in the strongest colours, too. Broken once: no colours of the night -> fails."""
    usual.media(colours=mode)
    look_at(usual, pages["grid"])
    ground = usual("getComputedStyle(document.body).backgroundColor")
    assert ground == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 24, 29)"}[mode]
    usual("$('.legend button').click()")  # which is then struck through
    for colour, moment in (("value", 33), ("visits", 33), ("error", 0)):
        choose(usual, ".learned", "colour", colour)
        slide(usual, moment)
        usual.wait("$$('.cell .box').every(x => x.getAnimations().length === 0)")
        assert usual(UNREADABLE % READABLE) == []


@needs_browser
def test_paper_is_white(usual, pages):
    """And narrower than the window. Broken once: colours of the night for all media; as it was drawn -> fails."""
    look_at(usual, pages["grid"])
    usual.media("print", "dark")
    assert usual("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert usual("getComputedStyle($('svg text')).fill") == "rgb(95, 102, 112)"
    usual("$('.body > svg').setAttribute('width', 3000)")  # as if drawn for such a window
    assert usual("$('.body > svg').clientWidth <= $('.body').clientWidth")
    assert not usual("$('.tool').checkVisibility()")


# --- by ear, and by keyboard -------------------------------------------------------------------------
@needs_browser
def test_everything_has_a_name_and_a_role(usual, pages):
    """Broken once: a button with a picture alone; a chart without a description -> fails."""
    for name in ("grid", "panels", "list"):
        look_at(usual, pages[name])
        nodes = usual.read_out()
        named = {"button", "combobox", "checkbox", "slider", "searchbox", "radio", "radiogroup", "region"}
        assert [node for node in nodes if node[0] in named and not node[1]] == []
        assert ("group", "Time") in {node[:2] for node in nodes}
        assert ("slider", "steps" if name == "grid" else "episodes") in {node[:2] for node in nodes}
        assert {"heading", "table", "columnheader", "combobox", "slider", "button"} <= {
            role for role, *_ in nodes
        }
        charts = usual("$$('.card svg[role]').map(x => [x.firstChild.tagName, x.children[1].tagName])")
        assert charts and all(chart == ["title", "desc"] for chart in charts)
        described = [d for role, _, d in nodes if role in ("group", "radiogroup") and d]
        assert len(described) == len(charts)
    assert usual("$$('svg:not([role])').every(x => x.ariaHidden === 'true')")
    assert usual("$$('[id]').length === new Set($$('[id]').map(x => x.id)).size")


@needs_browser
def test_the_moment_is_said_once_it_stands_still(usual, pages):
    """In a sentence. Broken once: said for each moment -> fails."""
    look_at(usual, pages["grid"])
    usual("""$$('[role=status]').forEach(box => new MutationObserver(() => (window.said = (window.said || 0) + 1))
        .observe(box, { childList: true, characterData: true, subtree: true }))""")
    for moment in range(8, 13):
        slide(usual, moment)
    said = usual.wait("$$('.unseen[role=status]').map(x => x.textContent).find(x => x.startsWith('After'))")
    numbers = usual("$$('.legend td[data-curve]').map(x => `${x.dataset.curve} ${x.textContent}`)")
    cell = usual("$('.cell.on').ariaLabel")
    assert said == f"After 780 steps. Mean return per episode: {', '.join(numbers)}. {cell.capitalize()}"
    learned = usual("$$('.about td[data-of=learned]').map(x => x.textContent)")
    assert re.match(r"row 3, column 0: (\S+), ", cell)[1] in learned
    assert usual("said") == 1
    assert usual("$('output').ariaLive") == "off"


@needs_browser
def test_sorting_is_said(usual, pages):
    """Of the methods as of the settings. Broken once: the way it went before -> fails."""
    look_at(usual, pages["grid"])
    for table in ("chosen-table", "settings"):
        for way in ("descending", "ascending"):
            usual(f"$('table.{table} .sort').click()")
            first = "ascending" if way == "descending" else "descending"  # names go from A to Z at first
            assert usual(f"$('table.{table} th').ariaSort") == first
            assert usual(
                f"$$('[role=status]').some(x => x.textContent.startsWith('sorted by method, {first}'))"
            )
            names = usual(f"$$('table.{table} tbody tr').map(x => x.cells[0].textContent.split(' ')[0])")
            assert names == sorted(names, reverse=first == "descending") and len(set(names)) == 2
    assert usual("$$('[aria-sort]').length") == 2


@needs_browser
def test_what_has_no_number_is_sorted_last(usual, pages):
    """Broken once: as the smallest of all -> fails."""
    look_at(usual, pages["grid"])
    at = usual("$$('table.chosen-table thead th').map(x => x.textContent)").index("p")
    for _ in range(2):
        usual(f"$$('table.chosen-table .sort')[{at}].click()")
        cells = usual(f"$$('table.chosen-table tbody tr').map(x => x.cells[{at}].textContent)")
        assert [cell == "–" for cell in cells] == [False, True]


@needs_browser
def test_the_keyboard_gets_everywhere(usual, pages):
    """One stop for a grid and for a picture of settings, in which the arrow keys go on; what a mouse would tell is
    told. Broken once: each point a stop; up is down -> fails."""
    look_at(usual, pages["grid"])
    usual("$('.explorer select').focus()")
    stops = []
    while usual("document.activeElement.closest('.explorer') !== null") and len(stops) < 60:
        stops.append(usual("document.activeElement.getAttribute('class') || document.activeElement.tagName"))
        outline = usual("""(e => e.matches(":focus-visible") && (e.matches(".cell, .point")
            ? getComputedStyle(e.querySelector(".box, .halo")).strokeWidth
            : getComputedStyle(e).outlineWidth))(document.activeElement)""")
        assert outline in ("3px", "4px"), stops[-1]  # where it is can be seen
        usual.key("Tab")
    assert [stops.count(kind) for kind in ("cell on", "point here")] == [1, 1]
    usual("$('.point.here').focus()")
    before = usual("$('.told').textContent")
    assert before == usual("document.activeElement.ariaLabel") and "8 seeds" in before
    usual.key("ArrowLeft")
    after = usual("$('.told').textContent")
    assert after == usual("document.activeElement.ariaLabel") != before
    usual.key("Enter", "\r")
    usual.wait("$('.point.here') === document.activeElement")  # the points are drawn anew
    assert usual("$('.told').textContent") == after
    choose(usual, ".chosen", "method", "0")
    choose(usual, ".settings", "picture", "heat")
    usual("$$('.point')[0].focus()")
    usual.key("ArrowUp")
    usual.key("ArrowRight")
    assert usual("document.activeElement.dataset.setting") == "0-3"  # the second alpha, the second epsilon
