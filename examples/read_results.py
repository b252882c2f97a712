"""Results of long ago: read `results.nc` again, compare methods, and hand tables to other programs.

    python examples/read_results.py runs/windy/results.nc

Without a file it makes a small one first, as `jaxrl-tab sweep` would.
"""

import sys
import tempfile
from pathlib import Path

import xarray as xr

import jaxrl_tab as rl
from jaxrl_tab import export, stats


def small_results():
    env, grid = rl.make("windy-gridworld"), {"alpha": [0.3, 0.5, 0.9]}
    sweeps = {
        name: rl.sweep(env, name, grid, num_seeds=40, num_steps=6000) for name in ("sarsa", "q-learning")
    }
    file = Path(tempfile.mkdtemp()) / "results.nc"
    tree = xr.DataTree.from_dict({name: result.to_xarray() for name, result in sweeps.items()})
    tree.to_netcdf(file, engine="h5netcdf")
    return file


datasets = export.load(sys.argv[1] if len(sys.argv) > 1 else small_results())
scores = {}
for name, ds in datasets.items():
    best = stats.best(ds)
    scores[name] = score = stats.score(ds.sel(best))
    mean, run = stats.mean_interval(score), stats.tolerance_interval(score)
    print(f"{name}, {', '.join(f'{k} {x:g}' for k, x in stats.named(ds, best).items())}")
    print(
        f"  mean return at the end   {mean.estimate:8.2f}   (95% interval {mean.low:.2f} to {mean.high:.2f})"
    )
    print(f"  nine of ten runs lie in  {run.low:8.2f} to {run.high:.2f}")

(first, x), (second, y), *_ = scores.items()
difference = stats.paired_difference(y, x)
by = difference.interval
print(f"{second} against {first}, seed by seed")
print(f"  better by                {by.estimate:8.2f}   (95% interval {by.low:.2f} to {by.high:.2f})")
print(f"  as great by luck with probability {difference.p:.2g}")
better = stats.probability_of_improvement(y, x)
bounds = f"{better.low:.2f} to {better.high:.2f}"
print(f"  a run of it is the better one with probability {better.estimate:.2f} ({bounds})")
needed = stats.seeds_needed(by.estimate.item() / 10, (y - x).std(ddof=1).item())
print(f"  seeds that a tenth of this difference would need: {needed}")

table = export.to_pandas(datasets, per="seed")  # a row for each run: pandas, seaborn, R, a spreadsheet
print(
    f"\na table of {len(table)} rows, for other programs; export.save(datasets, 'results.csv') writes one\n"
)
print(table[["method", "alpha", "seed", "episodes", "last_tenth_return"]].head(3).to_string(index=False))
