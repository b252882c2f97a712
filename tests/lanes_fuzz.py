"""Random JAX functions of one lane: arithmetic, any index, writes, loops of any length, branches.

Real numbers are whole eighths of moderate size after each step: so sums and products are exact, and it does not
matter in which order XLA adds or whether it rounds a product and a sum at once. But for `learning`, where that does
matter: what it gives are the bits of its numbers.
"""

import random
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxrl_tab.core import linear, tables

SHAPES = {"f": (), "i": (), "u": (), "b": (), "fs": (5,), "fl": (40,), "is": (6,), "il": (40,), "fm": (6, 7)}
DTYPES = {"f": np.float32, "i": np.int32, "u": np.uint32, "b": np.bool_}
WHOLE = [lax.add, lax.sub, lax.mul, lax.div, lax.rem, lax.max, lax.min, lax.bitwise_xor, lax.bitwise_and]
WHOLE += [lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic]
FEWEST = 3  # statements of a body


def inputs(rng: np.random.Generator, lanes: int) -> dict[str, np.ndarray]:
    """One array of each kind, with numbers at the edges among them."""
    found = {}
    for kind, shape in SHAPES.items():
        size = (lanes, *shape)
        if kind[0] == "f":
            x = rng.integers(-80, 80, size).astype(np.float32) / 8
            edges = rng.choice(np.array([np.nan, np.inf, -np.inf, 0, -0.0, 3e9, -3e9], np.float32), size)
            found[kind] = np.where(rng.random(size) < 0.05, edges, x)
        elif kind == "b":
            found[kind] = rng.integers(0, 2, size).astype(bool)
        else:
            info = np.iinfo(DTYPES[kind[0]])
            x = rng.integers(max(info.min, -50), 90, size)
            edges = rng.choice(np.array([info.min, info.max, info.max - 1, 0, 1, max(info.min, -1)]), size)
            found[kind] = np.where(rng.random(size) < 0.1, edges, x).astype(DTYPES[kind[0]])
    return found


class Program:
    """The statements of one function, chosen while it is traced: always the same for the same seed."""

    def __init__(self, seed: int):
        self.random = random.Random(seed)

    def run(self, variables: list[tuple[str, Any]], statements: int, depth: int) -> list[tuple[str, Any]]:
        """The variables after some more statements."""
        variables = list(variables)
        for _ in range(statements):
            variables.append(self.statement(variables, depth))
        return variables

    def pick(self, variables: list[tuple[str, Any]], kind: str) -> Any:
        """A variable of some kind, rather a late one."""
        of_kind = [x for k, x in variables if k == kind]
        return of_kind[max(self.random.randrange(len(of_kind)) for _ in range(2))]

    def statement(self, variables: list[tuple[str, Any]], depth: int) -> tuple[str, Any]:
        rules: list[Callable[..., tuple[str, Any]]] = [
            self.arithmetic,
            self.arithmetic,
            self.whole,
            self.comparison,
            self.choice,
            self.conversion,
            self.reading,
            self.reading,
            self.writing,
            self.writing,
            self.writing,
            self.slicing,
            self.reduction,
            self.moving,
            self.learning,
        ]
        if depth:
            loops = [self.counted, self.waiting, self.stacking, self.branch, self.several]
            if self.random.random() < 0.3:
                return self.random.choice(loops)(variables, depth - 1)
        return self.random.choice(rules)(lambda kind: self.pick(variables, kind))

    # --- single statements; `x` picks a variable of a kind

    def arithmetic(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(["f", "f", "fs", "fl", "fm"])
        y = self.random.choice([kind, "f"])
        function = self.random.choice([jnp.add, jnp.subtract, jnp.multiply, jnp.maximum, jnp.minimum])
        z = function(x(kind), x(y))
        return kind, jnp.floor(jnp.clip(z, -999.0, 999.0) * 8) / 8

    def whole(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(["i", "i", "u", "is", "il"])
        function = self.random.choice(WHOLE)
        return kind, function(x(kind), x(kind))

    def comparison(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(["f", "i", "u", "b"])
        function = self.random.choice([lax.eq, lax.ne, lax.lt, lax.le, lax.gt, lax.ge])
        return "b", function(x(kind), x(kind))

    def choice(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(list(SHAPES))
        return kind, jnp.where(x("b"), x(kind), x(kind))

    def conversion(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        before, after = self.random.choice(["fi", "fu", "if", "ui", "iu", "bi", "bf", "ib"])
        y = lax.convert_element_type(x(before), DTYPES[after])
        return after, jnp.clip(y, -999, 999) if after == "f" else y

    def reading(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(["fs", "fl", "il", "is"])
        array = x(kind).at[x("i")]
        mode = self.random.choice(["clip", "fill", "promise_in_bounds"])
        if self.random.random() < 0.3:
            array = x(kind).at[x("il")]  # many at once
            many = array.get(mode="clip")
            return ("fl", many) if kind[0] == "f" else ("il", many)
        return kind[0], array.get(mode=mode)

    def writing(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(["fs", "fl", "fl", "il", "is", "fm"])
        mode = self.random.choice(["clip", "drop"])
        name = self.random.choice(["set", "set", "max", "min"] + ["add"] * (kind[0] == "i"))
        if kind == "fm":
            return kind, getattr(x(kind).at[x("i"), x("i")], name)(x("f"), mode=mode)
        if self.random.random() < 0.2:
            many = self.random.choice(["is", "il"])
            new = x("il")[: SHAPES[many][0]] if kind[0] == "i" else x("fl")[: SHAPES[many][0]]
            return kind, getattr(x(kind).at[x(many)], name)(new, mode=mode)
        return kind, getattr(x(kind).at[x("i")], name)(x(kind[0]), mode=mode)

    def slicing(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        index = x(self.random.choice(["i", "u"]))
        if self.random.random() < 0.5:
            return "fs", lax.dynamic_slice(x("fl"), (index,), (5,))
        if self.random.random() < 0.3:
            return "fm", lax.dynamic_update_slice(x("fm"), x("fs")[None], (index, jnp.ones_like(index)))
        return "fl", lax.dynamic_update_slice(x("fl"), x("fs"), (index,))

    def reduction(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        kind = self.random.choice(["fs", "fl", "il", "is"])
        name = self.random.choice(["max", "min", "argmax", "argmin"] + ["sum"] * (kind[0] == "i"))
        if name.startswith("arg"):
            return "i", getattr(lax, name)(x(kind), 0, np.int32)
        return kind[0], getattr(jnp, name)(x(kind))

    def moving(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        moves: list[tuple[str, Callable[[], Any]]] = [
            ("fl", lambda: lax.rev(x("fl"), (0,))),
            ("fl", lambda: jnp.concatenate([x("fl")[5:], x("fs")])),
            ("il", lambda: jnp.cumsum(x("il"))),
            ("fl", lambda: lax.cummax(x("fl"))),
            ("fs", lambda: jnp.sort(x("fs"))),
            ("fs", lambda: x("fl")[3:40:8]),
            ("fm", lambda: x("fl").reshape(5, 8)[:, :7][jnp.array([0, 4, 1, 1, 2, 3])]),
            ("fl", lambda: jnp.broadcast_to(x("f"), (40,))),
            ("fs", lambda: x("fm").T[2][:5]),
            ("is", lambda: jnp.stack([x("i") for _ in range(6)])),
        ]
        kind, move = self.random.choice(moves)
        return kind, move()

    def learning(self, x: Callable[[str], Any]) -> tuple[str, Any]:
        """What methods with features do: several updates of a few weights each, by products that must be rounded."""
        plain = lambda z: jnp.where(jnp.abs(z) < 999, z, 0.1)
        ones = jnp.abs(x("is")[: self.random.choice([1, 2, 3])] % 40)
        turns = self.random.choice([2, jnp.abs(x("i") % 4)])
        alpha, targets = 0.037 * plain(x("f")), plain(x("fs"))
        w = tables.lane_by_lane(_learned, plain(x("fl"))[:, None], ones, alpha, targets, jnp.int32(turns))[
            :, 0
        ]
        sums = linear.total(w[:5] * targets)
        w = w.at[0].set(sums)
        plain_zeros = jnp.where(
            (w == 0) | ~(jnp.abs(w) < 1e9), 0.0, w
        )  # one zero, and no NaN: their bits are free
        return "il", lax.bitcast_convert_type(plain_zeros, np.int32)

    # --- loops and branches

    def carried(self, variables: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
        kinds = self.random.sample(list(SHAPES), self.random.randint(1, 4))
        return [(kind, self.pick(variables, kind)) for kind in kinds]

    def body(
        self, variables: list[tuple[str, Any]], own: list[tuple[str, Any]], depth: int, seed: int
    ) -> list[tuple[str, Any]]:
        """What a body makes of its own variables; it reads those around it, too."""
        program = Program(seed)
        after = program.run([*variables, *own], FEWEST + program.random.randrange(3), depth)
        return [(kind, program.pick(after, kind)) for kind, _ in own]

    def one_of(self, kinds: list[str], values: Any) -> tuple[str, Any]:
        k = self.random.randrange(len(kinds))
        return kinds[k], values[k]

    def counted(self, variables: list[tuple[str, Any]], depth: int) -> tuple[str, Any]:
        first, seed = self.carried(variables), self.random.random()
        kinds = [kind for kind, _ in first]
        turns = self.random.choice([3, lax.rem(self.pick(variables, "i"), np.int32(5))])

        def turn(k: Any, values: Any) -> Any:
            own = list(zip(kinds, values, strict=True))
            return [x for _, x in self.body([*variables, ("i", k)], own, depth, hash(seed))]

        return self.one_of(kinds, lax.fori_loop(0, turns, turn, [x for _, x in first]))

    def waiting(self, variables: list[tuple[str, Any]], depth: int) -> tuple[str, Any]:
        first, seed = [("b", self.pick(variables, "b")), *self.carried(variables)], self.random.random()
        first = [first[0], *(pair for pair in first[1:] if pair[0] != "b")]
        kinds = [kind for kind, _ in first]

        def goes_on(state: Any) -> Any:
            return (state[0] < 6) & state[1]

        def turn(state: Any) -> Any:
            own = list(zip(kinds, state[1:], strict=True))
            after = self.body([*variables, ("i", state[0])], own, depth, hash(seed))
            return [state[0] + 1, *(x for _, x in after)]

        return self.one_of(kinds, lax.while_loop(goes_on, turn, [jnp.int32(0), *(x for _, x in first)])[1:])

    def stacking(self, variables: list[tuple[str, Any]], depth: int) -> tuple[str, Any]:
        first, seed = self.carried(variables), self.random.random()
        kinds = [kind for kind, _ in first]
        reverse, rows = self.random.random() < 0.5, self.pick(variables, "is")

        def turn(values: Any, i: Any) -> Any:
            own = list(zip(kinds, values, strict=True))
            after = self.body([*variables, ("i", i)], own, depth, hash(seed))
            return [x for _, x in after], [x for _, x in own]

        last, stacked = lax.scan(turn, [x for _, x in first], rows, reverse=reverse)
        kind, x = self.one_of(kinds, stacked)
        return self.one_of([kind, *kinds], [x[4], *last])

    def branch(self, variables: list[tuple[str, Any]], depth: int) -> tuple[str, Any]:
        return self.branches(variables, depth, self.pick(variables, "b"), 2)

    def several(self, variables: list[tuple[str, Any]], depth: int) -> tuple[str, Any]:
        return self.branches(variables, depth, self.pick(variables, "i"), 3)

    def branches(
        self, variables: list[tuple[str, Any]], depth: int, which: Any, count: int
    ) -> tuple[str, Any]:
        first, seeds = self.carried(variables), [self.random.random() for _ in range(count)]
        kinds = [kind for kind, _ in first]

        def case(seed: float) -> Callable[[Any], Any]:
            def run(values: Any) -> Any:
                own = list(zip(kinds, values, strict=True))
                return [x for _, x in self.body(variables, own, depth, hash(seed))] if seed > 0.2 else values

            return run

        values = [x for _, x in first]
        if count == 2:
            return self.one_of(kinds, lax.cond(which, case(seeds[0]), case(seeds[1]), values))
        return self.one_of(kinds, lax.switch(which, [case(seed) for seed in seeds], values))


def _learned(lane: Any, w: Any, ones: Any, alpha: Any, targets: Any, turns: Any) -> Any:
    only = jnp.int32(0)

    def update(i: Any, w: Any) -> Any:
        x = linear.Active(tables.entry(ones, lane))
        error = tables.entry(targets, lane, i) - linear.entry(w, x, only, lane)
        return linear.add(w, x, only, tables.entry(alpha, lane) * error, lane)

    return lax.fori_loop(jnp.int32(0), tables.entry(turns, lane), update, w)


def function(seed: int, statements: int = 8, depth: int = 2) -> Callable[..., list[Any]]:
    """A random function of one variable of each kind; it gives the last variable of each."""

    def run(*args: Any) -> list[Any]:
        variables = Program(seed).run(list(zip(SHAPES, args, strict=True)), statements, depth)
        return [[x for k, x in variables if k == kind][-1] for kind in SHAPES]

    return run
