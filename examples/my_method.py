"""A method of your own: what it learns from one transition. Schedules, sweeps and statistics then apply to it.

Hysteretic Q-learning (Matignon et al. 2007, IROS) believes good news faster than bad news: where delta is negative the
step is smaller, by a factor `caution`. With caution 1 it is Q-learning.
"""

import jax.numpy as jnp

import jaxrl_tab as rl
from jaxrl_tab import policies, stats, tables
from jaxrl_tab.algorithms.td import TDControl
from jaxrl_tab.types import pytree


@pytree
class HystereticQLearning(TDControl):  # alpha, epsilon, gamma, q0, behaviour
    """Q-learning that learns less from what disappoints."""

    caution: float = 0.5

    def update(self, key, state, t):
        state = self.begin(state, t)  # counts the step
        q_next = policies.largest(tables.row(state.q, t.s_next))
        delta = t.r + t.discount * q_next - tables.entry(state.q, t.s, t.a)
        state = self.learn(state, t, jnp.where(delta < 0, self.caution * delta, delta))
        return state, self.policy(key, state, t.s_next)  # the action to take there


grid = {"caution": [0.1, 0.3, 1.0], "alpha": 0.5}
scores = {}
print("mean return of an episode at the end, 50 seeds, 8000 steps\n")
for name, env in {
    "no chance in it": rl.make("windy-gridworld"),
    "gusts of wind": rl.make("windy-gridworld", moves="king", stochastic=True),
}.items():
    ds = rl.sweep(env, HystereticQLearning, grid, num_seeds=50, num_steps=8000).to_xarray()
    scores[name] = mean, low, high, _ = stats.mean_interval(stats.score(ds))
    for i, caution in enumerate(grid["caution"]):
        print(f"  {name:16} caution {caution:g}: {mean[i]:7.2f} ({low[i]:.2f} to {high[i]:.2f})")
