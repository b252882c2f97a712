"""For the test of second starts: a sweep of each kind, with programs that are kept.

    python starts.py FILE

writes what they gave to FILE, and prints how many programs were traced, and how many that JAX compiled came from
its cache.
"""

import sys
from collections import Counter

import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import interop, policies
from jaxrl_tab.engine import by_xla, programs, room

STEPS = {"num_seeds": 3, "num_steps": 40, "log_every": 20}


def sweeps() -> dict[str, rl.SweepResult]:
    """A sweep of each kind of program."""
    walk, windy = rl.make("random-walk"), rl.make("windy-gridworld")
    uneven = policies.Table(np.tile([0.1, 0.2, 0.3, 0.4], (windy.num_states, 1)))
    lake = interop.from_gymnasium("FrozenLake-v1")
    return {
        "control": rl.sweep(walk, "sarsa", {"alpha": [0.25, 0.5]}, **STEPS),
        "prediction": rl.sweep(walk, "td", **STEPS),
        "exact": rl.sweep(walk, "q-learning", exact=True, **STEPS),
        "episodes": rl.sweep(walk, "q-learning", num_seeds=3, num_episodes=3),
        "policies": rl.sweep(windy, "q-learning", {"behaviour": uneven}, **STEPS),
        "imported": rl.sweep(lake, "q-learning", **STEPS),
        "record": rl.sweep(walk, "q-learning", record=lambda state: {"largest": state.q.max()}, **STEPS),
    }


def everything() -> dict[str, np.ndarray]:
    """The arrays of all, by name."""
    results = {name: (x.q, x.log, x.optimal_value) for name, x in sweeps().items()}
    leaves = jax.tree.leaves_with_path(results)
    return {jax.tree_util.keystr(path): np.asarray(x) for path, x in leaves}


if __name__ == "__main__":
    by_xla.use_all_cores()
    programs.keep()
    events = Counter()
    jax.monitoring.register_event_listener(lambda event, **_: events.update([event]))
    np.savez(sys.argv[1], **everything())
    print(room.traced_program.cache_info().misses, events["/jax/compilation_cache/cache_hits"])
