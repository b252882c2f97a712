"""Has every call within jaxrl_tab checked against its annotations, by jaxtyping and beartype.

Of a function that is called hundreds of times, one call of `one_of` is checked: more of them with `pytest --slow`.
Those of the lane compiler are called millions of times; only `pytest --slow` looks at them then.

Many tests give bad values on purpose. An annotation that excludes a value is right where the function refuses it
by itself, with an InputError or a RunError: then that error is raised, as it is without this. Everything else
is a wrong annotation, or a wrong call, and an error.
"""

import ast
import dataclasses
import functools
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType
from typing import Any, NoReturn, Self, get_args, get_type_hints

import jax
import jaxtyping
import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype
from beartype.door import die_if_unbearable
from beartype.roar import BeartypeCallHintParamViolation


class WrongArgument(BeartypeCallHintParamViolation):
    """An argument is not what its annotation says.

    Attributes:
        called: whether the function has been called nevertheless, to see whether it refuses the argument itself.
    """

    called = False


OFTEN = 500  # calls of a function, each of which is checked; after them one of so many:
one_of = 64
lets_go = True  # whether no call of a function of the lane compiler is looked at from then on
DIMENSIONS = jaxtyping.jaxtyped("context")  # in which the name of a dimension stands for one size


@functools.cache
def _rules(number: Any) -> BeartypeConf:
    """What beartype is told; `number` is what a float may be."""
    from jaxrl_tab.core.types import Algorithm

    return BeartypeConf(
        # Python cannot say whether a class, without an instance, has the properties that a protocol wants.
        hint_overrides=FrozenDict({float: number, complex: complex | number, type[Algorithm]: type}),
        is_random=False,  # in which items of a container are looked at
        violation_param_type=WrongArgument,
    )


def checked(definition: Any) -> Any:
    """The function, or the dataclass, with its calls checked. The import hook decorates all of them with it."""
    if inspect.isclass(definition):
        if "__dataclass_fields__" in vars(definition):
            definition.__init__ = _and_fields(definition)
        return definition
    if not definition.__annotations__:
        return definition
    strict, calls = None, 0

    @functools.wraps(definition)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal strict, calls
        calls += 1
        if calls == OFTEN and lets_go and definition.__module__.startswith("jaxrl_tab.lanes."):
            _let_go(call, definition)
        if calls > OFTEN and calls % one_of:
            return definition(*args, **kwargs)
        strict = strict or _strict_of(definition)  # made in the first call: then all that it names exists
        try:
            return strict(*args, __beartype_func=definition, **kwargs)
        except WrongArgument as violation:
            _refuse(violation, lambda: definition(*args, **kwargs))
        except ValueError as error:
            if "integer string conversion" not in str(error):
                raise
            return definition(*args, **kwargs)  # a number too long for the message of beartype

    @functools.wraps(definition)
    def generate(*args: Any, **kwargs: Any) -> Any:
        try:
            return (yield from _strict_of(definition)(*args, __beartype_func=definition, **kwargs))
        except WrongArgument as violation:
            _refuse(violation, lambda: next(definition(*args, **kwargs)))

    return generate if inspect.isgeneratorfunction(definition) else call


def _let_go(call: Any, definition: Any) -> None:
    """Puts the function in the place of the one that checks its calls, wherever that stands under a name."""
    *parents, _ = definition.__qualname__.split(".")
    if "<locals>" in parents:
        return
    of_package = [module for name, module in sys.modules.items() if name.startswith("jaxrl_tab.lanes.")]
    for place in [*of_package, functools.reduce(getattr, parents, sys.modules[definition.__module__])]:
        for name in [name for name, value in vars(place).items() if value is call]:
            setattr(place, name, definition)


_strict: dict[tuple[str, CodeType], Callable] = {}


def _strict_of(definition: Any) -> Callable:
    """What checks the calls of a function, which it takes as `__beartype_func`.

    A function within a function is a new one in each call of that; what checks it is made once, for that is slow.
    """
    key = definition.__module__, definition.__code__
    if key not in _strict:
        definition.__annotations__ = _hints(definition)
        _strict[key] = _make_strict(definition)
    return _strict[key]


def _make_strict(definition: Any) -> Callable:
    strict = beartype(conf=_rules(float | int | np.number))(definition)
    if strict is definition:  # there is nothing to check
        return lambda *args, __beartype_func, **kwargs: __beartype_func(*args, **kwargs)
    if not any(map(_of_arrays, definition.__annotations__.values())):
        return strict

    def with_dimensions(*args: Any, **kwargs: Any) -> Any:
        with DIMENSIONS:
            return strict(*args, **kwargs)

    return strict if inspect.isgeneratorfunction(definition) else with_dimensions


def _of_arrays(hint: Any) -> bool:
    """Whether jaxtyping checks it, or a part of it."""
    return getattr(hint, "__module__", "").startswith("jaxtyping") or any(map(_of_arrays, get_args(hint)))


def _refuse(violation: WrongArgument, call: Callable[[], Any]) -> NoReturn:
    """Raises the error of a function that was called with a wrong argument: its own, where it refuses that."""
    from jaxrl_tab.core.errors import InputError, RunError

    if not violation.called:
        violation.called = True
        try:
            call()
        except (InputError, RunError):
            raise
        except Exception as error:
            raise violation from error
    raise violation


def _and_fields(cls: Any) -> Callable:
    """Its `__init__`, which then checks what the fields hold: some take more than that, and convert it."""
    init = cls.__init__

    @functools.cache
    def fields() -> tuple[dict[str, Any], BeartypeConf]:
        hints = _hints(cls)
        # A leaf that is a number may be one of each run of a batch.
        rules = _rules(float | int | np.number | np.ndarray | jax.Array)
        return {field.name: hints[field.name] for field in dataclasses.fields(cls)}, rules

    @functools.wraps(init)
    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        init(self, *args, **kwargs)
        if type(self) is cls:
            hints, rules = fields()
            with DIMENSIONS:
                for name, hint in hints.items():
                    die_if_unbearable(getattr(self, name), hint, conf=rules)

    return __init__


def _hints(definition: Any) -> dict[str, Any]:
    """What its annotations mean, name by name; also those that a module imports only `if TYPE_CHECKING:`."""
    module = sys.modules[definition.__module__]
    try:
        hints = get_type_hints(definition, vars(module), include_extras=True)
    except NameError:
        names = vars(module) | _imported_for_types(definition.__module__)
        hints = get_type_hints(definition, names, include_extras=True)
    if Self in hints.values():
        cls = functools.reduce(getattr, definition.__qualname__.split(".")[:-1], module)
        hints = {name: cls if hint is Self else hint for name, hint in hints.items()}
    return hints


@functools.cache
def _imported_for_types(module: str) -> dict[str, Any]:
    variables = vars(sys.modules[module])
    names: dict[str, Any] = {}
    for block in ast.parse(Path(variables["__file__"]).read_text()).body:
        if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING":
            for statement in block.body:
                try:
                    exec(ast.unparse(statement), dict(variables), names)
                except ImportError as error:  # a name that its module, too, has for types alone
                    names |= _imported_for_types(str(error.name))
    return names


def check() -> None:
    """From now on modules of jaxrl_tab are checked as they are imported."""
    own = jaxtyping.jaxtyped
    jaxtyping.jaxtyped = lambda *args, typechecker=None: own(*args) if args else typechecker
    jaxtyping.install_import_hook("jaxrl_tab", "annotations.checked")
