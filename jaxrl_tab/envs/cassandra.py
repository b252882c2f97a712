"""Cassandra's format of MDPs and POMDPs, .MDP and .POMDP (Cassandra 1999, pomdp.org: "POMDP file format").

A POMDP is read as its MDP, whose state is seen: of observations only their part in rewards is left, which are averaged
over them. All forms are read: names or numbers, `*`, `uniform`, `identity`, `reset`, vectors and matrices.
"""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxrl_tab.core.errors import InputError, nearest, shown
from jaxrl_tab.envs.listed import Listed
from jaxrl_tab.exact.model import spread

ENDINGS = (".mdp", ".pomdp")  # of the names of such files, in any case
SETS = ("states", "actions", "observations")
STATEMENTS = ("discount", "values", *SETS, "start", "T", "O", "R")


class Read(NamedTuple):
    """What a file says.

    Attributes:
        outcomes: what may happen.
        start: the distribution of the start state, float64 [S].
        is_terminal: the states that every action leads back to with reward 0, and in which nobody starts; bool [S].
        discount: its discount rate; None where it has none.
    """

    outcomes: Listed
    start: np.ndarray
    is_terminal: np.ndarray
    discount: float | None


def is_name(path: str) -> bool:
    """Whether a file of this name is of this format."""
    return path.lower().endswith(ENDINGS)


def read(path: str, data: bytes) -> Read:
    """What the file with this content says. Raises InputError, which names the line, where it is of no such format."""
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text, and files whose names end so are texts") from None
    return _Reader(path, text).result()


class _Given(NamedTuple):
    """A statement about rewards: of which action, state, next state and observation; None stands for all."""

    where: tuple[int | None, ...]
    value: Any


class _Reader:
    """Reads a text from its first word to its last."""

    def __init__(self, path: str, text: str):
        self._path = path
        self._words = [
            (word, number)
            for number, line in enumerate(text.splitlines(), 1)
            for word in re.findall(r":|[^\s:]+", line.partition("#")[0])
        ]
        self._at = 0
        self._index: dict[str, dict[str, int]] = {}
        self._size: dict[str, int] = {}
        self._discount, self._sign = None, 1.0
        self._start: np.ndarray | None = None
        self._next: dict[tuple[int, int], dict[int, float]] = {}  # (s, a) -> s' -> probability
        self._seen: dict[tuple[int, int], np.ndarray] = {}  # (s', a) -> probability of each observation
        self._rewards: list[_Given] = []
        self._line: dict[tuple[int, int], int] = {}  # (s, a) -> where its successors were last given
        while self._at < len(self._words):
            self._statement()

    # --- words ---------------------------------------------------------------------------------------
    def _error(self, problem: str, at: int | None = None) -> InputError:
        at = min(self._at if at is None else at, len(self._words) - 1)
        line = self._words[at][1] if self._words else 1
        return InputError(f"{self._path}, line {line}: {problem}")

    def _peek(self) -> str:
        """The next word; empty at the end."""
        return self._words[self._at][0] if self._at < len(self._words) else ""

    def _take(self, wanted: str = "") -> str:
        word = self._peek()
        if not word or (wanted and word != wanted):
            raise self._error(
                f"{shown(wanted) if wanted else 'a word'} is missing"
                + (f" before {shown(word)}" if word else " at the end")
            )
        self._at += 1
        return word

    def _is_statement(self) -> bool:
        """Whether a statement begins here, or the text ends."""
        following = self._words[self._at + 1][0] if self._at + 1 < len(self._words) else ""
        word = self._peek()
        return (
            not word
            or (word in STATEMENTS and following == ":")
            or (word == "start" and following in ("include", "exclude"))
        )

    def _number(self) -> float:
        word = self._take()
        try:
            number = float(word)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise self._error(f"{shown(word)} is not a number", self._at - 1)
        return number

    def _numbers(self, count: int) -> np.ndarray:
        begin = self._at
        numbers = []
        while len(numbers) < count and not self._is_statement():
            numbers.append(self._number())
        if len(numbers) < count or not self._is_statement():
            more = "" if len(numbers) < count else " or more"
            have = len(numbers) + (1 if more else 0)
            raise self._error(f"{count} numbers are wanted here, and there are {have}{more}", begin)
        return np.array(numbers)

    def _entry(self, what: str) -> int | None:
        """The number of a state, an action or an observation; None for all of them."""
        if what not in self._size:
            raise self._error(f"{what} must be said before they are used")
        word, names = self._take(), self._index[what]
        if word == "*":
            return None
        if word in names:
            return names[word]
        if word.isdecimal() and int(word) < self._size[what]:
            return int(word)
        hint = nearest(word, names) if names else f"they are 0 to {self._size[what] - 1}"
        raise self._error(f"{shown(word)} is none of the {what}; {hint}", self._at - 1)

    def _entries(self, *sets: str) -> list[int | None]:
        """What is named after "T", ": a : s : s'", as far as it goes."""
        found: list[int | None] = []
        while len(found) < len(sets) and self._peek() == ":":
            self._take(":")
            found.append(self._entry(sets[len(found)]))
        if not found:
            self._take(":")
        if self._peek() == ":":
            raise self._error(f"there are more than {len(sets)} entries, of {', '.join(sets)}")
        return found

    def _all(self, what: str, entry: int | None) -> range:
        return range(self._size[what]) if entry is None else range(entry, entry + 1)

    # --- statements ----------------------------------------------------------------------------------
    def _statement(self) -> None:
        if not self._is_statement():
            raise self._error(
                f"a statement is wanted, such as 'T: action : state', and not {shown(self._peek())}"
            )
        kind = self._take()
        if kind in SETS:
            self._set(kind)
        else:
            getattr(self, f"_read_{kind}")()

    def _read_discount(self) -> None:
        self._take(":")
        self._discount = self._number()
        if not 0 <= self._discount <= 1:
            raise self._error(f"discount must be from 0 to 1, not {self._discount:g}", self._at - 1)

    def _read_values(self) -> None:
        self._take(":")
        word = self._take()
        if word not in ("reward", "cost"):
            raise self._error(f"values are 'reward' or 'cost', not {shown(word)}", self._at - 1)
        self._sign = -1.0 if word == "cost" else 1.0

    def _set(self, what: str) -> None:
        begin = self._at
        self._take(":")
        words = []
        while not self._is_statement():
            words.append(self._take())
        count = int(words[0]) if len(words) == 1 and words[0].isdecimal() else len(words)
        if not count:
            raise self._error(f"there are no {what}", begin)
        names = [] if len(words) == 1 and words[0].isdecimal() else words
        if len(set(names)) < len(names):
            twice = next(name for i, name in enumerate(names) if name in names[:i])
            raise self._error(f"{shown(twice)} is there twice among the {what}", begin)
        self._size[what], self._index[what] = count, {name: i for i, name in enumerate(names)}

    def _read_start(self) -> None:
        how = self._take() if self._peek() in ("include", "exclude") else ""
        self._take(":")
        if "states" not in self._size:
            raise self._error("states must be said before start")
        n = self._size["states"]
        begin, one = self._at, np.eye(n)
        if how or self._peek() in self._index["states"]:
            chosen = np.zeros(n, bool)
            while not self._is_statement():
                entry = self._entry("states")
                chosen[slice(None) if entry is None else entry] = True
            chosen = ~chosen if how == "exclude" else chosen
            if not chosen.any() or (not how and chosen.sum() > 1):
                raise self._error("start is one state, or the probability of each", begin)
            self._start = chosen / chosen.sum()
        elif self._peek() == "uniform":
            self._take()
            self._start = np.full(n, 1 / n)
        else:
            words = [self._take() for _ in iter(self._is_statement, True)]
            self._at = begin
            is_one = len(words) == 1 and words[0].isdecimal()
            self._start = one[self._entry("states")] if is_one else self._numbers(n)
            self._check_distribution(self._start, "the probabilities of the start states", begin)

    def _read_T(self) -> None:
        begin = self._at
        action, *rest = self._entries("actions", "states", "states")
        n, line = self._size["states"], self._words[begin][1]
        state = rest[0] if rest else None
        if len(rest) == 2:
            prob = self._number()
            rows = {s: dict.fromkeys(self._all("states", rest[1]), prob) for s in self._all("states", state)}
        else:
            rows = dict(self._rows(state, is_matrix=not rest, columns=n))
        for a in self._all("actions", action):
            for s, row in rows.items():
                self._next[s, a] = self._next.get((s, a), {}) | row if len(rest) == 2 else dict(row)
                self._line[s, a] = line

    def _rows(
        self, state: int | None, is_matrix: bool, columns: int
    ) -> Iterator[tuple[int, dict[int, float]]]:
        """The probabilities of what may follow on each state: a keyword, a vector, or a matrix."""
        n, word, begin = self._size["states"], self._peek(), self._at
        if word == "uniform":
            self._take()
            matrix = np.full((n, columns), 1 / columns)
        elif word == "identity" and is_matrix:
            self._take()
            matrix = np.eye(n)
        elif word == "reset":
            self._take()
            start = np.full(n, 1 / n) if self._start is None else self._start
            matrix = np.tile(start, (n, 1))
        elif is_matrix:
            matrix = self._numbers(n * columns).reshape(n, columns)
        else:
            matrix = np.tile(self._numbers(columns), (n, 1))
        for s in self._all("states", state):
            self._check_distribution(matrix[s], "the probabilities", begin)
            yield s, {int(i): float(matrix[s, i]) for i in np.flatnonzero(matrix[s])}

    def _read_O(self) -> None:
        begin = self._at
        action, *rest = self._entries("actions", "states", "observations")
        n, count = self._size["states"], self._size["observations"]
        if len(rest) == 2:
            prob = self._number()
            for key in ((s, a) for s in self._all("states", rest[0]) for a in self._all("actions", action)):
                row = self._seen.setdefault(key, np.zeros(count))
                row[self._all("observations", rest[1])] = prob
            return
        if self._peek() == "uniform":
            self._take()
            matrix = np.full((n, count), 1 / count)
        elif rest:
            matrix = np.tile(self._numbers(count), (n, 1))
        else:
            matrix = self._numbers(n * count).reshape(n, count)
        for s in self._all("states", rest[0] if rest else None):
            self._check_distribution(matrix[s], "the probabilities", begin)
            for a in self._all("actions", action):
                self._seen[s, a] = matrix[s].copy()

    def _read_R(self) -> None:
        sets = ["actions", "states", "states"] + ["observations"] * ("observations" in self._size)
        where = self._entries(*sets)
        # What is not named are the rows and columns of what follows.
        shape = [self._size[what] for what in sets[len(where) :]]
        if len(shape) > 2:
            raise self._error("rewards need a state as well: 'R: action : state'")
        numbers = self._numbers(int(np.prod(shape))).reshape(shape)
        for at, value in np.ndenumerate(numbers):
            full = (*where, *at, None)[:4]
            self._rewards.append(_Given(full, float(value)))

    def _check_distribution(self, prob: np.ndarray, what: str, at: int) -> None:
        if (prob < 0).any() or abs(prob.sum() - 1) > 1e-4:
            raise self._error(f"{what} add up to {prob.sum():.6g}, not to 1", at)

    # --- what it comes to ----------------------------------------------------------------------------
    def result(self) -> Read:
        for what in SETS[:2]:
            if what not in self._size:
                raise InputError(f"{self._path} does not say its {what}")
        n, actions = self._size["states"], self._size["actions"]
        start = np.full(n, 1 / n) if self._start is None else self._start / self._start.sum()
        outcomes = self._outcomes(n, actions)
        outcomes = outcomes._replace(reward=self._sign * self._reward(outcomes))
        stays = (outcomes.s_next == outcomes.row // actions) & (outcomes.reward == 0)
        is_terminal = np.bincount(outcomes.row[~stays] // actions, minlength=n) == 0
        is_terminal &= start == 0
        ends = spread(outcomes.s_next, outcomes.row // actions, is_terminal)
        if (~ends & (start > 0)).any():  # it may go on for ever
            is_terminal[:] = False
        return Read(outcomes, start, is_terminal, self._discount)

    def _outcomes(self, n: int, actions: int) -> Listed:
        """All outcomes, without their rewards. Each row is made to add up to 1, as files print few digits."""
        rows = []
        for key in ((s, a) for s in range(n) for a in range(actions)):
            row = {s: p for s, p in self._next.get(key, {}).items() if p}
            total = sum(row.values())
            if min(row.values(), default=0) < 0 or abs(total - 1) > 1e-4:
                where = f", line {self._line[key]}" if key in self._line else ""
                raise InputError(
                    f"{self._path}{where}: the probabilities of what follows on {self._name('actions', key[1])} in "
                    f"{self._name('states', key[0])} add up to {total:.6g}, not to 1"
                )
            rows.append({s: row[s] / total for s in sorted(row)})
        count = [len(row) for row in rows]
        s_next = np.fromiter((s for row in rows for s in row), int)
        prob = np.fromiter((p for row in rows for p in row.values()), float)
        return Listed(n, actions, np.repeat(np.arange(len(rows)), count), s_next, prob, np.zeros(len(prob)))

    def _name(self, what: str, number: int) -> str:
        """What the file calls a state or an action."""
        return next((name for name, i in self._index[what].items() if i == number), f"{what[:-1]} {number}")

    def _reward(self, outcomes: Listed) -> np.ndarray:
        """The mean reward of each outcome, as the last statement about it has it."""
        n, actions = outcomes.num_states, outcomes.num_actions
        by_seen = any(given.where[3] is not None for given in self._rewards)
        reward = np.zeros((len(outcomes.row), self._size["observations"] if by_seen else 1))
        begin = np.searchsorted(outcomes.row, np.arange(n * actions + 1))
        action = outcomes.row % actions
        for (a, s, s_next, seen), value in self._rewards:
            # Outcomes of one state lie together, and of one state and action, too.
            first, last = (0, n * actions) if s is None else (s * actions, (s + 1) * actions)
            if s is not None and a is not None:
                first, last = s * actions + a, s * actions + a + 1
            part = slice(begin[first], begin[last])
            chosen = np.ones(part.stop - part.start, bool)
            if a is not None:
                chosen &= action[part] == a
            if s_next is not None:
                chosen &= outcomes.s_next[part] == s_next
            reward[part][chosen, slice(None) if seen is None else seen] = value
        if not by_seen:
            return reward[:, 0]
        prob = np.zeros_like(reward)
        for i, key in enumerate(zip(outcomes.s_next.tolist(), action.tolist(), strict=True)):
            prob[i] = self._seen.get(key, 0)
            if abs(prob[i].sum() - 1) > 1e-4:
                where = f"{self._name('actions', key[1])} in {self._name('states', key[0])}"
                raise InputError(
                    f"{self._path}: rewards depend on what is observed, and the probabilities of what is observed "
                    f"after {where} add up to {prob[i].sum():.6g}, not to 1"
                )
        return (prob * reward).sum(1) / prob.sum(1)
