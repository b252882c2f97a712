"""A method of your own: what it learns from one transition. Schedules, sweeps and statistics then apply to it.

Sarsa looks at the next action, Expected Sarsa at the average over all of them. One-step Q(sigma) mixes the two (book,
section 7.6): how much does each bit of looking at averages help?
"""

import jax.numpy as jnp

import jaxrl_tab as rl
from jaxrl_tab import pytree, stats, tables
from jaxrl_tab.algorithms import TDControl


@pytree
class QSigma(TDControl):  # has alpha, epsilon, gamma, q0, behaviour, and all but the update
    """Sarsa where sigma is 1, Expected Sarsa where it is 0."""

    sigma: float = 0.5

    backup = rl.backups.Backup(
        {"σ": "action, state, action", "1 − σ": "action, state, each action"}
    )  # its diagram

    def update(self, key, state, t):
        state = self.begin(state, t)  # counts the step
        a_next = self.policy(key, state, t.s_next)
        row = tables.row(state.q, t.s_next)
        expected = jnp.dot(self.probs(state, t.s_next), row)
        q_next = self.sigma * row[a_next] + (1 - self.sigma) * expected
        delta = t.r + t.discount * q_next - tables.entry(state.q, t.s, t.a)
        return self.learn(state, t, delta), a_next  # Q(S, A) <- Q(S, A) + alpha delta; the action to take


if __name__ == "__main__":  # so that an experiment can name it: examples/my_method.py:QSigma
    env = rl.make("windy-gridworld")
    sigmas = [0.0, 0.25, 0.5, 0.75, 1.0]
    grid = {"sigma": sigmas, "alpha": 0.8}
    ds = rl.sweep(env, QSigma, grid, num_seeds=50, num_steps=8000).to_xarray()
    mean, low, high, _ = stats.mean_interval(stats.score(ds))
    print("windy gridworld, 8000 steps, 50 seeds, alpha 0.8: mean return at the end; at best -15\n")
    for i, sigma in enumerate(sigmas):
        print(f"  sigma {sigma:4.2f}: {mean[i]:7.2f}   ({low[i]:.2f} to {high[i]:.2f})")
