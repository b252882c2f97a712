"""Off-policy methods of several steps, n-step and with traces: against plain loops, and against one another."""

from functools import partial

import pytest
import reference
from marks import slow_but
from test_monte_carlo import ALPHAS, EPSILON, FIXED, GAMMAS, check, played, task_apart
from test_off_policy import eighths

import jaxrl_tab as rl
from jaxrl_tab import schedules
from jaxrl_tab.core.policies import EpsilonGreedy, Table

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
    "retrace": (
        rl.Retrace,
        {"lam": LAM, **OF_TABLE},
        partial(reference.ExpectedTraces, lam=LAM, c=lambda pi, b: min(1, pi / b), target=of_table),
        "visit",
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
QUICK = ["off-policy", "expected, off-policy", "tree backup", "dynamic sigma", "retrace"]


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
