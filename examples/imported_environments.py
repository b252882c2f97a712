"""Environments of Gymnasium and gymnax: learn here, beside the exact optimum, and play there."""

import gymnasium
import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import planning

EPISODES = 1000
key = jax.random.key(0)
method = rl.QLearning(alpha=rl.schedules.Power(0.7, clock="visit"), epsilon=0.5, gamma=0.99)

# Gymnasium's lake, from its table: probabilities, terminal states and the limit of 100 steps are its own.
lake = rl.interop.from_gymnasium("FrozenLake-v1")
state, _ = rl.train(key, method, lake, num_steps=200_000, log_every=200_000)
policy = planning.greedy_policy(state.q)
optimal, _ = planning.value_iteration(lake, gamma=1.0)

# Exact values know no limit of time: what is not over goes on. With a limit they are as many backups as there are
# steps, from 0 at the end.
in_time = np.zeros(lake.num_states)
for _ in range(lake.max_steps):
    in_time = planning.evaluation_backup(lake, in_time, policy)

# The same policy in Gymnasium itself.
there = gymnasium.make("FrozenLake-v1")
successes = 0
s, _ = there.reset(seed=0)
for _ in range(EPISODES):
    terminated = truncated = False
    while not (terminated or truncated):
        s, reward, terminated, truncated, _ = there.step(int(policy[s].argmax()))
        successes += int(reward == 1)
    s, _ = there.reset()

lake_success = {
    "at best, without a limit": optimal[0],
    "as learned, without a limit": planning.policy_value(lake, policy),
    f"as learned, in {lake.max_steps} steps": in_time[0],
    f"as learned, in {EPISODES} games": successes / EPISODES,
}
print("FrozenLake-v1 of Gymnasium, whose games end after 100 steps: the probability to reach the goal")
for what, value in lake_success.items():
    print(f"  {what:30}{value:8.4f}")

# Catch of gymnax: its states are found by closure, and what it draws is read from its program.
catch = rl.interop.from_gymnax("Catch-bsuite")
state, _ = rl.train(key, method, catch, num_steps=50_000, log_every=50_000)
catch_value = {
    "at best": planning.policy_value(catch, planning.policy_iteration(catch)[0]),
    "as learned": planning.policy_value(catch, planning.greedy_policy(state.q)),
}
print(f"Catch-bsuite of gymnax, which has {catch.num_states} states: what a game is worth")
for what, value in catch_value.items():
    print(f"  {what:30}{value:8.4f}")

# And the other way: the cliff for code that is written for gymnax, and for Gymnasium.
cliff = rl.interop.to_gymnax(rl.make("cliff-walking"))
s, where = cliff.reset(key)
s, where, reward, terminated, truncated, info = cliff.step(key, where, 1)  # right: down the cliff
print(f"the cliff in gymnax: reward {reward:.1f}, and again in state {s}")
cliff = rl.interop.to_gymnasium(rl.make("cliff-walking"))
s, _ = cliff.reset(seed=0)
s, reward, *_ = cliff.step(1)
print(f"the cliff in Gymnasium: reward {reward:.1f}, and again in state {s}")
