"""Easy21 (Silver's assignment to his lectures)."""

from functools import cache
from numbers import Integral

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core.errors import unfit
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.envs.base import TIME_LIMIT, Panel
from jaxrl_tab.envs.cards import DEALER_STICKS, LIMIT, SHOWN, CardGame, Game, compare, hands_panel, tabulate

MAX_STEPS = 100  # a hand that goes on and on is bust long before

BLACK = 2 / 3  # of all cards are black and add; the others are red and subtract
CARDS = np.array([*range(-10, 0), *range(1, 11)])  # what a card adds
DECK = np.where(CARDS > 0, BLACK, 1 - BLACK) / 10


@pytree
class Easy21(CardGame):
    """Draw cards to come closer to 21 than the dealer, neither beyond 21 nor below 1.

    A card counts 1 to 10, all equally likely. It is black and adds, with 2/3, or red and subtracts, with 1/3.
    The deck never runs out; there are no aces. Player and dealer begin with one black card each. Action 0 is
    to stick, action 1 to hit, which is to take a card: leaving 1 to 21 gives -1, any other card 0. After
    sticking the dealer takes cards up to a sum of 17 or more. The larger sum then wins, or the player if the
    dealer left 1 to 21: +1, 0 or -1.

    States are numbered 10 (player - 1) + dealer - 1, for the player's sum of 1 to 21 and the dealer's card of
    1 to 10. `state` gives the number; `q[:210].reshape(21, 10, 2)` is [player, dealer, action]. State 210 is
    terminal. The optimal value from the start, with gamma 1, is 0.063076.
    """

    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    @property
    def game(self) -> Game:
        return _game()

    def panels(self) -> tuple[Panel, ...]:
        cards = [str(card) for card in range(1, SHOWN + 1)]
        return (hands_panel("", range(LIMIT), range(1, LIMIT + 1), cards),)

    def state(self, player: int, dealer: int) -> int:
        """The number of the state of the player's sum, 1 to 21, and the dealer's first card, 1 to 10.

        Raises:
            InputError: there is no such state.
        """
        if not isinstance(player, Integral) or not 1 <= player <= LIMIT:
            raise unfit(type(self).__name__, "player", f"a sum of 1 to {LIMIT}", player)
        if not isinstance(dealer, Integral) or not 1 <= dealer <= SHOWN:
            raise unfit(type(self).__name__, "dealer", f"a card of 1 to {SHOWN}", dealer)
        return SHOWN * (int(player) - 1) + int(dealer) - 1


def _dealer() -> Float[np.ndarray, "16 6"]:
    """Where the dealer ends from each sum of 1 to 16, float64 [16, 6]: on 17 to 21, or bust.

    Red cards lead back, so this is a linear system: ends = once @ ends + the ends that one card reaches.
    """
    before = np.arange(1, DEALER_STICKS)
    total = before[:, None] + CARDS
    where = np.where((total < 1) | (total > LIMIT), LIMIT + 1, total)
    once = (where[:, :, None] == np.arange(1, LIMIT + 2)).transpose(0, 2, 1) @ DECK
    n = len(before)
    return np.linalg.solve(np.eye(n) - once[:, :n], once[:, n:])


@cache
def _game() -> Game:
    sums = np.arange(1, LIMIT + 1)
    total = sums[:, None] + CARDS
    after = np.where((total < 1) | (total > LIMIT), LIMIT, total - 1)
    stick = np.array([[compare(int(player), ends) for ends in _dealer()[:SHOWN]] for player in sums])
    first = np.full(SHOWN, 1 / 10)
    hands = np.append(first, np.zeros(LIMIT - SHOWN))
    return tabulate(hands, first, DECK, after, stick, np.ones(LIMIT))
