"""n-step Sarsa: against its plain loop, against Sarsa and Monte Carlo, and by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from by_hand import learned
from test_one_step import ALPHAS, EPSILON, GAMMAS, initial_tables
from test_reference import STEPS, env_and_task, task_of, words_of

import jaxrl_tab as rl
from jaxrl_tab import schedules

LONG = 200  # more steps than any of these episodes has


@pytest.mark.parametrize(
    ("n", "env_name"),
    [(1, "random mdp"), (3, "random mdp"), (3, "windy, stochastic, king"), (LONG, "cliff")],
)
def test_every_step_agrees_with_the_plain_loop(n, env_name):
    """n = 1 is held against the plain loop of Sarsa.

    Broken once: the tail dropped; backwards; by the Q before it; the memory not cleared; a time limit treated
    as terminal -> fails.
    """
    env, task = env_and_task(env_name)
    shape = env.num_states, env.num_actions
    keys, q0 = jax.random.split(jax.random.key(5), 4), initial_tables(env)

    def run(key, alpha, gamma, q0):
        method = rl.NStepSarsa(alpha=alpha, epsilon=EPSILON, gamma=gamma, q0=q0, n=n)
        return rl.train(key, method, env, num_steps=STEPS, log_every=STEPS)

    state, log = jax.jit(jax.vmap(run))(keys, jnp.array(ALPHAS), jnp.array(GAMMAS), q0)
    for i, (key, alpha, gamma) in enumerate(zip(keys, ALPHAS, GAMMAS, strict=True)):
        rates, words = (
            reference.Rates(lambda *_, alpha=alpha: alpha, lambda *_: EPSILON),
            words_of(key),
        )
        if n == 1:
            q, _, finished = reference.td_control(
                "sarsa", task, env.num_actions, rates, gamma, STEPS, words, q0[i]
            )
        else:
            agent = reference.NStepSarsa(shape, rates, gamma, q0[i], n=n)
            finished, q = reference.run(agent, task, STEPS, words), agent.q
        tolerance = 1e-4 if gamma == 0.9 else 0
        np.testing.assert_allclose(state.q[i], q, atol=tolerance, rtol=tolerance)
        assert log.episodes[i, 0] == len(finished)
        assert log.lengths[i, 0] == sum(length for _, length in finished)
        assert finished


@pytest.mark.parametrize(
    ("alpha", "plain"),
    [(0.25, lambda t, k, visits: 0.25), (schedules.sample_average(), lambda t, k, visits: 1 / visits)],
    ids=["constant", "1/N"],
)
def test_looking_further_than_the_episode_is_monte_carlo(alpha, plain):
    """Also where every step has its own step size: with 1/N(s, a), Q is the mean of the returns.

    Broken once: the step size taken when the return is complete, with later visits counted in -> fails.
    """
    env, key = rl.RandomWalk(states=5), jax.random.key(1)
    method = rl.NStepSarsa(alpha=alpha, n=LONG, gamma=0.5)
    state, log = jax.jit(lambda key: rl.train(key, method, env, num_steps=STEPS, log_every=STEPS))(key)
    rates = reference.Rates(plain, lambda *_: 0.0)
    agent = reference.MonteCarlo((env.num_states, 1), rates, 0.5)
    finished = reference.run(agent, task_of(env), STEPS, words_of(key))
    np.testing.assert_allclose(state.q, agent.q, atol=1e-6)
    assert log.episodes[0] == len(finished) > 20


# --- by hand: three states and a terminal one, one action, gamma 1/2, alpha 1/2, Q0 = 1 -----------------


def after(n, *episodes, cut=False):
    """Q after episodes of (S, R, S') each; see `by_hand.learned`."""
    return learned(rl.NStepSarsa(alpha=0.5, gamma=0.5, q0=1.0, n=n), 4, episodes, 0.5, cut)


WALK = ((0, 1.0, 1), (1, 2.0, 2), (2, 4.0, 3))


@pytest.mark.parametrize("n", [3, 5])
def test_the_tail_is_complete_and_ends_at_the_terminal_state(n):
    """G = 1 + 2/2 + 4/4 = 3, 2 + 4/2 = 4, and 4. The value of the terminal state, 1, counts nowhere.

    Broken once: only the oldest step learned at the end; weight not 0 where S' is terminal -> fails.
    """
    np.testing.assert_array_equal(after(n, WALK), [2.0, 2.5, 2.5, 1.0])


def test_two_steps_ahead():
    """G = 1 + 2/2 + 1/4 = 2.25 (Q(2) is still 1), then 2 + 4/2 = 4, and 4."""
    np.testing.assert_array_equal(after(2, WALK), [1.625, 2.5, 2.5, 1.0])


def test_a_time_limit_bootstraps_from_the_state_it_was_reached_in():
    """G = 3 + 1/8, 4 + 1/4, 4 + 1/2, each with the value 1 of state 3.

    Broken once: treated as terminal -> fails.
    """
    np.testing.assert_array_equal(after(3, WALK, cut=True), [2.0625, 2.625, 2.75, 1.0])


def test_the_tail_learns_from_the_oldest_step_on_and_by_q_as_it_is():
    """0 -> 1 -> 0 and time is up. First G = 1 + 2/2 + 1/4 = 2.25, so Q(0) = 1.625; then 2 + 1.625/2 = 2.8125.

    Broken once: backwards; or by the Q of before the tail -> fails.
    """
    q = after(3, ((0, 1.0, 1), (1, 2.0, 0)), cut=True)
    np.testing.assert_array_equal(q, [1.625, 1.90625, 1.0, 1.0])


def test_nothing_is_remembered_of_the_episode_before():
    """Twice the same episode: the second learns from its own rewards alone, from Q as the first left it.

    Broken once: the memory not cleared -> fails.
    """
    q = after(5, WALK, WALK)
    np.testing.assert_array_equal(q, [(2.0 + 3.0) / 2, (2.5 + 4.0) / 2, (2.5 + 4.0) / 2, 1.0])


# --- the 19-state walk -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("n", "alpha", "error"), [(2, 0.6, 0.27683), (8, 0.25, 0.27650)])
def test_root_mean_square_error_on_the_walk(n, alpha, error):
    """Mean over the first 10 episodes and the 19 states (book, figure 7.2), by long simulation elsewhere."""
    truth = np.arange(-9, 10) / 10
    rms = lambda state: {"rms": jnp.sqrt(((state.q[1:-1, 0] - truth) ** 2).mean())}
    method = rl.NStepSarsa(alpha=alpha, n=n)

    @jax.jit
    @jax.vmap
    def run(key):
        log = rl.train(key, method, rl.RandomWalk(), num_episodes=10, log_every=1, record=rms)[1]
        return log.recorded["rms"].mean()

    got = np.asarray(run(jax.random.split(jax.random.key(0), 1000)))
    assert abs(got.mean() - error) < 4 * got.std() / np.sqrt(len(got)) + 0.5e-4


@pytest.mark.parametrize("n", [0, -1, 2.5, "4", None])
def test_n_must_be_a_whole_number(n):
    with pytest.raises(rl.InputError, match=r"NStepSarsa: n must be a whole number of at least 1, not "):
        rl.NStepSarsa(n=n)
