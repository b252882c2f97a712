"""Exercise 2: on-policy first-visit Monte Carlo control.

Learn from whole returns (book, box of section 5.4). When an episode is over, go through its steps from the last to the
first, with G = 0 before:

    G <- gamma G + R
    unless the pair (S, A) occurs earlier in the episode:
        Q(S, A) <- the mean of all returns that followed first visits of (S, A), this one included

An agent is used in this loop, as with Gymnasium:

    action = agent.act(state)
    while not (terminated or truncated):
        next_state, reward, terminated, truncated = ...  # what the action leads to
        next_action = agent.update(state, action, reward, next_state, terminated, truncated)
        if next_action is None:  # update returned nothing
            next_action = agent.act(next_state)
        state, action = next_state, next_action

So update remembers the step, and learns where the episode ends. Here every episode ends in a terminal state.

The check lets the agent act on a small task, and compares Q after each step with what it should be; gamma is not 1.

Fill in act and update (add methods as you like). Then:

    jaxrl-tab check exercise_2_monte_carlo.py
"""

import numpy as np


class MonteCarlo:
    def __init__(self, num_states, num_actions, gamma, epsilon, rng):
        self.q = np.zeros((num_states, num_actions))
        self.gamma, self.epsilon, self.rng = gamma, epsilon, rng

    def act(self, state):
        """The action to take in a state: epsilon-greedy by self.q[state]; exercise 1 can be imported."""
        raise NotImplementedError("write me")

    def update(self, state, action, reward, next_state, terminated, truncated):
        """Learns from one step.

        terminated: the episode ends, for next_state is terminal: nothing comes after it.
        truncated: the episode ends, for its time is over; the task itself would go on.
        """
        raise NotImplementedError("write me")
