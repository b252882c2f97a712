"""GLIE Monte Carlo control of Blackjack in Numba, as fast as we could make it: cards are drawn and played.

A hand is one number, 2 sum + usable ace, and a card that is added to it is one look-up: half the rules of the
game are in a table, and none is a branch. Sum and ace in two variables, with arithmetic instead of the table,
took 1.15 times as long. What is left is bounded by branches that nobody can predict: whether a player with
less than 12 gets another card, whether the game goes on, whether the dealer takes one more. A decision to
explore, the action and the next card share a word of 64 bits.
"""

import numba  # pyright: ignore[reportMissingImports] (of the extra "bench")
import numpy as np

from benchmarks.numba_tools import LOW_32, U, generator, inline, rounds, xoshiro256pp
from benchmarks.rounds import Round

RANKS = 13  # ace, 2 to 10, jack, queen, king
LIMIT, PLAYER_DRAWS_BELOW, DEALER_DRAWS_BELOW = 21, 12, 17
HANDS = 2 * (LIMIT + 1)  # and those that are bust: 2 sum for a sum of 22 or more
LONGEST = 32  # more cards than any hand can take

STICK, HIT = U(0), U(1)
TEN = U(9)  # the ranks from here on count 10, and look alike to the player
CARDS_SHOWN = U(10)
PAIRS = HANDS * 10 * 2  # flat [hand, card shown, action]


def _hand_after() -> np.ndarray:
    """The hand with one more card, for each hand that is not bust and rank; uint8, flat, in rows of 16."""
    table = np.zeros((HANDS, 16), np.uint8)
    for hand in range(HANDS):
        for rank in range(RANKS):
            total, usable = divmod(hand, 2)
            if rank == 0 and total + 11 <= LIMIT:
                total, usable = total + 11, 1
            else:
                total += min(rank + 1, 10)
                if usable and total > LIMIT:
                    total, usable = total - 10, 0
            table[hand, rank] = 2 * total + (usable if total <= LIMIT else 0)
    return table.ravel()


HAND_AFTER = _hand_after()


@inline
def rank(bits_32):
    return (bits_32 * U(RANKS)) >> U(32)


@inline
def add(hand, bits_32):
    return U(HAND_AFTER[(hand << U(4)) + rank(bits_32)])


@inline
def choose(q, here, word, explore_below_32):
    """Epsilon-greedy: the upper half of the word decides on exploring, the bit below it is a coin."""
    stick, hit = q[here + STICK], q[here + HIT]
    any_one = ((word >> U(32)) < explore_below_32) | (stick == hit)
    return (word >> U(31)) & U(1) if any_one else U(hit > stick)


@inline
def deal(rng):
    """(the player's hand of 12 or more, the card that the dealer shows as a rank of 0 to 9, generator)."""
    word, rng = xoshiro256pp(rng)
    shown, hand = rank(word & LOW_32), add(U(0), word >> U(32))
    shown = shown if shown < TEN else TEN
    while hand < U(2 * PLAYER_DRAWS_BELOW):
        word, rng = xoshiro256pp(rng)
        hand = add(hand, word >> U(32))
    return hand, shown, rng


@inline
def play(q, path, hand, shown, rng, explore_below_32):
    """The player's turn: notes each (S, A) in `path`, and returns (hand, number of decisions, generator)."""
    length = U(0)
    goes_on = True
    while goes_on:
        word, rng = xoshiro256pp(rng)
        here = U(2) * (CARDS_SHOWN * hand + shown)
        a = choose(q, here, word, explore_below_32)
        path[length] = here + a
        length += U(1)
        after = add(hand, (word << U(1)) & LOW_32)
        goes_on = (a == HIT) & (after < U(HANDS))
        hand = after if a == HIT else hand
    return hand, length, rng


@inline
def result(hand, shown, rng):
    """(what the game gives: 1, 0 or -1; generator); the dealer plays unless the player is bust."""
    if hand >= U(HANDS):
        return np.float32(-1), rng
    dealer = U(HAND_AFTER[shown])
    while dealer < U(2 * DEALER_DRAWS_BELOW):
        word, rng = xoshiro256pp(rng)
        dealer = add(dealer, word >> U(32))
    player, dealer = hand >> U(1), U(0) if dealer >= U(HANDS) else dealer >> U(1)
    return np.float32(player > dealer) - np.float32(player < dealer), rng


def lane_by_lane(lanes: int, episodes: int) -> Round:
    """One lane after another; the outcome of a lane is its mean return in the last tenth of the episodes."""
    last_tenth = episodes // 10

    @numba.njit(parallel=True, error_model="numpy")
    def kernel(seeds, tables, mean_return, episodes):
        for i in numba.prange(seeds.size):
            q, n = tables[i], np.zeros(PAIRS, np.float32)
            path = np.zeros(LONGEST, np.uint16)
            rng = generator(seeds[i])
            won = np.float32(0)
            for k in range(1, episodes + 1):
                explore_below_32 = U(np.float32(2**32) / np.float32(k))  # epsilon = 1/k
                hand, shown, rng = deal(rng)
                hand, length, rng = play(q, path, hand, shown, rng, explore_below_32)
                g, rng = result(hand, shown, rng)
                for j in range(length):  # gamma is 1, and no pair comes twice in a game
                    pair = U(path[j])
                    n[pair] += np.float32(1)
                    q[pair] += (g - q[pair]) / n[pair]
                if k > episodes - last_tenth:
                    won += g
            mean_return[i] = won / last_tenth

    return rounds(kernel, lanes, PAIRS, episodes)
