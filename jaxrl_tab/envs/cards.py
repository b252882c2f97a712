"""What the card games share: the player takes cards until it sticks, then the dealer plays."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from jaxrl_tab.core import policies, tables
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.envs.base import Finite, Panel

STICK, HIT = 0, 1
SHOWN = 10  # that many different cards the dealer may show
DEALER_STICKS = 17  # on this sum and on all above
LIMIT = 21


class Game(NamedTuple):
    """A card game with all its probabilities worked out, in float64 NumPy.

    A state is the player's hand and the card that the dealer shows: number 10 hand + card - 1, for H hands
    and cards 1 to 10. One more state, the last, is terminal: S = 10 H + 1. K is the number of different
    draws.

    Attributes:
        hands: the distribution of the player's first hand, float64 [H].
        shown: the distribution of the card that the dealer shows, independent of it, float64 [10].
        prob: the probabilities of the outcomes, float64 [S, 2, K]. The first three of sticking are to win, to
            draw and to lose. Those of hitting are the draws, alike in all states.
        s_next: the states that they enter, int32 [S, 2, K].
        reward: their rewards, float64 [S, 2, K].
    """

    hands: Float[np.ndarray, " H"]
    shown: Float[np.ndarray, " 10"]
    prob: Float[np.ndarray, "S 2 K"]
    s_next: Int[np.ndarray, "S 2 K"]
    reward: Float[np.ndarray, "S 2 K"]

    @property
    def terminal(self) -> int:
        return len(self.prob) - 1


def compare(player: int, dealer: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 3"]:
    """The probabilities that the sum `player` wins, draws and loses, float64 [3].

    `dealer` is the distribution of where the dealer ends, float64 [6]: on 17 to 21, or bust.
    """
    *ends, bust = dealer
    sums = np.arange(DEALER_STICKS, LIMIT + 1)
    win, draw, lose = ((ends * where).sum() for where in (sums < player, sums == player, sums > player))
    return np.array([win + bust, draw, lose])


def tabulate(
    hands: Float[np.ndarray, " H"],
    shown: Float[np.ndarray, " 10"],
    draws: Float[np.ndarray, " K"],
    after: Int[np.ndarray, "H K"],
    stick: Float[np.ndarray, "H 10 3"],
    win: Float[np.ndarray, " H"],
) -> Game:
    """The `Game` in which draw k, of probability draws[k], turns hand h into hand after[h, k].

    A hand of number H or more is bust, which costs 1. To stick wins, draws and loses with the probabilities
    `stick`: a win with hand h gives win[h], a draw 0, a loss -1.
    """
    terminal = SHOWN * len(hands)
    prob, reward = np.zeros((2, len(hands), SHOWN, 2, len(draws)))
    s_next = np.full(prob.shape, terminal, np.int32)
    prob[..., STICK, :3] = stick
    reward[..., STICK, 0] = win[:, None]
    reward[..., STICK, 2] = -1
    bust = (after >= len(hands))[:, None]
    prob[..., HIT, :] = draws
    reward[..., HIT, :] = np.where(bust, -1, 0)
    s_next[..., HIT, :] = np.where(bust, terminal, SHOWN * after[:, None] + np.arange(SHOWN)[:, None])

    def with_terminal(table, row):
        return np.append(table.reshape(terminal, *row.shape), row[None], axis=0)

    end = np.full(prob.shape[-2:], terminal, np.int32)
    return Game(
        hands,
        shown,
        with_terminal(prob, prob[0, 0]),  # any distribution: all outcomes there are the same
        with_terminal(s_next, end),
        with_terminal(reward, 0.0 * end),
    )


def hands_panel(title: str, hands: Sequence[int], sums: Sequence[int], cards: Sequence[str]) -> Panel:
    """A table of the player's hands, the largest sum on top, by the card that the dealer shows.

    Args:
        title: what the hands have in common.
        hands: their numbers, in the order of their sums.
        sums: their sums, rising.
        cards: the names of the dealer's cards.
    """
    states = SHOWN * np.array(hands)[::-1, None] + np.arange(SHOWN)
    return Panel(title, states, tuple(map(str, sums[::-1])), tuple(cards), "player", "dealer shows")


class CardGame(Finite):
    """Action 0 is to stick, action 1 to hit; all else is read from a `Game`."""

    num_actions = 2

    @property
    def game(self) -> Game:
        raise NotImplementedError

    @property
    def num_states(self) -> int:
        return len(self.game.prob)

    @property
    def action_names(self) -> tuple[str, ...]:
        return "stick", "hit"

    def initial(self) -> Float[Array, " S"]:
        return jnp.asarray(np.append(np.outer(self.game.hands, self.game.shown), 0), float)

    def reset(self, key: Key[Array, ""]) -> Int[Array, ""]:
        """A draw from `initial`: hand and card are independent, and two short draws cost less than one."""
        hand_key, shown_key = jax.random.split(key)
        hand = policies.sample(hand_key, jnp.asarray(self.game.hands, float))
        return SHOWN * hand + policies.sample(shown_key, jnp.asarray(self.game.shown, float))

    def outcomes(self, s: Int[Array, ""], a: Int[Array, ""]) -> tuple[Float[Array, " K"], Outcome]:
        prob, reward = (jnp.asarray(x, float)[s, a] for x in (self.game.prob, self.game.reward))
        s_next = jnp.asarray(self.game.s_next)[s, a]
        return prob, Outcome(s_next, reward, s_next == self.game.terminal)

    def tabulated_step(self) -> Callable[[Key[Array, ""], Int[Array, ""], Int[Array, ""]], Outcome]:
        """As in `Finite`, but faster: what is drawn from does not depend on the state, and the tables are small."""
        game, count = self.game, self.game.prob.shape[-1]
        draws, stick = jnp.asarray(game.prob[0, HIT], float), jnp.asarray(game.prob[:, STICK, :3], float)
        after, win = jnp.asarray(game.s_next[:, HIT].ravel()), jnp.asarray(game.reward[:, STICK, 0], float)

        def step(key: Key[Array, ""], s: Int[Array, ""], a: Int[Array, ""]) -> Outcome:
            hits, card = a == HIT, policies.sample(key, draws)
            result = policies.sample(key, tables.row(stick, s))  # of sticking: to win, to draw or to lose
            s_next = jnp.where(hits, tables.entry(after, count * s + card), game.terminal)
            terminal = s_next == game.terminal
            loses = jnp.where(hits, terminal, result == 2) & (s != game.terminal)
            wins = jnp.where(hits | (result > 0), 0, tables.entry(win, s))
            return Outcome(s_next, jnp.where(loses, -1, wins), terminal)

        return step
