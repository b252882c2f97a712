"""Blackjack: what Monte Carlo control learns beside the exact optimum (book, figure 5.2)."""

import numpy as np

from jaxrl_tab.envs import Blackjack
from jaxrl_tab.exact import planning
from jaxrl_tab.figures.figure import EXACT, Figure, Number, swept

STICK, HIT = 0, 1
EPSILON = 0.1
RUN = "monte-carlo"
USABLE = {1: "usable ace", 0: "no usable ace"}
SUMS, SHOWN = np.arange(12, 22), np.arange(1, 11)
CARDS = ["A", *map(str, SHOWN[1:])]


def _experiment(num_seeds=20, num_episodes=500_000):
    budget = {"num_seeds": num_seeds, "num_episodes": num_episodes, "log_every": num_episodes, "exact": True}
    return {RUN: swept(Blackjack(), "monte-carlo", {"epsilon": EPSILON}, **budget)}


def _by_hand(q):
    """A table of S states as one of hands: [..., usable ace, player's sum, dealer's card, action]."""
    return np.asarray(q)[..., :-1, :].reshape(*q.shape[:-2], 2, len(SUMS), len(SHOWN), 2)


def _optimal():
    """q* by hand."""
    return _by_hand(planning.value_iteration(Blackjack())[1])


def _sticks_from(usable):
    """The lowest sum to stick on, for each card that the dealer may show."""
    return SUMS[(_optimal()[usable].argmax(-1) == STICK).argmax(0)]


def _sticks_unlike(usable, published):
    return lambda datasets: (_sticks_from(usable) != published).sum()


def _optimal_value(datasets):
    return planning.start_value(Blackjack(), planning.value_iteration(Blackjack())[0])


def _learned_value(datasets):
    """The exact value of the policy that each seed learned."""
    return datasets[RUN].greedy_value.isel(row=-1)


def _draw(datasets):
    from jaxrl_tab.show import plot

    ds = datasets[RUN]
    learned, exact = _by_hand(ds.q.values), _optimal()
    hits = (learned[..., HIT] > learned[..., STICK]).mean(0)
    best = exact[..., HIT] > exact[..., STICK]
    policies = {f"Learned: share of {ds.sizes['seed']} seeds that hit": hits, "Exact, with its border": best}
    surfaces = {"Learned by one seed: max Q(s, a)": learned[0], "Exact: v*(s)": exact}
    canvas = plot.canvas(plot.WIDTH, 9.6)
    grid = canvas.add_gridspec(4, 2, height_ratios=(1, 1, 1.25, 1.25))
    flat, deep, shares, values = [], [], None, None
    for row, (usable, name) in enumerate(USABLE.items()):
        for column, (title, hit) in enumerate(policies.items()):
            flat.append(ax := canvas.add_subplot(grid[row, column]))
            shares = _policy(ax, hit[usable], best[usable])
            ax.set_title(f"{title}\n{name}", fontsize=plot.TYPE)
        for column, (title, q) in enumerate(surfaces.items()):
            deep.append(ax := canvas.add_subplot(grid[2 + row, column], projection="3d"))
            values = surface(ax, q[usable].max(-1))
            ax.set_title(f"{title}\n{name}", fontsize=plot.TYPE)
    plot.color_bar(shares, flat, "share that hit", length=0.5)
    plot.color_bar(values, deep, length=0.5)
    episodes = f"{ds.attrs['num_episodes']:,}".replace(",", " ")
    plot.head(canvas, f"Blackjack: every-visit Monte Carlo, step 1/N, ε = {EPSILON}, {episodes} episodes")
    return canvas


def _policy(ax, hit, best):
    """How far the player hits, from 0 to 1, for each sum and card; and the border of the best policy."""
    import matplotlib as mpl
    from matplotlib.colors import ListedColormap

    from jaxrl_tab.show import plot

    pale = mpl.colormaps["Blues"].resampled(256)(np.linspace(0, 0.62, 256))  # texts can be read on it
    look = {"cmap": ListedColormap(pale), "vmin": 0, "vmax": 1, "ec": "white", "lw": 0.5}
    image = ax.pcolormesh(SHOWN, SUMS, hit.astype(float), shading="nearest", **look)
    border = SUMS[(~best).argmax(0)] - 0.5
    edges = np.append(SHOWN - 0.5, SHOWN[-1] + 0.5)
    ax.stairs(border, edges, baseline=None, color=plot.ALARM, lw=2)
    for text, total in {"stick": 20, "hit": 14}.items():
        ax.text(9, total, text, ha="center", va="center", fontsize=plot.TYPE)
    ax.set_xticks(SHOWN, CARDS)
    ax.set_yticks(SUMS[::3])
    ax.set_xlabel("dealer shows", fontsize=plot.TYPE)
    ax.set_ylabel("player's sum", fontsize=plot.TYPE)
    ax.tick_params(labelsize=plot.SMALL)
    return image


def surface(ax, v):
    """Values over the dealer's card and the player's sum."""
    from jaxrl_tab.show import plot

    at = np.meshgrid(SHOWN, SUMS)
    image = ax.plot_surface(*at, v, cmap="viridis", vmin=-1, vmax=1, ec="#00000055", lw=0.4)
    ax.set_xticks(SHOWN[::3], CARDS[::3])
    ax.set_yticks(SUMS[::3])
    ax.set_zticks([-1, 0, 1])
    ax.set_zlim(-1, 1)
    ax.set_xlabel("dealer shows", fontsize=plot.TYPE, labelpad=-2)
    ax.set_ylabel("player's sum", fontsize=plot.TYPE, labelpad=-2)
    ax.set_zlabel("value", fontsize=plot.TYPE, labelpad=-4)
    ax.tick_params(labelsize=plot.SMALL, pad=-2)
    ax.set_box_aspect((1, 1, 0.6), zoom=0.9)
    ax.view_init(elev=28, azim=-50)
    return image


FIGURE = Figure(
    title="Blackjack: policy and values, learned and exact",
    source="Sutton and Barto 2018, figure 5.2; Silver, lecture 5",
    shows="After half a million games most seeds stick and hit where the best policy does; they differ where "
    "both actions are worth nearly the same, so what they lose is small.",
    experiment=_experiment,
    small={"num_seeds": 2, "num_episodes": 200},
    numbers=(
        # The optimum by enumeration, and as published; what is learned from 363 seeds of a plain loop.
        Number("optimal value from the start", -0.046556, EXACT, _optimal_value),
        Number(
            "usable ace: cards for which it sticks from another sum than is known",
            0,
            EXACT,
            _sticks_unlike(1, (19, 18, 18, 18, 18, 18, 18, 18, 19, 19)),
        ),
        Number(
            "no usable ace: cards for which it sticks from another sum than is known",
            0,
            EXACT,
            _sticks_unlike(0, (17, 13, 13, 12, 12, 12, 17, 17, 17, 17)),
        ),
        Number("exact value of the learned policy, mean", -0.04900, 0.00005, _learned_value),
    ),
    draw=_draw,
)
