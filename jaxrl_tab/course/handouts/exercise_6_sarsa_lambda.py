"""Exercise 6: Sarsa(lambda).

Every pair learns from every error, the more the later it came (book, box of section 12.7; Silver, lecture 5), with
accumulating traces z, which are 0 when an episode begins:

    draw A' in S', epsilon-greedily
    delta = R + gamma Q(S', A') - Q(S, A)
    z(S, A) <- z(S, A) + 1
    for all s, a:   Q(s, a) <- Q(s, a) + alpha delta z(s, a),   then   z(s, a) <- gamma lambda z(s, a)
    take A' next

An agent is used in this loop, as with Gymnasium:

    action = agent.act(state)
    while not (terminated or truncated):
        next_state, reward, terminated, truncated = ...  # what the action leads to
        next_action = agent.update(state, action, reward, next_state, terminated, truncated)
        if next_action is None:  # update returned nothing
            next_action = agent.act(next_state)
        state, action = next_state, next_action

Where the episode was cut off by a time limit, the task would have gone on: the error still has Q(S', A') in it.

The check lets the agent act on a small task, and compares all of Q after each step with what it should be.

Fill in act and update (add methods as you like). Then:

    jaxrl-tab check exercise_6_sarsa_lambda.py
"""

import numpy as np


class SarsaLambda:
    def __init__(self, num_states, num_actions, alpha, gamma, epsilon, lam, rng):
        self.q = np.zeros((num_states, num_actions))
        self.z = np.zeros((num_states, num_actions))
        self.alpha, self.gamma, self.epsilon, self.lam, self.rng = alpha, gamma, epsilon, lam, rng

    def act(self, state):
        """The action to take in a state: epsilon-greedy by self.q[state]; exercise 1 can be imported."""
        raise NotImplementedError("write me")

    def update(self, state, action, reward, next_state, terminated, truncated):
        """Learns from one step. Returns A', which is taken next.

        terminated: the episode ends, for next_state is terminal: nothing comes after it.
        truncated: the episode ends, for its time is over; the task itself would go on.
        """
        raise NotImplementedError("write me")
