"""The taxi (Dietterich 2000, section 3.1; Gymnasium's Taxi)."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from jaxrl_tab.core import policies
from jaxrl_tab.core.checks import unbatched
from jaxrl_tab.core.pytree import field, pytree, static
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import TIME_LIMIT, Finite, Panel

# A bar is a wall between two cells; R, G, Y and B are the stands.
MAP = ("R: | : :G", " : | : : ", " : : : : ", " | : | : ", "Y| : |B: ")
SIDE, STANDS = 5, "RGYB"
CELLS = SIDE * SIDE
IN_TAXI = len(STANDS)  # where the passenger is who is at no stand
STATES = CELLS * (len(STANDS) + 1) * len(STANDS)
ACTIONS = "↓", "↑", "→", "←", "pick", "drop"
PICK_UP, DROP_OFF = 4, 5
MOVES = ((1, 0), (-1, 0), (0, 1), (0, -1))  # (down, right) of the first four
SIDES = ((2, 3), (3, 2), (1, 0), (0, 1))  # to the left and to the right of each of them


def _after() -> np.ndarray:
    """The cells to which each action leads from each cell, int32 [25, 6, 3]: as it should, and to its two sides.

    A wall and the edge stop a move; where they stop it as it should go, it does not go to its sides either.
    """
    after = np.empty((CELLS, len(ACTIONS), 3), np.int32)
    for cell, a in np.ndindex(CELLS, len(ACTIONS)):
        straight = _moved(cell, a)
        sides = [_moved(cell, side) for side in SIDES[a]] if straight != cell else [cell, cell]
        after[cell, a] = straight, *sides
    return after


def _moved(cell: int, a: int) -> int:
    if a >= len(MOVES):
        return cell
    (row, column), (down, right) = divmod(cell, SIDE), MOVES[a]
    is_inside = 0 <= row + down < SIDE and 0 <= column + right < SIDE
    is_open = is_inside and (right == 0 or MAP[row][2 * column + right] == ":")
    return cell + SIDE * down + right if is_open else cell


AFTER = _after()
STAND_AT = np.array([STANDS.find(MAP[row][2 * column]) for row, column in np.ndindex(SIDE, SIDE)], np.int32)
CELL, PASSENGER, AIM = (x.ravel() for x in np.indices((CELLS, IN_TAXI + 1, len(STANDS))))  # of each state
STARTS = np.flatnonzero((PASSENGER != IN_TAXI) & (PASSENGER != AIM)).astype(np.int32)
ENDS = (PASSENGER == AIM) & (STAND_AT[CELL] == AIM)


@pytree
class Taxi(Finite):
    """Fetch a passenger from one of four stands to another, in a small town with walls.

    It is Gymnasium's Taxi-v4, state by state, and without rain and fickleness Taxi-v3 as well. Every step costs 1,
    picking up or dropping off where that is not possible 10; the right delivery gives 20 and ends the episode. At
    another stand the passenger can be let out, and waits there. Episodes start with the taxi anywhere and the passenger
    at any stand but the one to go to. Actions are down, up, right, left, pick up, drop off.

    States are numbered ((5 row + column) 5 + passenger) 4 + goal. The passenger is at stand 0 to 3 (R, G, Y, B) or in
    the taxi, 4; the goal is a stand. From the start 404 of the 500 can be reached. With gamma 1 the optimal value is
    7.93.

    In the rain a move goes to its left or its right instead, half of the time that it does not go right; where a wall
    or the edge stops the move itself, the taxi stays. A fickle passenger may want to go to one of the three other
    stands instead, each as likely, with the first move in the taxi that leads anywhere, and never again. Gymnasium
    draws at the start of an episode whether that will be, and hides it, so that its 500 states do not say what may
    happen. Here that first move draws it, which comes to the same; the states from 500 on, in the same order, are those
    after it.
    """

    is_rainy: bool = static(default=False, help="Whether moves can go wrong.")
    rainy_probability: float = field(
        default=0.8, at_least=0, at_most=1, help="In the rain, the probability that a move goes right."
    )
    fickle_passenger: bool = static(default=False, help="Whether the passenger may want to go elsewhere.")
    fickle_probability: float = field(
        default=0.3, at_least=0, at_most=1, help="The probability that a fickle passenger does."
    )
    max_steps: int = static(default=200, at_least=1, help=TIME_LIMIT)

    num_actions = len(ACTIONS)

    @property
    def num_states(self) -> int:
        return 2 * STATES if self.fickle_passenger else STATES

    @property
    def action_names(self) -> tuple[str, ...]:
        return ACTIONS

    def panels(self) -> tuple[Panel, ...]:
        """The town, for each place and goal of a passenger who is not there yet: "R → G", "taxi → G"."""
        cells, names = np.arange(CELLS).reshape(SIDE, SIDE), tuple(map(str, range(SIDE)))
        tables = []
        for passenger, goal in np.argwhere(~np.eye(IN_TAXI + 1, len(STANDS), dtype=bool)):
            where = "taxi" if passenger == IN_TAXI else STANDS[passenger]
            for first in range(0, self.num_states, STATES):
                title = f"{where} → {STANDS[goal]}{' for good' if first else ''}"
                states = first + 20 * cells + 4 * passenger + goal
                tables.append(Panel(title, states, names, names, "row", "column"))
        return tuple(tables)

    def initial(self) -> Float[Array, " S"]:
        return jnp.zeros(self.num_states, dtype=float).at[STARTS].set(1 / len(STARTS))

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        return jnp.asarray(STARTS)[policies.below(key, len(STARTS))]

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        s = jnp.asarray(s, jnp.int32)
        cell, passenger, goal = s % STATES // 20, s // 4 % 5, s % 4
        stand, riding = jnp.asarray(STAND_AT)[cell], passenger == IN_TAXI
        picked_up = (a == PICK_UP) & (stand == passenger)
        let_out = (a == DROP_OFF) & riding & (stand >= 0)
        delivered = let_out & (stand == goal)
        reward = jnp.where(delivered, 20.0, jnp.where((a < PICK_UP) | picked_up | let_out, -1.0, -10.0))
        passenger_next = jnp.where(picked_up, IN_TAXI, jnp.where(let_out, stand, passenger))
        prob, cell_next = self._ways(cell, a)
        s_next = s + 20 * (cell_next - cell) + 4 * (passenger_next - passenger)
        if self.fickle_passenger:
            prob, s_next = self._wishes(prob, s_next, goal, (s < STATES) & riding & (cell_next != cell))
        over = jnp.asarray(ENDS)[s % STATES]
        s_next = jnp.where(over, s, s_next)
        reward = jnp.where(over, 0.0, reward).astype(float)
        return prob, Outcome(s_next, jnp.full(s_next.shape, reward), jnp.asarray(ENDS)[s_next % STATES])

    def _ways(self, cell: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " W"], Int[Array, " W"]]:
        """The cells to which action `a` may lead, and how likely each is: in the rain three, else one."""
        after = jnp.asarray(AFTER)[cell, a]
        if not self.is_rainy:
            return jnp.ones(1), after[:1]
        right = jnp.where(a < PICK_UP, unbatched(self, "rainy_probability", ndim=0), 1.0)
        return jnp.stack([right, (1 - right) / 2, (1 - right) / 2]), after

    def _wishes(
        self,
        prob: Float[Array, " W"],
        s_next: Int[Array, " W"],
        goal: Int[Array, ""],
        first: Bool[Array, " W"],
    ) -> tuple[Float[Array, " K"], Int[Array, " K"]]:
        """The same with each goal that the passenger may then have, where it is the `first` move in the taxi."""
        goals = jnp.arange(len(STANDS), dtype=jnp.int32)
        fickle = unbatched(self, "fickle_probability", ndim=0)
        changed = jnp.where(first, fickle, 0.0)[:, None]
        of_goal = jnp.where((goals == goal)[None], 1 - changed, changed / (len(STANDS) - 1))
        s_next = (s_next + jnp.where(first, STATES, 0))[:, None] + (goals - goal)[None]
        return (prob[:, None] * of_goal).ravel(), s_next.ravel()
