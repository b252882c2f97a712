"""A student's code: found in a file, called with care, and its errors told with the line of the file."""

import contextlib
import ctypes
import inspect
import io
import linecache
import random
import re
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from jaxrl_tab.core import modules
from jaxrl_tab.core.errors import InputError, check_choice, listed, nearest, one_line, shown
from jaxrl_tab.course.exercises import EXERCISES
from jaxrl_tab.course.updates import Setting, Step

PATIENCE = 5.0  # seconds that one call may take
TABLES = ("q", "Q", "q_table", "Q_table", "q_values")  # what a table of action values may be called
METHODS = {
    "act": ("state",),
    "update": ("state", "action", "reward", "next_state", "terminated", "truncated"),
}
FUNCTION, FUNCTION_TAKES = "epsilon_greedy", ("values", "epsilon", "rng")


class Unusable(InputError):
    """The file cannot be judged; the message says why, with the line."""


class TookTooLong(BaseException):
    """Raised within a call that does not end; no `except Exception` stops it."""


class Code:
    """What is judged: a class with `act` and `update`, or for the first exercise a function, and how it is called.

    Attributes:
        where: the file as people call it.
        made: the class or the function.
        exercise: the name of the exercise.
    """

    def __init__(self, where: str, made: Any, exercise: str):
        self.where, self.made, self.exercise = where, made, exercise
        self.file = _file_of(made)
        self._busy: tuple[float, str] | None = None  # since when a call runs, and which

    def line(self, of: Any) -> str:
        """ "my_agent.py, line 12" of a function; of the class where it is one, or what that has from elsewhere."""
        if inspect.isfunction(of):
            return f"{self.where}, line {of.__code__.co_firstlineno}"
        begins = re.compile(rf"\s*class {self.made.__name__}\b")
        numbers = [k for k, x in enumerate(linecache.getlines(self.file), 1) if begins.match(x)]
        return f"{self.where}, line {numbers[0]}" if numbers else self.where

    def call(self, what: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Calls a function of the student. Raises Unusable where that fails; `what` is what it is called."""
        self._busy = time.monotonic(), what
        try:
            return function(*args, **kwargs)
        except TookTooLong as error:
            raise Unusable(f"{self._at(error)}, in {what}: {_too_long()}") from None
        except (Exception, SystemExit) as error:
            raise Unusable(f"{self._at(error)}, in {what}: {type(error).__name__}: {_told(error)}") from error
        finally:
            self._busy = None

    def _at(self, error: BaseException) -> str:
        lines = [x.lineno for x in traceback.extract_tb(error.__traceback__) if x.filename == self.file]
        return f"{self.where}, line {lines[-1]}" if lines else self.where

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Stops a call that does not end, lets nothing wait for a person, and shows nothing that is printed."""
        done, thread = threading.Event(), threading.get_ident()

        def watch() -> None:
            while not done.wait(min(0.2, PATIENCE / 4)):
                busy = self._busy
                if busy and time.monotonic() - busy[0] > PATIENCE:
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(
                        ctypes.c_ulong(thread), ctypes.py_object(TookTooLong)
                    )
                    done.wait(PATIENCE)  # it may be caught; then once more

        watcher = threading.Thread(target=watch, daemon=True)
        stdin = sys.stdin
        watcher.start()
        try:
            sys.stdin = io.StringIO()
            with contextlib.redirect_stdout(_Nowhere()), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of numbers that overflow, which the verdict says in its way
                yield
        except TookTooLong as error:
            raise Unusable(f"{self._at(error)}: {_too_long()}") from None
        finally:
            sys.stdin = stdin
            done.set()
            watcher.join()


class _Nowhere(io.TextIOBase):
    def write(self, text: str) -> int:
        return len(text)


def _told(error: BaseException) -> str:
    return one_line(str(error)) or "no more is said"


def _too_long() -> str:
    return f"it has not ended after {PATIENCE:g} seconds"


def _file_of(made: Any) -> str:
    """The file as it stands in tracebacks."""
    codes = [made, *(vars(made).values() if inspect.isclass(made) else ())]
    return next((x.__code__.co_filename for x in codes if inspect.isfunction(x)), "")


# --- finding it --------------------------------------------------------------------------------------


def load(path: Path, exercise: str | None) -> Code:
    """What is judged in a file.

    Raises:
        Unusable: it cannot be read or imported, or it is not clear what is meant.
    """
    if path.is_dir():
        inside = sorted(x.name for x in path.glob("*.py"))
        such = (
            f"a file in it, such as {path / inside[0]}" if inside else "a file; there is none of Python in it"
        )
        raise Unusable(f"{path} is a folder: name {such}")
    if path.suffix != ".py":
        raise Unusable(f"{path} is no file of Python: its name must end in .py")
    file = modules.read(path)
    before = set(sys.modules)
    waiting = Code(path.name, None, "")
    waiting.file = file.path
    waiting._busy = time.monotonic(), "import"
    try:
        with waiting.watched():
            module = modules.load(file)
    except Unusable:
        raise
    except InputError as error:
        raise Unusable(str(error).replace(file.path, path.name)) from error
    finally:
        for name in set(sys.modules) - before:  # the next time it is run anew
            if modules.of_module(name):
                del sys.modules[name]
    return _in_module(module, path.name, exercise)


def _in_module(module: ModuleType, where: str, exercise: str | None) -> Code:
    said = exercise or getattr(module, "exercise", None)
    own = [x for x in vars(module).values() if getattr(x, "__module__", None) == module.__name__]
    classes = [x for x in own if inspect.isclass(x) and (hasattr(x, "act") or hasattr(x, "update"))]
    classes = [x for x in classes if not any(x in other.__mro__[1:] for other in classes)]
    function = vars(module).get(FUNCTION)
    if said is not None:
        _check(said)
    if said == "epsilon-greedy" or (said is None and not classes and function):
        if not inspect.isfunction(function):
            raise Unusable(f"{where} has no function {FUNCTION}({', '.join(FUNCTION_TAKES)})")
        return of(function, "epsilon-greedy", where)
    if said is not None and len(classes) > 1:
        classes = [x for x in classes if _named(x) == said] or classes
    if not classes:
        raise Unusable(
            f"{where} has neither a class with act and update nor a function {FUNCTION}: see the files of the "
            "exercises, which `jaxrl-tab check --hand-out FOLDER` writes"
        )
    if len(classes) > 1:
        raise Unusable(
            f"{where} has several agents, {listed(x.__name__ for x in classes)}: say which exercise is meant, as "
            "in --exercise sarsa, or leave one"
        )
    return of(classes[0], said, where)


def of(made: Any, exercise: str | None = None, where: str = "") -> Code:
    """The class or the function itself, as one has it in a notebook."""
    if inspect.isfunction(made):
        exercise = exercise or "epsilon-greedy"
    elif not inspect.isclass(made):
        raise InputError(f"check takes a file, a class or a function, not {shown(made)}")
    else:
        exercise = exercise or getattr(made, "exercise", None) or _named(made)
    code = Code(where or made.__name__, made, exercise or "")
    if exercise is None:
        raise Unusable(
            f'{code.line(made)}: say which exercise {made.__name__} is for, as in exercise = "sarsa", or --exercise '
            f"sarsa; it is one of {', '.join(EXERCISES)}"
        )
    _check(exercise)
    if (exercise == "epsilon-greedy") != inspect.isfunction(made):
        wanted = "a function" if exercise == "epsilon-greedy" else "a class with act and update"
        raise Unusable(f"{code.line(made)}: the exercise {exercise} wants {wanted}")
    if inspect.isfunction(made):
        _check_arguments(code, made, FUNCTION_TAKES)
        return code
    for name, takes in METHODS.items():
        method = getattr(made, name, None)
        if not callable(method):
            raise Unusable(
                f"{code.line(made)}: {made.__name__} has no method {name}(self, {', '.join(takes)})"
            )
        _check_arguments(code, method, ("self", *takes))
    _arguments(code, EXERCISES[exercise].takes)
    return code


def _check(exercise: Any) -> None:
    check_choice(None, "exercise", exercise, EXERCISES)


def _named(cls: type) -> str | None:
    """The exercise that a class is called after: QLearning, MonteCarloAgent."""
    plain = cls.__name__.lower().replace("_", "").removesuffix("agent").removesuffix("control")
    return next((name for name in EXERCISES if name.replace("-", "") == plain), None)


def _check_arguments(code: Code, function: Any, wanted: tuple[str, ...]) -> None:
    try:
        inspect.signature(function).bind(*wanted)
    except TypeError:
        name = function.__name__
        raise Unusable(
            f"{code.line(function)}: it must be possible to call {name}({', '.join(wanted)})"
        ) from None


def _arguments(code: Code, takes: tuple[str, ...]) -> tuple[str, ...]:
    """What the constructor asks for."""
    given = ("num_states", "num_actions", *takes, "rng")
    init = code.made.__init__
    parameters = list(inspect.signature(code.made).parameters.values())
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return given
    named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    for p in named:
        if p.name not in given and p.default is p.empty:
            hint = nearest(p.name, given, f"there are {', '.join(given)}")
            raise Unusable(
                f"{code.line(init)}: __init__ asks for {p.name}, which this exercise does not have; {hint}"
            )
    return tuple(p.name for p in named if p.name in given)


# --- using it ----------------------------------------------------------------------------------------


class Agent:
    """An agent of the student's class, in the loop that is promised to it: act, update, and on from there.

    Attributes:
        setting: what it was built with.
    """

    def __init__(self, code: Code, setting: Setting, seed: int):
        self.code, self.setting = code, setting
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002  of which a student may draw
        values = setting._asdict() | {"rng": np.random.default_rng(seed)}
        asked = _arguments(code, EXERCISES[code.exercise].takes)
        self.agent = code.call("__init__", code.made, **{name: values[name] for name in asked})
        self.next_action: int | None = None
        self.table = next((name for name in TABLES if hasattr(self.agent, name)), None)
        if self.table is None:
            raise Unusable(
                f"{code.line(code.made.__init__)}: there is no table self.q of the action values, to be read as "
                "q[s, a], q[s][a] or q[(s, a)]"
            )

    def act(self, s: int) -> int:
        """The action that is taken: what the last update returned, or what `act` says."""
        if self.next_action is not None:
            action, self.next_action = self.next_action, None
            return action
        return self._action("act", self.code.call("act", self.agent.act, s))

    def update(self, step: Step) -> int | None:
        """Tells of a step; A', where the agent returns it."""
        returned = self.code.call("update", self.agent.update, *step)
        if returned is None:
            return None
        action = self._action("update", returned)
        self.next_action = None if step.last else action
        return action

    def _action(self, what: str, x: Any) -> int:
        return action_of(self.code, what, x, self.setting.num_actions)

    def q(self) -> np.ndarray:
        """The table of action values, float [S, A]."""
        q = getattr(self.agent, self.table or "")
        size = self.setting.num_states, self.setting.num_actions
        try:
            if isinstance(q, np.ndarray) and q.shape == size:
                return q.astype(float)
            return np.array([[_entry(q, s, a) for a in range(size[1])] for s in range(size[0])], float)
        except (TypeError, ValueError, KeyError, IndexError) as error:
            raise Unusable(
                f"{self.code.line(self.code.made)}: self.{self.table} cannot be read as q[s, a], q[s][a] or q[(s, a)] "
                f"for {size[0]} states and {size[1]} actions: {type(error).__name__}: {_told(error)}"
            ) from None

    @property
    def is_lost(self) -> bool:
        """Whether Q has numbers in it that are infinite, or NaN, by which nobody can act."""
        return not np.isfinite(self.q()).all()

    @property
    def has_whole_numbers(self) -> bool:
        """Whether the table can hold nothing but whole numbers."""
        q = getattr(self.agent, self.table or "")
        return isinstance(q, np.ndarray) and q.dtype.kind in "iub"


def _entry(q: Any, s: int, a: int) -> Any:
    """Q(s, a), whatever it is kept in; what is missing in a dict is what the dict would give, or 0."""
    if not isinstance(q, Mapping):
        return q[s][a]
    if (s, a) in q:
        return q[s, a]
    if s not in q:
        new = getattr(q, "default_factory", None)
        missing = new() if new else 0.0
        return missing if np.ndim(missing) == 0 and not isinstance(missing, Mapping) else _of_row(missing, a)
    return _of_row(q[s], a)


def _of_row(row: Any, a: int) -> Any:
    if isinstance(row, Mapping) and a not in row:
        new = getattr(row, "default_factory", None)
        return new() if new else 0.0
    return row[a]


def action_of(code: Code, what: str, x: Any, num_actions: int) -> int:
    """An action that was returned. Raises Unusable where it is none."""
    if isinstance(x, np.ndarray) and x.size == 1:
        x = x.item()
    if not isinstance(x, int | np.integer) or isinstance(x, bool) or not 0 <= x < num_actions:
        function = code.made if inspect.isfunction(code.made) else getattr(code.made, what)
        hint = "; update returns the action to take next, or nothing" if what == "update" else ""
        raise Unusable(
            f"{code.line(function)}: {what} returned {shown(x)}, where an action is wanted, 0 to {num_actions - 1}"
            f"{hint}"
        )
    return int(x)
