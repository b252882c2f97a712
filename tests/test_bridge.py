"""The mean of the sample backup of a one-step method is the full backup, for every registered one."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import bridge, planning, policies
from jaxrl_tab.algorithms.off_policy import OffPolicyControl
from jaxrl_tab.algorithms.prediction import TD
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.cli import main
from jaxrl_tab.core import tables
from jaxrl_tab.core.policies import EpsilonGreedy, Greedy, Softmax, Table
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Transition
from jaxrl_tab.methods import ALGORITHMS, PREDICTION

GAMMA, EPSILON = 0.9, 0.3
ENVS = {
    "windy": rl.WindyGridworld(stochastic=True, shape=(3, 4), wind=(0, 1, 2, 0), start=(2, 0), goal=(1, 3)),
    "cliff": rl.CliffWalking(shape=(2, 4)),
    "walk": rl.RandomWalk(states=5),
}
ONE_STEP = [(row, name) for row in bridge.TABLE for name in row.methods if name in ALGORITHMS]


def some_q(env):
    """Whole numbers, so that there are ties; at terminal states too, where they must not be looked at."""
    return np.random.default_rng(0).integers(0, 4, size=(env.num_states, env.num_actions)).astype(float)


def target_probs(method, env, q):
    """The policy that the method learns about, [S, A]: its target, or else the one by which it acts."""
    with jax.enable_x64():
        state = method.init(env.num_states, env.num_actions)
        state = state._replace(**dict.fromkeys({"q", "q1", "q2"} & {*state._fields}, jnp.asarray(q)))
        of = getattr(method, "target_probs", method.probs)
        return np.asarray(jax.jit(jax.vmap(lambda s: of(state, s)))(jnp.arange(env.num_states)))


def full_backup(row, method, env, q):
    if row.backup is planning.optimality_backup:
        return row.backup(env, q, GAMMA)
    return row.backup(env, q, target_probs(method, env, q), GAMMA)


# --- the table ---------------------------------------------------------------------------------------


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("row", "name", "env_name"),
    [(*one, env) for one in ONE_STEP for env in ENVS if env == "windy" or one[1] == "sarsa"],
)
def test_the_mean_of_the_sample_backup_is_the_full_backup(row, name, env_name):
    """Broken once, each -> fails: gamma for `t.discount` in any method; in Sarsa the greedy action for A'."""
    env = ENVS[env_name]
    method, q = ALGORITHMS[name](epsilon=EPSILON, gamma=GAMMA), some_q(env)
    got = bridge.expected_backup(method, env, q)
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, full_backup(row, method, env, q), atol=1e-12)


@pytest.mark.parametrize("name", PREDICTION)
def test_the_mean_of_td_0_is_iterative_policy_evaluation(name):
    """Off-policy too, where b never does what pi never does: that is no 0 / 0. Broken once, each -> fails:

    no ratio; the ratio of the next action; gamma for `t.discount`.
    """
    env = ENVS["windy"]
    pi = np.random.default_rng(1).dirichlet(np.ones(4), size=env.num_states) * [0, 1, 1, 1]
    pi /= pi.sum(1, keepdims=True)
    b = (pi > 0) / 3
    method = PREDICTION[name](pi=pi, gamma=GAMMA, **({"behaviour": b} if "off-policy" in name else {}))
    v = np.random.default_rng(0).normal(size=env.num_states)
    if name in bridge.TABLE[0].methods:
        want = planning.evaluation_backup(env, v, pi, GAMMA)
        np.testing.assert_allclose(bridge.expected_backup(method, env, v), want, atol=1e-12)
    else:
        with pytest.raises(rl.InputError, match=r"remembers .* from step to step|a function of features"):
            bridge.expected_backup(method, env, v)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_method_is_in_the_table_or_is_no_one_step_method(name):
    """So that a new line in the registry is looked at."""
    rows = [row for row in bridge.TABLE if name in row.methods]
    if not rows and name != "hysteretic-q-learning":  # which learns no mean
        why = "remembers .* from step to step|must be an instance of a one-step|a function of features"
        with pytest.raises(rl.InputError, match=why):
            bridge.expected_backup(ALGORITHMS[name](), ENVS["walk"], some_q(ENVS["walk"]))
    assert len(rows) <= 1


def test_the_table_can_be_printed():
    lines = bridge.table().splitlines()
    for pair in (
        ("iterative policy evaluation", "TD(0)"),
        ("q-policy iteration", "Sarsa"),
        ("q-value iteration", "Q-learning"),
    ):
        assert any(all(name in line for name in pair) for line in lines)
    assert {name for row in bridge.TABLE for name in row.methods} <= {*ALGORITHMS, *PREDICTION}


# --- any policy --------------------------------------------------------------------------------------


def table_policy(env):
    probs = np.random.default_rng(1).dirichlet(np.ones(env.num_actions), size=env.num_states)
    return Table(probs)


CLIFF = ENVS["cliff"]


@pytest.mark.parametrize(
    "method",
    [
        rl.Sarsa(gamma=GAMMA, behaviour=Softmax(0.5)),
        rl.Sarsa(gamma=GAMMA, behaviour=table_policy(CLIFF)),
        rl.ExpectedSarsa(gamma=GAMMA, target=Softmax(0.5)),
        ALGORITHMS["q-learning-target"](gamma=GAMMA, target=table_policy(CLIFF), behaviour=Softmax(2.0)),
        ALGORITHMS["q-learning-target"](gamma=GAMMA, target=EpsilonGreedy(0.2)),
    ],
    ids=["softmax", "table", "expected, softmax", "target table", "target epsilon-greedy"],
)
def test_it_is_the_expectation_under_the_target_policy_whoever_acts(method):
    q = some_q(CLIFF)
    want = planning.expectation_backup(CLIFF, q, target_probs(method, CLIFF, q), GAMMA)
    np.testing.assert_allclose(bridge.expected_backup(method, CLIFF, q), want, atol=1e-12)


def test_q_learning_with_the_greedy_target_is_on_both_rows():
    q, method = some_q(CLIFF), rl.ExpectedSarsa(gamma=GAMMA, target=Greedy())
    got = bridge.expected_backup(method, CLIFF, q)
    np.testing.assert_allclose(got, planning.optimality_backup(CLIFF, q, GAMMA), atol=1e-12)
    np.testing.assert_allclose(
        got, planning.expectation_backup(CLIFF, q, planning.greedy_policy(q), GAMMA), atol=1e-12
    )


@pytree
class Moody(TDControl):
    """Learns from the best that may follow or from the worst, as a coin falls."""

    def update(self, key, state, t):
        row = tables.row(state.q, t.s_next)
        q_next = jnp.where(policies.coin(key), row.max(), row.min())
        delta = t.r + t.discount * q_next - tables.entry(state.q, t.s, t.a)
        return self.learn(state, t, delta), self.policy(key, state, t.s_next)


def test_both_sides_of_a_coin_count():
    """(Double Q-learning does not show it: here both its tables are the same.)"""
    q = some_q(CLIFF)
    best, worst = (planning.backup(planning.exact_model(CLIFF), v, GAMMA) for v in (q.max(1), q.min(1)))
    got = bridge.expected_backup(Moody(gamma=GAMMA), CLIFF, q)
    np.testing.assert_allclose(got, (best + worst) / 2, atol=1e-12)


# --- fixed points ------------------------------------------------------------------------------------


def test_q_star_and_q_pi_are_the_fixed_points():
    """And v_pi that of the backup for values; at gamma = 1 too."""
    for gamma in (GAMMA, 1.0):
        _, q_star = planning.value_iteration(CLIFF, gamma, tol=1e-12)
        np.testing.assert_allclose(
            bridge.expected_backup(rl.QLearning(gamma=gamma), CLIFF, q_star), q_star, atol=1e-9
        )
        policy = table_policy(CLIFF)
        v = planning.evaluate(CLIFF, policy.probabilities, gamma)
        np.testing.assert_allclose(
            planning.evaluation_backup(CLIFF, v, policy.probabilities, gamma), v, rtol=1e-9
        )
        q = planning.backup(planning.exact_model(CLIFF), v, gamma)
        np.testing.assert_allclose(
            bridge.expected_backup(rl.Sarsa(gamma=gamma, behaviour=policy), CLIFF, q), q, rtol=1e-9
        )


# --- that it is the mean of what really happens -------------------------------------------------------


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", [name for _, name in ONE_STEP])
def test_updates_with_real_keys_have_this_mean(name):
    """4000 updates of one pair; within 5 standard errors. So `choose` stands for what is drawn without it."""
    env, (s, a) = ENVS["windy"], (5, 1)  # in the first windy column, to the right
    q, cls = np.random.default_rng(0).normal(size=(env.num_states, env.num_actions)), ALGORITHMS[name]
    more = {"target": Softmax(1.0)} if issubclass(cls, OffPolicyControl) else {}
    method = cls(alpha=1.0, epsilon=0.8, gamma=GAMMA, q0=q, **more)
    start = method.init(env.num_states, env.num_actions)
    pair = jnp.int32(s), jnp.int32(a)

    def target(key):
        env_key, key = jax.random.split(key)
        s_next, reward, terminal = env.step(env_key, *pair)
        t = Transition(*pair, reward, s_next, jnp.where(terminal, 0, GAMMA), terminal)
        after, _ = method.update(key, start, t)
        return (after.q - start.q)[pair]  # half of it where two tables share what is learned

    moved = np.asarray(jax.jit(jax.vmap(target))(jax.random.split(jax.random.key(0), 4000)), np.float64)
    tables_kept = 2 if hasattr(start, "q1") else 1
    want = (bridge.expected_backup(method, env, q)[s, a] - q[s, a]) / tables_kept
    assert moved.std() > 0.1
    assert abs(moved.mean() - want) <= 5 * moved.std() / np.sqrt(4000)


@pytree
class NeverEnds(rl.QLearning):
    """Bootstraps through terminal states."""

    def update(self, key, state, t):
        return super().update(key, state, t._replace(discount=jnp.asarray(self.gamma)))


@pytree
class Twice(rl.Sarsa):
    """Learns from an action of the uniform policy, not from the one that its behaviour would take."""

    def probs(self, state, s):
        return jnp.full(state.q.shape[1], 1 / state.q.shape[1])


@pytest.mark.parametrize(("method", "row"), [(NeverEnds, bridge.TABLE[2]), (Twice, bridge.TABLE[1])])
def test_a_wrong_update_has_another_mean(method, row):
    q = some_q(CLIFF)
    right = method.__mro__[1](epsilon=EPSILON, gamma=GAMMA)
    want = full_backup(row, right, CLIFF, q)
    assert abs(bridge.expected_backup(right, CLIFF, q) - want).max() < 1e-12
    assert abs(bridge.expected_backup(method(epsilon=EPSILON, gamma=GAMMA), CLIFF, q) - want).max() > 0.1


# --- what is refused ---------------------------------------------------------------------------------


@pytree
class OwnDice(TDControl):
    """Draws by itself."""

    def update(self, key, state, t):
        a_next = jax.random.randint(key, (), 0, state.q.shape[1])
        return self.learn(state, t, t.r + t.discount * tables.entry(state.q, t.s_next, a_next)), a_next


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda q: bridge.expected_backup(OwnDice(), CLIFF, q),
            "draws in another way than by policies",
        ),
        (
            lambda q: bridge.expected_backup(rl.Sarsa, CLIFF, q),
            "an instance of a one-step method such as",
        ),
        (
            lambda q: bridge.expected_backup(rl.Sarsa(), CLIFF, q[:2]),
            r"q must have one .* not \(2, 4\)",
        ),
        (
            lambda q: bridge.expected_backup(TD(), CLIFF, q),
            "v must have one value for each of the 8 states",
        ),
        (lambda q: planning.optimality_backup(CLIFF, q.T), "for each of the 8 states and 4 actions, not"),
        (
            lambda q: planning.evaluation_backup(CLIFF, q, np.full((8, 4), 0.25)),
            "each of the 8 states, not",
        ),
        (
            lambda q: planning.expectation_backup(CLIFF, q, q),
            "policy_probs: .* are not a distribution",
        ),
        (lambda q: planning.expectation_backup(CLIFF, q, q, gamma=2), "gamma must be between 0 and 1"),
    ],
)
def test_what_cannot_be_averaged_is_refused(call, message):
    with pytest.raises(rl.InputError, match=message) as error:
        call(some_q(CLIFF))
    assert "\n" not in str(error.value)


def test_drawing_is_as_before_afterwards():
    with pytest.raises(rl.InputError):
        bridge.expected_backup(OwnDice(), CLIFF, some_q(CLIFF))
    assert policies.choose.get() is None


# --- the full backup by itself, and the command ---------------------------------------------------------


@pytest.mark.parametrize(("row", "name"), ONE_STEP)
def test_the_full_backup_of_a_method_is_that_of_its_row(row, name):
    """Broken once: the policy that acts, where the method has a target -> fails."""
    more = {"target": Softmax(0.5)} if issubclass(ALGORITHMS[name], OffPolicyControl) else {}
    method, q = ALGORITHMS[name](epsilon=EPSILON, gamma=GAMMA, **more), some_q(CLIFF)
    assert bridge.row_of(method) is row
    np.testing.assert_allclose(
        bridge.full_backup(method, CLIFF, q), full_backup(row, method, CLIFF, q), atol=1e-12
    )


def test_the_command_shows_both_sides_of_each_equation(capsys):
    assert main(["bridge"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "\n".join(lines) == bridge.table()
    at = lines.index("Bellman optimality equation for q*")
    assert lines[at + 2 : at + 11] == [
        "  full backup (DP): q-value iteration                sample backup (TD): Q-learning",
        "  q(s, a) <- E[R + gamma max_a' q(S', a') | s, a]    Q(S, A) <-alpha- R + gamma max_a' Q(S', a')",
        "",
        "            ●             s, a                           ●       S, A",
        "      ┌─────┴─────┐                                      │",
        "      ○           ○       mean over r, s', by p          ○       R, S'",
        "    ╱ │ ╲       ╱ │ ╲                                  ╱ │ ╲",
        "   ╱╰─┼─╯╲     ╱╰─┼─╯╲                                ╱╰─┼─╯╲",
        "  ●   ●   ●   ●   ●   ●   max over a'                ●   ●   ●   max over a'",
    ]
    assert main(["bridge", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["compared"] is None
    assert [row["sample"]["method"] for row in found["rows"]] == ["TD(0)", "Sarsa", "Q-learning"]
    assert [row["methods"] for row in found["rows"]] == [list(row.methods) for row in bridge.TABLE]


@pytest.mark.slow
def test_the_command_compares_what_a_method_has_learned(capsys, tmp_path):
    """Of two actions one is not there in A; the full backup by hand. Broken once: `there` is all -> fails."""
    command = "bridge maximization-bias expected-sarsa --actions 3 --epsilon 0.5 --gamma 0.5 --steps 50"
    assert main([*command.split(), "--json", "--out", str(tmp_path / "bridge")]) == 0
    numbers = json.loads(capsys.readouterr().out)["compared"]
    q, mean, full = (numbers[name] for name in ("values", "mean_of_samples", "full_backup"))
    assert q[0][2] is mean[0][2] is full[0][2] is None
    b = np.array(q[1])
    left = 0.5 * (0.5 * b.mean() + 0.5 * b.max())  # from A to B, for nothing
    np.testing.assert_allclose(sorted(full[0][:2]), sorted([left, 0]), atol=1e-9)
    np.testing.assert_allclose([mean[0][:2], mean[1][:2]], [full[0][:2], full[1][:2]], atol=1e-12)
    np.testing.assert_allclose(full[1], [-0.1] * 3, atol=1e-9)
    assert numbers["largest_difference"] < 1e-12
    assert {file.name for file in (tmp_path / "bridge").iterdir()} == {"bridge.png", "bridge.svg"}


def test_the_command_says_where_an_update_is_another_one(capsys, tmp_path):
    own = tmp_path / "mine.py"
    own.write_text(
        "import jaxrl_tab as rl\n\n@rl.pytree\nclass Greedy(rl.Sarsa):\n"
        '    """Learns half of the reward."""\n'
        "    def update(self, key, state, t):\n        return super().update(key, state, t._replace(r=t.r / 2))\n"
    )
    sizes = ["--states", "3", "--steps", "5"]
    assert main(["bridge", "random-walk", "expected-sarsa", *sizes]) == 0
    text = capsys.readouterr().out
    assert "π is the policy that acts, or the target where there is one." in text
    assert "The mean of what is sampled is the full backup" in text
    assert main(["bridge", "random-walk", f"{own}:Greedy", *sizes]) == 0
    assert (
        "The mean of what is sampled is not the full backup: the largest difference over all 5 pairs of state and "
        "action is 0.25." in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("typed", "why"),
    [
        (
            "random-walk expected-sarsa --states 3 --alpha 90 --steps 500",
            "after 500 steps expected-sarsa has diverged",
        ),
        ("k-armed-testbed q-learning", "each run has a problem of its own in k-armed-testbed"),
    ],
)
def test_the_command_refuses_what_cannot_be_compared(typed, why, capsys):
    """Broken once, each: not looked at -> "q0 must be a number, not an array"; what was learned elsewhere."""
    assert main(["bridge", *typed.split()]) == 2
    assert why in capsys.readouterr().err
