"""Off-policy learning, second use: learn again from the experience of old policies.

Q-learning walks the windy gridworld for 4000 steps. Q changed all the time, so every step was chosen by
another policy; off-policy methods may learn from all of them again, without a further step.
"""

import jax
import numpy as np

import jaxrl_tab as rl

env = rl.make("windy-gridworld")
sizes = env.num_states, env.num_actions
method = rl.QLearning(alpha=0.5)
num_steps, times = 4000, (1, 3, 10)
_, q_star = rl.planning.value_iteration(env)


def errors(key):
    """The mean |Q - Q*| of the pairs that were met, after the run and after each number of replays."""
    memory = rl.collect(key, method, env, num_steps)
    run = rl.learn(key, method, memory, *sizes)
    replays = (rl.replay(key, method, memory, *sizes, num_updates=n * num_steps) for n in times)
    return [abs(learner.q - q_star)[memory.s, memory.a].mean() for learner in (run, *replays)]


error = np.mean(jax.vmap(errors)(jax.random.split(jax.random.key(0), 8)), axis=1)
print("windy gridworld, 4000 steps, 8 seeds: mean |Q - Q*| of all pairs that were met\n")
print(f"  as it learned on the way             {error[0]:6.2f}")
for n, x in zip(times, error[1:], strict=True):
    print(f"  from {n * num_steps:6d} transitions drawn anew   {x:6.2f}")
