"""The tests check every call in the package against its annotations: see `annotations`."""

import annotations
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from annotations import WrongArgument, checked
from beartype.roar import BeartypeCallHintReturnViolation, BeartypeDoorHintViolation
from jaxtyping import Array, Float

import jaxrl_tab as rl
from jaxrl_tab.core import tables
from jaxrl_tab.core.pytree import pytree

Q, S, A = jnp.zeros((3, 2)), jnp.int32(0), jnp.int32(1)


@pytest.mark.parametrize(
    ("table", "s", "wrong"),
    [(Q, jnp.float32(0), "s"), (Q[0], S, "table"), (np.zeros((3, 2)), S, "table"), (Q, jnp.arange(2), "s")],
    ids=["dtype", "shape", "no array of JAX", "several"],
)
def test_a_function_of_the_package_takes_only_what_it_says(table, s, wrong):
    """Broken once: the hook not installed -> fails."""
    with pytest.raises(WrongArgument, match=rf"tables.add\(\) parameter {wrong}="):
        tables.add(table, s, A, jnp.float32(1))


def test_the_name_of_a_dimension_stands_for_one_size():
    """Broken once: without the context of jaxtyping -> fails."""

    @checked
    def total(x: Float[Array, " n"], y: Float[Array, " n"]) -> Float[Array, " n"]:
        return x + y

    np.testing.assert_array_equal(total(jnp.ones(3), jnp.ones(3)), [2, 2, 2])
    with pytest.raises(WrongArgument, match="parameter y="):
        total(jnp.ones(3), jnp.ones(1))


def test_it_returns_only_what_it_says():
    """Broken once: returns not checked -> fails."""

    @checked
    def half(n: int) -> int:
        return n / 2  # pyright: ignore

    with pytest.raises(BeartypeCallHintReturnViolation, match="half"):
        half(3)


def test_fields_hold_what_they_say():
    """Whatever was given: here a switch is made of a number of NumPy. Broken once: not checked -> fails."""
    assert rl.MonteCarlo(first_visit=np.True_).first_visit is True

    @checked
    @pytree
    class Counter:
        name: str

        def __post_init__(self):
            object.__setattr__(self, "name", 3)

    with pytest.raises(BeartypeDoorHintViolation, match="3"):
        Counter("three")


def test_what_a_function_refuses_it_refuses_in_its_own_words():
    """Broken once: `_refuse` raises the violation alone -> fails."""
    with pytest.raises(rl.InputError, match="key"):
        rl.train("no key", rl.Sarsa(), rl.WindyGridworld(), num_steps=1)
    with pytest.raises(rl.InputError, match="num_steps"):
        rl.train(jax.random.key(0), rl.Sarsa(), rl.WindyGridworld(), num_steps="many")


def test_of_a_function_that_is_called_often_some_calls_are_checked(monkeypatch):
    """More of them with --slow. Broken once: all or none after the first ones -> fails."""
    calls = annotations.OFTEN + 640
    for one_of, refused in ((64, annotations.OFTEN + 10), (8, annotations.OFTEN + 80), (1, calls)):
        monkeypatch.setattr(annotations, "one_of", one_of)

        @checked
        def same(x: int) -> int:
            return x

        found = 0
        for _ in range(calls):
            try:
                same("x")  # pyright: ignore[reportArgumentType]
            except WrongArgument:
                found += 1
        assert found == refused
