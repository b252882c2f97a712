"""What successive halving buys: what settings are worth that were found with the same number of steps.

    python -m benchmarks.searching [REPEATS]

Each way of searching is repeated with other draws and seeds. What was found runs on many fresh seeds. The table has
how much worse it is than the best setting that any search found, in median and at the worst of ten.
"""

import dataclasses
import sys
import time

import numpy as np

import jaxrl_tab as rl
from jaxrl_tab.engine.part import compute
from jaxrl_tab.engine.sweep import result
from jaxrl_tab.experiment.searching import Searching

RATES = {"alpha": rl.LogUniform(0.01, 1), "epsilon": rl.LogUniform(0.01, 0.5)}
TASKS = {
    "Sarsa, windy gridworld, 8000 steps": ("windy-gridworld", {"name": "sarsa", **RATES}, 8000),
    "Sarsa, cliff, 8000 steps": ("cliff-walking", {"name": "sarsa", **RATES}, 8000),
    "Q-learning, taxi, 30 000 steps": ("taxi", {"name": "q-learning", **RATES}, 30_000),
}
WAYS = {
    "all to the end, 20 seeds": {"draws": 7, "rungs": 1},
    "all to the end, 5 seeds": {"draws": 28, "rungs": 1, "seeds": 5},
    "halving, more steps, 20 seeds": {"draws": 27, "grow": "steps"},
    "halving, more steps, 10 seeds": {"draws": 54, "seeds": 10, "grow": "steps"},
    "halving, more seeds, 3 to 20": {"draws": 24, "grow": "seeds"},
    "halving, more seeds, 1 to 9": {"draws": 60, "grow": "seeds", "seeds": 9},
    "by Optuna in 3 rounds, more steps": {"draws": 15, "sampler": "optuna", "rounds": 3, "grow": "steps"},
    "by Optuna in 3 rounds, more seeds": {"draws": 15, "sampler": "optuna", "rounds": 3, "grow": "seeds"},
    "all to the end, 20 seeds, 4 times the steps": {"draws": 27, "rungs": 1},
}
FRESH = 500  # seeds on which what was found is judged


def found(environment, method, steps, way, seed):
    """The mean score of the setting that a search finds, on fresh seeds, and the steps that the search took."""
    search = rl.Search(environment, [method], **({"steps": steps, "seeds": 20, "seed": seed} | way))
    one = Searching(search, None, None, lambda stage: compute(stage.part))
    one.run()
    part = next(iter(search.experiment.parts().values()))
    alone = dataclasses.replace(part, axes={}, configs=[one.winners[0].config], num_seeds=FRESH, fresh=True)
    ds = result(alone, compute(alone)).to_xarray()
    return float(rl.stats.score(ds).mean()), search.work(search.experiment.method[0]["label"])


def main():
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for name, task in TASKS.items():
        scores, work, seconds = {}, {}, {}
        for way, given in WAYS.items():
            begun = time.perf_counter()
            pairs = [found(*task, given, seed) for seed in range(repeats)]
            scores[way], work[way] = np.array([x for x, _ in pairs]), pairs[0][1]
            seconds[way] = (time.perf_counter() - begun) / repeats
        best = max(x.max() for x in scores.values())
        print(f"\n{name}: the best that was found is worth {best:.2f}; {repeats} searches of each kind\n")
        print("| | million steps | worse by, median | 9 of 10 within | seconds |\n|---|---|---|---|---|")
        for way, x in scores.items():
            off = np.quantile(best - x, [0.5, 0.9])
            print(
                f"| {way} | {work[way] / 1e6:.2f} | {off[0]:.2f} | {off[1]:.2f} | {seconds[way]:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
