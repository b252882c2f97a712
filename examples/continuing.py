"""A task that does not end: what a step earns, learned and exact; and who finds what is far away."""

import jaxrl_tab as rl
from jaxrl_tab import planning

env = rl.make("river-swim", variant="osband")
best, _, policy = planning.relative_value_iteration(env)
print(f"always to swim right is best: {best:.4f} a step")
left = planning.average_reward(env, [[1, 0]] * 6)
print(f"always to swim left:          {left:.4f}")

# Without an end, returns are sums of discounted rewards. Where all values begin as high as they can be, what is not
# known looks good: that is exploration enough. Where they begin at 0, the small reward on the left is all
# that is found.
GAMMA, STEPS = 0.95, 20_000
grid = {"alpha": 0.1, "epsilon": 0.1, "gamma": GAMMA, "q0": [0.0, 1 / (1 - GAMMA)]}
ds = rl.sweep(env, rl.QLearning, grid, num_seeds=20, num_steps=STEPS, log_every=2000).to_xarray()
earned = (ds.rewards / ds.steps).isel(row=-1).mean("seed")
for q0, rate in zip(ds.q0.values, earned.values, strict=True):
    print(f"Q-learning, q0 = {q0:2.0f}, at the end: {rate:.4f}")
soft = 0.9 * policy + 0.1 / 2
print(f"the best policy, if one action in ten is random: {planning.average_reward(env, soft):.4f}")
