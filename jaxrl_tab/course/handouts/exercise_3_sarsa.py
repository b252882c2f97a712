"""Exercise 3: Sarsa.

Learn from the action that is taken next (book, box of section 6.4):

    draw A' in S', epsilon-greedily
    Q(S, A) <- Q(S, A) + alpha [R + gamma Q(S', A') - Q(S, A)]
    take A' next

An agent is used in this loop, as with Gymnasium:

    action = agent.act(state)
    while not (terminated or truncated):
        next_state, reward, terminated, truncated = ...  # what the action leads to
        next_action = agent.update(state, action, reward, next_state, terminated, truncated)
        if next_action is None:  # update returned nothing
            next_action = agent.act(next_state)
        state, action = next_state, next_action

So update draws A', learns from Q(S', A'), and returns A'. Where the episode was cut off by a time limit, the task would
have gone on: it still learns from Q(S', A').

The check lets the agent act on a small task, and compares Q after each step with what it should be. The state in which
an episode ends may be one in which other episodes go on, so that its Q is not 0.

Fill in act and update (add methods as you like). Then:

    jaxrl-tab check exercise_3_sarsa.py
"""

import numpy as np


class Sarsa:
    def __init__(self, num_states, num_actions, alpha, gamma, epsilon, rng):
        self.q = np.zeros((num_states, num_actions))
        self.alpha, self.gamma, self.epsilon, self.rng = alpha, gamma, epsilon, rng

    def act(self, state):
        """The action to take in a state: epsilon-greedy by self.q[state]; exercise 1 can be imported."""
        raise NotImplementedError("write me")

    def update(self, state, action, reward, next_state, terminated, truncated):
        """Learns from one step. Returns A', which is taken next.

        terminated: the episode ends, for next_state is terminal: nothing comes after it.
        truncated: the episode ends, for its time is over; the task itself would go on.
        """
        raise NotImplementedError("write me")
