"""An environment of your own: say where episodes start and what an action may lead to; the rest follows.

A machine gets worse until somebody repairs it. It earns 3, 2, 1 or 0 a day, a repair costs 4, and each day it
gets one step worse with probability `wear`. One day in ten the factory closes down for good.
"""

# Constants in the place of properties: Python allows it, and type checkers ask.
# pyright: reportAssignmentType=false, reportIncompatibleMethodOverride=false

import jax
import jax.numpy as jnp
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import Outcome, pytree, static
from jaxrl_tab.envs import Finite


@pytree
class Machine(Finite):
    """Run a machine that wears out, or repair it."""

    wear: float = 0.4  # a leaf: vmap may batch it
    closing: float = 0.1
    max_steps: int = static(default=1000)  # static: it shapes the program
    num_states, num_actions = 5, 2  # new, used, worn, broken; closed down
    action_names = ("run", "repair")

    def initial(self):
        return jnp.eye(5)[0]

    def outcomes(self, s, a):
        """Three of them: as it is, one step worse, closed down."""
        over = s == 4
        state = jnp.where(a == 1, 0, s)
        worse = jnp.minimum(state + 1, 3)
        prob = jnp.stack([(1 - self.closing) * (1 - self.wear), (1 - self.closing) * self.wear, self.closing])
        s_next = jnp.where(over, 4, jnp.stack([state, worse, jnp.int32(4)]))
        reward = jnp.where(a == 1, -4.0, 3.0 - s)
        return prob, Outcome(s_next, jnp.where(over, 0.0, reward) * jnp.ones(3), s_next == 4)


env = Machine()
v, q = rl.planning.value_iteration(env)  # exact, from `outcomes`
keys = jax.random.split(jax.random.key(0), 20)
method = rl.QLearning(alpha=rl.schedules.Power(0.6, clock="visit"), epsilon=0.2)
state, _ = jax.vmap(lambda key: rl.train(key, method, env, num_steps=100_000))(keys)  # samples `outcomes`
learned = np.asarray(state.q).mean(0)

print("what the machine is worth, Q(s, a): exact, and learned by Q-learning (20 seeds, 100 000 days)\n")
print("             run: exact  learned   repair: exact  learned   best")
for s, name in enumerate(["new", "used", "worn", "broken"]):
    best = env.action_names[q[s].argmax()]
    print(f"  {name:8}{q[s, 0]:12.3f}{learned[s, 0]:9.3f}{q[s, 1]:16.3f}{learned[s, 1]:9.3f}   {best}")

wears = [0.2, 0.4, 0.8]
values = [rl.planning.value_iteration(Machine(wear=wear))[0][0] for wear in wears]
print("\na new machine is worth, exactly")
for wear, value in zip(wears, values, strict=True):
    print(f"  {value:8.3f}   where it gets worse with probability {wear}")
