"""Whether what was seen to happen is what an environment states: Pearson's chi-squared test."""

import numpy as np
from scipy import stats


def p_value(count: np.ndarray, expected: np.ndarray, groups: int = 1) -> float:
    """The probability of counts as far from `expected` as these; what cannot happen must not have happened.

    Cells of which fewer than five are expected are counted as one. `groups` is how many numbers of trials
    were given: so many counts follow from the others.
    """
    assert (count[expected == 0] == 0).all()
    rare = expected < 5
    count, expected = (np.append(x[~rare], x[rare].sum()) for x in (count, expected))
    statistic = ((count - expected) ** 2 / np.where(expected > 0, expected, 1)).sum()
    return stats.chi2.sf(statistic, (expected > 0).sum() - groups)


def p_value_of_transitions(model, s, a, reward, s_next) -> float:
    """`p_value` of transitions, arrays [n] each, under a planning.Model, given how often each (s, a) was."""
    rewards = np.unique(np.append(model.reward, reward))
    count, expected = np.zeros((2, *model.prob.shape[:2], len(model.prob), len(rewards)))
    np.add.at(count, (s, a, s_next, np.searchsorted(rewards, reward)), 1)
    trials = count.sum((2, 3))
    index = (x[..., None] for x in np.ogrid[: model.prob.shape[0], : model.prob.shape[1]])
    cells = (*index, model.s_next, np.searchsorted(rewards, model.reward))
    np.add.at(expected, cells, trials[..., None] * model.prob)
    return p_value(count, expected, (trials > 0).sum())
