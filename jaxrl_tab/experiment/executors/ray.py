"""Many machines through Ray: a shard is a task."""

import contextlib
import logging
import os
import secrets
import socket
import subprocess
import sys
import threading
import warnings
from collections import deque
from collections.abc import Generator, Sequence
from typing import Any

from jaxrl_tab.core.errors import InputError, RunError, reason
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.experiment.executors.base import Arrays, Failed, Job, Work, environment, need, result_of

_SECONDS = 5  # in which the address of a cluster must answer
_PATIENCE = 30  # seconds in which it must let us in
_TRY = "import sys, ray; ray.init(sys.argv[1], log_to_driver=False, logging_level=50)"  # in another process
# What a gRPC client sends first: HTTP/2, and that it has no settings. A server answers with its own.
_HELLO, _SETTINGS = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + b"\4" + bytes(5), b"\4"
_AHEAD = 2  # tasks handed out for each place that there is for one: none stands idle, and few results wait


@checked_dataclass
class Ray:
    """On a Ray cluster; on the cores of this machine where none is named.

    A task that is lost with its worker or its node is done again, elsewhere. Where no node has room, it waits
    for one. A connection to Ray that this process already has is used, and stays. The logger of this module
    tells which cluster was joined.

    Attributes:
        address: Of the cluster, "HOST:PORT" or "ray://HOST:PORT", or "auto" for one that runs on this
            machine; by default what RAY_ADDRESS names. Where neither is given one is started here, for this
            process alone, and stopped at the end: it listens on the loopback interface, and has a token.
        num_cpus: The cores of each task, all of one machine.
        max_retries: How often a task that was lost is done again.

    Raises:
        InputError: the address has another form, or Ray is not installed.
        RunError: no Ray cluster answers there, or it wants a token.
    """

    address: str | None = None
    num_cpus: int = field(default=1, at_least=1)
    max_retries: int = field(default=3, at_least=0)

    def __post_init__(self) -> None:
        need("ray", "ray")
        if self._address != "local":
            _check_answers(self._address)
            _check_joins(self._address)

    def run(self, work: Work, tasks: Sequence[int]) -> Generator[tuple[int, Arrays]]:
        """As `Executor.run`."""
        with self._connection():
            import ray

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
                    with contextlib.redirect_stdout(sys.stderr):  # where Ray prints that a node goes away
                        ready, _ = ray.wait(list(under_way), num_returns=1)
                    yield result_of(*self._fetch(under_way, ready.pop()))
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
    def _address(self) -> str:
        return self.address or os.environ.get("RAY_ADDRESS") or "local"

    def _places(self) -> int:
        """How many tasks can run at a time, now: nodes come and go."""
        import ray

        return max(1, int(ray.cluster_resources().get("CPU", 0) // self.num_cpus))

    @contextlib.contextmanager
    def _connection(self) -> Generator[None]:
        own = self._address == "local"
        with _alone() if own else contextlib.nullcontext():
            import ray  # which looks at variables now

            if was_connected := ray.is_initialized():
                own = False
            else:
                self._connect()
        try:
            self._say_what_it_is(own)
            yield
        finally:
            if not was_connected:
                with contextlib.redirect_stdout(sys.stderr):
                    ray.shutdown()

    def _connect(self) -> None:
        import ray

        if self._address != "local":
            _check_answers(self._address)
        quiet = {"include_dashboard": False, "log_to_driver": False, "logging_level": logging.ERROR}
        try:
            with contextlib.redirect_stdout(sys.stderr), warnings.catch_warnings():
                # JAX warns of forks. Ray forks only to start another program at once, which is safe.
                warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
                ray.init(self._address, **quiet)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise RunError(f"no Ray cluster at {self._address}: {str(error).splitlines()[0]}") from error

    def _say_what_it_is(self, own: bool) -> None:
        import ray

        cores = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        log = logging.getLogger(__name__)
        if not own:
            by_client = self._address.startswith("ray://")  # then this process knows no other address
            address = self._address if by_client else ray.get_runtime_context().gcs_address
            log.warning("on the Ray cluster at %s: %d nodes, %d cores", address, len(cores), sum(cores))
        if max(cores, default=0) < self.num_cpus:
            warning = "no node of the Ray cluster has %d cores, only %d: waiting for one"
            log.warning(warning, self.num_cpus, max(cores, default=0))


def _call(job: Job, task: int) -> Arrays | Failed:
    return job(task)


@contextlib.contextmanager
def _alone() -> Generator[None]:
    """Variables with which a cluster is started that is for this process alone.

    Ray would listen on all interfaces, and leave a token in the home folder, with which `ray start` then
    makes clusters that refuse those who do not say RAY_AUTH_MODE=token.
    """
    settings = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}
    settings |= {"RAY_AUTH_TOKEN": os.environ.get("RAY_AUTH_TOKEN", secrets.token_hex(32))}
    before = {name: os.environ.get(name) for name in (*settings, "RAY_AUTH_MODE")}  # this Ray sets itself
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _check_answers(address: str) -> None:
    """Refuses an address where no such server listens: Ray would try for minutes, and then end this process."""
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit() or int(port) > 65535:
        raise InputError(f"the address of a Ray cluster is HOST:PORT or ray://HOST:PORT, not {address!r}")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_SECONDS) as connection:
            if os.environ.get("RAY_USE_TLS", "0") == "0":
                connection.sendall(_HELLO)
                if connection.recv(9)[3:4] != _SETTINGS:
                    raise RunError(f"no Ray cluster at {address}: something else listens there")
    except TimeoutError as error:
        raise RunError(f"no Ray cluster at {address}: there is no answer in {_SECONDS} seconds") from error
    except OSError as error:
        raise RunError(f"no Ray cluster at {address}: {reason(error)}") from error


def _check_joins(address: str) -> None:
    """Refuses a cluster that does not let us in. Another process tries, since Ray may hang, or end it."""
    command = [sys.executable, "-c", _TRY, address]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as trial:
        assert trial.stdout
        patience = threading.Timer(_PATIENCE, trial.kill)
        patience.start()
        lines = []
        for line in trial.stdout:
            lines.append(line.strip())
            if "InvalidAuthToken" in line:
                trial.kill()
        patience.cancel()
    if trial.returncode == 0:
        return
    reason = next(filter(None, reversed(lines)), "") if trial.returncode > 0 else ""
    if any("InvalidAuthToken" in line for line in lines):
        reason = "it wants its token: set RAY_AUTH_MODE=token, and RAY_AUTH_TOKEN unless it is in ~/.ray/auth_token"
    raise RunError(
        f"cannot connect to the Ray cluster at {address}: {reason or f'no answer in {_PATIENCE} seconds'}"
    )
