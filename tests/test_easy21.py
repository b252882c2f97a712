"""Easy21: cards turned by hand, the exact values by plain sweeps, and games card by card."""

import jax
import numpy as np
import pytest
from sampling import p_value, p_value_of_transitions

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.core import rng

STICK, HIT = 0, 1
TERMINAL = 210
CARDS = {sign * card: (2 if sign > 0 else 1) / 30 for sign in (-1, 1) for card in range(1, 11)}


@pytest.fixture(scope="module")
def env():
    return rl.make("easy21")


@pytest.fixture(scope="module")
def model(env):
    return planning.exact_model(env)


@pytest.fixture(scope="module")
def solution(env):
    return planning.policy_iteration(env)


def after(model, s, a):
    """s' -> (probability, rewards)."""
    p, r, s_next = model.prob[s, a], model.reward[s, a], model.s_next[s, a]
    return {int(i): (pytest.approx(p[s_next == i].sum()), set(r[(s_next == i) & (p > 0)])) for i in s_next}


def test_hits_worked_by_hand(env, model):
    """Broken once: red with 2/3 and black with 1/3 -> fails, and so does every test of values."""
    low, high, middle = env.state(1, 3), env.state(21, 3), env.state(11, 10)
    assert after(model, high, HIT) == {
        TERMINAL: (2 / 3, {-1.0}),  # any black card
        **{env.state(21 - card, 3): (1 / 30, {0.0}) for card in range(1, 11)},
    }
    assert after(model, low, HIT) == {
        TERMINAL: (1 / 3, {-1.0}),  # any red one
        **{env.state(1 + card, 3): (2 / 30, {0.0}) for card in range(1, 11)},
    }
    assert after(model, middle, HIT) == {env.state(11 + card, 10): (p, {0.0}) for card, p in CARDS.items()}
    assert after(model, TERMINAL, HIT) == after(model, TERMINAL, STICK) == {TERMINAL: (1.0, {0.0})}


def plain_dealer():
    """The distribution of the dealer's score from each sum of 1 to 16; 0 is bust."""
    ends = {}
    for first in range(1, 17):
        alive, done = {first: 1.0}, {}
        while sum(alive.values()) > 1e-15:
            reached = {}
            for total, p in alive.items():
                for card, q in CARDS.items():
                    new = total + card
                    into = reached if 1 <= new <= 16 else done
                    new = new if 1 <= new <= 21 else 0
                    into[new] = into.get(new, 0) + p * q
            alive = reached
        ends[first] = done
    return ends


def plain_optimal_values():
    """v*(player, dealer) and the value of sticking, by sweeps in plain Python."""
    ends = plain_dealer()
    places = [(player, dealer) for player in range(1, 22) for dealer in range(1, 11)]
    stick = {
        (player, dealer): sum(p * float(np.sign(player - score)) for score, p in ends[dealer].items())
        for player, dealer in places
    }
    v, change = dict(stick), 1.0
    while change > 1e-14:
        hit = {
            (player, dealer): sum(q * v.get((player + card, dealer), -1.0) for card, q in CARDS.items())
            for player, dealer in places
        }
        new = {place: max(stick[place], hit[place]) for place in places}
        change = max(abs(new[place] - v[place]) for place in places)
        v = new
    return v, stick


def test_optimal_values_are_those_of_plain_sweeps(env, model, solution):
    _, v, q = solution
    plain, stick = plain_optimal_values()
    for (player, dealer), value in plain.items():
        s = env.state(player, dealer)
        assert v[s] == pytest.approx(value, abs=1e-12)
        assert q[s, STICK] == pytest.approx(stick[player, dealer], abs=1e-12)
    start = np.mean([plain[player, dealer] for player in range(1, 11) for dealer in range(1, 11)])
    assert planning.start_value(env, v) == pytest.approx(start, abs=1e-12)
    assert start == pytest.approx(0.0630760640671, abs=1e-12)
    np.testing.assert_allclose(model.prob.sum(-1), 1, atol=1e-15)


def play(games, hits, rand):
    """The transitions (s, a, reward, s') of so many games, where `hits`(s) says whether to take a card."""

    def card():
        value = int(rand.integers(1, 11))
        return value if rand.random() < 2 / 3 else -value

    seen = []
    for _ in range(games):
        player, dealer = (int(x) for x in rand.integers(1, 11, 2))
        shown = dealer
        s, over = 10 * (player - 1) + shown - 1, False
        while not over and hits(s):
            player += card()
            over = not 1 <= player <= 21
            s_next = TERMINAL if over else 10 * (player - 1) + shown - 1
            seen.append((s, HIT, -1.0 if over else 0.0, s_next))
            s = s_next
        if not over:
            while 1 <= dealer < 17:
                dealer += card()
            won = not 1 <= dealer <= 21 or player > dealer
            seen.append((s, STICK, 1.0 if won else 0.0 if player == dealer else -1.0, TERMINAL))
    return tuple(map(np.array, zip(*seen, strict=True)))


def test_outcomes_are_those_of_games_card_by_card(model):
    rand = np.random.default_rng(0)
    transitions = play(30_000, lambda s: rand.random() < 0.5, rand)
    assert 1e-3 < p_value_of_transitions(model, *transitions) < 1 - 1e-3


def test_the_optimal_policy_earns_its_value(env, solution):
    """Broken once: the dealer sticks on 16 -> fails."""
    _, v, q = solution
    games = 20_000
    _, _, reward, _ = play(games, lambda s: q[s, HIT] > q[s, STICK], np.random.default_rng(1))
    ends = reward[reward != 0]
    error = np.sqrt((ends**2).sum() / games) / np.sqrt(games)
    assert abs(reward.sum() / games - planning.start_value(env, v)) < 4 * error


def test_reset_follows_initial(env, model):
    """Uniform over the first two cards. Broken once: the dealer's drawn with the key of the hand -> fails."""
    n = 100_000
    drawn = jax.jit(jax.vmap(env.reset))(rng.as_key(jax.random.bits(jax.random.key(0), (n,))))
    np.testing.assert_allclose(model.start, np.append(np.full(100, 0.01), np.zeros(111)), atol=1e-17)
    assert 1e-3 < p_value(np.bincount(drawn, minlength=211), n * model.start) < 1 - 1e-3


def test_state_numbers(env):
    assert (env.num_states, env.num_actions, env.action_names) == (211, 2, ("stick", "hit"))
    assert (env.state(1, 1), env.state(1, 10), env.state(2, 1), env.state(21, 10)) == (0, 9, 10, 209)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ((0, 1), "Easy21: player must be a sum of 1 to 21, not 0"),
        ((22, 1), "Easy21: player must be a sum of 1 to 21, not 22"),
        ((1, 0), "Easy21: dealer must be a card of 1 to 10, not 0"),
        ((1, "ace"), "Easy21: dealer must be a card of 1 to 10, not 'ace'"),
    ],
)
def test_error(env, place, message):
    with pytest.raises(rl.InputError) as error:
        env.state(*place)
    assert str(error.value) == message


def test_max_steps_must_be_a_number():
    with pytest.raises(rl.InputError, match="easy21: max_steps must be a whole number of at least 1, not 0"):
        rl.make("easy21", max_steps=0)
