"""Function approximation: features, and methods whose values are linear in them, against plain loops and tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference_linear

import jaxrl_tab as rl
from jaxrl_tab import approx
from jaxrl_tab.approx.features import read
from jaxrl_tab.core.types import Transition, fitted, init_learner

KEY = jax.random.key(0)
CAR = rl.MountainCar()


# --- features ------------------------------------------------------------------------------------------


def tiles_of_the_book(x, tilings):
    """The tile of each tiling, as Sutton's tiles3 has it without a hash: x in units of a tile's width."""
    fine = [int(np.floor(v * tilings)) for v in x]
    found = []
    for tiling in range(tilings):
        coordinates, shift = [], tiling
        for v in fine:
            coordinates.append((v + shift) // tilings)
            shift += 2 * tiling
        found.append(tuple(coordinates))
    return found


@pytest.mark.parametrize("tilings", [4, 8])
def test_two_states_share_a_tile_where_they_do_in_the_book(tilings):
    """Broken once: shifts of 1, 2, 3 instead of 1, 3, 5 -> fails."""
    points = np.random.default_rng(1).random((60, 2))
    features = approx.TileCoding(tilings, (5, 3), low=(0, 0), high=(1, 1))
    ours = np.stack([features(jnp.asarray(x)).ones for x in points])
    book = [tiles_of_the_book(x * (5, 3), tilings) for x in points]
    for tiling in range(tilings):
        ids = [tile[tiling] for tile in book]
        same = np.array([[a == b for b in ids] for a in ids])
        np.testing.assert_array_equal(ours[:, tiling, None] == ours[:, tiling], same)
    assert ours.min() >= 0
    assert ours.max() < features.size
    assert (np.diff(ours, axis=1) > 0).all()  # each tiling has indices of its own


def test_tiles_by_hand():
    """Two tilings of two tiles on [0, 1], which have three each: the second is moved by half a tile."""
    features = approx.TileCoding(2, 2, low=0, high=1)
    by_hand = {0.0: (0, 3), 0.3: (0, 4), 0.5: (1, 4), 0.8: (1, 5), 1.0: (2, 5)}
    for x, tiles in by_hand.items():
        np.testing.assert_array_equal(features(jnp.asarray([x])).ones, tiles)
    assert features.size == 6


@pytest.mark.parametrize(
    ("text", "x"),
    [
        ("polynomial(2)", [1, 0.5, 0.25, 0.25, 0.125, 0.0625, 0.0625, 0.03125, 0.015625]),
        ("fourier(1)", [1, np.cos(np.pi / 2), np.cos(np.pi / 4), np.cos(3 * np.pi / 4)]),
        ("radial-basis(2, 0.5)", [np.exp(-2 * d) for d in (0.3125, 0.3125, 0.8125, 0.8125)]),
        ("aggregation((2, 4))", 2),
    ],
)
def test_features_by_hand(text, x):
    """At (1/4, 1/2) of the range, each number in its turn."""
    features = read(text).ranged((-1.0, 0.0), (1.0, 10.0))
    np.testing.assert_allclose(features(jnp.asarray([-0.5, 5.0])), x, atol=1e-6)
    assert str(read(str(features))) == str(features)


@pytest.mark.parametrize(
    ("few", "many"), [("fourier(2)", "fourier(20)"), ("radial-basis(2)", "radial-basis(20)")]
)
def test_many_features_are_no_longer_program(few, many):
    """Of 400 features that were worked out one by one a program took a minute to compile."""
    traced = [jax.make_jaxpr(read(text).fitted(CAR))(jnp.zeros(2)).jaxpr.eqns for text in (few, many)]
    assert len(traced[0]) == len(traced[1])


def test_features_of_counted_states_are_worked_out_beforehand():
    """In float64; and a matrix of them is taken as it is."""
    walk = rl.RandomWalk(states=5)
    rows = read("tile-coding(2, 3)").fitted(walk)
    own = read("tile-coding(2, 3, low=0, high=6)")
    for s in range(7):
        np.testing.assert_array_equal(rows(jnp.int32(s)).ones, own(jnp.asarray([float(s)])).ones)
    assert rows.matrix.sum(1).tolist() == [2] * 7
    grid = read("aggregation((7, 2))").fitted(
        rl.WindyGridworld()
    )  # of rows, and of the two halves of columns
    np.testing.assert_array_equal(grid.numbers[:, 0], [2 * (s // 10) + (s % 10 > 4) for s in range(70)])
    for states, groups in ((8, 7), (13, 36), (1002, 99)):  # borders on which states lie, in spite of rounding
        s = np.arange(states)
        got = approx.matrix(f"aggregation({groups})", rl.make("long-walk", states=states - 2)).argmax(1)
        np.testing.assert_array_equal(got, np.minimum(s * groups // (states - 1), groups - 1))
    given = approx.Rows(np.eye(7)[:, ::-1])
    assert given.fitted(walk) == given
    assert approx.Rows(np.eye(7)) != given
    assert repr(approx.Rows(np.eye(7))) != repr(given)  # a program that is kept has this name


# --- methods ---------------------------------------------------------------------------------------------

METHODS = {
    "sarsa": (approx.SemiGradientSarsa, {}),
    "expected-sarsa": (approx.SemiGradientExpectedSarsa, {}),
    "q-learning": (approx.SemiGradientQLearning, {}),
    "n-step": (approx.SemiGradientNStepSarsa, {"n": 3}),
    "accumulating": (approx.SemiGradientSarsaLambda, {"lam": 0.8, "trace": "accumulating"}),
    "replacing": (approx.SemiGradientSarsaLambda, {"lam": 0.8, "trace": "replacing"}),
    "clearing": (approx.SemiGradientSarsaLambda, {"lam": 0.8, "trace": "clearing"}),
    "dutch": (approx.SemiGradientTrueOnlineSarsaLambda, {"lam": 0.8}),
}


def steps(count, states=70, actions=4, gamma=0.9, seed=3):
    """Transitions of episodes, of which one in eight ends, half of these by the time limit."""
    rand = np.random.default_rng(seed)
    s, found = int(rand.integers(states)), []
    for _ in range(count):
        s_next, last = int(rand.integers(states)), bool(rand.random() < 1 / 8)
        discount = 0.0 if last and rand.random() < 0.5 else gamma
        found.append((s, int(rand.integers(actions)), float(rand.normal()), s_next, discount, last))
        s = int(rand.integers(states)) if last else s_next
    return found


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize(
    "features", ["tile-coding(4, 5)", pytest.param("polynomial(3)", marks=pytest.mark.slow)]
)
def test_methods_learn_what_a_plain_loop_learns(name, features):
    """After each of 300 transitions, in float64.

    Broken once: a step that changes the first tiling alone, or all twice; dutch traces without their alpha -> each
    fails.
    """
    cls, more = METHODS[name]
    if features == "polynomial(3)" and name in ("replacing", "clearing"):
        return  # what a replacing trace is where all features are numbers nobody has said
    transitions = steps(300)
    with jax.enable_x64():
        method = fitted(cls(features=features, alpha=0.05, gamma=0.9, **more), rl.WindyGridworld())
        arrays = Transition(*map(jnp.asarray, zip(*transitions, strict=True)))
        keys = jax.random.split(KEY, len(transitions))

        def one(state, step):
            key, t = step
            state, a_next = method.update(key, state, t)
            return state, (state.q, a_next)

        state = init_learner(method, rl.WindyGridworld())
        _, (q, a_next) = jax.jit(lambda *steps: jax.lax.scan(one, state, steps))(keys, arrays)
        rows = method.features.matrix
    kind = (
        name
        if cls not in (approx.SemiGradientSarsaLambda, approx.SemiGradientTrueOnlineSarsaLambda)
        else "lambda"
    )
    own = {"trace": name} | more if kind == "lambda" else more
    by_hand = list(
        reference_linear.learned(kind, rows, transitions, np.asarray(a_next), alpha=0.05, gamma=0.9, **own)
    )
    np.testing.assert_allclose(q, by_hand, rtol=1e-9, atol=1e-11)


TWINS = [
    (rl.Sarsa, approx.SemiGradientSarsa, {}),
    (rl.ExpectedSarsa, approx.SemiGradientExpectedSarsa, {}),
    (rl.QLearning, approx.SemiGradientQLearning, {}),
    (rl.NStepSarsa, approx.SemiGradientNStepSarsa, {}),
    (rl.SarsaLambda, approx.SemiGradientSarsaLambda, {"trace": "clearing"}),
    (rl.TrueOnlineSarsaLambda, approx.SemiGradientTrueOnlineSarsaLambda, {}),
    (rl.prediction.TD, approx.SemiGradientTD, {}),
    (rl.prediction.NStepTD, approx.SemiGradientNStepTD, {}),
    (rl.prediction.TDLambda, approx.SemiGradientTDLambda, {}),
    (rl.prediction.TrueOnlineTDLambda, approx.SemiGradientTrueOnlineTDLambda, {}),
]


@pytest.mark.parametrize(("table", "linear", "more"), TWINS)
@pytest.mark.one_in(4)
def test_one_hot_features_are_the_table(table, linear, more):
    """To the last bit, with exact values beside them: where every feature is a state, nothing else is computed."""
    env = rl.RandomWalk(states=5) if issubclass(table, rl.prediction.Prediction) else rl.WindyGridworld()
    budget = {"num_steps": 400, "exact": True}
    mine, log = rl.train(KEY, table(alpha=0.5, **more), env, **budget)
    theirs, other = rl.train(KEY, linear(alpha=0.5, **more), env, **budget)
    np.testing.assert_array_equal(mine.q, theirs.q)
    for x, y in zip(log, other, strict=True):
        if x is not None:  # of V with features more errors are recorded
            np.testing.assert_array_equal(x, y)


def test_unavailable_actions_are_not_taken_and_not_counted():
    """The gambler cannot stake what he does not have. Broken once: rows without a mask -> fails."""
    env = rl.make("gamblers-problem")
    state, log = rl.train(
        KEY, approx.SemiGradientQLearning(features="aggregation(20)", alpha=0.2), env, num_steps=500
    )
    assert (log.rewards >= 0).all()
    table = np.asarray(rl.sweep(env, approx.SemiGradientQLearning, {"features": "aggregation(20)"}, num_seeds=2,
                                num_steps=500, progress=False).q)  # fmt: skip
    available = np.asarray(jax.vmap(env.available)(jnp.arange(env.num_states)))
    assert (table[:, ~available] < -1e29).all()
    assert (abs(table[:, available]) <= 1).all()
    assert np.isfinite(state.q).all()


def test_values_of_all_states_are_in_the_results_and_are_judged():
    """V of a walk by four groups of states, and its exact error; weights are what the learner has."""
    walk = rl.RandomWalk(states=19)
    grid = {"features": ["aggregation(4)", "aggregation(21)"], "alpha": [0.05]}
    result = rl.sweep(
        walk, approx.SemiGradientTD, grid, num_seeds=4, num_episodes=60, exact=True, progress=False
    )
    v = result.q[..., 0]
    assert v.shape == (2, 1, 4, 21)
    assert (np.diff(v[0], axis=-1) != 0).sum(-1).max() == 3
    truth = np.arange(-9, 10) / 10
    errors = np.sqrt(((v[..., 1:-1] - truth) ** 2).mean(-1))
    np.testing.assert_allclose(result.log.v_error[..., -1], errors, rtol=1e-5)
    ds = result.to_xarray()
    assert list(ds.features.values) == ["aggregation(4)", "aggregation(21)"]
    assert not ds.diverged.any()


def test_first_values_are_those_of_every_state():
    """q0 is the value of all pairs, whatever the features are."""
    for features in ("tile-coding(4, 3)", "polynomial(2)", "aggregation(3)"):
        method = fitted(approx.SemiGradientSarsa(features=features, q0=5.0), rl.WindyGridworld())
        state = init_learner(method, rl.WindyGridworld())
        rows = jax.vmap(method.row, (None, 0))(state, jnp.arange(70))
        np.testing.assert_allclose(rows, 5.0, rtol=1e-6)


# --- the mountain car ------------------------------------------------------------------------------------


def test_the_mountain_car_goes_as_in_the_book():
    """Two thousand steps of somebody who pushes anyhow, against the equations of example 10.1 in float64."""
    rand = np.random.default_rng(0)
    position, velocity = rand.uniform(-1.2, 0.5, 2000), rand.uniform(-0.07, 0.07, 2000)
    a = rand.integers(0, 3, 2000)
    s = np.stack([position, velocity], 1).astype(np.float32)
    after = jax.vmap(lambda s, a: CAR.step(KEY, s, a))(jnp.asarray(s), jnp.asarray(a, jnp.int32))
    speed = np.clip(velocity + 0.001 * (a - 1) - 0.0025 * np.cos(3 * position), -0.07, 0.07)
    place = np.clip(position + speed, -1.2, 0.5)
    speed = np.where(place <= -1.2, 0, speed)
    np.testing.assert_allclose(after.s_next, np.stack([place, speed], 1), atol=3e-7)
    np.testing.assert_array_equal(after.terminal, place >= 0.5)
    assert (after.reward == -1).all()
    starts = jax.vmap(CAR.reset)(jax.random.split(KEY, 2000))
    assert (starts[:, 1] == 0).all()
    assert -0.6 <= starts[:, 0].min() < -0.599
    assert -0.401 < starts[:, 0].max() < -0.4


@pytest.fixture(scope="module")
def cars():
    """As figure 10.2 has them, by lanes: 30 runs of 500 episodes."""
    grid = {"features": "tile-coding(8, 8)", "alpha": 0.5, "per_tiling": True, "epsilon": 0.0}
    return rl.sweep(CAR, approx.SemiGradientSarsa, grid, num_seeds=30, num_episodes=500, progress=False)


def test_the_mountain_car_is_learned_as_in_figure_10_2(cars):
    """Some 115 steps an episode in the end, and some 400 to 450 in the tenth; nobody goes astray."""
    lengths = cars.log.lengths
    last = lengths[:, -50:].mean(1)
    assert abs(last.mean() - 118) < 3 + 4 * last.std() / np.sqrt(len(last))
    assert 200 < lengths[:, 5:15].mean() < 500
    assert not cars.diverged.any()
    assert dict(cars.to_xarray().q.sizes) == {"seed": 30, "feature": 648, "action": 3}


def test_a_run_alone_has_the_bits_of_the_batch(cars):
    """That XLA gives these bits, too, is tested in test_lanes_same_bits."""
    method = approx.SemiGradientSarsa(features="tile-coding(8, 8)", alpha=0.5, per_tiling=True, epsilon=0.0)
    _, log = rl.train(jax.random.fold_in(KEY, 7), method, CAR, num_episodes=20)
    np.testing.assert_array_equal(log.lengths, cars.log.lengths[7, :20])


# --- refusals --------------------------------------------------------------------------------------------

REFUSED = {  # see test_approx_refusals
    "'tile-coding(8, 8' is not the name of features": lambda: read("tile-coding(8, 8"),
    "'' is not the name of features": lambda: read(""),
    "a replacing trace is for features that are 1 or 0, and fourier(5) are numbers": lambda: (
        approx.SemiGradientSarsaLambda(features="fourier")
    ),
    "q0 is a table, and values are functions of the features fourier(5": lambda: train(
        approx.SemiGradientSarsa(features="fourier", q0=np.ones((70, 4))), rl.WindyGridworld()
    ),
    "must be features that are finite in float32": lambda: read([[1e39]]),
    "and those of MountainCar cannot be counted": lambda: train(approx.SemiGradientSarsa(features=np.eye(7))),
    "MountainCar may end, and differential-semi-gradient-sarsa is for tasks that do not end": lambda: train(
        approx.DifferentialSemiGradientSarsa(features="tile-coding")
    ),
    "a matrix [S, n] is one value where it is approx.Rows(matrix)": lambda: rl.sweep(
        CAR, approx.SemiGradientSarsa, {"features": np.eye(7)}, num_seeds=1, num_steps=1
    ),
    "there are no features 'tile-codin'; did you mean 'tile-coding'": lambda: read("tile-codin(3)"),
    "TileCoding: tilings must be a whole number of at least 1, not 0": lambda: read("tile-coding(0)"),
    "TileCoding: tiles must be whole numbers of at least 1, not 0": lambda: read("tile-coding(8, 0)"),
    "Fourier: high must be above low, and number 0 is 0, not above 1": lambda: read(
        "fourier(3, low=1, high=0)"
    ),
    "Polynomial: low are 2 numbers, and high are 1": lambda: read("polynomial(2, low=(0, 1), high=2)"),
    "takes tilings, tiles": lambda: read("tile-coding(8, 8, 8)"),
    "Rows: numbers must be features of all states": lambda: read([[1, 2], [3]]),
    "SemiGradientSarsa: features": lambda: approx.SemiGradientSarsa(features="tile-coding(0)"),
    "cannot be divided by how many are 1": lambda: approx.SemiGradientSarsa(
        features="fourier", per_tiling=True
    ),
    "Sarsa keeps a table, and the states of MountainCar cannot be counted": lambda: train(rl.Sarsa()),
    "OneHot: the states of MountainCar cannot be counted": lambda: train(approx.SemiGradientSarsa()),
    "what goes by visits needs states that can be counted": lambda: train(
        approx.SemiGradientSarsa(features="tile-coding", alpha=rl.schedules.sample_average())
    ),
    "tiles are 3 numbers, and 2 are observed": lambda: train(
        approx.SemiGradientSarsa(features="tile-coding(8, (1, 2, 3))")
    ),
    "low are 1 numbers, and 2 are observed": lambda: train(
        approx.SemiGradientSarsa(features="tile-coding(8, 8, low=0, high=1)")
    ),
    "number 0 of what is observed of a state is between -1.2 and 0.5": lambda: train(
        approx.SemiGradientSarsa(features="tile-coding(8, 8, low=(-1, -1), high=(1, 1))")
    ),
    "tile-coding(8, 5000) are 200,080,008 features, and at most 16,777,216 are possible": lambda: train(
        approx.SemiGradientSarsa(features="tile-coding(8, 5000)")
    ),
    "features of 7 states were given, and the task has 70": lambda: train(
        approx.SemiGradientSarsa(features=np.eye(7)), rl.WindyGridworld()
    ),
    "give every state the value 1.0: leave it at 0": lambda: train(
        approx.SemiGradientSarsa(features="radial-basis", q0=1.0), rl.WindyGridworld()
    ),
    "exact values": lambda: rl.train(
        KEY, approx.SemiGradientSarsa(features="tile-coding"), CAR, num_steps=3, exact=True
    ),
    "is on no row of the table": lambda: rl.bridge.row_of(approx.SemiGradientSarsa()),
    "there are exact learning curves of TD": lambda: rl.moments.learning_curve(
        approx.SemiGradientTD(), rl.RandomWalk(states=5), num_episodes=2
    ),
}


def train(method, env=CAR):
    return rl.train(KEY, method, env, num_steps=3)


def test_where_states_cannot_be_counted_the_results_have_room_for_the_most_weights():
    """Those of fewer features stand at the beginning. Broken once: room for those of the first alone -> fails."""
    grid = {"features": ["tile-coding(2, 2)", "tile-coding(4, 3)"], "epsilon": 0.0}
    both = rl.sweep(CAR, approx.SemiGradientSarsa, grid, num_seeds=2, num_steps=50)
    assert both.q.shape == (2, 2, 64, 3)
    assert not both.q[0, :, 18:].any()
    for i, features in enumerate(grid["features"]):
        alone = rl.sweep(
            CAR, approx.SemiGradientSarsa, grid | {"features": features}, num_seeds=2, num_steps=50
        )
        np.testing.assert_array_equal(both.q[i, :, : alone.q.shape[1]], alone.q)
