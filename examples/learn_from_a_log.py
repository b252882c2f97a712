"""Off-policy learning, first use: learn from the logged experience of somebody else.

A player of Blackjack who tosses a coin for each card was watched. From that log alone: what would a game be
worth to a player who sticks on 20 and 21 only, and how should one play?
"""

import jax
import numpy as np

import jaxrl_tab as rl
from jaxrl_tab import planning
from jaxrl_tab.algorithms import OffPolicyMonteCarlo
from jaxrl_tab.core.policies import Table

env = rl.make("blackjack")
sizes = env.num_states, env.num_actions
key = jax.random.key(0)

# What was logged. Your own data go in as arrays: rl.Experience(s, a, r, s_next, terminal), or episodes.
coin = np.full(sizes, 0.5)
log = rl.collect(key, coin, env, num_steps=300_000)

# The policy that is asked about: action 0 is to stick, action 1 to hit.
sticks_late = np.tile([0.0, 1.0], (env.num_states, 1))
for player in (20, 21):
    for dealer in range(1, 11):
        for usable in (False, True):
            sticks_late[env.state(player, dealer, usable)] = 1, 0

# Returns, weighted by what the two policies think of the actions; or steps, which need no weights.
by_games = OffPolicyMonteCarlo(target=Table(sticks_late), behaviour=Table(coin))
by_steps = rl.ExpectedSarsa(alpha=rl.schedules.sample_average(), target=Table(sticks_late))
start = np.asarray(env.initial())
learned = {}
for how, method in {"importance sampling": by_games, "Expected Sarsa": by_steps}.items():
    q = rl.learn(key, method, log, *sizes).q
    learned[how] = start @ (sticks_late * q).sum(1)
learned["doubly robust"] = rl.evaluation.doubly_robust(
    log, sticks_late, coin
).value  # both; it has an interval, too
learned["exact"] = planning.policy_value(env, sticks_late)
print(f"from {log.terminal.sum()} games of a player who tosses a coin:\n")
print("what a game is worth to a player who sticks on 20 and 21 only")
for how, value in learned.items():
    print(f"  {how:22}{value:8.4f}")

control = rl.QLearning(alpha=rl.schedules.Power(0.7, clock="visit"))
q = rl.learn(key, control, log, *sizes).q
players = {
    "who tosses a coin": coin,
    "as learned from the log": planning.greedy_policy(q),
    "at best": planning.policy_iteration(env)[0],
}
values = {name: planning.policy_value(env, policy) for name, policy in players.items()}
print("what a game is worth, exactly, to a player ...")
for name, value in values.items():
    print(f"  {name:24}{value:8.4f}")
