"""Access control by priority in front of some servers (book, example 10.2)."""

from math import comb

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrl_tab.core.checks import Numbers, unbatched
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, Finite, Panel

ACCEPT = 1


@pytree
class AccessControl(Finite):
    """Let the customer in who is next, or turn him away: a task that does not end, for the average reward.

    Customers of several priorities stand in a queue that never empties, each priority equally likely. One who is
    accepted (action 1) while a server is free keeps a server busy and pays his priority; one who is rejected (action
    0), or finds no server free, goes away and pays nothing. Then each busy server, the new one among them, becomes
    free with a certain probability, and the next customer comes. All servers are free at the start.

    A state says how many servers are free and who comes next: free x priorities + place of the priority, 44 in all.
    """

    servers: int = static(default=10, at_least=1, help="How many servers there are.")
    priorities: Numbers = field(
        default=(1.0, 2.0, 4.0, 8.0), help="What customers pay, one number for each kind."
    )
    free: Numbers = field(
        default=0.06, at_least=0, at_most=1, help="Probability that a busy server becomes free in a step."
    )
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    num_actions = 2
    continuing = True

    def __post_init__(self):
        if (shape := np.shape(self.priorities)) == () or not shape[-1]:
            problem = f"priorities must be a row of one number or more, not of shape {shape}"
            raise InputError(problem, who=type(self).__name__, field="priorities")

    @property
    def kinds(self) -> int:
        """How many priorities there are."""
        return np.shape(self.priorities)[-1]

    @property
    def num_states(self) -> int:
        return (self.servers + 1) * self.kinds

    @property
    def action_names(self) -> tuple[str, ...]:
        return "reject", "accept"

    def panels(self) -> tuple[Panel, ...]:
        states = np.arange(self.num_states).reshape(-1, self.kinds).T
        rows = tuple(f"{x:g}" for x in np.asarray(self.priorities))
        columns = tuple(map(str, range(self.servers + 1)))
        return (Panel("", states, rows, columns, down="priority", along="free servers"),)

    def initial(self) -> Float[Array, " S"]:
        return jnp.zeros(self.num_states, dtype=float).at[-self.kinds :].set(1 / self.kinds)

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        """How many servers become free, and who comes next: [(servers + 1) x priorities]."""
        pays = unbatched(self, "priorities", ndim=1)
        free, kind = s // self.kinds, s % self.kinds
        is_served = (a == ACCEPT) & (free > 0)
        reward = jnp.where(is_served, pays[kind], 0)
        busy = self.servers - free + is_served.astype(jnp.int32)
        count = jnp.arange(self.servers + 1, dtype=jnp.int32)  # of those that become free
        p = unbatched(self, "free", ndim=0)
        chance = (
            jnp.asarray(_choose(self.servers), float)[busy]
            * p**count
            * (1 - p) ** jnp.maximum(busy - count, 0)
        )
        now_free = jnp.minimum(
            self.servers - busy + count, self.servers
        )  # more cannot be, with probability 0
        s_next = now_free[:, None] * self.kinds + jnp.arange(self.kinds, dtype=jnp.int32)[None]
        prob = jnp.repeat(chance / self.kinds, self.kinds)
        never = jnp.zeros(prob.shape, bool)
        return prob, Outcome(s_next.ravel(), jnp.full(prob.shape, reward), never)


def _choose(n: int) -> Float[np.ndarray, "N N"]:
    """k of so many, for all k up to n and all numbers up to n."""
    return np.array([[comb(busy, k) for k in range(n + 1)] for busy in range(n + 1)], float)
