"""Blackjack (book, example 5.1), and as Gymnasium plays it."""

from functools import cache
from numbers import Integral
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxrl_tab.core.errors import InputError, unfit
from jaxrl_tab.core.pytree import pytree, static
from jaxrl_tab.envs.base import TIME_LIMIT, Panel
from jaxrl_tab.envs.cards import DEALER_STICKS, LIMIT, SHOWN, CardGame, Game, compare, hands_panel, tabulate

MAX_STEPS = 32  # no hand can take more than 20 cards: the sums 12 to 21 with a usable ace, then without

ACE, TEN = 1, 10
CARDS = range(ACE, TEN + 1)
DECK = np.array([1] * 9 + [4]) / 13  # ace to ten; ten, jack, queen and king all count 10
LEAST = 12  # below it a card can do no harm, and is taken without asking
SUMS = LIMIT - LEAST + 1
NATURAL = 2 * SUMS  # the last hand, after those without and with a usable ace
HANDS = NATURAL + 1


@pytree
class Blackjack(CardGame):
    """Draw cards to come closer to 21 than the dealer, and not beyond.

    Cards come from a deck that never runs out. An ace is usable while it can count 11 without going over 21.
    Player and dealer get two cards each; one of the dealer's shows. While the player has less than 12, one
    more card is given without asking. Action 0 is to stick, action 1 to hit, which is to take a card: going
    over 21 gives -1, any other card 0. After sticking the dealer takes cards up to a sum of 17 or more, any
    ace counting 11 if it can, one that is drawn later as well. The larger sum then wins: +1, 0 or -1.

    States are numbered 100 usable + 10 (player - 12) + dealer - 1, for the player's sum of 12 to 21 and a
    dealer's card of 1 (an ace) to 10. `state` gives the number; `q[:200].reshape(2, 10, 10, 2)` is [usable,
    player, dealer, action]. The last state is terminal. It is 200, or 210 where naturals are told apart: they
    are then 200 to 209, by the dealer's card.

    A natural is 21 with the first two cards. Under "book" and "gymnasium" it is a 21 like any other: the two
    are the same task, Gymnasium's with sab=False, natural=False (where one may also stick below 12, which is
    never better), and example 5.1 as it is usually programmed. The rule for naturals in the text of example
    5.1 is "gymnasium-sab": a natural that sticks wins, but draws if the dealer has one too. Under "natural",
    which is Gymnasium with sab=False, natural=True, a natural that wins gets 1.5. Nowhere does a dealer's
    natural beat a 21. The optimal values from the start, with gamma 1, are -0.046556, -0.046556, -0.043113
    and -0.025729.
    """

    rules: Literal["book", "gymnasium", "gymnasium-sab", "natural"] = static(
        default="book", help="What a 21 with two cards is worth."
    )
    max_steps: int = static(default=MAX_STEPS, at_least=1, help=TIME_LIMIT)

    @property
    def game(self) -> Game:
        return _game(self.rules)

    def panels(self) -> tuple[Panel, ...]:
        sums, cards = range(LEAST, LIMIT + 1), ("A", *map(str, range(2, SHOWN + 1)))
        tables = [
            hands_panel(title, [_hand(total, usable) for total in sums], sums, cards)
            for title, usable in (("usable ace", True), ("no usable ace", False))
        ]
        if len(self.game.hands) == HANDS:
            tables.append(hands_panel("natural", [NATURAL], [LIMIT], cards))
        return tuple(tables)

    def state(self, player: int, dealer: int, usable: bool = False, natural: bool = False) -> int:
        """The number of a state.

        Args:
            player: the player's sum, 12 to 21.
            dealer: the card that the dealer shows, 1 (an ace) to 10.
            usable: whether the player has an ace that counts 11.
            natural: whether it is 21 with two cards. Where the rules make no difference it may be either.

        Raises:
            InputError: there is no such state.
        """
        who = type(self).__name__
        if not isinstance(player, Integral) or not LEAST <= player <= LIMIT:
            raise unfit(who, "player", f"a sum of {LEAST} to {LIMIT}", player)
        if not isinstance(dealer, Integral) or not ACE <= dealer <= TEN:
            raise unfit(who, "dealer", f"a card of {ACE} (an ace) to {TEN}", dealer)
        if natural and not (player == LIMIT and usable):
            problem = f"a natural is {LIMIT} with a usable ace, not {player}, usable={usable}"
            raise InputError(problem, who=who, field="natural")
        hand = NATURAL if natural and len(self.game.hands) == HANDS else _hand(int(player), bool(usable))
        return SHOWN * hand + int(dealer) - 1


def _add(total: int, usable: bool, card: int) -> tuple[int, bool]:
    """A hand (its sum, whether it has a usable ace) with one more card; over 21 where it is bust."""
    if card == ACE and total + 11 <= LIMIT:
        return total + 11, True
    total += card
    return (total - 10, False) if usable and total > LIMIT else (total, usable)


def _hand(total: int, usable: bool) -> int:
    """The number of a hand of 12 or more."""
    return SUMS * usable + total - LEAST if total <= LIMIT else HANDS


@cache
def _deal(total: int = 0, usable: bool = False, cards: int = 0) -> Float[np.ndarray, " 21"]:
    """The distribution of the hand with which the player is first asked, float64 [21]."""
    if total >= LEAST:
        return np.eye(HANDS)[NATURAL if (total, cards) == (LIMIT, 2) else _hand(total, usable)]
    return DECK @ np.array([_deal(*_add(total, usable, card), cards + 1) for card in CARDS])


@cache
def _dealer(total: int, usable: bool) -> Float[np.ndarray, " 6"]:
    """The distribution of where the dealer ends, float64 [6]: on 17 to 21, or bust."""
    if total >= DEALER_STICKS:
        return np.eye(6)[min(total, LIMIT + 1) - DEALER_STICKS]
    return DECK @ np.array([_dealer(*_add(total, usable, card)) for card in CARDS])


@cache
def _game(rules: str) -> Game:
    sums = [(total, usable) for usable in (False, True) for total in range(LEAST, LIMIT + 1)]
    sums.append((LIMIT, True))  # the natural
    after = np.array([[_hand(*_add(*hand, card)) for card in CARDS] for hand in sums])
    stick = np.array(
        [[compare(total, _dealer(*_add(0, False, card))) for card in CARDS] for total, _ in sums]
    )
    hands, win = _deal(), np.ones(HANDS)
    if rules == "natural":
        win[NATURAL] = 1.5
    elif rules == "gymnasium-sab":
        too = np.zeros(SHOWN)  # the probability that the dealer has one too: that the other card makes it one
        too[[ACE - 1, TEN - 1]] = DECK[[TEN - 1, ACE - 1]]
        stick[NATURAL] = np.stack([1 - too, too, 0 * too], axis=-1)
    else:
        hands = hands[:NATURAL] + hands[NATURAL] * np.eye(NATURAL)[_hand(LIMIT, True)]
        after, stick, win = after[:NATURAL], stick[:NATURAL], win[:NATURAL]
    return tabulate(hands, DECK, DECK, after, stick, win)
