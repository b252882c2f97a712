"""Where to update: everywhere alike, or where the policy goes (book, section 8.6, figure 8.8)."""

from functools import partial

import numpy as np

from jaxrl_tab.figures.figure import Figure, Number

STATES, ACTIONS = 1000, 2
BRANCHING = (1, 3, 10)
EPSILON, ENDS = 0.1, 0.1  # how often it explores, and the probability that a transition ends the episode
UPDATES, EVERY = 8000, 500
SWEEPS = 80  # of evaluation: 0.9^80 is 0.0002
UNIFORM, ON_POLICY = WAYS = ("uniform", "on-policy")


def _experiment(num_tasks=30):
    runs = [(b, way) for b in BRANCHING for way in WAYS]
    return {f"b-{b}, {way}": partial(_run, b, way, num_tasks) for b, way in runs}


def _run(b, way, num_tasks, progress):
    """The value of the start under the greedy policy, after every so many expected updates, [seed, row].

    In each task a pair leads to b states, drawn uniformly, all equally likely, with rewards from N(0, 1) each; unless
    the episode ends, with reward 0.
    """
    import xarray as xr

    rand = np.random.default_rng([b, WAYS.index(way)])
    tasks, shape = np.arange(num_tasks), (num_tasks, STATES, ACTIONS, b)
    s_next, rewards = rand.integers(STATES, size=shape), rand.normal(size=shape)
    q, s, values = np.zeros(shape[:3]), np.zeros(num_tasks, int), []
    for t in range(UPDATES):
        if way == UNIFORM:
            s, a = np.full(num_tasks, t // ACTIONS % STATES), np.full(num_tasks, t % ACTIONS)
        else:
            explores = rand.random(num_tasks) < EPSILON
            a = np.where(explores, rand.integers(ACTIONS, size=num_tasks), q[tasks, s].argmax(1))
        entered = s_next[tasks, s, a]
        expected = rewards[tasks, s, a] + q[tasks[:, None], entered].max(2)
        q[tasks, s, a] = (1 - ENDS) * expected.mean(1)
        if way == ON_POLICY:
            goes_on = rand.random(num_tasks) >= ENDS
            s = np.where(goes_on, entered[tasks, rand.integers(b, size=num_tasks)], 0)
        if (t + 1) % EVERY == 0:
            values.append(_start_value(q, s_next, rewards))
    return xr.Dataset({"value": (("row", "seed"), values)}).transpose("seed", "row")


def _start_value(q, s_next, rewards):
    """The value of the start of each task under the policy that is greedy to Q, [tasks]."""
    tasks, states = np.ogrid[: len(q), :STATES]
    greedy = q.argmax(2)
    entered, paid = s_next[tasks, states, greedy], rewards[tasks, states, greedy].mean(2)
    v = np.zeros(q.shape[:2])
    for _ in range(SWEEPS):
        v = (1 - ENDS) * (paid + v[tasks[..., None], entered].mean(2))
    return v[:, 0]


def _value(b, way, updates):
    return lambda datasets: datasets[f"b-{b}, {way}"].value.isel(row=updates // EVERY - 1)


def _draw(datasets):
    from jaxrl_tab.show import plot

    canvas = plot.canvas(plot.NARROW)
    ax = canvas.subplots()
    for b, color in zip(BRANCHING, plot.COLORS, strict=False):
        for way, dash in zip(WAYS, ("--", "-"), strict=True):
            value = datasets[f"b-{b}, {way}"].value
            plot.mean_curve(ax, EVERY * (value.row + 1), value, f"b = {b}, {way}", color, ls=dash)
    plot.tidy(ax, "expected updates", "value of the start, greedy policy")
    ax.set(xlim=(0, UPDATES), ylim=(0, None))
    plot.legend(ax)
    tasks = datasets[f"b-1, {UNIFORM}"].sizes["seed"]
    plot.head(
        canvas, f"{STATES} states, b branches: mean and pointwise 95% interval\nover {tasks} random tasks"
    )
    return canvas


FIGURE = Figure(
    title="Where to update: everywhere alike, or where the policy goes",
    source="Sutton and Barto 2018, figure 8.8",
    shows="Updates along the way that the policy goes are better at first, for the start depends on what is there, and "
    "for the longer the fewer states follow. In the long run they are worse: the same pairs are updated, for nothing, "
    "again and again.",
    experiment=_experiment,
    small={"num_tasks": 2},
    numbers=(
        # From 600 tasks of a plain loop each.
        Number("b = 1, uniform: value after 500 updates", 1.798, 0.097, _value(1, UNIFORM, 500)),
        Number("b = 1, on-policy: after 500", 4.909, 0.067, _value(1, ON_POLICY, 500)),
        Number("b = 1, uniform: after 8000", 7.213, 0.062, _value(1, UNIFORM, 8000)),
        Number("b = 1, on-policy: after 8000", 6.613, 0.062, _value(1, ON_POLICY, 8000)),
        Number("b = 3, uniform: after 500", 0.972, 0.024, _value(3, UNIFORM, 500)),
        Number("b = 3, on-policy: after 500", 1.439, 0.020, _value(3, ON_POLICY, 500)),
        Number("b = 3, uniform: after 8000", 3.253, 0.021, _value(3, UNIFORM, 8000)),
        Number("b = 3, on-policy: after 8000", 2.667, 0.019, _value(3, ON_POLICY, 8000)),
        Number("b = 10, uniform: after 2000", 1.626, 0.010, _value(10, UNIFORM, 2000)),
        Number("b = 10, on-policy: after 2000", 1.111, 0.010, _value(10, ON_POLICY, 2000)),
    ),
    draw=_draw,
)
