"""Many machines as one `jax.distributed` job, as in pods of accelerators: the same command on all of them."""

import pickle
from collections.abc import Generator, Sequence
from typing import Any, NamedTuple, Self

import jax
import numpy as np
from jax.experimental.multihost_utils import process_allgather

from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.experiment.executors.base import Arrays, Failed, Job, Work, result_of

_SECONDS = 10  # that a process waits for the others at its end, where they do not answer any more


@checked_dataclass
class Distributed:
    """On all processes of a `jax.distributed` job, each on its own devices, one shard each in every round.

    Make it in every process, before anything is computed. Process 0 hands out the shards and has the results;
    the others serve it until it leaves the block:

        with Distributed("10.0.0.1:8476", num_processes=4, process_id=i) as executor:
            if not executor.serve():
                ...  # in process 0: executor.run

    In each round every process gets the results of all, so there must be memory for them. A process that dies
    takes all others with it. What was given until then is there: start the job again, with what is missing.

    Attributes:
        address: Of process 0, "HOST:PORT", where PORT is free. On SLURM, Open MPI, Kubernetes and TPUs JAX
            finds out by itself what is not given here.
        num_processes: How many processes there are.
        process_id: The number of this one, from 0.

    Raises:
        InputError: JAX does not know the cluster.
        RunError: JAX has started already, or the other processes do not answer.
    """

    address: str | None = None
    num_processes: int | None = field(default=None, at_least=1)
    process_id: int | None = field(default=None, at_least=0)

    def __post_init__(self) -> None:
        try:
            jax.distributed.initialize(
                self.address, self.num_processes, self.process_id, shutdown_timeout_seconds=_SECONDS
            )
        except (ValueError, TypeError) as error:
            raise InputError(
                f"distributed: {str(error).splitlines()[0]} Give address, num_processes and process_id"
            ) from error
        except RuntimeError as error:
            raise RunError(f"distributed: {str(error).splitlines()[0]}") from error

    def run(self, work: Work, tasks: Sequence[int]) -> Generator[tuple[int, Arrays]]:
        """As `Executor.run`; in process 0."""
        order = _Order(Job.of(work), list(tasks))
        _exchange(order)
        for i in range(order.rounds):
            for results in _exchange(order.of_round(i)):
                for task, result in results:
                    yield result_of(task, result)

    def serve(self) -> bool:
        """Computes for process 0 until it leaves the block, and gives True; in process 0, False at once."""
        if jax.process_index() == 0:
            return False
        order, i = _Order(None, []), 0
        while (message := _exchange(order.of_round(i))[0]) is not None:
            order, i = (message, 0) if isinstance(message, _Order) else (order, i + 1)
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        if jax.process_index() == 0:
            _exchange(None)
        jax.distributed.shutdown()


class _Order(NamedTuple):
    """What process 0 asks for."""

    job: Any
    tasks: list[int]

    @property
    def rounds(self) -> int:
        return -(-len(self.tasks) // jax.process_count())

    def of_round(self, i: int) -> list[tuple[int, Arrays | Failed]]:
        """This process's task of a round and its result; none where there are no more."""
        own = self.tasks[i * jax.process_count() :][jax.process_index() :][:1]
        return [(task, self.job(task)) for task in own]


def _exchange(message: Any) -> list[Any]:
    """What each process says, by its number. All say something at the same time, and wait for each other."""
    data = np.frombuffer(pickle.dumps(message), np.uint8)
    sizes = process_allgather(np.uint32(data.size))
    most = 2 ** int(sizes.max() - 1).bit_length()  # few different lengths: JAX compiles for each
    everything = process_allgather(np.pad(data, (0, most - data.size)))
    return [pickle.loads(row[:size].tobytes()) for row, size in zip(everything, sizes, strict=True)]
