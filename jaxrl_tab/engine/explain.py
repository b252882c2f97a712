"""Where the methods of a sweep lose, from what their runs have learned."""

from collections.abc import Mapping

import numpy as np

from jaxrl_tab.core.declared import Learns, of_environment, of_method
from jaxrl_tab.core.errors import InputError, RunError, one_line
from jaxrl_tab.core.types import FiniteEnvironment
from jaxrl_tab.engine.acting import acting
from jaxrl_tab.engine.part import Part
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.losses import Losses, losses
from jaxrl_tab.show.explained import Explained, Explanation
from jaxrl_tab.stats.columns import Method, Methods
from jaxrl_tab.stats.measures import diverged_runs, named

# States of all policies together: so many seeds of each method are looked at, the first ones, and one at least.
MOST, IN_REPORT = 2**19, 2**14


def explain(
    methods: Mapping[str, Methods],
    parts: Mapping[str, Part],
    *,
    memory: int | None = None,
    most: int = MOST,
) -> Explanation:
    """Where methods lose what they earn less than the best policy, each at its best setting.

    Args:
        methods: those of each environment, by its name.
        parts: what was run, by "ENVIRONMENT/METHOD".
        memory: how many bytes a run may take, as in `sweep`.
        most: how many states the policies have together, at most: so many seeds are in the numbers, the first ones.
    """
    found, left_out = {}, []
    for label, own in methods.items():
        for name, method in own.settings.items():
            try:
                found[f"{label}/{name}"] = _explained(
                    label, method, parts.get(f"{label}/{name}"), memory, most
                )
            except (InputError, RunError) as error:
                left_out.append(f"{label}/{name}: {one_line(str(error))}.")
    return Explanation(found, left_out)


def _explained(label: str, own: Method, part: Part | None, memory: int | None, most: int) -> Explained:
    """Raises InputError or RunError where that cannot be told."""
    if part is None:
        raise InputError("it is not known what was run")
    env, setting = part.env, own.number_of_best
    if of_method(part.configs[setting]).learns is Learns.STATES:
        raise InputError("a method of prediction learns no policy, so there is nothing that its policy loses")
    if not isinstance(env, FiniteEnvironment) or of_environment(env).differs:
        raise InputError(
            "what is lost where needs one problem for all runs and steps, that states its outcomes"
        )
    best = own.at_best.ds
    places = np.flatnonzero(~diverged_runs(best).values)[: max(1, most // env.num_states)]
    if not len(places):
        raise InputError("all runs diverged")
    best = best.isel(seed=places)
    q = best.q.transpose("seed", "state", "action").values
    steps, episodes = (best[x].sum("row", dtype=np.int64).values for x in ("steps", "episodes"))
    gamma = float(part.configs[setting].gamma)
    greedy = q == q.max(-1, keepdims=True)
    policies = planning.greedy_policy(q)
    optimum = planning.start_value(env, planning.value_iteration(env, gamma)[0])
    probs = acting(part, setting, places, q, steps, episodes, memory)
    of: list[Losses | None] = [
        None if each is None else losses(env, gamma, zip(each, greedy, strict=True))
        for each in (probs, policies)
    ]
    assert of[1] is not None
    name = own.name
    return Explained(
        label, name, env, named(own.ds, own.best), optimum, len(places), of[0], of[1], optimum - own.soft
    )
