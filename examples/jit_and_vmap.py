"""`train` is a pure function of a key, a method and an environment: `jit`, `vmap` and the rest of JAX apply.

A method is a frozen dataclass whose numbers are leaves, and so is an environment: both may be batched.
"""

import jax
import jax.numpy as jnp

import jaxrl_tab as rl

env = rl.make("cliff-walking")


@jax.jit
def mean_return(key, method, env):
    """Of the episodes 401 to 500 of one run."""
    _, log = rl.train(key, method, env, num_episodes=500)
    return log.returns[400:].mean()


one = mean_return(jax.random.key(0), rl.Sarsa(alpha=0.5), env)
print(f"Sarsa on the cliff, mean return of episodes 401 to 500: one run {one:.2f}")

# A hundred seeds: the key has a batch axis.
keys = jax.random.split(jax.random.key(0), 100)
runs = jax.vmap(mean_return, (0, None, None))(keys, rl.Sarsa(alpha=0.5), env)
print(f"  mean of 100 runs {runs.mean():.2f}, standard deviation {runs.std(ddof=1):.2f}\n")

# Hyperparameters: a batch of methods is one method with arrays in it.
epsilons = jnp.array([0.01, 0.05, 0.1, 0.2])
methods = jax.vmap(lambda epsilon: rl.QLearning(alpha=0.5, epsilon=epsilon))(epsilons)
both = jax.vmap(jax.vmap(mean_return, (0, None, None)), (None, 0, None))(
    keys, methods, env
)  # [epsilons, seeds]
means = both.mean(1)
for epsilon, mean in zip(epsilons, means, strict=True):
    print(f"  Q-learning, epsilon {epsilon:4.2f}: {mean:7.2f}")
