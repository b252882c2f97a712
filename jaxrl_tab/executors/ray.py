"""Many machines through Ray: a shard is a task."""

import contextlib
import logging
import os
import socket
import warnings
from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

from jaxrl_tab.executors.base import Arrays, Failed, Job, Work, environment, given, need
from jaxrl_tab.types import InputError, RunError, whole

_SECONDS = 5  # in which the address of a cluster must answer
_AHEAD = 2  # tasks handed out for each place that there is for one: none stands idle, and few results wait


@dataclass(frozen=True)
class Ray:
    """On a Ray cluster; on the cores of this machine where there is none.

    A task that is lost with its worker or its node is done again, elsewhere. Where no node has room, it waits
    for one. A connection to Ray that this process already has is used, and stays.

    Attributes:
        address: of the cluster, "HOST:PORT" or "ray://HOST:PORT"; by default what RAY_ADDRESS names, or a
            cluster that runs on this machine; else one is started here, and stopped at the end.
        num_cpus: the cores of each task, all of one machine.
        max_retries: how often a task that was lost is done again.

    Raises:
        InputError: the address is none, or Ray is not installed.
        RunError: nothing answers there.
    """

    address: str | None = None
    num_cpus: int = 1
    max_retries: int = 3

    def __post_init__(self) -> None:
        need("ray", "ray")
        whole("num_cpus", "number of cores", self.num_cpus)
        whole("max_retries", "number", self.max_retries, least=0)
        _check_answers(self._address)

    def run(self, work: Work, tasks: Sequence[int]) -> Generator[tuple[int, Arrays]]:
        """As `Executor.run`."""
        import ray

        with self._connection():
            call = ray.remote(_call).options(
                num_cpus=self.num_cpus,
                max_retries=self.max_retries,
                retry_exceptions=False,
                runtime_env={"env_vars": environment()},
            )
            job = ray.put(Job.of(work, cores=self.num_cpus))
            waiting, under_way = deque(tasks), {}
            try:
                while waiting or under_way:
                    while waiting and len(under_way) < _AHEAD * self._places():
                        task = waiting.popleft()
                        under_way[call.remote(job, task)] = task
                    ready, _ = ray.wait(list(under_way), num_returns=1)
                    yield given(*self._fetch(under_way, ready.pop()))
            finally:
                for reference in under_way:
                    ray.cancel(reference, force=True)

    def _fetch(self, under_way: dict[Any, int], reference: Any) -> tuple[int, Arrays | Failed]:
        """The result of a task, now no longer under way: Ray lets go of it once nobody looks at it."""
        import ray
        import ray.exceptions

        task = under_way.pop(reference)
        try:
            return task, ray.get(reference)
        except ray.exceptions.RayTaskError as error:  # `Job` was not even begun
            raise RunError(f"shard {task} failed: {str(error).splitlines()[-1]}") from error
        except ray.exceptions.RayError as error:
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise RunError(f"shard {task} was lost {self.max_retries + 1} times: {reason}") from error

    @property
    def _address(self) -> str | None:
        return self.address or os.environ.get("RAY_ADDRESS")

    def _places(self) -> int:
        """How many tasks can run at a time, now: nodes come and go."""
        import ray

        return max(1, int(ray.cluster_resources().get("CPU", 0) // self.num_cpus))

    @contextlib.contextmanager
    def _connection(self) -> Generator[None]:
        import ray

        if ray.is_initialized():
            yield
            return
        _check_answers(self._address)
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that we start reports to nobody
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings(
                    "ignore", "os.fork", RuntimeWarning
                )  # by JAX: a program follows at once
                ray.init(
                    self._address, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR
                )
        except (ConnectionError, ValueError) as error:
            raise RunError(f"no Ray cluster at {self._address}: {str(error).splitlines()[0]}") from error
        try:
            largest = max((x["Resources"].get("CPU", 0) for x in ray.nodes() if x["Alive"]), default=0)
            if largest < self.num_cpus:
                said = "no node of the Ray cluster has %d cores, only %d: waiting for one"
                logging.getLogger(__name__).warning(said, self.num_cpus, largest)
            yield
        finally:
            ray.shutdown()


def _call(job: Job, task: int) -> Arrays | Failed:
    return job(task)


def _check_answers(address: str | None) -> None:
    """Refuses an address where nobody listens: Ray would try for minutes, and then end this process."""
    if address is None or address in ("auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"the address of a Ray cluster is HOST:PORT or ray://HOST:PORT, not {address!r}")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_SECONDS).close()
    except OSError as error:
        raise RunError(f"no Ray cluster at {address}: {error.strerror or error}") from error
