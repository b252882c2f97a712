"""REINFORCE in the short corridor, without and with a baseline (book, sections 13.3 and 13.4)."""

import jax.numpy as jnp

from jaxrl_tab.algorithms import Reinforce, ReinforceBaseline
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.envs import ShortCorridor
from jaxrl_tab.figures.figure import Figure, Number, swept

OPTIMUM = -(6 + 4 * 2**0.5)
FIRST = 1.47  # the preference for left, and against right: right has a probability of 0.05
EPISODES, EVERY = 1000, 10
STEPS = {2.0**-12: "α = 2⁻¹²", 2.0**-13: "α = 2⁻¹³", 2.0**-14: "α = 2⁻¹⁴"}
PLAIN, BASELINE = "reinforce", "reinforce-baseline"
WITH = {"alpha": 2.0**-9, "alpha_v": 2.0**-6}


class _MostlyLeft:
    """Goes left at first, nearly always."""

    def begun(self, num_states, num_actions):
        policy, clock = super().begun(num_states, num_actions)  # pyright: ignore[reportAttributeAccessIssue]
        return policy._replace(theta=policy.theta + jnp.array([[FIRST, -FIRST]])), clock


@pytree
class LeftReinforce(_MostlyLeft, Reinforce):
    """REINFORCE that goes left at first."""


@pytree
class LeftReinforceBaseline(_MostlyLeft, ReinforceBaseline):
    """The same with a baseline."""


def _experiment(num_seeds=200):
    budget = {"num_seeds": num_seeds, "num_episodes": EPISODES, "log_every": EVERY, "exact": True}
    alike = {"groups": "0,0,0,1"}
    return {
        PLAIN: swept(ShortCorridor(), LeftReinforce, {"alpha": list(STEPS)} | alike, **budget),
        BASELINE: swept(ShortCorridor(), LeftReinforceBaseline, WITH | alike, **budget),
    }


def _runs(datasets, alpha):
    return datasets[BASELINE] if alpha is None else datasets[PLAIN].sel(alpha=alpha)


def _earned(alpha, last):
    """The mean return of the 100 episodes up to this one; without an alpha, with the baseline."""

    def measure(datasets):
        rows = slice((last - 100) // EVERY, last // EVERY)
        return _runs(datasets, alpha).returns.isel(row=rows).sum("row") / 100

    return measure


def _draw(datasets):
    from jaxrl_tab import stats
    from jaxrl_tab.show import plot
    from jaxrl_tab.show.curves import interval_curve

    canvas = plot.canvas(plot.WIDTH)
    without, beside = canvas.subplots(1, 2, sharey=True)
    curves = [(without, alpha, name) for alpha, name in STEPS.items()]
    curves += [(beside, None, "with baseline, 2⁻⁹ and 2⁻⁶ for V"), (beside, 2.0**-13, "without, 2⁻¹³")]
    for i, (ax, alpha, name) in enumerate(curves):
        ds = _runs(datasets, alpha)
        color, dash = plot.COLORS[(0, 1, 2, 3, 1)[i]], plot.DASHES[i % 3]
        interval = stats.median_interval(ds.policy_value)
        interval_curve(ax, EVERY * (ds.row + 1), interval, name, color, ls=dash)
    for ax in (without, beside):
        plot.exact_line(ax, OPTIMUM, f"best stochastic: {OPTIMUM:.2f}".replace("-", "−"))
        plot.tidy(ax, "episodes", "exact value of the policy" if ax is without else "")
        ax.set(xlim=(0, EPISODES), ylim=(-90, 0))
        plot.legend(ax)
    seeds = datasets[PLAIN].sizes["seed"]
    plot.head(canvas, f"Short corridor, all states look the same: median and 95% interval, {seeds} seeds")
    return canvas


FIGURE = Figure(
    title="REINFORCE in the short corridor, without and with a baseline",
    source="Sutton and Barto 2018, figures 13.1 and 13.2",
    shows="The larger the step size, the sooner the median run comes to the best stochastic policy. But with 2⁻¹² "
    "some three runs in a hundred come to go always the same way, which never arrives, and ruin the mean. A baseline, "
    "itself learned, lets the step size be sixteen times as large.",
    experiment=_experiment,
    small={"num_seeds": 2},
    numbers=(
        # From 20 000 runs of plain loops.
        Number("α = 2⁻¹²: mean return of episodes 901 to 1000", -41.026, 1.183, _earned(2.0**-12, 1000)),
        Number("α = 2⁻¹³", -15.509, 0.394, _earned(2.0**-13, 1000)),
        Number("α = 2⁻¹⁴", -15.104, 0.099, _earned(2.0**-14, 1000)),
        Number("with baseline", -13.016, 0.221, _earned(None, 1000)),
        Number("with baseline: episodes 101 to 200", -13.384, 0.250, _earned(None, 200)),
    ),
    draw=_draw,
)
