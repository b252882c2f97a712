"""What methods and environments declare: texts and defaults, in classes of nobody's family too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import plot, stats
from jaxrl_tab.algorithms import PolicyGradient
from jaxrl_tab.core.declared import Learns, LearnsFrom, OfMethod, of_environment, of_method
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.methods import METHODS, PREDICTION
from jaxrl_tab.stats.measures import has_errors


@pytest.mark.parametrize("name", METHODS)
def test_every_registered_method_declares_what_it_learns(name):
    learns = of_method(METHODS[name]).learns
    of_control = Learns.PREFERENCES if issubclass(METHODS[name], PolicyGradient) else Learns.ACTIONS
    assert learns is (Learns.STATES if name in PREDICTION else of_control)
    assert hasattr(METHODS[name], learns.initial) or of_method(METHODS[name]).needs_horizon


def test_what_is_learned_from_is_a_text_with_two_consequences():
    table = [(x.value, x.needs_behaviour, x.in_episodes) for x in LearnsFrom]
    assert table == [
        ("itself", False, False),
        ("transitions", False, False),
        ("transitions of b", True, False),
        ("episodes", False, True),
        ("episodes of b", True, True),
    ]


@pytree
class Mean:
    """Of nobody's family: Q(S, A) is the last reward, and every action is equally likely."""

    gamma: float = 1.0

    learns_from = "transitions of b"
    behaviour = None

    def init(self, num_states, num_actions):
        return rl.algorithms.TDState(jnp.zeros((num_states, num_actions)), None)

    def policy(self, key, state, s):
        return jax.random.randint(key, (), 0, state.q.shape[1])

    def update(self, key, state, t):
        return state._replace(q=state.q.at[t.s, t.a].set(t.r)), self.policy(key, state, t.s_next)


def test_texts_in_own_classes_are_the_declaration():
    declared = of_method(Mean())
    assert declared == OfMethod(learns_from=LearnsFrom.TRANSITIONS_OF_B)
    assert (declared.learns, declared.learns_from) == ("actions", "transitions of b")
    log = rl.Experience(s=[0], a=[0], r=[2.0], s_next=[1], terminal=[True])
    with pytest.raises(rl.InputError, match="Mean weighs what it learns by the policy that acted"):
        rl.learn(jax.random.key(0), Mean(), log, 2, 1)


def test_what_is_said_of_an_update_is_not_said_of_another_one():
    """A subclass may say something else of the one that it inherits. Broken once: each inherits all -> fails."""
    said, another = {"learns_from": "episodes", "acts_after_update": True}, {"update": lambda *_: None}
    Says = type("Says", (Mean,), said)
    assert of_method(Says) == OfMethod(learns_from=LearnsFrom.EPISODES, acts_after_update=True)
    assert of_method(type("Updates", (Says,), another)) == OfMethod()


@pytest.mark.parametrize(
    ("attribute", "text", "message"),
    [
        (
            "learns_from",
            "transition",
            "Wrong: learns_from 'transition' is unknown; did you mean 'transitions'?",
        ),
        ("learns", "values", "Wrong: learns 'values' is unknown; did you mean 'states'?"),
    ],
)
def test_another_text_is_refused(attribute, text, message):
    """Broken once: not checked -> fails, by an error of the enum that does not say which class it is."""
    Wrong = type("Wrong", (Mean,), {attribute: text, "update": Mean.update})
    with pytest.raises(rl.InputError) as error:
        of_method(Wrong())
    assert str(error.value) == message


@pytree
class Door:
    """The methods of the protocol, and no base class: either action ends the episode, and pays."""

    num_states, num_actions, max_steps = 2, 2, 5

    def reset(self, key):
        return jnp.int32(0)

    def step(self, key, s, a):
        return Outcome(jnp.int32(1), jnp.asarray(a, float), jnp.bool(True))


def test_an_environment_without_a_base_class_declares_nothing_and_runs():
    assert of_environment(Door()) == (
        None,
        None,
        None,
        None,
        tuple,
        None,
        ("0", "1"),
        None,
        None,
        False,
        *[None] * 7,
        (),
        *[None] * 3,
    )
    ds = rl.sweep(Door(), Mean, num_seeds=2, num_steps=20).to_xarray()
    assert ds.attrs["learns"] == "actions"
    np.testing.assert_array_equal(ds.q[:, 0], [[0, 1]] * 2)
    assert set(plot.pictures({"mean": ds}, Door())) == {"episodes", "learning_curves"}


@pytest.fixture(scope="module")
def td():
    """TD(0) on the cliff, once with its error, once without."""
    runs = [
        rl.sweep(rl.CliffWalking(), "td", num_seeds=2, num_steps=200, log_every=100, exact=exact).to_xarray()
        for exact in (True, False)
    ]
    return dict(zip(("exact", "plain"), runs, strict=True))


@pytest.mark.slow
def test_a_dataset_says_what_was_learned_whatever_was_recorded(td):
    assert [ds.attrs["learns"] for ds in td.values()] == ["states"] * 2
    assert stats.is_prediction(*td.values())
    assert [has_errors(ds) for ds in td.values()] == [True, False]


def test_a_file_of_before_tells_it_by_its_error(td):
    older = {name: ds.drop_attrs() for name, ds in td.items()}
    assert [stats.is_prediction(ds) for ds in older.values()] == [True, False]


def test_values_of_states_have_no_path_though_no_error_was_recorded(td):
    """Broken once: told by `v_error` -> a path, of the one action that V has."""
    assert "greedy_path" not in plot.pictures({"td": td["plain"]}, rl.CliffWalking())


def test_the_initial_value_of_prediction_bounds_what_it_learns():
    """10 times |v0|, in addition to the largest return. Broken once: q0 of all methods -> no difference."""
    result = rl.sweep(rl.RandomWalk(), "td", {"v0": [0.0, -5.0]}, num_seeds=1, num_steps=10)
    assert np.diff(result.largest_value) == 50
