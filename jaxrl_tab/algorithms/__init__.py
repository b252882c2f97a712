"""The control methods, one file each. To add one: write its file, and add its line to CONTROL.

CONTROL holds those that can be made from their name alone; `ManyTargets` needs its policies, and so is a
class only.
"""

from jaxrl_tab.algorithms.actor_critic import ActorCritic, ActorCriticLambda
from jaxrl_tab.algorithms.average_reward import AverageReward
from jaxrl_tab.algorithms.control import TDState, ValueControl
from jaxrl_tab.algorithms.differential_q_learning import DifferentialQLearning
from jaxrl_tab.algorithms.differential_sarsa import DifferentialSarsa
from jaxrl_tab.algorithms.double_expected_sarsa import DoubleExpectedSarsa
from jaxrl_tab.algorithms.double_q_learning import DoubleQLearning
from jaxrl_tab.algorithms.double_sarsa import DoubleSarsa
from jaxrl_tab.algorithms.dyna_q import DynaQ, DynaQPlus
from jaxrl_tab.algorithms.expected_sarsa import ExpectedSarsa
from jaxrl_tab.algorithms.expected_sarsa_lambda import ExpectedSarsaLambda
from jaxrl_tab.algorithms.gradient_bandit import GradientBandit
from jaxrl_tab.algorithms.hysteretic_q_learning import HystereticQLearning
from jaxrl_tab.algorithms.many_targets import ManyTargets
from jaxrl_tab.algorithms.maxmin_q_learning import MaxminQLearning
from jaxrl_tab.algorithms.monte_carlo import MonteCarlo
from jaxrl_tab.algorithms.n_step_expected_sarsa import NStepExpectedSarsa
from jaxrl_tab.algorithms.n_step_off_policy_sarsa import NStepOffPolicySarsa
from jaxrl_tab.algorithms.n_step_sarsa import NStepSarsa
from jaxrl_tab.algorithms.off_policy_monte_carlo import OffPolicyMonteCarlo
from jaxrl_tab.algorithms.policy_gradient import PolicyGradient
from jaxrl_tab.algorithms.prioritized_sweeping import PrioritizedSweeping
from jaxrl_tab.algorithms.psrl import PSRL
from jaxrl_tab.algorithms.q_lambda import QLambda
from jaxrl_tab.algorithms.q_learning import QLearning
from jaxrl_tab.algorithms.q_pi_lambda import QPiLambda
from jaxrl_tab.algorithms.q_sigma import QSigma
from jaxrl_tab.algorithms.r_learning import RLearning
from jaxrl_tab.algorithms.r_max import RMax
from jaxrl_tab.algorithms.reinforce import Reinforce, ReinforceBaseline
from jaxrl_tab.algorithms.retrace import Retrace
from jaxrl_tab.algorithms.sarsa import Sarsa
from jaxrl_tab.algorithms.sarsa_lambda import SarsaLambda
from jaxrl_tab.algorithms.sarsa_lambda_forward import SarsaLambdaForward
from jaxrl_tab.algorithms.target_q_learning import TargetQLearning
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.algorithms.tree_backup import TreeBackup
from jaxrl_tab.algorithms.tree_backup_lambda import TreeBackupLambda
from jaxrl_tab.algorithms.true_online_sarsa_lambda import TrueOnlineSarsaLambda
from jaxrl_tab.algorithms.ucb_q_learning import UCBQLearning
from jaxrl_tab.algorithms.ucbvi import UCBVI
from jaxrl_tab.algorithms.weighted_double_q_learning import WeightedDoubleQLearning

CONTROL: dict[str, type] = {
    "sarsa": Sarsa,
    "q-learning": QLearning,
    "expected-sarsa": ExpectedSarsa,
    "monte-carlo": MonteCarlo,
    "n-step-sarsa": NStepSarsa,
    "n-step-expected-sarsa": NStepExpectedSarsa,
    "n-step-off-policy-sarsa": NStepOffPolicySarsa,
    "tree-backup": TreeBackup,
    "q-sigma": QSigma,
    "sarsa-lambda": SarsaLambda,
    "true-online-sarsa-lambda": TrueOnlineSarsaLambda,
    "sarsa-lambda-forward": SarsaLambdaForward,
    "expected-sarsa-lambda": ExpectedSarsaLambda,
    "q-lambda": QLambda,
    "tree-backup-lambda": TreeBackupLambda,
    "retrace": Retrace,
    "q-pi-lambda": QPiLambda,
    "double-q-learning": DoubleQLearning,
    "double-sarsa": DoubleSarsa,
    "double-expected-sarsa": DoubleExpectedSarsa,
    "weighted-double-q-learning": WeightedDoubleQLearning,
    "maxmin-q-learning": MaxminQLearning,
    "hysteretic-q-learning": HystereticQLearning,
    "q-learning-target": TargetQLearning,
    "off-policy-monte-carlo": OffPolicyMonteCarlo,
    "gradient-bandit": GradientBandit,
    "reinforce": Reinforce,
    "reinforce-baseline": ReinforceBaseline,
    "actor-critic": ActorCritic,
    "actor-critic-lambda": ActorCriticLambda,
    "r-learning": RLearning,
    "differential-q-learning": DifferentialQLearning,
    "differential-sarsa": DifferentialSarsa,
    "dyna-q": DynaQ,
    "dyna-q-plus": DynaQPlus,
    "prioritized-sweeping": PrioritizedSweeping,
    "r-max": RMax,
    "ucb-q-learning": UCBQLearning,
    "ucbvi": UCBVI,
    "psrl": PSRL,
}

__all__ = [
    "CONTROL",
    "PSRL",
    "UCBVI",
    "ActorCritic",
    "ActorCriticLambda",
    "AverageReward",
    "DifferentialQLearning",
    "DifferentialSarsa",
    "DoubleExpectedSarsa",
    "DoubleQLearning",
    "DoubleSarsa",
    "DynaQ",
    "DynaQPlus",
    "ExpectedSarsa",
    "ExpectedSarsaLambda",
    "GradientBandit",
    "HystereticQLearning",
    "ManyTargets",
    "MaxminQLearning",
    "MonteCarlo",
    "NStepExpectedSarsa",
    "NStepOffPolicySarsa",
    "NStepSarsa",
    "OffPolicyMonteCarlo",
    "PolicyGradient",
    "PrioritizedSweeping",
    "QLambda",
    "QLearning",
    "QPiLambda",
    "QSigma",
    "RLearning",
    "RMax",
    "Reinforce",
    "ReinforceBaseline",
    "Retrace",
    "Sarsa",
    "SarsaLambda",
    "SarsaLambdaForward",
    "TDControl",
    "TDState",
    "TargetQLearning",
    "TreeBackup",
    "TreeBackupLambda",
    "TrueOnlineSarsaLambda",
    "UCBQLearning",
    "ValueControl",
    "WeightedDoubleQLearning",
]
