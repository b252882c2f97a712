"""From the raw numbers of every seed to means with intervals, comparisons, curves and a summary table.

Everything works on the datasets that `SweepResult.to_xarray` gives, also after a round trip through netCDF,
and on arrays with named axes made from them. The seed is the unit of replication: numbers are first made one
per seed, then intervals are taken over seeds. Their axis is named, and an array without it is refused.

Which interval. This is how often a 95% interval of the mean held the true mean, in per cent, for samples of
10, 30 and 100 (40 000 of each, of bootstraps 10 000; standard error at most 0.2, of the lowest 0.4):

    method       normal            exponential       gamma(1/2)        lognormal(1/2)    lognormal(1)
    hall         96.2  95.7  95.2  94.9  95.9  95.9  94.6  96.0  96.2  94.9  95.4  95.7  92.1  94.0  95.2
    t            95.0  95.2  95.1  89.7  92.7  94.0  86.1  90.8  93.5  92.2  93.5  94.2  84.1  88.2  91.4
    percentile   90.5  93.5  94.8  85.8  91.9  93.5  82.1  89.7  93.0  87.9  92.0  94.2  80.1  87.6  91.9
    bca          90.1  93.5  94.7  87.3  92.5  93.8  85.0  91.0  93.6  88.5  92.3  94.3  82.7  88.9  92.3
    bootstrap-t  95.3  95.0  95.3  93.8  94.8  94.7  93.3  94.3  94.8  94.1  94.3  95.0  91.1  92.3  93.9

The percentile bootstrap and BCa fall short with ten seeds even of normal values, Student's t where values are
skewed. The default of `mean_interval` is "hall": it is between 93% and 97% everywhere but for ten values of
the lognormal(1), which has skewness 6 and where no method tried reaches 93%. Of ten normal values it is 18%
longer than Student's, of thirty 3%, of a hundred 1%. No interval knows of what no seed has shown: where one
run in five fails, ten seeds show no failure at all in 11% of experiments.

These are smooth distributions. Where single runs of a method get stuck the mean's interval falls short, at
ten seeds as far as to 66%: `score_interval` detects that and has the table; median and interquartile mean hold.

Unfinished and diverged runs. `score` says how runs count that finished no episode in the last tenth, and where
a dataset says which runs `diverged`, bool [*hyperparameters, seed], how those do: no run is left out where
settings are compared. The returns, errors and curves of diverged runs are NaN elsewhere, and so left out of
means and medians, whose `n` is smaller by them. Where the question is how often a run is good they count as
bad: they never reach a threshold (`time_to_threshold`), and with `final_return` they exceed no score
(`performance_profile`) and lose against any other run (`probability_of_improvement`).
"""

from jaxrl_tab.stats.along import MEMORY, Interval
from jaxrl_tab.stats.bootstrap import RESAMPLES, bootstrap_interval, iqm, iqm_interval
from jaxrl_tab.stats.column import Column
from jaxrl_tab.stats.columns import COLUMNS, Methods, summary
from jaxrl_tab.stats.comparisons import (
    Difference,
    holm,
    paired_difference,
    performance_profile,
    probability_of_improvement,
    proportion_interval,
    seeds_needed,
    unpaired_difference,
)
from jaxrl_tab.stats.deciding import Pair, Verdict, decide, looks, scored, until_decided
from jaxrl_tab.stats.early import (
    Early,
    better_early,
    by_length,
    early_score,
    first_episode,
    first_tenth,
    interim_return,
    pace,
    steps_per_episode,
)
from jaxrl_tab.stats.intervals import (
    mean_interval,
    median_interval,
    seeds_wanted,
    simultaneous_interval,
    tolerance_interval,
    unseen,
)
from jaxrl_tab.stats.measures import (
    NOT_SWEPT,
    SOFT_STATES,
    Measure,
    area_under_curve,
    curve_interval,
    drawn,
    episode_curve,
    final_return,
    fixed,
    hyperparameters,
    is_prediction,
    last_tenth,
    learning_curve,
    mean_return,
    merge_rows,
    named,
    optimum,
    possible,
    progress_interval,
    score,
    soft_optimum,
    standstill,
    time_to_threshold,
    unfinished,
)
from jaxrl_tab.stats.pilot import seeds_from_pilot
from jaxrl_tab.stats.settings import (
    Selection,
    at_edge,
    best,
    differences,
    pairs_to_correct,
    ranked,
    score_interval,
    selection,
    tied,
)
from jaxrl_tab.stats.tasks import (
    Tasks,
    across_tasks,
    mean_improvement,
    mean_rank,
    normalised,
    random_value,
)

__all__ = [
    "COLUMNS",
    "MEMORY",
    "NOT_SWEPT",
    "RESAMPLES",
    "SOFT_STATES",
    "Column",
    "Difference",
    "Early",
    "Interval",
    "Measure",
    "Methods",
    "Pair",
    "Selection",
    "Tasks",
    "Verdict",
    "across_tasks",
    "area_under_curve",
    "at_edge",
    "best",
    "better_early",
    "bootstrap_interval",
    "by_length",
    "curve_interval",
    "decide",
    "differences",
    "drawn",
    "early_score",
    "episode_curve",
    "final_return",
    "first_episode",
    "first_tenth",
    "fixed",
    "holm",
    "hyperparameters",
    "interim_return",
    "iqm",
    "iqm_interval",
    "is_prediction",
    "last_tenth",
    "learning_curve",
    "looks",
    "mean_improvement",
    "mean_interval",
    "mean_rank",
    "mean_return",
    "median_interval",
    "merge_rows",
    "named",
    "normalised",
    "optimum",
    "pace",
    "paired_difference",
    "pairs_to_correct",
    "performance_profile",
    "possible",
    "probability_of_improvement",
    "progress_interval",
    "proportion_interval",
    "random_value",
    "ranked",
    "score",
    "score_interval",
    "scored",
    "seeds_from_pilot",
    "seeds_needed",
    "seeds_wanted",
    "selection",
    "simultaneous_interval",
    "soft_optimum",
    "standstill",
    "steps_per_episode",
    "summary",
    "tied",
    "time_to_threshold",
    "tolerance_interval",
    "unfinished",
    "unpaired_difference",
    "unseen",
    "until_decided",
]


def __dir__() -> list[str]:
    return __all__
