"""Batch updating: what TD(0) and Monte Carlo come to on the same episodes (book, figure 6.2 and example 6.4)."""

import numpy as np

from jaxrl_tab.core.experience import Experience
from jaxrl_tab.engine.evaluation import lstd, lstd_system
from jaxrl_tab.envs import RandomWalk
from jaxrl_tab.figures.figure import EXACT, Figure, Number

WALK = RandomWalk(states=5, left_reward=0.0)
TRUE, MIDDLE, V0 = np.arange(1, 6) / 6, 3, 0.5
EPISODES = 100
METHODS = {"batch TD": 0.0, "batch MC": 1.0}  # and the lambda of LSTD(lambda) that it comes to
A, B, END = range(3)  # the states of example 6.4


def _experiment(num_runs=150):
    return {"walk": lambda progress: _walk(num_runs), "predictor": lambda progress: _predictor()}


def _walk(num_runs):
    """The RMS error after each episode, where each time all episodes so far are learned from until nothing changes."""
    import xarray as xr

    rng = np.random.default_rng(0)
    errors = np.array([_run(rng) for _ in range(num_runs)])
    names = list(METHODS)
    return xr.Dataset(
        {"error": (("seed", "method", "episode"), errors)}, {"method": names, "episode": _numbers()}
    )


def _numbers():
    return np.arange(1, EPISODES + 1)


def _run(rng):
    """The errors of one run, [methods, episodes]: the systems of its episodes are added up."""
    logs = [_episode(rng) for _ in range(EPISODES)]
    found = []
    for lam in METHODS.values():
        systems, constants = (
            np.cumsum(x, 0)
            for x in zip(*(lstd_system(log, WALK.num_states, lam=lam) for log in logs), strict=True)
        )
        unseen = np.diagonal(systems, axis1=1, axis2=2) == 0
        systems[unseen[:, :, None] & np.eye(WALK.num_states, dtype=bool)] = 1  # they keep their first value
        v = np.linalg.solve(systems, np.where(unseen, V0, constants)[:, :, None])[:, 1:-1, 0]
        found.append(np.sqrt(((v - TRUE) ** 2).mean(1)))
    return found


def _episode(rng):
    states = [MIDDLE]
    while 0 < states[-1] <= WALK.states:
        states.append(states[-1] + (1 if rng.random() < 0.5 else -1))
    reward = np.zeros(len(states) - 1)
    reward[-1] = float(states[-1] > 0)
    return Experience.from_episodes([(states, np.zeros(len(reward), int), reward)])


def _predictor():
    """V(A) and V(B) from the eight episodes of the example."""
    import xarray as xr

    one = lambda states, rewards: (states, [0] * len(rewards), rewards)
    log = Experience.from_episodes([one([A, B, END], [0, 0]), *[one([B, END], [1])] * 6, one([B, END], [0])])
    v = [lstd(log, END + 1, lam=lam)[:END] for lam in METHODS.values()]
    return xr.Dataset({"v": (("method", "state"), v)}, {"method": list(METHODS), "state": ["A", "B"]})


def _error(method, episodes):
    return lambda datasets: datasets["walk"].error.sel({"method": method, "episode": episodes})


def _v(method, state):
    return lambda datasets: datasets["predictor"].v.sel({"method": method, "state": state})


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.WIDTH)
    left, right = canvas.subplots(1, 2, width_ratios=(1.5, 1))
    walk, predicted = datasets["walk"], datasets["predictor"]
    for i, (method, color) in enumerate(zip(METHODS, plot.COLORS, strict=False)):
        plot.mean_curve(
            left, walk.episode, walk.error.sel({"method": method}), method, color, ls=plot.DASHES[i]
        )
        bars = right.bar(
            np.arange(2) + 0.4 * i - 0.2, predicted.v.sel({"method": method}), 0.36, color=color, label=method
        )
        right.bar_label(bars, fmt="%.2f", fontsize=plot.TYPE)
    plot.tidy(left, "episodes", "RMS error over states")
    left.set(xlim=(0, EPISODES), ylim=(0, 0.25))
    plot.axes_title(left, f"Random walk, five states: {walk.sizes['seed']} runs")
    plot.legend(left)
    right.set_xticks((0, 1), ("V(A)", "V(B)"))
    right.set_ylim(0, 1)
    plot.tidy(right, "", "value")
    plot.axes_title(right, "Example 6.4, eight episodes")
    return canvas


def _after(method, episodes, expected, error):
    return Number(f"{method}: RMS error after {episodes} episodes", expected, error, _error(method, episodes))


FIGURE = Figure(
    title="Batch TD and batch Monte Carlo: the optimality of TD(0)",
    source="Sutton and Barto 2018, figure 6.2 and example 6.4",
    shows="From the same episodes, gone through until nothing changes, TD comes closer to the true values than Monte "
    "Carlo, although that fits the returns of these episodes best: TD gives the values of the chain that they make "
    "most likely. So it says 3/4 for A, after which B came, of which 3/4 paid; Monte Carlo has seen one return from A.",
    experiment=_experiment,
    small={"num_runs": 3},
    numbers=(
        # From 4000 runs of a plain loop; the book has curves of the first, and prints the values of the second.
        _after("batch TD", 10, 0.120463, 0.001176),
        _after("batch TD", 25, 0.073854, 0.000713),
        _after("batch TD", 100, 0.036872, 0.000348),
        _after("batch MC", 10, 0.177366, 0.001335),
        _after("batch MC", 25, 0.112031, 0.000894),
        _after("batch MC", 100, 0.056378, 0.000462),
        Number("batch TD: V(A)", 0.75, EXACT, _v("batch TD", "A"), published="0.75"),
        Number("batch MC: V(A)", 0, EXACT, _v("batch MC", "A"), published="0"),
        Number("batch TD: V(B)", 0.75, EXACT, _v("batch TD", "B"), published="0.75"),
        Number("batch MC: V(B)", 0.75, EXACT, _v("batch MC", "B"), published="0.75"),
    ),
    draw=_draw,
)
