"""Methods that explore with a guarantee: against plain loops, and their bounds; and docs/exploring.md."""

import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from marks import slow_but
from reference import F
from test_available import HAS, FewActions
from test_reference import task_of, words_of

import jaxrl_tab as rl
from jaxrl_tab import cli, planning
from jaxrl_tab.core.policies import UNAVAILABLE
from jaxrl_tab.figures import FIGURES

H, P = 5, 0.1
CS, GAMMAS, R_MAXES = (1.0, 0.02, 0.05), (1.0, 1.0, 0.9), (1.0, 1.0, 2.0)


def random_task():
    """Rewards from 0 to 1, states that lack some actions, and one that ends an episode before its time."""
    rng = np.random.default_rng(4)
    p = rng.dirichlet(np.full(5, 0.5), HAS.shape)
    return FewActions(rl.FiniteMDP(p, rng.random(HAS.shape), terminal=[4], start=[0.5, 0.5, 0, 0, 0]))


TASK = rl.FiniteHorizon(random_task(), H)
STATES, A = HAS.shape
THERE = np.append(np.tile(HAS, (H, 1)), HAS[:1], axis=0)


class Optimist(reference.Agent):
    def __init__(self, c, gamma, r_max):
        rates = reference.Rates(lambda *_: 0, lambda *_: 0)
        most: Any = np.where(THERE, F(r_max * H), -np.inf)
        super().__init__(THERE.shape, rates, gamma, most)
        self.c, self.most = F(c * r_max), F(r_max * H)


class UCBQLearning(Optimist):
    """Jin and others 2018, algorithm 1."""

    def learn(self, s, a, r, s_next, terminal, ended, u):
        t, steps = self.visits[s, a], self.episode * H
        bonus = self.c * F(np.sqrt(H**3 * np.log(STATES * A * steps / P) / t))
        alpha = F((H + 1) / (H + t))
        v = F(0) if terminal else min(self.most, max(self.q[s_next]))
        self.q[s, a] = (1 - alpha) * self.q[s, a] + alpha * (r + F(self.gamma) * v + bonus)
        return self.act(s_next, u)


class UCBVI(Optimist):
    """Azar and others 2017, algorithms 1 to 3; a pair is one of all steps where the task is `stationary`."""

    def __init__(self, *args, stationary):
        super().__init__(*args)
        self.stationary, self.seen = stationary, {}

    def pair(self, s, a):
        return (s % STATES if self.stationary else s), a

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.seen.setdefault(self.pair(s, a), []).append(
            (s // STATES, r, None if terminal else s_next % STATES)
        )
        if ended:
            self.plan()
        return self.act(s_next, u)

    def plan(self):
        pairs = (STATES if self.stationary else H * STATES) * A
        most = self.c * H * np.log(5 * pairs * H * self.episode / P)
        v = np.zeros(STATES)
        for h in reversed(range(H)):
            for s in range(STATES):
                for a in range(A):
                    seen = self.seen.get(self.pair(h * STATES + s, a), [])
                    # What followed the last step is not seen, and does not matter.
                    follows = [s_next for step, _, s_next in seen if step < H - 1 or h == H - 1]
                    if follows:
                        mean = (
                            np.mean([0.0 if x is None else float(v[x]) for x in follows]) if h < H - 1 else 0
                        )
                        value = (
                            np.mean([r for _, r, _ in seen])
                            + self.gamma * mean
                            + most / np.sqrt(len(follows))
                        )
                        self.q[h * STATES + s, a] = min(self.q[h * STATES + s, a], F(value))
            v = self.q[h * STATES : (h + 1) * STATES].max(1)


METHODS = {
    "ucb-q-learning": (rl.UCBQLearning, {}, UCBQLearning),
    "ucbvi": (rl.UCBVI, {}, lambda *x: UCBVI(*x, stationary=False)),
    "stationary": (rl.UCBVI, {"stationary": True}, lambda *x: UCBVI(*x, stationary=True)),
}


@pytest.mark.parametrize("name", slow_but(["ucb-q-learning", "stationary"], METHODS))
def test_every_step_agrees_with_the_plain_loop(name):
    """Broken once, each -> fails: H^2 in the bonus; V not cut off at H; the last step's end counted where the task is
    stationary; no minimum with Q of before.
    """
    cls, fixed, plain = METHODS[name]
    keys, steps = jax.random.split(jax.random.key(3), 3), 600

    def run(key, c, gamma, r_max):
        method = cls(c=c, gamma=gamma, r_max=r_max, p=P, **fixed)
        return rl.train(key, method, TASK, num_steps=steps, log_every=steps)

    state, log = jax.jit(jax.vmap(run))(keys, jnp.array(CS), jnp.array(GAMMAS), jnp.array(R_MAXES))
    task = task_of(TASK)
    for i, (key, *numbers) in enumerate(zip(keys, CS, GAMMAS, R_MAXES, strict=True)):
        agent = plain(*numbers)
        finished = reference.run(agent, task, steps, words_of(key, steps))
        np.testing.assert_allclose(state.q[i][THERE], agent.q[THERE], rtol=1e-4)
        assert (np.asarray(state.q[i])[~THERE] == np.float32(UNAVAILABLE)).all()
        assert log.episodes[i, 0] == len(finished) > 0
        assert log.returns[i, 0] == pytest.approx(sum(g for g, _ in finished), rel=1e-4)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", slow_but([], METHODS))
def test_no_entry_is_below_the_best_value(name):
    """With the factors of the theory, and with far smaller ones. Broken once: no bonus -> fails."""
    cls, fixed, _ = METHODS[name]
    q = planning.value_iteration(TASK)[1]
    grid = {"c": [cls().c, 0.3], **fixed}
    found = np.asarray(rl.sweep(TASK, cls, grid, num_seeds=40, num_episodes=300).q)
    assert (found[..., THERE] >= q[THERE] - 1e-4).all()


def test_states_that_are_in_no_steps_are_refused():
    refusal = "UCBVI: 22 states are not as many for each of 5 steps, and the end"
    with pytest.raises(rl.InputError, match=refusal):
        rl.UCBVI().init(22, 2, 5)


def test_a_task_that_may_go_on_is_refused(capsys):
    message = (
        "ucbvi learns in tasks that end after a given number of steps, and chain may go on: take "
        "finite-horizon:20:chain, in Python FiniteHorizon(env, 20)"
    )
    for call in (
        lambda: rl.sweep(rl.make("chain"), "ucbvi", num_seeds=1, num_steps=1),
        lambda: rl.train(jax.random.key(0), rl.UCBVI(), rl.make("chain"), num_steps=1),
    ):
        with pytest.raises(rl.InputError) as error:
            call()
        assert str(error.value) == message
    assert cli.main(["sweep", "chain", "ucbvi", "--episodes", "2"]) == 2
    assert message in capsys.readouterr().err


# --- docs/exploring.md -------------------------------------------------------------------------------

PAGE = (Path(__file__).parent.parent / "docs/exploring.md").read_text(encoding="utf-8")


def test_the_page_shows_the_code_that_there_is():
    """Broken once: a line of the page changed -> fails."""
    (shown,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert shown == textwrap.dedent(inspect.getsource(rl.UCBQLearning.update))


def test_the_commands_of_the_page_are_understood():
    """Broken once: an option misspelt -> fails."""
    commands = [line.partition("#")[0].split() for line in PAGE.splitlines() if line.startswith("jaxrl-tab ")]
    assert [command for _, command, *_ in commands] == ["sweep"] * 3 + ["watch", "figure", "solve", "solve"]
    for _, command, *words in commands:
        if command == "sweep":
            assert cli.main([command, *words, "--dry-run"]) == 0
        elif command == "figure":
            assert words[0] in FIGURES
