"""A sweep from Python: which step size is best, how sure is that, and how far is it from the optimum?

One call runs every step size with every seed. Nothing is averaged in it: what comes back is an xarray
dataset with a number for each seed, and `stats` makes means with intervals of them.
"""

import jaxrl_tab as rl
from jaxrl_tab import stats

env = rl.make("windy-gridworld")
grid = {"alpha": [0.1, 0.3, 0.5, 0.7, 0.9, 1.0], "epsilon": 0.1}  # what is not named keeps its default

datasets = {
    method: rl.sweep(env, method, grid, num_seeds=50, num_steps=8000).to_xarray()
    for method in ("sarsa", "expected-sarsa")
}
optimum = float(stats.optimum(datasets["sarsa"]))
print(f"windy gridworld, 8000 steps, 50 seeds: mean return of an episode at the end; at best {optimum:g}\n")
for method, ds in datasets.items():
    mean, low, high, _ = stats.mean_interval(stats.score(ds))  # of [alpha, seed], over seeds
    for i, alpha in enumerate(grid["alpha"]):
        print(f"  {method:15} alpha {alpha}: {mean[i]:8.2f}   ({low[i]:.2f} to {high[i]:.2f})")

# The best step size of each was chosen for its luck on these seeds, too. So the two are compared on fresh ones,
# of another root; on many, for now and then a run of Sarsa is very bad. Seed i has the same random numbers in
# every sweep, so they are compared seed by seed.
best = {method: stats.best(ds) for method, ds in datasets.items()}
fresh = {
    method: stats.score(
        rl.sweep(env, method, grid | chosen, num_seeds=400, num_steps=8000, seed=1).to_xarray()
    )
    for method, chosen in best.items()
}
gain = stats.paired_difference(fresh["expected-sarsa"], fresh["sarsa"]).interval
print(f"\non fresh seeds Expected Sarsa with alpha {best['expected-sarsa']['alpha']} is better")
print(f"than Sarsa with alpha {best['sarsa']['alpha']} by {gain.estimate:.2f}", end=" ")
print(f"(95% interval {gain.low:.2f} to {gain.high:.2f})")
