"""Action values that are credited when they are read, against a loop over all pairs.

Each test was seen to fail on code broken in the ways that its docstring tells.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrl_tab.core import credited

STATES, ACTIONS, STEPS = 7, 3, 3000
FADES = (0.0, 1e-3, 0.5, 0.97, 1.0)
KEPT = (1.0, 0.0, 0.75)


def steps(seed=0, end=0.01):
    """Pairs, what is credited, and whether all traces end: of each step."""
    rand = np.random.default_rng(seed)
    s, a = rand.integers(0, STATES, STEPS, np.int32), rand.integers(0, ACTIONS, STEPS, np.int32)
    return s, a, rand.normal(size=STEPS) / 8, rand.random(STEPS) < end


def by_a_loop(q, fade, kept, steps, dtype=np.float64):
    """Q and z after each step, of all pairs, and Q(s, a) before it."""
    q, z = q.astype(dtype), np.zeros_like(q, dtype)
    fade, kept = dtype(fade), dtype(kept)
    for s, a, x, ends in zip(*steps, strict=True):
        before = q[s, a]
        z[s, a] = kept * z[s, a] + dtype(1)
        q += dtype(x) * z
        z *= dtype(0) if ends else fade
        yield before, q.copy(), z.copy()


def by_credit(q, fades, kept, steps):
    """The same, [fades, steps, ...], and what is kept of the pairs at the end."""

    def run(fade):
        def one(values, step):
            s, a, x, ends = step
            values = values.begun()
            before = values.entry(s, a)
            row = values.row(s)
            values = values.learned(s, a, kept, 1.0, x).faded(jnp.where(ends, 0, fade))
            return values, (before, row[a], values.q, values.z)

        return jax.lax.scan(one, credited.start(jnp.asarray(q)), steps)

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(run))(jnp.asarray(fades)))


@pytest.mark.parametrize("kept", KEPT)
def test_after_each_step_it_is_what_a_loop_over_all_pairs_makes_of_it(kept):
    """With traces that fade slowly, at once, never, and end; each in a lane of its own, in float64.

    Broken once: a base that does not take up what the marks of its pair have brought; credit that stays when it has
    been settled, or is settled by the scale; marks that are not divided by the scale, or do not take it up -> each
    fails.
    """
    q = np.random.default_rng(1).normal(size=(STATES, ACTIONS))
    with jax.enable_x64():
        _, (before, read, *tables) = by_credit(q, np.array(FADES), kept, steps())
    for i, fade in enumerate(FADES):
        wants = [np.array(x) for x in zip(*by_a_loop(q, fade, kept, steps()), strict=True)]
        np.testing.assert_allclose(before[i], wants[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(read[i], wants[0], rtol=1e-9, atol=1e-9)
        for got, want in zip(tables, wants[1:], strict=True):
            np.testing.assert_allclose(got[i], want, rtol=1e-9, atol=1e-9)


def test_in_an_episode_without_end_nothing_under_or_overflows():
    """In float32, in which 0.97^3000 is 0. Broken once: never settled, SMALL = 0 -> fails."""
    q = np.zeros((STATES, ACTIONS), np.float32)
    s, a, x, ends = steps(end=0)
    values, (_, _, got, z) = by_credit(q, np.float32([0.97, 1.0]), 0.0, (s, a, x.astype(np.float32), ends))
    assert np.isfinite(got).all()
    assert values.marks.max() <= 1 / credited.SMALL
    assert (values.scale > credited.SMALL).all()
    for i, fade in enumerate((0.97, 1.0)):
        *_, (_, want, want_z) = by_a_loop(q, fade, 0.0, (s, a, x, ends))
        np.testing.assert_allclose(got[i, -1], want, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(z[i, -1], want_z, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("kept", KEPT)
@pytest.mark.parametrize("fade", [0.5, 0.9, 0.97])
def test_in_float32_it_is_as_near_to_the_exact_values_as_a_loop_over_all_pairs(kept, fade):
    """Its errors were 0.4 to 0.8 times as large. Broken once: SMALL = 1 / 128 -> fails in seven of nine cases."""
    q = np.random.default_rng(1).normal(size=(STATES, ACTIONS)).astype(np.float32)
    s, a, x, ends = steps()
    x = x.astype(np.float32)
    fade = np.float32(fade)
    _, (_, _, got, _) = by_credit(q, fade[None], kept, (s, a, x, ends))
    exact, rounded = (
        np.array([y for _, y, _ in by_a_loop(q, fade, kept, (s, a, x, ends), dtype)])
        for dtype in (np.float64, np.float32)
    )
    error, usual = (np.sqrt(np.mean((y - exact) ** 2)) for y in (got[0], rounded))
    assert error < 1.25 * usual
