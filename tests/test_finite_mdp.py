"""FiniteMDP from what other tools have: the same task in every form, and one line for everything else."""

import time

import numpy as np
import pytest
from scipy import sparse

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.interop import from_gymnasium

# --- published examples, as their users write them ----------------------------------------------------

# the forest of pymdptoolbox, mdptoolbox.example.forest(): wait or cut, in three ages; actions first
FOREST = np.array([[[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]], [[1, 0, 0], [1, 0, 0], [1, 0, 0]]])
FOREST_REWARDS = np.array([[0, 0], [0, 1], [4, 2]])


@pytest.mark.parametrize("probabilities", [FOREST, [sparse.csr_matrix(p) for p in FOREST], FOREST.tolist()])
@pytest.mark.parametrize("rewards", [FOREST_REWARDS, sparse.csr_matrix(FOREST_REWARDS)])
def test_the_forest_of_pymdptoolbox(probabilities, rewards):
    """Its documentation: policy iteration with discount 0.9 waits everywhere, worth 26.244, 29.484, 33.484."""
    env = FiniteMDP.from_arrays(probabilities, rewards)
    v, q = planning.value_iteration(env, gamma=0.9)
    np.testing.assert_allclose(v, [26.244, 29.484, 33.484], atol=1e-3)
    assert q.argmax(1).tolist() == [0, 0, 0]


def test_the_example_of_quantecon():
    """Puterman's two states, as DiscreteDP documents them: v* = -8.5714, -20 with beta 0.95."""
    q, r = [[(0.5, 0.5), (0, 1)], [(0, 1), (0.5, 0.5)]], [[5, 10], [-1, -np.inf]]
    with pytest.raises(
        rl.InputError, match=r"\(2, 2, 2\) may be .*say first_axis='state' or first_axis='action'"
    ):
        FiniteMDP.from_arrays(q, r)
    for build in (lambda q, r: FiniteMDP.from_arrays(q, r, first_axis="state"), FiniteMDP):
        with pytest.raises(rl.InputError, match=r"\(1, 1\) is -inf, .*can be a copy of one that it has"):
            build(q, r)
        env = build([q[0], [q[1][0]] * 2], [r[0], [-1, -1]])
        np.testing.assert_allclose(planning.value_iteration(env, gamma=0.95)[0], [-60 / 7, -20], atol=1e-6)


def test_the_table_of_gymnasium_by_itself():
    """Flags say what is terminal; the rows after the goal of the cliff, which go on there, are not looked at."""
    import gymnasium

    cliff = gymnasium.make("CliffWalking-v1").unwrapped
    env = FiniteMDP.from_outcomes(cliff.P, start=cliff.initial_state_distrib)
    assert np.flatnonzero(env.is_terminal).tolist() == [47]
    v, _ = planning.value_iteration(env)
    assert v[36] == pytest.approx(-13)
    assert same(env, from_gymnasium("CliffWalking-v1"))


# --- the same task in every form -----------------------------------------------------------------------


def same(env, other):
    fields = ("successors", "prob", "reward", "is_terminal", "start_states", "start_prob")
    return all(np.array_equal(getattr(env, x), getattr(other, x)) for x in fields)


def random_table(seed, num_states, num_actions):
    """p and r [S, A, S'], where the last state is terminal, and can be reached."""
    rand = np.random.default_rng(seed)
    p = rand.dirichlet(np.ones(num_states), (num_states, num_actions))
    p *= rand.random(p.shape) < 0.6
    p[..., -1] += p.sum(-1) == 0
    p[0, 0, -1] += 0.5
    p /= p.sum(-1, keepdims=True)
    return p, rand.integers(1, 9, p.shape).astype(float)


def listed(p, r, last=None):
    """[S][A] lists of (p, s', reward), or with whether s' is `last` behind."""
    more = lambda s_next: () if last is None else (s_next == last,)
    return [
        [[(row[i], i, r[s, a, i], *more(i)) for i in np.flatnonzero(row)] for a, row in enumerate(actions)]
        for s, actions in enumerate(p)
    ]


def shuffled(rand, values):
    """A dict of `values`, its keys as numbers of NumPy in any order."""
    return {np.int64(i): values[i] for i in rand.permutation(len(values))}


@pytest.mark.parametrize(("num_states", "num_actions"), [(5, 2), (2, 5), (3, 3), (1, 1), (4, 1), (6, 3)])
@pytest.mark.parametrize("seed", [0, 1])
def test_one_task_in_every_form(seed, num_states, num_actions):
    """Broken once: rewards of sparse matrices taken from the transpose; dicts in the order of their keys."""
    p, r = random_table(seed, num_states, num_actions)
    terminal = [num_states - 1] if num_states > 1 else []
    rand = np.random.default_rng(seed)
    expected = FiniteMDP(p, r, terminal)

    outcomes = listed(p, r)
    as_dict = shuffled(rand, [shuffled(rand, actions) for actions in outcomes])
    flagged = listed(p, r, last=num_states - 1 if terminal else -1)
    for given in (outcomes, as_dict, np.array(outcomes, object) if num_states == 1 else tuple(outcomes)):
        assert same(FiniteMDP.from_outcomes(given, terminal), expected)
    assert same(FiniteMDP.from_outcomes(flagged), expected)
    assert same(FiniteMDP.from_outcomes(dict(enumerate(flagged)), terminal), expected)

    by_action, by_action_r = p.swapaxes(0, 1), r.swapaxes(0, 1)
    halves = [sparse.coo_matrix(x) for x in by_action]  # each entry in two parts
    halves = [
        sparse.coo_matrix(([*x.data / 2] * 2, ([*x.row] * 2, [*x.col] * 2)), shape=x.shape) for x in halves
    ]
    many = np.empty(num_actions, object)
    many[:] = [sparse.csr_array(x) for x in by_action]
    sparse_r = [sparse.csc_matrix(x) for x in by_action_r]
    dense = [(p, r, "state"), (by_action, by_action_r, "action"), (p, sparse_r, "state")]
    for probabilities, rewards, axis in dense:
        assert same(FiniteMDP.from_arrays(probabilities, rewards, terminal, first_axis=axis), expected)
        if num_states != num_actions:
            assert same(FiniteMDP.from_arrays(probabilities, rewards, terminal), expected)
    for probabilities in (
        [sparse.csr_matrix(x) for x in by_action],
        halves,
        many,
        [*map(sparse.lil_matrix, by_action)],
    ):
        for rewards in (by_action_r, sparse_r, by_action_r.tolist()):
            assert same(FiniteMDP.from_arrays(probabilities, rewards, terminal), expected)

    by_pair = FiniteMDP(p, r[..., 0], terminal)
    assert same(FiniteMDP.from_arrays(many, sparse.csr_matrix(r[..., 0]), terminal), by_pair)
    by_state = FiniteMDP(p, np.repeat(r[:, :1, 0], num_actions, axis=1), terminal)
    assert same(FiniteMDP.from_arrays(many, r[:, 0, 0], terminal), by_state)


def test_values_are_those_of_the_arrays():
    """By plain sweeps over the arrays."""
    p, r = random_table(3, 6, 3)
    v = np.zeros(6)
    for _ in range(400):
        v = np.where(np.arange(6) == 5, 0, (p * (r + 0.9 * v)).sum(-1).max(1))
    matrices = [sparse.csr_matrix(x) for x in p.swapaxes(0, 1)]
    for env in (
        FiniteMDP.from_arrays(matrices, r.swapaxes(0, 1), terminal=[5]),
        FiniteMDP.from_outcomes(listed(p, r, last=5)),
    ):
        np.testing.assert_allclose(planning.value_iteration(env, gamma=0.9)[0], v, atol=1e-9)


# --- flags -----------------------------------------------------------------------------------------------


def test_flags_and_terminal_together():
    """State 1 is terminal by the flag, 2 because it is said. What is listed after both is not looked at."""
    outcomes = [
        [[(0.5, 1, 1.0, True), (0.5, 2, 4.0, False)]],
        [[(1.0, 0, 9.0, False)]],
        [[(7.0, 0, 9.0, False)]],
    ]
    env = FiniteMDP.from_outcomes(outcomes, terminal=[2])
    assert env.is_terminal.tolist() == [False, True, True]
    assert planning.value_iteration(env)[0].tolist() == [2.5, 0, 0]


def test_a_state_that_ends_and_goes_on_gets_a_second_number():
    """Both do: 2 and 3 are the ends in 0 and in 1. v0 = (2 + 0 + v1) / 2, and v1 = 8."""
    outcomes = [[[(0.5, 1, 2.0, True), (0.5, 1, 0.0, False)]], [[(1.0, 0, 8.0, True)]]]
    env = FiniteMDP.from_outcomes(outcomes)
    assert env.is_terminal.tolist() == [False, False, True, True]
    v, _ = planning.value_iteration(env)
    assert v.tolist() == [5, 8, 0, 0]


# --- size ------------------------------------------------------------------------------------------------


def test_a_long_corridor_takes_no_more_than_its_length():
    """10^5 states in about a second; it was 7 s for 16,000. Broken once: state by state -> fails."""
    n = 100_000
    outcomes = [[[(1.0, max(s - 1, 0), -1.0)], [(1.0, min(s + 1, n - 1), -1.0)]] for s in range(n)]
    began = time.process_time()
    env = FiniteMDP.from_outcomes(outcomes, terminal=[n - 1])
    assert time.process_time() - began < 60  # some 300 s, state by state
    assert env.successors.shape == (n, 2, 1)
    s = np.arange(n)
    there = np.minimum(s + 1, n - 1), np.maximum(s - 1, 0)
    moves = [sparse.coo_matrix((np.ones(n), (s, to)), shape=(n, n)) for to in reversed(there)]
    assert same(FiniteMDP.from_arrays(moves, np.where(s == n - 1, 0, -1), terminal=[n - 1]), env)


# --- what is wrong is said ---------------------------------------------------------------------------------

P, R = random_table(0, 3, 2)
SPARSE = [sparse.csr_matrix(x) for x in P.swapaxes(0, 1)]
TWO = [[[(1.0, 1, 0.0)]], [[]]]


def two(outcome):
    return lambda: FiniteMDP.from_outcomes([[[outcome]], [[]]], terminal=[1])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (two((1, 1.7, 0)), "s' of an outcome after (s, a) = (0, 0) must be the number of a state, not 1.7"),
        (two((1, "1", 0)), "s' of an outcome after (s, a) = (0, 0) must be the number of a state, not '1'"),
        (two((1, True, 0)), "s' of an outcome after (s, a) = (0, 0) must be the number of a state, not True"),
        (
            two((1, np.nan, 0)),
            "s' of an outcome after (s, a) = (0, 0) must be the number of a state, not nan",
        ),
        (two((1, np.inf, 0)), "there is no state inf, an outcome after (s, a) = (0, 0); states are 0 to 1"),
        (two((1, 1e300, 0)), "there is no state 1e+300, an outcome after (s, a) = (0, 0); states are 0 to 1"),
        (two(("1", 1, 0)), "the probability of an outcome after (s, a) = (0, 0) must be a number, not '1'"),
        (two((1, 1, None)), "the reward after (s, a) = (0, 0) must be a number, not None"),
        (two((1, 1, 0, "no")), "terminated after (s, a) = (0, 0) must be True or False, not 'no'"),
        (
            two((1, 1)),
            "an outcome after (s, a) = (0, 0) must be (p, s', reward) or (p, s', reward, terminated), not (1, 1)",
        ),
        (
            lambda: FiniteMDP.from_outcomes([[[(0.5, 0, 0), (0.5, 1, 0, True)]], [[]]]),
            "an outcome after (s, a) = (0, 0) has 4 entries, and the first one has 3; "
            "all or none must say whether they are terminated",
        ),
        (
            lambda: FiniteMDP.from_outcomes([[None]]),
            "outcomes after (s, a) = (0, 0) must be a list, not None",
        ),
        (
            lambda: FiniteMDP.from_outcomes({0: {0: [], 2: []}}),
            "the keys of the actions of s = 0 must be 0 to 2, and 1 is missing",
        ),
        (
            lambda: FiniteMDP.from_outcomes({1: {0: []}}),
            "the keys of outcomes must be 0 to 1, and 0 is missing",
        ),
        (
            lambda: FiniteMDP.from_outcomes({(0, 0): []}),
            "the keys of outcomes must be whole numbers, not (0, 0)",
        ),
        (
            lambda: FiniteMDP.from_outcomes({0: {0: [], 1: []}, 1: {0: []}}),
            "s = 1 has 1 actions, and s = 0 has 2; all states must have the same number",
        ),
        (
            lambda: FiniteMDP.from_outcomes(P),
            "outcomes must be lists of (p, s', reward); FiniteMDP.from_arrays takes arrays and matrices",
        ),
        (
            lambda: FiniteMDP.from_outcomes([[[1.0, 0.0]]]),
            "an outcome after (s, a) = (0, 0) must be (p, s', reward) or (p, s', reward, terminated), not 1.0; "
            "FiniteMDP(probabilities, rewards) takes arrays",
        ),
        (
            lambda: FiniteMDP.from_outcomes(SPARSE),
            "outcomes must be lists of (p, s', reward); FiniteMDP.from_arrays takes arrays and matrices",
        ),
        (
            lambda: FiniteMDP(SPARSE, R),
            "probabilities must be an array [S, A, S']; FiniteMDP.from_arrays takes sparse matrices, "
            "one [S, S'] for each action",
        ),
        (
            lambda: FiniteMDP({0: {0: []}}),
            "probabilities must be an array, with rewards beside it; "
            "FiniteMDP.from_outcomes takes tables of outcomes",
        ),
        (
            lambda: FiniteMDP(R[..., 0], P),
            "probabilities must have shape [S, A, S'], not (3, 2): they come first, and then the rewards",
        ),
        (
            lambda: FiniteMDP(np.full((6, 3), 1 / 3), np.ones(6)),
            "probabilities must have shape [S, A, S'], not (6, 3); "
            "ddp.to_product_form() of QuantEcon turns pairs of states and actions into [S, A, S']",
        ),
        (
            lambda: FiniteMDP(P, R.swapaxes(0, 1)),
            "rewards must have shape [S, A] = (3, 2) or [S, A, S'] = (3, 2, 3), not (2, 3, 3); "
            "np.swapaxes(rewards, 0, 1) turns it into one of them",
        ),
        (
            lambda: FiniteMDP.from_arrays(SPARSE[0], R),
            "sparse probabilities must be a list of one matrix [S, S'] for each action, not one of shape (3, 3); "
            "ddp.to_product_form() of QuantEcon turns pairs of states and actions into [S, A, S']",
        ),
        (
            lambda: FiniteMDP.from_arrays([SPARSE[0], SPARSE[1][:, :2]], R),
            "sparse probabilities must be a list of one matrix [S, S'] for each action, and that of a = 1 is "
            "float64 of shape (3, 2)",
        ),
        (
            lambda: FiniteMDP.from_arrays(P, R.swapaxes(0, 1)),
            "rewards must have shape [S] = (3,), [S, A] = (3, 2) or [S, A, S'] = (3, 2, 3), not (2, 3, 3)",
        ),
        (
            lambda: FiniteMDP.from_arrays(P, R, first_axis="action"),
            "probabilities must have shape [A, S, S'], not (3, 2, 3)",
        ),
        (lambda: FiniteMDP.from_arrays(P, R, first_axis=0), "first_axis must be 'state' or 'action', not 0"),
    ],
)
def test_error(call, message):
    with pytest.raises(rl.InputError) as error:
        call()
    assert str(error.value) == f"FiniteMDP: {message}"


JUNK = [
    None, "x", "", True, np.nan, np.inf, -np.inf, -1, 1.7, 10**400, 1j, 2**40, [], (), {}, object(), [[1], [1, 2]],
    np.array("x"), np.array(3), np.zeros(0), np.zeros((2, 2, 2)), SPARSE, SPARSE[0], {1: 2}, {"a": []}, {True: []},
    b"x", int, range(3), np.ones((3, 2), complex), [None], ["x"], [[[]]], np.array([object()]), "x" * 5000,
]  # fmt: skip


def test_nonsense_gets_one_line():
    """Any argument, or any part of the outcomes, replaced by anything: it works, or InputError says why."""
    rand = np.random.default_rng(0)
    pick = lambda values: values[rand.integers(len(values))]
    refused = []
    for _ in range(600):
        build = pick([FiniteMDP, FiniteMDP.from_arrays, FiniteMDP.from_outcomes])
        given = {"terminal": [2], "start": 0, "max_steps": 9}
        if build == FiniteMDP.from_outcomes:
            outcomes = [[[list(x) for x in found] for found in actions] for actions in listed(P, R, last=2)]
            part, depth = outcomes, rand.integers(5)
            for _ in range(depth):
                i = rand.integers(len(part))
                if not isinstance(part[i], list):
                    break
                parent, part = part, part[i]
                if rand.random() < 0.3 and len(parent):
                    parent[i] = {pick([k, k, float(k), str(k)]): x for k, x in enumerate(part)}
            if len(part):
                part[rand.integers(len(part))] = pick(JUNK)
            given["outcomes"] = pick([outcomes, dict(enumerate(outcomes)), pick(JUNK)])
        else:
            given |= {"probabilities": pick([P, SPARSE]) if build != FiniteMDP else P, "rewards": R}
        if rand.random() < 0.7 or build != FiniteMDP.from_outcomes:
            given[pick([*given])] = pick(JUNK)
        try:
            build(**given)
        except rl.InputError as error:
            refused.append(str(error))
    assert len(refused) > 450
    assert not any("\n" in said or len(said) > 500 for said in refused)
