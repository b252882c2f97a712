"""The small examples of the lecture and the book: dynamics by hand, and the numbers they are known for."""

import dataclasses
import random
from collections import defaultdict
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.core import rng
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Outcome

UP, RIGHT, DOWN, LEFT = range(4)


def after(env, s: int, a: int) -> set[tuple[float, int, float, bool]]:
    """(probability, s', reward, terminal) of all that can follow `a` in `s`."""
    prob, *outcome = (x[s, a].tolist() for x in planning.exact_model(env)[:4])
    return {x for x in zip(prob, *outcome, strict=True) if x[0] > 0}


def random_words(n: int) -> jax.Array:
    """Keys of the kind that the loop uses."""
    return rng.as_key(jnp.asarray(np.random.default_rng(0).integers(2**32, size=n, dtype=np.uint32)))


def rewards(env, s: int, a: int, n: int) -> np.ndarray:
    step = jax.jit(jax.vmap(lambda env, key, s, a: env.step(key, s, a).reward, (None, 0, None, None)))
    return np.asarray(step(env, random_words(n), jnp.int32(s), jnp.int32(a)))


# --- the two doors -----------------------------------------------------------------------------------

HALF, THIRD = Fraction(1, 2), Fraction(1, 3)
DOORS = {  # prizes, and their probabilities behind each door
    "lecture": ((0, 1, 2, 3, 6), (HALF, 0, 0, 0, HALF), (0, HALF / 2, HALF, HALF / 2, 0)),
    "left is worse": ((0, 1, 2), (HALF, HALF, 0), (HALF, 0, HALF)),
    "rarely pays": ((0, 0.5, 100), (Fraction(7, 8), 0, Fraction(1, 8)), (HALF / 2, 3 * HALF / 2, 0)),
    "never pays": ((0, 1), (HALF, HALF), (1, 0)),
    "always pay": ((3, 1), (HALF, HALF), (0, 1)),
}


def doors(name: str) -> rl.TwoDoors:
    prizes, left, right = DOORS[name]
    return rl.TwoDoors(prizes=prizes, left=[float(p) for p in left], right=[float(p) for p in right])


def greedy_doors(mean: list) -> list[int]:
    return [door for door in (0, 1) if mean[door] == max(mean)]


def chance_of_worse_by_histories(name: str, plays: int) -> tuple[Fraction, Fraction]:
    """After so many plays of a greedy agent: the chance that only the worse door is left, and that both are.

    Every history is followed, with the sums and counts that sample averages are made of, in exact fractions.
    """
    prizes, *probs = DOORS[name]
    means = [sum(Fraction(x) * p for x, p in zip(prizes, prob, strict=True)) for prob in probs]
    worse = means.index(min(means))
    mass = {((Fraction(0), 0), (Fraction(0), 0)): Fraction(1)}

    def average(door):
        total, count = door
        return total / count if count else Fraction(0)

    for _ in range(plays):
        after_play = defaultdict(Fraction)
        for doors, chance in mass.items():
            greedy = greedy_doors([average(door) for door in doors])
            for choice in greedy:
                total, count = doors[choice]
                for prize, p in zip(prizes, probs[choice], strict=True):
                    changed = list(doors)
                    changed[choice] = (total + Fraction(prize), count + 1)
                    if p:
                        after_play[tuple(changed)] += chance * p / len(greedy)
        mass = after_play
    greedy = [(greedy_doors([average(door) for door in doors]), chance) for doors, chance in mass.items()]
    return (
        sum((chance for choice, chance in greedy if choice == [worse]), Fraction(0)),
        sum((chance for choice, chance in greedy if len(choice) == 2), Fraction(0)),
    )


@pytest.mark.parametrize("name", DOORS)
def test_lock_in_by_following_every_history(name):
    """The probability is what the worse door has already, and a share of what is still open.

    Broken once: `np.argmax(mean)`, and `prizes >= 0` for what pays -> fails.
    """
    worse, open_ = chance_of_worse_by_histories(name, plays=7)
    probability = doors(name).lock_in_probability()
    assert worse - 1e-12 <= probability <= worse + open_ + 1e-12
    share = worse / (1 - open_)  # each play until the matter is decided is like the first
    assert probability == pytest.approx(float(share), abs=1e-12)


@pytest.mark.parametrize(
    ("name", "expected"), [("lecture", 2 / 3), ("rarely pays", 6 / 7), ("never pays", 0)]
)
def test_lock_in_by_plain_loops(name, expected):
    assert doors(name).lock_in_probability() == pytest.approx(expected, abs=1e-12)
    prizes, *probs = ([float(x) for x in row] for row in DOORS[name])
    worse = int(np.argmin([np.dot(prizes, prob) for prob in probs]))
    draw, agents, locked = random.Random(0), 2000, 0
    for _ in range(agents):
        average, count = [0.0, 0.0], [0, 0]
        for _ in range(100):
            door = draw.choice(greedy_doors(average))
            [prize] = draw.choices(prizes, probs[door])
            count[door] += 1
            average[door] += (prize - average[door]) / count[door]
        locked += greedy_doors(average) == [worse]
    error = np.sqrt(expected * (1 - expected) / agents)
    assert abs(locked / agents - expected) <= 4 * error


def test_lock_in_by_training():
    """Greedy Q-learning with sample averages stays with the door that it is said to stay with, as often."""
    env, runs = rl.TwoDoors(), 1000
    greedy = rl.QLearning(alpha=rl.schedules.sample_average(), epsilon=0.0)

    @jax.jit
    @jax.vmap
    def values(key):
        return rl.train(key, greedy, env, num_steps=100)[0].q[0]

    left, right = values(jax.random.split(jax.random.key(0), runs)).T
    assert ((left == 0) != (right == 0)).all()
    expected = env.lock_in_probability()
    assert abs((left == 0).mean() - expected) < 4 * np.sqrt(expected * (1 - expected) / runs)


def test_no_door_is_worse_where_the_means_are_equal():
    """Broken once: `rtol=0` -> fails, for 0.7 in float32 is another number."""
    rounded = np.float32([0.1, 0.2, 0.7])
    env = rl.TwoDoors(prizes=(0, 1, 2), left=rounded, right=(0.2, 0, 0.8))
    assert env.left @ env.prizes != env.right @ env.prizes
    assert env.left.sum(dtype=float) == 1 != rounded.sum(dtype=float)
    assert env.lock_in_probability() == 0
    assert rl.TwoDoors(prizes=(0, 0), left=(0.5, 0.5), right=(1, 0)).lock_in_probability() == 0


def test_two_doors_outcomes():
    env = rl.TwoDoors()
    assert after(env, 0, 0) == {(0.5, 1, 0, True), (0.5, 1, 6, True)}
    assert after(env, 0, 1) == {(0.25, 1, 1, True), (0.5, 1, 2, True), (0.25, 1, 3, True)}
    np.testing.assert_allclose(planning.value_iteration(env)[1], [[3, 2], [0, 0]], atol=1e-12)
    assert env.action_names == ("left", "right")


def test_two_doors_batches_of_prizes():
    batch = dataclasses.replace(rl.TwoDoors(), prizes=np.outer([1, 2], [0, 1, 2, 3, 6]))

    def best(env):
        return env.outcomes(jnp.int32(0), jnp.int32(0))[1].reward.max()

    with pytest.raises(InputError, match=r"prizes of shape \(2, 5\) is a batch; vmap over the environment"):
        best(batch)
    stacked = dataclasses.replace(batch, left=np.stack([batch.left] * 2), right=np.stack([batch.right] * 2))
    assert jax.jit(jax.vmap(best))(stacked).tolist() == [6, 12]


# --- the k-armed test bed ----------------------------------------------------------------------------


def test_testbed_before_a_problem_is_drawn_is_the_mean_problem():
    env = rl.make("k-armed-testbed")
    assert after(env, 0, 7) == {(1, 1, 0, True)}
    assert (env.num_states, env.num_actions, env.means.shape) == (2, 10, (10,))
    assert after(rl.KArmedTestbed(arms=2, means=(0.5, -1)), 0, 1) == {(1, 1, -1, True)}
    assert rl.KArmedTestbed(arms=3, means=2).means.tolist() == [2, 2, 2]


def test_testbed_draws_a_problem_for_each_key():
    env = rl.KArmedTestbed(arms=4)
    keys = jax.random.split(jax.random.key(0), 500)
    many = jax.jit(jax.vmap(env.instance))(keys)
    means = np.asarray(many.means)
    assert means.shape == (500, 4)
    assert len(np.unique(means)) == 2000
    assert 0.01 < stats.kstest(means.ravel(), "norm").pvalue < 0.99
    np.testing.assert_array_equal(env.instance(keys[3]).means, means[3])
    of_arm_2 = jax.vmap(lambda env: env.outcomes(jnp.int32(0), jnp.int32(2))[1].reward[0])(many)
    np.testing.assert_array_equal(of_arm_2, means[:, 2])


def test_testbed_rewards_are_normal_around_the_mean():
    """From the 32 bits of one word, tails as well; none at all from the terminal state.

    Broken once: logistic noise of the same variance, and noise in the terminal state -> fails.
    """
    env, n = rl.KArmedTestbed(arms=3, means=(0, 1.5, -2)), 200_000
    for arm, mean in enumerate(env.means):
        noise = rewards(env, 0, arm, n) - mean
        assert stats.kstest(noise, "norm").pvalue > 0.01
        assert abs(noise.mean()) < 4 / np.sqrt(n)
        assert abs(noise.var() - 1) < 4 * np.sqrt(2 / n)
        assert abs((abs(noise) > 3).sum() - n * 2 * stats.norm.sf(3)) < 4 * np.sqrt(n * 2 * stats.norm.sf(3))
    assert (rewards(env, 1, 1, 10) == 0).all()


@pytest.mark.parametrize("arms", [1, 2, 3, 10, 1000])
def test_mean_of_the_best_arm(arms):
    """As the integral of P(best > x) over x > 0, less that of P(best < x) over x < 0."""
    above, _ = integrate.quad(lambda x: 1 - stats.norm.cdf(x) ** arms, 0, 12, epsabs=1e-12)
    below, _ = integrate.quad(lambda x: stats.norm.cdf(x) ** arms, -12, 0, epsabs=1e-12)
    got = rl.KArmedTestbed(arms=arms).expected_best_mean()
    assert got == pytest.approx(above - below, abs=1e-9)
    known = {2: np.pi**-0.5, 3: 1.5 * np.pi**-0.5, 10: 1.538753}
    assert got == pytest.approx(known.get(arms, got), abs=5e-7)


# --- the k-armed test bed that drifts ----------------------------------------------------------------


def test_arms_drift_as_walks_of_normal_steps():
    """q* in steps that lie near each other and far apart: the variances, steps that are independent of all else.

    Broken once, each -> fails: the variance of a middle twice as large; one walk for all arms; the later half of a
    part taken from its middle on exclusively.
    """
    env, times = rl.make("drifting-testbed", arms=3), np.array([0, 1, 2, 3, 100, 101, 9999, 10_000])
    walks = jax.jit(
        lambda keys: jax.vmap(lambda key: jax.vmap(lambda n: env.instance(key).at(n).means)(times))(keys)
    )
    x = np.asarray(walks(random_words(4000)), float) / env.drift  # [runs, times, arms]
    assert (x[:, 0] == 0).all()
    steps = np.diff(x, axis=1)
    lengths = np.diff(times)
    error = np.sqrt(2 / len(x))  # of a variance, as a part of it
    assert (abs(steps.var(0) / lengths[:, None] - 1) < 4.5 * error).all()
    assert abs(steps.mean(0) / np.sqrt(lengths)[:, None]).max() < 4.5 / np.sqrt(len(x))
    correlations = np.corrcoef(steps.reshape(len(x), -1).T) - np.eye(steps[0].size)
    assert abs(correlations).max() < 5 / np.sqrt(len(x))
    assert stats.kstest(steps[:, 0].ravel(), "norm").pvalue > 0.001


def test_arms_drift_alike_whatever_is_pulled():
    env = rl.make("drifting-testbed", arms=2, drift=0.5)
    of_run = env.instance(random_words(1)[0]).at(jnp.int32(7))
    means = np.asarray(of_run.means)
    for arm, mean in enumerate(means):
        ((prob, *into, terminal),) = after(of_run, 0, arm)
        assert (prob, terminal) == (1, True) and into == [1, pytest.approx(mean, rel=1e-6)]
    assert abs(rewards(of_run, 0, 1, 40_000).mean() - means[1]) < 4 / np.sqrt(40_000)
    assert after(env, 0, 1) == {(1, 1, 0, True)}  # no walk yet
    end, beyond = (env.instance(random_words(1)[0]).at(jnp.int32(n)).means for n in (2**24, 2**30))
    assert (end == beyond).all() and (end != 0).all()


# --- maximisation bias -------------------------------------------------------------------------------


def test_maximization_bias_outcomes():
    env = rl.MaximizationBias()
    assert [after(env, 0, a) for a in (0, 1)] == [{(1, 1, 0, False)}, {(1, 2, 0, True)}]
    for a in range(10):
        assert after(env, 1, a) == {(1, 2, -0.1, True)}
        assert after(env, 2, a) == {(1, 2, 0, True)}
    v, q = planning.value_iteration(env, gamma=1.0)
    np.testing.assert_allclose(v, [0, -0.1, 0], atol=1e-12)
    np.testing.assert_allclose(q[0, :2], [-0.1, 0], atol=1e-12)


def test_maximization_bias_has_two_actions_in_a_and_all_elsewhere():
    available = jax.vmap(rl.MaximizationBias(actions=4).available)(jnp.arange(3))
    assert available.tolist() == [[True, True, False, False], [True] * 4, [True] * 4]


def test_maximization_bias_noise():
    """N(-0.1, 1) in B and nothing elsewhere."""
    env, n = rl.MaximizationBias(), 20_000
    assert stats.kstest(rewards(env, 1, 3, n) + 0.1, "norm").pvalue > 0.01
    for s, a in ((0, 0), (0, 1), (2, 0)):
        assert (rewards(env, s, a, 10) == 0).all()


def share_of_left(double: bool, actions_in_a: int, runs: int = 2000, episodes: int = 100) -> np.ndarray:
    """Q-learning or Double Q-learning on example 6.7 in plain NumPy, all runs at once: [episodes].

    In A the even actions lead left.
    """
    draw, run = np.random.default_rng(0), np.arange(runs)
    q_a, q_b = np.zeros((2, runs, actions_in_a)), np.zeros((2, runs, 10))
    share = np.zeros(episodes)

    def greedy(q):
        return (draw.random(q.shape) * (q == q.max(1, keepdims=True))).argmax(1)

    def act(q):
        q = q.sum(0) if double else q[0]
        explores = draw.random(runs) < 0.1
        return np.where(explores, draw.integers(q.shape[1], size=runs), greedy(q))

    for episode in range(episodes):
        a, b = act(q_a), act(q_b)
        left = a % 2 == 0
        share[episode] = left.mean()
        mine, in_b = draw.integers(2, size=(2, runs)) if double else np.zeros((2, runs), int)
        other = 1 - mine if double else mine
        value_of_b = q_b[other, run, greedy(q_b[mine, run])]
        q_a[mine, run, a] += 0.1 * (np.where(left, value_of_b, 0) - q_a[mine, run, a])
        td = draw.normal(-0.1, 1, runs) - q_b[in_b, run, b]
        q_b[in_b, run, b] += 0.1 * td * left
    return share


def test_maximization_bias_needs_two_actions_in_a():
    """The numbers of the docstring; standard error 0.011."""
    two, ten = ([share_of_left(double, n) for double in (False, True)] for n in (2, 10))
    assert two[0].max() == pytest.approx(0.943, abs=0.02)  # as in the figure: Q-learning goes left, then less
    assert two[0][99] == pytest.approx(0.458, abs=0.045)
    assert two[1][9] == pytest.approx(0.457, abs=0.045)
    assert two[1].max() < 0.55  # and Double Q-learning never prefers left
    assert ten[0][99] == pytest.approx(0.626, abs=0.045)
    assert ten[1][9] == pytest.approx(0.583, abs=0.045)


# --- infinite variance -------------------------------------------------------------------------------


def test_infinite_variance_outcomes_and_values():
    env = rl.InfiniteVariance()
    assert {(round(p, 12), *rest) for p, *rest in after(env, 0, 0)} == {(0.9, 0, 0, False), (0.1, 1, 1, True)}
    assert after(env, 0, 1) == {(1, 1, 0, True)}
    left, either = [[1, 0], [1, 0]], [[0.5, 0.5], [0.5, 0.5]]
    assert planning.evaluate(env, left)[0] == pytest.approx(1, abs=1e-9)
    assert planning.evaluate(env, either)[0] == pytest.approx(1 / 11, abs=1e-9)  # v = (0.9 v + 0.1) / 2
    assert planning.evaluate(env, left, gamma=0.5)[0] == pytest.approx(0.1 / 0.55, abs=1e-9)
    np.testing.assert_allclose(planning.value_iteration(env)[1], [[1, 0], [0, 0]], atol=1e-8)


def test_infinite_variance_from_a_half_on():
    """The mean square of the importance-sampled return, by following the loop step by step."""

    def mean_square(back, steps):
        chance = {s_next: p for p, s_next, _, _ in after(rl.InfiniteVariance(back=back), 0, 0)}
        total, so_far = 0.0, 1.0  # the probability of k times left, and back, times the square of its ratio
        for _ in range(steps):
            left = so_far * 0.5 * (1 / 0.5) ** 2
            total += left * chance[1]
            so_far = left * chance.get(0, 0)
        return total

    for back in (0, 0.25, 0.45):
        limit = 2 * (1 - back) / (1 - 2 * back)
        assert mean_square(back, 400) == pytest.approx(limit, rel=1e-9)
    assert mean_square(0.5, 1000) == pytest.approx(1000)  # as much in every step
    assert mean_square(0.9, 100) > 1e20


# --- the grid of traces ------------------------------------------------------------------------------


def test_trace_gridworld_moves():
    """Broken once: reward for staying at the goal -> fails."""
    env = rl.TraceGridworld()
    goal = env.state((2, 6))
    assert (env.num_states, env.start_state, goal) == (90, 71, 26)
    assert after(env, 71, UP) == {(1, 61, 0, False)}
    assert after(env, 0, LEFT) == {(1, 0, 0, False)}
    assert after(env, 25, RIGHT) == {(1, goal, 1, True)}
    assert after(env, 16, DOWN) == {(1, goal, 1, True)}
    assert after(env, goal, LEFT) == {(1, goal, 0, True)}


def test_trace_gridworld_values_are_powers_of_gamma():
    env = rl.TraceGridworld(shape=(4, 6), start=(3, 0), goal=(1, 4))
    v, q = planning.value_iteration(env, gamma=0.5)
    row, column = np.indices(env.shape)
    distance = abs(row - 1) + abs(column - 4)
    expected = np.where(distance == 0, 0, 0.5 ** (distance - 1.0))
    np.testing.assert_allclose(v.reshape(env.shape), expected, atol=1e-12)
    assert q[env.start_state].tolist() == pytest.approx([0.5**5, 0.5**5, 0.5**6, 0.5**6])


def test_one_episode_of_sarsa_changes_one_arrow():
    algorithm = rl.Sarsa(alpha=0.5, epsilon=0.1, gamma=0.9)
    state, log = rl.train(jax.random.key(0), algorithm, rl.TraceGridworld(), num_episodes=1)
    [(s, a)] = np.argwhere(state.q)
    assert after(rl.TraceGridworld(), s, a) == {(1, 26, 1, True)}
    assert state.q[s, a] == 0.5
    assert log.lengths[0] >= 10


# --- errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("two-doors", {"prizes": (0, -1, 2, 3, 6)}, "prizes must be finite and at least 0, not -1"),
        ("two-doors", {"prizes": (0, np.inf, 2, 3, 6)}, "prizes must be finite and at least 0, not inf"),
        ("two-doors", {"prizes": 3}, "prizes must be a row of one number or more, not of shape ()"),
        ("two-doors", {"prizes": ()}, "prizes must be a row of one number or more, not of shape (0,)"),
        ("two-doors", {"prizes": "gold"}, "prizes must be numbers, in rows of equal length, not 'gold'"),
        (
            "two-doors",
            {"left": (0.5, 0.5)},
            "left must have one probability for each of the 5 prizes, not shape (2,)",
        ),
        (
            "two-doors",
            {"right": (0, 0.5, 0.25, 0, 0)},
            "the probabilities of right add up to 0.75, not to 1",
        ),
        (
            "two-doors",
            {"right": (0, 1.5, -0.5, 0, 0)},
            "right must be finite and at least 0, not -0.5",
        ),
        ("k-armed-testbed", {"arms": 0}, "arms must be a whole number of at least 1, not 0"),
        (
            "k-armed-testbed",
            {"means": (1, 2)},
            "means must have one number for each of the 10 arms, not shape (2,)",
        ),
        ("k-armed-testbed", {"means": np.nan}, "means must be finite, not nan"),
        ("k-armed-testbed", {"means": None}, "means must be numbers, in rows of equal length, not None"),
        ("maximization-bias", {"actions": 1}, "actions must be a whole number of at least 2, not 1"),
        ("infinite-variance", {"back": 1}, "back must be finite and at least 0 and less than 1, not 1"),
        ("infinite-variance", {"back": -0.1}, "back must be finite and at least 0 and less than 1, not -0.1"),
        (
            "infinite-variance",
            {"back": np.nan},
            "back must be finite and at least 0 and less than 1, not nan",
        ),
        ("infinite-variance", {"max_steps": 0}, "max_steps must be a whole number of at least 1, not 0"),
        ("trace-gridworld", {"start": (2, 6)}, "start and goal are the same cell (2, 6)"),
        (
            "trace-gridworld",
            {"goal": (9, 0)},
            "goal (9, 0) is outside the grid; rows are 0 to 8, columns 0 to 9",
        ),
        ("trace-gridworld", {"shape": (0, 3)}, "shape must be (rows, columns), at least 1 x 1, not (0, 3)"),
    ],
)
def test_error(name, parameters, message):
    with pytest.raises(InputError) as error:
        rl.make(name, **parameters)
    assert str(error.value) == f"{name}: {message}"


def test_values_that_are_traced_are_not_checked():
    """They have no value yet."""

    def mean(x) -> Outcome:
        arm = rl.KArmedTestbed(arms=2, means=jnp.stack([x, 2 * x])).outcomes(jnp.int32(0), jnp.int32(1))[1]
        loop = rl.InfiniteVariance(back=x).outcomes(jnp.int32(0), jnp.int32(0))[0]
        door = rl.TwoDoors(prizes=jnp.stack([x]), left=[1], right=jnp.stack([x]))
        return arm.reward[0], loop[0], door.outcomes(jnp.int32(0), jnp.int32(1))[0][0]

    assert [float(x) for x in jax.jit(mean)(0.25)] == [0.5, 0.25, 0.25]
