"""Exact learning curves, without a single run: what a step size costs in bias, and what in variance.

The random walk of five states (book, example 6.2), V = 1/2 at the beginning. docs/why.md tells what is printed here.
"""

import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import prediction as methods

env = rl.make("random-walk", states=5, left_reward=0.0)

curve = rl.moments.learning_curve(
    env, methods.TD(v0=0.5), num_episodes=100, alpha=[0.02, 0.05, 0.1, 0.2, 0.4]
)
print("TD(0): mean squared error = squared bias + variance")
print("  alpha      after 10 episodes                  after 100 episodes")
for i, alpha in enumerate(curve.grid["alpha"]):
    parts = [
        f"{curve.mse[i, k]:.6f} = {curve.squared_bias[i, k]:.6f} + {curve.variance[i, k]:.6f}"
        for k in (10, 100)
    ]
    print(f"  {alpha:<11g}{parts[0]}     {parts[1]}")

print("The best alpha for 10 episodes, and what it gives")
for name, method in (
    ("TD(0)", methods.TD(v0=0.5)),
    ("2-step TD", methods.NStepTD(n=2, v0=0.5)),
    ("4-step TD", methods.NStepTD(n=4, v0=0.5)),
    ("off-line TD(1/2)", methods.TDLambda(lam=0.5, offline=True, v0=0.5)),
    ("Monte Carlo", methods.MonteCarloPrediction(v0=0.5)),
):
    best = rl.moments.best_alpha(env, method, num_episodes=10)
    print(f"  {name:18}{best.alpha:.4f}  {best.mse:.6f}")

result = rl.sweep(env, methods.TD, {"alpha": 0.1, "v0": 0.5}, num_seeds=20_000, num_episodes=10)
squares = ((result.q[:, curve.states, 0].astype(float) - curve.true_values) ** 2).mean(1)
error = squares.std() / np.sqrt(len(squares))
print("alpha 0.1, 10 episodes: exact, and of 20 000 runs")
print(f"  {curve.mse[2, 10]:.6f}  {squares.mean():.6f} +- {error:.6f}")
