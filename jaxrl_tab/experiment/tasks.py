"""What an environment has of its own in an experiment, beside its parameters: the length of its runs, and gamma.

How long it takes to learn a task, and how its rewards are discounted, belongs to the task. So a table [[environment]]
may say it, in place of what the experiment and the methods say for all others.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from jaxrl_tab.core import describe
from jaxrl_tab.core.checks import build
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.experiment.places import blame


@checked_dataclass
class Own:
    """What may stand in a table [[environment]], instead of what holds for all.

    Attributes:
        steps, episodes: how long each run is: that of the two which the experiment has.
        log_every: as in `Experiment`.
        gamma: the discount rate of all methods in this environment.
    """

    steps: int | None = field(default=None, at_least=1)
    episodes: int | None = field(default=None, at_least=1)
    log_every: int | None = field(default=None, at_least=1)
    gamma: float | None = field(default=None, at_least=0, at_most=1)

    def budget(self, of_all: Budget) -> Budget:
        """How long runs are here."""
        lengths = {"num_steps": self.steps, "num_episodes": self.episodes, "log_every": self.log_every}
        return dataclasses.replace(of_all, **{key: x for key, x in lengths.items() if x is not None})

    def method(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """The table of a method as it is run here."""
        return table if self.gamma is None else {**table, "gamma": self.gamma}


def split(table: Mapping[str, Any], cls: type) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a table says of runs, checked, and the rest of it; a class that has such parameters takes them itself."""
    names = {f.name for f in dataclasses.fields(Own)} - {p.name for p in describe.parameters(cls)}
    own = {key: x for key, x in table.items() if key in names}
    with blame(own):
        found = dataclasses.asdict(build(Own, str(table.get("label", "environment")), own))
    return {key: found[key] for key in own}, {key: x for key, x in table.items() if key not in own}


def check(
    environments: Sequence[Mapping[str, Any]],
    classes: Sequence[type],
    methods: Sequence[Mapping[str, Any]],
    steps: int | None,
) -> None:
    """Raises InputError where an environment has a length in another unit, or a gamma beside a grid of them."""
    other = "episodes" if steps is not None else "steps"
    several = [
        table["label"]
        for table in methods
        if isinstance(table.get("gamma"), list) or any("gamma" in trial for trial in table.get(DRAW, []))
    ]
    for table, cls in zip(environments, classes, strict=True):
        own = split(table, cls)[0]
        if other in own:
            unit = "steps" if other == "episodes" else "episodes"
            raise InputError(
                f"{table['label']}: the length of these runs is a number of {unit}: give {unit}, not {other}"
            )
        if "gamma" in own and several:
            raise InputError(
                f"{table['label']} has a gamma of its own, and {several[0]} is tried with several: write it in one of "
                "the two places"
            )
