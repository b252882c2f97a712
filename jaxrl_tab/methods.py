"""All methods by their names: control and prediction, by tables and by features."""

from collections import ChainMap
from collections.abc import Mapping

from jaxrl_tab import algorithms, approx
from jaxrl_tab.algorithms import prediction
from jaxrl_tab.core import names
from jaxrl_tab.core.declared import Learns, of_method
from jaxrl_tab.core.errors import nearest

ALGORITHMS: dict[str, type] = algorithms.CONTROL | approx.CONTROL
PREDICTION: dict[str, type] = prediction.OF_STATES | approx.OF_STATES
# The methods of control come first, for a ChainMap begins with its last map.
METHODS: Mapping[str, type] = ChainMap(PREDICTION, ALGORITHMS)


METHOD = names.Kind(
    noun="a method",
    registry=METHODS,
    group="jaxrl_tab.methods",
    needs=("gamma", "init", "policy", "update"),
    add=lambda name, cls: (PREDICTION if of_method(cls).learns is Learns.STATES else ALGORITHMS).__setitem__(
        name, cls
    ),
    hint=lambda name: nearest(name, METHODS),
)
