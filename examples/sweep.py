"""A sweep from Python: which step size is best, how sure is that, and how far is it from the optimum?

One call runs every step size with every seed. Nothing is averaged in it: what comes back is an xarray
dataset with a number for each seed, and `stats` makes means with intervals of them.
"""

import jaxrl_tab as rl
from jaxrl_tab import stats

rl.use_all_cores()  # one JAX device per core; before anything is computed
env = rl.make("windy-gridworld")
grid = {"alpha": [0.1, 0.2, 0.4, 0.8], "epsilon": 0.1}  # what is not named keeps its default

datasets = {
    method: rl.sweep(env, method, grid, num_seeds=50, num_steps=8000).to_xarray()
    for method in ("sarsa", "expected-sarsa")
}
scores = {method: stats.score(ds) for method, ds in datasets.items()}  # [alpha, seed]
optimum = float(stats.optimum(datasets["sarsa"]))
print(f"windy gridworld, 8000 steps, 50 seeds: mean return of an episode at the end; at best {optimum:g}\n")
for method, score in scores.items():
    mean, low, high, _ = stats.mean_interval(score)
    for i, alpha in enumerate(grid["alpha"]):
        print(f"  {method:15} alpha {alpha}: {mean[i]:8.2f}   ({low[i]:.2f} to {high[i]:.2f})")

# Seed i has the same random numbers in every sweep, so methods are compared seed by seed.
one, other = (score.sel(stats.best(datasets[method])) for method, score in scores.items())
gain = stats.paired_difference(other, one).interval
print(f"\nat its best step size Expected Sarsa is better than Sarsa by {gain.estimate:.2f}")
print(f"(95% interval {gain.low:.2f} to {gain.high:.2f})")
