"""Results of sweeps that nobody ran: they look like real ones, and take no time."""

import numpy as np

import jaxrl_tab as rl
from jaxrl_tab.engine.log import Log

ALPHAS = (0.05, 0.2, 0.9)


def make_result(env, q, *, seeds=5, rows=20, best=-17.0, budget=None):
    """A sweep as real ones look: hugely negative returns first, `best` in the end, worse at small alpha."""
    rng = np.random.default_rng(0)
    shape = (len(ALPHAS), seeds, rows)
    progress = np.linspace(0, 1, rows)
    pace = np.array([20.0, 4.0, 1.0])[:, None, None]
    mean = best * (1 + (pace - 1) + 30 * np.exp(-6 * progress)) * rng.uniform(0.95, 1.05, shape)
    budget = budget or {"num_steps": 200 * rows, "num_episodes": None, "log_every": 200}
    if budget["num_steps"]:
        steps, episodes = np.full(shape, 200), np.floor(200 / -mean + 0.5)
    else:
        steps, episodes = -mean, np.ones(shape)
    log = Log(
        steps=steps.astype(np.int32),
        episodes=episodes.astype(np.int32),
        returns=(episodes * mean).astype(np.float32),
        lengths=steps.astype(np.int32),
        rewards=-steps.astype(np.float32),
    )
    return rl.SweepResult(
        environment="windy-gridworld",
        algorithm="sarsa",
        env=env,
        grid={"alpha": ALPHAS},
        fixed={"epsilon": 0.1, "gamma": 1.0},
        log=log,
        q=np.broadcast_to(np.asarray(q, np.float32), (*shape[:2], *q.shape)),
        optimal_value=np.array(-15.0),
        root_seed=0,
        seconds=1.0,
        compile_seconds=1.0,
        **budget,
    )
