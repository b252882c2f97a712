"""Learning from logs, again from memory, and about many policies at once: against runs and exact values."""

import jax
import numpy as np
import pytest
from marks import slow_but

import jaxrl_tab as rl
from jaxrl_tab import offline, planning, prediction
from jaxrl_tab.algorithms import MonteCarlo, OffPolicyMonteCarlo
from jaxrl_tab.core.declared import LearnsFrom, of_method
from jaxrl_tab.core.policies import EpsilonGreedy, Greedy, Table
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.schedules import Power

GAMMA = 0.9
CLIFF = rl.CliffWalking(shape=(2, 4))  # deterministic: what learns without noise gets to the exact values
SIZES = CLIFF.num_states, CLIFF.num_actions
UNIFORM = np.full(SIZES, 1 / SIZES[1])
FIELDS = ("s", "a", "r", "s_next", "terminal", "last")


def some_policies(count, seed=0):
    return np.random.default_rng(seed).dirichlet(np.ones(SIZES[1]), size=(count, SIZES[0]))


def exact_q(env, probs, gamma=GAMMA):
    return planning.backup(planning.exact_model(env), planning.evaluate(env, probs, gamma), gamma)


@pytest.fixture(scope="module")
def log():
    """Two thousand steps of somebody who moves at random."""
    return rl.collect(jax.random.key(1), UNIFORM, CLIFF, 2000)


@pytest.fixture(scope="module")
def visited(log):
    pairs = np.zeros(SIZES, bool)
    pairs[log.s, log.a] = True
    assert pairs.sum() == 5 * SIZES[1]  # all states but the goal and the two on the cliff
    return pairs


# --- a log is what happened --------------------------------------------------------------------------


def test_learning_from_the_log_of_a_run_gives_the_q_of_the_run_bit_for_bit():
    """Broken once -> fails: the log backwards; gamma' not 0 at terminal states; S' after the reset."""
    env = rl.CliffWalking(shape=(2, 4), max_steps=9)  # a time limit cuts many episodes short
    method, key = rl.QLearning(alpha=Power(0.7, clock="episode"), gamma=GAMMA, q0=-5.0), jax.random.key(0)
    state, _ = rl.train(key, method, env, num_steps=3000)
    learned = rl.learn(jax.random.key(99), method, rl.collect(key, method, env, 3000), *SIZES)
    np.testing.assert_array_equal(learned.q, state.q)
    assert learned.clock.step == 3000
    assert np.any(state.q < -10)


def test_off_policy_monte_carlo_learns_from_episodes_what_it_learned_in_the_run(log):
    ends = np.flatnonzero(log.terminal)
    whole = rl.Experience(*(getattr(log, name)[: ends[-1] + 1] for name in FIELDS))
    method = OffPolicyMonteCarlo(gamma=GAMMA, target=EpsilonGreedy(0.1), behaviour=Table(UNIFORM))
    learned = rl.learn(jax.random.key(0), method, whole, *SIZES)
    state, _ = rl.train(jax.random.key(1), method, CLIFF, num_episodes=len(ends))
    np.testing.assert_array_equal(learned.q, state.q)
    assert learned.clock.episode == len(ends)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("cls", [prediction.OffPolicyTD, prediction.OffPolicyMonteCarloPrediction])
def test_state_values_of_another_policy_are_learned_from_a_log(cls):
    """Up to the last full episode of the run, which ends with it; b must be known, though it is uniform."""
    method, key = cls(pi=some_policies(1)[0], behaviour=UNIFORM, gamma=GAMMA), jax.random.key(0)
    state, log = rl.train(key, method, CLIFF, num_episodes=20)
    experience = rl.collect(key, method, CLIFF, int(log.lengths.sum()))
    np.testing.assert_array_equal(rl.learn(key, method, experience, *SIZES).v, state.v)
    with pytest.raises(rl.InputError, match=f"{cls.__name__} weighs what it learns by the policy that acted"):
        rl.learn(key, cls(pi=some_policies(1)[0]), experience, *SIZES)


@pytest.mark.parametrize("gamma", [0.0, 0.5])
def test_terminal_and_cut_short_are_told_apart_whatever_gamma_is(gamma):
    """Broken once -> fails: terminal where the method's own gamma' is 0; a time limit as terminal."""
    env = rl.CliffWalking(shape=(2, 4), max_steps=7)
    log = rl.collect(jax.random.key(0), rl.Sarsa(gamma=gamma), env, 1000)
    goal, start = env.state(env.goal), env.start_state
    np.testing.assert_array_equal(log.terminal, log.s_next == goal)
    assert log.terminal.any() and (log.last & ~log.terminal).sum() > 10
    assert (log.s[1:][log.last[:-1]] == start).all()
    assert np.diff(np.flatnonzero(log.last), prepend=-1).max() == 7
    _, outcome = jax.vmap(env.outcomes)(log.s, log.a)  # deterministic: one outcome each
    np.testing.assert_array_equal(log.s_next, outcome.s_next[:, 0])
    np.testing.assert_array_equal(log.r, outcome.reward[:, 0])


def test_a_fixed_policy_acts_as_its_table_says():
    """Within 5 standard errors, in every state that is visited often."""
    b = some_policies(1)[0]
    log = rl.collect(jax.random.key(0), Table(b), CLIFF, 20_000)
    counts = np.zeros(SIZES)
    np.add.at(counts, (log.s, log.a), 1)
    often = counts.sum(1) > 500
    n = counts[often].sum(1, keepdims=True)
    error = abs(counts[often] / n - b[often]) / np.sqrt(b[often] * (1 - b[often]) / n)
    assert often.sum() >= 3
    assert error.max() < 5


def test_exploring_starts_are_logged_as_they_are():
    method = MonteCarlo(exploring_starts=True, epsilon=0.3)
    log = rl.collect(jax.random.key(2), method, CLIFF, 3000)
    assert len(set(log.s[1:][log.last[:-1]].tolist())) > 3


def test_logs_can_be_made_and_learned_from_in_a_batch():
    """Three logs in one program are the three logs alone, and so is what is learned from them."""
    method = rl.QLearning(alpha=0.5, gamma=GAMMA)

    def one(key):
        log = rl.collect(key, method, CLIFF, 200)
        return log, rl.learn(key, method, log, *SIZES).q

    keys = jax.random.split(jax.random.key(0), 3)
    logs, q = jax.jit(jax.vmap(one))(keys)
    for i, key in enumerate(keys):
        alone, q_alone = one(key)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(logs, name)[i], getattr(alone, name))
        np.testing.assert_array_equal(q[i], q_alone)
    assert not np.array_equal(q[0], q[1])


# --- learning from somebody else ---------------------------------------------------------------------

FROM_TRANSITIONS = [
    n
    for n, m in rl.ALGORITHMS.items()
    if of_method(m).learns_from is LearnsFrom.TRANSITIONS and not of_method(m).in_the_long_run
]
FROM_OWN = [n for n, m in rl.ALGORITHMS.items() if of_method(m).learns_from is LearnsFrom.ITSELF]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", FROM_TRANSITIONS)
def test_control_from_the_log_of_a_random_walker_is_optimal(name, log, visited):
    """Every registered method that says that it learns from transitions; so does its replay."""
    more = {"beta": 1.0} if name == "hysteretic-q-learning" else {}
    more |= {"alpha": 1.0} if hasattr(rl.ALGORITHMS[name], "alpha") else {}
    method = rl.ALGORITHMS[name](epsilon=0.0, gamma=GAMMA, q0=-5.0, **more)
    _, q_star = planning.value_iteration(CLIFF, GAMMA)
    learned = rl.learn(jax.random.key(0), method, log, *SIZES, passes=5)
    np.testing.assert_allclose(learned.q[visited], q_star[visited], rtol=1e-5)
    again = rl.replay(jax.random.key(0), method, log, *SIZES, num_updates=10_000)
    np.testing.assert_allclose(again.q[visited], q_star[visited], rtol=1e-5)


IN_ORDER = {"tree-backup": {}, "tree-backup-lambda": {}, "retrace": {}, "q-sigma": {"target": Greedy()}}


@pytest.mark.parametrize("name", slow_but(["tree-backup"], IN_ORDER))
def test_off_policy_methods_of_several_steps_learn_from_a_log_in_its_order(name, log, visited):
    """Those that go by ratios are told who acted; the others need not be. Broken once: the log backwards -> fails."""
    needs = of_method(rl.ALGORITHMS[name]).learns_from.needs_behaviour
    b = {"behaviour": Table(UNIFORM)} if needs else {}
    method = rl.ALGORITHMS[name](alpha=0.5, gamma=GAMMA, q0=-5.0, **b, **IN_ORDER[name])
    _, q_star = planning.value_iteration(CLIFF, GAMMA)
    learned = rl.learn(jax.random.key(0), method, log, *SIZES, passes=5)
    np.testing.assert_allclose(learned.q[visited], q_star[visited], rtol=1e-4)
    with pytest.raises(rl.InputError, match="replay draws single transitions"):
        rl.replay(jax.random.key(0), method, log, *SIZES, num_updates=10)


def test_any_policy_is_evaluated_from_the_log_of_another(log, visited):
    pi = some_policies(1, seed=5)[0]
    method = rl.ExpectedSarsa(alpha=1.0, gamma=GAMMA, target=Table(pi), behaviour=Table(UNIFORM))
    learned = rl.learn(jax.random.key(0), method, log, *SIZES, passes=30)
    np.testing.assert_allclose(learned.q[visited], exact_q(CLIFF, pi)[visited], rtol=1e-4)


@pytest.mark.slow
def test_importance_sampling_from_logs_has_the_mean_of_the_target_policy():
    """256 logs of 20 games each, within 4 standard errors. The policy that acted has another value."""
    p = np.zeros((4, 2, 4))
    p[0, 0, [1, 2]] = p[1, 0, [2, 3]] = p[1, 1, [0, 3]] = p[2, 1, [1, 3]] = 0.5
    p[0, 1, 2] = p[2, 0, 3] = p[3, :, 3] = 1
    env = rl.FiniteMDP(p, rewards=[[1, 0], [2, -1], [0, 3], [0, 0]], terminal=[3])
    b, pi = np.full((4, 2), 0.5), np.array([[0.8, 0.2], [0.4, 0.6], [0.3, 0.7], [0.5, 0.5]])
    method = OffPolicyMonteCarlo(target=Table(pi), behaviour=Table(b), weighting="ordinary", first_visit=True)

    def one(key):
        return rl.learn(key, method, rl.collect(key, b, env, 100), 4, 2).q[0]

    q = np.asarray(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), 256)), float)
    error = q.std(0) / 16
    want, of_b = exact_q(env, pi, 1.0)[0], exact_q(env, b, 1.0)[0]
    assert (abs(q.mean(0) - want) < 4 * error).all()
    assert (abs(of_b - want) > 8 * error).any()


@pytest.mark.parametrize("name", FROM_OWN)
def test_methods_that_learn_about_what_they_do_themselves_are_refused(name, log):
    """Sarsa's A', or the rest of an n-step return, would be somebody else's."""
    for call in (rl.learn, lambda *given: rl.replay(*given, num_updates=10)):
        with pytest.raises(rl.InputError, match=r"can learn only from what it did itself; take QLearning"):
            call(jax.random.key(0), rl.ALGORITHMS[name](), log, *SIZES)


def test_the_methods_are_sorted_as_the_book_does():
    assert {"q-learning", "expected-sarsa", "double-q-learning", "q-learning-target"} <= set(FROM_TRANSITIONS)
    assert {"sarsa", "n-step-sarsa", "monte-carlo", "sarsa-lambda", "q-lambda"} <= set(FROM_OWN)


def test_another_update_must_say_for_itself_what_it_learns_from(log):
    @pytree
    class Borrowed(rl.QLearning):
        update = rl.Sarsa.update

    with pytest.raises(rl.InputError, match="Borrowed can learn only from what it did itself"):
        rl.learn(jax.random.key(0), Borrowed(), log, *SIZES)


# --- order and passes --------------------------------------------------------------------------------

CHAIN = rl.Experience(s=[0, 1], a=[0, 0], r=[0, 1], s_next=[1, 2], terminal=[False, True])
BACKWARDS = rl.Experience(s=[1, 0], a=[0, 0], r=[1, 0], s_next=[2, 1], terminal=[True, False], last=True)


@pytest.mark.parametrize(
    ("experience", "passes", "q"),
    [
        (CHAIN, 1, (0, 0.5)),
        (CHAIN, 2, (0.25, 0.75)),
        (CHAIN, 3, (0.5, 0.875)),
        (BACKWARDS, 1, (0.25, 0.5)),
    ],
)
def test_transitions_are_learned_from_in_order_as_often_as_is_said(experience, passes, q):
    """Worked by hand: 0 -> 1 -> end with 1; step size 1/2."""
    method = rl.QLearning(alpha=0.5)
    learned = rl.learn(jax.random.key(0), method, experience, 3, 1, passes=passes)
    np.testing.assert_array_equal(learned.q[:, 0], (*q, 0))
    assert learned.clock.step == 2 * passes
    assert learned.clock.episode == experience.last.sum() * passes


def test_each_transition_of_each_pass_draws_anew():
    """With a drawn target: not twice the same in 32 transitions, nor in two passes, nor from two keys."""
    n, zeros = 32, np.zeros(32, int)
    log = rl.Experience(s=np.arange(n), a=zeros, r=zeros, s_next=zeros + n, terminal=zeros > 0, last=True)
    q0 = np.zeros((n + 1, 2))
    q0[n] = 1, 2
    method = rl.TargetQLearning(alpha=1.0, q0=q0, target=Table(np.full(q0.shape, 0.5)))

    def drawn(passes, seed):
        return rl.learn(jax.random.key(seed), method, log, n + 1, 2, passes=passes).q[:n, 0].tolist()

    assert set(drawn(1, 0)) == {1, 2}
    assert len({tuple(x) for x in (drawn(1, 0), drawn(2, 0), drawn(1, 1))}) == 3


# --- replay ------------------------------------------------------------------------------------------


def test_replay_draws_uniformly_with_replacement():
    """Counts of 50 transitions in 20 000 draws: chi-square within 5 standard deviations of its mean.

    Broken once -> fails: one index never drawn; each drawn in turn (chi-square 0).
    """
    n, draws = 50, 20_000
    zeros = np.zeros(n)
    memory = rl.Experience(np.arange(n), zeros.astype(int), zeros, np.arange(n), zeros > 0, last=True)
    method = rl.QLearning(alpha=rl.schedules.sample_average())
    counts = rl.replay(jax.random.key(0), method, memory, n, 1, num_updates=draws).clock.visits[:, 0]
    assert counts.sum() == draws
    chi_square = ((counts - draws / n) ** 2).sum() / (draws / n)
    assert abs(chi_square - (n - 1)) < 5 * np.sqrt(2 * (n - 1))
    other = rl.replay(jax.random.key(1), method, memory, n, 1, num_updates=draws).clock.visits[:, 0]
    assert not np.array_equal(counts, other)


def test_replay_learns_more_from_a_short_run_than_the_run_did():
    method, key = rl.QLearning(alpha=1.0, gamma=GAMMA), jax.random.key(0)
    state, _ = rl.train(key, method, CLIFF, num_steps=200)
    memory = rl.collect(key, method, CLIFF, 200)
    replayed = rl.replay(key, method, memory, *SIZES, num_updates=4000)
    _, q_star = planning.value_iteration(CLIFF, GAMMA)
    seen = memory.s, memory.a
    error, before = (abs(np.asarray(x.q) - q_star)[seen].max() for x in (replayed, state))
    assert before > 0.1
    assert error < 1e-4


def test_whole_episodes_are_not_replayed(log):
    method = OffPolicyMonteCarlo(behaviour=Table(UNIFORM))
    with pytest.raises(rl.InputError, match="replay draws single transitions, and OffPolicyMonteCarlo"):
        rl.replay(jax.random.key(0), method, log, *SIZES, num_updates=10)


# --- many target policies ----------------------------------------------------------------------------

TARGETS = np.concatenate([some_policies(3), UNIFORM[None]])
BEHAVIOUR = Table(0.5 * UNIFORM + 0.5 * some_policies(1, seed=9)[0])
MANY = rl.ManyTargets(TARGETS, BEHAVIOUR, alpha=1.0, gamma=GAMMA)


def test_each_table_goes_to_the_values_of_its_policy(visited):
    """Broken once -> fails: every table with the first policy; the behaviour's probabilities for pi."""
    state, _ = rl.train(jax.random.key(0), MANY, CLIFF, num_steps=50_000)
    assert state.q.shape == (4, *SIZES)
    for q, pi in zip(state.q, TARGETS, strict=True):
        np.testing.assert_allclose(q[visited], exact_q(CLIFF, pi)[visited], rtol=1e-4)


def test_each_table_is_what_expected_sarsa_learns_alone():
    """But for the last bit: XLA may round a sum of products otherwise in another program."""
    method = rl.ManyTargets(TARGETS, BEHAVIOUR, alpha=Power(0.7, clock="visit"), gamma=GAMMA, q0=-1.0)
    state, log = rl.train(jax.random.key(3), method, CLIFF, num_steps=2000)
    for q, pi in zip(state.q, TARGETS, strict=True):
        alone, log_alone = rl.train(
            jax.random.key(3),
            rl.ExpectedSarsa(alpha=method.alpha, gamma=GAMMA, q0=-1.0, target=Table(pi), behaviour=BEHAVIOUR),
            CLIFF,
            num_steps=2000,
        )
        np.testing.assert_allclose(q, alone.q, rtol=1e-6)
        np.testing.assert_array_equal(log.rewards, log_alone.rewards)
    np.testing.assert_array_equal(state.clock.visits, alone.clock.visits)


def test_many_runs_of_many_targets_are_each_run_alone():
    def run(key):
        return rl.train(key, MANY, CLIFF, num_steps=500)[0].q

    keys = jax.random.split(jax.random.key(0), 3)
    together = jax.jit(jax.vmap(run))(keys)
    np.testing.assert_allclose(together, np.stack([run(key) for key in keys]), rtol=1e-6)
    assert not np.array_equal(together[0], together[1])


def test_many_targets_are_learned_from_one_log(log, visited):
    method = rl.ManyTargets(TARGETS, alpha=1.0, gamma=GAMMA)
    learned = rl.learn(jax.random.key(0), method, log, *SIZES, passes=30)
    replayed = rl.replay(jax.random.key(0), method, log, *SIZES, num_updates=60_000)
    for i, pi in enumerate(TARGETS):
        for state in (learned, replayed):
            np.testing.assert_allclose(state.q[i][visited], exact_q(CLIFF, pi)[visited], rtol=1e-4)


@pytest.mark.slow
def test_many_targets_with_noise_have_the_right_mean():
    """A stochastic task, step sizes that fall: the mean of 64 runs within 4 standard errors and 1%."""
    env = rl.RandomWalk(states=5)
    method = rl.ManyTargets(np.ones((2, 7, 1)), alpha=Power(0.7, clock="visit"))
    run = jax.jit(jax.vmap(lambda key: rl.train(key, method, env, num_steps=5000)[0].q))
    q = np.asarray(run(jax.random.split(jax.random.key(0), 64)), float)[:, :, 1:6, 0]
    want = planning.evaluate(env, np.ones((7, 1)))[1:6]
    assert (abs(q.mean(0) - want) < 4 * q.std(0) / 8 + 0.01).all()
    assert q.std(0).max() > 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"targets": UNIFORM}, r"targets must be numbers \[P, S, A\], not of shape \(8, 4\)"),
        ({"targets": 2 * TARGETS}, r"of policy 0 in state 0 are not a distribution: \["),
        (
            {"targets": TARGETS, "behaviour": EpsilonGreedy()},
            r"must be policies.Table\(b\), for there is no one Q",
        ),
        (
            {"targets": TARGETS, "behaviour": Table(np.eye(4)[[0] * 8])},
            r"target 0: behaviour leaves out action 1 in state 0",
        ),
        ({"targets": TARGETS, "alpha": 0}, "ManyTargets: alpha must be greater than 0, not 0"),
        ({"targets": TARGETS, "gamma": 2}, "ManyTargets: gamma must be between 0 and 1, not 2"),
    ],
)
def test_many_targets_are_checked(arguments, message):
    with pytest.raises(rl.InputError, match=message):
        rl.ManyTargets(**arguments)


def test_many_targets_must_fit_the_task(windy):
    with pytest.raises(rl.InputError, match="the task has 70 states and 4 actions"):
        rl.train(jax.random.key(0), MANY, windy, num_steps=10)


# --- the dataset -------------------------------------------------------------------------------------

GOOD = {
    "s": [0, 1, 0, 2],
    "a": [0, 1, 1, 0],
    "r": [0.5, 1, 2, 3],
    "s_next": [1, 3, 2, 0],
    "terminal": [False, True, False, False],
    "last": [False, True, False, True],
}


def assert_same(one, other):
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_transitions_episodes_and_padded_arrays_make_the_same_experience():
    experience = rl.Experience(**GOOD)
    ended = [True, False]
    episodes = [([0, 1, 3], [0, 1], [0.5, 1]), ([0, 2, 0], [1, 0], [2, 3])]
    assert_same(rl.Experience.from_episodes(episodes, terminal=ended), experience)
    nan = np.nan
    padded = rl.Experience.from_padded(
        s=[[0, 1, 3, 9], [0, 2, 0, -9]],
        a=[[0, 1, 9], [1, 0, -9]],
        r=[[0.5, 1, nan], [2, 3, nan]],
        lengths=[2, 2],
        terminal=ended,
    )
    assert_same(padded, experience)
    assert_same(rl.Experience(**(GOOD | {"last": None})), experience)


def test_columns_of_0_and_1_are_truth_values():
    """As they are read back from a file of numbers. Broken once: without a `last`, | of floats -> fails."""
    experience = rl.Experience(**GOOD)
    for kind in (int, float):
        terminal, last = (np.array(GOOD[name], kind) for name in ("terminal", "last"))
        assert_same(rl.Experience(**(GOOD | {"terminal": terminal, "last": last})), experience)
        assert_same(rl.Experience(**(GOOD | {"terminal": terminal.tolist(), "last": None})), experience)
        assert_same(
            rl.Experience.from_episodes([EPISODE, EPISODE], terminal=kind(0)),
            rl.Experience.from_episodes([EPISODE, EPISODE], terminal=[False, False]),
        )


def test_episodes_may_have_any_lengths():
    experience = rl.Experience.from_padded(
        s=[[0, 1, 2, 3], [2, 3, 0, 0]], a=np.zeros((2, 3), int), r=[[1, 2, 3], [4, 0, 0]], lengths=[3, 1]
    )
    np.testing.assert_array_equal(experience.s, [0, 1, 2, 2])
    np.testing.assert_array_equal(experience.s_next, [1, 2, 3, 3])
    np.testing.assert_array_equal(experience.r, [1, 2, 3, 4])
    np.testing.assert_array_equal(experience.terminal, [False, False, True, True])
    np.testing.assert_array_equal(experience.last, experience.terminal)


EPISODE = ([0, 1, 3], [0, 1], [0.5, 1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"s": [[0, 1], [0, 2]]}, r"s must be whole numbers \[N\], at least one, not of shape \[2, 2\]"),
        ({"s": []}, r"s must be whole numbers \[N\], at least one, not of shape \[0\]"),
        ({"s": 3}, r"s must be whole numbers \[N\], at least one, not of shape \[\]"),
        ({"a": [0, 1, 1]}, r"a must have length 4, as s has, not 3"),
        ({"s": [[0], [1, 2]]}, r"s must be numbers, in rows of equal length"),
        ({"s": [0.0, 1, 0, 2]}, r"s must be whole numbers, not float64"),
        ({"a": [False, True, True, False]}, r"a must be whole numbers, not bool"),
        ({"r": ["a", "b", "c", "d"]}, r"r must be numbers"),
        ({"terminal": [0, 1, 2, 0]}, r"terminal must be booleans, or 0 and 1, not int64"),
        ({"terminal": [0, 0.5, 0, 0], "last": None}, r"terminal must be booleans, or 0 and 1, not float64"),
        ({"last": [0, np.nan, 0, 1]}, r"last must be booleans, or 0 and 1, not float64"),
        (dict.fromkeys(GOOD, ()), r"s must be whole numbers \[N\], at least one, not of shape \[0\]"),
        (dict.fromkeys(GOOD, ()) | {"last": None}, r"s must be whole numbers \[N\], at least one, not of"),
        ({"r": [0, 1, np.nan, 0]}, r"r\[2\] is nan, not a finite number"),
        ({"r": [0, 1, 2, np.inf]}, r"r\[3\] is inf, not a finite number"),
        (
            {"last": [False, False, False, True]},
            r"transition 1 enters a terminal state, which ends the episode: last\[1\] must be True",
        ),
        (
            {"last": [False, True, False, False]},
            r"the last transition must end its episode, if only because the log does: last\[3\] must be True",
        ),
        (
            {"s": [0, 1, 0, 1]},
            r"transition 2 leads to state 2, and transition 3 starts in state 1; .*last\[2\] must be True; "
            r"for transitions in no order give last=True",
        ),
    ],
)
def test_experience_is_checked(change, message):
    rl.Experience(**GOOD)
    with pytest.raises(rl.InputError, match=f"^Experience: {message}") as error:
        rl.Experience(**(GOOD | change))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rl.Experience.from_episodes([]), "there must be at least one episode"),
        (
            lambda: rl.Experience.from_episodes(3),
            "episodes must be a list of .states, actions, rewards., not 3",
        ),
        (lambda: rl.Experience.from_episodes([3]), r"episode 0 must be \(states, actions, rewards\), not 3"),
        (
            lambda: rl.Experience.from_episodes([EPISODE, EPISODE[:2]]),
            r"episode 1 must be \(states, actions, re",
        ),
        (
            lambda: rl.Experience.from_episodes([EPISODE, ([0, 1], [0, 1], [1, 1])]),
            r"episode 1 must have T actions, T rewards and T \+ 1 states, .* \(2,\), \(2,\) and \(2,\)",
        ),
        (lambda: rl.Experience.from_episodes([([0], [], [])]), "episode 0 must have T actions"),
        (
            lambda: rl.Experience.from_episodes([EPISODE], terminal=[True, False]),
            r"terminal must be True, False, or booleans \[E\] = \[1\], not bool \[2\]",
        ),
        (
            lambda: rl.Experience.from_padded([[0, 1]], [[0, 1]], [[0, 1]], [2]),
            r"s \[E, T \+ 1\] with the last states, .*; not \(1, 2\), \(1, 2\), \(1, 2\) and \(1,\)",
        ),
        (
            lambda: rl.Experience.from_padded([[0, 1, 2]], [[0, 1]], [[0, 1]], [3]),
            r"lengths\[0\] is 3, and must be from 1 to 2",
        ),
        (
            lambda: rl.Experience.from_padded([[0, 1, 2]], [[0, 1]], [[0, 1]], [1.5]),
            r"lengths must be whole numbers, not float64",
        ),
    ],
)
def test_episodes_are_checked(make, message):
    with pytest.raises(rl.InputError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


NEVER_1 = Table(np.array([[0.5, 0.5], [1, 0], [0.5, 0.5], [0.5, 0.5]]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_states": 3}, r"s_next\[1\] is 3; the task has states 0 to 2"),
        ({"num_actions": 1}, r"a\[1\] is 1; the task has actions 0 to 0"),
        (
            {"experience": rl.Experience(**(GOOD | {"s": [-1, 1, 0, 2]}))},
            r"s\[0\] is -1; the task has states 0 to",
        ),
        ({"experience": rl.Experience(**(GOOD | {"a": [2**40] * 4}))}, r"a\[0\] is 1099511627776; the task"),
        ({"num_states": 2.5}, "num_states must be a whole number of at least 1, not 2.5"),
        ({"num_actions": 0}, "num_actions must be a whole number of at least 1, not 0"),
        ({"experience": GOOD}, "experience must be an Experience, not dict"),
        ({"algorithm": rl.QLearning}, r"algorithm must be an instance, such as QLearning\(\), not the class"),
        ({"passes": 0}, "learn: passes must be a whole number of at least 1, not 0"),
        (
            {"algorithm": rl.QLearning(behaviour=NEVER_1)},
            "transition 1 takes action 1 in state 1, which the behaviour policy never does; it is not",
        ),
        (
            {"algorithm": OffPolicyMonteCarlo(target=NEVER_1, behaviour=NEVER_1)},
            "transition 1 takes action 1 in state 1, which the behaviour policy never does; it is not",
        ),
        (
            {"algorithm": OffPolicyMonteCarlo(epsilon=0.5)},
            r"OffPolicyMonteCarlo weighs what it learns by the policy that acted, which must be given: beh",
        ),
        (
            {"algorithm": rl.QLearning(behaviour=Table(UNIFORM))},
            "of shape \\(8, 4\\), and the task has 4 states and 2 actions",
        ),
    ],
)
def test_a_log_must_fit_the_task_and_the_method_before_anything_is_compiled(arguments, message, monkeypatch):
    monkeypatch.setattr(offline, "_learn", lambda *_: pytest.fail("compiled"))
    given = {
        "algorithm": rl.QLearning(),
        "experience": rl.Experience(**GOOD),
        "num_states": 4,
        "num_actions": 2,
    }
    with pytest.raises(rl.InputError, match=message) as error:
        rl.learn(jax.random.key(0), **(given | arguments))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        (
            EpsilonGreedy(0.1),
            "EpsilonGreedy chooses by Q, and nobody has learned one here; give its probabilities",
        ),
        (rl.QLearning, r"behaviour must be an instance, such as QLearning\(\), not the class"),
        (UNIFORM[:2], r"of shape \(2, 4\), and the task has 8 states"),
        (2 * UNIFORM, "the probabilities in state 0 are not a distribution"),
        ("random", r"behaviour must be an instance, such as Sarsa\(\), not 'random'"),
    ],
)
def test_who_acts_is_checked(behaviour, message):
    with pytest.raises(rl.InputError, match=message):
        rl.collect(jax.random.key(0), behaviour, CLIFF, 10)
