"""Actions that a state does not have: nobody takes them, and no maximum and no mean counts them."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import reference_gradient
import reference_one_step as plain
from marks import slow_but
from test_models import PSRL, planning_words, posterior_numbers
from test_one_step import heads, target_words
from test_reference import STEPS, task_of, words_of

import jaxrl_tab as rl
from jaxrl_tab import bridge, importance, planning, schedules
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.policies import UCB, UNAVAILABLE, EpsilonGreedy, Greedy, Softmax, Table
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Outcome, restricted
from jaxrl_tab.envs.base import Finite
from jaxrl_tab.methods import PREDICTION

pytestmark = pytest.mark.usefixtures("optimised")

HAS = np.array([[1, 0, 1, 0], [0, 0, 1, 0], [1, 1, 0, 1], [1, 1, 1, 1], [0, 1, 0, 0]], bool)
UNIFORM = HAS / HAS.sum(1, keepdims=True)


@pytree
class FewActions(Finite):
    """Five states, the last one terminal, four actions, of which a state has the ones in HAS."""

    mdp: rl.FiniteMDP

    num_states, num_actions, max_steps = 5, 4, 5

    def available(self, s):
        return jnp.asarray(HAS)[s]

    def initial(self):
        return self.mdp.initial()

    def outcomes(self, s, a):
        return self.mdp.outcomes(s, a)


def few_actions(elsewhere: float) -> FewActions:
    """Where an action that is not there would pay `elsewhere`, and end the episode."""
    rand = np.random.default_rng(0)
    p, r = rand.dirichlet(np.ones(5), (5, 4)), rand.integers(-16, 17, (5, 4, 5)) / 4
    r += rand.integers(-99, 99, r.shape) / 2**10  # of different returns no two are equal
    p[~HAS], r[~HAS] = np.eye(5)[4], elsewhere
    return FewActions(rl.FiniteMDP(p, r, terminal=[4], start=[0.25, 0.25, 0.25, 0.25, 0.0]))


TEMPTING, DIRE = 50.0, -50.0

# --- decision for decision ---------------------------------------------------------------------------

ALPHA, EPSILON, GAMMA = 0.25, 0.5, 0.5
RATES = reference.Rates(lambda *_: ALPHA, lambda *_: EPSILON)
SHARED = (HAS.shape, RATES, GAMMA, np.where(HAS, 0.5, -np.inf))
soft = lambda row, s: reference.soft(row, EPSILON)
greedy = lambda row, s: reference.soft(row, 0)
tenth = lambda n: 0.1


def summed(q, episode, alphas):
    return reference.offline_forward(q, episode, alphas, 0.9)


# What else the method is given, and its plain loop, from the key of the run.
PLAIN = {
    "sarsa": ({}, lambda key: reference.NStepSarsa(*SHARED, n=1)),
    "q-learning": ({}, lambda key: reference.OffPolicy(*SHARED, target=greedy)),
    "expected-sarsa": ({}, lambda key: reference.OffPolicy(*SHARED, target=soft)),
    "n-step-sarsa": ({"n": 3}, lambda key: reference.NStepSarsa(*SHARED, n=3)),
    "n-step-expected-sarsa": (
        {"n": 3},
        lambda key: reference.NStepOffPolicy(*SHARED, n=3, expected=True),
    ),
    "n-step-off-policy-sarsa": (
        {"n": 3},
        lambda key: reference.NStepOffPolicy(*SHARED, n=3, expected=False, target=greedy),
    ),
    "tree-backup": ({"n": 3}, lambda key: reference.Branching(*SHARED, n=3, target=greedy)),
    "q-sigma": ({"n": 3}, lambda key: reference.Branching(*SHARED, n=3, sigma=lambda *_: 0.5)),
    "double-q-learning": (
        {},
        lambda key: reference.DoubleQLearning(*SHARED, heads=heads(key), words=target_words(key)),
    ),
    "double-sarsa": ({}, lambda key: plain.Double(*SHARED, heads=heads(key))),
    "double-expected-sarsa": ({}, lambda key: plain.Double(*SHARED, heads=heads(key), expected=True)),
    "weighted-double-q-learning": (
        {"c": 1.0},
        lambda key: plain.WeightedDoubleQLearning(
            *SHARED, c=1, heads=heads(key), words=target_words(key), worst=target_words(key, 1)
        ),
    ),
    "maxmin-q-learning": ({}, lambda key: plain.MaxminQLearning(*SHARED, tables=2, words=target_words(key))),
    "hysteretic-q-learning": ({"beta": 0.0625}, lambda key: plain.HystereticQLearning(*SHARED, beta=0.0625)),
    "q-learning-target": (
        {"target": EpsilonGreedy(EPSILON)},
        lambda key: reference.OffPolicy(*SHARED, target=soft, words=target_words(key)),
    ),
    "monte-carlo": (
        {"exploring_starts": True, "batch": 2},
        lambda key: reference.WholeReturns(*SHARED, exploring_starts=True, batch=2),
    ),
    "off-policy-monte-carlo": (
        {"alpha": schedules.sample_average()},
        lambda key: reference.OffPolicyReturns(
            HAS.shape,
            reference.Rates(lambda t, k, n: 1 / n, RATES.epsilon),
            *SHARED[2:],
            target=greedy,
            weighting="weighted",
        ),
    ),
    "sarsa-lambda": ({"trace": "dutch"}, lambda key: reference.Traces(*SHARED, lam=0.9, trace="dutch")),
    "true-online-sarsa-lambda": ({}, lambda key: reference.Traces(*SHARED, lam=0.9, trace="dutch")),
    "expected-sarsa-lambda": (
        {},
        lambda key: reference.ExpectedTraces(*SHARED, lam=0.9, c=lambda pi, b: 1),
    ),
    "tree-backup-lambda": (
        {},
        lambda key: reference.ExpectedTraces(*SHARED, lam=0.9, c=lambda pi, b: pi, target=greedy),
    ),
    "retrace": (
        {},
        lambda key: reference.ExpectedTraces(*SHARED, lam=0.9, c=lambda pi, b: min(1, pi / b), target=greedy),
    ),
    "q-pi-lambda": (
        {},
        lambda key: reference.ExpectedTraces(*SHARED, lam=0.9, c=lambda pi, b: 1, target=greedy),
    ),
    "sarsa-lambda-forward": ({}, lambda key: reference.ForwardView(*SHARED, view=summed)),
    "dyna-q": ({}, lambda key: reference.DynaQ(*SHARED, words=planning_words(key))),
    "dyna-q-plus": (
        {"kappa": 0.25},
        lambda key: reference.DynaQ(*SHARED, words=planning_words(key), kappa=0.25),
    ),
    "r-max": ({"m": 3, "sweeps": 9}, lambda key: reference.RMax(*SHARED, m=3, sweeps=9)),
    "psrl": (
        PSRL,
        lambda key: reference.PSRL(*SHARED, numbers=posterior_numbers(key, 20, 5), samples=1, **PSRL),
    ),
    "prioritized-sweeping": ({}, lambda key: reference.PrioritizedSweeping(*SHARED)),
    "q-lambda": ({}, lambda key: reference.Traces(*SHARED, lam=0.9, version="watkins")),
    "gradient-bandit": ({}, lambda key: reference_gradient.GradientBandit(*SHARED)),
    "reinforce": ({}, lambda key: reference_gradient.Reinforce(*SHARED)),
    "reinforce-baseline": ({}, lambda key: reference_gradient.Reinforce(*SHARED, alpha_v=tenth)),
    "actor-critic": ({}, lambda key: reference_gradient.ActorCritic(*SHARED, alpha_v=tenth)),
    "actor-critic-lambda": (
        {},
        lambda key: reference_gradient.ActorCritic(*SHARED, alpha_v=tenth, lam=0.9, lam_v=0.9),
    ),
    "r-learning": (
        {"gamma": 1.0, "beta": 0.25},
        lambda key: plain.RLearning(*SHARED[:2], 1.0, SHARED[3], beta=0.25),
    ),
    "differential-q-learning": (
        {"gamma": 1.0, "eta": 0.5},
        lambda key: plain.DifferentialQLearning(*SHARED[:2], 1.0, SHARED[3], beta=0.5),
    ),
    "differential-sarsa": (
        {"gamma": 1.0, "beta": 0.25},
        lambda key: plain.DifferentialSarsa(*SHARED[:2], 1.0, SHARED[3], beta=0.25),
    ),
}


@cache
def both() -> FewActions:
    """The two environments that differ in what is not there, as a batch."""
    return jax.tree.map(lambda *x: np.stack(x), few_actions(TEMPTING), few_actions(DIRE))


def played(method, **budget):
    """What is learned in both, [2, ...]: it must be the same, to the bit."""
    run = lambda env: rl.train(jax.random.key(3), method, env, **budget or {"num_steps": STEPS})
    state, log = jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(both()))
    for x in jax.tree.leaves((state, log)):
        np.testing.assert_array_equal(x[0], x[1])
    assert abs(state.q[0][state.q[0] != np.array(UNAVAILABLE, state.q.dtype)]).max() < 30
    return jax.tree.map(lambda x: x[0], (state, log))


def has_a_plain_loop(name):
    """Not where it learns in other tasks alone, which `test_optimism` has; with features it is the same by table."""
    declared = of_method(rl.ALGORITHMS[name])
    return not declared.needs_horizon and declared.features is None


SOME = ["sarsa", "monte-carlo", "sarsa-lambda"]


@pytest.mark.parametrize("name", slow_but(SOME, [x for x in rl.ALGORITHMS if has_a_plain_loop(x)]))
def test_every_step_agrees_with_the_plain_loop(name):
    """Broken once -> each fails: epsilon over all actions; Q0 everywhere; UCB and exploring starts that try

    all actions; the target not told.
    """
    fields, plain = PLAIN[name]
    double = plain(jax.random.key(0)).q.dtype == float
    with jax.enable_x64(double):
        key = jax.random.key(3)
        agent, words, task = plain(key), words_of(key), task_of(few_actions(TEMPTING))
        common = {"alpha": ALPHA, "epsilon": EPSILON, "gamma": GAMMA, "q0": 0.5, "theta0": 0.5}
        taken = {f.name for f in dataclasses.fields(rl.ALGORITHMS[name])}
        method = rl.ALGORITHMS[name](**{k: x for k, x in common.items() if k in taken} | fields)
        state, log = played(method, num_steps=STEPS, log_every=STEPS)
    if getattr(agent, "exploring_starts", False):
        task = task._replace(initial=[1, 1, 1, 1, 0])
    finished = reference.run(agent, task, STEPS, words)
    assert log.episodes[0] == len(finished) > 100
    assert log.lengths[0] == sum(n for _, n in finished)
    tables = [(state.q1, agent.q1), (state.q2, agent.q2)] if hasattr(state, "q1") else [(state.q, agent.q)]
    for got, want in tables:
        tolerance = 1e-10 if double else 1e-4  # sums of products may be rounded otherwise
        np.testing.assert_allclose(got[HAS], want[HAS], rtol=tolerance, atol=tolerance)
        np.testing.assert_array_equal(got[~HAS], np.array(UNAVAILABLE, got.dtype))


@pytest.mark.parametrize(
    "policy", [EpsilonGreedy(1.0), Softmax(9.0), UCB(9.0), Greedy(), Table(UNIFORM)], ids=str
)
def test_no_policy_takes_an_action_that_is_not_there(policy):
    """Broken once: an action that was never taken comes first in UCB, whatever it is; Q0 everywhere -> fails."""
    start = restricted(rl.QLearning(behaviour=policy), HAS).init(5, 4).q
    np.testing.assert_array_equal(start, np.where(HAS, 0, np.float32(UNAVAILABLE)))
    for visits in (np.zeros((5, 4), int), HAS * 9):
        clock = schedules.start(5, 4, True)._replace(visits=jnp.asarray(visits))
        rows = [
            restricted(policy, HAS).probs(jnp.where(HAS[s], 0.0, UNAVAILABLE), clock, jnp.int32(s))
            for s in range(5)
        ]
        np.testing.assert_allclose(rows, UNIFORM, rtol=1e-6)


@pytest.mark.parametrize("name", PREDICTION)
def test_all_actions_equally_likely_are_those_that_there_are(name):
    """Broken once: 1/A for all, where pi is not given -> fails."""
    method = PREDICTION[name](gamma=GAMMA)
    state = restricted(method, HAS).init(5, 4)
    for pi in filter(lambda x: x is not None, (state.acting, state.target)):
        np.testing.assert_allclose(pi, UNIFORM, rtol=1e-6)
    env = few_actions(TEMPTING)
    assert method.exact_value(env) == pytest.approx(planning.policy_value(env, UNIFORM, GAMMA), rel=1e-12)


def test_many_targets_act_among_what_there_is():
    method = restricted(rl.ManyTargets(np.stack([UNIFORM] * 3)), HAS)
    np.testing.assert_allclose(method.selection.probabilities, UNIFORM, rtol=1e-6)
    np.testing.assert_array_equal(method.init(5, 4).q == np.float32(UNAVAILABLE), np.stack([~HAS] * 3))


# --- exact values ------------------------------------------------------------------------------------


def every_policy(epsilon):
    """All that take one action of each state, and with probability epsilon any that there is."""
    choices = np.array(np.meshgrid(*(np.flatnonzero(row) for row in HAS), indexing="ij")).reshape(5, -1).T
    return [epsilon * UNIFORM + (1 - epsilon) * np.eye(4)[choice] for choice in choices]


def values(model, pi, gamma):
    """v_pi, [S], from the outcomes of what is there."""
    p = np.zeros((5, 5))
    for s, a, k in np.ndindex(model.prob.shape):
        if HAS[s, a] and not model.terminal[s, a, k]:
            p[s, model.s_next[s, a, k]] += pi[s, a] * model.prob[s, a, k]
    r = (np.where(HAS, pi, 0) * (model.prob * model.reward).sum(-1)).sum(1)
    return np.linalg.solve(np.eye(5) - gamma * p, r)


@pytest.mark.parametrize("elsewhere", [TEMPTING, DIRE])
def test_planning_knows_what_there_is(elsewhere):
    """Against all 24 policies, each as a linear system.

    Broken once -> each fails: the mean, or epsilon, over all actions; a first policy that takes all of them.
    """
    env = few_actions(elsewhere)
    model = planning.exact_model(env)
    for epsilon in (0.0, 0.3):
        best = np.max([values(model, pi, 0.9) for pi in every_policy(epsilon)], axis=0)
        pi, v, q = planning.epsilon_soft(env, epsilon, 0.9)
        np.testing.assert_allclose(v, best, rtol=1e-10)
        np.testing.assert_allclose(planning.epsilon_greedy_policy(q, epsilon), pi)
        assert (pi[~HAS] == 0).all() and (q[~HAS] == UNAVAILABLE).all()
        np.testing.assert_allclose(planning.evaluate(env, pi, 0.9), v, rtol=1e-12)
    v, q = planning.value_iteration(env, 0.9)
    np.testing.assert_allclose(v, planning.policy_iteration(env, 0.9)[1], rtol=1e-9)
    wild = np.where(HAS, q, 1e9)  # whatever a table says of what is not there
    np.testing.assert_allclose(planning.optimality_backup(env, wild, 0.9), q, rtol=1e-8)
    np.testing.assert_array_equal(
        planning.expectation_backup(env, wild, UNIFORM, 0.9),
        planning.expectation_backup(env, q, UNIFORM, 0.9),
    )
    assert not np.isnan(importance.action_variance(env, UNIFORM, UNIFORM, 0.9).ordinary[HAS]).any()
    assert np.isnan(importance.action_variance(env, UNIFORM, UNIFORM, 0.9).ordinary[~HAS]).all()


def test_nothing_is_reached_by_what_is_not_there():
    """s0 goes to s1 only by an action that it does not have. Broken once: outcomes as they are -> fails."""

    @pytree
    class Closed(Finite):
        num_states, num_actions, max_steps = 3, 2, 9

        def available(self, s):
            return jnp.array([True, False]) | (s > 0)

        def initial(self):
            return jnp.eye(3)[0]

        def outcomes(self, s, a):
            s_next = jnp.where((s == 0) & (a == 1), 1, 2)[None]
            return jnp.ones(1), Outcome(s_next, jnp.where(s < 2, -1.0, 0.0)[None], s_next == 2)

    assert planning.reachable(planning.exact_model(Closed())).tolist() == [True, False, True]


def test_waiting_for_nothing_is_done_by_what_is_there():
    """Waiting is free, and ending costs 1. Broken once: a copy of waiting that is not there -> is taken."""

    @pytree
    class Waiting(Finite):
        num_states, num_actions, max_steps = 2, 3, 9

        def available(self, s):
            return jnp.arange(3) < 2

        def initial(self):
            return jnp.eye(2)[0]

        def outcomes(self, s, a):
            ends = (s == 1) | (a == 1)
            reward = jnp.where(ends & (s == 0), -1.0, 0.0)
            return jnp.ones(1), Outcome(ends.astype(jnp.int32)[None], reward[None], ends[None])

    pi, v, _ = planning.policy_iteration(Waiting())
    assert pi[0].tolist() == [1, 0, 0] and v[0] == 0


@pytest.mark.slow
def test_exact_values_beside_a_run():
    """Broken once: |Q - Q*| of what is not there -> fails."""
    method = rl.QLearning(alpha=schedules.sample_average(), epsilon=1.0, gamma=GAMMA)
    run = lambda: rl.train(
        jax.random.key(3), method, few_actions(TEMPTING), num_steps=9999, exact=True, log_every=9999
    )
    _, log = jax.jit(run)()
    assert log.q_error[0] < 0.2
    env = few_actions(TEMPTING)
    optimum = planning.start_value(env, planning.value_iteration(env, GAMMA)[0])
    assert log.greedy_value[0] == pytest.approx(optimum, rel=1e-6)


@pytest.mark.parametrize("method", [rl.QLearning(gamma=0.9), rl.ExpectedSarsa(gamma=0.9, epsilon=0.3)])
def test_the_mean_of_a_sample_backup_is_a_full_backup(method):
    env = few_actions(TEMPTING)
    q = np.random.default_rng(1).normal(size=HAS.shape)
    pi = planning.epsilon_greedy_policy(np.where(HAS, q, UNAVAILABLE), getattr(method, "epsilon", 0.1))
    want = (
        planning.optimality_backup(env, q, 0.9)
        if isinstance(method, rl.QLearning)
        else planning.expectation_backup(env, q, pi, 0.9)
    )
    np.testing.assert_allclose(bridge.expected_backup(method, env, q), want, rtol=1e-10)


# --- as anyone runs it -------------------------------------------------------------------------------


def test_maximization_bias_is_the_one_of_the_book():
    """Figure 6.5: the numbers of 40 000 plain loops with two actions in A (standard error .0025 in the end).

    Broken once: ten actions in A -> 61% instead of 46% in episode 100.
    """
    result = rl.sweep(rl.make("maximization-bias"), "q-learning", num_seeds=4000, num_episodes=100)
    left = result.log.lengths.mean(0) - 1
    for episode, share in ((1, 0.5), (19, 0.9396), (100, 0.4587)):
        assert left[episode - 1] == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 4000) + 0.01)


# --- what is refused ---------------------------------------------------------------------------------


@pytree
class Untold:
    """A method of somebody who never heard of this."""

    gamma: float = 1.0

    def init(self, num_states, num_actions): ...

    def policy(self, key, state, s): ...

    def update(self, key, state, t): ...


EVERYWHERE = np.full(HAS.shape, 0.25)


@pytest.mark.parametrize(
    "method",
    [
        rl.Sarsa(behaviour=Table(EVERYWHERE)),
        rl.ExpectedSarsa(target=Table(EVERYWHERE)),
        rl.ManyTargets(EVERYWHERE[None]),
        rl.prediction.TD(pi=EVERYWHERE),
        rl.prediction.OffPolicyTD(behaviour=EVERYWHERE),
    ],
    ids=lambda method: type(method).__name__,
)
def test_a_table_that_takes_what_is_not_there_is_refused(method):
    message = "state 0 does not have action 1, so its probability must be 0, not 0.25"
    with pytest.raises(rl.InputError, match=message):
        rl.train(jax.random.key(0), method, few_actions(0.0), num_steps=10)


def test_what_else_is_refused():
    env = few_actions(0.0)
    with pytest.raises(rl.InputError, match="state 0 does not have action 1"):
        rl.sweep(env, "sarsa", {"behaviour": [Table(EVERYWHERE)]}, num_seeds=1, num_steps=10)
    with pytest.raises(rl.InputError, match="policy_probs: state 0 does not have action 1"):
        planning.evaluate(env, EVERYWHERE, 0.9)
    with pytest.raises(rl.InputError, match="target: state 0 does not have action 1"):
        importance.variance(env, EVERYWHERE, EVERYWHERE)
    with pytest.raises(
        rl.InputError, match="Untold cannot be told that some states do not have every action"
    ):
        rl.train(jax.random.key(0), Untold(), env, num_steps=10)
    with pytest.raises(
        rl.InputError, match="name an action in every state, in terminal ones too; 0 has none"
    ):
        rl.train(
            jax.random.key(0),
            rl.Sarsa(behaviour=EpsilonGreedy(0.1, ~HAS | (np.arange(4) == 1))),
            env,
            num_steps=9,
        )


def test_a_log_tells_what_is_there():
    """Broken once: `available` not looked at -> the log is taken."""
    log = rl.Experience(s=[0, 2], a=[2, 2], r=[1.0, 1.0], s_next=[2, 4], terminal=[False, True])
    with pytest.raises(rl.InputError, match="transition 1 takes action 2 in state 2, which does not have it"):
        rl.learn(jax.random.key(0), rl.QLearning(), log, 5, 4, available=HAS)
    few = rl.Experience(s=[0, 2], a=[2, 1], r=[1.0, -1.0], s_next=[2, 4], terminal=[False, True])
    q = rl.learn(jax.random.key(0), rl.QLearning(alpha=1.0, q0=-2.0), few, 5, 4, available=HAS).q
    np.testing.assert_array_equal(q[~HAS], np.float32(UNAVAILABLE))
    assert (q[0, 2], q[2, 1]) == (-1, -1)
    with pytest.raises(rl.InputError, match=r"learn: available must be booleans \[S, A\] = \[5, 4\]"):
        rl.learn(jax.random.key(0), rl.QLearning(), few, 5, 4, available=HAS[:2])


# --- said of the behaviour policy --------------------------------------------------------------------


def test_a_behaviour_may_be_restricted_where_the_environment_says_nothing():
    """s0 -(-1)-> s1 -(-5)-> end. In s1 action 1 would give 0, and is not to be taken."""
    to = np.array([[[0, 1, 0], [0, 1, 0]], [[0, 0, 1], [0, 0, 1]], [[0, 0, 1], [0, 0, 1]]], float)
    chain = rl.FiniteMDP(to, np.array([[-1.0, -1.0], [-5.0, 0.0], [0.0, 0.0]]), terminal=[2])
    method = rl.QLearning(alpha=0.5, behaviour=EpsilonGreedy(0.5, [[1, 1], [1, 0], [1, 1]]))
    q = rl.train(jax.random.key(0), method, chain, num_steps=400)[0].q
    np.testing.assert_allclose(q[:2], [[-6, -6], [-5, UNAVAILABLE]], rtol=1e-5)


def test_coverage_knows_which_actions_there_are():
    """Broken once: `available` not looked at -> fails."""
    available = np.array([[True, True], [True, False], [True, True]])
    behaviour = EpsilonGreedy(0.1, available)
    needs_it = Table(np.tile([0.0, 1.0], (3, 1)))
    for method in (rl.OffPolicyMonteCarlo, rl.TargetQLearning, rl.ExpectedSarsa):
        with pytest.raises(rl.InputError, match="leaves out action 1 in state 1, which target can take"):
            method(behaviour=behaviour, target=needs_it)
        for target in (Greedy(), Softmax(1.0), Table(np.tile([1.0, 0.0], (3, 1)))):
            method(behaviour=behaviour, target=target)
