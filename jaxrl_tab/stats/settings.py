"""Which setting is best, and what its rows of a table hold."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr

from jaxrl_tab.core.checks import InputError
from jaxrl_tab.core.schedules import typed
from jaxrl_tab.stats.along import Interval, check_fraction, name_list
from jaxrl_tab.stats.bootstrap import iqm_interval
from jaxrl_tab.stats.comparisons import Difference, paired_difference
from jaxrl_tab.stats.intervals import least_of, mean_interval, median_interval, seeds_wanted, with_one_more
from jaxrl_tab.stats.measures import (
    Measure,
    diverged_runs,
    drawn,
    final_return,
    fixed,
    hyperparameters,
    is_prediction,
    named,
    optimum,
    possible,
    score,
    sound_runs,
    standstill,
    unfinished,
)


def best(ds: xr.Dataset, by: Measure = score, **given: Any) -> dict[str, Any]:
    """The combination of hyperparameters with the best mean `score`: the highest return, the lowest error.

    All are compared on all their seeds: `score` says how unfinished and diverged runs count. A setting at
    which fewer runs diverge is preferred to any at which more do, whatever their means (of prediction these
    are infinite); so is, of a measure of one's own, one with fewer seeds that have no number. Of equals the
    first.

    The selection is biased: the winner was chosen for being good on these very seeds, so its own mean
    (and interval) promises too much. Run it again on fresh seeds for a number to report: `selection`. Which
    settings may as well be the best one: `tied`.

    The right choice was made in so many per cent of experiments (1500 to 8000 of each kind with up to 300
    seeds, 300 or more with 1000), drawn from 20 000 runs of each setting, 8000 steps, epsilon 0.1:

        seeds                                                    10   30  100  300 1000
        cliff, Sarsa, alpha .1, .5 (1% stuck), 1 (2%)            94   96  100  100  100
        windy, Sarsa, seven alphas                               86   97  100  100  100
        windy, Q-learning, seven alphas                          85   97  100  100  100
        cliff, Sarsa 1 (2% stuck), Sarsa .1, Q-learning .1       61   86  100  100  100
        cliff, Sarsa .5 (1% stuck) and one that is 6.5 better    47   60   81   96  100
        cliff, Sarsa .5 (1% stuck) and one that is 5.5 worse     84   79   76   89   97

    Where 1% of all runs are stuck, nine in ten experiments with ten seeds see none of them, so no rule can be
    good there. Medians and trimmed means choose wrongly in the fourth and fifth line, and more surely so with
    more seeds. What is left open by the seeds there are, `tied` says.

    Args:
        ds: a sweep.
        by: what to choose by, a number for each seed; of prediction lower is better, else higher.
        given: hyperparameters to hold at one of their values; the best of the others is looked for.

    Returns:
        A value for each of `hyperparameters(ds)`, fit for `ds.sel`; of drawn ones the label of the draw.

    Raises:
        InputError: a given name was not swept, or not at that value.
    """
    names = hyperparameters(ds)
    for name, value in given.items():
        if name not in names:
            how = "drawn together with others: hold draw" if name in drawn(ds) else "not swept"
            raise InputError(f"{name} was {how}; swept were {name_list(names)}")
        if value not in ds[name].values.tolist():
            tried = ", ".join(map(repr, ds[name].values.tolist()))
            raise InputError(f"{name} was not swept at {value!r}; there are {tried}")
    ds = ds.sel(given)
    merit, lost = _merit(ds, by)
    mean = merit.mean("seed").where(lost == lost.min()).fillna(-np.inf)
    place = np.unravel_index(np.argmax(mean.values), mean.shape)
    found = {str(name): ds[name].values[i].item() for name, i in zip(mean.dims, place, strict=True)}
    return {name: given.get(name, found.get(name)) for name in names}


def ranked(datasets: Mapping[str, xr.Dataset]) -> list[str]:
    """The names of the methods, that whose best setting is the best of all first: by the rule of `best`."""

    def rank(name: str) -> tuple[int, float]:
        merit, lost = (part.sel(best(datasets[name])) for part in _merit(datasets[name]))
        return int(lost), -float(merit.mean().fillna(-np.inf))

    return sorted(datasets, key=rank)


def _merit(ds: xr.Dataset, by: Measure = score) -> tuple[xr.DataArray, xr.DataArray]:
    """What settings are compared by, [*hyperparameters, seed], and how many runs are lost, [*hyperparameters].

    The first is turned so that higher is better; NaN where there is no finite number.
    """
    merit = -by(ds) if is_prediction(ds) else by(ds)
    merit = merit.where(np.isfinite(merit))
    return merit, (merit.isnull() | diverged_runs(ds)).sum("seed")


def tied(ds: xr.Dataset, by: Measure = score, confidence: float = 0.95) -> xr.DataArray:
    """Which settings cannot be told apart from the best one, which is among them: bool [*hyperparameters].

    Those whose difference from it, seed by seed, has an interval that holds 0: at the level 1 - 0.05 / (K - 1)
    of `paired_difference` for K settings, so that the setting with the best true mean is among them with 95%.
    In the experiments of `best` it was in 94.2% at the least (fifth line, 30 seeds), 98% in the fourth line,
    100% in the others; with ten seeds there were 1.5 to 2.9 settings in the set, with 100 1.2 to 2.0.

    Args:
        ds, by: as in `best`.
        confidence: that the setting with the best true mean is among them.
    """
    check_fraction("confidence", confidence)
    merit, lost = _merit(ds, by)
    winner = merit.sel(best(ds, by)).drop_vars(hyperparameters(ds) + drawn(ds), errors="ignore")
    settings = merit.sizes["seed"] and merit.size // merit.sizes["seed"]
    level = 1 - (1 - confidence) / max(1, settings - 1)
    difference = paired_difference(winner, merit, confidence=level).interval
    return ~(difference.low > 0).transpose(*lost.dims) & (lost == lost.min())


def at_edge(ds: xr.Dataset, setting: Mapping[str, Any]) -> dict[str, str]:
    """The hyperparameters whose value in `setting` is the "largest" or the "smallest" that was tried.

    A better value may lie beyond. Nothing is said of random draws, of what is no number, of a single value,
    and where nothing lies beyond: below 0, below one step of n, and above 1 of what is a probability or a
    discount.
    """
    found = {}
    for name in hyperparameters(ds):
        tried = ds[name].values
        if name == "draw" or tried.dtype.kind not in "fiu" or len(tried) < 2:
            continue
        if setting[name] == tried.max() and not (name in ("epsilon", "lam", "gamma") and tried.max() == 1):
            found[name] = "largest"
        elif setting[name] == tried.min() and tried.min() not in (
            (0, 1) if tried.dtype.kind in "iu" else (0,)
        ):
            found[name] = "smallest"
    return found


def score_interval(ds: xr.Dataset, confidence: float = 0.95, by: Measure = score) -> Interval:
    """The mean `score` of each setting over all its seeds, with its interval, [*hyperparameters].

    It is that of `mean_interval`, but where the mean rests on few bad runs (`seeds_wanted`): there the bad
    end lies at least where Student's interval has it with one run more, which scores as the worst one seen,
    or as `standstill(ds)` if that is worse. And it leaves out what is impossible: see `possible`.

    In so many per cent of experiments it held the true mean (2000 of each kind with up to 100 seeds, then
    1000 and 400, so the standard error is 0.5 to 1; runs as in the table of `best`), how often that of
    `mean_interval` did, and how often the warning was given, with 10, 30, 100, 300 and 1000 seeds:

                                       this                  mean_interval          warned
        normal numbers             96  95  95  94  93     96  95  95  94  93     18   1   0   0   0
        windy, Q-learning .5       96  96  95  96  95     96  96  95  96  95     25   6   0   0   0
        windy, Sarsa .5            96  96  96  95  95     96  96  96  95  95     44  24   1   0   0
        windy, Sarsa 1             94  94  95  94  94     93  93  94  93  94     67  75  68  52  49
        cliff, Q-learning .5       96  96  96  94  96     96  96  96  94  96     31   8   0   0   0
        cliff, Sarsa 1 (2% stuck)  89  98  96  97  95     77  86  96  97  95     88  98 100 100  24
        cliff, Sarsa .5 (1% stuck) 82  94 100 100  97     66  76  88  94  96     81  94  99 100 100

    Without a warning it missed in at most 6.8%, but 18% and 11% in the last two lines with ten seeds. The
    intervals of median and interquartile mean held in 93% to 98% everywhere. With few seeds the warning is
    often false, and the interval then needlessly wide.

    Whatever is done, no interval knows of what no seed has shown: n runs that are all well leave it possible
    that up to 3 / n of all runs are not (the rule of three, 95%).

    Args:
        ds: a sweep.
        confidence: the coverage aimed at, between 0 and 1.
        by: gives the scores; or another measure of returns, or errors.
    """
    x = by(ds)
    good = -x if is_prediction(ds) else x
    mean, low, high, n = mean_interval(good, confidence=confidence)
    if (few := seeds_wanted(good) > n).any():
        stuck = least_of(good.min("seed"), standstill(ds))
        low = low.where(~few, np.fmin(low, with_one_more(good, stuck, "seed", confidence)[1]))
    if is_prediction(ds):
        mean, low, high = -mean, -high, -low
    return possible(Interval(mean, low, high, n), x, ds)


def differences(datasets: Mapping[str, xr.Dataset], confidence: float = 0.95) -> dict[str, Difference]:
    """How the best setting of each method differs from that of the best method, seed by seed: x - best.

    The settings, and the method to compare with, were chosen for being good on these very seeds. So p-values
    and intervals are corrected for all pairs of settings of two methods that might have been compared
    (Bonferroni): of identical methods some p is below 5% in at most 5% of experiments, and the intervals all
    hold at once. Where each method comes with one setting alone, such as on fresh seeds, these are the pairs
    of methods, which is far less to correct for: choose on some seeds and compare on others where it matters.

    In 1500 to 3000 experiments with 30 or 100 seeds, of normal numbers and of runs of the product, some p of
    2, 3, 5 and 10 identical methods was below 5% in at most 5.9, 4.7, 3.7 and 3.5% (uncorrected in up to 61%),
    and of one setting beside the best of 7, or 20, like it in at most 2.0% (uncorrected in up to 12 and 21%).

    Args:
        datasets: for each method a sweep, or one setting; all of control, or all of prediction.
        confidence: of all intervals together.

    Returns:
        For each method, that with the best mean first, its `paired_difference` from the first, with `worst` as
        `standstill` has it; for the first itself there is none, it is left out. Empty where there is but one
        method, or where their seeds are not the same.
    """
    prediction = is_prediction(*datasets.values())
    seeds = [ds.seed.values for ds in datasets.values()]
    if len(datasets) < 2 or any(not np.array_equal(seeds[0], other) for other in seeds[1:]):
        return {}
    merits = {name: _merit(ds)[0] for name, ds in datasets.items()}
    pairs = pairs_to_correct([merit.size // merit.sizes["seed"] for merit in merits.values()])
    at = {name: merits[name].sel(best(ds)).reset_coords(drop=True) for name, ds in datasets.items()}
    first, *others = ranked(datasets)
    worst = min(float(standstill(ds).min()) for ds in datasets.values())
    found = {}
    for name in others:
        (mean, low, high, n), p, reduction = paired_difference(
            at[name], at[first], confidence=1 - (1 - confidence) / pairs, worst=worst
        )
        if prediction:
            mean, low, high = -mean, -high, -low
        found[name] = Difference(Interval(mean, low, high, n), (p * pairs).clip(max=1), reduction)
    return found


def pairs_to_correct(settings: Sequence[int]) -> int:
    """How many pairs of settings there are of two methods, that have so many settings each."""
    return (sum(settings) ** 2 - sum(n**2 for n in settings)) // 2


class Selection(NamedTuple):
    """What a setting that was chosen on some seeds promised there, and what it is worth on others.

    Attributes:
        setting: the setting, fit for `sel` on the dataset that it was chosen from.
        promised: its mean on the seeds that it was chosen on; the interval does not know of the choice.
        fresh: its mean on fresh seeds, with its interval: the number to report.
        bias: how far `promised` is off: less `fresh`, and less the bounds of that.
    """

    setting: dict[str, Any]
    promised: Interval
    fresh: Interval
    bias: Interval


def selection(ds: xr.Dataset, fresh: xr.Dataset, by: Measure = score, confidence: float = 0.95) -> Selection:
    """Selection without bias: the setting that is best in `ds`, and how good it is on the seeds of `fresh`.

    Args:
        ds: the sweep to choose from.
        fresh: a sweep of the same method on other seeds, of the chosen setting, `best(ds, by)`, at least.
        by: what to choose by and what to report, as in `best`.
        confidence: of each interval.

    Raises:
        InputError: `fresh` has no such setting, or shares a seed with `ds`: one of the same number under the
            same root. (What was run with `sweep.Part.fresh` has a root of its own.)
    """
    setting = best(ds, by)
    same_root = all(ds.attrs.get(key, 0) == fresh.attrs.get(key, 0) for key in ("root_seed", "fresh_seeds"))
    if same_root and (again := np.intersect1d(ds.seed, fresh.seed)).size:
        raise InputError(
            f"seed {again[0]} is among those that the setting was chosen on; report on fresh ones"
        )
    at = fresh
    for name, value in (setting | named(ds, setting)).items():
        if name in at.dims:
            if value not in at[name].values.tolist():
                raise InputError(f"the fresh runs have no {name} = {value}")
            at = at.sel({name: value})
        elif (
            name != "draw"
            and (got := fixed(at).get(name, at[name].item() if name in at.coords else None)) != value
            and not (isinstance(got, float) and typed(got) == value)  # as on an axis beside schedules
        ):
            raise InputError(f"the fresh runs must have {name} = {value}, not {got}")
    promised = Interval(*(part.sel(setting) for part in score_interval(ds, confidence, by)))
    found = score_interval(at, confidence, by)
    off = (promised.estimate - found.estimate, promised.estimate - found.high, promised.estimate - found.low)
    return Selection(setting, promised, found, Interval(*off, found.n))


def summary(datasets: Mapping[str, xr.Dataset]) -> pd.DataFrame:
    """A table with a row for each method and combination of hyperparameters: what `summary.csv` holds.

    All intervals are of 95%, each for itself.

    Args:
        datasets: a sweep for each method, by its name.

    Returns:
        A frame with the columns `method`; every hyperparameter of any method, swept or not (empty where a
        method has no such); `episodes`, episodes finished in the whole run, mean over seeds; and

        - `last_tenth_return` with `last_tenth_low` and `last_tenth_high`: the mean `score` of all seeds, and
          its interval by `score_interval`;
        - `last_tenth_median` and `last_tenth_iqm`, each with `_low` and `_high`: median and interquartile
          mean of the score, and their intervals, which hold also where the mean's cannot be trusted;
        - `seeds`: how many seeds there are in these; `unfinished`: how many of them finished no episode in
          the last tenth, and so count with the rewards that they collected there; `diverged`: how many
          diverged, and so count as the worst run of the sweep;
        - `seeds_wanted`: how many seeds it takes until the interval of the mean can be trusted (see the
          function of this name). More than `seeds`: it rests on few bad runs;
        - `best`: whether this is the best setting of its method (`best`); `tied`: whether it cannot be told
          apart from that (`tied`);
        - `difference` with `difference_low` and `difference_high`, and `p`, in the rows of the best settings
          of all methods but the first: how this differs from the best setting of the best method, seed by
          seed, corrected for the choice (`differences`). Empty elsewhere, and where the seeds are not the same;
        - `steps_per_second` of the method's sweep;
        - where it was recorded, `greedy_value`, the exact value of the greedy policy at the end, median over
          seeds; `optimum`, v* from the start, of prediction v_pi.

        Of prediction the score is the error, and its columns are `v_error`, `v_error_low`, `v_error_high`,
        `v_error_median`, ... and `v_error_iqm`, ...; `final_v_error` is that at the end, mean over seeds.
        `last_tenth_return`, `_low` and `_high` are then what the policy that acts earned in those runs that
        finished an episode there.
    """
    records, names, columns = [], {}, {}
    compared = differences(datasets)
    for method, ds in datasets.items():
        swept, constant = hyperparameters(ds), fixed(ds)
        names |= dict.fromkeys([*swept, *drawn(ds), *constant])
        x, prediction = score(ds), is_prediction(ds)
        known = lambda _, x=x: x
        results: dict[str, Any] = {"episodes": ds.episodes.sum("row").mean("seed")}
        if prediction:
            late = mean_interval(final_return(ds))
            results |= dict(
                zip(("last_tenth_return", "last_tenth_low", "last_tenth_high"), late[:3], strict=True)
            )
        kind = "v_error" if prediction else "last_tenth"
        found = {
            "v_error" if prediction else "last_tenth_return": score_interval(ds, by=known),
            f"{kind}_median": median_interval(x),
            f"{kind}_iqm": iqm_interval(x.where(np.isfinite(x))),
        }
        for name, (estimate, low, high, _) in found.items():
            name = name.removesuffix("_return")
            results |= {name if name != "last_tenth" else "last_tenth_return": estimate}
            results |= {f"{name}_low": low, f"{name}_high": high}
        results |= {
            "seeds": x.notnull().sum("seed"),
            "unfinished": xr.zeros_like(x, int).sum("seed") if prediction else unfinished(ds).sum("seed"),
            **({"diverged": ds.diverged.sum("seed")} if "diverged" in ds else {}),
            "seeds_wanted": seeds_wanted(x, higher_is_better=not prediction),
            "best": _is_at(x, best(ds, known)),
            "tied": tied(ds, known),
        }
        difference = compared.get(method)
        here = results["best"].where(difference is not None, False)
        parts = (*difference.interval[:3], difference.p) if difference else [xr.DataArray(np.nan)] * 4
        for name, part in zip(("difference", "difference_low", "difference_high", "p"), parts, strict=True):
            results[name] = xr.where(here, part, np.nan)
        results["steps_per_second"] = ds.attrs.get("steps_per_second", np.nan)
        if "greedy_value" in ds:
            results["greedy_value"] = sound_runs(ds.greedy_value.isel(row=-1), ds).median("seed")
        if prediction:
            results["final_v_error"] = mean_interval(sound_runs(ds.v_error.isel(row=-1), ds)).estimate
        columns |= dict.fromkeys(results)
        results["optimum"] = optimum(ds)
        table = xr.Dataset(results).expand_dims(method=[method])
        frame = table.to_dataframe(dim_order=["method", *swept]).reset_index()
        records += [constant | record for record in frame.to_dict("records")]
    return pd.DataFrame(records, columns=["method", *names, *columns, "optimum"])


def _is_at(x: xr.DataArray, setting: Mapping[str, Any]) -> xr.DataArray:
    """True at one setting, bool [*hyperparameters]."""
    at = xr.zeros_like(x.isel(seed=0, drop=True), bool)
    at.loc[dict(setting)] = True
    return at
