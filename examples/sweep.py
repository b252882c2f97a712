"""A sweep from Python: which step size is best, how sure is that, and how far is it from the optimum?

One call runs every step size with every seed. Nothing is averaged in it: what comes back is an xarray dataset with
a number for each seed, and `stats` makes means with intervals of them.
"""

import jaxrl_tab as rl
from jaxrl_tab import stats

rl.use_all_cores()  # one JAX device per core; before anything is computed
env = rl.make("windy-gridworld")
alphas = [0.1, 0.2, 0.4, 0.8]

datasets = {
    method: rl.sweep(env, method, {"alpha": alphas, "epsilon": 0.1}, num_seeds=50, num_steps=8000).to_xarray()
    for method in ("sarsa", "q-learning", "expected-sarsa")
}
print(f"windy gridworld, 8000 steps, 50 seeds: mean return of an episode at the end; at best {-15}\n")
print(f"{'':15}" + "".join(f"  alpha {alpha:<12g}" for alpha in alphas))
for method, ds in datasets.items():
    mean, low, high, _ = stats.mean_interval(stats.score(ds))
    cells = [
        f"{m:8.1f} ({a:.1f} to {b:.1f})" for m, a, b in zip(mean.values, low.values, high.values, strict=True)
    ]
    print(f"{method:15}" + "".join(f"{cell:20}" for cell in cells))

# Seed i has the same random numbers in every sweep, so methods are compared seed by seed.
best = {method: stats.score(ds.sel(stats.best(ds))) for method, ds in datasets.items()}
gain = stats.paired_difference(best["expected-sarsa"], best["sarsa"])
print(
    f"\nExpected Sarsa is better than Sarsa by {gain.interval.estimate:.2f} "
    f"({gain.interval.low:.2f} to {gain.interval.high:.2f}), each at its best step size"
)
