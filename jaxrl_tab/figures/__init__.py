"""Published figures, one file each. To add one: write its file, and add its line to FIGURES."""

from jaxrl_tab.figures import cliff_walking, windy_gridworld
from jaxrl_tab.figures.figure import Check, Figure, Number, swept

FIGURES = {
    "windy-gridworld": windy_gridworld.FIGURE,
    "cliff-walking": cliff_walking.FIGURE,
}

__all__ = ["FIGURES", "Check", "Figure", "Number", "swept"]
