"""Monte Carlo control and the forward view of Sarsa(lambda): against plain loops, and by hand.

Each was seen to fail on code broken in the ways that its docstring tells.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from by_hand import learned
from test_reference import ENVS, STEPS, random_mdp, task_of, words_of

import jaxrl_tab as rl
from jaxrl_tab import planning, schedules
from jaxrl_tab.core.schedules import Optax, Power

GAMMAS = (0.0, 0.5, 0.9, 1.0)
EPSILON = 0.25

# --- decision for decision, in float64 ---------------------------------------------------------------


def with_rewards_apart(env):
    """The same task, with a small number of its own added to the reward of each (s, a, s').

    A mean of returns may be rounded otherwise than in a plain loop. So no two actions may have the same mean
    from different returns, for rounding would then decide between them.
    """
    model = planning.exact_model(env)
    size, actions, outcomes = model.prob.shape
    p, r = np.zeros((2, size, actions, size))
    for s, a, k in np.ndindex(size, actions, outcomes):
        p[s, a, model.s_next[s, a, k]] += model.prob[s, a, k]
        r[s, a, model.s_next[s, a, k]] = model.reward[s, a, k]
    r += np.random.default_rng(5).integers(-9999, 9999, r.shape) / 2**17  # which float32 can say
    return rl.FiniteMDP(p, r, planning.terminal_states(model), model.start, env.max_steps)


@cache
def task_apart(env_name):
    """The environment so changed, and its plain tables."""
    with jax.enable_x64():
        env = with_rewards_apart(ENVS[env_name]())
        return env, task_of(env)


def played(env, method, *fields):
    """What `method(gamma, *fields)` learned for each of GAMMAS, and the words that it met; in float64."""
    with jax.enable_x64():
        keys = jax.random.split(jax.random.key(7), len(GAMMAS))
        run = lambda key, *given: rl.train(key, method(*given), env, num_steps=STEPS, log_every=STEPS)
        state, log = jax.jit(jax.vmap(run))(keys, *map(jnp.array, (GAMMAS, *fields)))
        return jax.tree.map(np.asarray, (state, log)), [words_of(key) for key in keys]


def check(agent, task, words, state, log, i, tolerance=1e-10):
    """Lets `agent` play, and compares it with lane i."""
    finished = reference.run(agent, task, STEPS, words[i])
    assert log.episodes[i, 0] == len(finished) > 0
    assert log.lengths[i, 0] == sum(n for _, n in finished)
    np.testing.assert_allclose(state.q[i], agent.q, rtol=tolerance, atol=tolerance)


N = lambda t, k, n: 1 / n
FIXED = lambda value: lambda t, k, n: value
ALPHAS = {
    "1/N": (schedules.sample_average(), N),
    "constant": (0.25, FIXED(0.25)),
    **{
        clock: (
            Optax(lambda count: 0.5 ** (1 + count % 3), clock=clock),
            lambda *now, at=at: 0.5 ** (1 + (now[at] - 1) % 3),
        )
        for at, clock in enumerate(schedules.CLOCKS)
    },
}
EPSILONS = {
    "constant": (EPSILON, FIXED(EPSILON)),
    "glie": (schedules.glie(), lambda t, k, n: 1 / k),
    "step": (Power(0.5, clock="step"), lambda t, k, n: t**-0.5),
    "visit": (Power(clock="visit"), lambda t, k, n: 1 / n),
}
# alpha, epsilon, and the fields that the plain loop has, too.
KINDS = {
    "every visit": ("1/N", "constant", {}),
    "first visit": ("1/N", "glie", {"first_visit": True}),
    "constant alpha, batch": ("constant", "step", {"batch": 4}),
    "exploring starts": ("episode", "constant", {"exploring_starts": True, "first_visit": True}),
    "by step": ("step", "visit", {"first_visit": True, "batch": 2}),
    "by visit": ("visit", "visit", {"exploring_starts": True, "batch": 3}),
}


@pytest.mark.parametrize(
    ("kind", "env_name"),
    [
        *((kind, "random mdp") for kind in KINDS),
        pytest.param("first visit", "windy, stochastic, king", marks=pytest.mark.slow),
    ],
)
def test_every_step_agrees_with_the_plain_loop(kind, env_name):
    """Broken once -> each fails: what follows a time limit discounted twice, or 0; all visits for first ones;

    the first visit of the run for that of the episode; the memory not cleared; from the first step to the
    last; 1/N without this visit; a batch not waited for, or ending an episode early; acting by the latest Q
    in a batch; exploring starts with actions of the policy, or in terminal states too.
    """
    (env, task), (alpha, epsilon, fields) = task_apart(env_name), KINDS[kind]
    (alpha, plain_alpha), (epsilon, plain_epsilon) = ALPHAS[alpha], EPSILONS[epsilon]
    method = lambda gamma: rl.MonteCarlo(alpha=alpha, epsilon=epsilon, gamma=gamma, q0=0.5, **fields)
    (state, log), words = played(env, method)
    if "exploring_starts" in fields:  # anywhere but in terminal states, which lead to themselves
        over = [row[0][0][1:] == (s, 0, True) for s, row in enumerate(task.outcomes)]
        task = task._replace(initial=1 - np.array(over))
    for i, gamma in enumerate(GAMMAS):
        rates = reference.Rates(plain_alpha, plain_epsilon)
        agent = reference.WholeReturns((env.num_states, env.num_actions), rates, gamma, 0.5, **fields)
        check(agent, task, words, state, log, i)
        if state.clock.visits is not None:
            np.testing.assert_array_equal(state.clock.visits[i], agent.returns)


@pytest.mark.slow
def test_a_batch_of_one_is_a_policy_that_improves_after_every_episode():
    """And one as long as the run is a policy that never does: Q is then q_pi of the first policy, uniform."""
    env = random_mdp()
    run = jax.jit(lambda method: rl.train(jax.random.key(0), method, env, num_steps=300, log_every=300))
    state, _ = run(rl.MonteCarlo(epsilon=0.0, batch=1))
    assert state.acting is None
    state, _ = run(rl.MonteCarlo(epsilon=0.0, batch=300))
    assert (state.acting[0] == 0).all() and (state.q[:4] != 0).all()


# --- by hand: gamma 1/2, alpha 1/N -------------------------------------------------------------------


def after(*episodes, gamma=0.5, cut=False, **fields):
    """Q after episodes of (S, R, S') each; see `by_hand.learned`."""
    return learned(rl.MonteCarlo(gamma=jnp.float32(gamma), **fields), 3, episodes, gamma, cut)


LOOP = ((0, 1.0, 0), (0, 4.0, 1), (1, 2.0, 0), (0, 8.0, 2))


def test_every_visit_and_first_visit():
    """The returns are 8, 2 + 8/2 = 6, 4 + 6/2 = 7 and 1 + 7/2 = 4.5; those of state 0 are 4.5, 7 and 8.

    Broken once: the last visit for the first -> fails.
    """
    np.testing.assert_array_equal(after(LOOP), [6.5, 6.0, 0.0])
    np.testing.assert_array_equal(after(LOOP, first_visit=True), [4.5, 6.0, 0.0])


def test_first_visits_are_found_at_gamma_0():
    """The returns are the rewards: the first of state 0 is 1.

    Broken once: "not yet seen" where a trace that gamma has faded to 0 says so -> fails.
    """
    np.testing.assert_array_equal(after(LOOP, gamma=0.0, first_visit=True), [1.0, 2.0, 0.0])
    np.testing.assert_array_equal(after(LOOP, LOOP[1:], gamma=0.0, first_visit=True), [2.5, 2.0, 0.0])


def test_an_episode_is_forgotten_when_it_is_over():
    """Each of two episodes is averaged once, and what was visited in the first is new in the second.

    Broken once: the memory not cleared at the end of the episode -> fails.
    """
    twice = after(LOOP, LOOP, first_visit=True)
    np.testing.assert_array_equal(twice, [4.5, 6.0, 0.0])
    np.testing.assert_array_equal(after(LOOP, ((1, 2.0, 2),)), [6.5, 4.0, 0.0])


def test_a_time_limit_leaves_the_value_of_the_state_it_was_reached_in():
    """G = 8 + 2/2, where V(2) = 2; at a terminal state it does not count.

    Broken once: a time limit treated as terminal -> fails.
    """
    episodes = ((2, 2.0, 1),), ((0, 8.0, 2),)
    np.testing.assert_array_equal(after(*episodes, cut=True), [9.0, 0.0, 2.0])
    np.testing.assert_array_equal(after(*episodes), [8.0, 0.0, 2.0])


# --- the forward view of Sarsa(lambda) ---------------------------------------------------------------


def off_line_sarsa(q, episode, alphas):
    """Sarsa (equation 6.7) of every step, all by the Q of the start of the episode."""
    new = q.copy()
    for s, a, r, discount, s_next, a_next, alpha in zip(*episode, alphas, strict=True):
        new[s, a] += alpha * (r + discount * q[s_next, a_next] - q[s, a])
    return new


FORWARD = {"windy, stochastic, king": "1/N", "random mdp": "episode"}


def test_the_book_makes_the_same_updates_one_after_another():
    """Broken once: by the Q of the start; from the last step to the first; what later updates leave not forgotten with
    the episode; the returns by the Q that the walk has changed -> each fails.
    """
    (env, task), (alpha, plain_alpha) = task_apart("random mdp"), ALPHAS["visit"]
    lambdas = (0.5, 0.0, 1.0, 0.9)
    method = lambda gamma, lam: rl.SarsaLambdaForward(
        alpha=alpha, epsilon=EPSILON, q0=0.5, gamma=gamma, lam=lam, one_by_one=True
    )
    (state, log), words = played(env, method, lambdas)
    for i, (gamma, lam) in enumerate(zip(GAMMAS, lambdas, strict=True)):
        view = lambda *given, lam=lam: reference.offline_one_by_one(*given, lam)
        rates = reference.Rates(plain_alpha, FIXED(EPSILON))
        agent = reference.ForwardView((env.num_states, env.num_actions), rates, gamma, 0.5, view=view)
        check(agent, task, words, state, log, i)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("env_name", FORWARD)
def test_the_forward_view_is_what_its_definition_says(env_name):
    """Off-line Sarsa where lambda = 0, every-visit Monte Carlo where it is 1, else mixtures of n-step ones.

    And where alpha is the same for all steps of an episode it is the off-line backward view.

    Broken once: G not discounted; nothing after the time limit; by the Q that the walk has changed; a
    bootstrap through terminal states; the next value not shared with lambda; one step size for all -> each
    fails.
    """
    (env, task), (alpha, plain_alpha) = task_apart(env_name), ALPHAS[FORWARD[env_name]]
    lambdas = (0.5, 0.0, 1.0, 0.9)
    shared = {"alpha": alpha, "epsilon": EPSILON, "q0": 0.5}
    forward = lambda gamma, lam: rl.SarsaLambdaForward(**shared, gamma=gamma, lam=lam)
    backward = lambda gamma, lam: rl.SarsaLambda(**shared, gamma=gamma, lam=lam, offline=True)
    (state, log), words = played(env, forward, lambdas)
    for i, (gamma, lam) in enumerate(zip(GAMMAS, lambdas, strict=True)):
        view = {0.0: off_line_sarsa, 1.0: reference.every_visit_monte_carlo}.get(
            lam, lambda *given, lam=lam: reference.offline_forward(*given, lam)
        )
        rates = reference.Rates(plain_alpha, FIXED(EPSILON))
        agent = reference.ForwardView((env.num_states, env.num_actions), rates, gamma, 0.5, view=view)
        check(agent, task, words, state, log, i)
    if FORWARD[env_name] == "episode":
        (other, other_log), _ = played(env, backward, lambdas)
        np.testing.assert_allclose(state.q, other.q, rtol=0, atol=1e-10)
        np.testing.assert_array_equal(log.lengths, other_log.lengths)
