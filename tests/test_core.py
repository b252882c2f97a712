"""The small parts by numbers worked by hand: tables, words, policies, schedules, updates."""

import dataclasses

import jax
import jax.extend as jex
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy import stats

import jaxrl_tab as rl
from jaxrl_tab import policies, schedules
from jaxrl_tab.core import rng, tables
from jaxrl_tab.core.errors import nearest
from jaxrl_tab.core.types import Transition
from jaxrl_tab.envs import ENVS
from jaxrl_tab.methods import METHODS

# --- tables ------------------------------------------------------------------------------------------


def test_add_is_plain_indexing_for_one_lane_many_lanes_and_lanes_of_lanes():
    rand = np.random.default_rng(0)
    q = rand.integers(0, 9, (3, 4, 5, 2)).astype(np.float32)
    s, a = rand.integers(0, 5, (3, 4)), rand.integers(0, 2, (3, 4))
    x = rand.integers(1, 9, (3, 4)).astype(np.float32)
    want = q.copy()
    for i, j in np.ndindex(3, 4):
        want[i, j, s[i, j], a[i, j]] += x[i, j]
        one = map(jnp.asarray, (q[i, j], s[i, j], a[i, j], x[i, j]))
        np.testing.assert_array_equal(tables.add(*one), want[i, j])
    np.testing.assert_array_equal(jax.jit(jax.vmap(tables.add))(q[0], s[0], a[0], x[0]), want[0])
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(tables.add)))(q, s, a, x), want)


def test_add_where_only_some_arguments_have_lanes():
    q = jnp.zeros((3, 2))
    got = jax.vmap(tables.add, in_axes=(None, 0, None, None))(q, jnp.arange(3), jnp.int32(1), jnp.float32(2))
    np.testing.assert_array_equal(got, [q.at[i, 1].set(2) for i in range(3)])


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", ["sarsa", "n-step-sarsa", "monte-carlo"])
def test_lanes_in_turn_and_side_by_side_give_the_same(name, windy, monkeypatch):
    """On a CPU tables are read and written in loops over the lanes, elsewhere by gathers and scatters."""
    method = rl.ALGORITHMS[name](alpha=0.5)  # no rounding: the order of operations may differ

    def q(log_every):  # which is another program, with the same result
        run = lambda key: rl.train(key, method, windy, num_steps=300, log_every=log_every)[0].q
        return jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(4), 6))

    in_turn = q(300)
    monkeypatch.setattr(tables, "lanes_in_turn", lambda: False)
    np.testing.assert_array_equal(q(150), in_turn)
    assert len(np.unique(in_turn, axis=0)) > 1


def test_entries_and_rows_are_plain_indexing_with_any_lanes():
    rand = np.random.default_rng(1)
    table, s, a = (
        jnp.asarray(rand.normal(size=(4, 5, 3))),
        rand.integers(0, 5, (4, 16)),
        rand.integers(0, 3, (4, 16)),
    )
    row, entry = (lambda t, s, a: tables.row(t, s)), tables.entry
    for read, want in ((row, lambda t: t[s]), (entry, lambda t: t[s, a])):
        got = jax.vmap(jax.vmap(read, (None, 0, 0)), (None, 0, 0))(table[0], s, a)  # one table for all lanes
        np.testing.assert_array_equal(got, want(np.asarray(table[0])))
    got = jax.vmap(jax.vmap(entry, (None, 0, 0)))(table, s, a)  # a table for some lanes
    np.testing.assert_array_equal(got, np.asarray(table)[np.arange(4)[:, None], s, a])
    got = jax.vmap(row, (0, None, None))(table, jnp.int32(2), jnp.int32(0))  # all look at the same entry
    np.testing.assert_array_equal(got, np.asarray(table)[:, 2])


def _with_sum(table, x, y):
    return table * x + y


@pytest.mark.parametrize("in_turn", [True, False])
def test_a_table_is_changed_where_the_condition_holds_with_any_lanes(in_turn, monkeypatch):
    """Broken once: changed where it does not hold, or in the first lane -> each fails."""
    monkeypatch.setattr(tables, "lanes_in_turn", lambda: in_turn)
    rand = np.random.default_rng(0)
    table, y = rand.normal(size=(2, 3, 4, 5, 2)).astype(np.float32)
    x, is_due = rand.normal(size=(3, 4)).astype(np.float32), rand.random((3, 4)) < 0.5
    change = lambda is_due, *args: tables.changed_where(is_due, _with_sum, *args)
    got = jax.jit(jax.vmap(jax.vmap(change)))(is_due, table, x, y)
    for i, j in np.ndindex(3, 4):
        want = table[i, j] * x[i, j] + y[i, j] if is_due[i, j] else table[i, j]
        np.testing.assert_allclose(got[i, j], want, rtol=1e-5, atol=1e-6)
        one = change(*map(jnp.asarray, (is_due[i, j], table[i, j], x[i, j], y[i, j])))
        np.testing.assert_allclose(one, want, rtol=1e-5, atol=1e-6)


# --- random words ------------------------------------------------------------------------------------


def test_the_word_of_a_step_depends_on_the_step_alone():
    """Drawn one by one, or together; and all differ, those of one call, too.

    Broken once: the second word of a call for both of its decisions -> fails.
    """
    stream = rng.stream(jax.random.key(5))
    words = jnp.stack([rng.word(stream, jnp.arange(100), decision) for decision in range(4)])
    np.testing.assert_array_equal(rng.word(stream, jnp.int32(40), 2), words[2, 40])
    assert len(np.unique(words)) == 400


def test_threefry_is_the_one_behind_jax_random():
    key, counts = jax.random.bits(jax.random.key(1), (2,)), jax.random.bits(jax.random.key(2), (2, 50))
    want = jex.random.threefry_2x32(tuple(key), counts)
    np.testing.assert_array_equal(jnp.stack(rng.threefry(tuple(key), *counts)), want)


def test_words_are_uniform_and_independent_across_runs_steps_and_decisions():
    """Chi-squared on the top 4 bits of neighbouring words, in each of three directions."""
    streams = jax.vmap(lambda i: rng.stream(jax.random.fold_in(jax.random.key(0), i)))(jnp.arange(200))
    draw = jax.vmap(lambda stream: jnp.stack([rng.word(stream, jnp.arange(500), d) for d in range(2)]))
    top = np.asarray(draw(streams)) >> 28  # [runs, decisions, steps]
    for x, y in ((top[1:], top[:-1]), (top[:, 1], top[:, 0]), (top[..., 1:], top[..., :-1])):
        counts = np.bincount((16 * x + y).ravel(), minlength=256)
        assert stats.chisquare(counts).pvalue > 1e-3


def test_a_word_is_a_key_like_any_other():
    words = jnp.array([0, 0x9E3779B9, 0x12345678], jnp.uint32)
    keys = rng.as_key(words)
    np.testing.assert_array_equal(jax.vmap(jax.random.bits)(keys), words)  # one draw is the word itself
    parts = jax.random.split(keys[1], 4)
    draws = jax.vmap(lambda key: jax.random.normal(key, (1000,)))(
        jnp.concatenate([parts, keys[1:2], jax.random.fold_in(keys[1], 7)[None]])
    )
    assert len(np.unique(draws)) > 5900
    correlations = np.corrcoef(draws)[np.triu_indices(6, 1)]
    assert abs(correlations).max() < 4 / np.sqrt(1000)
    assert stats.kstest(draws.ravel(), "norm").pvalue > 1e-3
    small = jax.random.bits(keys[2], (1000,), jnp.uint8)
    assert small.dtype == jnp.uint8 and stats.chisquare(np.bincount(small % 16)).pvalue > 1e-3


# --- policies ----------------------------------------------------------------------------------------


def test_policies_split_ties():
    """Broken once: the first maximal action instead of all -> fails. Behaviour, target and `planning` have
    their tie rule from here.
    """
    q = jnp.array([1.0, 3.0, 3.0, -jnp.inf])
    np.testing.assert_array_equal(policies.greedy(q), [0, 0.5, 0.5, 0])
    np.testing.assert_allclose(policies.epsilon_greedy(q, 0.2), [0.05, 0.45, 0.45, 0.05], rtol=1e-6)
    np.testing.assert_array_equal(policies.epsilon_greedy(jnp.zeros(4), 0.0), [0.25] * 4)


def test_sample_draws_with_the_exact_probabilities():
    weights = jnp.array([0.0, 1.0, 2.0, 0.0, 5.0, 0.0])
    keys = jax.random.split(jax.random.key(1), 20_000)
    counts = np.bincount(jax.vmap(lambda key: policies.sample(key, weights))(keys), minlength=6)
    assert counts[weights == 0].sum() == 0
    assert stats.chisquare(counts[[1, 2, 4]], np.array([1, 2, 5]) / 8 * 20_000).pvalue > 1e-3


@pytest.mark.parametrize("n", [3, 7, 11])
def test_sample_never_draws_what_is_impossible(n):
    """The extreme words, with weights whose sum is rounded: the first and the last index have none."""
    weights = jnp.concatenate([jnp.zeros(1), policies.greedy(jnp.ones(n)), jnp.zeros(1)])
    words = jnp.array([0, 1, 2**32 - 257, 2**32 - 1], dtype=jnp.uint32)
    got = jax.vmap(lambda key: policies.sample(key, weights))(rng.as_key(words))
    np.testing.assert_array_equal(got, [1, 1, n, n])


# --- schedules ---------------------------------------------------------------------------------------


def test_schedules_by_hand():
    harmonic, root = schedules.glie(), schedules.Power(power=0.5, scale=2.0, clock="step")
    assert [float(harmonic(jnp.int32(n))) for n in (1, 2, 4)] == [1, 0.5, 0.25]
    assert float(root(jnp.int32(16))) == 0.5
    assert schedules.sample_average().clock == "visit"
    linear = schedules.Optax(optax.linear_schedule(1.0, 0.0, 10), clock="episode")
    np.testing.assert_allclose([linear(jnp.int32(n)) for n in (1, 6, 11, 99)], [1, 0.5, 0, 0])


def test_exploration_is_a_probability_whatever_the_schedule_says():
    """10/k begins above 1: everything is explored then, and nothing has a negative probability."""
    method = rl.Sarsa(epsilon=schedules.Power(scale=10.0))
    state = method.init(1, 4)._replace(q=jnp.array([[0.0, 1.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(method.probs(state, jnp.int32(0)), [0.25] * 4)


def test_sample_averages_are_means():
    """alpha = 1/N(s, a) makes each entry the mean of its targets: here gamma = 0, so of its rewards."""
    method = rl.Sarsa(alpha=schedules.sample_average(), epsilon=1.0, gamma=0.0)
    state = method.init(2, 2)
    rewards = [3.0, 5.0, 10.0]
    for r in rewards:
        t = Transition(*map(jnp.asarray, (1, 0, r, 0, 0.0, False)))
        state, _ = method.update(jax.random.key(0), state, t)
    np.testing.assert_allclose(state.q, [[0, 0], [np.mean(rewards), 0]], rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: schedules.Power(clock="day"),
            "Power: clock 'day' is unknown; choose one of step, episode, visit",
        ),
        (lambda: schedules.Power(power=-1), "Power: power must be greater than 0, not -1"),
        (lambda: schedules.Optax(0.5), "Optax: schedule must be a function of a count, not 0.5"),
    ],
)
def test_bad_schedules_are_refused(make, message):
    with pytest.raises(rl.InputError, match=message):
        make()


# --- one update by hand ------------------------------------------------------------------------------

Q = jnp.array([[0.0, 8.0], [2.0, 4.0], [100.0, 100.0]])


@pytest.mark.parametrize(
    ("method", "wants"),
    [  # Q(0, 1) = 8, R = 1, gamma = 1/2, alpha = 1/2; S' = 1 with Q = 2, 4; epsilon = 1/2: pi = 1/4, 3/4
        (rl.Sarsa, {0: 8 + (1 + 2 / 2 - 8) / 2, 1: 8 + (1 + 4 / 2 - 8) / 2}),
        (rl.QLearning, {0: 8 + (1 + 4 / 2 - 8) / 2, 1: 8 + (1 + 4 / 2 - 8) / 2}),
        (rl.ExpectedSarsa, {0: 8 + (1 + 3.5 / 2 - 8) / 2, 1: 8 + (1 + 3.5 / 2 - 8) / 2}),
    ],
)
def test_one_update_by_hand(method, wants):
    """Each method's target; a terminal S' adds nothing, whatever its entries say; only one entry moves."""
    algorithm = method(alpha=0.5, epsilon=0.5, gamma=0.5)
    state = algorithm.init(3, 2)._replace(q=Q)
    for a_next, word in ((0, 0), (1, 2**31)):  # a word below 1/4 of the range draws action 0
        key = rng.as_key(jnp.uint32(word))
        t = Transition(*map(jnp.asarray, (0, 1, 1.0, 1, 0.5, False)))
        new, a = algorithm.update(key, state, t)
        assert a == a_next
        np.testing.assert_array_equal(new.q, Q.at[0, 1].set(wants[a_next]))
        ends = t._replace(s_next=jnp.asarray(2), discount=jnp.asarray(0.0), last=jnp.asarray(True))
        new, _ = algorithm.update(key, state, ends)
        np.testing.assert_array_equal(new.q, Q.at[0, 1].set(8 + (1 - 8) / 2))
        assert (new.clock.step, new.clock.episode) == (1, 1)


# --- what is refused ---------------------------------------------------------------------------------

LARGE = np.full((70, 4), 0.25)
LONG = np.full(100, 0.123456789)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: rl.Sarsa(behaviour=LARGE),  # pyright: ignore[reportArgumentType]
            "Sarsa: behaviour must be a policy such as policies.Softmax(0.5), not an array of shape (70, 4); "
            "for probabilities [S, A] it is policies.Table(...)",
        ),
        (
            lambda: rl.TargetQLearning(target=[[0.25, 0.75]]),  # pyright: ignore[reportArgumentType]
            "TargetQLearning: target must be a policy such as policies.Softmax(0.5), not [[0.25, 0.75]]; "
            "for probabilities [S, A] it is policies.Table(...)",
        ),
        (
            lambda: policies.Table(LONG[None]),
            "Table: the probabilities in state 0 are not a distribution: "
            "[0.12345679 0.12345679 0.12345679 ... 0.12345679 0.12345679 0.12345679]",
        ),
        (
            lambda: rl.ManyTargets(LONG[None, None]),
            "ManyTargets: the probabilities of policy 0 in state 0 are not a distribution: "
            "[0.12345679 0.12345679 0.12345679 ... 0.12345679 0.12345679 0.12345679]",
        ),
        (
            lambda: rl.ManyTargets(LARGE[None], behaviour=LARGE),  # pyright: ignore[reportArgumentType]
            "ManyTargets: behaviour must be policies.Table(b), for there is no one Q to choose by, not an "
            "array of shape (70, 4)",
        ),
        (
            lambda: rl.Sarsa(gamma=LONG + 1),
            "Sarsa: gamma must be between 0 and 1, not "
            "[1.12345679 1.12345679 1.12345679 ... 1.12345679 1.12345679 1.12345679]",
        ),
        (
            lambda: rl.Sarsa(alpha=-LARGE),
            "Sarsa: alpha must be greater than 0, not an array of shape (70, 4)",
        ),
        (
            lambda: rl.NStepSarsa(n=jnp.ones((2, 2))),
            "NStepSarsa: n must be a whole number of at least 1, not an array of shape (2, 2)",
        ),
        (lambda: rl.NStepSarsa(n=True), "NStepSarsa: n must be a whole number of at least 1, not True"),
    ],
)
def test_messages_are_one_short_line_whatever_was_given(make, message):
    """Broken once: the arrays as they print themselves -> fails."""
    with pytest.raises(rl.InputError) as error:
        make()
    assert str(error.value) == message


SWITCHES = [
    (cls, field.name)
    for cls in (*ENVS.values(), *METHODS.values())
    for field in dataclasses.fields(cls)
    if field.metadata.get("static") and isinstance(field.default, bool)
]


@pytest.mark.parametrize(("cls", "name"), SWITCHES)
def test_switches_are_true_or_false(cls, name):
    """Of every environment and method that has one; a string would be as good as True."""
    for wrong in ("yes", 3, None):
        with pytest.raises(rl.InputError, match=rf"{name} must be true or false, not {wrong!r}$"):
            cls(**{name: wrong})
    for right in (np.True_, np.False_):
        given = getattr(cls(**{name: right}), name)
        assert type(given) is bool and given == right


def test_there_are_switches():
    names = {"first_visit", "exploring_starts", "offline", "stochastic"}
    assert names <= {name for _, name in SWITCHES} and len(SWITCHES) >= 8


def test_nearest_name():
    assert nearest("q_lerning", rl.ALGORITHMS) == "did you mean 'q-learning'?"
    assert nearest("xyz", ["a", "b"]) == "choose one of a, b"
