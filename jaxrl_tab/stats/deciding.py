"""Comparing on as many seeds as it takes: group-sequential, pair by pair, with an error rate that is held.

Methods run on common seeds, and are looked at when they have 100, 150, 200, 300, 400, ... of them (`looks`). At each
look every pair that is still open has an interval of its mean difference: `paired_difference` at a level that is so
much above 95% that *all intervals of all pairs at all looks hold at once* with 95% (repeated confidence intervals:
Jennison and Turnbull 1989, J. R. Statist. Soc. B 51, 305-361; Bonferroni over pairs). So one may stop at any look, for
any reason, and read whatever the intervals say. A pair is decided where its interval excludes 0, or holds only
differences that do not matter. Methods all of whose pairs are decided get no more seeds.

The levels spend the error equally on each doubling of the seeds (Lan and DeMets 1983, Biometrika 70, 659-663).
docs/deciding.md has the error rates and the power, from simulating all of it, and where it cannot hold.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from scipy import special

from jaxrl_tab.core.checks import FRACTION, check_within
from jaxrl_tab.core.errors import InputError, shown, whole
from jaxrl_tab.core.notebook import table
from jaxrl_tab.stats.comparisons import paired_difference
from jaxrl_tab.stats.intervals import least_of, unseen
from jaxrl_tab.stats.measures import diverged_runs, earned, has_errors, last_tenth, mean_error

FIRST, MOST = 100, 2000  # seeds at the first look and at the last
POINTS = 401  # at which the density of a path is known, between two looks

Scores = Mapping[str, Any]  # of each method the scores of its seeds so far, higher is better, [n]


def looks(first: int = FIRST, most: int = MOST) -> tuple[int, ...]:
    """The numbers of seeds at which is looked: `first`, half as many more, twice as many, and so on until `most`."""
    whole(None, "the seeds of the first look", first, 2)
    whole(None, "the most seeds", most, first)
    halves = (first * 2**k * half // 2 for k in itertools.count() for half in (2, 3))
    return (*itertools.takewhile(lambda n: n < most, halves), most)


def spent(n: int, looks: Sequence[int], error: float) -> float:
    """How much of `error` is spent by the look at n seeds: as much for each doubling, and all at the last look."""
    return error * np.log2(2 * n / looks[0]) / np.log2(2 * looks[-1] / looks[0])


@functools.lru_cache(maxsize=64)
def levels(looks: tuple[int, ...], error: float) -> tuple[float, ...]:
    """For each look 1 - the confidence of its interval, so that some of the intervals misses with probability `error`.

    For a mean of normal values with a known spread it is exact, and nearly so for others. From the density of a
    Brownian motion that has not left its bounds yet, look by look (Armitage, McPherson and Rowe 1969, J. R. Statist.
    Soc. A 132, 235-244).
    """
    place, weight, before, found = np.zeros(1), np.ones(1), 0, []
    for n in looks:
        step = np.sqrt(n - before)
        leaving = spent(n, looks, error) - (spent(before, looks, error) if before else 0)
        bound, beyond = 0.0, 12 * np.sqrt(n)
        while beyond - bound > 1e-10:
            middle = (bound + beyond) / 2
            leave = weight @ (special.ndtr((-middle - place) / step) + special.ndtr((place - middle) / step))
            bound, beyond = (middle, beyond) if leave > leaving else (bound, middle)
        new = np.linspace(-bound, bound, POINTS)
        density = np.exp(-0.5 * ((new[:, None] - place) / step) ** 2) / (step * np.sqrt(2 * np.pi)) @ weight
        width = np.full(POINTS, new[1] - new[0])
        width[[0, -1]] /= 2  # the trapezoidal rule
        place, weight, before = new, density * width, n
        found.append(float(2 * special.ndtr(-bound / np.sqrt(n))))
    return tuple(found)


def scored(ds: xr.Dataset) -> xr.DataArray:
    """The `score` of each run for `decide`: higher is better, and NaN where the run diverged, [*hyperparameters, seed].

    A number that depends on its run alone, and on no others that may be added.
    """
    score = -mean_error(ds) if has_errors(ds) else earned(ds, last_tenth(ds))
    return score.where(~diverged_runs(ds)).reset_coords(drop=True)


def repeated_interval(
    x: xr.DataArray, y: xr.DataArray, level: float, worst: float = np.inf
) -> tuple[xr.DataArray, xr.DataArray, xr.DataArray]:
    """The mean of x - y [..., seed] seed by seed, and its bounds at a look of this level, [...] each.

    It is the interval of `paired_difference`, which knows of stuck runs that no seed has shown. Where so few of the
    differences are not 0 that they could not show anything, it also holds what such differences might come to.

    A run that diverged, NaN, scores as the worst of x and y, or `worst` if that is worse: in its favour, for it is
    without bound. So what diverges more often has no bound below: it is never called better.
    """
    lost, lost_of_y = (one.isnull().sum("seed") for one in (x, y))
    fill = least_of(x.min("seed"), y.min("seed"), worst)
    fill = fill.where(np.isfinite(fill), 0)  # nothing is known of either
    x, y = x.fillna(fill), y.fillna(fill)
    (mean, low, high, n), _, _ = paired_difference(x, y, confidence=1 - level, worst=worst)
    differ = (x != y).sum("seed")
    if (few := 2.0 ** (1 - differ) > level).any():
        might = _rare(x, y, differ, n, level, worst)
        low, high = low.where(~few, np.fmin(low, -might)), high.where(~few, np.fmax(high, might))
    return mean, low.where(lost <= lost_of_y, -np.inf), high.where(lost >= lost_of_y, np.inf)


def _rare(
    x: xr.DataArray, y: xr.DataArray, differ: xr.DataArray, n: xr.DataArray, level: float, worst: float
) -> xr.DataArray:
    """How large a mean difference is that rests on few seeds: no more of them differ than Clopper and Pearson (1934)
    have it, and none by more than the scores that were seen do.

    Where all scores are the same, that is by what `worst` is below them, or else by as much as they are from 0.
    """
    share = xr.apply_ufunc(special.betaincinv, differ + 1, (n - differ).clip(min=1e-9), 1 - level / 2)
    top = np.fmax(x.max("seed"), y.max("seed"))
    span = top - least_of(x.min("seed"), y.min("seed"))
    span = xr.where(span > 0, span, top - worst if np.isfinite(worst) else abs(top))
    return share * xr.where(span > 0, span, np.inf)


class Pair(NamedTuple):
    """What is known of two methods.

    Attributes:
        first, second: their names; `first` has the better mean.
        verdict: "better": the first is; "same": they are apart by less than the difference that matters; "open".
        seeds: on how many seeds each that is so.
        difference, low, high: by how much the first has the better score, mean and interval; all such intervals hold
            at once. `low` is minus infinity where more of its runs diverged.
        stuck: of a first that is better: which share of all its runs would have to be stuck, beyond those that were
            seen, to overturn this; NaN where it is not known what a stuck run scores.
    """

    first: str
    second: str
    verdict: Literal["better", "same", "open"]
    seeds: int
    difference: float
    low: float
    high: float
    stuck: float


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What is decided about some methods, and who needs more seeds.

    Attributes:
        names: of the methods, the best first.
        pairs: what is known of each two of them.
        seeds: how many seeds of each method were used.
        wanted: the methods that need seeds up to the next look; empty where all is decided or the last look is over.
        until: how many seeds they need then; 0 where nobody needs any.
        same: the difference that matters, or 0.
        confidence: that all is right.
        diverged: how many of its runs diverged, of the methods of which some did.
    """

    names: tuple[str, ...]
    pairs: tuple[Pair, ...]
    seeds: Mapping[str, int]
    wanted: tuple[str, ...]
    until: int
    same: float
    confidence: float
    diverged: Mapping[str, int]

    def __repr__(self) -> str:
        return f"<Verdict: {self.sentence}>"

    def _repr_html_(self) -> str:
        head = ("first", "second", "verdict", "seeds", "difference", "low", "high")
        rows = [[x if isinstance(x, str) else f"{x:.4g}" for x in pair[: len(head)]] for pair in self.pairs]
        return table(f"{self.sentence}.", head, rows)

    def renamed(self, name: Callable[[str], str]) -> "Verdict":
        """The same with other names for the methods."""
        return dataclasses.replace(
            self,
            names=tuple(map(name, self.names)),
            pairs=tuple(x._replace(first=name(x.first), second=name(x.second)) for x in self.pairs),
            seeds={name(key): n for key, n in self.seeds.items()},
            wanted=tuple(map(name, self.wanted)),
            diverged={name(key): n for key, n in self.diverged.items()},
        )

    @property
    def open(self) -> tuple[Pair, ...]:
        """The pairs that are not decided."""
        return tuple(pair for pair in self.pairs if pair.verdict == "open")

    @property
    def order(self) -> str:
        """All in a line: "a > b ≈ c ? d".

        All before a > are better than all after it; ≈ is the same but for less than what matters; the others are left
        open, at least in part. What is decided there stands after it, as in "a ? b ? c, a > c".
        """
        beats, names = _beats(self.names, self.pairs), self.names
        same = {frozenset(pair[:2]) for pair in self.pairs if pair.verdict == "same"}
        line, group = names[0], [0]  # the numbers of those between two >
        for i in range(1, len(names)):
            is_cut = all(set(names[i:]) <= beats[name] for name in names[:i])
            line += (
                f" {'>' if is_cut else '≈' if frozenset(names[i - 1 : i + 1]) in same else '?'} {names[i]}"
            )
            group.append(group[-1] + is_cut)
        number = dict(zip(names, group, strict=True))
        within = [x for x in self.pairs if x.verdict == "better" and number[x.first] == number[x.second]]
        return ", ".join([line, *(f"{pair.first} > {pair.second}" for pair in within)])

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        n = sorted({self.seeds[name] for name in self.names})
        seeds = f"{n[0]} to {n[-1]} seeds" if len(n) > 1 else f"{n[0]} seeds"
        return f"{self.order}; {seeds}; error rate at most {100 * (1 - self.confidence):.3g}%"

    def notes(self, number: Callable[[float], str] = "{:.3g}".format) -> list[str]:
        """What a reader of the verdict must know, in sentences; `number` writes scores."""
        between = lambda pair: (
            f"{number(pair.difference)} ({number(pair.low)} to {number(pair.high)}; {pair.seeds} seeds)"
        )
        lines = []
        for pair in self.pairs:
            if pair.verdict == "better":
                line = f"{pair.first} is better than {pair.second} by {between(pair)}"
                if pair.stuck < 1:
                    line += f"; {100 * pair.stuck:.2g}% more of its runs stuck would overturn that"
                    line += ", which so few seeds cannot exclude" if pair.stuck < 3 / pair.seeds else ""
            elif pair.verdict == "same":
                line = f"{pair.first} and {pair.second} are apart by less than {number(self.same)}: {between(pair)}"
            else:
                line = f"{pair.first} and {pair.second} are left open: {between(pair)}"
            lines.append(f"{line}.")
        lines += [
            f"{count} {'runs' if count > 1 else 'run'} of {name} diverged: such a run scores as the worst that was "
            "seen, and what diverges more often is never called better."
            for name, count in self.diverged.items()
        ]
        fewest = min(self.seeds.values())
        return [*lines, f"What no seed has shown is not in it: {unseen(fewest)} stuck unseen."]


def decide(
    scores: Scores,
    same: float = 0.0,
    *,
    first: int = FIRST,
    most: int = MOST,
    confidence: float = 0.95,
    worst: float = np.inf,
) -> Verdict:
    """What the seeds so far decide of some methods, and who needs more: one step of `until_decided`.

    It goes over all looks from the first, so that the same scores always give the same verdict, and a verdict that was
    reached stays whatever seeds are added. What a method has beyond the last look that it takes part in is not used.

    Args:
        scores: of each method, by its name, the scores of its seeds in their order, higher is better, [n]: an array, or
            a DataArray along `seed`, whose labels must then be the same. NaN: the run diverged.
        same: the size of a difference that matters. Two methods that are surely apart by less are "the same"; with 0
            only which is better is asked.
        first, most: the seeds at the first look and at the last, see `looks`.
        confidence: that nothing in the verdict is wrong.
        worst: what a run may score at worst beside the worst one seen, such as `standstill(ds)`.

    Raises:
        InputError: an argument is out of its range, or there are not two methods, or their seeds are not the same.
    """
    check_within("confidence", confidence, FRACTION)
    check_within("same", same, {"at_least": 0})
    if not isinstance(scores, Mapping) or len(scores) < 2:
        raise InputError(f"two methods or more are compared, by their names, not {shown(scores)}")
    x = {str(name): _as_seeds(name, values) for name, values in scores.items()}
    pairs, plan = list(itertools.combinations(x, 2)), looks(first, most)
    level = levels(plan, (1 - confidence) / len(pairs))
    known: dict[tuple[str, str], Pair] = {}
    seeds = dict.fromkeys(x, 0)
    wanted: tuple[str, ...] = ()
    until = 0
    for n, p in zip(plan, level, strict=True):
        left = [pair for pair in pairs if pair not in known or known[pair].verdict == "open"]
        if not left:
            break
        active = [name for name in x if any(name in pair for pair in left)]
        if any(x[name].sizes["seed"] < n for name in active):
            wanted, until = tuple(active), n
            break
        seeds |= dict.fromkeys(active, n)
        for pair in left:
            a, b = (x[name][:n] for name in pair)
            known[pair] = _judged(pair, a, b, p, same, worst)
    used = {name: values[: seeds[name]] for name, values in x.items()}
    diverged = {name: count for name, values in used.items() if (count := int(values.isnull().sum()))}
    found = [known.get(pair) or _unknown(pair) for pair in pairs]
    names = _ordered(x, found, used)
    place = {name: i for i, name in enumerate(names)}
    found.sort(key=lambda pair: sorted((place[pair.first], place[pair.second])))
    return Verdict(names, tuple(found), seeds, wanted, until, same, confidence, diverged)


def until_decided(
    run: Callable[[Sequence[str], int, int], Scores],
    names: Sequence[str],
    same: float = 0.0,
    *,
    first: int = FIRST,
    most: int = MOST,
    confidence: float = 0.95,
    worst: float = np.inf,
    each: Callable[[Verdict], Any] | None = None,
) -> Verdict:
    """Compares methods on common seeds, as many as it takes, and adds seeds only where something is open.

    Args:
        run: gives the scores of the seeds from a number until before another, of some of the methods, by their names:
            `run(["sarsa", "q-learning"], 100, 150)` has 50 scores of each, higher is better.
        names: of all the methods.
        each: is called with the verdict at every look, such as `print`.
        same, first, most, confidence, worst: as in `decide`.

    Raises:
        InputError: as `decide`; or `run` gives other scores than it was asked for.
    """
    scores = {str(name): np.empty(0) for name in names}
    while True:
        verdict = decide(scores, same, first=first, most=most, confidence=confidence, worst=worst)
        if each and any(verdict.seeds.values()):
            each(verdict)
        if not verdict.wanted:
            return verdict
        done = len(scores[verdict.wanted[0]])
        new = run(list(verdict.wanted), done, verdict.until)
        for name in verdict.wanted:
            more = _as_seeds(name, new[name]).values
            if len(more) != verdict.until - done:
                raise InputError(
                    f"{name} has {len(more)} scores of the seeds from {done} to {verdict.until - 1}"
                )
            scores[name] = np.append(scores[name], more)


def _as_seeds(name: Any, values: Any) -> xr.DataArray:
    if isinstance(values, xr.DataArray) and values.dims == ("seed",):
        return values.astype(float).reset_coords(drop=True)
    array = np.asarray(values, float)
    if array.ndim != 1:
        raise InputError(f"the scores of {shown(name)} must be one number for each seed, not {shown(values)}")
    return xr.DataArray(array, dims="seed", coords={"seed": np.arange(len(array))})


def _judged(
    names: tuple[str, str], x: xr.DataArray, y: xr.DataArray, level: float, same: float, worst: float
) -> Pair:
    difference, low, high = map(float, repeated_interval(x, y, level, worst))
    if high < 0 or (difference < 0 and not low > 0):  # the better one first
        names, x, (difference, low, high) = (names[1], names[0]), y, (-difference, -high, -low)
    stuck = np.nan
    if low > 0:
        verdict, lost = "better", float(x.mean()) - worst  # by a run that gets stuck
        stuck = min(1.0, low / lost) if 0 < lost < np.inf else np.nan
    else:
        verdict = "same" if -same < low and high < same else "open"
    return Pair(*names, verdict, x.sizes["seed"], difference, low, high, stuck)


def _unknown(names: tuple[str, str]) -> Pair:
    return Pair(*names, "open", 0, np.nan, -np.inf, np.inf, np.nan)


def _ordered(names: Scores, pairs: Sequence[Pair], used: Mapping[str, xr.DataArray]) -> tuple[str, ...]:
    """The names, the best first: by what is decided, and what follows from it, and then by their means."""
    beats = _beats(names, pairs)
    lead = lambda name: len(beats[name]) - sum(name in others for others in beats.values())
    mean = lambda name: float(used[name].mean()) if used[name].size else 0.0
    return tuple(sorted(names, key=lambda name: (-lead(name), -mean(name))))


def _beats(names: Iterable[str], pairs: Iterable[Pair]) -> dict[str, set[str]]:
    """Whom each is better than, as is decided or follows from that."""
    found = {name: set[str]() for name in names}
    for pair in pairs:
        found[pair.first] |= {pair.second} if pair.verdict == "better" else set()
    for via in found:
        for others in found.values():
            others |= found[via] if via in others else set()
    return found
