"""The racetrack: how the best policy drives, and how fast a race can be (book, exercise 5.12)."""

import numpy as np

from jaxrl_tab.envs import Racetrack
from jaxrl_tab.envs.base import COMPASS
from jaxrl_tab.envs.racetrack import CRASH, SPEEDS, STAY, TRACKS, tabulated
from jaxrl_tab.figures.figure import EXACT, Figure, Number

SMALL = 1e-11  # a change of values that is none


def _experiment():
    return {name: _solved(name) for name in TRACKS}


def _solved(name):
    def solve(progress):
        """The optimal values, by sweeps over what the two things that may happen are worth, and a best action."""
        import xarray as xr

        env = Racetrack(track=name)
        track, failure = tabulated(env.rows), float(env.failure)
        v, old = np.zeros(env.num_states), np.full(env.num_states, np.inf)
        q = np.zeros(track.after.shape)
        while abs(v - old).max() > SMALL:
            worth = np.where(track.after == CRASH, v[track.starts].mean(), v[track.after])
            q = (1 - failure) * worth + failure * worth[:, [STAY]] - 1
            q[-1] = 0
            v, old = q.max(1), v
        best = (q >= v[:, None] - 1e-9).argmax(1)
        return xr.Dataset({"v": ("state", v), "best": ("state", best), "start": ("line", track.starts)})

    return solve


def _steps(name, how):
    """Expected steps of the best policy, over the starting line: their mean, or those from the best cell."""
    return lambda datasets: -getattr(datasets[name].v[datasets[name].start], how)()


def _driven(name, best, s):
    """The states of a race from `s` on in which the car obeys; None where it leaves the track."""
    after, way = tabulated(TRACKS[name]).after, [int(s)]
    while way[-1] != len(after) - 1 and len(way) < 99:
        way.append(int(after[way[-1], best[way[-1]]]))
        if way[-1] == CRASH:
            return None
    return way


def _points(places, best, way):
    """Where the car is after each step, as x and y; the last move as far as it would go beyond the finish line."""
    row, column, up, right = places[way[:-1]].T
    down, along = COMPASS[best[way[-2]]]
    last = (
        row[-1] - np.clip(up[-1] - down, 0, SPEEDS - 1),
        column[-1] + np.clip(right[-1] + along, 0, SPEEDS - 1),
    )
    return np.append(column, last[1]), np.append(row, last[0])


def _shortest(name):
    def shortest(datasets):
        ds = datasets[name]
        ways = [_driven(name, ds.best.values, s) for s in ds.start.values]
        return min(len(way) - 1 for way in ways if way)

    return shortest


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH, 4.6)
    axes = canvas.subplots(1, 2, width_ratios=[len(rows[0]) for rows in TRACKS.values()])
    for ax, (name, ds) in zip(axes, datasets.items(), strict=True):
        rows, places = TRACKS[name], tabulated(TRACKS[name]).places
        shades = {"#": 0.45, ".": 1.0, "S": 0.85, "G": 0.85}
        image = [[shades[letter] for letter in row] for row in rows]
        ax.imshow(image, cmap="gray", vmin=0, vmax=1)
        lines = np.arange(len(rows) + 1) - 0.5, np.arange(len(rows[0]) + 1) - 0.5
        ax.hlines(lines[0], *lines[1][[0, -1]], color="#c8c8c8", lw=0.3)
        ax.vlines(lines[1], *lines[0][[0, -1]], color="#c8c8c8", lw=0.3)
        ways = [_driven(name, ds.best.values, s) for s in ds.start.values]
        ways = [way for way in ways if way]
        for i, color in zip(np.linspace(0, len(ways) - 1, 4).round().astype(int), plot.COLORS, strict=False):
            ax.plot(*_points(places, ds.best.values, ways[i]), ".-", color=color, lw=1.2, ms=5)
        ax.set_title(f"{-float(ds.v[ds.start].mean()):.2f} steps on average", fontsize=plot.TYPE)
        ax.set(xlim=lines[1][[0, -1]], ylim=lines[0][[-1, 0]], xticks=[], yticks=[])
    plot.head(canvas, "Races of the best policies from four cells of the starting line, without noise")
    return canvas


FIGURE = Figure(
    title="The racetrack: the best policies, exactly",
    source="Sutton and Barto 2018, exercise 5.12 and figure 5.5",
    shows="Each point is where the car is after a step: as fast as it may be where it is straight, and slower before "
    "the turn, the more so the narrower it is. Where the car may not obey, the best policies need a step or so more.",
    experiment=_experiment,
    numbers=(
        # By policy iteration over all outcomes; the book leaves this to the reader.
        Number("left: expected steps from the starting line", 11.694577, EXACT, _steps("left", "mean")),
        Number("left: from its best cell", 11.029578, EXACT, _steps("left", "max")),
        Number("left: steps of the shortest race without noise", 10, EXACT, _shortest("left")),
        Number("right: expected steps from the starting line", 8.895873, EXACT, _steps("right", "mean")),
        Number("right: from its best cell", 8.322414, EXACT, _steps("right", "max")),
        Number("right: steps of the shortest race without noise", 8, EXACT, _shortest("right")),
    ),
    draw=_draw,
)
