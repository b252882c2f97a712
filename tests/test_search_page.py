"""What a search shows of itself: who was left is by hand, and it stands in the picture and in the report."""

import numpy as np
import pytest
from made_up import make_result

from jaxrl_tab import report
from jaxrl_tab.experiment.searching import Tried
from jaxrl_tab.show import search_curves, search_page, searched
from jaxrl_tab.stats.columns import by_environment

# Of four settings two go on, and of these the one that was second is found: by hand.
SETTINGS = [{"alpha": 0.01, "epsilon": 0.1}, {"alpha": 0.1, "epsilon": 0.2}, {"alpha": 0.5, "epsilon": 0.1}]
SETTINGS.append({"alpha": 1.0, "epsilon": 0.25})
FIRST, LAST = [3.0, 7.0, 5.0, None], {1: -21.5, 2: -20.0}


def tried(method="sarsa", settings=SETTINGS):
    rows = [
        Tried(method, i, settings[i], 0, 0, 90, 3, "episodes", x, 0, i in LAST) for i, x in enumerate(FIRST)
    ]
    return rows + [
        Tried(method, i, settings[i], 0, 1, 270, 3, "score", x, 0, i == 2) for i, x in LAST.items()
    ]


def test_ways_are_those_by_hand():
    (ways,) = searched.ways(tried())
    assert ways.rungs == [(90, 3, 4, "episodes, second half"), (270, 3, 2, "score")]
    assert [(way.number, way.ranks, way.found) for way in ways.all] == [
        (2, (2, 1), True),
        (1, (1, 2), False),
        (0, (3,), False),
        (3, (4,), False),
    ]
    assert ways.all[0].scores == ("5", "−20") and ways.all[3].scores == ("–",)
    assert ways.axes == ["alpha", "epsilon"] and searched.wide([ways]) == {"alpha"}
    assert searched.decades(0.01, 1) == pytest.approx([0.01, 0.03, 0.1, 0.3, 1])


def test_settings_that_are_no_numbers_lie_nowhere():
    (ways,) = searched.ways(tried(settings=[one | {"epsilon": "glie"} for one in SETTINGS]))
    assert ways.axes == []
    section = search_page.section(tried(settings=[{"alpha": 0.1}] * 4), "steps", {}, 3, "mean return")
    assert [one.title for one in section.methods[0].drawings] == ["Who was left, rung after rung"]


def test_drawings_have_each_setting_in_its_place():
    """Broken once: the best at the bottom, or without the logarithm of alpha -> fails."""
    section = search_page.section(tried(), "steps", {"sarsa": "−20.5 (−21 to −20)"}, 100, "mean return")
    assert section.found_rows == [["Sarsa", "α 0.5, ε 0.1", "−20", "−20.5 (−21 to −20)"]]
    plane, ranks = section.methods[0].drawings
    *_, second, found = ranks.marks
    assert found.kind == "found" and second.kind == "on" and ranks.marks[0].kind == "out"
    assert found.places[0][1] > found.places[1][1] == second.places[0][1]  # up in the drawing is a smaller y
    x = {mark.about.partition(",")[0]: mark.places[0][0] for mark in plane.marks}
    assert x["α 0.1"] - x["α 0.01"] == pytest.approx(x["α 1"] - x["α 0.1"], abs=0.2)
    assert [line for _, (line,) in plane.across] == ["0.01", "0.03", "0.1", "0.3", "1"]
    assert found.about == "α 0.5, ε 0.1: 2 of 4 (5), 1 of 2 (−20)"


def test_a_report_has_a_section_of_the_search(windy):
    """Names come from files of anybody: in the page they are text. Broken once: without `tried` -> fails."""
    ds = make_result(windy, np.zeros((70, 4))).to_xarray()
    methods = by_environment({"windy/<b>sarsa": ds}, {"windy": windy})
    page = report.page(methods, {}, {}, tried=tried("<b>sarsa")).html
    assert "How the settings were found" in page and page.count("<svg viewBox") == 2
    assert "5 fresh seeds" in page and "α 0.5, ε 0.1: 2 of 4 (5), 1 of 2 (−20)" in page
    assert "<b>sarsa" not in page
    assert "How the settings were found" not in report.page(methods, {}, {}).html


def test_a_picture_names_what_was_found():
    figure = search_curves.search(searched.ways(tried()), "steps")
    plane, ranks = figure.axes
    assert plane.get_xscale() == "log" and plane.get_yscale() == "linear"
    (legend,) = [x.get_text() for x in ranks.get_legend().get_texts() if "found" in x.get_text()]
    assert legend == "found: α 0.5, ε 0.1"
    assert [x.get_text() for x in ranks.get_xticklabels()] == ["90 steps\n3 seeds", "270 steps\n3 seeds"]
    one = tried(settings=[{"alpha": x["alpha"]} for x in SETTINGS])
    assert len(search_curves.search(searched.ways(one), "steps").axes) == 1
