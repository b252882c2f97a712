"""What is said of a method before it runs, and of one that diverged: too large a step size, the deadly triad."""

import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import approx, policies
from jaxrl_tab.approx.dangers import has_deadly_triad, largest_square, step_sizes
from jaxrl_tab.approx.features import read
from jaxrl_tab.show import words

CAR = rl.MountainCar()
WALK = rl.RandomWalk(states=5)


@pytest.mark.parametrize(
    ("text", "square"),
    [
        ("tile-coding(8, 4)", 8),
        ("fourier(2)", 9),
        ("polynomial(3)", 16),
        ("aggregation(3) + tile-coding(2, 2)", 3),
        ("fourier(1) + tile-coding(2, 2)", 6),
    ],
)
def test_the_largest_square_of_what_is_observed(text, square):
    """Of a car. Broken once: the middle of the range alone -> fails."""
    assert largest_square(read(text).fitted(CAR)) == pytest.approx(square)


def test_the_largest_square_of_states():
    assert largest_square(read([[1, 2], [0, 3], [2, 0]])) == 9
    assert largest_square(read("one-hot").fitted(WALK)) == 1


def test_a_step_size_that_must_diverge_is_named():
    """All of a sweep in one line, and only those that are too large: with polynomial(1) |x|^2 is 2 at most.

    Broken once: 1 for 2; alpha not divided where it is by tilings -> fails.
    """
    own = lambda alpha, **more: approx.SemiGradientTD(features="polynomial(1)", alpha=alpha, **more)
    (line,) = step_sizes([own(a) for a in (0.5, 0.99, 1.01, 1.5)], WALK)
    assert line == (
        "SemiGradientTD must diverge with a step size of 1.01, 1.5: it is above 2 / 2 = 1, and where |x(s)|^2 of "
        "polynomial(1) is 2, each update then makes the error larger"
    )
    tiles = lambda **more: approx.SemiGradientSarsa(features="tile-coding(8, 8)", alpha=0.3, **more)
    assert not [*step_sizes([tiles(per_tiling=True)], CAR)]
    assert len([*step_sizes([tiles()], CAR)]) == 1
    others = [
        approx.SemiGradientSarsa(features="tile-coding(8, 8)", optimizer="optax:sgd(0.3)"),
        approx.SemiGradientSarsa(features="tile-coding(8, 8)", alpha=rl.schedules.glie()),
        rl.Sarsa(alpha=3.0),
    ]
    assert not [*step_sizes(others, CAR)]


def test_the_three_parts_of_the_triad():
    """Features that are no table, a policy that is learned about, and another one that acts; all of them bootstrap."""
    tiles = {"features": "tile-coding"}
    three = [
        approx.SemiGradientQLearning(**tiles),
        approx.SemiGradientExpectedSarsa(target=policies.Greedy(), **tiles),
        approx.SemiGradientOffPolicyTD(features="own"),
        approx.DeepQNetwork(),
    ]
    two = [
        approx.SemiGradientQLearning(),
        approx.SemiGradientQLearning(epsilon=0.0, **tiles),
        approx.SemiGradientSarsa(**tiles),
        approx.SemiGradientExpectedSarsa(**tiles),
        approx.DeepSarsa(),
        rl.QLearning(),
    ]
    assert all(map(has_deadly_triad, three))
    assert not any(map(has_deadly_triad, two))


def test_it_is_said_of_what_diverged_and_of_nothing_else():
    """Baird's counterexample, in a sweep, on the screen's line and in the report; its weights are no numbers yet.

    Broken once: said of what did not diverge; judged by infinities alone -> fails.
    """
    grid = {"features": "own", "alpha": 0.01, "gamma": 0.99, "w0": "1,1,1,1,1,1,10,1"}
    runs = [
        rl.sweep(
            rl.make("baird"), approx.SemiGradientOffPolicyTD, grid, num_seeds=2, num_steps=n, progress=False
        )
        for n in (20_000, 100)
    ]
    late, early = (run.to_xarray() for run in runs)
    assert late.diverged.all() and np.isfinite(late.q).all()
    assert not early.diverged.any()
    assert early.attrs["deadly_triad"] == 1
    said = "the deadly triad, with which no step size is safe (book, section 11.3)."
    (line,) = words.deadly_triads({"mine": late, "other": early})
    assert line.startswith("mine approximates, bootstraps, and learns") and line.endswith(said)
    assert said in runs[0].report().html
    assert said not in runs[1].report().html
