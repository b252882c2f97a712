"""Runs that `lanes` compiled give XLA's numbers, to the last bit; and however they are done, the same."""

from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lanes_runs import runs_of
from lanes_tools import assert_same_bits, narrow
from marks import slow_but, slow_but_first

import jaxrl_tab as rl
from jaxrl_tab import Outcome, policies, pytree, schedules, static
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.engine import by_lanes
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.room import signature, traced_program
from jaxrl_tab.envs import ENVS
from jaxrl_tab.envs.base import Finite
from jaxrl_tab.interop import from_gymnasium
from jaxrl_tab.lanes import program
from jaxrl_tab.lanes.kernel import Kernel
from jaxrl_tab.lanes.target import host
from jaxrl_tab.methods import METHODS

pytestmark = pytest.mark.usefixtures("optimised")


@pytree
class Coin(Finite):
    """Somebody's own environment: toss until it shows heads."""

    heads: float = 0.5
    max_steps: int = static(default=100)
    num_states, num_actions = 3, 2

    def initial(self):
        return jnp.array([0.7, 0.3, 0])

    def outcomes(self, s, a):
        over = s == 2
        heads = jnp.asarray(self.heads, float) / (1 + a + s % 2)
        s_next = jnp.where(over, 2, jnp.array([2, 1]))
        return jnp.stack([heads, 1 - heads]), Outcome(
            s_next, jnp.where(over, 0.0, jnp.array([-0.3, -1.1])), s_next == 2
        )


@pytree
class Hasty(rl.Sarsa):
    """Somebody's own method: Sarsa that takes its largest value for a sign."""

    haste: float = 1.0

    def update(self, key, state, tr):
        new, a = super().update(key, state, tr)
        return new._replace(q=jnp.where(new.q.max() > 0, new.q * self.haste, new.q)), a


class Case(NamedTuple):
    env: Any = "windy-gridworld"
    method: Any = "q-learning"
    grid: Any = MappingProxyType({})
    episodes: int | None = None
    exact: bool = False
    record: Any = None


UNEVEN = policies.Table(np.tile(np.array([0.1, 0.2, 0.3, 0.4]), (70, 1)))
TO_NEXT = np.random.default_rng(0).dirichlet(np.full(4, 0.4), (4, 3))
TO_NEXT[3] = [0, 0, 0, 1]
REWARDS = np.random.default_rng(1).normal(size=(4, 3)) * (np.arange(4) < 3)[:, None]
AVERAGE = schedules.sample_average()
SHORT = rl.FiniteHorizon(rl.make("frozen-lake"), 7)
SMALLER = {"alpha": [0.03, 0.1, 0.37]}  # with which learning with four tilings does not diverge
ALPHAS = {"alpha": [0.1, 0.37, 1.0]}  # not dyadic: a number that is rounded otherwise would show

CASES = {
    # each method, and each environment
    "sarsa": Case("windy-gridworld", "sarsa", ALPHAS),
    "q-learning": Case("cliff-walking", "q-learning", ALPHAS),
    "expected-sarsa": Case("trace-gridworld", "expected-sarsa", ALPHAS),
    "monte-carlo": Case("blackjack", "monte-carlo", episodes=20),
    "n-step-sarsa": Case("maze", "n-step-sarsa", ALPHAS | {"n": 3}),
    "n-step-expected-sarsa": Case(
        "maze", "n-step-expected-sarsa", ALPHAS | {"target": policies.EpsilonGreedy(0.05)}
    ),
    "n-step-off-policy-sarsa": Case("cliff-walking", "n-step-off-policy-sarsa", ALPHAS | {"n": 2}),
    "tree-backup": Case("windy-gridworld", "tree-backup", ALPHAS),
    "q-sigma": Case("frozen-lake", "q-sigma", ALPHAS | {"sigma": [0.0, 0.3, 1.0]}),
    "true-online-sarsa-lambda": Case("windy-gridworld", "true-online-sarsa-lambda", ALPHAS),
    "expected-sarsa-lambda": Case(
        "trace-gridworld", "expected-sarsa-lambda", ALPHAS | {"target": policies.EpsilonGreedy(0.05)}
    ),
    "tree-backup-lambda": Case("maze", "tree-backup-lambda", ALPHAS),
    "q-pi-lambda": Case("frozen-lake", "q-pi-lambda", {"lam": [0.0, 0.3, 0.9]}),
    "retrace": Case("frozen-lake", "retrace", {"lam": [0.0, 0.3, 0.9]}),
    "sarsa-lambda": Case("easy21", "sarsa-lambda", {"lam": [0.0, 0.3, 0.9]}),
    "clearing traces": Case("windy-gridworld", "sarsa-lambda", ALPHAS | {"trace": "clearing"}),
    "sarsa-lambda-forward": Case("two-doors", "sarsa-lambda-forward", ALPHAS, episodes=20),
    "one by one": Case("two-doors", "sarsa-lambda-forward", ALPHAS | {"one_by_one": True}, episodes=20),
    "q-lambda": Case("frozen-lake", "q-lambda", ALPHAS),
    "Peng's": Case("frozen-lake", "q-lambda", ALPHAS | {"version": "peng"}),
    "double-q-learning": Case("maximization-bias", "double-q-learning", episodes=20),
    "double-sarsa": Case("cliff-walking", "double-sarsa", ALPHAS),
    "double-expected-sarsa": Case("trace-gridworld", "double-expected-sarsa", ALPHAS),
    "weighted-double-q-learning": Case("k-armed-testbed", "weighted-double-q-learning", ALPHAS),
    "maxmin-q-learning": Case("frozen-lake", "maxmin-q-learning", ALPHAS | {"tables": 3}),
    "hysteretic-q-learning": Case("windy-gridworld", "hysteretic-q-learning", ALPHAS),
    "q-learning-target": Case("k-armed-testbed", "q-learning-target", ALPHAS),
    "dyna-q": Case("blocking-maze", "dyna-q", ALPHAS | {"gamma": 0.95}),
    "r-max": Case("two-doors", "r-max", {"q0": 5.0, "m": [2.0, 3.0], "sweeps": 9}),
    "ucb-q-learning": Case(SHORT, "ucb-q-learning", {"c": [1.0, 0.01]}, episodes=20),
    "ucbvi": Case(SHORT, "ucbvi", {"c": [1.0, 0.01]}, episodes=20),
    "a stationary task": Case(SHORT, "ucbvi", {"c": [1.0, 0.01], "stationary": True}, episodes=20),
    "psrl": Case("frozen-lake", "psrl", {"spread": [0.3, 1.0], "gamma": 0.9, "every": 10.0, "sweeps": 9}),
    "optimistic posterior sampling": Case(
        "chain", "psrl", {"samples": 3, "gamma": 0.9, "every": [7.0, 20.0]}
    ),
    "dyna-q-plus": Case("frozen-lake", "dyna-q-plus", ALPHAS),
    "prioritized-sweeping": Case("shortcut-maze", "prioritized-sweeping", ALPHAS | {"gamma": 0.95}),
    "off-policy-monte-carlo": Case("infinite-variance", "off-policy-monte-carlo", episodes=20),
    "arms that drift": Case(
        "drifting-testbed", "q-learning", {"alpha": [0.1, schedules.Unbiased(0.1)]}, episodes=20
    ),
    "gradient-bandit": Case("k-armed-testbed", "gradient-bandit", ALPHAS, episodes=20),
    "reinforce": Case("two-doors", "reinforce", ALPHAS, episodes=20),
    "groups of states": Case("short-corridor", "actor-critic-lambda", ALPHAS | {"groups": "0,0,0,1"}),
    "reinforce-baseline": Case(
        "random-walk", "reinforce-baseline", ALPHAS | {"alpha_v": AVERAGE}, episodes=8
    ),
    "actor-critic": Case("windy-gridworld", "actor-critic", ALPHAS),
    "actor-critic-lambda": Case("cliff-walking", "actor-critic-lambda", ALPHAS),
    "momentum": Case("two-doors", "actor-critic", ALPHAS | {"optimizer": "sgd(momentum=0.9)"}),
    "r-learning": Case("access-control", "r-learning", ALPHAS),
    "differential-q-learning": Case(
        "access-control", "differential-q-learning", ALPHAS | {"eta": [0.1, 0.37]}
    ),
    "differential-sarsa": Case("access-control", "differential-sarsa", ALPHAS),
    "td": Case("random-walk", "td", ALPHAS, episodes=8),
    "n-step-td": Case("racetrack", "n-step-td", ALPHAS | {"n": 4}),
    "td-lambda": Case("random-walk", "td-lambda", ALPHAS, exact=True),
    "true-online-td-lambda": Case("random-walk", "true-online-td-lambda", ALPHAS),
    "offline-lambda-return": Case("random-walk", "offline-lambda-return", ALPHAS, episodes=8),
    "monte-carlo-prediction": Case("blackjack", "monte-carlo-prediction", episodes=20),
    "n-step-off-policy-td": Case("two-doors", "n-step-off-policy-td", ALPHAS | {"n": 2}, episodes=20),
    "control variates": Case("random-walk", "n-step-off-policy-td", ALPHAS | {"control_variates": True}),
    "off-policy-td": Case("jacks-car-rental", "off-policy-td", ALPHAS | {"gamma": 0.9}),
    "off-policy-monte-carlo-prediction": Case("two-doors", "off-policy-monte-carlo-prediction", episodes=20),
    **{
        name: Case(
            "access-control" if name.startswith("differential") else "mountain-car",  # the one never ends
            name,
            SMALLER | {"features": "tile-coding(4, 4)"},
        )
        for name, cls in rl.approx.CONTROL.items()
        if name != "lspi" and not of_method(cls).left_to_xla
    },
    **{
        name: Case("random-walk", name, SMALLER | {"features": "tile-coding(2, 3)"}, episodes=8)
        for name in rl.approx.OF_STATES
        if name != "lstd"
    },
    "lstd": Case("random-walk", "lstd", {"gamma": 0.9, "features": "tile-coding(2, 3)"}, episodes=8),
    "two tilings": Case(
        "mountain-car", "semi-gradient-n-step-sarsa", SMALLER | {"features": "tile-coding(2, 4)"}
    ),
    "features that are any numbers": Case(
        "random-walk", "semi-gradient-n-step-td", SMALLER | {"features": "fourier(3)"}, episodes=8
    ),
    "least squares of any numbers": Case(
        "random-walk", "lstd", {"gamma": 0.9, "features": "fourier(3)"}, episodes=8
    ),
    "clearing traces of features": Case(
        "mountain-car",
        "semi-gradient-sarsa-lambda",
        SMALLER | {"features": "tile-coding(4, 4)", "trace": "clearing"},
    ),
    "errors of features": Case(
        "random-walk", "semi-gradient-td", ALPHAS | {"features": "aggregation(3)"}, episodes=8, exact=True
    ),
    "lspi": Case(rl.FiniteMDP(TO_NEXT, REWARDS), "lspi", {"gamma": 0.9, "epsilon": 1.0}),
    "long-walk": Case("long-walk", "td", ALPHAS, episodes=4),
    "square-wave": Case(
        "square-wave", "semi-gradient-td", SMALLER | {"features": "tile-coding(2, 5)"}, episodes=20
    ),
    "baird": Case("baird", "off-policy-td", ALPHAS | {"gamma": 0.9}),
    "tsitsiklis-van-roy": Case("tsitsiklis-van-roy", "td", ALPHAS | {"gamma": 0.9}),
    "one task for each run": Case(
        rl.make("garnet", own=True, states=6), "q-learning", ALPHAS | {"gamma": 0.9}
    ),
    **{
        name: Case(name, "q-learning", ALPHAS | {"gamma": 0.9})
        for name in ("river-swim", "chain", "two-loops", "deep-sea", "garnet")
    },
    "a finite horizon": Case(SHORT, "q-learning", ALPHAS, exact=True),
    # policies and schedules
    "greedy": Case("gamblers-problem", "q-learning", {"behaviour": policies.Greedy()}, episodes=20),
    "softmax": Case("recycling-robot", "expected-sarsa", {"behaviour": policies.Softmax(0.3), "gamma": 0.9}),
    "upper confidence bounds": Case("taxi", "q-learning", {"behaviour": policies.UCB(2.0)}),
    "a policy in a table": Case(grid={"behaviour": UNEVEN}),
    "schedules": Case(
        "two-doors", "sarsa", {"alpha": schedules.sample_average(), "epsilon": schedules.glie()}
    ),
    # what is measured at the ends of rows, by XLA
    "exact": Case("cliff-walking", "sarsa", ALPHAS | {"gamma": 0.9}, exact=True),
    "record": Case(
        "two-doors",
        "sarsa",
        ALPHAS,
        record=lambda state: {"largest": state.q.max(), "best": state.q.argmax()},
    ),
    # from elsewhere
    "a table": Case(rl.FiniteMDP(TO_NEXT, REWARDS), "sarsa", ALPHAS),
    "imported": Case("FrozenLake-v1", "q-learning", ALPHAS, episodes=8),
    "somebody's own": Case(Coin(), Hasty, ALPHAS | {"haste": [1.3, 0.7]}, episodes=20),
}


def env_of(case):
    if not isinstance(case.env, str):
        return case.env
    return rl.make(case.env) if case.env in ENVS else from_gymnasium(case.env)


def swept(case, backend, num_seeds=11):
    budget = (
        {"num_steps": 120, "log_every": 60}
        if case.episodes is None
        else {"num_episodes": case.episodes, "log_every": 2}
    )
    return rl.sweep(
        env_of(case),
        case.method,
        case.grid,
        num_seeds=num_seeds,
        exact=case.exact,
        record=case.record,
        backend=backend,
        **budget,
    )


def arrays(result):
    return [np.asarray(x) for x in jax.tree.leaves((result.q, result.log))]


# By which a mistake shows soonest; all others take long to compile.
FIRST = {"sarsa", "monte-carlo", "td", "schedules", "record"}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", slow_but(FIRST, CASES))
def test_lanes_gives_what_xla_gives(name):
    """The tables, and all of the log. Broken once: no product fused -> fails."""
    assert_same_bits(*(arrays(swept(CASES[name], backend)) for backend in ("lanes", "xla")))


def test_each_method_and_each_environment_is_among_them():
    assert {case.method for case in CASES.values()} >= {
        name for name, cls in METHODS.items() if not of_method(cls).left_to_xla
    }
    assert {case.env for case in CASES.values() if isinstance(case.env, str)} >= set(ENVS)


# --- however they are done ---------------------------------------------------------------------------


def done_by(runs, target, lanes):
    """What the kernel for another processor, or for another number of lanes, gives for the runs."""
    arguments = runs.arguments(np.array(0))
    closed = traced_program(runs.budget, signature(arguments)).jaxpr
    leaves = [np.asarray(x, jax.typeof(x).dtype) for x in jax.tree.leaves(arguments[-1])]
    inputs = len(closed.jaxpr.invars) - len(leaves)
    varying = [True] * inputs + [False] * len(leaves)
    results = len(jax.tree.leaves(runs.needs.results))
    made = program.compile(closed, varying, [*[None] * inputs, *leaves], results, lanes=lanes, target=target)
    padded = -(-len(runs) // made.lanes) * made.lanes
    outputs = Kernel(made)(*by_lanes._inputs(runs.arguments(np.arange(padded)), padded))
    return made.lanes, [x[: len(runs)] for x in outputs]


ALONE = [
    "sarsa",
    "monte-carlo",
    "sarsa-lambda",
    "double-q-learning",
    "td",
    "schedules",
    "a policy in a table",
]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", ALONE)
def test_a_run_alone_gives_what_it_gives_among_others(name):
    """Broken once: a turn takes the action of the one before -> fails."""
    case = CASES[name]
    of_one = {key: value[1] if isinstance(value, list) else value for key, value in case.grid.items()}
    budget = Budget(
        None if case.episodes else 120, case.episodes, 50 if case.episodes is None else 2, exact=False
    )
    runs = runs_of(env_of(case), case.method, budget, 5, **of_one)
    (lanes, alone), (_, among_others) = done_by(runs, host(), 1), done_by(runs, narrow(), 5)
    assert lanes == 1
    assert_same_bits(alone, among_others)


def targets():
    """This processor with its vectors, with shorter ones, and with the shortest."""
    of_eight = ",".join(f"-{x[1:]}" if x.startswith("+avx512") else x for x in host().features.split(","))
    return [host(), host()._replace(features=of_eight), narrow()]


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("env", "method", "by"),
    [
        ("windy-gridworld", "n-step-sarsa", {"num_steps": 120}),
        ("trace-gridworld", "expected-sarsa", {"num_steps": 120}),
        pytest.param("blackjack", "monte-carlo", {"num_episodes": 6}, marks=pytest.mark.slow),
    ],
)
def test_the_bits_depend_on_neither_the_vectors_nor_the_block(env, method, by):
    """Nor on the place in it."""
    budget = Budget(**{"num_steps": None, "num_episodes": None} | by, log_every=2, exact=False)
    runs = runs_of(env, method, budget, 37, gamma=0.9, **{} if method == "monte-carlo" else {"alpha": 0.37})
    ways = [(target, lanes) for target in targets() for lanes in (program.MANY, 2)] + [(host(), 1)]
    results = [done_by(runs, *way) for way in ways]
    assert len({lanes for lanes, _ in results}) >= 3  # of one lane, of a vector of each length, of a block
    for _, outputs in results[1:]:
        assert_same_bits(outputs, results[0][1])
    shifted = done_by(replace(runs, numbers=np.roll(runs.numbers, 5)), host(), program.MANY)[1]
    assert_same_bits([np.roll(x, -5, axis=0) for x in shifted], results[0][1])


@pytest.mark.parametrize("case", slow_but_first(["sarsa", "exact", "monte-carlo"]))
def test_a_run_is_what_it_is_among_any_number_of_others(case):
    """1 and 3 are programs of their own, and what XLA does of a row is done for a block at least."""
    result = swept(CASES[case], "lanes", 300)
    many = {n: arrays(swept(CASES[case], "lanes", n)) for n in (1, 3, 17)}
    axis = len(result.grid)
    for n, few in many.items():
        assert_same_bits(few, [x.take(range(n), axis) for x in arrays(result)])
