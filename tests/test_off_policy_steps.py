"""Off-policy methods of several steps, n-step and with traces: against plain loops, and against one another."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from marks import slow_but, slow_but_first
from test_monte_carlo import ALPHAS, EPSILON, FIXED, GAMMAS, check, played, task_apart
from test_off_policy import eighths
from test_reference import random_mdp

import jaxrl_tab as rl
from jaxrl_tab import schedules
from jaxrl_tab.core.policies import EpsilonGreedy, Greedy, Table
from jaxrl_tab.core.types import Transition

N, LAM = 3, 0.75
greedy = lambda row, s: reference.soft(row, 0)
softer = lambda row, s: reference.soft(row, 0.5)
TABLE = eighths(5, 3)
SOFTER, OF_TABLE = {"target": EpsilonGreedy(0.5)}, {"target": Table(TABLE)}
of_table = lambda row, s: TABLE[s]

DYNAMIC = schedules.Exponential(1.0, 0.75, clock="episode")
# The method with its own fields; its plain loop; and alpha.
KINDS = {
    "off-policy": (
        rl.NStepOffPolicySarsa,
        {"n": N, **SOFTER},
        partial(reference.NStepOffPolicy, n=N, expected=False, target=softer),
        "visit",
    ),
    "off-policy, greedy": (
        rl.NStepOffPolicySarsa,
        {"n": N},
        partial(reference.NStepOffPolicy, n=N, expected=False, target=greedy),
        "constant",
    ),
    "expected": (
        rl.NStepExpectedSarsa,
        {"n": N},
        partial(reference.NStepOffPolicy, n=N, expected=True),
        "visit",
    ),
    "expected, off-policy": (
        rl.NStepExpectedSarsa,
        {"n": N, **OF_TABLE},
        partial(reference.NStepOffPolicy, n=N, expected=True, target=of_table),
        "constant",
    ),
    "tree backup": (
        rl.TreeBackup,
        {"n": N, **SOFTER},
        partial(reference.Branching, n=N, target=softer),
        "visit",
    ),
    "tree backup, greedy": (
        rl.TreeBackup,
        {"n": N},
        partial(reference.Branching, n=N, target=greedy),
        "constant",
    ),
    "dynamic sigma": (
        rl.QSigma,
        {"n": N, "sigma": DYNAMIC},
        partial(reference.Branching, n=N, sigma=lambda t, k: 0.75 ** (k - 1)),
        "constant",
    ),
    "sigma, off-policy": (
        rl.QSigma,
        {"n": N, "sigma": 0.75, **OF_TABLE},
        partial(reference.Branching, n=N, sigma=lambda t, k: 0.75, target=of_table),
        "visit",
    ),
    "sigma, as drawn": (
        rl.QSigma,
        {"n": N, "sigma": 0.25, "control_variates": False, **SOFTER},
        partial(reference.Branching, n=N, sigma=lambda t, k: 0.25, control_variates=False, target=softer),
        "constant",
    ),
    "retrace": (
        rl.Retrace,
        {"lam": LAM, **OF_TABLE},
        partial(reference.ExpectedTraces, lam=LAM, c=lambda pi, b: min(1, pi / b), target=of_table),
        "visit",
    ),
    "off-policy corrections": (
        rl.QPiLambda,
        {"lam": LAM, **SOFTER},
        partial(reference.ExpectedTraces, lam=LAM, c=lambda pi, b: 1, target=softer),
        "constant",
    ),
    "tree-backup traces": (
        rl.TreeBackupLambda,
        {"lam": LAM, "trace": "replacing", **SOFTER},
        partial(reference.ExpectedTraces, lam=LAM, trace="replacing", c=lambda pi, b: pi, target=softer),
        "constant",
    ),
    "expected traces": (
        rl.ExpectedSarsaLambda,
        {"lam": LAM},
        partial(reference.ExpectedTraces, lam=LAM, c=lambda pi, b: 1),
        "visit",
    ),
    "expected traces, off-policy": (
        rl.ExpectedSarsaLambda,
        {"lam": LAM, **SOFTER},
        partial(reference.ExpectedTraces, lam=LAM, c=lambda pi, b: pi / b, target=softer),
        "constant",
    ),
}
QUICK = ["off-policy", "dynamic sigma", "retrace"]


@pytest.mark.parametrize("kind", slow_but(QUICK, KINDS))
def test_every_step_agrees_with_the_plain_loop(kind):
    """In float64. Broken once -> each fails: the ratio of its own action on an error; that of the last action left out,
    or after a terminal state; pi or b of another moment; sigma of the next episode; no mean after a time limit; the
    tail by the Q of before it; traces by the ratio of the next action, or that outlive the episode.
    """
    cls, fields, plain, rate = KINDS[kind]
    (env, task), (alpha, plain_alpha) = task_apart("random mdp"), ALPHAS[rate]
    method = lambda gamma: cls(alpha=alpha, epsilon=EPSILON, gamma=gamma, q0=0.5, **fields)
    (state, log), words = played(env, method)
    for i, gamma in enumerate(GAMMAS):
        rates = reference.Rates(plain_alpha, FIXED(EPSILON))
        agent = plain((env.num_states, env.num_actions), rates, gamma, 0.5)
        check(agent, task, words, state, log, i, tolerance=1e-8)


# --- against one another -----------------------------------------------------------------------------


def q_of(method):
    with jax.enable_x64():
        run = jax.jit(lambda key: rl.train(key, method, random_mdp(), num_steps=400, log_every=400)[0].q)
        return run(jax.random.key(5))


SAME = {
    "one step of tree backup": (rl.TreeBackup(n=1), rl.QLearning()),
    "sigma 0": (rl.QSigma(n=3, sigma=0.0, target=Greedy()), rl.TreeBackup(n=3)),
    "one expected step": (rl.NStepExpectedSarsa(n=1), rl.ExpectedSarsa()),
    "one step, any sigma": (rl.QSigma(n=1), rl.ExpectedSarsa()),
    "on-policy": (rl.Retrace(target=EpsilonGreedy(0.1)), rl.ExpectedSarsaLambda()),
    "on-policy, corrected": (rl.QPiLambda(target=EpsilonGreedy(0.1)), rl.ExpectedSarsaLambda()),
    "lambda 0": (rl.TreeBackupLambda(lam=0.0), rl.QLearning()),
    "another name": (rl.TrueOnlineSarsaLambda(), rl.SarsaLambda(trace="dutch")),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", slow_but_first(SAME))
def test_at_the_ends_of_the_scale_they_are_others(name):
    one, other = map(q_of, SAME[name])
    np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.slow
def test_ratios_undo_what_the_behaviour_does():
    """Two states in a row, two actions: the mean over what b does of the first update is that under pi.

    (S_0, A_0) leads to S_1, where A_1 pays 1 or 3 and ends; from Q = 0 and with alpha = 1 the mean of what Q(S_0, A_0)
    becomes is v_pi(S_1) = 1 pi(0) + 3 pi(1), by importance sampling in both its forms and by a tree backup with the
    values of S_1 known.
    """
    pi, b = np.array([0.25, 0.75]), np.array([0.5, 0.5])
    tables = {"target": Table(np.tile(pi, (3, 1))), "behaviour": Table(np.tile(b, (3, 1)))}

    @jax.jit
    @jax.vmap
    def first(a, method):
        state, _ = method.update(jax.random.key(0), method.init(3, 2), transition(0, 0, 0.0, 1))
        return method.update(jax.random.key(0), state, transition(1, a, 1.0 + 2 * a, 2, over=True))[0].q[0, 0]

    mean = lambda method: b @ first(jnp.arange(2), jax.tree.map(lambda x: jnp.stack([x, x]), method))
    assert mean(rl.NStepExpectedSarsa(n=2, alpha=1.0, **tables)) == 2.5
    assert mean(rl.QSigma(n=2, alpha=1.0, sigma=1.0, **tables)) == 2.5
    assert mean(rl.QSigma(n=2, alpha=1.0, sigma=0.0, **tables)) == 0.5 * (0.25 * 1 + 0.75 * 3)  # others are 0
    known = np.array([[0.0, 0.0], [1.0, 3.0], [0.0, 0.0]])
    assert mean(rl.TreeBackup(n=2, alpha=1.0, q0=known, **tables)) == 2.5


def transition(s, a, r, s_next, over=False):
    return Transition(*map(jnp.asarray, (s, a, r, s_next, 0.0 if over else 1.0, over)))


@pytest.mark.parametrize(
    "cls", [rl.NStepOffPolicySarsa, rl.QSigma, rl.NStepExpectedSarsa, rl.ExpectedSarsaLambda]
)
def test_a_behaviour_that_leaves_out_what_the_target_takes_is_refused(cls):
    with pytest.raises(
        rl.InputError, match=f"{cls.__name__}: behaviour leaves out actions that target can take"
    ):
        cls(target=EpsilonGreedy(0.1), behaviour=Greedy())
    cls(behaviour=Greedy(), target=Greedy())
