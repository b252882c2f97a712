"""Random functions give XLA's numbers, and write nowhere but in their memory."""

import lanes_fuzz
import numpy as np
import pytest
from lanes_tools import assert_same_bits, by_lanes, by_xla, narrow
from marks import slow_but_first

from jaxrl_tab.lanes import ahead, vectors
from jaxrl_tab.lanes.target import host

pytestmark = pytest.mark.usefixtures("optimised")

LANES = 16


def results(seed, *targets):
    """What a random function gives, by XLA and by each target."""
    function = lanes_fuzz.function(seed)
    args = list(lanes_fuzz.inputs(np.random.default_rng(seed), LANES).values())
    return by_xla(function, *args), *(by_lanes(function, *args, target=target) for target in targets)


def without_signs_of_zeros(arrays):
    """XLA leaves out what adds 0."""
    return [x + 0 if x.dtype.kind == "f" else x for x in arrays]


@pytest.mark.parametrize(
    "seeds", slow_but_first(range(first, first + 10) for first in range(0, 40, 10)), ids=str
)
def test_random_functions_give_the_numbers_of_xla(seeds, monkeypatch):
    """Also where indices leave a vector two by two. Broken once: `scatter` writes what is out of range to the last
    place -> fails; LLVM is told the bounds of a pair of indices -> a segmentation fault."""
    monkeypatch.setattr(vectors, "PAIRED", narrow().width)
    for seed in seeds:
        expected, found = results(seed, narrow())
        assert_same_bits(without_signs_of_zeros(found), without_signs_of_zeros(expected))


@pytest.mark.parametrize("seed", slow_but_first(range(100, 104), 2))
def test_the_bits_do_not_depend_on_the_width_of_the_vectors(seed):
    _, short, wide = results(seed, narrow(), host())
    assert_same_bits(short, wide)


@pytest.mark.parametrize("seeds", slow_but_first([range(200, 206), range(206, 212)]), ids=str)
def test_one_lane_alone_gives_the_same(seeds, monkeypatch):
    """All that can be is worked out ahead, in loops of any length, whether it pays or not.

    Broken once: the conditions of a case are in another order where it is read -> fails.
    """
    monkeypatch.setattr(ahead, "OFTEN", 1)
    monkeypatch.setattr(ahead, "LONG", 1)
    for seed in seeds:
        function, inputs = lanes_fuzz.function(seed), lanes_fuzz.inputs(np.random.default_rng(seed), LANES)
        alone, among_others = (by_lanes(function, *inputs.values(), lanes=n) for n in (1, LANES))
        assert_same_bits(alone, among_others)
