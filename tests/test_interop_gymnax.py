"""gymnax both ways: against tables worked out by hand or by Gymnasium, and against gymnax's own steps."""

import runpy
from pathlib import Path

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sampling
from flax import struct
from gymnax.environments import environment, spaces
from gymnax.experimental.rollout import RolloutWrapper
from gymnax.wrappers import FlattenObservationWrapper, LegacyStepAPIWrapper, LogWrapper, StickyActionWrapper
from marks import slow_but_first

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.envs import name_of
from jaxrl_tab.interop import from_gymnasium, from_gymnax, make, to_gymnax
from jaxrl_tab.interop.gymnax import EnumeratedGymnax, SampledGymnax

# --- exact ---------------------------------------------------------------------------------------------


def value_iteration(p, r, terminal, gamma):
    """v* by plain sweeps over p and r [S, A, S']."""
    v = np.zeros(len(p))
    for _ in range(3000):
        v = np.where(terminal, 0, ((p * r).sum(-1) + gamma * p @ np.where(terminal, 0, v)).max(1))
    return v


def dense(env):
    """p and r [S, A, S'] of an environment."""
    model = planning.exact_model(env)
    p, r = np.zeros((2, *model.prob.shape[:2], len(model.prob)))
    s, a = np.ogrid[: len(p), : p.shape[1]]
    at = s[..., None], a[..., None], model.s_next
    np.add.at(p, at, model.prob)
    np.add.at(r, at, model.prob * model.reward)
    return p, np.divide(r, p, out=np.zeros_like(r), where=p > 0)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "parameters",
    [{"map_name": "4x4"}, {"map_name": "8x8"}, {"desc": ["SFF", "FHF", "FFG"], "success_rate": 0.5}],
)
def test_the_lake_is_that_of_gymnasium(parameters):
    """From float32 and random keys, the same probabilities as in Gymnasium's float64 table."""
    ours, theirs = from_gymnax("FrozenLake-misc", **parameters), from_gymnasium("FrozenLake-v1", **parameters)
    for x, y in zip(dense(ours), dense(theirs), strict=True):
        np.testing.assert_allclose(x, y, atol=1e-15)
    np.testing.assert_array_equal(ours.is_terminal, theirs.is_terminal)
    np.testing.assert_array_equal(ours.initial(), theirs.initial())
    np.testing.assert_array_equal(ours.observations, np.arange(ours.num_states))
    assert ours.max_steps == (200 if ours.num_states == 64 else 100)


def test_the_lakes_optimal_values():
    env = from_gymnax("FrozenLake-misc")
    v, _ = planning.value_iteration(env)
    np.testing.assert_allclose(v, value_iteration(*dense(env), env.is_terminal, 1.0), atol=1e-9)
    assert v[0] == pytest.approx(14 / 17, abs=1e-9)


def test_a_time_limit_is_no_terminal_state():
    env = from_gymnax("FrozenLake-misc", params={"max_steps_in_episode": 7})
    assert (env.num_states, env.max_steps) == (16, 7)
    assert np.flatnonzero(env.is_terminal).tolist() == [5, 7, 11, 12, 15]
    _, log = rl.train(jax.random.key(0), rl.QLearning(), env, num_episodes=50)
    assert log.lengths.max() == 7


def four_rooms(goal, starts, fail=1 / 3):
    """p, r [S, A, S'] and the start distribution, by hand: the intended move, or any other by `fail` / 3."""
    text = gymnax.environments.misc.rooms.four_rooms_map.split("\n")[1:]
    cells = [(y, x) for y, row in enumerate(text) for x, mark in enumerate(row) if mark == " "]
    p, r = np.zeros((2, len(cells), 4, len(cells)))
    for s, (y, x) in enumerate(cells):
        for a in range(4):
            for move, (dy, dx) in enumerate([(-1, 0), (0, 1), (1, 0), (0, -1)]):
                to = (y + dy, x + dx)
                s_next = cells.index(to) if to in cells else s
                p[s, a, s_next] += 1 - fail if move == a else fail / 3
    goal = cells.index(goal)
    p[goal], r[:, :, goal], r[goal] = np.eye(len(cells))[goal], 1, 0
    start = np.zeros(len(cells))
    start[
        [cells.index(cell) for cell in starts] if starts else [i for i in range(len(cells)) if i != goal]
    ] = 1
    return p, r, start / start.sum(), goal


@pytest.mark.one_in(2)
@pytest.mark.parametrize("anywhere", slow_but_first([False, True]))
def test_four_rooms(anywhere):
    """The slips, and the start anywhere but at the goal."""
    env = from_gymnax("FourRooms-misc", params={"resample_init_pos": anywhere, "fail_prob": 0.3})
    p, r, start, goal = four_rooms((8, 9), None if anywhere else [(4, 1)], fail=0.3)
    np.testing.assert_allclose(dense(env)[0], p, atol=1e-15)
    np.testing.assert_array_equal(dense(env)[1], np.where(p > 0, r, 0))
    np.testing.assert_allclose(env.initial(), start, atol=1e-7)
    assert np.flatnonzero(env.is_terminal).tolist() == [goal]
    v, _ = planning.value_iteration(env, gamma=0.95)
    np.testing.assert_allclose(v, value_iteration(p, r, np.arange(104) == goal, 0.95), atol=1e-6)


def test_catch():
    """The optimum is to catch every ball: 1. The ball starts in each of five columns."""
    env = from_gymnax("Catch-bsuite")
    p, r = dense(env)
    v = value_iteration(p, r, env.is_terminal, 1.0)
    start = np.flatnonzero(env.initial())
    np.testing.assert_allclose(env.initial()[start], np.full(5, 0.2))
    np.testing.assert_allclose(v[start], np.ones(5))
    np.testing.assert_allclose(planning.value_iteration(env)[0], v, atol=1e-9)
    assert set(np.unique(p)) == {0, 1}  # nothing else is random
    assert env.is_terminal.sum() == 25  # each place of the ball with each of the paddle
    idle = np.zeros((env.num_states, 3))
    idle[:, 1] = 1
    assert planning.policy_value(env, idle) == pytest.approx(-0.6)


@pytest.mark.parametrize("size", slow_but_first([4, 8]))
def test_deep_sea(size):
    """Always right: 1 - 0.01. What is seen at the end is always the same, but the ends are told apart."""
    env = from_gymnax("DeepSea-bsuite", size=size)
    v, _ = planning.value_iteration(env)
    assert env.max_steps == size
    assert np.asarray(env.initial()) @ v == pytest.approx(1 - 0.01, abs=1e-9)
    ends = env.observations[env.is_terminal]
    assert (ends == 0).all()
    assert len(ends) == size
    seen = env.observations[~env.is_terminal].reshape(-1, size * size)
    assert (seen.sum(1) == 1).all()
    assert len(np.unique(seen, axis=0)) == len(seen) == size * (size + 1) // 2
    rewards = np.unique(env.reward)
    np.testing.assert_allclose(rewards, [-0.01 / size, 0, 1 - 0.01 / size], atol=1e-9)


def test_rewards_by_chance_are_kept_apart():
    """In the umbrella chain each step earns -1 or +1; the time matters there, and ends the chain."""
    env = from_gymnax("UmbrellaChain-bsuite", params={"chain_length": 3})
    model = planning.exact_model(env)
    start = np.flatnonzero(model.start)
    for s in start:
        assert sorted(model.reward[s, 0][model.prob[s, 0] > 0].tolist()) == [-1, 1]
    assert env.num_states == 4 + 4 + 4 + 4
    assert np.asarray(model.start)[start] == pytest.approx([0.25] * 4)
    v, _ = planning.value_iteration(env)
    assert v[start] == pytest.approx([1] * 4)


def gymnax_transitions(env, name, num_steps, lanes, **parameters):
    """(s, a, r, s') of a random walk in gymnax with its own autoreset, observations named by `env`."""
    theirs, params = gymnax.make(name)
    params = params.replace(**parameters)

    def step(carry, key):
        observation, state = carry
        act, go = jax.random.split(key)
        a = theirs.action_space(params).sample(act)
        next_observation, state, r, terminated, _, info = theirs.step(go, state, a, params)
        return (next_observation, state), (observation, a, r, info["final_observation"], terminated)

    def one(key):
        first, rest = jax.random.split(key)
        return jax.lax.scan(step, theirs.reset(first, params), jax.random.split(rest, num_steps))[1]

    seen = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(3), lanes))
    o, a, r, o_next, terminal = (np.asarray(x).reshape(lanes * num_steps, -1) for x in seen)
    names = {
        (end, np.asarray(x, o.dtype).tobytes()): s
        for s, (x, end) in enumerate(
            zip(env.observations.reshape(env.num_states, -1), env.is_terminal, strict=True)
        )
    }
    s = np.array([names[False, x.tobytes()] for x in o])
    s_next = np.array([names[bool(end), x.tobytes()] for x, end in zip(o_next, terminal[:, 0], strict=True)])
    return s, a[:, 0], r[:, 0].astype(float), s_next


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("FrozenLake-misc", {}),
        pytest.param(
            "FourRooms-misc",
            {"resample_init_pos": True, "max_steps_in_episode": 50},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_happens_in_gymnax_is_what_was_enumerated(name, parameters):
    """Broken once -> fails: slips to three sides; the start of FourRooms anywhere."""
    env = from_gymnax(name, params=parameters)
    s, a, r, s_next = gymnax_transitions(env, name, num_steps=500, lanes=40, **parameters)
    assert sampling.p_value_of_transitions(planning.exact_model(env), s, a, r, s_next) > 0.001


# --- sampled -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def noisy_sea():
    """With normal numbers in its rewards: states are exact, rewards can only be sampled."""
    return from_gymnax("DeepSea-bsuite", size=4, params={"deterministic": False, "randomize_actions": False})


def test_random_rewards_can_only_be_sampled(noisy_sea):
    assert isinstance(noisy_sea, SampledGymnax)
    assert (noisy_sea.num_states, noisy_sea.num_actions, noisy_sea.max_steps) == (14, 2, 4)
    with pytest.raises(rl.InputError, match="DeepSea-bsuite can only be sampled; exact values need"):
        planning.value_iteration(noisy_sea)


def test_sampled_steps_are_those_of_gymnax(noisy_sea):
    """From row 0 right: in 3 of 4 cases. In the last row at the edge: reward 1 - 0.0025 + N(0, 1)."""
    keys = jax.random.split(jax.random.key(0), 4000)
    step = jax.jit(jax.vmap(noisy_sea.step, (0, None, None)))
    start = jax.jit(noisy_sea.reset)(keys[0])
    s_next, reward, terminal = map(np.asarray, step(keys, start, 1))
    place = noisy_sea.observations.reshape(-1, 16).argmax(1)
    assert place[start] == 0
    count = np.bincount(place[s_next], minlength=16)[[4, 5]]
    assert sampling.p_value(count, np.array([1000, 3000])) > 0.001
    np.testing.assert_allclose(reward, -0.0025, atol=1e-6)
    assert not terminal.any()

    last = np.flatnonzero((place == 15) & ~noisy_sea.is_terminal)[0]
    s_next, reward, terminal = map(np.asarray, step(keys, last, 1))
    assert terminal.all() and noisy_sea.is_terminal[s_next].all()
    assert abs(reward.mean() - 0.9975) < 4 / 4000**0.5
    assert abs(reward.std() - 1) < 4 / 8000**0.5


@pytest.mark.slow
def test_methods_learn_in_it(noisy_sea):
    method = rl.QLearning(alpha=rl.schedules.sample_average(), epsilon=1.0)
    state, log = rl.train(jax.random.key(0), method, noisy_sea, num_steps=4000)
    assert np.isfinite(log.rewards).all()
    assert log.lengths.sum() == 4 * log.episodes.sum() == 4000
    assert (state.q[noisy_sea.is_terminal] == 0).all()


@struct.dataclass
class WalkState(environment.EnvState):
    place: jax.Array


class Walk(environment.Environment):
    """Five places in a row, from the middle; a normal number drives it. Both ends are terminal."""

    name = "Walk-v0"
    num_actions = 2
    default_params = environment.EnvParams(max_steps_in_episode=30)

    def reset_env(self, key, params):
        return jnp.int32(2), WalkState(time=0, place=jnp.int32(2))

    def step_env(self, key, state, action, params):
        place = state.place + jnp.where(jax.random.normal(key) + action > 0.5, 1, -1)
        state = WalkState(time=state.time + 1, place=place)
        return place, state, (place == 4).astype(int), (place == 0) | (place == 4), {}

    def action_space(self, params=None):
        return spaces.Discrete(2)

    def observation_space(self, params=None):
        return spaces.Discrete(7)


@pytest.mark.slow
def test_states_are_found_by_sampling_where_it_must_be():
    """States are numbered by what is observed; 5 and 6 never are. Rewards that are integers are floats."""
    env = from_gymnax(Walk())
    assert isinstance(env, SampledGymnax)
    assert env.is_state.tolist() == [True] * 5 + [False] * 2
    assert np.flatnonzero(env.is_terminal).tolist() == [0, 4]
    s_next, reward, terminal = jax.vmap(env.step, (0, None, None))(
        jax.random.split(jax.random.key(0), 500), jnp.int32(3), jnp.int32(1)
    )
    count = np.bincount(s_next, minlength=5)[[2, 4]]
    assert sampling.p_value(count, 500 * np.array([0.308538, 0.691462])) > 0.001
    np.testing.assert_array_equal(reward, np.asarray(s_next) == 4)
    np.testing.assert_array_equal(terminal, np.asarray(s_next) == 4)
    assert reward.dtype == jnp.float32


def test_a_state_that_was_never_met_is_not_passed_off_as_another():
    env = from_gymnax(Walk())
    unknown = env.__class__(**{**vars(env), "is_state": env.is_state & (np.arange(7) != 1)})
    keys = jax.random.split(jax.random.key(0), 50)
    _, reward, _ = jax.vmap(unknown.step, (0, None, None))(keys, jnp.int32(2), jnp.int32(0))
    assert 0 < np.isnan(reward).sum() < 50


def test_wrappers_that_change_nothing_are_passed_through():
    env = from_gymnax(LegacyStepAPIWrapper(LogWrapper(gymnax.make("FrozenLake-misc")[0])))
    np.testing.assert_array_equal(dense(env)[0], dense(from_gymnax("FrozenLake-misc"))[0])
    walk = from_gymnax(LogWrapper(Walk()), params=Walk.default_params.replace(max_steps_in_episode=7.0))
    assert (type(walk), walk.max_steps) == (SampledGymnax, 7)


# --- what cannot be imported ---------------------------------------------------------------------------


class Quit(Walk):
    """The second action ends the episode where it is, and pays 1; the first draws where to go on."""

    def step_env(self, key, state, action, params):
        place = jnp.where(action == 1, state.place, jax.random.randint(key, (), 0, 7))
        return place, WalkState(time=state.time + 1, place=place), action * 1.0, action == 1, {}


def test_an_end_that_looks_like_a_state_is_apart(monkeypatch):
    """Broken once -> fails: the same number for both. In blocks of one state at a time it is the same."""
    env = from_gymnax(Quit())
    assert isinstance(env, EnumeratedGymnax)
    assert name_of(env) == Quit().name
    assert env.observations.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6]
    assert env.is_terminal.tolist() == [False, True] * 7
    p, r = dense(env)
    np.testing.assert_allclose(p[::2, 0, ::2], np.full((7, 7), 1 / 7))
    np.testing.assert_array_equal(p[::2, 1, 1::2], np.eye(7))
    np.testing.assert_array_equal(r[::2, 1, 1::2], np.eye(7))
    monkeypatch.setattr("jaxrl_tab.interop.gymnax_states.LANES", 1)
    for x, y in zip(dense(from_gymnax(Quit())), (p, r), strict=True):
        np.testing.assert_array_equal(x, y)


class Casino(Walk):
    """One state, in which nothing is to be seen."""

    def reset_env(self, key, params):
        return jnp.int32(0), environment.EnvState(time=0)

    def step_env(self, key, state, action, params):
        reward = jax.random.bernoulli(key, jnp.where(action == 1, 0.25, 0.75))
        return jnp.int32(0), state.replace(time=state.time + 1), reward, False, {}


def test_one_state():
    env = from_gymnax(Casino())
    assert (env.num_states, env.max_steps) == (7, 30)
    assert planning.reachable(planning.exact_model(env)).tolist() == [True] + 6 * [False]
    np.testing.assert_allclose(planning.value_iteration(env, gamma=0.5)[1][0], [1.5, 1.0])


class Clockless(Walk):
    def step_env(self, key, state, action, params):
        observation, state, *rest = super().step_env(key, state, action, params)
        return observation, state.replace(time=state.time + 1), *rest


class Reversed(Walk):
    def step(self, key, state, action, params=None):
        return super().step(key, state, 1 - action, params)


class Foggy(Walk):
    def step_env(self, key, state, action, params):
        observation, *rest = super().step_env(key, state, action, params)
        return observation * jnp.nan, *rest


class Impatient(Walk):
    def is_truncated(self, state, params):
        return state.place == 3


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("given", "parameters", "message"),
    [
        ("FrozenLake", {}, "gymnax has no environment 'FrozenLake'; did you mean 'FrozenLake-misc'"),
        ("FrozenLake-misc", {"slip": 1}, "FrozenLake-misc: .*unexpected keyword argument 'slip'"),
        (
            "FourRooms-misc",
            {"params": {"fail": 1}},
            "FourRooms-misc has no parameter 'fail'; did you mean 'fail_prob'",
        ),
        ("FrozenLake-misc", {"map_name": "5x5"}, "FrozenLake-misc: map_name must be '4x4' or '8x8'"),
        ("Pendulum-v1", {}, "Pendulum-v1: actions must be discrete, and they are Box"),
        (
            "MemoryChain-bsuite",
            {},
            "MemoryChain-bsuite: what is observed is not a state, for two that differ in time",
        ),
        (
            "SimpleBandit-bsuite",
            {},
            "SimpleBandit-bsuite: rewards of the start state is another one with each key",
        ),
        (
            "DiscountingChain-bsuite",
            {},
            "what happens depends on the time, and only the time limit of 100 steps",
        ),
        (Clockless(), {}, "Walk-v0: `time` in its state does not count the steps"),
        (Impatient(), {}, "Walk-v0: its own rule when to truncate is not understood"),
        (Walk(), {"size": 3}, "size: parameters go with the name"),
        (
            FlattenObservationWrapper(Walk()),
            {},
            "what the wrapper FlattenObservationWrapper changes would be lost",
        ),
        (
            StickyActionWrapper(LogWrapper(Walk())),
            {},
            "what the wrapper StickyActionWrapper changes would be lost",
        ),
        (Reversed(), {}, "Walk-v0: its own `step` would be lost, .*; write there what Reversed changes"),
        (Foggy(), {}, r"Walk-v0: a state, or what is observed in it, is not a number \(NaN\)"),
        (Walk(), {"params": 7}, "Walk-v0: params must be those of this environment, or a dict .*, not 7"),
        ("FourRooms-misc", {"params": {"fail_prob": "x"}}, "FourRooms-misc: fail_prob must be numbers"),
        (
            "FourRooms-misc",
            {"params": {"fail_prob": np.nan}},
            "fail_prob must be a finite number, .*, not nan",
        ),
        (
            "FrozenLake-misc",
            {"params": {"max_steps_in_episode": 7.5}},
            "max_steps_in_episode must be .*, not 7.5",
        ),
    ],
)
def test_what_is_wrong_is_said(given, parameters, message):
    with pytest.raises(rl.InputError, match=message):
        from_gymnax(given, **parameters)


def test_too_many_states(monkeypatch):
    monkeypatch.setattr("jaxrl_tab.interop.gymnax_states.MAX_STATES", 100)
    with pytest.raises(rl.InputError, match="FourRooms-misc has more than 100 states, too many for a table"):
        make("gymnax:FourRooms-misc")


# --- ours for them -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gusty():
    return rl.make(
        "windy-gridworld",
        stochastic=True,
        shape=(3, 4),
        wind=(0, 1, 1, 0),
        start=(2, 0),
        goal=(0, 3),
        max_steps=12,
    )


def test_a_rollout_that_is_written_for_gymnax(gusty):
    """gymnax's own, under jit and vmap: a random policy's return over 12 steps, against exact values.

    Its time limit is met, so the exact value is that of a policy followed for 12 steps.
    """
    rollout = RolloutWrapper(env=to_gymnax(gusty))
    keys = jax.random.split(jax.random.key(0), 2000)
    _, a, _, s_next, done, total = map(np.asarray, rollout.batch_rollout(keys, None))
    assert a.shape == (2000, 12)
    assert a.max() == 3
    assert done[:, -1].any() and done[:, :-1].any()
    model = planning.exact_model(gusty)
    v = np.zeros(12)
    for _ in range(12):
        v = planning.backup(model, v, 1.0).mean(1)
    assert abs(total.mean() - v[gusty.start_state]) < 4 * total.std() / 2000**0.5
    assert (s_next[done] == gusty.start_state).all()  # after the reset


def test_steps_reset_by_themselves_and_say_what_was_before(gusty):
    """With a wrapper of gymnax on top. What was terminated, truncated, and observed before the reset."""
    env = LogWrapper(to_gymnax(gusty))
    params = to_gymnax(gusty).default_params

    def step(carry, key):
        s, state = carry
        act, go = jax.random.split(key)
        a = env.action_space(params).sample(act)
        s_next, state, reward, terminated, truncated, info = env.step(go, state, a, params)
        seen = s, a, reward, info["final_observation"], s_next, terminated, truncated
        return (s_next, state), (*seen, info["returned_episode_lengths"])

    def run(key):
        return jax.lax.scan(step, env.reset(key, params), jax.random.split(key, 8000))[1]

    s, a, reward, final, s_next, terminated, truncated, length = map(
        np.asarray, jax.jit(run)(jax.random.key(1))
    )
    assert sampling.p_value_of_transitions(planning.exact_model(gusty), s, a, reward, final) > 0.001
    np.testing.assert_array_equal(terminated, final == gusty.state(gusty.goal))
    done = terminated | truncated
    np.testing.assert_array_equal(s_next, np.where(done, gusty.start_state, final))
    assert (length[truncated] == 12).all()
    assert (terminated & ~truncated).sum() > 100 < (truncated & ~terminated).sum()


def test_spaces_and_names():
    env = to_gymnax(rl.CliffWalking())
    params = env.default_params
    assert (env.name, env.num_actions, params.max_steps_in_episode) == ("cliff-walking", 4, 10_000)
    assert (env.observation_space(params).n, env.action_space(params).n) == (48, 4)
    observation, state = env.reset(jax.random.key(0))  # the default parameters
    assert observation == state.s == 36
    assert env.observation_space(params).contains(observation)
    assert env.state_space(params).contains(state)
    observation, state, reward, terminated, info = env.step_env(jax.random.key(0), state, 1, params)
    assert (int(observation), float(reward), bool(terminated), float(info["discount"])) == (
        36,
        -100,
        False,
        1,
    )
    assert (reward.dtype, observation.dtype) == (jnp.float32, jnp.int32)
    state = state.replace(s=jnp.int32(35))  # above the goal
    _, state, _, terminated, info = env.step_env(jax.random.key(0), state, 2, params)
    assert terminated and env.is_terminated(state, params) and info["discount"] == 0
    assert not env.is_truncated(state, params)
    assert env.is_truncated(state.replace(time=10_000), params)


def test_the_same_environment_is_compiled_once(gusty):
    """JAX takes two instances for two functions, so one is given for one."""
    assert to_gymnax(gusty) is to_gymnax(gusty)
    assert from_gymnax("DeepSea-bsuite", size=4, params={"deterministic": False}).env is (
        from_gymnax("DeepSea-bsuite", size=4, params={"deterministic": False}).env
    )


def test_round_trip():
    """Where nothing is drawn, all is exact again."""
    cliff = rl.CliffWalking(shape=(2, 4))
    again = from_gymnax(to_gymnax(cliff))
    assert isinstance(again, EnumeratedGymnax)
    assert again.num_states == 8
    assert np.flatnonzero(again.is_terminal).tolist() == [7]
    v, _ = planning.value_iteration(again)
    np.testing.assert_allclose(v[:5], planning.value_iteration(cliff)[0][:5])
    with pytest.raises(rl.InputError, match="env must be an instance, such as CliffWalking"):
        to_gymnax("cliff-walking")  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_the_example(capsys):
    """The games within four standard errors of what is exact with their limit of steps.

    Broken once: as many backups as the limit and one more step for each, 200 -> fails.
    """
    names = runpy.run_path(str(Path(__file__).parent.parent / "examples" / "imported_environments.py"))
    best, exact, in_time, played = names["lake_success"].values()
    assert best == pytest.approx(14 / 17)
    assert best - 0.01 < exact <= best + 1e-9
    assert in_time < exact - 0.05
    assert abs(played - in_time) < 4 * (in_time * (1 - in_time) / 1000) ** 0.5
    assert names["catch_value"]["at best"] == pytest.approx(1)
    assert names["catch_value"]["as learned"] > 0.99
    assert capsys.readouterr().out.count("reward -100.0, and again in state 36") == 2


def test_actions_that_are_not_there_do_what_the_first_one_does():
    """As in Gymnasium, see there. Broken once: what the environment makes of action 5, right -> fails."""
    env, key = to_gymnax(rl.make("maximization-bias")), jax.random.key(0)
    _, state = env.reset(key)
    s, state, reward, terminated, _, info = env.step(key, state, 5)
    assert (int(s), float(reward), bool(terminated)) == (1, 0, False) and info["action_mask"].all()
