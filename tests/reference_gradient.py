"""The book's boxes of section 2.8 and chapter 13 as plain loops, in float64. See `reference`."""

import numpy as np
from reference import Agent, draw


class Adam:
    """Kingma and Ba 2015, algorithm 1, as an ascent of a table with step size 1."""

    def __init__(self, b1=0.9, b2=0.999, small=1e-8):
        self.b1, self.b2, self.small = b1, b2, small
        self.n, self.m, self.v = 0, 0.0, 0.0

    def step(self, gradient):
        self.n += 1
        self.m = self.b1 * self.m + (1 - self.b1) * gradient
        self.v = self.b2 * self.v + (1 - self.b2) * gradient**2
        return (self.m / (1 - self.b1**self.n)) / (np.sqrt(self.v / (1 - self.b2**self.n)) + self.small)


class Softmax(Agent):
    """Acts by the softmax of its preferences `q`, in which -inf is no action; a method adds `learn`."""

    def __init__(self, shape, rates, gamma, theta0=0.0, optimizer=None):
        super().__init__(shape, rates, gamma)
        self.q = np.full(shape, theta0, float)
        self.power, self.optimizer = 1.0, optimizer

    def pi(self, s):
        weights = [np.exp(x - max(self.q[s])) for x in self.q[s]]
        return np.array(weights) / sum(weights)

    def act(self, s, u):
        return draw(self.pi(s), u)

    def alpha(self, s, a):
        return self.rates.alpha(self.t, self.episode, self.visits[s, a])

    def score(self, s, a):
        """grad ln pi(a | s), in a table of zeros."""
        table = np.zeros(self.q.shape)
        table[s] = -self.pi(s)
        table[s, a] += 1
        return table

    def ascend(self, gradient, alpha):
        self.q += alpha * (gradient if self.optimizer is None else self.optimizer.step(gradient))

    def go_on(self, ended):
        self.power = 1.0 if ended else self.power * self.gamma


class GradientBandit(Softmax):
    """Equation 2.12; every state is a bandit of its own."""

    def __init__(self, *args, baseline=True, **kwargs):
        super().__init__(*args, **kwargs)
        self.baseline, self.rewards = baseline, {}

    def learn(self, s, a, r, s_next, terminal, ended, u):
        before = self.rewards.setdefault(s, [])
        mean = (np.mean(before) if before else r) if self.baseline else 0
        self.ascend((r - mean) * self.score(s, a), self.alpha(s, a))
        before.append(float(r))
        return self.act(s_next, u)


class Reinforce(Softmax):
    """The boxes of sections 13.3 and, with a step size `alpha_v`, 13.4. An optimiser gets the sum of an episode."""

    def __init__(self, *args, alpha_v=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.alpha_v, self.v, self.steps = alpha_v, np.zeros(len(self.q)), []
        self.learned_from = np.zeros(self.q.shape, int)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        self.steps.append((s, a, float(r)))
        if ended:
            rest = 0 if terminal or self.alpha_v is None else self.gamma * self.v[s_next]
            total = np.zeros(self.q.shape)
            for t, (s, a, _) in enumerate(self.steps):
                later = [x for _, _, x in self.steps[t:]]
                g = sum(self.gamma**k * x for k, x in enumerate(later)) + self.gamma ** len(later) * rest
                self.learned_from[s, a] += 1
                if self.alpha_v is not None:
                    g -= self.v[s]
                    self.v[s] += self.alpha_v(self.learned_from[s].sum()) * g
                gradient = self.gamma**t * g * self.score(s, a)
                if self.optimizer is None:
                    self.ascend(gradient, self.rates.alpha(self.t, self.episode, self.learned_from[s, a]))
                total += gradient
            if self.optimizer is not None:
                self.ascend(total, self.rates.alpha(self.t, self.episode, None))
            self.steps = []
        return self.act(s_next, u)


class ActorCritic(Softmax):
    """The boxes of section 13.5: one step; and, with `lam`, eligibility traces."""

    def __init__(self, *args, alpha_v, lam=None, lam_v=None, **kwargs):
        super().__init__(*args, **kwargs)
        self.alpha_v, self.v = alpha_v, np.zeros(len(self.q))
        self.lam, self.lam_v = lam or 0.0, lam_v or 0.0
        self.z, self.z_v = np.zeros(self.q.shape), np.zeros(len(self.q))

    def learn(self, s, a, r, s_next, terminal, ended, u):
        delta = r + (0 if terminal else self.gamma * self.v[s_next]) - self.v[s]
        self.z = self.gamma * self.lam * self.z + self.power * self.score(s, a)
        self.z_v = self.gamma * self.lam_v * self.z_v + np.eye(len(self.v))[s]
        self.v += self.alpha_v(self.visits[s].sum()) * delta * self.z_v
        self.ascend(delta * self.z, self.alpha(s, a))
        self.go_on(ended)
        if ended:
            self.z, self.z_v = np.zeros(self.q.shape), np.zeros(len(self.q))
        return self.act(s_next, u)


class Grouped:
    """An agent that is told the group of each state, and not the state."""

    def __init__(self, agent, groups):
        vars(self).update(agent=agent, groups=groups)

    def __getattr__(self, name):
        return getattr(self.agent, name)

    def __setattr__(self, name, value):
        setattr(self.agent, name, value)

    @property
    def visits(self):
        return Visits(self.agent.visits, self.groups)

    def first_action(self, s, u):
        return self.agent.first_action(self.groups[s], u)

    def learn(self, s, a, r, s_next, terminal, ended, u):
        return self.agent.learn(self.groups[s], a, r, self.groups[s_next], terminal, ended, u)


class Visits:
    """The table of visits, in which a state is counted in its group."""

    def __init__(self, table, groups):
        self.table, self.groups = table, groups

    def __getitem__(self, at):
        return self.table[self.groups[at[0]], at[1]]

    def __setitem__(self, at, n):
        self.table[self.groups[at[0]], at[1]] = n
