"""An experiment in a file: grids and random draws, in a folder that can be resumed and has a report.

    python examples/experiment.py runs/cliff

Without a folder it goes into a temporary one. The best setting of each method was chosen for its mean on a few
seeds, and so for its luck on them: on average the first number flatters it, though not in every single case. It is
run again on fresh seeds, which had no part in the choice: the second number is the one to quote.
"""

import sys
import tempfile
from pathlib import Path

import jaxrl_tab as rl
from jaxrl_tab import planning, stats

experiment = rl.Experiment.load(Path(__file__).with_suffix(".toml"))  # or rl.Experiment(environment=..., ...)
folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp()) / "cliff"
outcome = rl.run(experiment, folder)  # interrupted? rl.resume(folder) does what is missing

env = rl.make("cliff-walking")
soft = planning.start_value(env, planning.epsilon_soft(env, 0.1)[1])
print(
    "cliff walking, epsilon 0.1, the best of 20 step sizes by 5 seeds: mean return of an episode at the end"
)
print(f"no policy that explores so much can have more than {soft:.2f} on average\n")
for name, ds in outcome.datasets.items():
    best = stats.best(ds)
    chosen, fresh = stats.score(ds.sel(best)), stats.score(outcome.fresh[name])
    setting = ", ".join(f"{k} {x:.3g}" for k, x in stats.named(ds, best).items())
    print(f"{name.partition('/')[2]}, {setting}")
    for which, score in (("on the seeds of the choice", chosen), ("on fresh seeds", fresh)):
        mean, low, high, n = stats.mean_interval(score)
        print(f"  {which:28}{mean:8.2f}   ({low:.2f} to {high:.2f}, {n:d} seeds)")
files = sorted(file.name for file in folder.iterdir() if not file.name.startswith("."))
print(f"\nin {folder}: {', '.join(files)}")
