"""Settings of an experiment run again, to record what their runs had learned on the way.

A run depends on its seed and its hyperparameters alone, to the last bit. So what is wanted of few runs need not be
recorded of all.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxrl_tab.engine.axes import DRAW
from jaxrl_tab.engine.budget import AtPoints
from jaxrl_tab.engine.counted import Counted, TablesAndVisits
from jaxrl_tab.engine.part import Part, compute
from jaxrl_tab.experiment.spec import Experiment, as_toml
from jaxrl_tab.show.explorer.over_time import OverTime


@dataclasses.dataclass(frozen=True)
class RunAgain:
    """Runs settings of these parts again: see `over_time.Again`.

    Attributes:
        parts: what was run, by the labels "ENVIRONMENT/METHOD".
        memory: how many bytes a run may take, as in `sweep`.
    """

    parts: Mapping[str, Part]
    memory: int | None = None

    def __call__(
        self, name: str, setting: int, places: np.ndarray, every: int, points: np.ndarray | None = None
    ) -> OverTime:
        part, counts = self.parts[name], points is None
        config = part.configs[setting]
        budget = dataclasses.replace(
            part.budget,
            log_every=part.budget.row * every,
            exact=False,
            exact_every=None,
            record=TablesAndVisits(part.env.num_states) if points is None else AtPoints.of_array(points),
        )
        one: Any = [Counted(config) if counts else config]
        recorded = compute(
            dataclasses.replace(part, axes={}, configs=one, budget=budget), places, memory=self.memory
        ).log.recorded
        assert recorded is not None
        return OverTime(np.asarray(recorded["table"]), np.asarray(recorded["visits"]) if counts else None)


def toml_of_settings(experiment: Experiment) -> dict[str, str]:
    """For each part, by its label, an experiment of one setting as TOML, without what was swept.

    Its last lines are those of the method, so that the values of a setting can follow.
    """
    data = experiment.data()
    texts = {}
    for name, part in experiment.parts().items():
        label, _, method = name.partition("/")
        swept = {key for axis, values in part.axes.items() for key in ([axis] if axis != DRAW else values[0])}
        own = next(table for table in data["method"] if table["label"] == method)
        own = {key: value for key, value in own.items() if key not in {*swept, "draws", DRAW}}
        environment = [table for table in data["environment"] if table["label"] == label]
        top = {key: value for key, value in data.items() if key != "select"}
        texts[name] = as_toml(top | {"environment": environment, "method": [own]})
    return texts
