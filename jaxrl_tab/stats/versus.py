"""Results beside other results of the same experiment: the same to the last bit, or better, or worse?"""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.stats.comparisons import holm, paired_difference, unpaired_difference
from jaxrl_tab.stats.measures import fixed, hyperparameters, named, standstill
from jaxrl_tab.stats.settings import Settings

FEWEST = 6  # seeds in both from which on they are paired: fewer differences cannot show anything at 95%
LENGTHS = ("num_steps", "num_episodes")
SAME_RUNS = ("root_seed", "fresh_seeds")
Verdict = Literal["same", "better", "worse", "open", "none"]


class Place(NamedTuple):
    """Where two runs are first not the same.

    Attributes:
        seed: of the run.
        row: of the log, from 0; None where it is none: only what was learned in the end is another.
        variable: its name in the dataset.
        before, after: what stands there.
    """

    seed: int
    row: int | None
    variable: str
    before: float
    after: float


@dataclasses.dataclass(frozen=True)
class Compared:
    """A setting of a method in two results.

    Attributes:
        name: "ENVIRONMENT/METHOD".
        kind: what is compared: a "setting" that both have; the "chosen" one of each, where what was tried is not the
            same, on the seeds that it was chosen on; or the "fresh" seeds of the chosen one of each.
        setting, other: its hyperparameters there and here: those that were swept in either, or are not the same.
        prediction: whether errors are compared, the lower the better; else returns.
        seeds: how many seeds each has.
        common: how many of these are the same seeds.
        same: how many runs of these are the same to the last bit, as far as both go; None where they cannot be
            laid side by side, as where the rows of their logs are of other lengths.
        first: where the first run that is not the same begins to differ.
        means: the mean score of each, where they are paired on the seeds that both have; NaN where there is none.
        paired: whether they were compared seed by seed.
        difference, low, high: of the means, second less first, and its interval: at the level at which Holm's
            procedure tests it, so that it leaves out 0 where `corrected` is at most 1 - confidence.
        p, corrected: of "there is no difference", by itself, and of all comparisons by Holm's procedure.
        lost: how many runs of each diverged or have no finite score.
        verdict: of the second: all runs that both have are the "same"; it is "better" or "worse"; "open": no
            difference was shown; "none": there are too few runs to compare.
    """

    name: str
    kind: Literal["setting", "chosen", "fresh"]
    setting: dict[str, Any]
    other: dict[str, Any]
    prediction: bool
    seeds: tuple[int, int]
    common: int
    same: int | None
    first: Place | None
    means: tuple[float, float]
    paired: bool
    difference: float
    low: float
    high: float
    p: float
    corrected: float
    lost: tuple[int, int]
    verdict: Verdict


class _Pair(NamedTuple):
    """Two settings that are to be compared.

    Attributes:
        kind, setting, other: as in `Compared`.
        first, second: the datasets of the two settings, [seed, ...].
        merits: their scores, the higher the better, [seed] each.
        lost: how many runs of each are lost.
        worst: what a run may score at worst.
        choices: among how many pairs the two were chosen on these very seeds.
    """

    kind: Literal["setting", "chosen", "fresh"]
    setting: dict[str, Any]
    other: dict[str, Any]
    first: xr.Dataset
    second: xr.Dataset
    merits: tuple[xr.DataArray, xr.DataArray]
    lost: tuple[int, int]
    worst: float
    choices: int = 1

    @property
    def common(self) -> np.ndarray:
        """The numbers of the seeds that both have; none where their root is another one."""
        roots = [[ds.attrs.get(key, 0) for key in SAME_RUNS] for ds in (self.first, self.second)]
        return (
            np.intersect1d(self.first.seed, self.second.seed) if roots[0] == roots[1] else np.array([], int)
        )


def versus(
    first: Mapping[str, Settings],
    second: Mapping[str, Settings],
    fresh: Mapping[str, tuple[Settings, Settings]],
) -> list[tuple[str, bool, _Pair]]:
    """What is to be compared, not compared yet: name, whether it is prediction, and the pair.

    Args:
        first, second: the settings by the names "ENVIRONMENT/METHOD", which both have.
        fresh: of some of these names, or of others, the chosen settings on fresh seeds.
    """
    found = []
    for name, own in first.items():
        pairs = [*_pairs(own, second[name], name not in fresh)]
        if name in fresh:
            once, again = fresh[name]
            pairs.append(_pair("fresh", once, again, once.best, again.best, 1, own, second[name]))
        found += [(name, own.prediction, pair) for pair in pairs]
    for name, (once, again) in fresh.items():
        if name not in first:
            found.append((name, once.prediction, _pair("fresh", once, again, {}, {}, 1)))
    return found


def compared(pairs: Sequence[tuple[str, bool, _Pair]], confidence: float) -> list[Compared]:
    """All pairs compared, as one family of comparisons."""
    bits = [_same_bits(pair) for _, _, pair in pairs]
    whole = [_is_same(pair, same) for (_, _, pair), (same, _) in zip(pairs, bits, strict=True)]
    tested = [_tested(pair, confidence) for _, _, pair in pairs]
    p = np.array([np.nan if same else test.p for test, same in zip(tested, whole, strict=True)])
    corrected = holm(xr.DataArray(p, dims="comparison")).values if len(p) else p
    tests, rejected = int(np.isfinite(p).sum()), int((corrected <= 1 - confidence).sum())
    rank = {int(i): k for k, i in enumerate(np.argsort(p, kind="stable"))}
    rows = []
    for i, ((name, prediction, pair), (same, place)) in enumerate(zip(pairs, bits, strict=True)):
        # Holm's procedure tests the smallest p at (1 - confidence) / tests, the next one at a little more, until
        # the first that does not pass: at its level all others stay, too.
        level = 1 - (1 - confidence) / max(1, tests - min(rank[i], rejected))
        test = tested[i] if whole[i] else _tested(pair, level)
        if whole[i]:
            verdict: Verdict = "same"
        elif np.isnan(p[i]):
            verdict = "none"
        elif corrected[i] > 1 - confidence:
            verdict = "open"
        else:
            verdict = "better" if (test.by_loss or test.gain) > 0 else "worse"
        sign = -1 if prediction else 1
        low, high = (0.0, 0.0) if whole[i] else sorted((sign * test.low, sign * test.high))
        rows.append(
            Compared(
                name=name,
                kind=pair.kind,
                setting=pair.setting,
                other=pair.other,
                prediction=prediction,
                seeds=(pair.first.sizes["seed"], pair.second.sizes["seed"]),
                common=len(pair.common),
                same=same,
                first=place,
                means=(sign * test.means[0], sign * test.means[1]),
                paired=test.paired,
                difference=sign * test.gain + 0.0,
                low=low + 0.0,
                high=high + 0.0,
                p=float(p[i]),
                corrected=float(corrected[i]),
                lost=pair.lost,
                verdict=verdict,
            )
        )
    return rows


def is_same_task(first: xr.Dataset, second: xr.Dataset) -> bool:
    """Whether two datasets are of the same task, as far as they tell: parameters that only one has do not count."""
    one, other = (json.loads(ds.attrs.get("environment_parameters", "{}")) for ds in (first, second))
    named_alike = first.attrs.get("environment") == second.attrs.get("environment")
    return named_alike and all(one[key] == other[key] for key in one.keys() & other.keys())


# --- which settings are compared ---------------------------------------------------------------------
def _pairs(one: Settings, two: Settings, choose: bool) -> Iterator[_Pair]:
    """The settings that both have; and, if these are not all, the best of each, where they are to `choose`."""
    places = [dict(_settings(own.ds)) for own in (one, two)]
    shared = [key for key in _names(one.ds) if key in _names(two.ds)]
    by_key = [_by_key(of, shared) for of in places]
    by_key = by_key if all(by_key) else [{}, {}]
    both = [key for key in by_key[0] if key in by_key[1]]
    for key in both:
        yield _pair("setting", one, two, by_key[0][key], by_key[1][key], 1)
    best = (one.best, two.best)
    if any(best == tuple(of[key] for of in by_key) for key in both):
        return  # they are compared already
    if choose and not len(both) == len(places[0]) == len(places[1]):
        yield _pair("chosen", one, two, *best, len(places[0]) * len(places[1]))


def _names(ds: xr.Dataset) -> list[str]:
    return list(next(iter(_settings(ds)))[1])


def _settings(ds: xr.Dataset) -> Iterator[tuple[tuple[tuple[str, Any], ...], dict[str, Any]]]:
    """The place of each setting on the axes, and all its hyperparameters."""
    names = hyperparameters(ds)
    for values in product(*(ds[name].values.tolist() for name in names)):
        place = dict(zip(names, values, strict=True))
        yield tuple(place.items()), named(ds, place) | fixed(ds)


def _by_key(
    settings: Mapping[tuple[tuple[str, Any], ...], dict[str, Any]], shared: Sequence[str]
) -> dict[tuple[Any, ...], dict[str, Any]]:
    """The places by the values of hyperparameters that both have; none where these do not tell settings apart."""
    keyed = {
        tuple(_plain(values.get(key)) for key in shared): dict(place) for place, values in settings.items()
    }
    return keyed if len(keyed) == len(settings) else {}


def _plain(value: Any) -> Any:
    """A hyperparameter in one form: 0.1 may be a number here, and a text on an axis beside schedules there."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return str(value)


def _pair(
    kind: Any,
    one: Settings,
    two: Settings,
    place: Mapping[str, Any],
    other: Mapping[str, Any],
    choices: int,
    swept: Settings | None = None,
    swept_too: Settings | None = None,
) -> _Pair:
    """Two settings, by their places. `swept`: whose axes tell what was tried, where the datasets are of one setting."""
    both = ((one, place), (two, other))
    values = [named(own.ds, at) | fixed(own.ds) for own, at in both]
    axes = [n for own in (swept or one, swept_too or two) for n in _swept(own.ds)]
    shown = [n for n in values[0] | values[1] if n in axes or _differ(n, *values)]
    settings = [{n: x[n] for n in shown if n in x} for x in values]
    at = [own.ds.sel(dict(p)).reset_coords(drop=True) for own, p in both]
    merits = [own.merit.sel(dict(p)).reset_coords(drop=True) for own, p in both]
    lost = [int(own.lost.sel(dict(p))) for own, p in both]
    return _Pair(
        kind=kind,
        setting=settings[0],
        other=settings[1],
        first=at[0],
        second=at[1],
        merits=(merits[0], merits[1]),
        lost=(lost[0], lost[1]),
        worst=min(float(own.once(standstill).min()) for own in (one, two)),
        choices=choices,
    )


def _swept(ds: xr.Dataset) -> list[str]:
    """The hyperparameters of which several values were tried."""
    tried = [values for _, values in _settings(ds)]
    return [name for name in tried[0] if len({str(values[name]) for values in tried}) > 1]


def _differ(name: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return name in one and name in other and _plain(one[name]) != _plain(other[name])


# --- bits --------------------------------------------------------------------------------------------
def _same_bits(pair: _Pair) -> tuple[int | None, Place | None]:
    """How many runs of the seeds that both have are the same, and where the first other one begins to differ."""
    common, one, two = pair.common, pair.first, pair.second
    if pair.setting != pair.other and pair.kind != "setting":
        return (None, None)
    if not len(common):
        return 0, None
    if one.attrs.get("log_every") != two.attrs.get("log_every"):
        return None, None
    rows = min(one.sizes["row"], two.sizes["row"])
    whole = one.sizes["row"] == two.sizes["row"]
    names = [str(n) for n in one.data_vars if n in two.data_vars and "seed" in one[n].dims]
    logged = [n for n in names if "row" in one[n].dims]
    alike, first = np.ones(len(common), bool), None
    places: list[tuple[int, float, Place]] = []
    for name in [*logged, *([n for n in names if n not in logged] if whole else [])]:
        x, y = (_of_seeds(ds[name], common, rows) for ds in (one, two))
        if x.shape != y.shape or x.dtype != y.dtype:
            return None, None
        other = _as_bits(x) != _as_bits(y)
        alike &= ~other.any(1)
        if other.any():
            run, place = (int(i) for i in np.argwhere(other)[0])
            row = place // (x.shape[1] // rows) if name in logged else None
            there = Place(int(common[run]), row, name, float(x[run, place]), float(y[run, place]))
            places.append((run, np.inf if row is None else row, there))
    if places:
        first = min(places, key=lambda place: place[:2])[2]
    return int(alike.sum()), first


def _of_seeds(x: xr.DataArray, seeds: np.ndarray, rows: int) -> np.ndarray:
    """The numbers of these seeds, [seed, row x ...], of the first rows."""
    x = x.sel(seed=seeds).transpose("seed", *(["row"] if "row" in x.dims else []), ...)
    return (x.isel(row=slice(rows)) if "row" in x.dims else x).values.reshape(len(seeds), -1)


def _as_bits(x: np.ndarray) -> np.ndarray:
    """Numbers as their bits, so that NaN is itself, and 0 is not −0."""
    return np.ascontiguousarray(x).view(f"u{x.dtype.itemsize}") if x.dtype.kind == "f" else x


def _is_same(pair: _Pair, same: int | None) -> bool:
    """Whether all runs that both have are the same, and none of them is longer."""
    lengths = [[ds.attrs.get(key) for key in LENGTHS] for ds in (pair.first, pair.second)]
    return bool(same) and same == len(pair.common) and lengths[0] == lengths[1]


# --- better or worse ---------------------------------------------------------------------------------
class _Test(NamedTuple):
    """The second setting against the first, in scores of which higher is better.

    Attributes:
        gain, low, high: the mean difference, second less first, and its interval.
        p: of "there is no difference".
        means: the mean score of each.
        paired: whether they were compared seed by seed.
        by_loss: 1 or −1 where it is not the scores that decide, but that fewer or more runs are lost; else 0.
    """

    gain: float
    low: float
    high: float
    p: float
    means: tuple[float, float]
    paired: bool
    by_loss: int


def _tested(pair: _Pair, confidence: float) -> _Test:
    x, y = pair.merits
    common = pair.common
    paired = len(common) >= FEWEST
    by_loss = _lost_p(pair) if pair.lost[0] != pair.lost[1] else np.nan
    tests = pair.choices * (1 if np.isnan(by_loss) else 2)  # of scores and of losses, and of all choices
    if paired:
        x, y = x.sel(seed=common), y.sel(seed=common)
    compare = paired_difference if paired else unpaired_difference
    (gain, low, high, _), p, _ = compare(y, x, confidence=1 - (1 - confidence) / tests, worst=pair.worst)
    least = float(np.fmin(p, by_loss))
    sign = int(np.sign(pair.lost[0] - pair.lost[1])) if by_loss == least else 0
    p = float(np.minimum(1, tests * least))
    means = float(x.mean()), float(y.mean())
    return _Test(float(gain), float(low), float(high), p, means, paired, sign)


def _lost_p(pair: _Pair) -> float:
    """p of "as many runs are lost in both", by Fisher's exact test."""
    from scipy import stats  # here, because it takes half a second

    sizes = [ds.sizes["seed"] for ds in (pair.first, pair.second)]
    kept = [n - lost for n, lost in zip(sizes, pair.lost, strict=True)]
    return float(stats.fisher_exact([pair.lost, kept])[1])  # pyright: ignore[reportArgumentType]
