"""Exercise 5: n-step Sarsa.

Learn from n rewards, and the value of the pair after them (book, box of section 7.2):

    G = R_(t+1) + gamma R_(t+2) + ... + gamma^(n-1) R_(t+n) + gamma^n Q(S_(t+n), A_(t+n))
    Q(S_t, A_t) <- Q(S_t, A_t) + alpha [G - Q(S_t, A_t)]

An agent is used in this loop, as with Gymnasium:

    action = agent.act(state)
    while not (terminated or truncated):
        next_state, reward, terminated, truncated = ...  # what the action leads to
        next_action = agent.update(state, action, reward, next_state, terminated, truncated)
        if next_action is None:  # update returned nothing
            next_action = agent.act(next_state)
        state, action = next_state, next_action

So update remembers the step, draws A', lets the pair of n steps ago learn, if there is one, and returns A'. Where the
episode ends, all pairs that are left learn, the oldest first: in a terminal state from the rewards up to it; at a time
limit also from the value of the last S' and A', discounted by as many steps as there are.

The check lets the agent act on a small task, and compares Q after each step with what it should be; n is more than 2.

Fill in act and update (add methods as you like). Then:

    jaxrl-tab check exercise_5_n_step_sarsa.py
"""

import numpy as np


class NStepSarsa:
    def __init__(self, num_states, num_actions, alpha, gamma, epsilon, n, rng):
        self.q = np.zeros((num_states, num_actions))
        self.alpha, self.gamma, self.epsilon, self.n, self.rng = alpha, gamma, epsilon, n, rng

    def act(self, state):
        """The action to take in a state: epsilon-greedy by self.q[state]; exercise 1 can be imported."""
        raise NotImplementedError("write me")

    def update(self, state, action, reward, next_state, terminated, truncated):
        """Learns from one step. Returns A', which is taken next.

        terminated: the episode ends, for next_state is terminal: nothing comes after it.
        truncated: the episode ends, for its time is over; the task itself would go on.
        """
        raise NotImplementedError("write me")
