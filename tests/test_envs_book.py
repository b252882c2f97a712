"""The tasks of the book, and Gymnasium's taxi and slippery cliff: against tables, plain loops and printed numbers."""

import math
from itertools import product

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.envs.racetrack import TRACKS
from jaxrl_tab.figures import FIGURES
from jaxrl_tab.show.states import state_names


def optimum(name, gamma=1.0, **parameters):
    """The optimal value from the start."""
    env = rl.make(name, **parameters)
    return planning.start_value(env, planning.value_iteration(env, gamma)[0])


# --- Gymnasium's tables ------------------------------------------------------------------------------


def merged(num_states, num_actions, outcomes):
    """Of outcomes (s, a, probability, s', reward, terminal): p(s' | s, a), and the mean reward of each, [S, A, S']."""
    p, r, ends = np.zeros((3, num_states, num_actions, num_states))
    for s, a, prob, s_next, reward, terminal in outcomes:
        p[s, a, s_next] += prob
        r[s, a, s_next] += prob * reward
        ends[s, a, s_next] += prob * terminal
    return p, r, ends


def theirs(P):
    return merged(len(P), len(P[0]), ((s, a, *x) for s in P for a in P[s] for x in P[s][a]))


def ours(env):
    model = planning.exact_model(env)
    columns = (model.prob, model.s_next, model.reward, model.terminal)
    places = np.indices(model.prob.shape)[:2]
    return merged(*model.prob.shape[:2], zip(*(x.ravel() for x in (*places, *columns)), strict=True))


RAIN = {"is_rainy": True, "rainy_probability": 0.7}


@pytest.mark.parametrize(
    ("name", "parameters", "of_gymnasium", "given"),
    [
        ("taxi", {}, "Taxi-v4", {}),
        ("taxi", RAIN, "Taxi-v4", RAIN),
        ("cliff-walking", {}, "CliffWalking-v1", {}),
        ("cliff-walking", {"is_slippery": True}, "CliffWalkingSlippery-v1", {}),
    ],
    ids=["taxi", "rainy taxi", "cliff", "slippery cliff"],
)
def test_it_is_gymnasiums_state_by_state(name, parameters, of_gymnasium, given):
    """Where an episode can come to and goes on; in their tables it goes on from where it has ended, too.

    Broken once -> each fails: a taxi that drifts where its move is stopped; a slippery step with one side twice.
    """
    env, table = rl.make(name, **parameters), gymnasium.make(of_gymnasium, **given)
    model = planning.exact_model(env)
    lives = planning.reachable(model) & ~planning.terminal_states(model)
    for x, y in zip(ours(env), theirs(table.unwrapped.P), strict=True):
        np.testing.assert_allclose(x[lives], y[lives], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(model.start, table.unwrapped.initial_state_distrib, rtol=1e-12)
    limit = table.spec.max_episode_steps
    assert limit is None or env.max_steps == limit


def test_the_fickle_passenger_is_gymnasiums():
    """What happens in their `step`, with each draw that it may make, beside their table, which does not show it."""
    env, inner = (
        rl.make("taxi", fickle_passenger=True),
        gymnasium.make("Taxi-v4", fickle_passenger=True).unwrapped,
    )
    model = planning.exact_model(env)

    class Fixed:
        """Random numbers that are known."""

        def __init__(self, pick):
            self.pick = pick

        def random(self):
            return 0.0

        def choice(self, among):
            return among[self.pick]

    def stepped(s, a, fickle, pick=0):
        inner.s, inner.fickle_step, inner._np_random = s, fickle, Fixed(pick)
        s_next, reward, terminal, *_ = inner.step(a)
        settled = not inner.fickle_step
        return s_next, reward, terminal, settled

    lives = np.flatnonzero(planning.reachable(model) & ~planning.terminal_states(model))
    for s, a in product(lives[::7], range(6)):
        settled = s >= 500
        stays = stepped(s % 500, a, False)
        rides = s // 4 % 5 == 4 and not settled and stays[0] // 20 != s % 500 // 20
        expected = {}
        if rides:
            expected[(500 + stays[0], *stays[1:3])] = 0.7
            for pick in range(3):
                *changed, used = stepped(s, a, True, pick)
                assert used
                expected[(500 + changed[0], *changed[1:])] = 0.1
        else:
            expected[(500 * settled + stays[0], *stays[1:3])] = 1.0
        got, columns = {}, (model.prob, model.s_next, model.reward, model.terminal)
        for p, *outcome in zip(*(x[s, a].tolist() for x in columns), strict=True):
            got[tuple(outcome)] = got.get(tuple(outcome), 0) + p
        assert {x: p for x, p in got.items() if p} == pytest.approx(expected)


def test_optimal_values_of_the_taxi_and_the_cliff():
    assert optimum("taxi") == pytest.approx(7.93, abs=1e-9)
    assert optimum("cliff-walking", is_slippery=True) == pytest.approx(-64.709176, abs=1e-6)


def test_the_taxi_is_seen_in_its_town():
    env = rl.make("taxi")
    assert [panel.title for panel in env.panels()][:4:3] == ["R → G", "G → R"]
    assert state_names(env)(((3 * 5 + 1) * 5 + 2) * 4) == "row 3, column 1, Y → R"
    assert len({int(s) for panel in env.panels() for s in panel.states.ravel()}) == 400


# --- the gambler -------------------------------------------------------------------------------------


def test_the_gambler_is_bold_where_the_coin_is_not_fair():
    """Dubins and Savage; broken once: heads and tails exchanged -> fails."""
    env = rl.make("gamblers-problem", goal=64)
    v, q = planning.value_iteration(env)
    expected = np.zeros(65)
    expected[64] = 1
    for step in (32, 16, 8, 4, 2, 1):  # of dyadic capitals it ends
        for s in range(step, 64, 2 * step):
            expected[s] = 0.4 * expected[2 * s] if s <= 32 else 0.4 + 0.6 * expected[2 * s - 64]
    np.testing.assert_allclose(v[:-1], expected[:-1], atol=1e-9)
    stakes = [np.flatnonzero(row >= row.max() - 1e-9) for row in q]
    assert all(min(s, 64 - s) in stakes[s] for s in range(1, 64))
    assert q[10, 11] == q[10, 0] == UNAVAILABLE and q[10, 10] > 0
    v = planning.value_iteration(rl.make("gamblers-problem"))[0]
    np.testing.assert_allclose(v[[0, 25, 50, 75, 100]], [0, 0.16, 0.4, 0.64, 0], atol=1e-9)


def test_the_gambler_is_timid_where_it_is_better_than_fair():
    v = planning.value_iteration(rl.make("gamblers-problem", goal=20, p_h=0.55))[0]
    r = 0.45 / 0.55
    np.testing.assert_allclose(v[1:20], (1 - r ** np.arange(1, 20)) / (1 - r**20), rtol=1e-9)


def test_the_coin_can_be_swept():
    odds = jnp.array([0.25, 0.4, 0.55])
    prob = jax.vmap(lambda p_h: rl.envs.GamblersProblem(p_h=p_h).outcomes(jnp.int32(3), jnp.int32(1))[0])(
        odds
    )
    np.testing.assert_allclose(prob[:, 0], odds)


# --- the robot ---------------------------------------------------------------------------------------


def test_the_robot_has_the_table_of_the_book():
    """Example 3.3, with alpha = 0.9, beta = 0.4, r_search = 5 and r_wait = 2: all rows that the book prints."""
    high, low, search, wait, recharge = 0, 1, 0, 1, 2
    a, b = 0.9, 0.4
    env = rl.make("recycling-robot", stays_high=a, stays_low=b, search_reward=5.0, wait_reward=2.0)
    model = planning.exact_model(env)
    got = {
        (s, act, int(s_next)): (pytest.approx(p), r)
        for s, act in product(range(2), range(3))
        if model.available[s, act]
        for p, s_next, r in zip(*(x[s, act] for x in (model.prob, model.s_next, model.reward)), strict=True)
        if p
    }
    assert got == {
        (high, search, high): (a, 5),
        (high, search, low): (1 - a, 5),
        (low, search, high): (1 - b, -3),
        (low, search, low): (b, 5),
        (high, wait, high): (1, 2),
        (low, wait, low): (1, 2),
        (low, recharge, high): (1, 0),
    }
    assert not model.terminal.any()


def test_what_the_robot_should_do():
    """v* solves v_h = r + g (a v_h + (1 - a) v_l), v_l = g v_h, where recharging is best."""
    v, q = planning.value_iteration(rl.make("recycling-robot"), 0.9)
    high = 2 / (1 - 0.9 * 0.7 - 0.9**2 * 0.3)
    assert v == pytest.approx([high, 0.9 * high]) and q.argmax(1).tolist() == [0, 2]
    assert q[0, 2] == UNAVAILABLE


# --- Jack's cars -------------------------------------------------------------------------------------


def plain_day(cars, capacity, requests, returns):
    """p(evening | morning), and the cars rented, by a loop over all that may be asked for and brought back."""
    evening, mean = np.zeros(capacity + 1), 0.0
    poisson = lambda mean, n: math.exp(-mean) * mean**n / math.factorial(n)
    for asked, back in product(range(40), range(40)):
        p, rented = poisson(requests, asked) * poisson(returns, back), min(asked, cars)
        evening[min(cars - rented + back, capacity)] += p
        mean += p * rented
    return evening, mean


@pytest.mark.parametrize("exercise", [False, True])
def test_a_day_and_a_night_of_the_cars(exercise):
    """Broken once -> each fails: one car more rented than there is; the second lot from 12 cars on; the free car on

    the way back.
    """
    env = rl.make("jacks-car-rental", capacity=12, most_moved=2, exercise=exercise)
    model = planning.exact_model(env)
    s, a = 13 * 12 + 11, 3  # 12 and 11 cars, of which one is moved from the first location to the second
    (first, rented), (second, more) = plain_day(11, 12, 3, 3), plain_day(12, 12, 4, 2)
    order = np.argsort(model.s_next[s, a])
    np.testing.assert_allclose(model.prob[s, a][order], np.outer(first, second).ravel(), atol=1e-12)
    cost = 4 + 4 if exercise else 2
    np.testing.assert_allclose(model.reward[s, a], 10 * (rented + more) - cost, rtol=1e-12)
    assert not model.available[13, 4] and model.available[13, 3]  # 1 and 0 cars: two cannot be moved
    assert model.available[13 * 0 + 2, 0]


@pytest.mark.slow
def test_the_optimum_of_the_cars():
    """Solved by plain value iteration over the days above, in float64."""
    assert optimum("jacks-car-rental", 0.9) == pytest.approx(574.948324, abs=1e-6)


# --- the racetrack -----------------------------------------------------------------------------------


def driven(rows, cell, velocity):
    """Where a car ends, in exact halves: a cell, "end", or "crash"."""
    (row, column), (up, right) = cell, velocity
    n = max(up, right)
    for k in range(1, n + 1):
        y, x = row - math.floor(k * up / n + 0.5), column + math.floor(k * right / n + 0.5)
        if not (y >= 0 and x < len(rows[0])) or rows[y][x] == "#":
            return "crash"
        if rows[y][x] == "G":
            return "end"
    return (row, column) if n == 0 else (y, x)


@pytest.mark.parametrize("track", [{"map": ["##..G", "#...G", ".....", "SSS##"]}, {"track": "left"}])
def test_the_car_goes_where_a_plain_loop_says(track):
    """Broken once: a car that stands still off the starting line; the finish looked for at the end of a move alone;
    up and right exchanged -> fails.
    """
    env = rl.make("racetrack", failure=0.25, **track)
    rows, model, end = env.rows, planning.exact_model(env), env.num_states - 1
    starts = [env.state(len(rows) - 1, k) for k, x in enumerate(rows[-1]) if x == "S"]
    assert np.flatnonzero(model.start).tolist() == starts
    number = {tuple(place): i for i, place in enumerate(env.places.tolist())}
    for s in range(0, end, 1 if end < 500 else 37):
        *cell, up, right = env.places[s].tolist()
        for a, (down, along) in enumerate(rl.envs.base.COMPASS):
            expected = np.zeros(env.num_states)
            new = min(max(up - down, 0), 4), min(max(right + along, 0), 4)
            if new == (0, 0) and rows[cell[0]][cell[1]] != "S":
                new = up, right
            for p, velocity in ((0.75, new), (0.25, (up, right))):
                to = driven(rows, cell, velocity)
                if to == "crash":
                    expected[starts] += p / len(starts)
                else:
                    expected[end if to == "end" else number[(*to, *velocity)]] += p
            got = np.bincount(model.s_next[s, a], model.prob[s, a], env.num_states)
            np.testing.assert_allclose(got, expected, atol=1e-12)
            assert (model.reward[s, a] == -1).all()


def test_the_tracks_are_those_of_the_book():
    count = lambda rows: (rows[-1].count("S"), "".join(rows).count("G"))
    sizes = {name: (len(rows), len(rows[0]), *count(rows)) for name, rows in TRACKS.items()}
    assert sizes == {"left": (32, 17, 6, 6), "right": (30, 32, 23, 9)}
    assert {name: rl.make("racetrack", track=name).num_states for name in TRACKS} == {
        "left": 2361,
        "right": 7794,
    }


@pytest.mark.parametrize(
    ("track", "value"), [("left", -11.694577), pytest.param("right", -8.895873, marks=pytest.mark.slow)]
)
def test_how_fast_a_race_can_be(track, value):
    assert optimum("racetrack", track=track) == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"map": ["..G"]}, "racetrack: the track has no starting line, of letters S"),
        ({"map": ["S.."]}, "racetrack: the track has no finish line, of letters G"),
        ({"map": ["S.Q"]}, "racetrack: row 0, column 2: the letter 'Q' is not in the legend"),
        ({"track": "middle"}, "racetrack: track 'middle' is unknown; choose one of left, right"),
    ],
)
def test_mistakes_in_a_track(parameters, message):
    with pytest.raises(rl.InputError) as error:
        rl.make("racetrack", **parameters)
    assert str(error.value).startswith(message)


def test_a_state_says_where_the_car_is_and_how_fast():
    """Broken once: the name not asked for -> fails."""
    env = rl.make("racetrack")
    names = state_names(env)
    assert names(env.state(28, 4, 2, 0)) == "(28, 4), speed ↑2 →0" and names(env.num_states - 1) == "finish"


def test_no_car_is_off_the_track():
    with pytest.raises(rl.InputError, match=r"Racetrack: no car can come to \(0, 0\) with velocity \(0, 0\)"):
        rl.make("racetrack").state(0, 0)


# --- the figures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["state-values", "gamblers-problem", "recycling-robot"])
def test_the_numbers_of_the_book_come_out(name):
    """All of them, and what is printed as well. (Those that take longer: test_figures.)"""
    figure = FIGURES[name]
    datasets = {key: run(lambda state: None) for key, run in figure.experiment().items()}
    for number in figure.numbers:
        check = number.check(datasets)
        assert check.ok and check.reproduces is not False, check
