"""What a benchmark is made of, and how it is measured: in turn, round after round.

Speed drifts with the load and the clock of the machine, so the parties of a task run in turn, round after
round, and what counts is the ratio within a round. Flags, devices and threads are settled when a process
starts, so each library, on each number of cores, has its own process, which is kept waiting while the others
run.
"""

import contextlib
import importlib
import itertools
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np


class Timing(NamedTuple):
    """One round of one party.

    Attributes:
        seconds: time from the call to the results, compilation apart; where it is compilation that is
            measured, what the party says.
        outcomes: a number for each lane that tells what it learned, [lanes]; None where there is none.
    """

    seconds: float
    outcomes: np.ndarray | None = None


Round = Callable[[int], Timing]  # runs all lanes once, with random numbers named by a whole number


def warm(run: Round) -> Round:
    """A round that follows another one at once, which is not measured.

    For what takes a millisecond: after others have had their turns, the caches of the processor hold what is theirs.
    """

    def second(seed: int) -> Timing:
        run(seed + 2**16)
        return run(seed)

    return second


class Party(NamedTuple):
    """Who does a task, and how.

    Attributes:
        name: as the table shows it.
        library: parties of one library share a process.
        call: "module:function", which compiles, and gives a Round.
        arguments: of the call, by name.
    """

    name: str
    library: str
    call: str
    arguments: Mapping[str, Any]


class Target(NamedTuple):
    """What a party is compared with: the ratio of their speeds within a round, party / against.

    Attributes:
        party, against: their names; against None its own seconds are judged, as a time.
        least, aim: the ratio to reach, and the one to hope for; None: none was set.
        times: it is the ratio of their times, and `least` and `aim` are those to stay under.
    """

    party: str
    against: str | None
    least: float | None = None
    aim: float | None = None
    times: bool = False


class Task(NamedTuple):
    """What all its parties do, in turn.

    Attributes:
        name: as the table shows it.
        cores: how many each party may use.
        work, unit: how much each party does in a round, and of what; a speed is so many units a second.
        parties: in the order in which they take turns.
        targets: what is compared with what.
        outcome: what the outcomes are, on which all parties must agree; None where they need not.
    """

    name: str
    cores: int
    work: float
    unit: str
    parties: tuple[Party, ...]
    targets: tuple[Target, ...]
    outcome: str | None = None


class Record(NamedTuple):
    """One round of one party of one task.

    Attributes:
        mean, variance, lanes: of the outcomes; None where there are none.
    """

    task: str
    cores: int
    round: int
    party: str
    seconds: float
    mean: float | None = None
    variance: float | None = None
    lanes: int | None = None


def measure(tasks: Sequence[Task], rounds: int, progress: Callable[[str], None]) -> Iterator[Record]:
    """The records of all tasks, in the order in which they run. `progress` hears what is going on."""
    progress("compiling")
    processes: dict[tuple[str, int], _Process] = {}
    turns: list[tuple[Task, Party, _Process]] = []
    for task in tasks:
        for party in task.parties:
            if (key := (party.library, task.cores)) not in processes:
                processes[key] = _Process(task.cores)
            turns.append((task, party, processes[key]))
    for task, party, process in turns:  # all processes compile at the same time
        process.tell("prepare", (task.name, party.name), party.call, party.arguments)
    for _, _, process in turns:
        process.answer()

    for task, group in itertools.groupby(turns, key=lambda turn: turn[0]):
        parties = list(group)
        progress(f"{task.name}, {cores_in_words(task.cores)}")
        for number in range(rounds):
            for _, party, process in parties:
                process.tell("run", (task.name, party.name), number)
                yield _record(task, number, party, process.answer())


def cores_in_words(count: int) -> str:
    return f"{count} core{'s' if count > 1 else ''}"


def _record(task: Task, number: int, party: Party, timing: Timing) -> Record:
    record = Record(task.name, task.cores, number, party.name, timing.seconds)
    if (x := timing.outcomes) is None:
        return record
    return record._replace(mean=float(x.mean(dtype=float)), variance=float(x.var(dtype=float)), lanes=len(x))


def fresh(call: str, cores: int, **arguments: Any) -> Any:
    """What "module:function" returns in a process of its own, on so many cores."""
    process = _Process(cores)
    process.tell("call", call, arguments)
    return process.answer()


class _Process:
    """A process that does as it is told. It ends when nobody holds this any more."""

    def __init__(self, cores: int):
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        context.Process(target=_serve, args=(theirs, cores), daemon=True).start()
        theirs.close()  # so that a process that died is noticed

    def tell(self, *order: Any) -> None:
        self.pipe.send(order)

    def answer(self) -> Any:
        try:
            return self.pipe.recv()
        except EOFError:
            raise SystemExit("a process of the benchmark died; what it said is above") from None


def _serve(pipe: Connection, cores: int) -> None:
    """Compiles, runs rounds and calls functions, until nobody asks any more."""
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])  # before JAX and Numba start threads
    prepared: dict[tuple[str, str], Round] = {}  # by the names of task and party

    def prepare(name: tuple[str, str], function: str, arguments: Mapping[str, Any]) -> None:
        prepared[name] = call(function, arguments)

    def run(name: tuple[str, str], number: int) -> Timing:
        return prepared[name](number)

    def call(path: str, arguments: Mapping[str, Any]) -> Any:
        module, _, function = path.partition(":")
        return getattr(importlib.import_module(module), function)(**arguments)

    orders = {"prepare": prepare, "run": run, "call": call}
    with contextlib.suppress(EOFError):
        while True:
            order, *what = pipe.recv()
            pipe.send(orders[order](*what))
