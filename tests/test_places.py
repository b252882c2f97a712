"""What is shown of what was learned where states cannot be counted."""

import dataclasses
import json

import numpy as np
import pytest
from exploring import decoded
from made_up import make_result

import jaxrl_tab as rl
from jaxrl_tab import plot
from jaxrl_tab.envs import MountainCar, SquareWave
from jaxrl_tab.experiment.again import RunAgain
from jaxrl_tab.show import places
from jaxrl_tab.show.explorer import chapter
from jaxrl_tab.stats.columns import Methods

CAR = MountainCar(max_steps=200)


def made_up(env, features, weights, **fixed):
    result = make_result(env, weights)
    return dataclasses.replace(result, fixed=result.fixed | {"features": features} | fixed).to_xarray()


def test_values_at_places_are_those_of_the_weights():
    """Of the two numbers themselves, scaled to [-1, 1]; and of four tiles. Broken once: velocity along -> fails."""
    w = np.array([[1.0, -2.0, 0.5], [3.0, 0.25, -1.0]])
    found = places.places_of(CAR, {"car": (ds := made_up(CAR, "observation", w))})
    assert found is not None
    position, velocity = np.meshgrid(
        -1.2 + 1.7 * (np.arange(21) + 0.5) / 21, 0.07 - 0.14 * (np.arange(15) + 0.5) / 15
    )
    np.testing.assert_allclose(found.points, np.stack([position, velocity], -1).reshape(-1, 2), atol=1e-6)
    assert found.panel.rows[7] == "0"
    assert (found.panel.columns[0], found.panel.columns[-1]) == ("−1.2", "0.46")
    assert found.start == 7 * 21 + 8  # the car stands still at about -0.5
    scaled = np.stack([(position + 0.35) / 0.85, velocity / 0.07], -1).reshape(-1, 2)
    q = places.learned_at(found.points, CAR, ds.isel(alpha=0))
    np.testing.assert_allclose(q, np.broadcast_to(scaled @ w, q.shape), atol=1e-5)
    padded = made_up(CAR, "observation", np.pad(w, ((0, 3), (0, 0)), constant_values=np.nan))
    np.testing.assert_array_equal(places.learned_at(found.points, CAR, padded.isel(alpha=0)), q)
    tiles = made_up(CAR, "tile-coding(1, 2)", np.arange(9.0)[:, None])
    of_tiles = places.learned_at(np.array([[-1, -0.01], [0, -0.01], [-1, 0.01]]), CAR, tiles.isel(alpha=0))
    assert of_tiles.shape == (5, 3, 1)
    assert len({*of_tiles[0, :, 0]}) == 3


@pytest.mark.slow
def test_the_report_shows_them_over_time():
    """At the end, and after half of the episodes: as runs of that length have them, and by their weights."""
    grid = {"alpha": [0.2, 0.5], "epsilon": 0.0, "features": "tile-coding(2, 3)", "per_tiling": True}
    method = {"name": "semi-gradient-sarsa", **grid}
    environment = {"name": "mountain-car", "max_steps": 200}
    experiment = rl.Experiment(environment, method, seeds=3, episodes=4)
    outcome = rl.run(experiment, progress=False)
    ((label, methods),) = outcome.methods.items()
    seen = chapter.explorer(label, methods, again=RunAgain(experiment.parts()))
    page = json.loads(json.dumps(seen.data)), {f"data-1-{name}": text for name, text in seen.blocks.items()}
    assert (seen.data["absent"], seen.data["methods"][0]["missing"]) == ("", "")
    assert len(seen.data["scene"]["panels"][0]["states"]) == 15
    ds, found = methods["semi-gradient-sarsa"], places.places_of(CAR, methods)
    assert found is not None
    best = seen.data["methods"][0]["best"]
    shorter = rl.sweep(CAR, "semi-gradient-sarsa", grid, num_seeds=3, num_episodes=2, progress=False)
    for setting in (0, 1):
        shown, views, about = decoded(page, 0, setting)
        assert about["moments"] == (4 if setting == best else 1)
        assert views[0] == "mean"
        close = {"atol": about["step"] / 2 + 1e-4}
        end = places.learned_at(found.points, CAR, ds.isel(alpha=setting))
        np.testing.assert_allclose(shown[0, -1], end.mean(0), **close)
        if setting == best:
            then = places.learned_at(found.points, CAR, shorter.to_xarray().isel(alpha=setting))
            np.testing.assert_allclose(shown[0, 1], then.mean(0), **close)


def test_where_there_is_no_map_a_sentence_says_so():
    class Four(MountainCar):
        low, high = (0.0,) * 4, (1.0,) * 4

    w = np.zeros((4, 3))
    for env, ds, why in (
        (Four(), made_up(Four(), "observation", w), "a state is 4 numbers here, and a map is of two"),
        (CAR, made_up(CAR, "observation", w, network="mlp(4)"), "as where there is a network"),
        (CAR, made_up(CAR, "mine", w), "features that have a name"),
        (SquareWave(), made_up(SquareWave(), "observation", w[:1, :1]), "the curve in values.png"),
    ):
        data = chapter.explorer("task", Methods.of({"sarsa": ds}, env)).data
        assert why in data["absent"]
        assert data["scene"] is None
        assert ("values" in plot.pictures({"sarsa": ds}, env)) == (env.num_actions == 1)


@pytest.mark.parametrize(("sign", "what"), [(-1, "cost to go, −max q(s, a)"), (1, "max q(s, a)")])
def test_the_map_is_of_the_cost_to_go_where_all_is_a_cost(sign, what):
    """Of nine tiles, numbered along the velocity and then the position. Broken once: upside down -> fails."""
    ds = made_up(CAR, "tile-coding(1, 2)", sign * np.arange(9.0)[:, None])
    figure = plot.pictures({"sarsa": ds}, CAR)["values"]
    image = figure.axes[0].get_images()[0].get_array()
    assert image.shape == (60, 60)
    corners = image[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert corners.argmax() == 1
    assert corners[0] > corners[2]
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("position", "velocity")
    assert figure.axes[-1].get_xlabel() == what
