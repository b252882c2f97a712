"""How long runs usually take, from what they are: the measure of `speeds`, and all there is before any was run here.

The numbers were measured on one core of an AMD EPYC (Zen 5), in 2026, each method in several environments, and are
right within a factor of two. That is the same for all cores and machines of our days, by and large.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.algorithms import prediction
from jaxrl_tab.algorithms.double_q_learning import DoubleQLearning
from jaxrl_tab.algorithms.dyna_q import DynaQ
from jaxrl_tab.algorithms.n_step import Branching, NStepControl
from jaxrl_tab.algorithms.prioritized_sweeping import PrioritizedSweeping
from jaxrl_tab.algorithms.psrl import PSRL
from jaxrl_tab.algorithms.r_max import RMax
from jaxrl_tab.algorithms.sarsa_lambda_forward import SarsaLambdaForward
from jaxrl_tab.algorithms.traces import TraceControl
from jaxrl_tab.algorithms.ucbvi import UCBVI
from jaxrl_tab.algorithms.whole_returns import WholeReturns
from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import FiniteEnvironment
from jaxrl_tab.engine import backend
from jaxrl_tab.engine.part import Part
from jaxrl_tab.envs.finite_horizon import FiniteHorizon
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.model import Model

# Nanoseconds of a step by `lanes`, and for each entry of the table in a step. The first that fits counts.
WHOLE = (WholeReturns, prediction.MonteCarloPrediction, prediction.OffPolicyMonteCarloPrediction)
METHODS: list[tuple[tuple[type, ...], float, float]] = [
    (WHOLE, 18, 0),
    ((SarsaLambdaForward, prediction.OfflineLambdaReturn), 22, 0),
    ((TraceControl, prediction.TDLambda), 8, 0.1),
    ((Branching,), 20, 0),
    ((NStepControl, prediction.NStepTD), 13, 0),
    ((DoubleQLearning,), 9, 0),
    ((DynaQ,), 60, 0),
    ((RMax,), 30, 0),
    ((UCBVI,), 60, 0),
    ((PSRL,), 30, 0),
    ((PrioritizedSweeping,), 30, 4),
    ((object,), 6, 0),
]
# Nanoseconds of a number of a model that PSRL draws and solves in 100 sweeps: in all runs of a vector at once, or in
# one of them, at the end of its episode, while the others wait.
TOGETHER, ALONE = 30.0, 150.0
LARGE, LARGEST = 0.002, 12.0  # nanoseconds more for each entry, as a large table is further away; and at most
BY_XLA = 5  # times as long as by `lanes`
ROW = 60  # nanoseconds of a row of the log
COMPILING = {"lanes": 0.3, "xla": 1.5}  # seconds of a program
STARTING = {"lanes": 0.01, "xla": 0.4}  # the same, where it was made before
# More seconds, where exact values are recorded.
EXACT = {Learns.ACTIONS: 4.5, Learns.PREFERENCES: 4.5, Learns.STATES: 1.5}
KEPT = 0.06  # of these, where it was made before
EPISODE_STEPS = 100.0  # of an episode of which nothing is known
LEARNING = 5.0  # so many steps, over the step size, for each entry of a table until it is learned, about
SWEEPS, OUTCOMES = 300, 10**5  # steps that the length of an episode is followed, and outcomes for which it is


class Typical(NamedTuple):
    """How long something usually takes.

    Attributes:
        running: seconds of one core for a run.
        compiling: seconds for a program that is made.
        starting: seconds for a program that was made before.
    """

    running: float
    compiling: float
    starting: float


def typical(part: Part) -> Typical:
    """How long the runs of a part usually take on a CPU."""
    by, learns, budget = backend.chosen(), of_method(part.configs[0]).learns, part.budget
    states, entries = part.env.num_states, part.env.num_states * part.env.num_actions
    each, of_entry = next(x for kinds, *x in METHODS if issubclass(part.algorithm, kinds))
    step = each + of_entry * entries + min(LARGE * entries, LARGEST)
    if issubclass(part.algorithm, PSRL):
        step += float(np.mean([_drawing(part, config) for config in part.configs]))
    steps = budget.num_steps or (budget.num_episodes or 0) * episode_steps(part)
    rows = -(-(budget.num_steps or budget.num_episodes or 0) // budget.row)
    row, compiling, starting = float(ROW), COMPILING[by], STARTING[by]
    if budget.exact:
        # A system of equations for each policy that is judged; an error of prediction is a sum.
        solving = 0.01 * states**3 + 12.5 * states**2 + 370 * states
        row += 2 * solving / budget.exact_row if learns is not Learns.STATES else 130 * states
        compiling, starting = compiling + EXACT[learns], starting + KEPT * EXACT[learns]
    of_steps = steps * step * (BY_XLA if by == "xla" else 1)
    return Typical(1e-9 * (of_steps + rows * row), compiling, starting)


def _drawing(part: Part, config: Any) -> float:
    """Nanoseconds of a step in which models are drawn and solved, on average over the steps."""
    states, in_turn = part.env.num_states, isinstance(part.env, FiniteHorizon)
    numbers = states**2 * part.env.num_actions * config.samples * config.sweeps / 100
    return numbers * (TOGETHER / config.every + (TOGETHER if in_turn else ALONE) / episode_steps(part))


@functools.lru_cache(maxsize=16)
def episode_steps(part: Part) -> float:
    """How many steps an episode has on average over a run whose budget are episodes, about.

    At first a learner goes to and fro, as the policy does in which all actions are equally likely, and prediction
    goes on like that; then it comes to act as the best policy does that explores a little.
    """
    env: Any = part.env
    if not isinstance(env, FiniteEnvironment) or of_environment(env).instance is not None:
        return EPISODE_STEPS
    model = planning.exact_model(env)
    if model.prob.size > OUTCOMES:
        return EPISODE_STEPS
    actions = np.ones(model.prob.shape[:2]) if model.available is None else np.asarray(model.available, float)
    at_first = _steps(model, actions / actions.sum(-1, keepdims=True), env.max_steps)
    if of_method(part.configs[0]).learns is Learns.STATES:
        return at_first
    try:
        best = np.asarray(planning.epsilon_soft(env, 0.1, part.configs[0].gamma)[0])
    except (InputError, TypeError):  # no finite answer, or no such discount
        return at_first
    in_the_end = _steps(model, best, env.max_steps)
    if issubclass(part.algorithm, WHOLE):  # which learns nothing before an episode is over
        return min(at_first, in_the_end + 0.4 * at_first)
    alphas = [
        x if isinstance(x := getattr(config, "alpha", None), float | int) else 0.1 for config in part.configs
    ]
    until_learned = LEARNING * model.prob[..., 0].size * float(np.mean(1 / np.array(alphas)))
    return min(at_first, in_the_end + until_learned / (part.budget.num_episodes or 1))


def _steps(model: Model, probs: np.ndarray, most: int) -> float:
    """The expected length of an episode of a policy, [S, A], of at most so many steps."""
    weight = probs[:, :, None] * model.prob * ~model.terminal
    there, total, before = model.start, 0.0, 1.0
    for _ in range(min(SWEEPS, most)):
        before = float(there.sum())
        total += before
        there = np.bincount(model.s_next.ravel(), (there[:, None, None] * weight).ravel(), len(there))
        if not there.sum() > 1e-6:
            return total
    left = float(there.sum())
    rate = left / before  # from now on so many of those that are left go on with each step
    return min(total + left / max(1 - rate, 1 / most), most)
