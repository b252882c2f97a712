"""Off-policy learning, fourth use: learn about many target policies from one stream of experience.

One walker moves at random through a gridworld with a cliff. Each of its steps teaches eleven tables, one for
a policy: the shortest path, but with probability epsilon any move, for epsilon from 0 to 1.
"""

import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import planning

env, gamma = rl.make("cliff-walking"), 0.9
_, q_star = planning.value_iteration(env, gamma)
epsilons = np.linspace(0, 1, 11)
targets = np.array([planning.epsilon_greedy_policy(q_star, epsilon) for epsilon in epsilons])

method = rl.ManyTargets(targets, alpha=0.5, gamma=gamma)  # acts at random unless it is told otherwise
state, _ = rl.train(jax.random.key(0), method, env, num_steps=300_000)

print("discounted value of the start on the cliff, gamma = 0.9; all from the same 300 000 random steps\n")
print(" epsilon   learned     exact")
start = env.start_state
learned = (targets[:, start] * np.asarray(state.q)[:, start]).sum(1)
exact = np.array([planning.evaluate(env, target, gamma)[start] for target in targets])
for row in zip(epsilons, learned, exact, strict=True):
    print("{:8.1f}{:10.3f}{:10.3f}".format(*row))
