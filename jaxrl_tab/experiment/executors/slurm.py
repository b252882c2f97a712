"""Many machines through SLURM: the shards as a job array, handed in and fetched by submitit."""

import contextlib
import shutil
import tempfile
import time
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.experiment.executors.base import Arrays, Failed, Job, Work, need, result_of

_SECONDS = 1.0  # between looks at the jobs
_DEFAULTS = {"name": "jaxrl-tab", "timeout_min": 60}


@checked_dataclass
class Slurm:
    """As an array of SLURM jobs, among which the shards are dealt out.

    A job that dies is handed in again, with all its shards. One that reaches its time limit is not, for it
    would reach it again: the shards that it had finished are given, and the next one has failed.

    Attributes:
        folder: Where the jobs' files go, seen by all machines. They are removed at the end, but for those of
            jobs that failed or died too often.
        parameters: What SLURM is asked for, as `submitit.AutoExecutor.update_parameters` has it: timeout_min
            (60 by default), cpus_per_task, mem_gb, slurm_partition, slurm_account, slurm_array_parallelism ...
        max_jobs: How many jobs at most: SLURM limits arrays, to 1001 by default, and each job imports and
            compiles for some ten seconds before it computes.
        max_retries: How often a job that died is handed in again.
        cluster: "slurm", or "local" for processes of this machine instead of jobs, to try it out.

    Raises:
        InputError: there is no SLURM here, or it has no such parameter, or submitit is not installed.
    """

    folder: str | Path
    parameters: Mapping[str, Any] = field(default_factory=dict)
    max_jobs: int = field(default=100, at_least=1)
    max_retries: int = field(default=3, at_least=0)
    cluster: str = "slurm"

    def __post_init__(self) -> None:
        need("submitit", "slurm")
        with tempfile.TemporaryDirectory() as folder:
            self._executor(folder)

    def run(self, work: Work, tasks: Sequence[int]) -> Generator[tuple[int, Arrays]]:
        """As `Executor.run`."""
        Path(self.folder).mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix="jobs-", dir=self.folder)).resolve()
        executor, job = self._executor(folder), Job.of(work)
        shares = [tasks[i :: self.max_jobs] for i in range(min(self.max_jobs, len(tasks)))]
        with executor.batch():
            handed_in = [executor.submit(_several, job, share) for share in shares]
        under_way = {submitted: (share, 0) for submitted, share in zip(handed_in, shares, strict=True)}
        try:
            while under_way:
                for submitted in [submitted for submitted in under_way if submitted.done()]:
                    share, deaths = under_way.pop(submitted)
                    results = self._fetch(submitted, share, deaths + 1)
                    if results is None:
                        under_way[executor.submit(_several, job, share)] = share, deaths + 1
                    while results:  # none is held any longer than it takes to give it
                        yield result_of(*results.pop(0))
                if under_way:
                    time.sleep(_SECONDS)
        except _JobError:
            raise  # and keep the folder, where the job's own messages are
        except BaseException:
            _remove(folder)
            raise
        else:
            _remove(folder)
        finally:
            for submitted in under_way:
                submitted.cancel(check=False)

    def _executor(self, folder: str | Path) -> Any:
        """The executor of submitit."""
        import submitit

        try:
            executor = submitit.AutoExecutor(folder, cluster=self.cluster)
            executor.update_parameters(**_DEFAULTS | dict(self.parameters))
        except (RuntimeError, ValueError, NameError, AssertionError) as error:  # all that it refuses with
            raise InputError(f"slurm: {str(error).splitlines()[0]}") from error
        return executor

    def _fetch(self, job: Any, share: Sequence[int], deaths: int) -> list[tuple[int, Arrays | Failed]] | None:
        """What a job that has ended gave; None where it died, for the `deaths`-th time: try again."""
        from submitit.core.utils import FailedJobError, UncompletedJobError

        try:
            results = job.result()
        except UncompletedJobError as error:
            failed = isinstance(error, FailedJobError)  # our function was not even begun
            if not failed and deaths <= self.max_retries:
                return None
            how = "failed" if failed else f"died {deaths} times"
            raise _JobError(
                f"the job of shards {', '.join(map(str, share))} {how}: what it said is in {job.paths.stderr}"
            ) from error
        job.paths.result_pickle.unlink()
        return results


class _JobError(RunError):
    """A job failed as a whole, and not in one of its shards."""


def _several(job: Job, tasks: Sequence[int]) -> list[tuple[int, Arrays | Failed]]:
    """What a job does: its tasks, up to the first that fails."""
    results = []
    for task in tasks:
        results.append((task, job(task)))
        if isinstance(results[-1][1], Failed):
            break
    return results


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):  # other runs have files there
        folder.parent.rmdir()
