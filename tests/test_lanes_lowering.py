"""What is worked out while compiling, and how much code is written for what is done once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lanes_tools import by_lanes

from jaxrl_tab.lanes.analysis import operations
from jaxrl_tab.lanes.lower import lower

pytestmark = pytest.mark.usefixtures("optimised")

TABLE = np.random.default_rng(0).integers(-50, 50, (40, 3)).astype(np.int32)  # more than are taken apart
ROWS = np.array([-1, 39, 40, 0, 7] * 8, np.int32)  # some of them lie outside


@pytest.mark.slow
def test_large_known_arrays_of_whole_numbers_are_worked_out_without_a_program_of_xla(monkeypatch):
    """The numbers are NumPy's. Broken once: all left to JAX, or an index that is taken as it is -> fails."""

    def function(i):
        rows = jnp.asarray(TABLE).at[ROWS].get(mode="clip", wrap_negative_indices=False)
        return (jnp.sign(rows) * 3 + rows // 7)[i]

    def refuse():
        raise AssertionError("JAX is asked")

    lanes = np.arange(40, dtype=np.int32)
    jax.make_jaxpr(function)(lanes[0])  # JAX works out what it wants to before
    monkeypatch.setattr(jax, "ensure_compile_time_eval", refuse)
    (numbers,) = by_lanes(function, lanes)
    rows = TABLE[np.clip(ROWS, 0, 39)]
    np.testing.assert_array_equal(numbers, np.sign(rows) * 3 + rows // 7)


@pytest.mark.parametrize(("turns", "stores"), [(0, 1), (100, 4 + 2)])
def test_only_within_a_loop_an_array_is_gone_through_in_several_steps_at_a_time(turns, stores):
    """Of 40 numbers: four in a turn within a loop, and one where they are put into its memory, and given back.

    Of few turns there would be no loop: they are written one after another.

    Broken once: four in a turn everywhere -> both fail; one in a turn everywhere -> the second fails.
    """

    def function(x):
        return jax.lax.fori_loop(0, turns, lambda _, x: x * 2, x) if turns else x

    code = lower(jax.make_jaxpr(function)(np.zeros(40, np.float32)), [True], [None])
    assert sum(value.op == "store" for value in operations(code.region)) == stores
