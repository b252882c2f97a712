"""What is recorded at the end of rows; a problem for each run."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from keeping import forget

import jaxrl_tab as rl
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.core.types import Outcome
from jaxrl_tab.engine import traced
from jaxrl_tab.envs.base import FixedStart

METHOD = rl.Sarsa(alpha=0.5, epsilon=0.25)


def clock_and_start(state):
    return {"at_step": state.clock.step, "at_episode": state.clock.episode, "row_of_start": state.q[30]}


@pytest.mark.parametrize(("unit", "number", "every"), [("num_steps", 2500, 1000), ("num_episodes", 7, 3)])
def test_rows_are_recorded_at_their_end(unit, number, every, windy):
    """Also of the last row, which is shorter. (In a dataset, and beside exact values: see test_prediction.)

    Broken once: recorded before the row, by steps or by episodes; axes lost in the shorter row -> each fails.
    """
    budget = {unit: number, "log_every": every}
    run = lambda key: rl.train(key, METHOD, windy, record=clock_and_start, **budget)
    state, log = jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 3))
    found = log.recorded
    np.testing.assert_array_equal(found["at_step"], np.cumsum(log.steps, 1))
    np.testing.assert_array_equal(found["at_episode"], np.cumsum(log.episodes, 1))
    want = np.append(np.arange(every, number, every), number)
    at = found["at_step"] if unit == "num_steps" else found["at_episode"]
    np.testing.assert_array_equal(at, np.broadcast_to(want, (3, 3)))
    assert found["row_of_start"].shape == (3, 3, 4)
    np.testing.assert_array_equal(found["row_of_start"][:, -1], state.q[:, 30])
    assert (found["row_of_start"][:, 0] != found["row_of_start"][:, 1]).any()


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (5, "record must be a function from the state of the learner to a dict of arrays"),
        (
            lambda state: state.q,
            "record must be a function from the state of the learner to a dict of arrays",
        ),
        (lambda state: {"steps": 0}, "record: 'steps' is already a name in the results; choose another one"),
        (lambda state: {"q": state.q}, "record: 'q' is already a name in the results; choose another one"),
    ],
)
def test_what_cannot_be_recorded_is_refused(record, message, windy):
    with pytest.raises(rl.InputError) as error:
        rl.train(jax.random.key(0), METHOD, windy, num_steps=10, record=record)
    assert str(error.value) == message


# --- a problem for each run --------------------------------------------------------------------------


@pytree
class Lottery(FixedStart):
    """One play, whose reward is a number that is drawn once for a run."""

    prize: float = -1.0

    num_states, num_actions, max_steps, start_state = 2, 2, 10, 0

    def instance(self, key):
        return Lottery(jax.random.uniform(key))

    def outcomes(self, s, a):
        reward = jnp.where(s == 0, jnp.asarray(self.prize, float), 0)
        return jnp.ones(1), Outcome(jnp.array([1]), reward[None], jnp.array([True]))


@pytest.mark.slow
def test_each_run_has_its_own_problem_and_each_configuration_the_same_ones():
    """The reward of a step tells which problem it is; all steps of a run are of one, and exact values too.

    Broken once: one problem for all; the environment as it was given -> each fails.
    """
    sweep = partial(rl.sweep, Lottery(), "sarsa", num_steps=300, exact=True)
    log = sweep({"alpha": [1.0, 0.5]}, num_seeds=5).log
    prize = log.rewards / 100
    np.testing.assert_allclose(prize, np.broadcast_to(prize[0, :, :1], prize.shape), rtol=1e-6)
    assert len(np.unique(prize[0, :, 0])) == 5
    assert prize.min() >= 0
    np.testing.assert_allclose(log.greedy_value, prize, rtol=1e-5)
    np.testing.assert_array_equal(sweep({"alpha": 0.25}, num_seeds=2).log.rewards, log.rewards[0, :2])
    other = sweep({"alpha": 0.25}, num_seeds=2, seed=1).log
    assert not np.isin(other.rewards, log.rewards).any()


@pytest.mark.one_in(5)
@pytest.mark.parametrize(
    ("backend", "length"),
    [
        ("lanes", {"num_steps": 120}),
        ("lanes", {"num_episodes": 7}),
        ("lanes", {"num_steps": 125}),
        ("lanes", {"num_episodes": 12}),
        ("xla", {"num_steps": 125}),
    ],
    ids=str,
)
def test_how_many_rows_are_measured_at_once_changes_nothing(backend, length, monkeypatch):
    """One at a time, or up to five: 12 rows in fours or threes, 7 one by one, and a shorter one after 12.

    Broken once: the rows of a group in another order, or `measure.of` of the last learner alone -> fails.
    """
    options = length | {"log_every": 10 if "num_steps" in length else 1, "backend": backend, "num_seeds": 3}

    def swept(rows):
        monkeypatch.setattr(traced, "rows_at_once", lambda what, algorithm, learner: rows)
        forget()
        traced.unchecked.clear_cache()
        record = lambda state: {"q_all": state.q, "first": state.q[0, 0]}
        return rl.sweep(rl.make("random-walk"), "td", exact=True, record=record, **options)

    one, several = swept(1), swept(5)
    assert one.log.recorded["q_all"].std(axis=-3).any()  # from row to row
    for x, y in zip(
        jax.tree.leaves((one.q, one.log)), jax.tree.leaves((several.q, several.log)), strict=True
    ):
        np.testing.assert_array_equal(x, y)


@pytest.mark.slow
def test_what_stands_in_the_state_is_recorded_without_xla(monkeypatch):
    """Nothing is worked out, so `lanes` copies it. Broken once: XLA is called -> fails."""
    forget()
    monkeypatch.setattr(traced, "prepared", lambda *_, **__: pytest.fail("it is left to XLA"))
    record = lambda state: {"table": state.q}
    for length in ({"num_steps": 205}, {"num_episodes": 25}):
        by = [
            rl.sweep(
                rl.make("random-walk"), "sarsa", record=record, log_every=10, num_seeds=3, backend=x, **length
            )
            for x in ("lanes", "xla")
        ]
        tables = by[0].log.recorded["table"]
        np.testing.assert_array_equal(tables, by[1].log.recorded["table"])
        np.testing.assert_array_equal(tables[:, -1], by[0].q)
        assert tables.std(axis=-3).any()
