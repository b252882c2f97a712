"""Jack's car rental (book, example 4.2, and exercise 4.7)."""

import math
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core import policies
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import MAX_STEPS, TIME_LIMIT, FixedStart, Panel

REQUESTED, RETURNED = (3, 4), (3, 2)  # cars a day at the two locations, on average
PAID, MOVING, PARKING = 10, 2, 4  # for a car that is rented, that is moved, and for a second parking lot
FREE_LOT = 10  # cars that stay overnight without one


class Location(NamedTuple):
    """A day at a location, in float64 NumPy; N is the number of cars that it can have, and one more.

    Attributes:
        requested, returned: the distributions of these cars, [N]; that of N - 1 is of as many, or more.
        rented: how many are rented on average, of those that are there in the morning, [N].
        after: the distribution of the cars in the evening, of those in the morning, [N, N].
    """

    requested: Float[np.ndarray, " N"]
    returned: Float[np.ndarray, " N"]
    rented: Float[np.ndarray, " N"]
    after: Float[np.ndarray, "N N"]


@pytree
class JacksCarRental(FixedStart):
    """Rent out cars at two locations, and move some from one to the other overnight.

    A state is how many cars there are at the two locations in the evening, 0 to 20 each, numbered 21 first + second.
    An action moves cars overnight, at 2 dollars each: 0 to 10 are -5 to 5 cars from the first location to the second,
    of which there are those that the evening's cars allow. On the next day customers rent cars, at 10 dollars each,
    while there are any: as many as two Poisson variables of means 3 and 4 ask for; and bring back as many as two others
    of means 3 and 2, which can be rented from the day after. Cars beyond 20 at a location go back to the company, those
    that were moved there as well.

    It goes on for ever; the book has gamma 0.9. It leaves open where an episode starts: here with 10 cars at each, of
    which the optimal value then is 574.948324. No Poisson variable is cut off: whatever is asked for beyond the cars
    that are there comes to the same, and so does what is brought back beyond the room. A step draws all four;
    `outcomes` gives the distribution of the next evening, over all 441 states, and the mean of the reward.

    With the changes of exercise 4.7 an employee moves one car to the second location for nothing, and more than 10 cars
    that stay overnight at a location cost 4 dollars for a second parking lot.
    """

    capacity: int = static(default=20, at_least=1, help="How many cars a location can have.")
    most_moved: int = static(default=5, at_least=0, help="How many cars can be moved in a night.")
    exercise: bool = static(default=False, help="Whether it is as changed in exercise 4.7.")
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    continuing = True

    @property
    def num_states(self) -> int:
        return (self.capacity + 1) ** 2

    @property
    def num_actions(self) -> int:
        return 2 * self.most_moved + 1

    @property
    def start_state(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return (self.capacity + 2) * (self.capacity // 2)

    @property
    def action_names(self) -> tuple[str, ...]:
        return tuple(
            f"{moved:+d}" if moved else "0" for moved in range(-self.most_moved, self.most_moved + 1)
        )

    def panels(self) -> tuple[Panel, ...]:
        states = np.arange(self.num_states).reshape(self.capacity + 1, -1)
        cars = tuple(map(str, range(self.capacity + 1)))
        return (Panel("", states[::-1], cars[::-1], cars, "first", "second"),)

    def available(self, s: Int[Array, ""]) -> Bool[Array, " A"]:
        """The moves that the cars of `s` allow, bool [A]."""
        moved = jnp.arange(self.num_actions) - self.most_moved
        return (moved <= s // (self.capacity + 1)) & (-moved <= s % (self.capacity + 1))

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        cars, cost = self._overnight(s, a)
        first, second = (
            jnp.asarray(x.after, float)[n] for x, n in zip(_locations(self.capacity), cars, strict=True)
        )
        rented = sum(
            jnp.asarray(x.rented, float)[n] for x, n in zip(_locations(self.capacity), cars, strict=True)
        )
        s_next = jnp.arange(self.num_states, dtype=jnp.int32)
        reward = jnp.full(self.num_states, PAID * rented - cost)
        return jnp.outer(first, second).ravel(), Outcome(s_next, reward, jnp.zeros(self.num_states, bool))

    def step(self, key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
        cars, cost = self._overnight(s, a)
        keys = jax.random.split(key, 4)
        reward, evening = -cost, []
        for location, n, at_request, at_return in zip(
            _locations(self.capacity), cars, keys[:2], keys[2:], strict=True
        ):
            rented = jnp.minimum(policies.sample(at_request, jnp.asarray(location.requested, float)), n)
            returned = policies.sample(at_return, jnp.asarray(location.returned, float))
            reward = reward + PAID * rented.astype(float)
            evening.append(jnp.minimum(n - rented + returned, self.capacity))
        return Outcome((self.capacity + 1) * evening[0] + evening[1], reward, jnp.bool_(False))

    def _overnight(
        self, s: Int[Array, ""], a: Int[Array, ""]
    ) -> tuple[tuple[Int[Array, ""], Int[Array, ""]], Float[Array, ""]]:
        """The cars at both locations in the morning, and what the night costs."""
        s, moved = jnp.asarray(s, jnp.int32), jnp.asarray(a, jnp.int32) - self.most_moved
        cars = s // (self.capacity + 1) - moved, s % (self.capacity + 1) + moved
        paid = abs(moved) - (moved > 0) if self.exercise else abs(moved)
        cost = MOVING * paid.astype(float)
        cars = jnp.clip(cars[0], 0, self.capacity), jnp.clip(cars[1], 0, self.capacity)
        if self.exercise:
            cost = cost + sum(jnp.where(n > FREE_LOT, float(PARKING), 0.0) for n in cars)
        return cars, cost


@lru_cache
def _locations(capacity: int) -> tuple[Location, Location]:
    """Both locations."""
    first, second = (_location(capacity, *means) for means in zip(REQUESTED, RETURNED, strict=True))
    return first, second


def _location(capacity: int, requested: float, returned: float) -> Location:
    cars = np.arange(capacity + 1)
    requests, returns = _poisson(requested, capacity), _poisson(returned, capacity)
    rented = np.minimum(cars, cars[:, None])  # [morning, requested]
    after = np.zeros((capacity + 1, capacity + 1))
    evening = np.minimum(
        (cars[:, None] - rented)[..., None] + cars, capacity
    )  # [morning, requested, returned]
    np.add.at(after, (cars[:, None, None], evening), np.outer(requests, returns))
    return Location(requests, returns, rented @ requests, after)


def _poisson(mean: float, most: int) -> Float[np.ndarray, " N"]:
    """The probabilities of 0 to `most` - 1, and of `most` or more, float64 [most + 1]."""
    prob = np.array([math.exp(-mean) * mean**n / math.factorial(n) for n in range(most)])
    return np.append(prob, 1 - prob.sum())
