"""The mistakes that are known by name: what one says to a student who made one, and why it is one."""

from typing import NamedTuple


class Mistake(NamedTuple):
    """A mistake.

    Attributes:
        what: what the agent does, one sentence.
        why: what would be right, and why.
    """

    what: str
    why: str


MISTAKES = {
    # --- how it acts ---
    "first-of-ties": Mistake(
        "It takes the first of tied actions.",
        "Where several actions are best, each of them must be equally likely; argmax always takes the first one.",
    ),
    "last-of-ties": Mistake(
        "It takes the last of tied actions.",
        "Where several actions are best, each of them must be equally likely.",
    ),
    "never-explores": Mistake(
        "It never explores.",
        "ε belongs into the behaviour: with probability ε the action is drawn from all actions.",
    ),
    "always-explores": Mistake(
        "It always acts at random.",
        "With probability 1 - ε the action must be a best one.",
    ),
    "explores-others": Mistake(
        "It explores among the other actions only.",
        "With probability ε it must draw from all actions, the best included: the best one then has probability "
        "1 - ε + ε/|A|, and each other one ε/|A|.",
    ),
    "explores-not-last": Mistake(
        "It never explores the last action.",
        "With probability ε it must draw from all actions: rng.integers(n) is one of 0 to n - 1 already.",
    ),
    "epsilon-swapped": Mistake(
        "It explores with probability 1 - ε.",
        "It must explore with probability ε, and be greedy with 1 - ε: the comparison is the wrong way "
        "round.",
    ),
    "takes-worst": Mistake(
        "It takes a worst action where it should take a best one.", "Greedy is the maximum."
    ),
    "other-epsilon": Mistake(
        "It does not explore with the ε that it was given.",
        "Use the ε of the constructor, as it is: it does not change here.",
    ),
    "stale-action": Mistake(
        "It begins an episode with an action that was drawn in the episode before.",
        "Where an episode ends, by a terminal state or by a time limit, forget the next action; the first action is "
        "drawn in the first state.",
    ),
    "old-state-action": Mistake(
        "It draws A' by the values of S, not of S'.", "A' is what it does in the next state: act(next_state)."
    ),
    "changes-values": Mistake(
        "It changes the values that it is given.", "They belong to the caller: change a copy, values.copy()."
    ),
    # --- what it looks ahead to ---
    "terminal": Mistake(
        "It bootstraps through a terminal state.",
        "Nothing comes after a terminal state: where terminated is True, the target is R alone. The Q of the state "
        "that was reached may be anything, for other episodes may go on from it.",
    ),
    "time-limit": Mistake(
        "It does not bootstrap at a time limit.",
        "Where truncated is True the episode was only cut off, and the task would have gone on: the target still "
        "has the value of the next state. Only terminated says that nothing comes.",
    ),
    "swapped-ends": Mistake(
        "It takes terminated for truncated, and truncated for terminated.",
        "Terminated comes first. After it there is nothing; where truncated is True, the task would have gone on.",
    ),
    "swapped-states": Mistake(
        "It takes S for S', and S' for S.",
        "update gets the state that was left first, and next_state after the reward.",
    ),
    "never-bootstraps": Mistake(
        "It never bootstraps: it learns from R alone.",
        "The target has the discounted value of what comes next.",
    ),
    "max-target": Mistake(
        "It learns from the best action in S', as Q-learning does.",
        "Sarsa learns from the action that it will take: R + γ Q(S', A').",
    ),
    "draws-again": Mistake(
        "It draws A' again: it learns from an action that it does not take.",
        "Draw A' once in update, learn from Q(S', A'), and take that very action next: return it from update.",
    ),
    "same-action": Mistake(
        "It learns from Q(S', A), with the action of this step.",
        "A' is an action of its own, drawn in S'; only by chance is it A.",
    ),
    "explores-in-target": Mistake(
        "It explores in the target: it learns from an action that is drawn ε-greedily.",
        "Q-learning acts ε-greedily and learns about the greedy policy: the target has the maximum over the "
        "actions in S', with no ε in it.",
    ),
    "expected-target": Mistake(
        "It learns from the mean over A', as Expected Sarsa does.",
        "The target here looks at one action, not at the average of all by their probabilities.",
    ),
    "uniform-target": Mistake(
        "It learns from the plain mean of the values in S'.", "The target looks at one action in S'."
    ),
    "min-target": Mistake("It learns from the worst action in S'.", "The target has the maximum."),
    "old-state": Mistake(
        "It looks ahead to the state in which it was, not to the next one.",
        "The value in the target is that of S', not of S.",
    ),
    "action-index": Mistake(
        "It uses the number of the best action as if it were its value.",
        "argmax says which action is best; max says what it is worth.",
    ),
    "no-gamma": Mistake("It forgets γ.", "What comes after a step is discounted by γ."),
    "gamma-on-all": Mistake(
        "It discounts the reward as well.",
        "R is the reward of this very step: γ stands before what comes after it. R + γ ..., not γ (R + ...).",
    ),
    "skips-terminal": Mistake(
        "It does not learn from the step into a terminal state.",
        "That step has a reward as well, often the only one: Q(S, A) moves towards R.",
    ),
    "skips-last": Mistake(
        "It does not learn from the last step of an episode.",
        "That step has a reward as well: where terminated is True it learns from R alone, else as in any step.",
    ),
    "skips-time-limit": Mistake(
        "It does not learn from the step that a time limit ends.",
        "Where truncated is True the step is learned from as any other; there is only none after it.",
    ),
    "terminal-reset": Mistake(
        "It sets Q of the state to 0 in which an episode ended.",
        "Other episodes may go on from there. Leave its values alone; where terminated is True do not look at them.",
    ),
    "next-reward": Mistake(
        "A pair learns from the reward of the step after it.",
        "Keep the reward with the pair that it came from, until A' is known.",
    ),
    # --- how far it goes ---
    "alpha-twice": Mistake("It applies α twice.", "The step is α (target - Q(S, A)): α stands there once."),
    "no-alpha": Mistake("It forgets α.", "Q goes only the part α of the way to the target."),
    "sample-average": Mistake(
        "It learns with 1/N(S, A) and not with α.", "The step size is the α of the constructor, as it is."
    ),
    "alpha-swapped": Mistake(
        "It has α and 1 - α the wrong way round.",
        "Q <- (1 - α) Q + α target: the small part is the new one.",
    ),
    "old-not-subtracted": Mistake(
        "It adds α times the target and does not subtract Q(S, A).",
        "The step is α (target - Q(S, A)); without Q in it, Q grows and grows.",
    ),
    "whole-target": Mistake(
        "It adds the whole target to (1 - α) Q.", "The target has α before it: (1 - α) Q + α target."
    ),
    "old-lost": Mistake(
        "It loses the old value: Q becomes α times the target.",
        "Q <- Q + α (target - Q): mind the brackets, and whether it is = or +=.",
    ),
    "brackets": Mistake(
        "It has the brackets wrong: α stands before R only.",
        "α stands before the whole error, α (R + γ ... - Q(S, A)).",
    ),
    "sign": Mistake("It goes away from the target.", "The error is target minus Q(S, A), and is added."),
    "next-pair": Mistake(
        "It changes Q of the next state.", "What learns is the pair that was left, Q(S, A): not Q(S', A)."
    ),
    "whole-row": Mistake(
        "It changes all actions of S.", "Only the action that was taken learns: Q(S, A), not the row Q(S)."
    ),
    # --- n steps ---
    "n-too-small": Mistake(
        "It uses the wrong n: one step less than n.",
        "n-step returns have n rewards, and then the value of the pair after them.",
    ),
    "n-too-large": Mistake(
        "It uses the wrong n: one step more than n.",
        "n-step returns have n rewards, and then the value of the pair after them.",
    ),
    "one-step": Mistake(
        "It uses the wrong n: it learns from one step, as plain Sarsa does.",
        "n-step returns have n rewards, and then the value of the pair after them.",
    ),
    "gamma-once": Mistake(
        "It discounts the value after n rewards only once.",
        "Before it stands γ to the power of the number of rewards: γ^n, near the end of an episode less.",
    ),
    "undiscounted-rewards": Mistake(
        "It does not discount the rewards within the n steps.", "R_{t+1} + γ R_{t+2} + γ^2 R_{t+3} + ..."
    ),
    "gamma-n": Mistake(
        "It discounts the last value by γ^n even where an episode ends and fewer rewards came before it.",
        "Before it stands γ to the power of how many rewards there are.",
    ),
    "flush-oldest": Mistake(
        "Where an episode ends, only the oldest pair learns, and the others are forgotten.",
        "All that are left learn then, the oldest first, each from the rewards that follow it.",
    ),
    "no-flush": Mistake(
        "The last steps of an episode never learn.",
        "Where the episode ends, fewer than n rewards follow the last n - 1 pairs: they learn from those.",
    ),
    "flush-one": Mistake(
        "Where an episode ends, only one more pair learns.",
        "All that are left learn then, the oldest first, each from the rewards that follow it: while, not if.",
    ),
    "no-flush-at-time-limit": Mistake(
        "The last steps of an episode do not learn where a time limit ends it.",
        "An episode ends where terminated or truncated is True; in both cases the pairs that are left learn.",
    ),
    "over-the-end": Mistake(
        "It goes on over the end of an episode: steps of one learn from rewards of the next.",
        "Where an episode ends, let the pairs that are left learn, and then forget them.",
    ),
    "over-the-time-limit": Mistake(
        "It goes on over a time limit: steps of one episode learn from rewards of the next.",
        "An episode ends where terminated or truncated is True; in both cases let the pairs that are left learn, and "
        "then forget them.",
    ),
    "newest-pair": Mistake(
        "The newest pair learns from the rewards that came before it.",
        "The return of n rewards belongs to the oldest pair, that of n steps ago.",
    ),
    # --- traces ---
    "no-traces": Mistake(
        "Only the newest pair learns: the traces have no effect.",
        "Every pair learns from every error, times its trace: Q <- Q + α delta z for all of them.",
    ),
    "replacing": Mistake(
        "Its traces are replacing where they should be accumulating.",
        "A pair that comes again gets 1 added to its trace: z(S, A) <- z(S, A) + 1, not z(S, A) <- 1.",
    ),
    "clears-others": Mistake(
        "It sets the traces of the other actions of S to 0.", "Only the trace of (S, A) changes in a visit."
    ),
    "traces-kept": Mistake(
        "Its traces are not reset where an episode ends.",
        "The next episode must not teach pairs of this one: all traces are 0 when an episode begins.",
    ),
    "traces-kept-at-time-limit": Mistake(
        "Its traces are not reset where a time limit ends the episode.",
        "An episode ends where terminated or truncated is True; all traces are 0 when the next one begins.",
    ),
    "no-lambda": Mistake("It forgets λ: traces fade by γ only.", "They fade by γ λ."),
    "no-gamma-in-traces": Mistake("It forgets γ in the traces: they fade by λ only.", "They fade by γ λ."),
    "no-fading": Mistake("Its traces do not fade.", "In every step each trace is multiplied by γ λ."),
    "fades-at-once": Mistake(
        "The trace of the newest pair fades before it is used.",
        "First z(S, A) <- z(S, A) + 1, then Q <- Q + α delta z, and then the traces fade.",
    ),
    "trace-too-late": Mistake(
        "The newest pair gets its trace after Q has learned.",
        "First z(S, A) <- z(S, A) + 1, then Q <- Q + α delta z: the pair itself learns, too.",
    ),
    # --- whole returns ---
    "every-visit": Mistake(
        "It learns from every visit, not from the first one only.",
        "Where a pair comes several times in an episode, only the return after the first time counts.",
    ),
    "last-visit": Mistake(
        "It learns from the last visit, not from the first one.",
        "The loop goes backwards, so what is met first is what came last: a visit is the first one if the pair does "
        "not occur *earlier* in the episode.",
    ),
    "first-of-state": Mistake(
        "It looks for the first visit of the state, not of the pair.",
        "Another action in the same state is another pair: what counts is whether (S, A) came before.",
    ),
    "same-return": Mistake(
        "All pairs learn from the return of the whole episode.",
        "Each pair learns from the rewards that came after it: G_t, not G_0.",
    ),
    "discounted-from-start": Mistake(
        "It discounts from the start of the episode.",
        "Each return begins anew: G_t = R_{t+1} + γ R_{t+2} + ..., with γ^0 before the first reward after t.",
    ),
    "rewards-alone": Mistake(
        "Each pair learns from its own reward alone.", "G <- γ G + R: the return has all that came after it."
    ),
    "own-reward-missing": Mistake(
        "The reward of the step itself is missing in its return.",
        "G_t begins with R_{t+1}, which came with the step: first G <- γ G + R, then the pair learns.",
    ),
    "constant-alpha": Mistake(
        "It learns with a constant α, where Q should be the mean of the returns.",
        "Q(S, A) is the mean of all its returns: a step size of 1/N(S, A).",
    ),
    "sum": Mistake("Q is the sum of the returns, not their mean.", "Divide by how many there were."),
    "last-return": Mistake(
        "Q is the newest return, not the mean of all.",
        "Q(S, A) is the mean over the returns of all episodes.",
    ),
    "counts-all": Mistake(
        "It counts all visits, and learns from first ones.", "N(S, A) is how many returns are in the mean."
    ),
    "counts-states": Mistake(
        "It counts visits of the state, not of the pair.", "N(S, A) is how many returns this pair has had."
    ),
    "episodes-kept": Mistake(
        "It does not forget an episode when it is over.",
        "After it has learned, its list of steps must be emptied.",
    ),
    "counts-one-more": Mistake(
        "It counts one return too many.",
        "The first return is the mean of itself: N(S, A) begins at 0, and is 1 when the first one is taken in.",
    ),
    # --- the table ---
    "learns-nothing": Mistake(
        "Q never changes.",
        "Is it self.q that is changed, and not a copy, or a variable that is gone when update returns? And is R in the "
        "target?",
    ),
    "whole-numbers": Mistake(
        "The table holds whole numbers only.",
        "What is written into it is rounded towards 0: np.zeros((num_states, num_actions)) alone has floats.",
    ),
    "all-states": Mistake(
        "It changes Q of all states: they share one row.",
        "[[0.0] * num_actions] * num_states is the same list many times: write "
        "[[0.0] * num_actions for _ in range(num_states)].",
    ),
    "starts-elsewhere": Mistake("Q is not 0 at the beginning.", "All values begin at 0 here."),
}
