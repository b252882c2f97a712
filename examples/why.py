"""Why does Q-learning fall off the cliff? What docs/why.md tells is printed here.

Sarsa and Q-learning, 100 seeds, 20 000 steps each. Where each loses what it earns less than the best policy is no
matter of more runs: the environment is known, so it is worked out, for the policy of each run.
"""

import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import planning

env = rl.make("cliff-walking")
sweeps = [
    rl.sweep(env, method, {"alpha": 0.1}, num_seeds=100, num_steps=20_000)
    for method in (rl.QLearning, rl.Sarsa)
]
explained = {sweep.algorithm: next(iter(sweep.explain().values())) for sweep in sweeps}

for one in explained.values():
    print(f"{one.name}:")
    for sentence in one.sentences:
        print(f"  {sentence}")

# The same for any policy: here one that keeps to the edge, and explores.
v, q = planning.value_iteration(env)
edge = planning.epsilon_greedy_policy(q, 0.1)
visits, regret = planning.occupancy(env, edge), planning.regret_map(env, edge)
lost = planning.start_value(env, v) - planning.policy_value(env, edge)
print("\nThe shortest way, exploring with epsilon 0.1:")
print(
    f"  steps in an episode {visits.sum():.4f}, lost {lost:.10f}, the same state by state {regret.sum():.10f}"
)
beside = np.arange(25, 35)  # the cells above the cliff
print(
    f"  of that {regret[beside].sum() / lost:.1%} beside the cliff, where it is {visits[beside].sum():.2f} steps"
)
