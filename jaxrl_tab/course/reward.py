"""What a right agent can do: it learns a task for a while, and its greedy policy is measured exactly."""

from typing import Any

import numpy as np

from jaxrl_tab import envs
from jaxrl_tab.course.exercises import Exercise
from jaxrl_tab.course.student import Agent, Code
from jaxrl_tab.course.updates import Setting, Step
from jaxrl_tab.envs.base import Grid
from jaxrl_tab.exact import planning

EPSILON = 0.1
MOST = 60_000  # steps, however long the episodes are


def shown(code: Code, exercise: Exercise) -> tuple[str, ...]:
    """What the agent's greedy policy is worth after it has learned, beside the best one; lines of text."""
    env = envs.make(exercise.task)
    model = planning.exact_model(env)
    states, actions = model.prob.shape[:2]
    agent = Agent(code, Setting(states, actions, exercise.alpha, 1.0, EPSILON, n=4, lam=0.8), 0)
    episodes = _learn(agent, model, exercise.episodes, env.max_steps)
    q = agent.q()
    found = planning.policy_value(env, planning.greedy_policy(q))
    best = planning.start_value(env, planning.value_iteration(env)[0])
    worth = "may go round for ever" if np.isinf(found) else f"is worth {_number(found)} from the start"
    line = f"After {episodes} episodes of {exercise.task} its greedy policy {worth}; the best is worth {_number(best)}."
    return (line, *([] if np.isinf(found) else _drawn(env, model, q)))


def _learn(agent: Agent, model: planning.Model, episodes: int, longest: int) -> int:
    """Learns, and says in how many episodes."""
    draw, steps = np.random.default_rng(0), 0
    certain = model.prob.shape[-1] == 1
    edges, starts = np.cumsum(model.prob, -1), np.cumsum(model.start)
    for episode in range(episodes):
        s = int(np.searchsorted(starts, draw.random(), side="right"))
        for length in range(1, longest + 1):
            a = agent.act(s)
            k = 0 if certain else int(np.searchsorted(edges[s, a, :-1], draw.random(), side="right"))
            s_next, terminated = int(model.s_next[s, a, k]), bool(model.terminal[s, a, k])
            truncated = length == longest and not terminated
            agent.update(Step(s, a, float(model.reward[s, a, k]), s_next, terminated, truncated))
            s, steps = s_next, steps + 1
            if terminated or truncated:
                break
        if steps > MOST:
            return episode + 1
    return episodes


def _drawn(env: Any, model: planning.Model, q: np.ndarray) -> list[str]:
    """On a grid the greedy way from the start, one line for each row of cells."""
    if not isinstance(env, Grid):
        return []
    cells, names = [["·"] * env.shape[1] for _ in range(env.shape[0])], env.action_names
    s, ends = env.start_state, False
    for _ in range(env.num_states):
        a = int(q[s].argmax())
        cells[s // env.shape[1]][s % env.shape[1]] = names[a]
        s, ends = int(model.s_next[s, a, 0]), bool(model.terminal[s, a, 0])
        if ends:
            cells[s // env.shape[1]][s % env.shape[1]] = "G"
            break
    return [" ".join(row) for row in cells]


def _number(x: float) -> str:
    return f"{x:.4g}".replace("-", "−")
