"""How much memory runs take, and so how many are computed at once."""

import functools
import hashlib
import logging
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxrl_tab.core import memory, rng
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.core.types import Algorithm, Environment, FiniteEnvironment, fitted, table_of
from jaxrl_tab.engine import provenance
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.engine.onward import Onward, split, without_table
from jaxrl_tab.engine.traced import gives, in_full, place_of_table, unchecked
from jaxrl_tab.exact import planning

LANES = 64
BLOCKS = 16  # of lanes that a device works through in one call, at most
FEWEST_LANES = (
    8  # on a CPU, where memory runs out: with fewer, what `record` adds up would differ in the last bit
)
OF_A_STEP = 800  # bytes of a run, about: numbers of one step that lie in memory between two loops over lanes
CALL_BYTES = 2**28  # of a call on a device, at most, unless one block alone is larger


class Plan(NamedTuple):
    """Where the memory of a sweep goes.

    Attributes:
        results: where the results of its runs are written.
        room: the bytes that a call may take on each device.
    """

    results: memory.Results
    room: int


class Forecast(NamedTuple):
    """What running some runs of one program will take, known from shapes alone.

    Attributes:
        blocks: how many blocks of runs there are, on all devices together.
        results: the bytes of what the runs give.
        working: the bytes of the largest call, on all devices together.
    """

    blocks: int
    results: int
    working: int


def plan(
    needs: "Sequence[Needs]", runs: int, limit: int | None = None, devices: Sequence[Any] | None = None
) -> Plan:
    """Shares out the memory among results and calls. What does not fit beside a call is written to disk.

    Args:
        needs: what one run of each program needs.
        runs: how many there are of all programs together.
        devices: the JAX devices that compute; all by default.
        limit: the bytes to share out, in the machine and on each device with memory of its own; by default
            half of what is free there.

    Raises:
        InputError: there is not enough memory for a call, or room on the disk; nothing was compiled.
    """
    devices = tuple(devices or jax.local_devices())
    results = results_of(needs)
    least = max(one.call.bytes(_least_lanes(devices), blocks=1) for one in needs)
    machine, device = (memory.free(x) // 2 if limit is None else limit for x in ((), devices))
    needed = runs * memory.size(results)
    if _on_cpu(devices):  # whose memory is the machine's
        on_disk = needed + len(devices) * least > machine
        device = (machine if on_disk else machine - needed) // len(devices)
    else:
        on_disk = needed > machine
    if least > device:
        raise InputError(
            f"{_least_lanes(devices)} runs at a time on each device ({len(devices)}) need "
            f"{memory.words(least * len(devices))}, more than the {memory.words(device * len(devices))} that "
            "they may take: give more memory, or take a larger log_every, or fewer states or features"
        )
    if on_disk:
        folder, free = memory.disk()
        reason = (
            f"the results of {runs} runs need {memory.words(needed)}; "
            f"there is room for {memory.words(machine)} in memory"
        )
        if needed > free:
            raise InputError(
                f"{reason} and {memory.words(free)} in {folder}: take fewer seeds, or a larger log_every"
            )
        logging.getLogger(__name__).warning("%s, so they are kept in files in %s", reason, folder)
    return Plan(memory.Results(results, runs, on_disk), device)


def results_of(needs: "Sequence[Needs]") -> tuple[Any, ...]:
    """The shapes of what the runs of all programs of a part give.

    Their tables may differ where they are weights, of other features: then it is the largest.

    Raises:
        InputError: something else differs.
    """
    tables, others = [one.results[0] for one in needs], [one.results[1:] for one in needs]
    if any(other != others[0] for other in others):
        raise InputError("what record gives must be of the same shape in all runs")
    shape = tuple(np.max([x.shape for x in tables], axis=0).tolist())
    return (jax.ShapeDtypeStruct(shape, tables[0].dtype), *others[0])


def forecast(
    needs: "Needs", runs: int, limit: int | None = None, devices: Sequence[Any] | None = None
) -> Forecast:
    """What so many runs of one program will take; the others as in `plan`. Nothing is compiled."""
    devices = tuple(devices or jax.local_devices())
    room = memory.free(devices) // 2 if limit is None else limit
    lanes, most = width_of_call(needs.call, runs, room // len(devices) if _on_cpu(devices) else room, devices)
    blocks = -(-runs // lanes)
    working = len(devices) * needs.call.bytes(lanes, min(most, -(-blocks // len(devices))))
    return Forecast(blocks, runs * memory.size(needs.results), working)


def _on_cpu(devices: Sequence[Any]) -> bool:
    return devices[0].platform == "cpu"


def _least_lanes(devices: Sequence[Any]) -> int:
    return LANES if _on_cpu(devices) else 1


def width_of_call(call: memory.Call, runs: int, room: int, devices: Sequence[Any]) -> tuple[int, int]:
    """How many lanes go side by side, and how many blocks of them a call takes at most."""
    if _on_cpu(devices):
        fits = [n for n in range(1, BLOCKS + 1) if call.bytes(LANES, n) <= min(room, CALL_BYTES)]
        return LANES, max(fits, default=1)
    lanes = 2 ** (-(-runs // len(devices)) - 1).bit_length()
    while lanes > 1 and call.bytes(lanes, 1) > room:
        lanes //= 2
    return lanes, 1


def smaller_call(call: memory.Call, lanes: int, most: int, devices: Sequence[Any]) -> tuple[int, int]:
    """Half as many blocks of a call, or, where it is one, half as many lanes.

    Raises:
        RunError: it cannot be smaller.
    """
    if most > 1:
        smaller = lanes, most // 2
    elif lanes > (FEWEST_LANES if _on_cpu(devices) else 1):
        smaller = lanes // 2, 1
    else:
        raise RunError(
            f"there is not enough memory for {lanes} runs at a time on each device ({len(devices)}), the "
            f"smallest number possible, which need {memory.words(len(devices) * call.bytes(lanes, 1))}: take a "
            "larger log_every, or a smaller environment"
        )
    logging.getLogger(__name__).warning(
        "out of memory with %d runs at a time, %d times a call; trying again with half", lanes, most
    )
    return smaller


def is_no_memory(error: BaseException) -> bool:
    """Whether an error says that the memory ran out: Python's, or that of XLA."""
    return isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)


def program_arguments(budget: Budget, root: Any, seed: Any, algorithm: Any, env: Any) -> tuple:
    """The arguments of a program; for exact values with the numbers of method and environment in full.

    Where `seed` is None, `root` is the key of the one run.
    """
    full = in_full if budget.exact else lambda _: None
    return jax.random.key_data(root), seed, (algorithm, full(split(algorithm).method)), (env, full(env))


class Signature(NamedTuple):
    """What, beside the budget, makes a program another one.

    Attributes:
        treedef, avals: the arguments.
        settings: of JAX, under which it is traced.
    """

    treedef: Any
    avals: tuple
    settings: tuple

    @property
    def arguments(self) -> Any:
        """The arguments, with the kind of each array in its place."""
        return jax.tree.unflatten(self.treedef, self.avals)

    @property
    def name(self) -> Any:
        """The arguments, as `programs` names them."""
        return jax.tree.unflatten(self.treedef, [f"{x} {x.weak_type}" for x in self.avals])


def signature(args: Any) -> Signature:
    leaves, treedef = jax.tree.flatten(args)
    return Signature(treedef, tuple(jax.typeof(x) for x in leaves), tuple(provenance.settings().values()))


class Needs(NamedTuple):
    """What a run needs of memory.

    Attributes:
        results: the shapes of its table and its Log.
        call: the bytes of a call.
        program: a name of its program, which is another one where the program is.
    """

    results: Any
    call: memory.Call
    program: str


def needs_of(env: Environment, algorithm: Algorithm | Onward, root: jax.Array, budget: Budget) -> Needs:
    """What one run of this method needs of memory. Its hyperparameters are arrays, whose values do not matter."""
    needs = needs_of_program(budget, signature(program_arguments(budget, root, np.uint32(0), algorithm, env)))
    return needs._replace(call=needs.call._replace(shared=needs.call.shared + _tables(env)))


@functools.lru_cache(maxsize=1024)
def needs_of_program(budget: Budget, signature: Signature) -> Needs:
    """The same, but for the tables of the environment's outcomes, whose size is not in the signature."""
    root, seed, algorithm, envs = signature.arguments
    env, _ = envs
    shapes = jax.eval_shape(lambda algorithm, env: gives(algorithm, env, budget), algorithm[0], env)
    results, others, beside = shapes
    call = memory.Call(
        shared=memory.size((root, envs)),
        kept=memory.size((seed, algorithm, results)),
        working=_working(env, budget, memory.size((results, others))) + memory.size(beside),
    )
    program = hashlib.sha256(f"{budget} {signature.treedef} {signature.avals}".encode()).hexdigest()[:16]
    return Needs(results, call, program)


@functools.lru_cache(maxsize=64)
def traced_program(budget: Budget, signature: Signature) -> Any:
    """One run, traced: what `program_arguments` gives -> ((table, Log), state of the learner).

    Of a method that is `Onward` it is ((table, Log, where the run is but for the table), None).
    """

    def one(root, seed, algorithms, envs):
        (algorithm, exact_algorithm), (env, exact_env) = algorithms, envs
        full = (exact_algorithm, exact_env) if budget.exact else None
        key = rng.from_data(root)
        key = key if seed is None else jax.random.fold_in(key, seed)
        end, log = unchecked(key, algorithm, env, full, budget)
        method, _, goes_on = split(algorithm)
        learner, method = end.learner if goes_on else end, fitted(method, env)
        table = table_of(method, env.num_states, learner)
        if not goes_on:
            return (table, log), learner
        return (table, log, without_table(end, place_of_table(method, env, learner))), None

    return jax.jit(one).trace(*signature.arguments)


def _tables(env: Environment) -> int:
    """The bytes of all outcomes of a finite environment, which its step reads from tables."""
    if not isinstance(env, FiniteEnvironment):
        return 0
    model = planning.exact_model(env)  # in float64
    real = jax.dtypes.canonicalize_dtype(float).itemsize
    return real * (model.prob.size + model.reward.size) + model.s_next.nbytes


def _working(env: Environment, budget: Budget, carried: int) -> int:
    """The bytes with which one run works: what its loop carries, random words, and exact values."""
    if budget.num_episodes:  # XLA keeps what lanes carried that have left the loop, and what all carry next
        carried *= 2
    carried += OF_A_STEP
    if not (budget.exact and env.num_states):
        return carried
    # In float64: the matrix [S, S] that is solved, the weights of all outcomes four times, and three tables.
    with planning.doubled():
        weight = jax.eval_shape(planning.enumerate_model, env).prob
    table = weight.dtype.itemsize * env.num_states * env.num_actions
    matrix = weight.dtype.itemsize * env.num_states**2
    if budget.num_steps and budget.num_steps % budget.row:  # a last, shorter row has its own
        matrix *= 2
    return carried + matrix + 4 * memory.size(weight) + 3 * table
