"""Gymnasium both ways: against plain value iteration on its own tables, its own checks, and round trips."""

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sampling
from gymnasium import wrappers
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.utils.env_checker import check_env
from test_finite_mdp import JUNK

import jaxrl_tab as rl
from jaxrl_tab import cli, planning
from jaxrl_tab.envs import FiniteMDP
from jaxrl_tab.envs.base import MAX_STEPS
from jaxrl_tab.interop import from_gymnasium, make, pictures, to_gymnasium
from jaxrl_tab.interop.gymnasium import HARMLESS

SLIPPERY = {"desc": ["SFF", "FHF", "FFG"], "success_rate": 0.5}


def plain_value_iteration(env, gamma=1.0):
    """v* of Gymnasium's own table, by loops: an outcome that is done has no future."""
    v = np.zeros(env.observation_space.n)
    for _ in range(5000):
        old = v.copy()
        for s, actions in env.unwrapped.P.items():
            v[s] = max(
                sum(p * (r + (0 if done else gamma * v[s_next])) for p, s_next, r, done in outcomes)
                for outcomes in actions.values()
            )
        if np.abs(v - old).max() < 1e-12:
            return v
    raise AssertionError("no convergence")


@pytest.mark.parametrize(
    ("name", "parameters", "max_steps", "from_the_start"),
    [
        ("FrozenLake-v1", {}, 100, 14 / 17),
        ("FrozenLake-v1", {"is_slippery": False}, 100, 1),
        ("FrozenLake-v1", SLIPPERY, 100, None),
        ("Taxi-v4", {}, 200, 7.93),
        ("CliffWalking-v1", {}, 10_000, -13),
        ("CliffWalking-v1", {"is_slippery": True, "max_episode_steps": 77}, 77, None),
    ],
)
def test_optimal_values_are_those_of_the_table(name, parameters, max_steps, from_the_start):
    theirs = gymnasium.make(name, **parameters)
    env = from_gymnasium(name, **parameters)
    assert (env.num_states, env.num_actions) == (theirs.observation_space.n, theirs.action_space.n)
    assert env.max_steps == max_steps
    v, _ = planning.value_iteration(env)
    counts = planning.reachable(planning.exact_model(env)) & ~env.is_terminal
    expected = plain_value_iteration(theirs)
    np.testing.assert_allclose(v[counts], expected[counts], atol=1e-8)
    assert (v[env.is_terminal] == 0).all()
    start = theirs.unwrapped.initial_state_distrib
    np.testing.assert_allclose(env.initial(), start, rtol=1e-6)
    if from_the_start is not None:
        assert start @ v == pytest.approx(from_the_start, abs=1e-6)


def test_terminal_states_go_by_the_done_flag():
    """The goal of the cliff is not absorbing in the table; of the taxi 404 states can be reached."""
    cliff = from_gymnasium("CliffWalking-v1")
    assert np.flatnonzero(cliff.is_terminal).tolist() == [47]
    assert gymnasium.make("CliffWalking-v1").unwrapped.P[47][3] == [(1, 36, -100, False)]
    taxi = from_gymnasium("Taxi-v4")
    assert taxi.is_terminal.sum() == 4
    assert planning.reachable(planning.exact_model(taxi)).sum() == 404


def test_equal_outcomes_are_added_up():
    """At the top left, two of three slips lead back; Gymnasium lists them one by one."""
    prob, outcome = from_gymnasium("FrozenLake-v1").outcomes(jnp.int32(0), jnp.int32(0))
    listed = sorted((s, p) for p, s in zip(prob.tolist(), outcome.s_next.tolist(), strict=True) if p > 0)
    assert listed == [(0, pytest.approx(2 / 3)), (4, pytest.approx(1 / 3))]


class Odd(gymnasium.Env):
    """A table in which state 1 is entered with an end and without, and with different rewards."""

    observation_space, action_space = gymnasium.spaces.Discrete(2), gymnasium.spaces.Discrete(1)
    P = {  # noqa: RUF012
        0: {0: [(0.25, 1, 1.0, True), (0.25, 1, 3.0, True), (0.25, 1, 0.0, False), (0.25, 0, 0.0, False)]},
        1: {0: [(1.0, 0, 8.0, False)]},
    }
    initial_state_distrib = np.array([1.0, 0.0])


def test_a_state_that_ends_and_goes_on_gets_two_numbers():
    """Broken once -> fails: such a state terminal in all cases. Rewards on the same way are kept apart."""
    env = from_gymnasium(Odd())
    v, _ = planning.value_iteration(env)
    assert env.is_terminal.tolist() == [False, False, True]
    assert v == pytest.approx([6, 14, 0])  # v0 = (1 + 3 + (8 + v0) + v0) / 4
    prob, outcome = env.outcomes(jnp.int32(0), jnp.int32(0))
    listed = {
        (s, r): p
        for p, s, r in zip(prob.tolist(), outcome.s_next.tolist(), outcome.reward.tolist(), strict=True)
    }
    assert listed == dict.fromkeys([(2, 1.0), (2, 3.0), (1, 0.0), (0, 0.0)], 0.25)


@pytest.mark.parametrize(
    ("given", "parameters", "message"),
    [
        (
            "FrozenLake-v9",
            {},
            "gymnasium: Environment version `v9` for environment `FrozenLake` doesn't exist",
        ),
        ("NoSuchLake-v1", {}, "gymnasium: Environment `NoSuchLake` doesn't exist"),
        ("FrozenLake-v1", {"slip": 1}, "FrozenLake-v1: .*slip"),
        (
            "Blackjack-v1",
            {},
            r'Blackjack-v1 has no table of its outcomes .*; rl.make\("blackjack", rules="gymnasium"\) is that game',
        ),
        (
            "CartPole-v1",
            {},
            "CartPole-v1 has no table of its outcomes .*only an environment such as FrozenLake-v1",
        ),
        ("FrozenLake-v1", {"map_name": "5x5"}, "FrozenLake-v1: '5x5'"),
        (
            "FrozenLake-v1",
            {"max_episode_steps": 0},
            "FrozenLake-v1: Expect the `max_episode_steps` to be positive",
        ),
        ("no_such_module:Lake-v0", {}, "no_such_module:Lake-v0: .*no_such_module"),
        ("Taxi-v4", {"fickle_passenger": True}, "Taxi-v4: fickle_passenger changes what happens"),
        (Odd(), {"slip": 1}, "slip: parameters go with the name"),
        (7, {}, "env must be the name of an environment of Gymnasium, or one, not 7"),
    ],
)
def test_what_is_wrong_is_said(given, parameters, message):
    with pytest.raises(rl.InputError, match=message):
        from_gymnasium(given, **parameters)


class Table(gymnasium.Env):
    """Two states, of which 1 is the end, and two actions; it plays by its table."""

    observation_space = action_space = gymnasium.spaces.Discrete(2)
    initial_state_distrib = np.array([1.0, 0.0])

    def __init__(self, actions):
        self.P = {1: {a: [(1.0, 1, 0.0, True)] for a in actions}, 0: actions}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        _, s_next, reward, terminated = self.P[0][action][0]
        return s_next, reward, terminated, False, {}


FIVE_OR_ONE = {1: [(1.0, 1, 5.0, True)], 0: [(1.0, 1, 1.0, True)]}


def test_actions_and_states_go_by_their_keys():
    """Broken once: in the order in which they stand -> q(0) is [5, 1]."""
    for actions in (FIVE_OR_ONE, {np.int64(a): x for a, x in FIVE_OR_ONE.items()}):
        assert planning.value_iteration(from_gymnasium(Table(actions)))[1][0].tolist() == [1, 5]
    with pytest.raises(
        rl.InputError, match="the keys of the actions of s = 0 must be 0 to 2, and 0 is missing"
    ):
        from_gymnasium(Table({1: FIVE_OR_ONE[1], 2: FIVE_OR_ONE[0]}))
    with pytest.raises(
        rl.InputError, match=r"Table: its table has 1 actions, and its action_space is Discrete\(2\)"
    ):
        from_gymnasium(Table({0: FIVE_OR_ONE[0]}))
    env = Table(FIVE_OR_ONE)
    del env.P[1][1]
    with pytest.raises(rl.InputError, match="s = 1 has 1 actions, and s = 0 has 2"):
        from_gymnasium(env)


def test_nonsense_gets_one_line():
    """Any part of an environment that a table is made of, replaced by anything."""
    said = []
    for name in ("P", "initial_state_distrib", "observation_space", "action_space"):
        for junk in JUNK:
            env = Table(FIVE_OR_ONE)
            setattr(env, name, junk)
            try:
                from_gymnasium(env)
            except rl.InputError as error:
                said.append(str(error))
    assert len(said) > 100
    assert not any("\n" in text or len(text) > 500 for text in said)


# --- what is around a table ----------------------------------------------------------------------------


def lake(limit=100):
    return gymnasium.make("FrozenLake-v1", max_episode_steps=limit)


class Reversed(gymnasium.ActionWrapper):
    def action(self, action):
        return 3 - action


class Doubled(gymnasium.RewardWrapper):
    def reward(self, reward):
        return 2 * reward


class Moved(gymnasium.ObservationWrapper):
    def observation(self, observation):
        return 15 - observation


class Patient(wrappers.TimeLimit):
    def step(self, action):
        *outcome, _, info = self.env.step(action)
        return *outcome, False, info


@pytest.mark.parametrize(
    "wrap",
    [
        Reversed,
        Doubled,
        Moved,
        lambda env: Patient(env, 50),
        lambda env: wrappers.TimeLimit(Doubled(env), 50),
        lambda env: wrappers.StickyAction(env, 0.5),
        lambda env: wrappers.TimeAwareObservation(env, flatten=False),
        lambda env: wrappers.TransformReward(env, lambda r: r),
        wrappers.NormalizeReward,
        wrappers.FlattenObservation,
        wrappers.Autoreset,
    ],
)
def test_wrappers_that_change_something_are_refused(wrap):
    """Broken once: wrappers not looked at -> every one is dropped, and nothing is said."""
    env = wrap(lake())
    name = type(env if type(env) is not wrappers.TimeLimit else env.env).__name__
    with pytest.raises(
        rl.InputError, match=f"does not know what the wrapper {name} changes; import env.unwrapped"
    ):
        from_gymnasium(env)


@pytest.mark.parametrize("wrap", [*HARMLESS[:3], lambda env: wrappers.TimeLimit(env, 10**6)])
def test_wrappers_that_are_passed_through_change_nothing(wrap):
    plain, wrapped = (walk(env, 500, seed=0) for env in (lake(), wrap(lake())))
    for x, y in zip(plain, wrapped, strict=True):
        np.testing.assert_array_equal(x, y)
    assert from_gymnasium(wrap(lake())).max_steps == 100


@pytest.mark.parametrize(
    ("env", "max_steps"),
    [
        (wrappers.TimeLimit(lake(), 30), 30),
        (wrappers.TimeLimit(lake(7), 30), 7),  # the outer one is never met
        (lake(-1), MAX_STEPS),  # as Gymnasium says that there is none
        (wrappers.TimeLimit(lake().unwrapped, 500), 500),
        (wrappers.TimeLimit(to_gymnasium(rl.CliffWalking(max_steps=20)), 99), 20),
    ],
)
def test_the_time_limit_is_the_shortest(env, max_steps):
    assert from_gymnasium(env).max_steps == max_steps


class Shaped(FrozenLakeEnv):
    def step(self, action):
        s, reward, *rest = super().step(action)
        return s, reward - 0.01, *rest


class Mirrored(FrozenLakeEnv):
    def step(self, action):
        return super().step(3 - action)


class Hasty(FrozenLakeEnv):
    def step(self, action):
        s, reward, terminated, _, info = super().step(action)
        return s, reward, terminated, True, info


class Elsewhere(FrozenLakeEnv):
    def reset(self, **kwargs):
        _, info = super().reset(**kwargs)
        self.s = 14
        return 14, info


class Broken(FrozenLakeEnv):
    def step(self, action):
        raise RuntimeError("no\ngame")


class Louder(FrozenLakeEnv):
    """Other pictures, the same game."""

    def step(self, action):
        return super().step(action)


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (Shaped(), "Shaped: action . in state . was followed by state . with reward -0.01, which its table"),
        (
            Mirrored(),
            "Mirrored: action . in state .* was followed by state .* with reward 0.*, which its table",
        ),
        (wrappers.TimeLimit(Hasty(), 9), "Hasty: an episode was truncated after 1 steps, which its table"),
        (Elsewhere(), "Elsewhere: an episode starts in state 14, which its table"),
        (Broken(), r"Broken: its steps could not be compared with its table \(RuntimeError: no game\)"),
    ],
)
def test_what_an_environment_does_must_be_in_its_table(env, message):
    """Gymnasium's own are not tried. Broken once: nor any other -> what they change is lost."""
    with pytest.raises(
        rl.InputError, match=f"{message}.*FiniteMDP.from_outcomes takes env.unwrapped.P alone"
    ):
        from_gymnasium(env)


def test_an_environment_that_does_what_it_says_is_taken_and_left_as_it_is():
    env = Louder(is_slippery=True, map_name="8x8")
    env.reset(seed=3)
    before = env.s, env.np_random.bit_generator.state
    assert from_gymnasium(env).num_states == 64
    assert (env.s, env.np_random.bit_generator.state) == before


def test_a_vector_of_environments_is_not_one():
    with pytest.raises(rl.InputError, match=r"env is a vector of environments.*env.envs\[0\]"):
        from_gymnasium(gymnasium.make_vec("FrozenLake-v1", num_envs=2))


def test_theirs_is_not_ours():
    for call in (to_gymnasium, lambda env: rl.train(jax.random.key(0), rl.Sarsa(), env, num_steps=1)):
        with pytest.raises(
            rl.InputError,
            match=r"env must be an environment of jaxrl_tab, not .*; rl.interop.from_gymnasium imports it",
        ):
            call(lake())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("FrozenLake-v1", "did you mean 'frozen-lake'?"),
        ("FrozenLake8x8-v1", "'gymnasium:FrozenLake8x8-v1' imports it"),
        ("Taxi-v3", "did you mean 'taxi'?"),
        (
            "CartPole-v1",
            "'gymnasium:CartPole-v1' imports it, if it has a table of its outcomes",
        ),
        (
            "Catch-bsuite",
            "'gymnax:Catch-bsuite' imports it, if its states can be counted",
        ),
        ("CliffWalking-v1", "did you mean 'cliff-walking'?"),
        ("Blackjack-v1", "did you mean 'blackjack'?"),
    ],
)
def test_names_that_are_not_ours_lead_to_where_they_are(name, message, tmp_path, capsys):
    """In Python, on the command line, and in a file."""
    with pytest.raises(rl.InputError) as error:
        rl.make(name)
    assert str(error.value) == f"{name!r} is not an environment; {message}"
    for command in (["solve", name], ["sweep", name, "sarsa"]):
        assert cli.main(command) == 2
        assert capsys.readouterr().err == f"jaxrl-tab: {name!r} is not an environment; {message}\n"
    with pytest.raises(rl.InputError) as error:
        rl.Experiment(name, "sarsa", seeds=2, steps=9)
    assert str(error.value).endswith(f"{name!r} is not an environment; {message}")


@pytest.mark.parametrize("name", ["taxi", "gym:Taxi-v4", "gymnasium:", ""])
def test_names_have_a_prefix(name):
    with pytest.raises(rl.InputError, match="is not of the form gymnasium:NAME or gymnax:NAME"):
        make(name)


def test_a_name_with_a_prefix():
    assert make("gymnasium:FrozenLake-v1", is_slippery=False).num_states == 16


# --- ours for them -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gusty():
    """Three gusts of wind, a time limit that is often met."""
    return rl.make(
        "windy-gridworld", stochastic=True, shape=(3, 4), wind=(0, 1, 1, 0), start=(2, 0), goal=(0, 3)
    )


@pytest.mark.parametrize("env", [rl.CliffWalking(), rl.make("blackjack"), rl.make("k-armed-testbed")])
def test_gymnasiums_own_check(env):
    check_env(to_gymnasium(env))


def test_round_trip(gusty):
    """The table of ours, imported again, is ours; also through gymnasium.make, which wraps it."""
    for theirs in (to_gymnasium(gusty), gymnasium.make(to_gymnasium(gusty).spec)):
        again = from_gymnasium(theirs)
        assert isinstance(again, FiniteMDP)
        assert again.max_steps == gusty.max_steps
        for gamma in (0.9, 1.0):
            for x, y in zip(*(planning.value_iteration(e, gamma) for e in (gusty, again)), strict=True):
                np.testing.assert_allclose(x, y, atol=1e-9)


def walk(env, num_steps, seed):
    """Transitions of a random walk by Gymnasium's rules, and how often it was terminated and truncated."""
    choose = np.random.default_rng(seed)
    s, _ = env.reset(seed=seed)
    seen, ends = [], np.zeros(2, int)
    for _ in range(num_steps):
        a = choose.integers(env.action_space.n)
        s_next, reward, terminated, truncated, _ = env.step(a)
        seen.append((s, a, reward, s_next))
        ends += terminated, truncated
        s = env.reset()[0] if terminated or truncated else s_next
    return *map(np.array, zip(*seen, strict=True)), ends


def test_what_happens_is_what_the_environment_states(gusty):
    env = rl.make(
        "windy-gridworld",
        **{f: getattr(gusty, f) for f in ("shape", "wind", "start", "goal")},
        stochastic=True,
        max_steps=10,
    )
    s, a, reward, s_next, (terminated, truncated) = walk(to_gymnasium(env), 4000, seed=0)
    p = sampling.p_value_of_transitions(planning.exact_model(env), s, a, reward, s_next)
    assert p > 0.001
    assert (s_next == 3).sum() == terminated > 50
    assert 400 > truncated > 50


def test_seeds_make_it_reproducible(gusty):
    first, again, other = (walk(to_gymnasium(gusty), 200, seed)[3] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_use_is_checked(gusty):
    env = to_gymnasium(gusty)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    env.reset(seed=0)
    with pytest.raises(rl.InputError, match="action must be one of 0 to 3, not 4"):
        env.step(4)
    with pytest.raises(rl.InputError, match="env must be an instance, such as CliffWalking"):
        to_gymnasium("cliff-walking")  # pyright: ignore[reportArgumentType]


def test_q_learning_learns_the_lake():
    """What is imported is an environment like any other."""
    env = from_gymnasium("FrozenLake-v1", is_slippery=False)
    method = rl.QLearning(alpha=0.5, epsilon=0.5, gamma=0.9)
    run = jax.jit(jax.vmap(lambda key: rl.train(key, method, env, num_steps=10_000, log_every=10_000)[0].q))
    q = run(jax.random.split(jax.random.key(0), 20))
    np.testing.assert_allclose(q[:, 0].max(1), 0.9**5, rtol=1e-4)


def test_actions_that_are_not_there_are_said_and_do_what_the_first_one_does():
    """In state A of maximisation bias there are left, 0, and right, 1. Broken once: 5 goes right -> fails."""
    env = to_gymnasium(rl.make("maximization-bias"))
    _, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [1, 1] + 8 * [0] and info["action_mask"].dtype == np.int8
    s, reward, terminated, _, info = env.step(5)
    assert (s, reward, terminated) == (1, 0, False) and env.P[0][5] == [(1.0, 1, 0.0, False)]
    assert info["action_mask"].all()
    with_all = to_gymnasium(rl.make("cliff-walking"))
    assert with_all.reset(seed=0)[1] == {}


# --- registered there ---------------------------------------------------------------------------------


def test_ours_are_registered_with_their_parameters():
    """Each under the name of its class; the table is ours, also where Gymnasium's wrappers are around it."""
    there = {name for name in gymnasium.registry if name.startswith("jaxrl_tab/")}
    assert there == {f"jaxrl_tab/{cls.__name__}-v0" for cls in rl.ENVS.values()}
    env = gymnasium.make("jaxrl_tab/WindyGridworld-v0", moves="king", render_mode="ansi")
    v, _ = planning.value_iteration(from_gymnasium(env))
    assert v[30] == -7
    assert (env.spec.id, env.unwrapped.initial_state_distrib[30]) == ("jaxrl_tab/WindyGridworld-v0", 1)
    with pytest.raises(rl.InputError, match="windy-gridworld: moves 'queen' is unknown"):
        gymnasium.make("jaxrl_tab/WindyGridworld-v0", moves="queen")
    with pytest.raises(rl.InputError, match="render_mode 'human' is unknown"):
        to_gymnasium(rl.make("chain"), "human")


def test_a_grid_is_rendered_with_the_agent_in_it():
    """In characters; and in pixels, of 32 a cell."""
    grid = {"map": ["S.#", "..G"], "disable_env_checker": True}
    env = gymnasium.make("jaxrl_tab/Maze-v0", render_mode="ansi", **grid)
    env.reset(seed=0)
    assert env.render() == "state 0 of 6\n[S] .  #\n .  .  G\n"
    env.step(1)
    assert env.render() == "state 1 of 6, after →\n S [.] #\n .  .  G\n"
    env = gymnasium.make("jaxrl_tab/Maze-v0", render_mode="rgb_array", **grid)
    env.reset(seed=0)
    env.step(1)
    middle = env.render()[16::32, 16::32]
    assert middle.shape == (2, 3, 3) and len(np.unique(middle.reshape(6, 3), axis=0)) == 5
    assert (middle[0, 1] == pictures.AGENT).all() and (middle[0, 2] == pictures.WALL).all()


@pytest.mark.parametrize("name", ["blackjack", "river-swim", "deep-sea", "cliff-walking"])
def test_each_state_has_its_place_in_a_picture(name):
    env = rl.make(name)
    shown = pictures.places(env)
    assert sorted(shown[shown >= 0]) == list(range(env.num_states))
    images = {pictures.pixels(env, s).tobytes() for s in range(6)}
    assert len(images) == 6
