"""Two doors (lecture 5, "Example of greedy action selection")."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import TOLERANCE, Numbers, assign, first, unbatched
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree
from jaxrl_tab.envs.bandit import Bandit


@pytree
class TwoDoors(Bandit):
    """Open one of two doors for a prize; a greedy agent can stay with the worse door for ever.

    In the lecture the left door gives 0 when it is first opened, and the right one 1, then 3, then 2: greedy
    behaviour opens the right one from then on, and never learns what else may be behind the left one. Here
    the left door hides 6 half of the time and nothing else, which is 3 on average; the right one 1, 2 or 3,
    which is 2. Actions are left and right. All three rows are leaves: `vmap` can batch them.
    """

    prizes: Numbers = field(default=(0.0, 1.0, 2.0, 3.0, 6.0), at_least=0, help="The possible rewards, [K].")
    left: Numbers = field(
        default=(0.5, 0.0, 0.0, 0.0, 0.5),
        at_least=0,
        help="The probability of each prize behind the left door, [K].",
    )
    right: Numbers = field(
        default=(0.0, 0.25, 0.5, 0.25, 0.0),
        at_least=0,
        help="The probability of each prize behind the right door, [K].",
    )

    num_actions = 2

    def __post_init__(self):
        who, shape = type(self).__name__, np.shape(self.prizes)
        if not shape or not shape[-1]:
            raise InputError(
                f"prizes must be a row of one number or more, not of shape {shape}", who=who, field="prizes"
            )
        left, right = (_door(who, what, getattr(self, what), shape[-1]) for what in ("left", "right"))
        assign(self, left=left, right=right)

    @property
    def action_names(self) -> tuple[str, ...]:
        return "left", "right"

    def rewards(self, a: Int[Array, ""]) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        prizes, left, right = (unbatched(self, what, ndim=1) for what in ("prizes", "left", "right"))
        return jnp.where(a == 0, left, right), prizes

    def lock_in_probability(self) -> float:
        """The probability that a greedy agent opens the worse door for ever, from some play on.

        The agent's values are sample averages, 0 before the first play, and ties are broken uniformly. While
        both averages are 0 each door is opened with probability 1/2. The first prize above 0 makes the
        average of its door positive, and no prize can make it 0 again: the other door, whose average is 0,
        is never opened from then on. So the door that is first to pay is the choice for ever. A door pays
        with probability p, the sum over its prizes above 0. A play before that is decided by the worse door
        with probability p_worse / 2, by the better one with p_better / 2, and by neither otherwise: then the
        next play is like it. So the worse door is the choice for ever with probability

            p_worse / (p_worse + p_better).

        It depends on how often the doors pay and not on how much. Where the means are equal (to 1e-6, the
        precision to which probabilities are taken) no door is the worse one, and the answer is 0.
        """
        prizes, *doors = (np.asarray(x) for x in (self.prizes, self.left, self.right))
        mean = [door @ prizes for door in doors]
        pays = [door @ (prizes > 0) for door in doors]
        if np.isclose(*mean, rtol=TOLERANCE, atol=0):
            return 0.0
        return float(pays[np.argmin(mean)] / sum(pays))


def _door(who: str, what: str, prob: Any, count: int) -> Any:
    """The probabilities of so many prizes behind a door, scaled to add up to 1 exactly."""
    if (shape := np.shape(prob))[-1:] != (count,):
        problem = f"{what} must have one probability for each of the {count} prizes, not shape {shape}"
        raise InputError(problem, who=who, field=what)
    if not isinstance(prob, np.ndarray):
        return prob
    total = prob.sum(-1, keepdims=True)
    if (i := first(abs(total - 1) > TOLERANCE)) is not None:
        problem = f"the probabilities of {what} add up to {total[i]:.6g}, not to 1"
        raise InputError(problem, who=who, field=what)
    return prob / total
