"""Solutions of the exercises, in several styles; and mistakes, each as changes to one of them.

They are here so that students do not stumble over them.
"""

EPSILON_GREEDY = {
    "numpy": """
import numpy as np

def epsilon_greedy(values, epsilon, rng):
    if rng.random() < epsilon:
        return rng.integers(len(values))
    return rng.choice(np.flatnonzero(values == values.max()))
""",
    "lists": """
def epsilon_greedy(values, epsilon, rng):
    best = [a for a in range(len(values)) if values[a] == max(values)]
    everything = list(range(len(values)))
    return int(rng.choice(everything if rng.random() < epsilon else best))
""",
    "probabilities": """
import numpy as np

def epsilon_greedy(values, epsilon, rng):
    best = values == np.max(values)
    p = np.ones(len(values)) * epsilon / len(values)
    p[best] += (1 - epsilon) / best.sum()
    return rng.choice(len(values), p=p)
""",
    "the module random": """
import random

def epsilon_greedy(values, epsilon, rng):
    values = list(values)
    if random.random() < epsilon:
        return random.randrange(len(values))
    return random.choice([a for a, v in enumerate(values) if v == max(values)])
""",
}

BASE = """
import numpy as np

class Base:
    def __init__(self, num_states, num_actions, alpha, gamma, epsilon, rng):
        self.q = np.zeros((num_states, num_actions))
        self.alpha, self.gamma, self.epsilon, self.rng = alpha, gamma, epsilon, rng

    def act(self, state):
        values = self.q[state]
        if self.rng.random() < self.epsilon:
            return self.rng.integers(len(values))
        return self.rng.choice(np.flatnonzero(values == values.max()))
"""

SARSA = {
    "numpy": BASE
    + """
class Sarsa(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        next_action = self.act(next_state)
        target = reward
        if not terminated:
            target += self.gamma * self.q[next_state, next_action]
        self.q[state, action] += self.alpha * (target - self.q[state, action])
        return next_action
""",
    "remembers A'": """
import numpy as np

class Agent:
    exercise = "sarsa"

    def __init__(self, num_states, num_actions, alpha, gamma, epsilon, rng):
        self.Q = [[0.0] * num_actions for _ in range(num_states)]
        self.num_actions = num_actions
        self.alpha, self.gamma, self.epsilon, self.rng = alpha, gamma, epsilon, rng
        self.next_action = None

    def choose(self, s):
        if self.rng.uniform() < self.epsilon:
            return int(self.rng.integers(0, self.num_actions))
        best = max(self.Q[s])
        return int(self.rng.choice([a for a in range(self.num_actions) if self.Q[s][a] == best]))

    def act(self, s):
        if self.next_action is None:
            return self.choose(s)
        return self.next_action

    def update(self, s, a, r, s2, terminated, truncated):
        a2 = self.choose(s2)
        q2 = 0.0 if terminated else self.Q[s2][a2]
        self.Q[s][a] = (1 - self.alpha) * self.Q[s][a] + self.alpha * (r + self.gamma * q2)
        self.next_action = None if terminated or truncated else a2
""",
    "a step later": """
from collections import defaultdict
import random

class Sarsa:
    def __init__(self, num_actions, alpha, gamma, epsilon, **others):
        self.q = defaultdict(float)
        self.actions = range(num_actions)
        self.alpha, self.gamma, self.epsilon = alpha, gamma, epsilon
        self.before = None

    def act(self, state):
        if random.random() < self.epsilon:
            return random.choice(self.actions)
        best = max(self.q[state, a] for a in self.actions)
        return random.choice([a for a in self.actions if self.q[state, a] == best])

    def learn(self, s, a, target):
        self.q[s, a] += self.alpha * (target - self.q[s, a])

    def update(self, state, action, reward, next_state, terminated, truncated):
        if self.before:
            s, a, r = self.before
            self.learn(s, a, r + self.gamma * self.q[state, action])
        self.before = state, action, reward
        if terminated:
            self.learn(state, action, reward)
        if truncated:
            self.learn(state, action, reward + self.gamma * self.q[next_state, self.act(next_state)])
        if terminated or truncated:
            self.before = None
""",
}

Q_LEARNING = {
    "numpy": BASE
    + """
class QLearning(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        target = reward
        if not terminated:
            target += self.gamma * self.q[next_state].max()
        self.q[state, action] += self.alpha * (target - self.q[state, action])
""",
    "dict of dicts": """
exercise = "q-learning"

class MyAgent:
    def __init__(self, num_states, num_actions, alpha, gamma, epsilon, rng):
        self.q_table = {s: {a: 0.0 for a in range(num_actions)} for s in range(num_states)}
        self.step_size, self.discount, self.epsilon, self.rng = alpha, gamma, epsilon, rng

    def act(self, obs):
        row = self.q_table[obs]
        if self.rng.random() >= self.epsilon:
            top = max(row.values())
            return int(self.rng.choice([a for a in row if row[a] == top]))
        return int(self.rng.choice(list(row)))

    def update(self, obs, action, reward, next_obs, terminated, truncated):
        future = (not terminated) * max(self.q_table[next_obs].values())
        error = reward + self.discount * future - self.q_table[obs][action]
        self.q_table[obs][action] = self.q_table[obs][action] + self.step_size * error
""",
    "Gymnasium's tutorial, float32": """
from collections import defaultdict
import numpy as np

class QLearningAgent:
    def __init__(self, num_actions, alpha, gamma, epsilon, rng):
        self.q_values = defaultdict(lambda: np.zeros(num_actions, np.float32))
        self.lr, self.discount_factor, self.epsilon, self.rng = alpha, gamma, epsilon, rng
        self.training_error = []

    def act(self, obs):
        if self.rng.random() < self.epsilon:
            return self.rng.choice(len(self.q_values[obs]))
        return self.rng.choice(np.argwhere(self.q_values[obs] == np.max(self.q_values[obs])).ravel())

    def update(self, obs, action, reward, next_obs, terminated, truncated):
        future_q_value = (not terminated) * np.max(self.q_values[next_obs])
        temporal_difference = reward + self.discount_factor * future_q_value - self.q_values[obs][action]
        self.q_values[obs][action] += self.lr * temporal_difference
        self.training_error.append(temporal_difference)
""",
}

MONTE_CARLO = {
    "numpy": BASE.replace("num_actions, alpha, gamma", "num_actions, gamma").replace(
        "self.alpha, self.gamma, self.epsilon, self.rng = alpha, gamma",
        "self.gamma, self.epsilon, self.rng = gamma",
    )
    + """
class MonteCarlo(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        if not hasattr(self, "episode"):
            self.episode, self.count = [], np.zeros_like(self.q)
        self.episode.append((state, action, reward))
        if not (terminated or truncated):
            return
        pairs = [(s, a) for s, a, _ in self.episode]
        g = 0.0
        for t in reversed(range(len(self.episode))):
            s, a, r = self.episode[t]
            g = self.gamma * g + r
            if (s, a) not in pairs[:t]:
                self.count[s, a] += 1
                self.q[s, a] += (g - self.q[s, a]) / self.count[s, a]
        self.episode = []
""",
    "lists of returns, and a policy": """
import numpy as np

class MonteCarloControl:
    def __init__(self, num_states, num_actions, gamma, epsilon, rng):
        self.returns = {}
        self.q = {}
        self.A, self.gamma, self.epsilon, self.rng = num_actions, gamma, epsilon, rng
        self.policy = np.ones((num_states, num_actions)) / num_actions
        self.trajectory = []

    def act(self, state):
        return self.rng.choice(self.A, p=self.policy[state])

    def update(self, state, action, reward, next_state, terminated, truncated):
        self.trajectory.append((state, action, reward))
        if terminated or truncated:
            seen = set()
            rewards = [r for _, _, r in self.trajectory]
            for t, (s, a, _) in enumerate(self.trajectory):
                if (s, a) in seen:
                    continue
                seen.add((s, a))
                g = sum(self.gamma**k * r for k, r in enumerate(rewards[t:]))
                self.returns.setdefault((s, a), []).append(g)
                self.q[s, a] = float(np.mean(self.returns[s, a]))
            for s, _ in seen:
                row = np.array([self.q.get((s, a), 0.0) for a in range(self.A)])
                best = row == row.max()
                self.policy[s] = self.epsilon / self.A + (1 - self.epsilon) * best / best.sum()
            self.trajectory.clear()
""",
}

N_STEP = {
    "lists": BASE.replace("epsilon, rng):", "epsilon, rng, n):").replace(
        "        self.alpha,", "        self.n, self.memory = n, []\n        self.alpha,"
    )
    + """
class NStepSarsa(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        next_action = self.act(next_state)
        self.memory.append((state, action, reward))
        if len(self.memory) == self.n:
            self.learn(next_state, next_action, terminated)
        if terminated or truncated:
            while self.memory:
                self.learn(next_state, next_action, terminated)
        return next_action

    def learn(self, next_state, next_action, terminated):
        g = 0.0 if terminated else self.q[next_state, next_action]
        for _, _, r in reversed(self.memory):
            g = r + self.gamma * g
        s, a, _ = self.memory.pop(0)
        self.q[s, a] += self.alpha * (g - self.q[s, a])
""",
    "the book's box": BASE.replace("epsilon, rng):", "epsilon, rng, n):").replace(
        "        self.alpha,", "        self.n = n\n        self.begin()\n        self.alpha,"
    )
    + """
class NStepSarsa(Base):
    def begin(self):
        self.S, self.A, self.R = [], [], [0.0]

    def update(self, state, action, reward, next_state, terminated, truncated):
        self.S.append(state)
        self.A.append(action)
        self.R.append(reward)
        a_next = self.act(next_state)
        t = len(self.S) - 1
        end = terminated or truncated
        last = len(self.S) if end else np.inf
        taus = range(max(0, t - self.n + 1), len(self.S)) if end else [t - self.n + 1]
        for tau in taus:
            if tau >= 0:
                upto = min(tau + self.n, len(self.S))
                g = sum(self.gamma ** (i - tau - 1) * self.R[i] for i in range(tau + 1, upto + 1))
                if not terminated:
                    g += self.gamma ** (upto - tau) * self.q[next_state, a_next]
                s, a = self.S[tau], self.A[tau]
                self.q[s, a] += self.alpha * (g - self.q[s, a])
        if end:
            self.begin()
        return a_next
""",
    "a step later": BASE.replace("epsilon, rng):", "epsilon, rng, n):").replace(
        "        self.alpha,", "        self.n, self.memory = n, []\n        self.alpha,"
    )
    + """
class NStepSarsa(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        if len(self.memory) == self.n:
            self.learn(self.q[state, action])
        self.memory.append((state, action, reward))
        if terminated or truncated:
            value = 0.0 if terminated else self.q[next_state, self.act(next_state)]
            while self.memory:
                self.learn(value)

    def learn(self, g):
        for _, _, r in reversed(self.memory):
            g = r + self.gamma * g
        s, a, _ = self.memory.pop(0)
        self.q[s, a] += self.alpha * (g - self.q[s, a])
""",
}

SARSA_LAMBDA = {
    "numpy": BASE.replace("epsilon, rng):", "epsilon, rng, lam):").replace(
        "        self.alpha,", "        self.lam, self.z = lam, np.zeros_like(self.q)\n        self.alpha,"
    )
    + """
class SarsaLambda(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        next_action = self.act(next_state)
        target = reward + (0.0 if terminated else self.gamma * self.q[next_state, next_action])
        delta = target - self.q[state, action]
        self.z[state, action] += 1
        self.q += self.alpha * delta * self.z
        self.z *= self.gamma * self.lam
        if terminated or truncated:
            self.z[:] = 0
        return next_action
""",
    "a dict of traces": BASE.replace("epsilon, rng):", "epsilon, rng, lam):").replace(
        "        self.alpha,", "        self.lam, self.z = lam, {}\n        self.alpha,"
    )
    + """
class SarsaLambda(Base):
    def update(self, state, action, reward, next_state, terminated, truncated):
        a_next = self.act(next_state)
        bootstrap = self.gamma * self.q[next_state][a_next] * (not terminated)
        delta = reward + bootstrap - self.q[state][action]
        for pair in self.z:
            self.z[pair] *= self.gamma * self.lam
        self.z[state, action] = self.z.get((state, action), 0.0) + 1.0
        for pair, trace in self.z.items():
            self.q[pair] += self.alpha * delta * trace
        if terminated or truncated:
            self.z = {}
        return a_next
""",
}

RIGHT = {
    "epsilon-greedy": EPSILON_GREEDY,
    "monte-carlo": MONTE_CARLO,
    "sarsa": SARSA,
    "q-learning": Q_LEARNING,
    "n-step-sarsa": N_STEP,
    "sarsa-lambda": SARSA_LAMBDA,
}

CHOICE = "self.rng.choice(np.flatnonzero(values == values.max()))"
EXPLORES = "if self.rng.random() < self.epsilon:"
ANY = "return self.rng.integers(len(values))"
# Of an agent with `act` as in BASE: old -> new text, and the name of the mistake.
OF_ACT = [
    (CHOICE, "int(np.argmax(values))", "first-of-ties"),
    (CHOICE, "len(values) - 1 - int(np.argmax(values[::-1]))", "last-of-ties"),
    (EXPLORES, "if False:", "never-explores"),
    (EXPLORES, "if True:", "always-explores"),
    (EXPLORES, "if self.rng.random() > self.epsilon:", "epsilon-swapped"),
    (EXPLORES, "if self.rng.random() < 0.1:", "other-epsilon"),
    (EXPLORES, "if self.rng.random() < self.epsilon / len(values):", "other-epsilon"),
    (
        ANY,
        "best = self.rng.choice(np.flatnonzero(values == values.max())); "
        "return self.rng.choice([a for a in range(len(values)) if a != best])",
        "explores-others",
    ),
    (CHOICE, CHOICE.replace("max", "min"), "takes-worst"),
]
NOT_TERMINATED = "if not terminated:"
ENDED = "if terminated or truncated:"
TARGET = "self.alpha * (target - self.q[state, action])"
OF_ONE_STEP = [
    (NOT_TERMINATED, "if True:", "terminal"),
    (NOT_TERMINATED, "if not (terminated or truncated):", "time-limit"),
    (NOT_TERMINATED, "if False:", "never-bootstraps"),
    ("self.gamma * ", "", "no-gamma"),
    (TARGET, f"self.alpha * {TARGET}", "alpha-twice"),
    (TARGET, "(target - self.q[state, action])", "no-alpha"),
    (TARGET, "self.alpha * target", "old-not-subtracted"),
    (TARGET, "self.alpha * target - self.q[state, action]", "old-lost"),
    (TARGET, "self.alpha * (self.q[state, action] - target)", "sign"),
    ("target = reward", "target = 0.0", "learns-nothing"),
    ("self.q[state, action] += self.alpha", "self.q[next_state, action] += self.alpha", "next-pair"),
    (
        f"self.q[state, action] += {TARGET}",
        "self.q[state] += self.alpha * (target - self.q[state])",
        "whole-row",
    ),
    (
        f"self.q[state, action] += {TARGET}",
        "self.q[state, action] *= self.alpha; self.q[state, action] += (1 - self.alpha) * target",
        "alpha-swapped",
    ),
    (
        f"self.q[state, action] += {TARGET}",
        "self.q[state, action] *= 1 - self.alpha; self.q[state, action] += target",
        "whole-target",
    ),
]
FUTURE = " += self.gamma * self.q[next_state, next_action]"
OF_SARSA = [
    (
        f"            target{FUTURE}\n        self",
        f"            target{FUTURE}\n        if not terminated: self",
        "skips-terminal",
    ),
    (
        f"            target{FUTURE}\n        self",
        f"            target{FUTURE}\n        if not truncated: self",
        "skips-time-limit",
    ),
    (
        f"            target{FUTURE}\n        self",
        f"            target{FUTURE}\n        if not (terminated or truncated): self",
        "skips-last",
    ),
    ("self.q[state, action] +=", "q = self.q.copy(); q[state, action] +=", "learns-nothing"),
    ("self.q[state, action] +=", "self.q[:, action] +=", "all-states"),
    ("np.zeros((num_states, num_actions))", "np.zeros((num_states, num_actions), int)", "whole-numbers"),
    (
        "        target = reward\n",
        "        target = reward\n        self.q[next_state] *= not terminated\n",
        "terminal-reset",
    ),
    ("self.act(next_state)", "self.act(state)", "old-state-action"),
    (
        "        target = reward\n",
        "        self.n = getattr(self, 'n', 0 * self.q); self.n[state, action] += 1\n"
        "        self.alpha = 1 / self.n[state, action]\n        target = reward\n",
        "sample-average",
    ),
    (TARGET, "(self.alpha * reward + (target - reward) - self.q[state, action])", "brackets"),
    ("        return next_action\n", "", "draws-again"),
    ("self.q[next_state, next_action]", "self.q[next_state].max()", "max-target"),
    ("self.q[next_state, next_action]", "self.q[next_state, action]", "same-action"),
    ("self.q[next_state, next_action]", "self.q[next_state].mean()", "uniform-target"),
    ("self.q[next_state, next_action]", "self.q[state, next_action]", "old-state"),
    (
        "next_action = self.act(next_state)",
        "next_action = self.q[next_state].argmax()",
        ("first-of-ties", "never-explores"),
    ),
]
OF_Q_LEARNING = [
    (ANY, "return self.rng.integers(len(values) - 1)", "explores-not-last"),
    ("next_state, terminated, truncated):", "next_state, truncated, terminated):", "swapped-ends"),
    (
        "update(self, state, action, reward, next_state,",
        "update(self, next_state, action, reward, state,",
        "swapped-states",
    ),
    ("np.zeros", "np.ones", "starts-elsewhere"),
    ("self.q[next_state].max()", "self.q[next_state, self.act(next_state)]", "explores-in-target"),
    ("self.q[next_state].max()", "self.q[next_state].argmax()", "action-index"),
    ("self.q[next_state].max()", "self.q[state].max()", "old-state"),
    ("self.q[next_state].max()", "self.q[next_state].min()", "min-target"),
    (
        "self.q[next_state].max()",
        "(self.epsilon * self.q[next_state].mean() + (1 - self.epsilon) * self.q[next_state].max())",
        "expected-target",
    ),
]
OF_REMEMBERING = [
    ("self.next_action = None if terminated or truncated else a2", "self.next_action = a2", "stale-action"),
    ("self.next_action = None if terminated or truncated else a2", "pass", "draws-again"),
]
FIRST_VISIT = "if (s, a) not in pairs[:t]:"
RETURN = "g = self.gamma * g + r"
OF_MONTE_CARLO = [
    ("/ self.count[s, a]", "/ (self.count[s, a] + 1)", "counts-one-more"),
    (
        RETURN,
        "g = sum(self.gamma**k * x[2] for k, x in enumerate(self.episode[t + 1 :]))",
        "own-reward-missing",
    ),
    (
        f"{FIRST_VISIT}\n                self.count[s, a] += 1",
        f"self.count[s, a] += 1\n            {FIRST_VISIT}",
        "counts-all",
    ),
    (FIRST_VISIT, "if True:", "every-visit"),
    (FIRST_VISIT, "if (s, a) not in pairs[t + 1:]:", "last-visit"),
    (FIRST_VISIT, "if s not in [x for x, _ in pairs[:t]]:", "first-of-state"),
    (RETURN, "g = g + r", "no-gamma"),
    (RETURN, "g = self.gamma * (g + r)", "gamma-on-all"),
    (RETURN, "g = r", "rewards-alone"),
    (RETURN, "g = sum(self.gamma**k * x[2] for k, x in enumerate(self.episode))", "same-return"),
    (RETURN, "g = g + self.gamma**t * r", "discounted-from-start"),
    ("/ self.count[s, a]", "* 0.25", "constant-alpha"),
    ("/ self.count[s, a]", "/ self.count[s].sum()", "counts-states"),
    ("(g - self.q[s, a]) / self.count[s, a]", "g", "sum"),
    ("(g - self.q[s, a]) / self.count[s, a]", "g - self.q[s, a]", "last-return"),
    ("        self.episode = []\n", "", "episodes-kept"),
]
LEARNS_N = "if len(self.memory) == self.n:"
OF_N_STEP = [
    (
        "        for _, _, r in reversed(self.memory):\n            g = r + self.gamma * g\n",
        "        g = g * self.gamma**self.n + sum(self.gamma**i * x[2] for i, x in enumerate(self.memory))\n",
        "gamma-n",
    ),
    (
        f"        {ENDED}\n            while self.memory:\n"
        "                self.learn(next_state, next_action, terminated)",
        f"        elif {ENDED[3:]}\n            self.learn(next_state, next_action, terminated)\n"
        f"        {ENDED}\n            self.memory = []",
        "flush-oldest",
    ),
    ("s, a, _ = self.memory.pop(0)", "s, a, _ = self.memory[-1]; self.memory.pop(0)", "newest-pair"),
    (ENDED, f"if truncated: self.memory = []\n        {ENDED}", "no-flush-at-time-limit"),
    ("g = 0.0 if terminated else self.q", "g = self.q", "terminal"),
    ("next_action, terminated)\n", "next_action, terminated or truncated)\n", "time-limit"),
    (LEARNS_N, "if len(self.memory) == self.n - 1:", "n-too-small"),
    (LEARNS_N, "if len(self.memory) == self.n + 1:", "n-too-large"),
    (LEARNS_N, "if len(self.memory) == 1:", "one-step"),
    ("g = r + self.gamma * g", "g = r + g", "no-gamma"),
    (
        "            while self.memory:\n                self.learn(next_state, next_action, terminated)",
        "            self.memory = []",
        "no-flush",
    ),
    ("            while self.memory:\n", "            if self.memory:\n", "flush-one"),
    (ENDED, "if terminated:", "over-the-time-limit"),
    (ENDED, "if False:", "over-the-end"),
    ("self.alpha * (g", "self.alpha**2 * (g", "alpha-twice"),
    ("        return next_action\n", "", "draws-again"),
    ("self.q[next_state, next_action]", "self.q[next_state].max()", "max-target"),
]
OF_LATE = [("s, a, r = self.before", "s, a, r = *self.before[:2], reward", "next-reward")]
OF_BOX = [
    ("self.gamma ** (upto - tau) *", "self.gamma *", "gamma-once"),
    ("self.gamma ** (i - tau - 1) *", "", "undiscounted-rewards"),
]
OF_LAMBDA = [
    (
        "        self.z[state, action] += 1\n",
        "        z = self.z[state, action]; self.z[state] = 0; self.z[state, action] = z + 1\n",
        "clears-others",
    ),
    ("0.0 if terminated else", "0.0 if False else", "terminal"),
    ("0.0 if terminated else", "0.0 if terminated or truncated else", "time-limit"),
    (ENDED, "if terminated:", "traces-kept-at-time-limit"),
    (ENDED, "if False:", "traces-kept"),
    ("self.z[state, action] += 1", "self.z[state, action] = 1", "replacing"),
    ("self.gamma * self.lam", "self.gamma", "no-lambda"),
    ("self.gamma * self.lam", "self.lam", "no-gamma-in-traces"),
    ("self.z *= self.gamma * self.lam", "pass", "no-fading"),
    ("self.z *= self.gamma * self.lam", "self.z[:] = 0", "no-traces"),
    (
        "        self.z[state, action] += 1\n        self.q += self.alpha * delta * self.z\n",
        "        self.q += self.alpha * delta * self.z\n        self.z[state, action] += 1\n",
        "trace-too-late",
    ),
    (
        "        self.q += self.alpha * delta * self.z\n        self.z *= self.gamma * self.lam\n",
        "        self.z *= self.gamma * self.lam\n        self.q += self.alpha * delta * self.z\n",
        "fades-at-once",
    ),
    ("self.alpha * delta", "self.alpha * self.alpha * delta", "alpha-twice"),
    ("        return next_action\n", "", "draws-again"),
    ("self.q[next_state, next_action]", "self.q[next_state].max()", "max-target"),
]
ANY_OF_ALL = "return rng.integers(len(values))"
OF_FUNCTION = [
    ("    if rng", "    values -= values.max()\n    if rng", "changes-values"),
    ("values == values.max()", "np.arange(len(values)) == values.argmax()", "first-of-ties"),
    ("rng.random() < epsilon", "rng.random() > epsilon", "epsilon-swapped"),
    (ANY_OF_ALL, "return rng.choice(np.delete(np.arange(len(values)), values.argmax()))", "explores-others"),
    (
        ANY_OF_ALL,
        "return rng.choice([a for a, v in enumerate(values) if v < max(values)] or range(4))",
        "explores-others",
    ),
]
