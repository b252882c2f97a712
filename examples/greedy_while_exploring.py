"""Off-policy learning, third use: learn about the greedy policy while exploring.

This is Q-learning: it explores for ever, and still learns what not to explore would be worth. Sarsa learns
about exploring as it does, and so keeps away from the cliff (book, example 6.6).
"""

import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import planning

env = rl.make("cliff-walking")
keys = jax.random.split(jax.random.key(0), 10)

rows = {}
for method in (rl.QLearning(alpha=0.1), rl.Sarsa(alpha=0.1)):
    state, log = jax.vmap(lambda key, m=method: rl.train(key, m, env, num_steps=40_000))(keys)
    late = slice(200, None)  # rows of 100 steps: the second half
    exploring = log.returns[:, late].sum() / log.episodes[:, late].sum()
    greedy = [planning.policy_value(env, planning.greedy_policy(q)) for q in np.asarray(state.q)]
    rows[type(method).__name__] = exploring, np.mean(greedy)
soft, optimal = planning.epsilon_soft(env, 0.1)[1], planning.value_iteration(env)[0]
rows["at best"] = soft[env.start_state], optimal[env.start_state]

print("cliff walking, epsilon 0.1 for ever, 10 seeds\n")
print("             mean return of an        exact value of")
print("             exploring episode    its greedy policy")
for name, (exploring, value) in rows.items():
    print(f"{name:12}{exploring:18.2f}{value:21.2f}")
