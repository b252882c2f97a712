"""Loops and branches: while, scan, cond."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from jaxrl_tab.lanes.arrays import (
    SMALL,
    Array,
    Known,
    Parts,
    Plain,
    Stored,
    flat,
    is_small,
    like,
    made_by,
    made_of,
    size_of,
)
from jaxrl_tab.lanes.code import Value
from jaxrl_tab.lanes.lowering import Lowering
from jaxrl_tab.lanes.registry import rule
from jaxrl_tab.lanes.rules.indexing import clamped
from jaxrl_tab.lanes.rules.numbers import word_of

TURN = 3  # numbers that a turn of a loop counts as, besides its own
WRITTEN_OUT = 128  # numbers at most of a loop that is written turn after turn
FEW = 24  # equations of a branch that is worked out where it is not taken, too


@rule("while", of_parts=True)
def while_(code: Lowering, equation: Any, *args: Array) -> list[Array]:
    p = equation.params
    of_condition, of_body, first = _split(code.as_in_memory(args), p["cond_nconsts"], p["body_nconsts"])
    return code.while_loop(
        first,
        lambda carried: code.closed(p["cond_jaxpr"], *of_condition, *carried)[0].item(0),
        lambda carried: code.closed(p["body_jaxpr"], *of_body, *carried),
    )


@rule("scan", of_parts=True)
def scan(code: Lowering, equation: Any, *args: Array) -> list[Array]:
    p = equation.params
    of_consts, count = _counts(p)
    length, closed = p["length"], p["jaxpr"]
    # Of a single turn XLA makes no loop.
    consts, first, rows = _split(args if length == 1 else code.as_in_memory(args), of_consts, count)
    stacked = [_stack(code, length, v.aval) for v in closed.jaxpr.outvars[count:]]

    def turn(carried: list[Any]) -> list[Array]:
        i = carried[0].item(0)
        at = code.op("sub", np.int32, code.const(length - 1, np.int32), i) if p["reverse"] else i
        after = code.closed(closed, *consts, *carried[1 : 1 + count], *(_row(code, x, at) for x in rows))
        filled = zip(flat(carried[1 + count :]), flat(after[count:]), strict=True)
        new = like(stacked, [_put(code, x, y, at) for x, y in filled])
        return [made_of(code, (), np.int32, [code.plus(i, 1)]), *after[:count], *new]

    def goes_on(carried: list[Any]) -> Value:
        return code.op("lt", bool, carried[0].item(0), code.const(length, np.int32))

    carried = [code.known(np.int32(0)), *first, *stacked]
    if length * (_numbers(closed.jaxpr) + TURN) > WRITTEN_OUT:
        return code.while_loop(carried, goes_on, turn)[1:]
    for _ in range(length):
        carried = turn(carried)
        if length > 1:
            carried = like(carried, [code.in_memory(x) for x in flat(code.as_in_memory(carried))])
    return carried[1:]


@rule("cond", of_parts=True)
def cond(code: Lowering, equation: Any, which: Plain, *args: Array) -> Sequence[Array]:
    """Several branches, of which each is a loop of one turn at most: lanes that take another one write nothing.

    Short branches are all worked out, and one of their results is chosen. A short one among long ones is worked
    out for all lanes, and the others replace what it gives.
    """
    branches, number = equation.params["branches"], which.item(0)
    number = code.op("convert", np.int32, number) if number.dtype == bool else number
    number = clamped(code, number, len(branches) - 1)
    if number.op == "const":
        return code.closed(branches[int(number.number)], *args)
    if all(_is_short(branch.jaxpr) for branch in branches):
        return _chosen(code, number, [code.closed(branch, *args) for branch in branches])
    places: dict[int, int] = {}
    if short := next((branch for branch in branches if _is_short(branch.jaxpr)), None):
        results = code.closed(short, *args)
    else:
        places = _places(branches)
        results = [
            args[places[k]] if k in places else _empty(code, v.aval.shape, v.aval)
            for k, v in enumerate(equation.outvars)
        ]
    in_place = [k for k in places if not is_small(equation.outvars[k].aval.shape)]
    for case, branch in enumerate(branches):
        if branch is short or _gives_back(branch, places):
            continue
        taken = code.op("eq", bool, number, code.const(case, np.int32))

        def once(carried: list[Array], branch: Any = branch) -> list[Array]:
            own = list(args)
            for k in in_place:
                own[places[k]] = carried[1 + k]
            return [code.known(np.bool_(False)), *code.closed(branch, *own)]

        first = [made_of(code, (), bool, [taken]), *results]
        results = code.while_loop(first, lambda carried: carried[0].item(0), once)[1:]
    return results


def _is_short(jaxpr: Any) -> bool:
    """Whether a branch may as well be worked out where it is not taken: few equations, no loops, no large results."""
    return _equations(jaxpr) <= FEW and all(is_small(v.aval.shape) for v in jaxpr.outvars)


def _equations(jaxpr: Any) -> float:
    """How many equations there are, also in what is called; infinity where one is a loop, or gives a large array."""
    return _count(jaxpr, lambda sizes: 1 if max(sizes, default=0) <= SMALL else math.inf)


def _numbers(jaxpr: Any) -> float:
    """How many numbers the equations give, if they give few; a large array counts as one, and a loop as infinity."""
    return _count(jaxpr, lambda sizes: sum(n if n <= SMALL else 1 for n in sizes))


def _count(jaxpr: Any, of_one: Callable[[list[int]], float]) -> float:
    """What the equations add up to, also in what is called: each by the sizes of its results; a loop is infinity."""
    count = 0.0
    for equation in jaxpr.eqns:
        if equation.primitive.name in ("while", "scan", "cond"):
            return math.inf
        inner = [p.jaxpr if hasattr(p, "jaxpr") else p for p in equation.params.values()]
        count += of_one([size_of(v.aval.shape) for v in equation.outvars])
        count += sum(_count(p, of_one) for p in inner if hasattr(p, "eqns"))
    return count


def _chosen(code: Lowering, number: Value, cases: Sequence[Sequence[Array]]) -> list[Array]:
    """The results of the case of a number."""
    flat_cases = [flat(case) for case in cases]

    def choose(*xs: Plain) -> Plain:
        def at(i: Value) -> Value:
            chosen = xs[0].read(i)
            for k, x in enumerate(xs[1:], 1):
                is_it = code.op("eq", bool, number, code.const(k, np.int32))
                chosen = code.choice(is_it, chosen, x.read(i))
            return chosen

        return made_by(code, xs[0].shape, xs[0].dtype, at)

    return like(cases[0], [choose(*xs) for xs in zip(*flat_cases, strict=True)])


def _places(branches: Sequence[Any]) -> dict[int, int]:
    """result -> the argument that it is where a branch gives that back, or, if large, in whose memory it lies."""
    places: dict[int, int] = {}
    for gives_back in (True, False):
        for branch in branches:
            for k, v in enumerate(branch.jaxpr.outvars):
                for j, argument in enumerate(branch.jaxpr.invars):
                    alike = v is argument if gives_back else str(v.aval) == str(argument.aval)
                    free = is_small(v.aval.shape) or j not in places.values()
                    if alike and (gives_back or not is_small(v.aval.shape)) and k not in places and free:
                        places[k] = j
    return places


def _gives_back(branch: Any, places: dict[int, int]) -> bool:
    """Whether a branch gives back its arguments, where the results lie already."""
    invars = branch.jaxpr.invars
    return all(k in places and v is invars[places[k]] for k, v in enumerate(branch.jaxpr.outvars))


def _counts(params: Mapping[str, Any]) -> tuple[int, int]:
    """How many of the arguments of a scan are the same in each turn, and how many after them it carries."""
    if "num_consts" in params:  # JAX 0.10
        return params["num_consts"], params["num_carry"]
    consts, carried, _ = params["ft_in"].unpack()
    return len(consts), len(carried)


def _split(xs: Sequence[Any], *counts: int) -> list[list[Any]]:
    """The first so many, the next so many, and the rest."""
    ends = [0, *np.cumsum(counts), len(xs)]
    return [list(xs[a:b]) for a, b in pairwise(ends)]


def _empty(code: Lowering, shape: Sequence[int], aval: Any) -> Array:
    """An array that is written before it is read."""
    dtype, count = word_of(aval)
    if is_small(shape):
        words: list[Plain] = [Known(np.zeros(shape, dtype), code)] * count
    else:
        words = [code.empty(shape, dtype) for _ in range(count)]
    return words[0] if count == 1 else Parts(tuple(words))


def _stack(code: Lowering, length: int, aval: Any) -> Array:
    """Memory for the rows that a scan gives."""
    dtype, count = word_of(aval)
    words = [code.empty((length, *aval.shape), dtype) for _ in range(count)]
    return words[0] if count == 1 else Parts(tuple(words))


def _row(code: Lowering, x: Array, i: Value) -> Array:
    """`x[i]`; i is in range."""
    if isinstance(x, Parts):
        return Parts(tuple(_plain_row(code, part, i) for part in x.arrays))
    return _plain_row(code, x, i)


def _plain_row(code: Lowering, x: Plain, i: Value) -> Plain:
    shape = x.shape[1:]
    first = code.times(i, size_of(shape))
    return made_by(code, shape, x.dtype, lambda k: x.read(_sum(code, first, k)), [x])


def _put(code: Lowering, x: Plain, y: Plain, i: Value) -> Stored:
    """`x` with `x[i] = y`; i is in range."""
    to, size = code.to_change(x), size_of(y.shape)
    first = code.times(i, size)
    if is_small(y.shape):
        for k in range(size):
            code.store(to.buffer, code.plus(first, k), y.item(k))
    else:
        code.each(size, lambda k: code.store(to.buffer, _sum(code, first, k), y.read(k)))
    return to


def _sum(code: Lowering, i: Value, k: Value) -> Value:
    return code.plus(i, int(k.number)) if k.op == "const" else code.op("add", np.int32, i, k)
