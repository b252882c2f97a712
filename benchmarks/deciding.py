"""How often `stats.until_decided` errs, and what it finds with how many seeds: `python -m benchmarks.deciding`.

The whole procedure is simulated: experiments are drawn from runs of the product, on common seeds, and from
distributions that are known. It prints the tables of docs/deciding.md; `--trials 200` is a quick look.
"""

import argparse
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab import stats
from jaxrl_tab.stats.deciding import levels, looks, repeated_interval

MOST = 2000  # seeds
RUNS = 20_000  # of each population of the product
FLOOR = -800.0  # what a run scores that stands still in the last tenth, on the cliff and in the wind
CHUNK = 250  # experiments at a time
CONFIDENCE = 0.95

Draw = Callable[[np.random.Generator, int], list[np.ndarray]]  # of each method scores [experiments, MOST]


class Case(NamedTuple):
    """Methods to compare.

    Attributes:
        draw: draws experiments.
        means: what is true.
        same: the difference that matters.
        floor: what a stuck run scores; infinite where that is not known.
    """

    draw: Draw
    means: Sequence[float]
    same: float = 0.0
    floor: float = np.inf


class Found(NamedTuple):
    """What came out of the experiments, [experiments] each.

    Attributes:
        wrong: whether anything was decided wrongly.
        all_found: whether all true differences were found.
        same: whether all that are equal were called the same.
        seeds: how many seeds a method got, on average.
    """

    wrong: np.ndarray
    all_found: np.ndarray
    same: np.ndarray
    seeds: np.ndarray


# --- the procedure, for many experiments at once ------------------------------------------------------
def sequential(scores: Sequence[np.ndarray], case: Case, first: int = 100) -> Found:
    """`until_decided` in each of the experiments."""
    x = [xr.DataArray(values, dims=("experiment", "seed")) for values in scores]
    pairs, plan = list(itertools.combinations(range(len(x)), 2)), looks(first, scores[0].shape[1])
    codes = {pair: np.zeros(len(scores[0]), int) for pair in pairs}  # 1: better, -1: worse, 2: the same
    seeds = np.zeros((len(x), len(scores[0])), int)
    for n, level in zip(plan, levels(plan, (1 - CONFIDENCE) / len(pairs)), strict=True):
        left = {pair: np.flatnonzero(codes[pair] == 0) for pair in pairs}
        for (a, b), at in left.items():
            seeds[a, at] = seeds[b, at] = n
            if at.size:
                bounds = repeated_interval(x[a][at, :n], x[b][at, :n], level, case.floor)
                _, low, high = (part.values for part in bounds)
                is_same = (-case.same < low) & (high < case.same)
                codes[a, b][at] = np.select([low > 0, high < 0, is_same], [1, -1, 2], 0)
    return _found(codes, seeds.mean(0), case)


def fixed(scores: Sequence[np.ndarray], case: Case, n: int) -> Found:
    """`paired_difference` on n seeds, corrected by Holm."""
    x = [xr.DataArray(values[:, :n], dims=("experiment", "seed")) for values in scores]
    pairs = list(itertools.combinations(range(len(x)), 2))
    tested = [stats.paired_difference(x[a], x[b], worst=case.floor) for a, b in pairs]
    p = stats.holm(xr.concat([one.p for one in tested], "pair"), "pair").transpose("pair", ...).values
    signs = [np.sign(one.interval.estimate.values) for one in tested]
    codes = {pair: np.where(p[i] < 1 - CONFIDENCE, signs[i], 0).astype(int) for i, pair in enumerate(pairs)}
    return _found(codes, np.full(len(scores[0]), float(n)), case)


def _found(codes: dict[tuple[int, int], np.ndarray], seeds: np.ndarray, case: Case) -> Found:
    wrong, all_found, same = np.zeros(len(seeds), bool), np.ones(len(seeds), bool), np.ones(len(seeds), bool)
    for (a, b), code in codes.items():
        gap = case.means[a] - case.means[b]
        truth = int(np.sign(gap)) if abs(gap) > 1e-9 else 0
        wrong |= np.isin(code, (1, -1)) & (code != truth)
        wrong |= (code == 2) & (abs(gap) >= case.same)
        all_found &= (truth == 0) | (code == truth)
        same &= (truth != 0) | (code == 2)
    return Found(wrong, all_found, same, seeds)


def simulate(case: Case, trials: int, of: Callable[[Sequence[np.ndarray], Case], Found]) -> Found:
    """What `of` finds in so many experiments: always the same ones."""
    rng, parts = np.random.default_rng(0), []
    for begun in range(0, trials, CHUNK):
        parts.append(of(case.draw(rng, min(CHUNK, trials - begun)), case))
    return Found(*map(np.concatenate, zip(*parts, strict=True)))


# --- what is drawn from --------------------------------------------------------------------------------
def populations() -> dict[str, np.ndarray]:
    """Scores of `RUNS` runs of the product, for each setting: 8000 steps, epsilon 0.1; common seeds."""
    import jaxrl_tab as rl

    swept = {
        ("cliff", "sarsa"): [0.1, 0.5, 1.0],
        ("cliff", "q-learning"): [0.1, 0.5, 1.0],
        ("windy", "sarsa"): [0.05, 0.1, 0.2, 0.5, 0.7, 1.0],
        ("windy", "q-learning"): [0.5, 0.7, 1.0],
    }
    envs = {"cliff": rl.make("cliff-walking"), "windy": rl.make("windy-gridworld")}
    found = {}
    for (env, method), alphas in swept.items():
        grid = {"alpha": alphas}
        result = rl.sweep(envs[env], method, grid, num_seeds=RUNS, num_steps=8000, log_every=800)
        ds = result.to_xarray()
        found |= {f"{env} {method} {alpha:g}": stats.score(ds).sel(alpha=alpha).values for alpha in alphas}
    return found


def normal(*means: float) -> Draw:
    return lambda rng, trials: [mean + rng.standard_normal((trials, MOST)) for mean in means]


def half(*means: float) -> Draw:
    """Normal, with differences of two of them of standard deviation 1."""
    return lambda rng, trials: [mean + rng.standard_normal((trials, MOST)) / np.sqrt(2) for mean in means]


def two_valued(*shares: float) -> Draw:
    return lambda rng, trials: [(rng.random((trials, MOST)) < share) * 1.0 for share in shares]


def of_runs(*runs: np.ndarray, paired: bool = True) -> Draw:
    """Runs of the product: with the same seeds, or each with its own."""

    def draw(rng: np.random.Generator, trials: int) -> list[np.ndarray]:
        seeds = rng.integers(RUNS, size=(trials, MOST))
        return [x[seeds if paired else rng.integers(RUNS, size=(trials, MOST))] for x in runs]

    return draw


def stuck(share: float, score: float) -> Draw:
    """Normal values with standard deviation 5, of which a share of the first method's are stuck; equal means."""

    def draw(rng: np.random.Generator, trials: int) -> list[np.ndarray]:
        x, y = (5 * rng.standard_normal((trials, MOST)) for _ in range(2))
        return [np.where(rng.random((trials, MOST)) < share, score, x) - share * score, y]

    return draw


def moved(x: np.ndarray, to: np.ndarray) -> np.ndarray:
    return x - x.mean() + to.mean()


# --- the tables ------------------------------------------------------------------------------------------
def nulls(runs: dict[str, np.ndarray]) -> Iterator[tuple[str, Case]]:
    """Methods that are the same: nothing should be called better."""
    for k in (2, 3, 5):
        yield f"normal, {k} methods", Case(normal(*[0.0] * k), [0] * k)
    for name in ("cliff sarsa 0.5", "cliff sarsa 1", "windy sarsa 1"):
        for k in (2, 3, 5):
            yield f"{name}, {k} methods", Case(of_runs(*[runs[name]] * k, paired=False), [0] * k, 0.0, FLOOR)
    for share, ks in ((0.9, (2, 3, 5)), (0.98, (2, 5))):
        for k in ks:
            yield f"0 or 1, {share:.0%} ones, {k} methods", Case(two_valued(*[share] * k), [0] * k)


def shapes(runs: dict[str, np.ndarray]) -> Iterator[tuple[str, Case]]:
    """Equal means of different shapes."""
    for one, other in (
        ("cliff sarsa 0.5", "cliff q-learning 0.5"),
        ("cliff sarsa 0.5", "cliff sarsa 0.1"),
        ("cliff sarsa 0.5", "cliff sarsa 1"),
        ("cliff sarsa 0.5", "windy q-learning 0.5"),
        ("cliff sarsa 1", "cliff q-learning 0.5"),
        ("cliff sarsa 1", "windy sarsa 1"),
        ("windy sarsa 1", "windy sarsa 0.5"),
        ("windy sarsa 1", "cliff q-learning 1"),
        ("windy sarsa 0.05", "windy sarsa 0.1"),
    ):
        x = runs[one]
        yield f"{one}, {other}", Case(of_runs(x, moved(runs[other], x)), [0, 0], 0.0, FLOOR)


def beyond() -> Iterator[tuple[str, Case]]:
    """Equal means where stuck runs have no lesser relatives: what no sample shows."""
    for share, score in ((0.01, -800), (0.003, -2000), (0.001, -800), (0.003, -300), (0.03, -300)):
        yield f"{share:.1%} at {score}", Case(stuck(share, score), [0, 0], 0.0, FLOOR)


def not_the_same(runs: dict[str, np.ndarray]) -> Iterator[tuple[str, Case]]:
    """Methods that are apart by just what matters: neither "the same" nor the wrong one may be called."""
    yield "normal, 0.2 sd", Case(half(0, 0.2), [0, 0.2], 0.2)
    for one, other in ((1.0, 0.98), (0.99, 0.97), (0.9, 0.88)):
        yield (
            f"0 or 1, {one:.0%} and {other:.0%} ones",
            Case(two_valued(one, other), [one, other], one - other),
        )
    for one, other, d in (
        ("cliff sarsa 0.5", "cliff q-learning 0.5", 5.0),
        ("windy sarsa 1", "windy sarsa 0.5", 5.0),
    ):
        x = runs[one]
        y = moved(runs[other], x) + d
        yield f"{one}, {other}", Case(of_runs(x, y), [0, d], d, FLOOR)


def powers(runs: dict[str, np.ndarray]) -> Iterator[tuple[str, Case]]:
    """Methods that differ."""
    for d in (0.1, 0.2, 0.3, 0.5):
        yield f"normal, {d:g} sd apart", Case(half(0, d), [0, d])
    yield "normal, equal; 0.2 sd matter", Case(half(0, 0), [0, 0], 0.2)
    yield "normal, 0, 0 and 0.3 sd; 0.15 matter", Case(half(0, 0, 0.3), [0, 0, 0.3], 0.15)
    for names in (
        ("windy q-learning 0.7", "windy q-learning 1"),
        ("windy sarsa 0.5", "windy sarsa 0.7"),
        ("windy sarsa 1", "windy sarsa 0.2"),
        ("cliff sarsa 0.1", "cliff sarsa 1"),
        ("cliff sarsa 0.5", "cliff q-learning 0.5"),
        ("windy q-learning 0.5", "windy q-learning 0.7", "windy q-learning 1"),
        ("cliff sarsa 0.1", "cliff sarsa 0.5", "cliff sarsa 1"),
        ("windy sarsa 0.5", "windy sarsa 0.7", "windy sarsa 1", "windy sarsa 0.2", "windy q-learning 1"),
    ):
        x = [runs[name] for name in names]
        means = [float(values.mean()) for values in x]
        yield ", ".join(names), Case(of_runs(*x), means, 0.0, FLOOR)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2000, help="experiments of each kind")
    trials = parser.parse_args().trials
    runs = populations()
    at = {n: lambda scores, case, n=n: fixed(scores, case, n) for n in (100, 300)}
    for title, cases in (
        ("the same distribution", nulls(runs)),
        ("equal means, different shapes", shapes(runs)),
        ("apart by what matters", not_the_same(runs)),
        ("what no sample shows", beyond()),
    ):
        print(f"\n| {title} | until decided | 100 seeds | 300 seeds |\n|---|---|---|---|")
        for name, case in cases:
            errors = [simulate(case, trials, of).wrong.mean() for of in (sequential, *at.values())]
            print(f"| {name} |", " | ".join(f"{100 * error:.1f}" for error in errors), "|", flush=True)
    print("\n| | found | seeds | 100 seeds | 300 seeds | wrong |\n|---|---|---|---|---|---|")
    for name, case in powers(runs):
        found, *others = (simulate(case, trials, of) for of in (sequential, *at.values()))
        share = found.all_found & found.same if case.same else found.all_found
        cells = [f"{100 * share.mean():.1f}", f"{found.seeds.mean():.0f}"]
        cells += ["–" if case.same else f"{100 * x.all_found.mean():.0f}" for x in others]
        print(f"| {name} |", " | ".join([*cells, f"{100 * found.wrong.mean():.1f}"]), "|", flush=True)


if __name__ == "__main__":
    main()
