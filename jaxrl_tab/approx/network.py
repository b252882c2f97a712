"""A small neural network: layers of linear functions, with a bent line between them (book, section 9.7)."""

import math
from typing import Any, Literal, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jaxrl_tab.approx.observed import check_tuple
from jaxrl_tab.core.errors import InputError, reason, shown
from jaxrl_tab.core.optax import read_call
from jaxrl_tab.core.pytree import checked_dataclass, static

ACTIVATIONS = {"relu": jax.nn.relu, "tanh": jnp.tanh}


class Layer(NamedTuple):
    """The weights of a layer.

    Attributes:
        w: float [inputs, outputs].
        b: what is added, float [outputs].
    """

    w: Float[Array, "n m"]
    b: Float[Array, " m"]


Weights: TypeAlias = tuple[Layer, ...]


@checked_dataclass
class MLP:
    """A multilayer perceptron, as text "mlp(64, 64)": layers of so many units, and one of an output for each action.

    Its first weights are uniform, with mean 0 and variance 2 / inputs of a layer with relu (He et al. 2015), 1 / inputs
    of one with tanh, and of the last (LeCun et al. 1998).
    """

    widths: tuple[int, ...] | int = static(default=(64, 64), help="How many units each hidden layer has.")
    activation: Literal["relu", "tanh"] = static(
        default="relu", help="What each unit does with its sum: max(0, x), or tanh x."
    )

    def __post_init__(self):
        check_tuple(self, "widths", "whole numbers of at least 1", 1)

    def init(self, key: Key[Array, ""], inputs: int, outputs: int) -> Weights:
        """The first weights."""
        sizes = [inputs, *self._widths, outputs]
        keys = jax.random.split(key, len(sizes) - 1)
        hidden = 2 if self.activation == "relu" else 1

        def layer(i: int) -> Layer:
            n, m = sizes[i], sizes[i + 1]
            end = math.sqrt(3 * (hidden if i < len(self._widths) else 1) / n)
            return Layer(jax.random.uniform(keys[i], (n, m), minval=-end, maxval=end), jnp.zeros(m))

        return tuple(layer(i) for i in range(len(sizes) - 1))

    def __call__(self, weights: Weights, x: Float[Array, " n"]) -> Float[Array, " m"]:
        """The outputs for one input."""
        *hidden, last = weights
        for layer in hidden:
            x = ACTIVATIONS[self.activation](x @ layer.w + layer.b)
        return x @ last.w + last.b

    @property
    def _widths(self) -> tuple[int, ...]:
        widths: Any = self.widths  # a tuple, once it is made
        return widths

    def __str__(self) -> str:
        more = [] if self.activation == "relu" else [f"activation={self.activation!r}"]
        return f"mlp({', '.join([*map(str, self._widths), *more])})"


def read(written: Any) -> MLP:
    """A network from its text, "mlp(64, 64)" or "mlp(32, activation='tanh')", or itself.

    Raises:
        InputError: it is none; the message says what would be right.
    """
    if isinstance(written, MLP):
        return written
    what = "a network with the widths of its hidden layers, such as mlp(64, 64)"
    if not isinstance(written, str):
        raise InputError(f"{shown(written)} is not {what}")
    name, widths, keywords = read_call(written, what, takes_more=True)
    if name != "mlp":
        raise InputError(f"{shown(written)} is not {what}")
    try:
        return MLP(**({"widths": tuple(widths)} if widths else {}), **keywords)
    except TypeError as error:
        raise InputError(f"{shown(written)}: {reason(error)}; mlp takes widths and activation") from None
