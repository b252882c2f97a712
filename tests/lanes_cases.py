"""For each primitive that has a rule, functions and arguments that try it at the edges."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

EDGES = {
    np.float32: [
        0, -0.0, 0.5, -0.5, 1, -1, 1.5, 2.5, -2.5, 3, 7.25, 1e-3, 1e-5, 0.49999997, 88.9, -104, 2**23 + 1, -(2**31),
        2**31, 2**32, 3e9, -3e9, 1e20, -1e20, 3.4e38, np.inf, -np.inf, np.nan, 1.2e-38, 1e-40, -1e-40,
    ],
    np.int32: [
        0, 1, -1, 2, -2, 3, 5, 7, -7, 31, 32, 33, 64, -33, 100, 46341, 2**30, 2**31 - 1, -(2**31), 1 - 2**31,
    ],
    np.uint32: [
        0, 1, 2, 3, 5, 7, 31, 32, 33, 64, 100, 65535, 65536, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - 2, 2**32 - 1,
    ],
    np.bool_: [False, True],
}  # fmt: skip
F32, I32, U32, BOOL = np.float32, np.int32, np.uint32, np.bool_


def pairs(*dtypes):
    """Every edge of each dtype with every edge of the others, and some random numbers: one array for each."""
    grid = np.meshgrid(*(np.array(EDGES[dtype], dtype) for dtype in dtypes))
    rng = np.random.default_rng(0)
    return [
        np.concatenate([x.ravel(), numbers(rng, dtype, 64)]) for x, dtype in zip(grid, dtypes, strict=True)
    ]


def numbers(rng, dtype, *shape):
    if dtype == np.float32:
        return (rng.normal(size=shape) * 10.0 ** rng.integers(-3, 4, shape)).astype(dtype)
    info = np.iinfo(dtype) if dtype != np.bool_ else None
    return (
        rng.integers(0, 2, shape).astype(bool)
        if info is None
        else rng.integers(info.min, info.max, shape, dtype)
    )


def arrays(dtype, *shape, lanes=40, seed=0):
    """An array of edges and random numbers for each lane."""
    rng = np.random.default_rng(seed)
    x = numbers(rng, dtype, lanes, *shape)
    at = rng.random(x.shape) < 0.4
    x[at] = rng.choice(np.array(EDGES[dtype], dtype), at.sum())
    return x


def small(dtype, *shape, lanes=40, seed=0):
    """Numbers that an order of sums can be seen in."""
    rng = np.random.default_rng(seed)
    if dtype == np.float32:
        return rng.normal(size=(lanes, *shape)).astype(dtype)
    return rng.integers(0 if dtype == np.uint32 else -9, 9, (lanes, *shape)).astype(dtype)


def index(lanes=40, *shape):
    """Indices in range, out of range, and far out of range."""
    rng = np.random.default_rng(1)
    x = rng.integers(-12, 60, (lanes, *shape)).astype(np.int32)
    x[::7] = np.resize([2**31 - 1, -(2**31), -1], x[::7].shape)
    return x


def each(primitive, *kinds):
    """Number by number: at all the edges; and for one number with an array that is small, and one that is large."""
    cases = [(primitive, *pairs(*dtypes)) for dtypes in kinds]
    dtypes = kinds[0]
    for shape in ((3,), (5, 9)):
        xs = [arrays(dtype, *shape, seed=k) for k, dtype in enumerate(dtypes)]
        cases.append((primitive, *xs))
    return cases


ONE, WHOLE, ANY = [(F32,)], [(I32,), (U32,)], [(F32,), (I32,), (U32,)]
TWO, WHOLE_TWO, ANY_TWO = [(F32, F32)], [(I32, I32), (U32, U32)], [(F32, F32), (I32, I32), (U32, U32)]
WITH_BOOL = [*ANY_TWO, (BOOL, BOOL)]
BITS_TWO = [*WHOLE_TWO, (BOOL, BOOL)]
SMALL, LARGE = (5,), (50,)  # taken apart, and in memory
FEW = 16  # lanes: where there are more than 4096 numbers, XLA sums them in another order


def both(function, dtype=F32):
    """A function of an array that is small, of one that is large."""
    return [(function, arrays(dtype, *SMALL)), (function, arrays(dtype, *LARGE))]


def row_of_each_turn(i):
    """Of a known table and of one in memory, the same in all lanes; then a row of each lane's own."""
    known, bools = jnp.arange(60.0).reshape(20, 3), jnp.arange(60).reshape(20, 3) % 4 > 1

    def turn(k, total):
        return total + jnp.where(
            lax.dynamic_slice(bools, (k, 0), (1, 3)), lax.dynamic_slice(known, (k, 0), (1, 3)), k
        )

    return lax.fori_loop(0, 20, turn, jnp.zeros((1, 3))) * lax.dynamic_slice(known, (i, 0), (1, 3))


CASES = {
    # number by number
    "add": each(lax.add, *ANY_TWO),
    "sub": each(lax.sub, *ANY_TWO),
    "mul": each(lax.mul, *ANY_TWO),
    "div": each(lax.div, *ANY_TWO),
    "rem": each(lax.rem, *ANY_TWO),
    "max": each(lax.max, *WITH_BOOL),
    "min": each(lax.min, *WITH_BOOL),
    "sin": each(lax.sin, *ONE),
    "cos": each(lax.cos, *ONE),
    "pow": each(lax.pow, *TWO, (F32, I32)),
    "eq": each(lax.eq, *WITH_BOOL),
    "ne": each(lax.ne, *WITH_BOOL),
    "lt": each(lax.lt, *WITH_BOOL),
    "le": each(lax.le, *WITH_BOOL),
    "gt": each(lax.gt, *WITH_BOOL),
    "ge": each(lax.ge, *WITH_BOOL),
    "and": each(lax.bitwise_and, *BITS_TWO),
    "or": each(lax.bitwise_or, *BITS_TWO),
    "xor": each(lax.bitwise_xor, *BITS_TWO),
    "not": each(lax.bitwise_not, (I32,), (U32,), (BOOL,)),
    "shift_left": each(lax.shift_left, *WHOLE_TWO),
    "shift_right_logical": each(lax.shift_right_logical, *WHOLE_TWO),
    "shift_right_arithmetic": each(lax.shift_right_arithmetic, *WHOLE_TWO),
    "neg": each(lax.neg, *ANY),
    "abs": each(lax.abs, (F32,), (I32,)),
    "sign": each(lax.sign, *ANY),
    "floor": each(lax.floor, *ONE),
    "ceil": each(lax.ceil, *ONE),
    "round": each(partial(lax.round, rounding_method=lax.RoundingMethod.TO_NEAREST_EVEN), *ONE)
    + each(partial(lax.round, rounding_method=lax.RoundingMethod.AWAY_FROM_ZERO), *ONE),
    "sqrt": each(lax.sqrt, *ONE),
    "square": each(lax.square, *ANY),
    "integer_pow": [
        (partial(lax.integer_pow, y=y), *pairs(dtype))
        for y in (0, 1, 2, 3, 5, 7, -1, -3)
        for dtype in (F32, I32)
        if y >= 0 or dtype == F32
    ],
    "is_finite": each(lax.is_finite, *ONE),
    "exp": each(lax.exp, *ONE),
    "exp2": each(lax.exp2, *ONE),
    "expm1": each(lax.expm1, *ONE),
    "log": each(lax.log, *ONE),
    "log1p": each(lax.log1p, *ONE),
    "tanh": each(lax.tanh, *ONE),
    "logistic": each(lax.logistic, *ONE),
    "erf": each(lax.erf, *ONE),
    "erf_inv": each(lax.erf_inv, *ONE),
    "population_count": each(lax.population_count, *WHOLE),
    "clz": each(lax.clz, *WHOLE),
    "convert_element_type": [
        (partial(lax.convert_element_type, new_dtype=to), *pairs(dtype))
        for dtype in EDGES
        for to in EDGES
        if to != dtype
    ],
    "bitcast_convert_type": [
        (partial(lax.bitcast_convert_type, new_dtype=to), *pairs(dtype))
        for dtype in (F32, I32, U32)
        for to in (I32, U32)
    ]
    + [(partial(lax.bitcast_convert_type, new_dtype=F32), small(I32))],
    "select_n": each(lax.select_n, (BOOL, F32, F32), (BOOL, I32, I32), (BOOL, BOOL, BOOL))
    + [(lax.select_n, arrays(I32), small(F32), small(F32, seed=1), small(F32, seed=2))]
    + [
        (lax.select_n, arrays(BOOL), arrays(F32, *shape), arrays(F32, *shape, seed=1))
        for shape in (SMALL, LARGE)
    ],
    "clamp": [
        (lax.clamp, *pairs(F32, F32, F32)),
        (lax.clamp, *pairs(I32, I32, I32)),
        (lax.clamp, *pairs(U32, U32, U32)),
        (lax.clamp, arrays(F32), arrays(F32, *LARGE), arrays(F32, seed=2)),
    ],
    "complex": [(lambda x, y: lax.real(lax.complex(x, y)), arrays(F32), arrays(F32, seed=1))],
    "real": [(lambda x, y: lax.real(lax.complex(x, y)[1:]), arrays(F32, 5), arrays(F32, 5, seed=1))],
    "imag": [(lambda x, y: lax.imag(lax.complex(x, y)[1:]), arrays(F32, 50), arrays(F32, 50, seed=1))],
    # places
    "reshape": both(lambda x: x.reshape(-1, 5).reshape(5, -1) + 1),
    "squeeze": both(lambda x: lax.squeeze(x[None, :, None], (0, 2))),
    "copy": both(lambda x: lax.copy_p.bind(x)),
    "stop_gradient": both(lax.stop_gradient),
    "optimization_barrier": both(lax.optimization_barrier),
    "broadcast_in_dim": both(lambda x: lax.broadcast_in_dim(x, (4, len(x), 3), (1,)))
    + both(lambda x: x[:, None] + jnp.arange(3.0)[None]),
    "tile": both(lambda x: jnp.tile(x.reshape(5, -1), (2, 3))),
    "slice": [
        *both(lambda x: lax.slice(x.reshape(5, -1), (1, 0), (4, 1))),
        (lambda x: lax.slice(x, (1, 2), (9, 12), (3, 2)), arrays(F32, 9, 13)),
    ],
    "transpose": [
        *both(lambda x: x.reshape(5, -1).T),
        (lambda x: lax.transpose(x, (2, 0, 1)), arrays(I32, 3, 4, 5)),
    ],
    "rev": [
        *both(lambda x: lax.rev(x.reshape(5, -1), (0,))),
        (lambda x: lax.rev(x, (0, 2)), arrays(BOOL, 3, 4, 5)),
    ],
    "empty": both(lambda x: lax.dynamic_update_slice(lax.empty(x.shape, F32), x, (0,))),
    "iota": [
        *both(lambda x: x + lax.iota(F32, len(x))),
        (lambda x: x + lax.broadcasted_iota(I32, (6, 7), 1), arrays(I32)),
    ],
    "concatenate": [
        *both(lambda x: lax.concatenate([x, x[:3], x * 2], 0)),
        (lambda x, y: lax.concatenate([x, y], 1), arrays(F32, 3, 7), arrays(F32, 3, 8, seed=1)),
    ],
    "stack": both(lambda x: jnp.stack([x, -x], 1)),
    "split": [
        *both(lambda x: lax.split(x, (2, len(x) - 2))),
        (lambda x: lax.split(x, (2, 5), 1), arrays(F32, 6, 7)),
    ],
    "unstack": both(lambda x: tuple(jnp.unstack(x.reshape(5, -1), axis=0))),
    "pad": [
        *both(lambda x: lax.pad(x, x[0] + 1, [(2, 3, 1)])),
        (lambda x: lax.pad(x, F32(7), [(-1, 2, 0), (1, -2, 2)]), arrays(F32, 6, 9)),
    ],
    # indexing
    "dynamic_slice": [
        (lambda x, i: lax.dynamic_slice(x, (i,), (3,)), arrays(F32, *shape), i)
        for shape in (SMALL, LARGE)
        for i in (index(), index().astype(U32))
    ]
    + [
        (
            lambda x, i, sizes=sizes: lax.dynamic_slice(x, (i[0], i[1]), sizes),
            arrays(F32, 9, 11),
            index(40, 2),
        )
        for sizes in ((1, 1), (1, 4), (3, 2), (2, 11), (7, 6), (9, 11))
    ]
    + [(lambda i, n=n: lax.dynamic_slice(jnp.arange(60.0), (i,), (n,)), index()) for n in (1, 2, 40)]
    + [(row_of_each_turn, index())],
    "dynamic_update_slice": [
        (lambda x, y, i: lax.dynamic_update_slice(x, y, (i,)), arrays(F32, *shape), arrays(F32, 3, seed=1), i)
        for shape in (SMALL, LARGE)
        for i in (index(), index().astype(U32))
    ]
    + [
        (
            lambda x, y, i: lax.dynamic_update_slice(x, y, (i[0], i[1])),
            arrays(I32, 9, 11),
            arrays(I32, *sizes),
            index(40, 2),
        )
        for sizes in ((1, 1), (3, 2), (7, 6), (9, 11))
    ],
    "gather": [
        (lambda x, i, mode=mode: x.at[i].get(mode=mode), arrays(dtype, *shape), i)
        for shape in (SMALL, LARGE)
        for i in (index(), index(40, 4))
        for mode in ("clip", "fill")
        for dtype in (F32, I32)
    ]
    + [(lambda x, i: x[i], arrays(dtype, 50), index(40, 3)) for dtype in (U32, BOOL)]
    + [(lambda x, i: x[i[0], i[1]], arrays(F32, 6, 9), index(40, 2))]
    + [
        (lambda x, i: x[:, i[1]], arrays(F32, 6, 9), index(40, 2)),
        (lambda x, i: x[i], arrays(F32, 6, 9), index()),
    ]
    + [(lambda x, i: jnp.take_along_axis(x, i, 1), arrays(F32, 6, 9), index(40, 6, 2))]
    + [
        (lambda i: jnp.arange(70.0)[i], index(40, 50)),
        (lambda x, i: x.at[i].get(mode="promise_in_bounds"), arrays(F32, 50), abs(index()) % 50),
    ],
    "sort": [(lax.sort, arrays(dtype, 7)) for dtype in (F32, I32, U32, BOOL)]
    + [(lambda x: jnp.sort(x, axis=0, descending=True), arrays(F32, 5, 3)), (jnp.argsort, small(I32, 12))]
    + [(lambda x, y: lax.sort((x, y, x + y), num_keys=2), small(I32, 9), arrays(F32, 9))],
}
for name in ("scatter", "scatter-add", "scatter-sub", "scatter-mul", "scatter-max", "scatter-min"):
    method = {"scatter": "set", "scatter-sub": "subtract", "scatter-mul": "multiply"}.get(name, name[8:])
    CASES[name] = [
        (
            lambda x, i, y, method=method, mode=mode: getattr(x.at[i], method)(y, mode=mode),
            arrays(dtype, *shape),
            i,
            arrays(dtype, *i.shape[1:], seed=1),
        )
        for shape in (SMALL, LARGE)
        for i in (index(), index(40, 4), index(40, 40) % 9)
        for mode in ("clip", "drop")
        for dtype in (F32, I32)
    ] + [
        (
            lambda x, i, y, method=method: getattr(x.at[i[0], i[1]], method)(y),
            arrays(F32, 6, 9),
            index(40, 2),
            arrays(F32),
        ),
        (
            lambda x, i, y, method=method: getattr(x.at[i], method)(y),
            arrays(F32, 6, 9),
            index(),
            arrays(F32, 9, seed=1),
        ),
    ]
for name in ("sum", "prod", "max", "min", "and", "or", "xor"):
    bitwise = name in ("and", "or", "xor")
    reduce = getattr(lax, f"reduce_{name}")
    CASES[f"reduce_{name}"] = [
        (
            partial(reduce, axes=axes),
            arrays(dtype, *shape, lanes=FEW)
            if bitwise or name in ("max", "min")
            else small(dtype, *shape, lanes=FEW),
        )
        for dtype in ((I32, U32, BOOL) if bitwise else (F32, I32, U32))
        for shape, axes in (
            ((5,), (0,)),
            ((3, 4), (0,)),
            ((3, 4), (0, 1)),
            ((50,), (0,)),
            ((6, 9), (1,)),
            ((40, 3), (0,)),
        )
    ]
for name in ("argmax", "argmin"):
    find = getattr(lax, name)
    CASES[name] = [
        (lambda x, find=find, axis=axis: find(x, axis, I32), arrays(dtype, *shape))
        for dtype in (F32, I32, U32, BOOL)
        for shape, axis in (((5,), 0), ((3, 4), 1), ((50,), 0), ((40, 3), 0))
    ] + [(lambda x, find=find: find(x, 0, I32), np.sign(small(F32, 9)))]
for name in ("cumsum", "cumprod", "cummax", "cummin"):
    run = getattr(lax, name)
    CASES[name] = [
        (
            lambda x, run=run, axis=axis, reverse=reverse: run(x, axis, reverse),
            small(dtype, *shape, lanes=FEW),
        )
        for dtype in (F32, I32)
        for shape, axis in (((5,), 0), ((3, 4), 1), ((30,), 0), ((6, 9), 0), ((70,), 0))
        for reverse in (False, True)
    ]
CASES["dot_general"] = [
    (jnp.dot, small(dtype, *x), small(dtype, *y, seed=1))
    for dtype in (F32, I32)
    for x, y in (((2,), (2,)), ((4,), (4,)), ((4,), (4, 3)), ((3, 4), (4,)), ((2, 3), (3, 2)))
]
CASES["top_k"] = [
    (lambda x: lax.top_k(x, 3), arrays(dtype, *shape))
    for dtype in (F32, I32, U32)
    for shape in ((7,), (4, 5))
]
CASES["add_any"] = [
    (lambda x: jax.grad(lambda x: x[0] * x[1] + x[2] ** 2 + x[0] ** 3)(x), np.round(small(F32, 4) * 8))
]
CASES["div"] += [  # by what is the same in all lanes
    (lambda s: lax.fori_loop(0, 7, lambda k, x: x / (k + 1.5), s), small(F32)),
    (lambda s: lax.fori_loop(1, 7, lambda k, x: x + (s - x) / k, s * 2), small(F32)),
    (lambda s: lax.fori_loop(0, 7, lambda k, x: x + (k + 1.0) / s, s), small(F32)),
]
CASES["reduce_sum"] += [(lambda x: x / x.sum(1, keepdims=True), small(F32, 9, 6, lanes=FEW))]
for name in ("eq_to", "lt_to", "le_to"):
    compare = getattr(lax, f"{name}_p")
    CASES[name] = [(compare.bind, *pairs(dtype, dtype)) for dtype in (F32, I32, U32)]
CASES["div"] += [
    (lambda x: x / 3, small(F32)),  # XLA multiplies by the reciprocal of what it uses more than once
    (lambda x: x / np.arange(1, 6, dtype=F32), small(F32, 5)),
    (lambda x, y: x / y, small(F32, 5), small(F32, seed=1)),
    (lambda x, y: x / y, small(F32, 40), small(F32, seed=1)),
    (lambda x: x / x[:, 1:2], small(F32, 4, 6)),
    (lambda x: x / jnp.broadcast_to(x[:, 1:2], (9, 6)), small(F32, 9, 6)),
    (lambda x: 7 / x, small(F32, 4, 6)),
]
CASES["while"] = [
    (
        lambda x, n: lax.while_loop(lambda c: c[0] < n, lambda c: (c[0] + 1, c[1] * 0.5 + c[0]), (0, x)),
        small(F32, *shape),
        small(I32),
    )
    for shape in ((), SMALL, LARGE)
]
CASES["scan"] = [
    (
        lambda x, reverse=reverse: lax.scan(lambda c, y: (c * 0.5 + y, (c, y > 0)), x[0], x, reverse=reverse),
        small(F32, *shape),
    )
    for shape in ((4,), (40,), (7, 9), (3, 40))
    for reverse in (False, True)
]
CASES["cond"] = [
    (lambda i, x: lax.cond(i > 3, lambda x: x * 2, lambda x: x + 1, x), small(I32), small(F32, *shape))
    for shape in ((), SMALL, LARGE)
] + [
    (lambda i, x: lax.cond(i > 3, lambda x: x.at[2].set(0.0), lambda x: x, x), small(I32), small(F32, 50)),
    (
        lambda i, x: (x[2], lax.cond(i > 3, lambda x: x.at[2].set(0.0), lambda x: x.at[i].add(1.0), x), x),
        small(I32),
        small(F32, 50),
    ),
    (
        lambda i, x: lax.switch(i, [lambda x: x + 1, lambda x: x * 2, lambda x: jnp.sum(x) + x], x),
        small(I32),
        small(F32, 40),
    ),
    (
        lambda i, x: lax.switch(
            i, [lambda x: x + 1, lambda x: lax.fori_loop(0, i, lambda k, x: x + k, x), lambda x: x], x
        ),
        small(I32),
        small(F32),
    ),
]
KEYS = small(U32, 2)
CASES |= {
    "random_wrap": [(lambda k: jax.random.key_data(jax.random.wrap_key_data(k)), KEYS)],
    "random_unwrap": [
        (lambda k: jax.random.key_data(jax.random.split(jax.random.wrap_key_data(k), (2, 3))[1]), KEYS)
    ],
    "random_seed": [(lambda i: jax.random.key_data(jax.random.key(i)), index())],
    "random_bits": [
        (lambda k, shape=shape: jax.random.bits(jax.random.wrap_key_data(k), shape), KEYS)
        for shape in ((), (3,), (50,))
    ]
    + [(lambda k: jax.vmap(jax.random.bits)(jax.random.split(jax.random.wrap_key_data(k), 3)), KEYS)],
    "random_split": [
        (lambda k: [jax.random.bits(x) for x in jax.random.split(jax.random.wrap_key_data(k), 3)], KEYS)
    ],
    "random_fold_in": [
        (lambda k, i: jax.random.key_data(jax.random.fold_in(jax.random.wrap_key_data(k), i)), KEYS, index())
    ],
    "threefry2x32": [(lambda k: jax.random.uniform(jax.random.wrap_key_data(k), (3, 4)), KEYS)],
    "iota_2x32_shape": [(lambda k: jax.random.normal(jax.random.wrap_key_data(k), (50,)), KEYS)],
}
