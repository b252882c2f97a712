"""What agents should learn from each step, and what they learn with a mistake in it: plain loops over NumPy arrays.

A learner follows an agent step by step. It remembers what the method remembers (`see`), and says what Q should be
after the step, given the Q before it (`after`). A mistake is a word in `mistakes`.
"""

from typing import Any, ClassVar, NamedTuple

import numpy as np


class Setting(NamedTuple):
    """What an agent is built with.

    No two of the numbers, or their complements or products, are the same. With this epsilon no best action is taken
    with probability 0.45 where one is best; with 0.6 if one explores among the others only, 0.3 if epsilon is the wrong
    way round, and 0.75 if one always explores: far apart.
    """

    num_states: int = 6
    num_actions: int = 4
    alpha: float = 0.25
    gamma: float = 0.875
    epsilon: float = 0.6
    n: int = 3
    lam: float = 0.625


class Step(NamedTuple):
    """A step as `update` hears of it."""

    s: int
    a: int
    r: float
    s_next: int
    terminated: bool
    truncated: bool

    @property
    def last(self) -> bool:
        return self.terminated or self.truncated


# What the target looks at in S', by the mistake.
TARGETS = {
    "max-target": "max",
    "expected-target": "expected",
    "uniform-target": "uniform",
    "min-target": "min",
    "same-action": "same action",
    "action-index": "index",
    "draws-again": "sampled",
    "explores-in-target": "sampled",
}
UNSURE = {
    "draws-again",
    "explores-in-target",
}  # of these nobody sees which action was drawn: any may have been


class Learner:
    """One-step learning: Q(S, A) <- Q(S, A) + alpha [R + gamma (what S' is worth) - Q(S, A)]."""

    target: ClassVar[str] = "sampled"

    def __init__(self, setting: Setting, mistakes: frozenset[str] = frozenset()):
        self.setting, self.mistakes = setting, mistakes
        self.steps: list[Step] = []
        self.visits = np.zeros((setting.num_states, setting.num_actions), int)
        self.gamma = 1.0 if "no-gamma" in mistakes else setting.gamma
        self.kind = next((TARGETS[x] for x in mistakes if x in TARGETS), self.target)
        self.unsure = bool(UNSURE & mistakes)

    def see(self, step: Step) -> None:
        """Remembers a step."""
        if self.steps and self.forgets(self.steps[-1]):
            self.steps = []
        if "swapped-states" in self.mistakes:
            step = step._replace(s=step.s_next, s_next=step.s)
        self.steps.append(step)
        self.visits[step[:2]] += 1

    def forgets(self, last: Step) -> bool:
        """Whether what was remembered is forgotten after this step."""
        return last.last

    def after(self, q: np.ndarray, a_next: int) -> np.ndarray:
        """Q after the last step that was seen, where it was `q`, and `a_next` is A'."""
        step, q = self.steps[-1], q.copy()
        if "terminal-reset" in self.mistakes and step.terminated:
            q[step.s_next] = 0
        if not self.skips(step):
            self.move(q, step, step.r + self.discounted(q, a_next))
        return q

    def skips(self, step: Step) -> bool:
        """Whether nothing is learned from a step."""
        skipped = {"learns-nothing"}
        if step.last:
            skipped |= {"skips-last", "skips-terminal" if step.terminated else "skips-time-limit"}
        return bool(skipped & self.mistakes)

    def discounted(self, q: np.ndarray, a_next: int, steps: int = 1) -> float:
        """What the state is worth that the last step led to, seen from so many steps before."""
        step, mistakes = self.steps[-1], self.mistakes
        ends = step.terminated and "terminal" not in mistakes
        if "swapped-ends" in mistakes:
            ends = step.truncated
        if ends or (step.truncated and "time-limit" in mistakes) or "never-bootstraps" in mistakes:
            return 0.0
        row = q[step.s if "old-state" in mistakes else step.s_next]
        if "gamma-n" in mistakes:
            steps = self.setting.n
        return self.gamma ** (1 if "gamma-once" in mistakes else steps) * self.worth(row, step.a, a_next)

    def worth(self, row: np.ndarray, a: int, a_next: int) -> float:
        if self.kind == "expected":
            best, epsilon = row == row.max(), self.setting.epsilon
            return float(row @ (epsilon / len(row) + (1 - epsilon) * best / best.sum()))
        choices = {
            "sampled": row[a_next],
            "max": row.max(),
            "min": row.min(),
            "uniform": row.mean(),
            "same action": row[a],
            "index": float(row.argmax()),
        }
        return float(choices[self.kind])

    def move(self, q: np.ndarray, step: Step, target: float) -> None:
        """Moves Q of the pair of a step towards a target."""
        pair: Any = (step.s_next if "next-pair" in self.mistakes else step.s, step.a)
        old: Any = q[step.s, step.a]
        if "all-states" in self.mistakes:
            pair = (slice(None), step.a)
        if "whole-row" in self.mistakes:
            pair, old = step.s, q[step.s].copy()
        q[pair] += self.moved(old, target, step) - old

    def moved(self, old: Any, target: float, step: Step) -> Any:
        """What the old value of the pair of a step becomes."""
        mistakes, alpha, r = self.mistakes, self.setting.alpha, step.r
        if "sample-average" in mistakes:
            alpha = 1 / self.visits[step[:2]]
        if "gamma-on-all" in mistakes:
            target += (self.gamma - 1) * r
        new = {
            "alpha-twice": old + alpha**2 * (target - old),
            "no-alpha": target + 0 * old,
            "alpha-swapped": alpha * old + (1 - alpha) * target,
            "old-not-subtracted": old + alpha * target,
            "whole-target": (1 - alpha) * old + target,
            "old-lost": alpha * target + 0 * old,
            "brackets": target - (1 - alpha) * r + 0 * old,
            "sign": old - alpha * (target - old),
        }
        return next((new[x] for x in mistakes if x in new), old + alpha * (target - old))


class QLearning(Learner):
    """R + gamma max Q(S', a)."""

    target = "max"


class NStep(Learner):
    """The pair of n steps ago learns from n rewards and the value of the pair after them; at the end all that are left.

    `steps` are those that have not learned yet.
    """

    def __init__(self, setting: Setting, mistakes: frozenset[str] = frozenset()):
        super().__init__(setting, mistakes)
        self.n = setting.n + ("n-too-large" in mistakes) - ("n-too-small" in mistakes)
        if "one-step" in mistakes:
            self.n = 1
        self.due = 0  # how many learn now

    def see(self, step: Step) -> None:
        del self.steps[: self.due]
        super().see(step)
        self.due = int(len(self.steps) >= self.n)
        if step.last:
            self.due = self._left(step)

    def _left(self, last: Step) -> int:
        """How many learn where an episode ends."""
        if "flush-oldest" in self.mistakes:
            return 1
        none = {"no-flush", "over-the-end"} & self.mistakes
        late = {"no-flush-at-time-limit", "over-the-time-limit"} & self.mistakes and last.truncated
        if none or late:
            return self.due
        return min(len(self.steps), self.due + 1 if "flush-one" in self.mistakes else len(self.steps))

    def forgets(self, last: Step) -> bool:
        kept = {"over-the-end", "flush-one"} & self.mistakes
        return last.last and not kept and not ("over-the-time-limit" in self.mistakes and last.truncated)

    def after(self, q: np.ndarray, a_next: int) -> np.ndarray:
        q, steps = q.copy(), self.steps
        if "learns-nothing" in self.mistakes:
            return q
        discount = 1.0 if "undiscounted-rewards" in self.mistakes else self.gamma
        for k in range(self.due):
            window = steps[k : k + self.n]
            rewards = sum(discount**i * step.r for i, step in enumerate(window))
            pair = steps[-1] if "newest-pair" in self.mistakes else steps[k]
            self.move(q, pair, rewards + self.discounted(q, a_next, len(window)))
        return q


class Traces(Learner):
    """Every pair learns from every error, times its trace."""

    def __init__(self, setting: Setting, mistakes: frozenset[str] = frozenset()):
        super().__init__(setting, mistakes)
        self.z = np.zeros((setting.num_states, setting.num_actions))

    def see(self, step: Step) -> None:
        if self.steps and (last := self.steps[-1]).last:
            kept = "traces-kept-at-time-limit" in self.mistakes and last.truncated
            if not kept and "traces-kept" not in self.mistakes:
                self.z[:] = 0
        if "trace-too-late" in self.mistakes and self.steps and not self.steps[-1].last:
            self.z[self.steps[-1][:2]] += 1
        super().see(step)
        fading = 1.0 if "no-gamma-in-traces" in self.mistakes else self.gamma
        fading *= 1.0 if "no-lambda" in self.mistakes else self.setting.lam
        fading = 1.0 if "no-fading" in self.mistakes else fading
        if "fades-at-once" in self.mistakes:
            self.z[step[:2]] += 1
            self.z *= fading
            return
        self.z *= fading
        if "no-traces" in self.mistakes:
            self.z[:] = 0
        if "clears-others" in self.mistakes:
            self.z[step.s] *= np.arange(self.setting.num_actions) == step.a
        if "replacing" in self.mistakes:
            self.z[step[:2]] = 1
        elif "trace-too-late" not in self.mistakes:
            self.z[step[:2]] += 1

    def after(self, q: np.ndarray, a_next: int) -> np.ndarray:
        step = self.steps[-1]
        if self.skips(step):
            return q
        old = q[step[:2]]
        return q + (self.moved(old, step.r + self.discounted(q, a_next), step) - old) * self.z


class WholeReturns(Learner):
    """First-visit Monte Carlo: at the end of an episode each pair learns from the return after its first visit."""

    def __init__(self, setting: Setting, mistakes: frozenset[str] = frozenset()):
        super().__init__(setting, mistakes)
        self.returns = np.zeros((setting.num_states, setting.num_actions), int)
        self.lessons: list[tuple[Step, float, int]] = []  # the steps that learn, their returns, and N

    def forgets(self, last: Step) -> bool:
        return last.last and "episodes-kept" not in self.mistakes

    def see(self, step: Step) -> None:
        super().see(step)
        self.lessons = []
        if not step.last:
            return
        for k in self._visits():
            pair = self.steps[k]
            self.returns[pair[:2]] += 1
            counted = pair.s if "counts-states" in self.mistakes else pair[:2]
            count = int(self.returns[counted].sum()) + ("counts-one-more" in self.mistakes)
            self.lessons.append((pair, self._return(k), count))
        if "counts-all" in self.mistakes:
            self.lessons = [(pair, g, int(self.visits[pair[:2]])) for pair, g, _ in self.lessons]

    def _visits(self) -> list[int]:
        """The steps that learn, from the last to the first."""
        steps, mistakes = self.steps, self.mistakes
        if "every-visit" in mistakes:
            return list(range(len(steps)))[::-1]
        what = (lambda x: x.s) if "first-of-state" in mistakes else (lambda x: x[:2])
        order = range(len(steps))[::-1] if "last-visit" in mistakes else range(len(steps))
        found: dict[Any, int] = {}
        for k in order:
            found.setdefault(what(steps[k]), k)
        return sorted(found.values(), reverse=True)

    def _return(self, k: int) -> float:
        mistakes, gamma = self.mistakes, self.gamma
        rewards = [step.r for step in self.steps]
        start = 0 if "same-return" in mistakes else k
        if "rewards-alone" in mistakes:
            return rewards[k]
        if "own-reward-missing" in mistakes:
            rewards = [*rewards[:k], 0.0, *rewards[k + 1 :]]
        g = sum(gamma**i * r for i, r in enumerate(rewards[start:]))
        if "own-reward-missing" in mistakes:
            g /= gamma
        if "gamma-on-all" in mistakes:
            g *= gamma
        if "discounted-from-start" in mistakes:
            g *= gamma**k
        return g

    def after(self, q: np.ndarray, a_next: int) -> np.ndarray:
        q = q.copy()
        for step, g, count in () if "learns-nothing" in self.mistakes else self.lessons:
            old = q[step[:2]]
            size = 1 / count
            if "constant-alpha" in self.mistakes:
                size = self.setting.alpha
            if "last-return" in self.mistakes:
                size = 1.0
            q[step[:2]] = old + g if "sum" in self.mistakes else old + size * (g - old)
        return q
