"""How many lanes go side by side, which branches are left out for them, and what is read once.

Where numbers are compared, what they should be is worked out in NumPy or by XLA.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from lanes_tools import assert_as_xla, by_lanes, narrow

from jaxrl_tab.lanes import program, vectors
from jaxrl_tab.lanes.analysis import Facts, operations
from jaxrl_tab.lanes.emit import emit
from jaxrl_tab.lanes.lower import lower
from jaxrl_tab.lanes.target import Target

pytestmark = pytest.mark.usefixtures("optimised")

AVX2 = Target("x86_64-unknown-linux-gnu", "", "+avx2,+fma")
AVX512 = AVX2._replace(features="+avx2,+fma,+avx512f,+avx512vl,+avx512dq")
LANES, STATES, ACTIONS = 40, 30, 4
RNG = np.random.default_rng(0)
Q = RNG.normal(size=(LANES, STATES, ACTIONS)).astype(np.float32)
S = RNG.integers(-3, STATES + 3, LANES).astype(np.int32)
A = RNG.integers(-3, ACTIONS + 3, LANES).astype(np.int32)


def lowered(function, *args):
    """The scalar code of a function whose arguments differ from lane to lane, and the facts about it."""
    code = lower(jax.make_jaxpr(function)(*args), [True] * len(args), [None] * len(args))
    return code, Facts(code.region)


# --- rows and single numbers out of them


def row_of(q, s):
    return lax.dynamic_slice(q, (s, 0), (1, ACTIONS))[0]


def entry_of_a_row(q, s, a):
    return row_of(q, s).max() + q.at[s, a].get(mode="clip")


def entry_after_a_write(q, s, a):
    q = q.at[0, 0].set(1.0)
    best = row_of(q, s).max()
    new = q.at[s, 2].add(best, mode="clip")
    return new.at[s, a].get(mode="clip") + best, new


def entry_within_a_loop(q, s, a):
    """The row is read before the loop, which changes an entry of it in each turn."""
    q = q.at[0, 0].set(1.0)
    best = row_of(q, s).max()
    return lax.fori_loop(0, a, lambda _, q: q.at[s, a].add(best, mode="clip"), q)


def entry_behind_a_loop(q, s, a):
    """The row is read last within the loop, in which some lanes have no turn."""

    def turn(k, carried):
        q, _ = carried
        q = q.at[s, k].add(1.0, mode="clip")
        return q, row_of(q, s).max()

    q = q.at[0, 0].set(1.0)
    q, best = lax.fori_loop(0, a, turn, (q, row_of(q, s).max()))
    return best, q.at[s, a].get(mode="clip"), q


@pytest.mark.parametrize(
    "function", [entry_of_a_row, entry_after_a_write, entry_within_a_loop, entry_behind_a_loop]
)
def test_an_entry_of_a_row_that_was_read_is_the_entry_in_memory(function):
    """Broken once: rows are not forgotten at a store -> the second fails; before and behind loops -> the others."""
    assert_as_xla(function, Q, S, A)


@pytest.mark.parametrize(
    ("target", "width", "loads"), [(AVX2, 8, 0), (AVX2, 16, 16), (AVX512, 16, 0), (AVX512, 32, 0)]
)
def test_an_entry_is_read_again_where_its_row_would_take_too_many_registers(target, width, loads):
    """Rows are loads of four numbers; AVX2 has 16 registers, AVX-512 has 32.

    Broken once: an entry is always read again, or never -> fails.
    """

    def numbers_read(function):
        code, facts = lowered(function, Q[0], S[0], A[0])
        return emit(code, facts, target, width, 1).text.count("= load float,")

    of_row_alone = numbers_read(lambda q, s, a: row_of(q, s).max())
    assert numbers_read(entry_of_a_row) - of_row_alone == loads


# --- branches


def much(x):
    """More than may as well be worked out where it is not wanted; without products, which XLA may round otherwise."""
    for k in range(30):
        x = jnp.maximum(x - k, -x)
    return x


def one_branch(x, i):
    return lax.cond(i % 8 == 0, lambda: much(x[0]), lambda: x[1])


def one_of_three_branches(x, i):
    """All that is not worked out is given back, also an array of 10 numbers, and the same number twice."""
    y, z, w = x[:10] * 2, x[10], x[11]
    cases = [
        lambda y, z, w: (y, z, z),
        lambda y, z, w: (y.at[3].set(much(z)), z, w),
        lambda y, z, w: (y, much(w), z + w),
    ]
    return *lax.switch(i, cases, y, z, w), y[3] + z


def one_of_three_has_little_to_do(x, i):
    return lax.switch(i, [lambda: much(x[0]), lambda: x[1] + x[2], lambda: much(x[3])])


@pytest.mark.parametrize("function", [one_branch, one_of_three_branches, one_of_three_has_little_to_do])
def test_a_lane_takes_its_branch_alone(function):
    """Broken once: a branch that gives back something else than the others is left out -> fails."""
    x = RNG.normal(size=(LANES, 12)).astype(np.float32)
    assert_as_xla(function, x, np.arange(-2, LANES - 2, dtype=np.int32))


@pytest.mark.parametrize(
    ("function", "branches"),
    [
        (lambda x, i: lax.cond(i > 0, lambda: much(x), lambda: x), 1),
        (lambda x, i: lax.cond(i > 0, lambda: much(x), lambda: x + 1), 1),
        (lambda x, i: lax.cond(i > 0, lambda: x * 2 + 1, lambda: x), 0),
        (lambda x, i: lax.fori_loop(0, (i > 0).astype(jnp.int32), lambda _, x: x * 2 + 1, x), 1),
    ],
    ids=["or nothing", "or little", "little or nothing", "counted"],
)
def test_a_branch_with_much_to_do_is_left_out_where_no_lane_takes_it(function, branches):
    """It is a loop of one turn at most, as one that counts to 1 at most; a branch with little to do is none.

    Broken once: all branches are worked out, or none; a short one is a loop, too; one that counts is none -> fails.
    """
    code, facts = lowered(function, Q[0, 0, 0], S[0])
    loops = [value for value in operations(code.region) if value.op == "loop" and facts.varies(value)]
    assert len(loops) == branches
    assert all(facts.is_branch(loop) and facts.turns(loop.attr.body.ops[-1]) == 1 for loop in loops)


# --- how many lanes


def in_each_step(do):
    return lambda x, i: lax.fori_loop(0, 1000, lambda _, x: do(x, i), x)


def waited_for(x, i):
    return lax.while_loop(lambda x: x < i, lambda x: x + 1, x)


def rare(x, i):
    return lax.cond(x > i, lambda: much(x), lambda: x + 1)


@pytest.mark.parametrize(
    ("function", "of_16", "of_8"),
    [
        (in_each_step(lambda x, i: x + i), (32, 2), (16, 2)),
        (in_each_step(rare), (16, 2), (8, 2)),
        (waited_for, (16, 1), (8, 1)),
        (lambda x, i: waited_for(rare(x, i), i), (16, 1), (8, 1)),
        (in_each_step(waited_for), (8, 1), (8, 1)),
    ],
    ids=["plain", "rare", "waited for once", "both", "waited for in each step"],
)
def test_fewer_lanes_go_side_by_side_where_they_wait_for_one_another(function, of_16, of_8):
    """By the table in docs/performance.md. Broken once: a branch counts as a loop that lanes wait in -> fails."""
    code, facts = lowered(function, np.float32(0), np.float32(0))
    assert program.block(code, facts, AVX512, 1000) == of_16
    assert program.block(code, facts, AVX2, 1000) == of_8
    assert program.block(code, facts, AVX512, 16) == (16, 1)
    assert program.block(code, facts, AVX512, 1) == (1, 1)


@pytest.mark.slow
def test_the_documentation_prints_every_stage_of_a_program(capsys):
    """Broken once: without `backend.using("xla")`, as it stood for some weeks -> Unsupported."""
    page = (Path(__file__).parents[1] / "docs/performance.md").read_text(encoding="utf-8")
    exec(page.partition("```python\n")[2].partition("```")[0], {})
    jaxpr, llvm, assembly = capsys.readouterr().out.split("\n\n", 2)
    assert "scan[" in jaxpr and "define" in llvm and "kernel:" in assembly


# --- indices


def test_indices_that_leave_a_vector_two_by_two_are_where_they_should_be(monkeypatch):
    """LLVM 22 leaves out the mask of the lower of two where it knows a bound of a sum: here 35 + 1.

    Broken once: LLVM is told the bounds -> a segmentation fault; the halves in the other order -> fails.
    """
    monkeypatch.setattr(vectors, "PAIRED", narrow().width)
    monkeypatch.setattr(program, "block", lambda *_: (narrow().width, 1))
    x = RNG.normal(size=(LANES, 40)).astype(np.float32)
    first = RNG.integers(0, 60, LANES).astype(np.uint32)
    (part,) = by_lanes(lambda x, i: lax.dynamic_slice(x + x, (i,), (5,)), x, first)
    places = np.minimum(first, 35)[:, None] + np.arange(5)
    np.testing.assert_array_equal(part, 2 * x[np.arange(LANES)[:, None], places])
