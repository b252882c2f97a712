"""Learning over time as an animation: a GIF, or a page with a slider.

Matplotlib and Pillow are imported when something is drawn.
"""

from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError, as_path, one_line, reason
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.core.types import Environment, FiniteEnvironment
from jaxrl_tab.envs.base import Grid
from jaxrl_tab.exact import planning
from jaxrl_tab.show.html import as_data, as_json, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

MOST_STATES = 500  # of a picture
DPI = 100
SECONDS, SECONDS_AT_END = 0.25, 3.0  # for which a picture is seen, and the last one
COLORS = 128  # of a picture


def check(file: Path | str, env: Environment) -> Path:
    """The file of an animation, as a path.

    Raises:
        InputError: it has a wrong ending, is there already, or its folder is not; or there is no picture of
            the environment.
    """
    path = as_path("an animation", file)
    name = one_line(str(path))
    if path.suffix.lower() not in (".gif", ".html"):
        raise InputError(f"an animation is a file that ends in .gif or .html, not {name}")
    if path.exists():
        raise InputError(f"{name} exists already; name a new file")
    if not path.parent.is_dir():
        raise InputError(f"{name} cannot be written: there is no folder {one_line(str(path.parent))}")
    who = type(env).__name__
    if not isinstance(env, FiniteEnvironment):
        raise InputError(f"there is no picture of {who}, which does not state its outcomes")
    if env.num_states > MOST_STATES:
        raise InputError(
            f"there is no picture of {who}: it has {env.num_states} states, more than {MOST_STATES}"
        )
    return path


def pictures(env: Environment, tables: Float[np.ndarray, "n S A"], titles: Sequence[str]) -> "list[Image]":
    """A picture of each table of values, under its title. Their colours mean the same.

    Args:
        env: an environment that `check` lets pass.
        tables: action values, one table after another; of state values [n, S, 1].
        titles: of each of them.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    from jaxrl_tab.show import plot

    drawn: list[Any] = []
    size: Any = None
    places: list[Any] = []
    for figure in _figures(env, tables, titles):
        figure.set_dpi(DPI)
        if places:  # all lie as in the first, so that nothing jumps
            figure.set_layout_engine("none")
            figure.set_size_inches(size)
            for ax, place in zip(figure.axes, places, strict=True):
                ax.set_position(place)
        else:
            plot.lay_out(figure)
            size, places = figure.get_size_inches(), [ax.get_position(original=True) for ax in figure.axes]
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # `savefig` would draw everything twice
        drawn.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    # The last picture, of what was learned by the end, has all colours that the others have.
    palette = drawn[-1].quantize(COLORS)
    return [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in drawn]


def write(file: Path, shown: "Sequence[Image]", titles: Sequence[str], name: str) -> None:
    """Writes an animation of some pictures: a page where the file ends in .html, else a GIF.

    Args:
        file: a new file.
        shown: the pictures.
        titles: of each of them.
        name: what learned what they show.

    Raises:
        InputError: the file cannot be written.
    """
    if file.suffix.lower() == ".html":
        sources = [as_data(_png(picture), "image/png") for picture in shown]
        data = as_json({"sources": sources, "titles": list(titles), "seconds": SECONDS})
        own = {"styles": ["learning.css"], "scripts": ["learning.js"], "data": data}
        data = render("learning.html", name=name, titles=titles, source=sources[-1], **own).encode()
    else:
        data = _gif(shown)
    try:
        with file.open("xb") as to:
            to.write(data)
    except OSError as error:
        raise InputError(f"{one_line(str(file))} cannot be written: {reason(error)}") from None


def _figures(env: Environment, tables: np.ndarray, titles: Sequence[str]) -> "Iterator[Figure]":
    """A figure for each table."""
    from jaxrl_tab.show import plot

    q = np.where(tables == UNAVAILABLE, np.nan, tables.astype(float))
    of_states = q.shape[-1] == 1 < env.num_actions
    v = np.nanmax(q, -1)
    inner = _inner(env)
    limits = _limits(v[:, inner])
    panels = bool(of_environment(env).panels())
    for table, values, title in zip(q, v, titles, strict=True):
        if isinstance(env, Grid):
            figure = plot.canvas(plot.WIDTH)
            ax = figure.subplots()
            plot.values(ax, env, values, None if of_states else table, limits)
        elif panels:
            figure, grid = plot.panels_canvas(env, 1)
            plot.panels(
                grid[0], env, values, None if of_states else plot.greedy_actions(table), title, limits
            )
            yield figure
            continue
        else:
            figure = plot.canvas(plot.NARROW)
            ax = figure.subplots()
            if of_states:
                ax.plot(np.flatnonzero(inner), values[inner], "o-", color=plot.COLORS[0])
                plot.tidy(ax, "state", "V")
            else:
                plot.action_values(ax, env, table)
            ax.set_ylim(_with_margin(q[:, inner]))
        ax.set_title(plot.literal(title), fontsize=plot.TITLE)
        yield figure


def _inner(env: Environment) -> np.ndarray:
    """Which states can be reached and are not terminal, bool [S]."""
    model = planning.exact_model(env)
    return planning.reachable(model) & ~planning.terminal_states(model)


def _limits(x: np.ndarray) -> tuple[float, float]:
    """The smallest and the largest of the finite numbers."""
    finite = x[np.isfinite(x)]
    return float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))


def _with_margin(x: np.ndarray) -> tuple[float, float]:
    low, high = _limits(x)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _png(picture: "Image") -> bytes:
    file = BytesIO()
    picture.save(file, format="PNG", optimize=True)
    return file.getvalue()


def _gif(shown: "Sequence[Image]") -> bytes:
    file = BytesIO()
    durations: list[Any] = [round(1000 * SECONDS)] * (len(shown) - 1) + [round(1000 * SECONDS_AT_END)]
    first, *others = shown
    first.save(file, format="GIF", save_all=True, append_images=others, duration=durations, loop=0)
    return file.getvalue()
