"""Generalized policy iteration, iterate by iterate. What docs/gpi.md tells is printed here."""

import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import planning

cliff, easy21 = rl.make("cliff-walking"), rl.make("easy21")

policy, v, q, history = planning.policy_iteration(cliff, history=True)
print("Cliff walking, policy iteration from the policy that takes any action")
for n, value in enumerate(history.start_value):
    line = f"  policy {n}: {value:9.2f} from the start"
    if n:
        line += f", {history.changed[n]:2} states act otherwise"
        line += f", v changes by {history.least_change[n]:.0f} to {history.largest_change[n]:.0f}"
    print(line)

soft = planning.generalized_policy_iteration(cliff, epsilon=0.1)
print("The same among the policies that explore with epsilon 0.1")
for n, value in enumerate(soft.start_value):
    print(f"  policy {n}: {value:9.2f} from the start")

print("Easy21: the largest |v - v*| after some improvements, by the sweeps of evaluation before each")
for sweeps in (None, 10, 3, 1):
    found = planning.generalized_policy_iteration(easy21, sweeps=sweeps)
    errors = "  ".join(f"{found.error[min(n, len(found.error) - 1)]:.6f}" for n in (0, 1, 2, 3, 6))
    needed = np.argmax(found.error < 1e-9)
    print(f"  {sweeps or 'exact':>5}: {errors}, below 1e-9 after {needed} improvements")

print("Easy21: the way between the lines, distances from v = v_pi and from pi = greedy(v)")
for sweeps in (None, 1):
    way = planning.generalized_policy_iteration(easy21, sweeps=sweeps).zigzag[:5]
    print(f"  {sweeps or 'exact':>5}: " + "  ".join(f"({a:.4f}, {b:.4f})" for a, b in way))

windy = rl.make("windy-gridworld")
up = np.tile([1.0, 0, 0, 0], (windy.num_states, 1))
lost = planning.generalized_policy_iteration(windy, policy=up)
print("The windy gridworld, from the policy that always goes up: states with a finite value")
print(" ", *np.isfinite(lost.v).sum(1))
