"""Exercise 1: epsilon-greedy.

An agent that always takes the action that looks best never learns what the others are worth. So, with probability
epsilon, it takes any action (book, section 2.2; Silver, lecture 5):

    pi(a | s) = epsilon / |A| + 1 - epsilon    for the best action,
    pi(a | s) = epsilon / |A|                  for each of the others.

Where several actions are equally good, each of the best is equally likely.

Fill in the function. Then:

    jaxrl-tab check exercise_1_epsilon_greedy.py

The check draws many actions, from values with a tie and without, and compares how often each one comes.
"""

import numpy as np  # noqa: F401  of use, perhaps


def epsilon_greedy(values, epsilon, rng):
    """The action to take, 0 to |A| - 1.

    Args:
        values: the value of each action, an array [A].
        epsilon: the probability to explore.
        rng: a generator of random numbers: rng.random() is between 0 and 1, rng.integers(n) is one of 0 to n - 1, and
            rng.choice(x) is one of the entries of x.
    """
    raise NotImplementedError("write me")
