"""Whether a behaviour policy takes every action that a target policy may take."""

import numpy as np

from jaxrl_tab.core import clock
from jaxrl_tab.core.checks import Marks, concrete, first
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.core.policies import UCB, EpsilonGreedy, Greedy, Policy, Softmax, Table


def check_coverage(what: str, target: Policy, behaviour: Policy) -> None:
    """Raises InputError where `behaviour` leaves out an action that `target` can take.

    This is the assumption of coverage: pi(a | s) > 0 implies b(a | s) > 0 (book, section 5.5). It is judged
    for whatever Q may become, and as far as the numbers given decide it: softmax and epsilon-greedy with
    epsilon > 0 take every action, greedy and UCB leave some out (a greedy behaviour none that a greedy target
    takes), tables go entry by entry, rows of terminal states included. Other policies, schedules and traced
    numbers are let through.

    Args:
        what: who asks, to begin the message.
        target: pi, which is learned about.
        behaviour: b, which acts.
    """
    if isinstance(behaviour, EpsilonGreedy) and not isinstance(target, Table | EpsilonGreedy):
        behaviour = EpsilonGreedy(behaviour.epsilon)  # other policies see from Q what is not available
    out = _left_out(behaviour)
    if out is None or (_is_greedy(behaviour) and _is_greedy(target)):
        return
    can = np.array(True)
    if isinstance(target, Table):
        if (pi := concrete(target.probabilities)) is None:
            return
        can = pi > 0
    if isinstance(target, EpsilonGreedy):
        if (available := _available(target)) is None:
            return
        can = available
    if can.ndim and out.ndim and can.shape != out.shape:
        problem = f"target is a table {can.shape}, and behaviour one {out.shape}"
    elif at := first(can & out):
        problem = (
            f"behaviour leaves out action {at[1]} in state {at[0]}, which target can take; "
            "give it a positive probability"
        )
    elif at is not None:
        problem = (
            "behaviour leaves out actions that target can take; "
            "let it take all of them, as EpsilonGreedy(0.1) does"
        )
    else:
        return
    raise InputError(problem, who=what, field="behaviour")


def _left_out(policy: Policy) -> Marks | None:
    """Where the probability of a policy is 0, or can be 0 for some Q, bool [S, A].

    The answer is a single bool [] for all entries where they do not differ, and None where the numbers that
    are given do not decide it.
    """
    match policy:
        case Table():
            pi = concrete(policy.probabilities)
            return None if pi is None else pi == 0
        case EpsilonGreedy() if isinstance(policy.epsilon, clock.Schedule):
            return None
        case EpsilonGreedy():
            epsilon, available = concrete(policy.epsilon), _available(policy)
            return None if epsilon is None or available is None else ~available | (epsilon == 0).any()
        case Softmax():
            return np.array(False)
        case Greedy() | UCB():
            return np.array(True)
    return None


def _available(policy: EpsilonGreedy) -> Marks | None:
    """The available actions, bool [S, A], or True [] where all are; None where they are traced."""
    available = np.array(True) if policy.available is None else concrete(policy.available)
    return None if available is None else available > 0


def _is_greedy(policy: Policy) -> bool:
    """Whether it is the greedy policy, by this name or as epsilon-greedy that never explores."""
    if isinstance(policy, EpsilonGreedy) and not isinstance(policy.epsilon, clock.Schedule):
        epsilon = concrete(policy.epsilon)
        return epsilon is not None and bool((epsilon == 0).all())
    return isinstance(policy, Greedy)
