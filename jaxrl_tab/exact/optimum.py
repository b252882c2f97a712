"""The best policy of an environment, worked out once."""

import numpy as np
from jaxtyping import Bool, Float

from jaxrl_tab.core.checks import first
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact.model import (
    Model,
    backup,
    ending_at,
    exact_model,
    name_of,
    once_for_an_environment,
    reachable,
    with_sizes,
)
from jaxrl_tab.exact.values import MAX_ROUNDS, ROUNDING, Round, iterate_policies


@once_for_an_environment(
    like=(Model(*[None] * len(Model._fields)), Round(*[None] * len(Round._fields)), None)
)
def solved(env: Environment, epsilon: float, gamma: float) -> tuple[Model, Round, Bool[np.ndarray, " S"]]:
    """The model, the last round of policy iteration in it, and which states were left out of both.

    Left out is what cannot be reached, where nothing else has no finite value. Raises InputError where there
    is no finite answer.
    """
    model = exact_model(env)
    last, out = iterate_policies(model, epsilon, gamma), np.zeros(len(model.start), bool)
    if last.caught.any() and not (last.caught & (is_reachable := reachable(model))).any():
        out = ~is_reachable
        model = ending_at(model, out)
        last = iterate_policies(model, epsilon, gamma)
    if last.caught.any():
        where, who = (
            f"{name_of(env)}: from state {first(last.caught)[0]}",
            "epsilon-soft " if epsilon else "",
        )
        why = (
            "a round trip earns more than it costs"
            if last.n
            else f"no {who}policy ever ends and rewards go on"
        )
        rate = of_environment(env).discount
        own = f", as the {rate:g} that its source states" if rate not in (None, 1) else ""
        raise InputError(
            f"{where} {why}, so at gamma = 1 the optimal value is not finite; take gamma below 1{own}"
        )
    if last.better.any():
        raise InputError(f"{name_of(env)}: policy iteration did not settle in {MAX_ROUNDS} rounds")
    return model, last, out


def rounding(model: Model, last: Round, gamma: float) -> Float[np.ndarray, " S"]:
    """What a sweep over the best values may change by rounding alone, float64 [S], judged state by state."""
    terms = (last.probs * backup(with_sizes(model), abs(last.v), gamma)).sum(1)
    return ROUNDING * np.finfo(last.v.dtype).eps * terms


def unless(out: Bool[np.ndarray, " S"], values: Float[np.ndarray, "S *A"]) -> Float[np.ndarray, "S *A"]:
    """`values`, and NaN for the states that were left out."""
    return np.where(out.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)
