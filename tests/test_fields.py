"""Fields say what they take: what is refused, how, and what is read from text; in help and docstrings as well."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import policies, schedules
from jaxrl_tab.core import describe
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.envs import ENVS
from jaxrl_tab.methods import METHODS

REGISTERED = [*ENVS.values(), *METHODS.values()]
CLASSES = [*REGISTERED, *policies.POLICIES.values(), *schedules.FAMILIES.values()]
NEEDED = {schedules.Linear: (1.0, 0.0, 5), schedules.Exponential: (1.0, 0.5)}  # arguments without a default

# --- limits ------------------------------------------------------------------------------------------

# By hand, independently of the classes: a value just outside of each field's range, or on an end that is not in it.
OUTSIDE = {
    "alpha": [0, -1e-3],
    "alpha_v": [0, -1e-3],
    "epsilon": [-0.1, 1.1],
    "gamma": [-0.1, 1.5],
    "beta": [0],
    "eta": [0],
    "lam": [-0.1, 1.1],
    "sigma": [-0.1, 1.1],
    "lam_v": [-0.1, 1.1],
    "temperature": [0],
    "c": [-0.5],
    "power": [0],
    "scale": [0],
    "n0": [0],
    "start": [-0.1],
    "end": [-0.1],
    "steps": [0.5],
    "planning_steps": [-1],
    "kappa": [-0.1],
    "m": [0.5],
    "p": [0, 1],
    "r_max": [0],
    "sweeps": [0],
    "prior": [0],
    "spread": [-0.1],
    "every": [0.5],
    "samples": [0],
    "change_at": [-1],
    "changed": [-0.1, 1.1],
    "theta": [-0.1],
    "rate": [0, 1],
    "n": [0],
    "batch": [0],
    "buffer": [0],
    "target_every": [0],
    "arms": [0],
    "drift": [-0.1],
    "tables": [0],
    "states": [0],
    "actions": [1],
    "branching": [0],
    "size": [1],
    "number": [-1],
    "short": [0],
    "long": [0],
    "max_steps": [0],
    "back": [-0.1, 1],
    "servers": [0],
    "free": [-0.1, 1.1],
    "prizes": [[-1.0]],
    "left": [[-1.0, 2.0]],
    "slip": [-0.1, 1.1],
    "success_rate": [-0.1, 1.1],
    "rainy_probability": [-0.1, 1.1],
    "fickle_probability": [-0.1, 1.1],
    "p_h": [-0.1, 1.1],
    "goal": [1],
    "jump": [0],
    "width": [0.0, 2.1],
    "capacity": [0],
    "most_moved": [-1],
    "failure": [-0.1, 1],
    "stays_high": [-0.1, 1.1],
    "stays_low": [-0.1, 1.1],
    "right": [[-1.0, 2.0]],
    "ends": [0, 1.1],
    "ridge": [0],
}
LIMITED = [(cls, f.name) for cls in CLASSES for f in dataclasses.fields(cls) if f.metadata.get("limits")]


@pytest.mark.parametrize(("cls", "name"), LIMITED)
def test_what_is_out_of_range_is_refused_and_says_who_what_and_why(cls, name):
    """Every field with limits in the package, those of base classes too. Broken once: a field that gives another
    default (MonteCarlo.alpha) lost the limits of its base -> fails.
    """
    for wrong in OUTSIDE[name]:
        names = [f.name for f in dataclasses.fields(cls)]
        given = dict(zip(names, NEEDED.get(cls, ()), strict=False)) | {name: wrong}
        with pytest.raises(InputError) as error:
            cls(**given)
        assert (error.value.who, error.value.field) == (cls.__name__, name)
        assert str(error.value).startswith(f"{cls.__name__}: {name} must be {error.value.wanted}, not ")
        assert error.value.value == (wrong[0] if isinstance(wrong, list) else wrong)


def test_there_are_limits_everywhere():
    names = {name for _, name in LIMITED}
    assert names == OUTSIDE.keys() and len(LIMITED) > 70


def test_numbers_are_checked_entry_by_entry_and_not_a_number_is_none():
    for wrong in (np.array([0.5, 1.5]), np.nan, np.inf, np.array([0.1, np.nan])):
        with pytest.raises(InputError, match="Sarsa: gamma must be between 0 and 1, not"):
            rl.Sarsa(gamma=wrong)
    with pytest.raises(InputError, match="RandomWalk: left_reward must be finite, not inf"):
        rl.envs.RandomWalk(left_reward=np.inf)


def test_what_a_person_called_the_class_begins_the_message():
    with pytest.raises(
        InputError, match=r"^cliff-walking: max_steps must be a whole number of at least 1, not 0$"
    ):
        rl.make("cliff-walking", max_steps=0)
    with pytest.raises(InputError, match=r"^CliffWalking: max_steps must be"):
        rl.envs.CliffWalking(max_steps=0)


# --- errors ------------------------------------------------------------------------------------------


def test_an_error_keeps_what_it_carries_when_it_travels():
    """Broken once: without the attributes in what is pickled -> fails."""
    error = InputError("n must be 1, not 2", who="A", field="n", wanted="1", value=2)
    for other in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
        assert str(other) == "A: n must be 1, not 2"
        assert (other.who, other.field, other.wanted, other.value) == ("A", "n", "1", 2)
    plain = InputError("nothing is right")
    assert str(plain) == "nothing is right"
    assert (plain.who, plain.field, plain.wanted, plain.value) == (None, None, None, None)


def test_an_error_is_renamed_without_a_look_at_its_words():
    error = InputError("a: b: c", who="A: B", field="n")
    assert str(error.renamed("C")) == "C: a: b: c"
    assert str(error.renamed("C", "m")) == "C: m: a: b: c"
    assert error.renamed("C").field == "n" and error.renamed("C", "m").field == "m"
    assert str(error) == "A: B: a: b: c"


@pytest.mark.parametrize(
    ("make", "message", "field"),
    [
        (lambda: rl.prediction.TD(pi=[[0.5]]), "TD: pi: the probabilities in state 0 are not", "pi"),
        (
            lambda: rl.prediction.TDLambda(trace="dutch", offline=True),
            "TDLambda: offline goes with accumulating",
            "offline",
        ),
        (
            lambda: rl.Sarsa(alpha="harmonic:-1:visit"),
            "Sarsa: alpha: n0 must be greater than 0, not -1",
            "alpha",
        ),
        (
            lambda: rl.Sarsa(epsilon="small"),
            "Sarsa: epsilon: 'small' is neither a number nor a sched",
            "epsilon",
        ),
        (lambda: rl.Sarsa(epsilon="-1"), "Sarsa: epsilon must be between 0 and 1, not -1.0", "epsilon"),
        (
            lambda: rl.Sarsa(behaviour="softmax::"),
            "Sarsa: behaviour: 'softmax::' is not of the form",
            "behaviour",
        ),
        (lambda: rl.Sarsa(gamma="0.9"), "Sarsa: gamma must be a number, not '0.9'", "gamma"),  # type: ignore
        (lambda: rl.QLambda(trace="dutch"), "QLambda: trace 'dutch' is unknown", "trace"),  # type: ignore
    ],
)
def test_errors_from_within_name_what_the_person_wrote(make, message, field):
    with pytest.raises(InputError) as error:
        make()
    assert str(error.value).startswith(message)
    assert error.value.field == field
    assert "command line" not in str(error.value)


# --- texts -------------------------------------------------------------------------------------------


def test_texts_are_read_as_on_the_command_line():
    method = rl.Sarsa(alpha="harmonic:100:visit", behaviour="softmax:0.5")  # pyright: ignore[reportArgumentType]
    assert repr(method.alpha) == repr(schedules.Harmonic(100.0, clock="visit"))
    assert repr(method.behaviour) == repr(policies.Softmax(0.5))
    method = rl.MonteCarlo(alpha="0.5", epsilon="glie")  # pyright: ignore[reportArgumentType]
    assert method.alpha == 0.5 and repr(method.epsilon) == repr(schedules.glie())
    target = rl.ExpectedSarsa(target="epsilon_greedy:glie").target  # pyright: ignore[reportArgumentType]
    assert repr(target) == repr(policies.EpsilonGreedy(schedules.glie()))


def test_a_grid_of_texts_is_that_of_what_they_mean():
    """Broken once: the texts themselves as the values of the axis -> fails."""
    env = rl.make("two-doors")
    run = lambda values: rl.sweep(env, rl.Sarsa, {"epsilon": values}, num_seeds=2, num_steps=20)
    texts, objects = run(["harmonic:1:episode", "0.5"]), run([schedules.glie(), 0.5])
    assert texts.to_xarray().equals(objects.to_xarray())
    assert [str(x) for x in texts.grid["epsilon"]] == ["glie", "0.5"]
    with pytest.raises(InputError, match="holds glie more than once"):
        run(["glie", "harmonic:1:episode"])


@pytest.mark.parametrize("values", [{0.1, 0.2}, frozenset({0.1}), (x for x in (0.1, 0.2)), map(float, "12")])
def test_what_has_no_order_or_can_be_read_once_is_no_grid(values):
    with pytest.raises(
        InputError, match="the grid of alpha must be a list, which has an order and a length, not "
    ):
        rl.sweep(rl.make("two-doors"), rl.Sarsa, {"alpha": values}, num_seeds=1, num_steps=1)


# --- help --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cls", CLASSES)
def test_the_docstring_explains_every_field_inherited_ones_too(cls):
    text = " ".join(cls.__doc__.partition("\nAttributes:\n")[2].split())
    for parameter in describe.parameters(cls):
        assert parameter.help and f"{parameter.name}: {parameter.help}" in text


def test_help_says_the_range_that_is_checked():
    told = {p.name: p.help for p in describe.parameters(rl.SarsaLambda)}
    assert told["alpha"] == "Step size. A number greater than 0, or a schedule."
    assert told["gamma"] == "Discount rate. A number between 0 and 1."
    assert told["trace"].endswith('"accumulating", "replacing", "clearing" or "dutch".')


# --- classes of users --------------------------------------------------------------------------------


@rl.pytree
class Mine(rl.Sarsa):
    """A method of somebody's own.

    Attributes:
        alpha: how far
            it goes.
        mine: whatever.
    """

    alpha: float = 0.7
    mine: float = -5.0
    size: int = rl.static(default=3)
    limited: float = rl.field(default=2.0, at_least=1, at_most=3, help="A number of mine.")


def test_plain_fields_take_anything_and_say_what_the_docstring_says():
    assert Mine(mine="anything").mine == "anything"  # pyright: ignore[reportArgumentType]
    assert Mine(size=2.5).size == 2.5  # pyright: ignore[reportArgumentType]
    told = {p.name: p.help for p in describe.parameters(Mine)}
    assert told["mine"] == "whatever."
    assert told["limited"] == "A number of mine. A number between 1 and 3."
    assert told["gamma"] == "Discount rate. A number between 0 and 1."


def test_another_default_keeps_the_limits_of_the_base():
    """Broken once: a field of a plain annotation has no limits -> fails."""
    with pytest.raises(InputError, match="Mine: alpha must be greater than 0, not -1"):
        Mine(alpha=-1)
    with pytest.raises(InputError, match="Mine: limited must be between 1 and 3, not 4"):
        Mine(limited=4)
