"""The book's boxes as plain loops over NumPy scalars: what every method is compared with.

Nothing here is shared with the package but the random words: a loop is told what the word of each decision
was and makes the decision by itself. So a loop and the package must agree step for step, entry for entry.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

F = np.float32


class Words(NamedTuple):
    """Uniform numbers in [0, 1) for each decision of each step, [steps]; and for the start of the run."""

    update: np.ndarray
    start: np.ndarray
    step: np.ndarray
    reset: np.ndarray
    first_reset: float
    first_action: float


class Task(NamedTuple):
    """A finite MDP as nested tables: outcomes[s][a] = [(probability, s_next, reward, terminal), ...]."""

    outcomes: list
    initial: np.ndarray
    max_steps: int

    def begin(self, u):
        return draw(self.initial, u)

    def step(self, s, a, u):
        outcomes = self.outcomes[s][a]
        return outcomes[draw([p for p, *_ in outcomes], u) if len(outcomes) > 1 else 0][1:]


class Rates(NamedTuple):
    """alpha and epsilon as functions of (step, episode, visits): numbers of this one, counted from 1."""

    alpha: Callable
    epsilon: Callable


def draw(probabilities, u):
    """The index in whose interval u falls, the intervals laid end to end and scaled to their sum."""
    edges = np.cumsum(np.asarray(probabilities, F))
    for i, edge in enumerate(edges[:-1]):
        if F(u) * edges[-1] < edge:
            return i
    return len(edges) - 1


def epsilon_greedy(row, epsilon):
    """Over the actions that there are: the values of the others are -inf, here and in all loops."""
    there, best = [q > -np.inf for q in row], [q == max(row) for q in row]
    explore, exploit = F(epsilon) / F(sum(there)), (F(1) - F(epsilon)) / F(sum(best))
    return [F(t) * explore + F(b) * exploit for t, b in zip(there, best, strict=True)]


def mean(probabilities, row):
    return sum(p * q for p, q in zip(probabilities, row, strict=True) if p)


def td_control(kind, task, num_actions, rates, gamma, num_steps, words, q0=0.0):
    """Sarsa, Q-learning and Expected Sarsa (boxes of sections 6.4, 6.5; equation 6.9).

    Returns Q [S, A], the visits [S, A], and the return and length of each finished episode.
    """
    num_states = len(task.outcomes)
    q = np.full((num_states, num_actions), q0, F)
    visits = np.zeros((num_states, num_actions), int)
    finished = []
    t, episode = 0, 1
    s = task.begin(words.first_reset)
    a = draw(epsilon_greedy(q[s], rates.epsilon(1, 1, 1)), words.first_action)
    while True:  # each episode
        g, length, ended = F(0), 0, False
        while not ended:
            if t == num_steps:
                return q, visits, finished
            s_next, reward, terminal = task.step(s, a, words.step[t])
            g += F(gamma) ** length * F(reward)
            length += 1
            visits[s, a] += 1
            ended = terminal or length == task.max_steps
            epsilon = rates.epsilon(t + 2, episode, visits[s_next].sum() + 1)
            if kind == "sarsa":
                a_next = draw(epsilon_greedy(q[s_next], epsilon), words.update[t])
                bootstrap = q[s_next, a_next]
            elif kind == "q-learning":
                bootstrap = max(q[s_next])
            else:
                pi = epsilon_greedy(q[s_next], epsilon)
                bootstrap = mean(pi, q[s_next])
            target = F(reward) + (F(0) if terminal else F(gamma) * bootstrap)
            q[s, a] += F(rates.alpha(t + 1, episode, visits[s, a])) * (target - q[s, a])
            if kind != "sarsa":
                a_next = draw(epsilon_greedy(q[s_next], epsilon), words.update[t])
            s, a = s_next, a_next
            t += 1
        finished.append((g, length))
        episode += 1
        s = task.begin(words.reset[t - 1])
        epsilon = rates.epsilon(t + 1, episode, visits[s].sum() + 1)
        a = draw(epsilon_greedy(q[s], epsilon), words.start[t - 1])


# --- one loop, many agents ---------------------------------------------------------------------------


def run(agent, task, num_steps, words):
    """Lets `agent` act and learn for so many steps; the return and length of each finished episode."""
    finished, g, length = [], F(0), 0
    s = task.begin(words.first_reset)
    a = agent.first_action(s, words.first_action)
    for t in range(num_steps):
        s_next, reward, terminal = task.step(s, a, words.step[t])
        g += F(agent.gamma) ** length * F(reward)
        length += 1
        ended = terminal or length == task.max_steps
        agent.t += 1
        agent.visits[s, a] += 1
        a = agent.learn(s, a, F(reward), s_next, terminal, ended, words.update[t])
        s = s_next
        if ended:
            finished.append((g, length))
            g, length = F(0), 0
            agent.episode += 1
            s = task.begin(words.reset[t])
            a = agent.first_action(s, words.start[t])
    return finished


class Agent:
    """Acts epsilon-greedily by `values(s)`, a row of A; `learn` gives A', by the word u or later ones."""

    def __init__(self, shape, rates, gamma, q0=0.0):
        self.q = np.full(shape, q0, F)
        self.visits = np.zeros(shape, int)
        self.rates, self.gamma = rates, gamma
        self.t, self.episode = 0, 1

    def values(self, s):
        return self.q[s]

    def act(self, s, u):
        epsilon = self.rates.epsilon(self.t + 1, self.episode, self.visits[s].sum() + 1)
        return draw(epsilon_greedy(self.values(s), epsilon), u)

    def first_action(self, s, u):
        return self.act(s, u)

    def alpha(self, s, a):
        return F(self.rates.alpha(self.t, self.episode, self.visits[s, a]))

    def discount(self, terminal):
        return F(0) if terminal else F(self.gamma)


class OffPolicy(Agent):
    """Q-learning with A' ~ target(row, s), drawn by words of its own; or, without words, its expectation."""

    def __init__(self, *args, target, words=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.target, self.words = target, words

    def learn(self, s, a, r, s_next, terminal, ended, u):
        row = self.q[s_next]
        pi = self.target(row, s_next)
        bootstrap = mean(map(F, pi), row) if self.words is None else row[draw(pi, self.words[self.t - 1])]
        target = r + self.discount(terminal) * bootstrap
        self.q[s, a] += self.alpha(s, a) * (target - self.q[s, a])
        return self.act(s_next, u)


class DoubleQLearning(Agent):
    """The box of section 6.7. Heads: Q1 learns. Of several maximal actions one is drawn, by other words."""

    def __init__(self, *args, heads, words, **kwargs):
        super().__init__(*args, **kwargs)
        self.q1, self.q2, self.heads, self.words = self.q, self.q.copy(), heads, words

    def values(self, s):
        return (self.q1[s] + self.q2[s]) / F(2)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        own, other = (self.q1, self.q2) if self.heads[self.t - 1] else (self.q2, self.q1)
        best = draw(epsilon_greedy(own[s_next], 0.0), self.words[self.t - 1])
        target = r + self.discount(terminal) * other[s_next, best]
        own[s, a] += self.alpha(s, a) * (target - own[s, a])
        return self.act(s_next, u)


class NStepSarsa(Agent):
    """The box of section 7.2, with the whole episode kept in lists; at a time limit the tail bootstraps."""

    def __init__(self, *args, n, **kwargs):
        super().__init__(*args, **kwargs)
        self.n, self.steps = n, []

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, r, self.alpha(s, a)))
        a_next = self.act(s_next, u)
        length = len(self.steps)
        oldest = length - self.n
        for tau in range(max(oldest, 0), length if ended else oldest + 1):
            g = F(0)
            for i in range(tau, length):
                g += F(self.gamma) ** (i - tau) * self.steps[i][2]
            if not terminal:
                g += F(self.gamma) ** (length - tau) * self.q[s_next, a_next]
            s, a, _, alpha = self.steps[tau]
            self.q[s, a] += alpha * (g - self.q[s, a])
        if ended:
            self.steps = []
        return a_next


class DynaQ(Agent):
    """The box of section 8.2; with kappa Dyna-Q+, section 8.3. words: two for each planning step, [steps, n, 2]."""

    def __init__(self, *args, words, kappa=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.words, self.kappa = words, kappa
        self.model, self.tried_at = {}, {}

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.improve(s, a, r, self.discount(terminal), s_next)
        if s not in self.model:
            self.model[s] = {}
        self.model[s][a] = r, self.discount(terminal), s_next
        self.tried_at[s, a] = self.t
        for of_state, of_action in self.words[self.t - 1]:
            s_past = list(self.model)[int(F(of_state) * F(len(self.model)))]
            tried = self.model[s_past]
            there = [
                q > -np.inf if self.kappa is not None else a in tried for a, q in enumerate(self.q[s_past])
            ]
            a_past = draw(there, of_action)
            r_past, discount, next_past = tried.get(a_past, (F(0), F(self.gamma), s_past))
            if self.kappa is not None:
                r_past += F(self.kappa) * np.sqrt(F(self.t - self.tried_at.get((s_past, a_past), 0)))
            self.improve(s_past, a_past, r_past, discount, next_past)
        return self.act(s_next, u)

    def improve(self, s, a, r, discount, s_next):
        self.q[s, a] += self.alpha(s, a) * (r + discount * max(self.q[s_next]) - self.q[s, a])


class PrioritizedSweeping(Agent):
    """The box of section 8.4, with the queue as a dict of priorities."""

    def __init__(self, *args, n=5, theta=1e-4, **kwargs):
        super().__init__(*args, **kwargs)
        self.n, self.theta = n, F(theta)
        self.model, self.queue = {}, {}

    def error(self, s, a):
        r, discount, s_next = self.model[s, a]
        return r + discount * max(self.q[s_next]) - self.q[s, a]

    def insert(self, s, a):
        priority = abs(self.error(s, a))
        if priority > self.theta:
            self.queue[s, a] = max(priority, self.queue.get((s, a), F(0)))

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.model[s, a] = r, self.discount(terminal), s_next
        self.insert(s, a)
        for _ in range(self.n):
            if not self.queue:
                break
            first = max(sorted(self.queue), key=self.queue.__getitem__)
            del self.queue[first]
            self.q[first] += self.alpha(*first) * self.error(*first)
            for pair, (_, _, leads_to) in self.model.items():
                if leads_to == first[0]:
                    self.insert(*pair)
        return self.act(s_next, u)


class RMax(Agent):
    """Pairs with m visits are known, by the mean of these; the others keep their Q."""

    def __init__(self, *args, m, sweeps, **kwargs):
        super().__init__(*args, **kwargs)
        self.m, self.sweeps = m, sweeps
        self.seen, self.ends = {}, set()

    def learn(self, s, a, r, s_next, terminal, ended, u):
        seen = self.seen.setdefault((s, a), [])
        if terminal:
            self.ends.add(s_next)
        if len(seen) < self.m:
            seen.append((r, s_next))
            if len(seen) == self.m:
                self.solve()
        return self.act(s_next, u)

    def solve(self):
        known = {pair: seen for pair, seen in self.seen.items() if len(seen) == self.m}
        for _ in range(self.sweeps):
            v = [F(0) if s in self.ends else row.max() for s, row in enumerate(self.q)]
            means = {
                pair: np.mean([r + F(self.gamma) * v[x] for r, x in seen]) for pair, seen in known.items()
            }
            for pair, mean in means.items():
                self.q[pair] = mean


class PSRL(Agent):
    """A model drawn from the posterior after each episode, or `every` steps; of several, each pair has its best.

    `numbers(t)` are the uniform numbers of the model that is drawn in step t, [pair, next state, try, 2], and the signs
    of the rewards' normal numbers, [pair]: a try is of Cheng's method, and try 0 has the number for the power.
    """

    def __init__(self, *args, numbers, prior, r0, spread, every, samples, sweeps, **kwargs):
        super().__init__(*args, **kwargs)
        self.first, self.numbers, self.prior, self.r0, self.spread = self.q.copy(), numbers, prior, r0, spread
        self.every, self.samples, self.sweeps = every, samples, sweeps
        self.seen, self.ends, self.left = {}, set(), 1

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.seen.setdefault((s, a), []).append((float(r), s_next))
        if terminal:
            self.ends.add(s_next)
        self.left -= 1
        if ended or self.left == 0:
            self.left = self.every
            self.solve()
        return self.act(s_next, u)

    def gamma_variable(self, shape, tries):
        a, root = shape + 1, np.sqrt(2 * shape + 1)
        for u, w in tries[1:]:
            v = np.log(u / (1 - u)) / root
            if a - np.log(4) + (a + root) * v - a * np.exp(v) >= np.log(u * u * w):
                return a * np.exp(v) * tries[0][0] ** (1 / shape)
        raise AssertionError("more tries are needed")

    def solve(self):
        tries, signs = self.numbers(self.t - 1)
        states, actions = self.q.shape
        p, r = (np.zeros((states, actions, self.samples, *rest)) for rest in ((states,), ()))
        for pair, (s, a, k) in enumerate(np.ndindex(states, actions, self.samples)):
            seen = self.seen.get((s, a), [])
            follows = [sum(x == z for _, x in seen) for z in range(states)]
            weights = [
                self.gamma_variable(n + self.prior / states, of_one)
                for n, of_one in zip(follows, tries[pair], strict=False)
            ]
            p[s, a, k] = np.array(weights) / sum(weights)
            z = signs[pair] * np.sqrt(2 * self.gamma_variable(0.5, tries[pair][states]))
            known = 1 + len(seen)
            r[s, a, k] = (self.r0 + sum(x for x, _ in seen)) / known + self.spread / np.sqrt(known) * z
        self.q[:] = self.first
        for _ in range(self.sweeps):
            v = [0.0 if s in self.ends else row.max() for s, row in enumerate(self.q)]
            backed_up = (r + float(self.gamma) * (p @ np.array(v))).max(2)
            self.q[:] = np.where(self.first > -1e29, backed_up, self.first)


class MonteCarlo(Agent):
    """Every visit, in order, towards its return (book, equation 6.1), with its own step size."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.steps = []

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, r, self.alpha(s, a)))
        a_next = self.act(s_next, u)
        if ended:
            returns = [F(0)]
            for _, _, r, _ in reversed(self.steps):
                returns.append(r + F(self.gamma) * returns[-1])
            for (s, a, _, alpha), g in zip(self.steps, reversed(returns), strict=False):
                self.q[s, a] += alpha * (g - self.q[s, a])
            self.steps = []
        return a_next


class Traces(Agent):
    """Sarsa(lambda), with dutch traces as in the box of section 12.7, else as in the lecture's; and Q(lambda):

    Watkins's and the naive one as in section 7.6 of the first edition, Peng's as in Peng and Williams 1996. In float64.
    """

    def __init__(self, *args, lam, trace="accumulating", offline=False, version=None):
        super().__init__(*args)
        self.q = self.q.astype(float)
        self.lam, self.trace, self.offline, self.version = lam, trace, offline, version
        self.begin()

    def begin(self):
        self.z, self.increments, self.q_old = np.zeros_like(self.q), np.zeros_like(self.q), 0.0

    def learn(self, s, a, r, s_next, terminal, ended, u):
        q, z, alpha = self.q, self.z, float(self.alpha(s, a))
        a_next = self.act(s_next, u)
        is_greedy = q[s_next, a_next] == max(q[s_next])
        q_now, q_next = q[s, a], max(q[s_next]) if self.version else q[s_next, a_next]
        if terminal:
            q_next = 0.0
        delta = r + self.gamma * q_next - q_now
        if self.version == "peng":
            q += (
                alpha
                * (r + self.gamma * q_next - max(q[s]))
                * (z if self.trace == "accumulating" else others(z, s, a))
            )
            q[s, a] += alpha * delta
        if self.trace == "accumulating":
            z[s, a] += 1
        elif self.trace == "replacing":
            z[s, a] = 1
        elif self.trace == "clearing":
            z[s] = 0
            z[s, a] = 1
        else:
            z[s, a] += 1 - alpha * z[s, a]
        if self.offline:
            self.increments += alpha * delta * z
        elif self.trace == "dutch":
            q += alpha * (delta + q_now - self.q_old) * z
            q[s, a] -= alpha * (q_now - self.q_old)
            self.q_old = q_next
        elif self.version != "peng":
            q += alpha * delta * z
        z *= self.gamma * self.lam
        if self.version == "watkins" and not is_greedy:
            z[:] = 0
        if ended:
            q += self.increments
            self.begin()
        return a_next


def others(z, s, a):
    """The traces of all pairs but this one."""
    z = z.copy()
    z[s, a] = 0
    return z


class WholeReturns(Agent):
    """Monte Carlo control (boxes of sections 5.3 and 5.4; Silver, lecture 5). In float64.

    `returns` counts what was averaged, and is what schedules by visit go by. A time limit leaves the mean of
    Q(S', .) under the policy. In a batch of episodes the policy stays what it was at first, with its epsilon.
    """

    def __init__(self, *args, first_visit=False, batch=1, exploring_starts=False, behaviour=None):
        super().__init__(*args)
        self.q = self.q.astype(float)
        self.first_visit, self.batch, self.exploring_starts = first_visit, batch, exploring_starts
        self.behaviour = behaviour
        self.returns, self.steps = np.zeros(self.q.shape, int), []
        self.improve(1)

    def improve(self, episode):
        """The policy of the next batch, which begins with this episode."""
        self.acting, self.frozen = self.q.copy(), (self.t, episode, self.returns.copy())

    def probs(self, s):
        if self.behaviour is not None:
            return self.behaviour[s]
        now = self.t, self.episode, self.returns
        t, episode, returns = now if self.batch == 1 else self.frozen
        return soft(self.acting[s], self.rates.epsilon(t + 1, episode, returns[s].sum() + 1))

    def act(self, s, u):
        return self.choose(self.probs(s), u)

    def first_action(self, s, u):
        return self.choose(self.q[s] > -np.inf, u) if self.exploring_starts else self.act(s, u)

    def choose(self, probs, u):
        a = draw(probs, u)
        self.b = probs[a]  # what importance sampling divides by
        return a

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, float(r), self.b))
        if ended:
            self.walk_back(0.0 if terminal else self.gamma * self.rest(s_next))
            self.steps = []
            if self.episode % self.batch == 0:
                self.improve(self.episode + 1)
        return self.act(s_next, u)

    def rest(self, s):
        return mean(self.probs(s), self.q[s])

    def counts(self, i):
        """Whether the return from step i is one of those that are averaged."""
        pairs = [step[:2] for step in self.steps]
        return not self.first_visit or pairs[i] not in pairs[:i]

    def rate(self, s, a):
        self.returns[s, a] += 1
        return float(self.rates.alpha(self.t, self.episode, self.returns[s, a]))

    def walk_back(self, g):
        """`g` is what came after the last reward, discounted."""
        for i, (s, a, r, _) in reversed(list(enumerate(self.steps))):
            g = r + g
            if self.counts(i):
                self.q[s, a] += self.rate(s, a) * (g - self.q[s, a])
            g *= self.gamma


def soft(row, epsilon):
    """The epsilon-greedy policy, in float64."""
    there, best = (np.array(x, float) for x in (row > -np.inf, row == max(row)))
    return float(epsilon) * there / there.sum() + (1 - float(epsilon)) * best / best.sum()


class OffPolicyReturns(WholeReturns):
    """Off-policy Monte Carlo control (box of section 5.7, with any target; equations 5.5 and 5.14).

    target(row, s) is pi(. | s). The terms of each return are added up one by one.
    """

    def __init__(self, *args, target, weighting, **kwargs):
        super().__init__(*args, **kwargs)
        self.target, self.weighting = target, weighting
        self.c = np.zeros_like(self.q)

    def rest(self, s):
        return mean(self.target(self.q[s], s), self.q[s])

    def walk_back(self, g):
        terms, ratios = [g], []  # discounted rewards from here on; ratios of the steps after this one
        for i, (s, a, r, b) in reversed(list(enumerate(self.steps))):
            terms = [r, *terms] if i == len(self.steps) - 1 else [r, *(self.gamma * x for x in terms)]
            if self.counts(i):
                g, w, alpha = sum(terms), np.prod(ratios), self.rate(s, a)
                if self.weighting == "weighted":
                    self.c[s, a] += w
                    alpha = w / self.c[s, a] if w else 0.0
                elif self.weighting == "ordinary":
                    g = w * g
                else:
                    weights = [np.prod(ratios[:k]) for k in range(len(terms) - 1)]
                    g = np.dot([*weights, weights[-1]], terms)
                self.q[s, a] += alpha * (g - self.q[s, a])
            ratios = [self.target(self.q[s], s)[a] / b, *ratios]


class TwoPolicies(Agent):
    """What off-policy methods with several steps share: pi and b of each action as they were when it was chosen.

    target(row, s) is pi(. | s); None: the policy that acts. In float64.
    """

    def __init__(self, *args, target=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.q, self.target, self.steps = self.q.astype(float), target, []

    def soft(self, s):
        return soft(self.q[s], self.rates.epsilon(self.t + 1, self.episode, self.visits[s].sum() + 1))

    def pi(self, s):
        return self.soft(s) if self.target is None else self.target(self.q[s], s)

    def mean(self, s):
        return mean(self.pi(s), self.q[s])

    def act(self, s, u):
        a = draw(self.soft(s), u)
        self.chosen = self.pi(s)[a], self.soft(s)[a]
        return a


class NStepOffPolicy(TwoPolicies):
    """n-step Sarsa off-policy (box of section 7.3), the whole episode kept in lists; or Expected Sarsa (equation 7.7).

    The second acts after its update.
    """

    def __init__(self, *args, n, expected, **kwargs):
        super().__init__(*args, **kwargs)
        self.n, self.expected = n, expected

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, float(r), float(self.alpha(s, a)), self.chosen))
        a_next = None if self.expected else self.act(s_next, u)
        length = len(self.steps)
        for tau in range(max(length - self.n, 0), length if ended else length - self.n + 1):
            g = sum(self.gamma ** (i - tau) * self.steps[i][2] for i in range(tau, length))
            chosen = [step[4] for step in self.steps[tau + 1 :]]
            if not terminal:
                value = self.mean(s_next) if self.expected else self.q[s_next, a_next]
                g += self.gamma ** (length - tau) * value
                is_cut = ended and self.gamma == 0  # which nobody can tell from a terminal state
                chosen += [] if self.expected or is_cut else [self.chosen]
            rho = np.prod([pi / b for pi, b in chosen])
            s, a, _, alpha, _ = self.steps[tau]
            self.q[s, a] += alpha * rho * (g - self.q[s, a])
        if ended:
            self.steps = []
        return self.act(s_next, u) if self.expected else a_next


class Branching(TwoPolicies):
    """Q(sigma) by its equation 7.17, or as in De Asis et al. 2018, and n-step tree backup by 7.16 (sigma None).

    They act after their update.
    """

    def __init__(self, *args, n, sigma=None, control_variates=True, **kwargs):
        super().__init__(*args, **kwargs)
        self.n, self.sigma, self.control_variates = n, sigma, control_variates

    def g(self, k, beyond):
        """The return of step k, as far as there are steps."""
        r = self.steps[k][2]
        if k == len(self.steps) - 1:
            return r + beyond()
        s, a, *_, (pi, b), sigma = self.steps[k + 1]
        now, longer = self.pi(s), self.g(k + 1, beyond)
        others = sum(p * q for i, (p, q) in enumerate(zip(now, self.q[s], strict=True)) if p and i != a)
        backup = others + now[a] * longer
        if sigma is None:
            return r + self.gamma * backup
        if not self.control_variates:
            return r + self.gamma * (sigma * pi / b * longer + (1 - sigma) * backup)
        weight = sigma * pi / b + (1 - sigma) * now[a]
        return r + self.gamma * weight * (longer - self.q[s, a]) + self.gamma * self.mean(s)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        sigma = None if self.sigma is None else self.sigma(self.t, self.episode)
        self.steps.append((s, a, float(r), float(self.alpha(s, a)), self.chosen, sigma))
        beyond = lambda: 0.0 if terminal else self.gamma * self.mean(s_next)
        due = len(self.steps) if ended else int(len(self.steps) == self.n)
        for _ in range(due):  # one that has learned is no longer needed
            g, (s, a, _, alpha, *_) = self.g(0, beyond), self.steps[0]
            self.q[s, a] += alpha * (g - self.q[s, a])
            del self.steps[0]
        return self.act(s_next, u)


class ExpectedTraces(TwoPolicies):
    """The error with the mean over A', and traces that go on by gamma lambda c(pi, b): one loop over all pairs."""

    def __init__(self, *args, lam, c, trace="accumulating", **kwargs):
        super().__init__(*args, **kwargs)
        self.lam, self.c, self.trace = lam, c, trace
        self.z = np.zeros_like(self.q)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        delta = r + (0.0 if terminal else self.gamma * self.mean(s_next)) - self.q[s, a]
        self.z *= self.gamma * self.lam * self.c(*self.chosen)
        self.z[s, a] = 1 if self.trace == "replacing" else self.z[s, a] + 1
        self.q += float(self.alpha(s, a)) * delta * self.z
        if ended:
            self.z[:] = 0
        return self.act(s_next, u)


class ForwardView(Agent):
    """Sarsa that learns at the end of the episode, by `view(q, episode, alphas [T])`. In float64."""

    def __init__(self, *args, view):
        super().__init__(*args)
        self.q, self.view, self.steps = self.q.astype(float), view, []

    def learn(self, s, a, r, s_next, terminal, ended, u):
        a_next = self.act(s_next, u)
        alpha = float(self.rates.alpha(self.t, self.episode, self.visits[s, a]))
        self.steps.append((s, a, float(r), 0.0 if terminal else self.gamma, s_next, a_next, alpha))
        if ended:
            *steps, alphas = map(np.array, zip(*self.steps, strict=True))
            self.q = self.view(self.q, Episode(*steps), alphas)
            self.steps = []
        return a_next


# --- state values: `acting` acts, and the values of pi are learned, in float64 ------------------------


class Values(Agent):
    """TD(0) for v_pi (box of section 6.1); off-policy, with one ratio on the target (Silver, lecture 5)."""

    def __init__(self, rates, gamma, v0, acting, pi=None):
        super().__init__(np.shape(acting), rates, gamma)
        self.v, self.acting, self.pi = np.full(len(acting), float(v0)), acting, acting if pi is None else pi
        self.begin()

    def begin(self):
        self.steps = []

    def act(self, s, u):
        return draw(self.acting[s], u)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        alpha = lambda: float(self.rates.alpha(self.t, self.episode, self.visits[s].sum()))
        self.learn_value(s, a, float(r), s_next, 0.0 if terminal else self.gamma, ended, alpha)
        if ended:
            self.begin()
        return self.act(s_next, u)

    def learn_value(self, s, a, r, s_next, discount, ended, alpha):
        rho = self.pi[s][a] / self.acting[s][a]
        self.v[s] += alpha() * (rho * (r + discount * self.v[s_next]) - self.v[s])


class NStepValues(Values):
    """The box of section 7.1, with the whole episode kept in lists."""

    def __init__(self, *args, n, **kwargs):
        super().__init__(*args, **kwargs)
        self.n = n

    def learn_value(self, s, a, r, s_next, discount, ended, alpha):
        self.steps.append((s, r, alpha()))
        length = len(self.steps)
        for tau in range(max(length - self.n, 0), length if ended else length - self.n + 1):
            g = sum(self.gamma ** (i - tau) * self.steps[i][1] for i in range(tau, length))
            g += self.gamma ** (length - 1 - tau) * discount * self.v[s_next]
            s, _, step_size = self.steps[tau]
            self.v[s] += step_size * (g - self.v[s])


class NStepOffPolicyValues(Values):
    """n-step TD off-policy (equation 7.9), the whole episode kept in lists; or with control variates (7.13)."""

    def __init__(self, *args, n, control_variates=False, **kwargs):
        super().__init__(*args, **kwargs)
        self.n, self.control_variates = n, control_variates

    def learn_value(self, s, a, r, s_next, discount, ended, alpha):
        self.steps.append((s, r, alpha(), self.pi[s][a] / self.acting[s][a], discount))
        length = len(self.steps)
        for tau in range(max(length - self.n, 0), length if ended else length - self.n + 1):
            s, _, step_size, *_ = self.steps[tau]
            if self.control_variates:
                g = self.v[s_next]
                for state, r, _, rho, gamma in reversed(self.steps[tau:]):
                    g = rho * (r + gamma * g) + (1 - rho) * self.v[state]
                self.v[s] += step_size * (g - self.v[s])
                continue
            g = sum(self.gamma ** (i - tau) * self.steps[i][1] for i in range(tau, length))
            g += self.gamma ** (length - 1 - tau) * discount * self.v[s_next]
            rho = np.prod([step[3] for step in self.steps[tau:]])
            self.v[s] += step_size * rho * (g - self.v[s])


class TraceValues(Values):
    """TD(lambda) (boxes of sections 12.2 and 12.5)."""

    def __init__(self, *args, lam, trace="accumulating", offline=False, **kwargs):
        self.lam, self.trace, self.offline = lam, trace, offline
        super().__init__(*args, **kwargs)

    def begin(self):
        self.z, self.increments, self.v_old = np.zeros_like(self.v), np.zeros_like(self.v), 0.0

    def learn_value(self, s, a, r, s_next, discount, ended, alpha):
        v, z, alpha = self.v, self.z, alpha()
        v_now, v_next = v[s], v[s_next]
        delta = r + discount * v_next - v_now
        z *= self.gamma * self.lam
        z[s] = {"accumulating": z[s] + 1, "replacing": 1, "dutch": z[s] + 1 - alpha * z[s]}[self.trace]
        if self.offline:
            self.increments += alpha * delta * z
        elif self.trace == "dutch":
            v += alpha * (delta + v_now - self.v_old) * z
            v[s] -= alpha * (v_now - self.v_old)
            self.v_old = v_next
        else:
            v += alpha * delta * z
        if ended:
            v += self.increments


class LambdaReturnValues(Values):
    """The off-line lambda-return algorithm (section 12.1, equation 12.4)."""

    def __init__(self, *args, lam, **kwargs):
        super().__init__(*args, **kwargs)
        self.lam = lam

    def learn_value(self, s, a, r, s_next, discount, ended, alpha):
        self.steps.append((s, r, discount, self.v[s_next], alpha()))
        if ended:
            states, r, discounts, values, alphas = zip(*self.steps, strict=True)
            for t, s in enumerate(states):
                g = lambda_return(r, discounts, values, self.lam, t, len(r))
                self.v[s] += alphas[t] * (g - self.v[s])


class ReturnValues(Values):
    """Monte Carlo for v_pi (box of section 5.1, equations 5.5, 5.6 and 5.14), each return by its definition.

    weighting None: on-policy.
    """

    def __init__(self, *args, first_visit=False, weighting=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.first_visit, self.weighting = first_visit, weighting
        self.averaged, self.sums = np.zeros(len(self.v), int), np.zeros((2, len(self.v)))

    def learn_value(self, s, a, r, s_next, discount, ended, alpha):
        self.steps.append((s, a, r))
        if not ended:
            return
        rest = discount * self.v[s_next]
        for t in reversed(range(len(self.steps))):
            s = self.steps[t][0]
            if self.first_visit and s in [step[0] for step in self.steps[:t]]:
                continue
            self.averaged[s] += 1
            alpha = float(self.rates.alpha(self.t, self.episode, self.averaged[s]))
            terms = [self.gamma**k * r for k, (_, _, r) in enumerate(self.steps[t:])]
            terms[-1] += self.gamma ** (len(terms) - 1) * rest
            ratios = np.array([self.pi[s][a] / self.acting[s][a] for s, a, _ in self.steps[t:]])
            if self.weighting == "weighted":  # sum of W G over sum of W, with the step size as the last share
                share = np.array([[1 - alpha], [alpha]])
                new = ratios.prod() * np.array([sum(terms), 1.0])
                self.sums[:, s] = share[0] * self.sums[:, s] + share[1] * new
                if self.sums[1, s]:
                    self.v[s] = self.sums[0, s] / self.sums[1, s]
                continue
            g = {
                None: sum(terms),
                "ordinary": ratios.prod() * sum(terms),
                "per-decision": float(np.dot(np.cumprod(ratios), terms)),
            }[self.weighting]
            self.v[s] += alpha * (g - self.v[s])


# --- the forward view, in float64 --------------------------------------------------------------------


class Episode(NamedTuple):
    """S, A, R and gamma' of each step, [T] each, and the pair (S', A') from which each is bootstrapped."""

    s: np.ndarray
    a: np.ndarray
    r: np.ndarray
    discount: np.ndarray
    s_next: np.ndarray
    a_next: np.ndarray


def lambda_return(r, discount, values, lam, t, horizon):
    """The return of step t from the n-step returns as far as `horizon` (book, equation 12.3 and 12.9).

    values[k] stands for what follows step k.
    """
    returns, g, weight = [], 0.0, 1.0
    for k in range(t, horizon):
        g += weight * r[k]
        weight *= discount[k]
        returns.append(g + weight * values[k])
    *shorter, longest = returns
    return (1 - lam) * sum(lam**n * x for n, x in enumerate(shorter)) + lam ** len(shorter) * longest


def offline_forward(q, episode, alpha, lam):
    """Q after an episode by the sum of the increments towards its lambda-returns, all by its first Q.

    That is the off-line forward view of Silver's lecture 4. alpha may be one number, or one for each step.
    """
    values = q[episode.s_next, episode.a_next]
    new = q.copy()
    for t, (s, a, step) in enumerate(np.broadcast(episode.s, episode.a, alpha)):
        g = lambda_return(episode.r, episode.discount, values, lam, t, len(episode.s))
        new[s, a] += step * (g - q[s, a])
    return new


def offline_one_by_one(q, episode, alpha, lam):
    """The off-line lambda-return algorithm of the book's section 12.1: the same returns, one update after another."""
    values = q[episode.s_next, episode.a_next]
    new = q.copy()
    for t, (s, a, step) in enumerate(np.broadcast(episode.s, episode.a, alpha)):
        g = lambda_return(episode.r, episode.discount, values, lam, t, len(episode.s))
        new[s, a] += step * (g - new[s, a])
    return new


def online_forward(q, episode, alpha, lam):
    """Q after each step by the on-line lambda-return algorithm (section 12.4): with each new step the updates

    of the whole episode are made again, from the Q of its start, with returns that look as far as that step.
    """
    values, after = [], []
    latest = q
    for h in range(1, len(episode.s) + 1):
        values.append(latest[episode.s_next[h - 1], episode.a_next[h - 1]])
        latest = q.copy()
        for t in range(h):
            g = lambda_return(episode.r, episode.discount, values, lam, t, h)
            pair = episode.s[t], episode.a[t]
            latest[pair] += alpha * (g - latest[pair])
        after.append(latest)
    return after


def every_visit_monte_carlo(q, episode, alpha):
    """Q after the episode: alpha (G - Q) added up over all visits, all by the Q of its start (section 5.1).

    Where a time limit cut the episode, G goes on with the value of the pair at which it was cut. alpha may be
    one number, or one for each step.
    """
    new, g = q.copy(), q[episode.s_next[-1], episode.a_next[-1]]
    alpha = np.broadcast_to(alpha, len(episode.s))
    for t in reversed(range(len(episode.s))):
        g = episode.r[t] + episode.discount[t] * g
        new[episode.s[t], episode.a[t]] += alpha[t] * (g - q[episode.s[t], episode.a[t]])
    return new
