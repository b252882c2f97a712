"""The k-armed test bed (book, section 2.3)."""

import dataclasses
import math
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import tables
from jaxrl_tab.core.checks import Numbers, assign, unbatched
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.envs.bandit import NormalBandit


@pytree
class KArmedTestbed(NormalBandit):
    """Pull one of several arms, whose rewards are normal around means that are drawn anew for each run.

    The mean q*(a) of each arm is drawn from N(0, 1) once for a problem, and a reward from N(q*(a), 1) for a
    play. `train` draws a problem for each run, from its key. Before that, `means` are those of the mean
    problem: 0. `outcomes` gives the mean of the reward, `step` adds the noise. `means` is a leaf: `vmap` can
    batch it.
    """

    arms: int = static(default=10, at_least=1, help="Number of arms.")
    means: Numbers = field(
        default=0.0, help="q*, the mean reward of each arm without `shift`, [arms], or one number for all."
    )

    shift: float = field(default=0.0, help="What is added to every reward (book, figure 2.5: 4).")

    def __post_init__(self):
        if isinstance(self.means, np.ndarray) and self.means.ndim == 0:
            assign(self, means=np.full(self.arms, self.means))
        if (shape := np.shape(self.means))[-1:] != (self.arms,):
            problem = f"means must have one number for each of the {self.arms} arms, not shape {shape}"
            raise InputError(problem, who=type(self).__name__, field="means")

    def instance(self, key: Key[Array, ""]) -> Self:
        """The environment with a problem drawn from `key`: means from N(0, 1), float [arms]."""
        return dataclasses.replace(self, means=jax.random.normal(key, (self.arms,)))

    @property
    def num_actions(self) -> int:
        return self.arms

    def rewards(self, a: Int[Array, ""]) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
        means = unbatched(self, "means", ndim=1)
        return jnp.ones(1), (tables.entry(means, jnp.asarray(a, jnp.int32)) + self.shift)[None]

    def mean_optimal_value(self, gamma: float) -> float:
        """The mean over problems of v* from the start; a play is one step, so gamma does not matter."""
        return self.expected_best_mean()

    def expected_best_mean(self) -> float:
        """The mean over problems of max_a q*(a), for comparison with learned rewards; 1.538753 for 10 arms.

        It is `shift` and the integral of x n phi(x) Phi(x)^(n-1), with the density phi and the distribution Phi of
        N(0, 1): by the trapezoidal rule, which for such a function is exact to rounding.
        """
        x, width = np.linspace(-12, 12, 2401, retstep=True)
        density = np.exp(-(x**2) / 2) / math.sqrt(2 * math.pi)
        below = np.array([math.erfc(-y / math.sqrt(2)) / 2 for y in x])
        return self.shift + float((x * self.arms * density * below ** (self.arms - 1)).sum() * width)
