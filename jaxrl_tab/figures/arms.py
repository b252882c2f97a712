"""What the figures of the k-armed testbed share: how often the best arm of each problem is pulled."""

import jax
import numpy as np

from jaxrl_tab.core import rng
from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.engine.traced import problem_of
from jaxrl_tab.envs import KArmedTestbed
from jaxrl_tab.figures.figure import swept

PLAYS, EVERY = 1000, 10


def run(method, setting, num_problems, chances=None, env=None, plays=PLAYS, every=EVERY):
    """A sweep over problems, with `best`, how probable the best arm is in the play after each row, [..., seed, row].

    Args:
        method: its name.
        setting: its hyperparameters.
        num_problems: how many.
        chances: from the learner's table of a problem, float [..., arms], the probabilities of the arms; without it
            there is no `best`.
        env: the testbed; by default the book's.
        plays, every: how many there are, and in each row of the log.
    """
    env = env or KArmedTestbed()
    budget = {"num_seeds": num_problems, "num_steps": plays, "log_every": every}
    if chances is None:
        return swept(env, method, setting, **budget)
    sweep = swept(env, method, setting, **budget, record=_table)

    def measured(progress):
        ds = sweep(progress)
        of_arms = ds.table.isel(table_0=0)
        of_one = ds.steps.values.reshape(-1, ds.sizes["row"])[0]  # all settings and seeds play as often
        is_best = np.eye(env.arms)[best_arms(env, num_problems, of_one.cumsum())]
        best = (chances(of_arms.values) * is_best).sum(-1)
        return ds.drop_vars("table").assign(best=(of_arms.dims[:-1], best))

    return measured


def best_arms(env, num_problems, plays):
    """The best arm of the problem of each seed, after so many `plays`, int [seeds, plays]."""

    def best(seed):
        problem = problem_of(rng.stream(jax.random.fold_in(rng.key(0), seed)), env)
        at = of_environment(problem).at or (lambda _: problem)
        return jax.vmap(lambda n: at(n).means.argmax())(jax.numpy.asarray(plays))

    return np.asarray(jax.jit(jax.vmap(best))(jax.numpy.arange(num_problems)))


def epsilon_greedy(epsilon):
    """The probabilities of arms [..., arms] by their values."""

    def chances(q):
        greedy = q == q.max(-1, keepdims=True)
        return epsilon / q.shape[-1] + (1 - epsilon) * greedy / greedy.sum(-1, keepdims=True)

    return chances


def softmax(theta):
    """The probabilities of arms [..., arms] by their preferences."""
    weights = np.exp(theta - theta.max(-1, keepdims=True))
    return weights / weights.sum(-1, keepdims=True)


def late_reward(name, **setting):
    """The mean reward of the last 100 plays of each problem."""

    def measure(datasets):
        late = datasets[name].sel(setting).isel(row=slice(-10, None))
        return late.rewards.sum("row") / late.steps.sum("row")

    return measure


def late_share(name, **setting):
    """How probable the best arm is in plays 911, 921, ..., 1001 of each problem."""
    return lambda datasets: datasets[name].sel(setting).best.isel(row=slice(-10, None)).mean("row")


def draw_rewards(ax, ds, name, color):
    """The mean reward of each ten plays."""
    from jaxrl_tab.show import plot

    plays = ds.steps.isel(seed=0).cumsum("row")
    plot.mean_curve(ax, plays, ds.rewards / ds.steps, name, color, lw=1.5)


def draw_share(ax, ds, name, color, **look):
    """How often the best arm is pulled, in percent."""
    from jaxrl_tab.show import plot

    plays = ds.steps.isel(seed=0).cumsum("row") + 1
    plot.mean_curve(ax, plays, 100 * ds.best, name, color, lw=1.5, **look)


def finish(ax, title, *, share):
    from jaxrl_tab.show import plot

    if not share:
        plot.exact_line(ax, best := KArmedTestbed().expected_best_mean(), f"best: {best:.2f}")
    plot.tidy(ax, "plays", "best arm, % of plays" if share else "mean reward")
    ax.set(xlim=(0, None), ylim=(0, 100) if share else (-0.1, 1.65))
    ax.set_title(title, fontsize=plot.TYPE)
    plot.legend(ax)


def _table(learner):
    return {"table": learner.q}
