"""Sarsa(lambda) and Q(lambda): against their plain loops, against the forward view, and by hand.

Each was seen to fail on code broken in the ways that its docstring tells.
"""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from by_hand import learned as learned_by_hand
from test_reference import STEPS, env_and_task, random_mdp, words_of

import jaxrl_tab as rl
from jaxrl_tab.core.policies import Table
from jaxrl_tab.core.schedules import Optax, Power
from jaxrl_tab.core.types import Transition

pytestmark = pytest.mark.usefixtures("optimised")

TRACES = ("accumulating", "replacing", "dutch")
METHODS = [
    *((rl.SarsaLambda, {"trace": trace}) for trace in TRACES),
    (rl.SarsaLambda, {"offline": True}),
    *((rl.QLambda, {"trace": trace}) for trace in ("accumulating", "replacing")),
    *((rl.QLambda, {"version": version, "trace": "replacing"}) for version in ("peng", "naive")),
    (rl.SarsaLambda, {"trace": "clearing"}),
]
KINDS = {
    f"{fields.get('version', cls.__name__)}, {fields.get('trace', 'offline')}": (cls, fields)
    for cls, fields in METHODS
}
GAMMAS, LAMBDAS, ALPHAS = (0.0, 0.5, 0.9, 1.0), (0.75, 1.0, 0.5, 0.875), (0.5, 0.25, 0.25, 0.125)

# --- decision for decision ---------------------------------------------------------------------------
# In float64, and from a Q without ties: the product sums in another order than the plain loops, and a tie that the
# last bit breaks is a decision.


@pytest.mark.parametrize(
    ("kind", "env_name"),
    [
        *((kind, "random mdp") for kind in [*KINDS][::2]),
        *(pytest.param(kind, "random mdp", marks=pytest.mark.slow) for kind in [*KINDS][1::2]),
        pytest.param("SarsaLambda, dutch", "windy, stochastic, king", marks=pytest.mark.slow),
        pytest.param("QLambda, accumulating", "cliff", marks=pytest.mark.slow),
    ],
)
def test_every_step_agrees_with_the_plain_loop(kind, env_name):
    """Broken once: traces outlive an episode that a time limit ends; they fade by gamma; a bootstrap through

    terminal states, none at the time limit; A' drawn again, by another word or by the new Q; Watkins never
    cuts, cuts on a tie, cuts by the new Q, Peng's or the naive version, too; Peng's error for the pair itself; dutch
    traces that fade like accumulating ones; off-line learning that acts by the Q of the moment, or forgets episodes cut
    by the time limit; the traces of other actions kept where they are cleared -> each fails.
    """
    (cls, fields), (env, task) = KINDS[kind], env_and_task(env_name)
    shape = env.num_states, env.num_actions
    q0 = np.random.default_rng(0).random(shape, np.float32)

    def run(key, alpha, gamma, lam):
        method = cls(alpha=alpha, epsilon=0.25, gamma=gamma, q0=q0, lam=lam, **fields)
        return rl.train(key, method, env, num_steps=STEPS, log_every=STEPS)

    with jax.enable_x64():
        keys = jax.random.split(jax.random.key(7), len(GAMMAS))
        state, log = jax.jit(jax.vmap(run))(keys, *map(jnp.array, (ALPHAS, GAMMAS, LAMBDAS)))
        words = [words_of(key) for key in keys]
    for i, (alpha, gamma, lam) in enumerate(zip(ALPHAS, GAMMAS, LAMBDAS, strict=True)):
        rates = reference.Rates(lambda *_, alpha=alpha: alpha, lambda *_: 0.25)
        known = {"version": "watkins"} | fields if cls is rl.QLambda else fields
        agent = reference.Traces(shape, rates, gamma, q0, lam=lam, **known)
        finished = reference.run(agent, task, STEPS, words[i])
        assert len(finished) > 0
        assert log.episodes[i, 0] == len(finished)
        assert log.lengths[i, 0] == sum(n for _, n in finished)
        np.testing.assert_allclose(log.returns[i, 0], sum(g for g, _ in finished), rtol=1e-4)
        np.testing.assert_allclose(state.q[i], agent.q, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("trace", ["accumulating", "dutch"])
def test_the_step_size_is_that_of_the_current_pair(trace):
    """Broken once: alpha of (S', A'), for all traces or in the dutch correction alone; N(S, A) without this

    visit -> each fails.
    """
    env, task = env_and_task("random mdp")
    alpha = Optax(lambda count: 0.5 ** (2 + count % 3), clock="visit")
    method = rl.SarsaLambda(alpha=alpha, epsilon=Power(clock="visit"), gamma=0.5, lam=0.75, trace=trace)
    with jax.enable_x64():
        key = jax.random.key(3)
        run = jax.jit(lambda key: rl.train(key, method, env, num_steps=STEPS, log_every=STEPS))
        state, _ = run(key)
        words = words_of(key)
    rates = reference.Rates(lambda t, k, n: 0.5 ** (2 + (n - 1) % 3), lambda t, k, n: 1 / n)
    agent = reference.Traces((env.num_states, env.num_actions), rates, 0.5, lam=0.75, trace=trace)
    reference.run(agent, task, STEPS, words)
    np.testing.assert_allclose(state.q, agent.q, rtol=1e-10, atol=1e-10)


# --- the ends of the scale ---------------------------------------------------------------------------


SHARED = {"alpha": 0.5, "gamma": 0.5, "q0": 0.5}


def learned(method, env):
    state, log = jax.jit(lambda key: rl.train(key, method, env, num_steps=2000, log_every=100))(
        jax.random.key(5)
    )
    return state.q, log


@pytest.fixture(scope="module")
def sarsa():
    return learned(rl.Sarsa(**SHARED), random_mdp())


def test_with_lambda_0_sarsa_lambda_is_sarsa(sarsa):
    """Bitwise, in float32, in every row of the log, where the time limit is often met.

    Broken once: traces that fade by gamma instead of gamma lambda -> fails.
    """
    q, log = learned(rl.SarsaLambda(**SHARED, lam=0.0), random_mdp())
    want, wanted = sarsa
    np.testing.assert_array_equal(q, want)
    jax.tree.map(np.testing.assert_array_equal, log, wanted)


@pytest.mark.slow
def test_with_lambda_0_true_online_sarsa_lambda_is_sarsa():
    """In float64, where its correction of other pairs is taken back with the last bits only.

    Broken once: the correction for the step's own pair, too -> fails.
    """
    with jax.enable_x64():
        q, log = learned(rl.SarsaLambda(**SHARED, lam=0.0, trace="dutch"), random_mdp())
        want, wanted = learned(rl.Sarsa(**SHARED), random_mdp())
    np.testing.assert_allclose(q, want, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(log.lengths, wanted.lengths)


def test_with_lambda_0_q_lambda_makes_the_updates_of_q_learning():
    """Bitwise, where the behaviour does not depend on Q: A' is drawn before the one and after the other."""
    shared = SHARED | {"behaviour": Table(np.full((5, 3), 1 / 3))}
    q, log = learned(rl.QLambda(**shared, lam=0.0), random_mdp())
    want, wanted = learned(rl.QLearning(**shared), random_mdp())
    np.testing.assert_array_equal(q, want)
    jax.tree.map(np.testing.assert_array_equal, log, wanted)


# --- the backward view is the forward view -----------------------------------------------------------

STATES, ACTIONS, PLAYED, ALPHA = 4, 2, 80, 0.3
PAIRS = ((0.0, 0.5), (0.5, 0.9), (0.9, 0.8), (1.0, 0.5), (1.0, 1.0), (0.75, 0.0), (0.9, 1.0))  # gamma, lambda


def play(**fields):
    """What Sarsa(lambda) learns from random transitions in which it chooses the actions; in float64.

    Returns, for each of PAIRS, Q before each step and after the last, [PLAYED + 1, S, A], and the finished
    episodes: where each begins and ends, and its steps.
    """
    rand = np.random.default_rng(0)
    terminal, cut = rand.random((2, PLAYED)) < 0.08
    inputs = (
        rand.normal(size=PLAYED),
        rand.integers(0, STATES, PLAYED, np.int32),
        terminal,
        terminal | cut,
        rand.integers(0, STATES, PLAYED, np.int32),
        rand.integers(0, ACTIONS, PLAYED, np.int32),
    )

    def run(gamma, lam):
        method = rl.SarsaLambda(alpha=ALPHA, epsilon=0.5, gamma=gamma, lam=lam, **fields)

        def one(carry, x):
            state, s, a = carry
            key, r, s_next, terminal, last, s_start, a_start = x
            t = Transition(s, a, r, s_next, jnp.where(terminal, 0, gamma), last)
            new, a_next = method.update(key, state, t)
            carry = new, jnp.where(last, s_start, s_next), jnp.where(last, a_start, a_next)
            return carry, (state.q, t, a_next)

        keys = jax.random.split(jax.random.key(0), PLAYED)
        start = method.init(STATES, ACTIONS), jnp.int32(0), jnp.int32(0)
        (state, *_), (q, t, a_next) = jax.lax.scan(one, start, (keys, *map(jnp.asarray, inputs)))
        return jnp.append(q, state.q[None], axis=0), t, a_next

    with jax.enable_x64():
        out = jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(*map(jnp.array, zip(*PAIRS, strict=True))))
    ends = np.flatnonzero(terminal | cut) + 1
    bounds = list(zip([0, *ends], ends, strict=False))
    assert terminal.any()
    assert (cut & ~terminal).any()
    assert max(end - begin for begin, end in bounds) > 10
    for i, (gamma, lam) in enumerate(PAIRS):
        q, t, a_next = jax.tree.map(lambda x, i=i: x[i], out)
        steps = t.s, t.a, t.r, t.discount, t.s_next, a_next
        episodes = [(b, e, reference.Episode(*(x[b:e] for x in steps))) for b, e in bounds]
        yield gamma, lam, q, episodes


@pytest.fixture(scope="module")
def offline():
    return list(play(offline=True))


def test_offline_backward_view_is_the_offline_forward_view(offline):
    """Broken once: traces that fade by gamma, or outlive the time limit; errors by the Q of the moment; no

    bootstrap at the time limit -> each fails.
    """
    for _, lam, q, episodes in offline:
        for begin, end, episode in episodes:
            assert (q[begin:end] == q[begin]).all()
            want = reference.offline_forward(q[begin], episode, ALPHA, lam)
            np.testing.assert_allclose(q[end], want, rtol=0, atol=1e-10)


def test_offline_with_lambda_1_is_every_visit_monte_carlo(offline):
    """Broken once: episodes cut by the time limit forgotten; a bootstrap through terminal states -> fails."""
    checked = 0
    for _, _, q, episodes in (run for run in offline if run[1] == 1):
        for begin, end, episode in episodes:
            want = reference.every_visit_monte_carlo(q[begin], episode, ALPHA)
            np.testing.assert_allclose(q[end], want, rtol=0, atol=1e-10)
            checked += 1
    assert checked


def test_the_sum_of_increments_is_not_the_offline_lambda_return_algorithm_of_the_book():
    """A state that comes n times, gamma = 1, and at the end 1, from V = 0, with alpha = 1.

    Every lambda-return of the episode is 1 for lambda = 1. The book's updates (equation 12.4), one after another,
    stop at the target: V = 1. Their sum, by the V of the start, is n.
    """
    n = 7
    episode = [[(0, 0.0, 0)] * (n - 1) + [(0, 1.0, 1)]]
    for method in (
        rl.SarsaLambda(alpha=1.0, lam=1.0, offline=True),
        rl.SarsaLambdaForward(alpha=1.0, lam=1.0),
    ):
        assert learned_by_hand(method, 2, episode, 1.0)[0] == n


def test_true_online_is_the_online_forward_view_at_every_step():
    """Broken once: all of the trace of a pair that comes again kept; no correction by Q_old, or one of the

    step's own pair, too; traces marked before they fade -> each fails.
    """
    for _, lam, q, episodes in play(trace="dutch"):
        for begin, end, episode in episodes:
            want = reference.online_forward(q[begin], episode, ALPHA, lam)
            np.testing.assert_allclose(q[begin + 1 : end + 1], want, rtol=0, atol=1e-10)


# --- by hand -----------------------------------------------------------------------------------------

UNIFORM = Table(np.full((3, 4), 0.25))


def transition(s, a, r, s_next, discount=0.5, last=False):
    return Transition(*map(jnp.asarray, (s, a, r * 1.0, s_next, float(discount), last)))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("kind", KINDS)
def test_traces_end_with_the_episode(kind):
    """By a terminal state (discount 0) and by the time limit.

    Broken once: traces that fade by gamma lambda at the end as well; by gamma' lambda, which ends them at
    terminal states alone -> each fails.
    """
    cls, fields = KINDS[kind]
    method = cls(alpha=0.5, gamma=0.5, lam=1.0, behaviour=UNIFORM, **fields)

    @jax.jit
    @jax.vmap
    def two_steps(discount):
        key, end = jax.random.key(0), transition(0, 0, 1, 1, last=True)._replace(discount=discount)
        state, _ = method.update(key, method.init(3, 4), end)
        return state.q, method.update(key, state, transition(1, 1, 1, 2, 0, last=True))[0].q

    first, second = map(np.array, two_steps(jnp.array([0.0, 0.5])))
    assert (first[:, 0, 0] == 0.5).all()
    first[:, 1, 1] = 0.5
    np.testing.assert_array_equal(second, first)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("kind", KINDS)
def test_the_action_that_is_learned_from_is_the_one_that_is_taken(kind):
    """In Q(lambda), the one by which traces are cut. Broken once: A' drawn again by another word -> fails."""
    cls, fields = KINDS[kind]
    q = jnp.zeros((3, 4)).at[1].set(jnp.array([1.0, 2.0, 4.0, 8.0]))
    method = cls(alpha=0.5, gamma=0.5, lam=1.0, q0=q, behaviour=UNIFORM, **fields)

    def update(key):
        state, a_next = method.update(key, method.init(3, 4), transition(0, 0, 0, 1, last=False))
        return state.values.q[0, 0], state.values.z[0, 0], a_next

    value, z, a_next = jax.jit(jax.vmap(update))(jax.random.split(jax.random.key(0), 64))
    assert set(np.asarray(a_next)) == {0, 1, 2, 3}
    if cls is rl.QLambda:
        np.testing.assert_array_equal(value, np.full(64, 0.5 * 0.5 * 8))
        goes_on = (a_next == 3) | (fields.get("version", "watkins") != "watkins")
        np.testing.assert_array_equal(z, np.where(goes_on, 0.5, 0))
    else:
        np.testing.assert_array_equal(value, 0.5 * 0.5 * q[1][a_next])
        np.testing.assert_array_equal(z, np.full(64, 0.5))


@pytest.mark.parametrize("trace", ["accumulating", "replacing"])
def test_watkins_cuts_where_the_next_action_is_not_greedy_and_only_there(trace):
    """Two steps; the second action is one of the two greedy ones, or another.

    Broken once: never cut; cut unless A' is the first greedy action; the error of Sarsa -> each fails.
    """
    best = jnp.array([2.0, 2.0, 1.0, 0.0])

    @jax.jit
    @jax.vmap
    def q_of_the_first_pair(second):
        policy = Table(jnp.full((3, 4), 0.25).at[1].set(jax.nn.one_hot(second, 4)))
        q0 = jnp.zeros((3, 4)).at[1].set(best)
        method = rl.QLambda(alpha=0.5, gamma=0.5, lam=0.5, q0=q0, behaviour=policy, trace=trace)
        key = jax.random.key(0)
        state, a_next = method.update(key, method.init(3, 4), transition(0, 0, 0, 1))
        before = state.q[0, 0]
        state, _ = method.update(key, state, transition(1, a_next, 4, 2))
        return before, state.q[0, 0], state.q[1, second]

    before, after, second = q_of_the_first_pair(jnp.arange(4))
    np.testing.assert_array_equal(before, np.full(4, 0.5))  # 0.5 (0 + 0.5 * 2 - 0)
    np.testing.assert_array_equal(second, best + 0.5 * (4 - best))
    # The error of the second step, 4 - 2 = 2, with alpha 0.5 and the trace 0.5 * 0.5; both ties go on.
    np.testing.assert_array_equal(after, [0.75, 0.75, 0.5, 0.5])


@pytest.mark.slow
@pytest.mark.parametrize("cls", [rl.SarsaLambda, rl.QLambda])
def test_actions_that_are_tied_at_a_bump_are_equally_likely(cls):
    """A' is drawn before the update, so A, tried for the first time, is still tied with those that were not.

    Broken once: the pair marked before A' is drawn, which moves the last bit of its value -> fails.
    """
    method = cls(alpha=0.1, epsilon=0.0, gamma=1.0)

    @jax.vmap
    def a_next(key, reward):
        first, second, third = jax.random.split(key, 3)
        state, _ = method.update(first, method.init(3, 4), transition(0, 0, reward, 1, 1))
        state, _ = method.update(second, state, transition(1, 0, reward, 2, 1))
        return method.update(third, state, transition(2, 3, -1, 2, 1))[1]

    rewards = np.repeat(-np.random.default_rng(0).random(16), 100)
    drawn = jax.jit(a_next)(jax.random.split(jax.random.key(0), len(rewards)), rewards).reshape(16, 100)
    counts = np.stack([(np.asarray(drawn) == a).sum(1) for a in range(4)], 1)
    assert (abs(counts - 25) < 5 * np.sqrt(100 * 0.25 * 0.75)).all()


# --- wrong input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cls", "fields", "message"),
    [
        (rl.SarsaLambda, {"lam": 1.1}, "SarsaLambda: lam must be between 0 and 1, not 1.1"),
        (rl.QLambda, {"lam": -0.5}, "QLambda: lam must be between 0 and 1, not -0.5"),
        (rl.QLambda, {"lam": float("nan")}, "QLambda: lam must be between 0 and 1, not nan"),
        (rl.SarsaLambda, {"trace": "duch"}, "SarsaLambda: trace 'duch' is unknown; did you mean 'dutch'?"),
        (
            rl.QLambda,
            {"trace": "dutch"},
            "QLambda: trace 'dutch' is unknown; choose one of accumulating, replacing",
        ),
        (
            rl.SarsaLambda,
            {"trace": "dutch", "offline": True},
            "offline goes with accumulating traces only, not dutch",
        ),
        (rl.SarsaLambda, {"offline": 1}, "offline must be true or false, not 1"),
    ],
)
def test_wrong_input_is_refused_in_one_line(cls, fields, message):
    with pytest.raises(rl.InputError, match=re.escape(message)) as error:
        cls(**fields)
    assert "\n" not in str(error.value)
