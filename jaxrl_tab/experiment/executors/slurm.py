"""Many machines through SLURM: the shards as a job array, handed in and fetched by submitit."""

import contextlib
import itertools
import os
import pickle
import shutil
import tempfile
import time
from collections import deque
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

    Each shard is given as soon as it is finished: a job leaves it in a file. A job that dies is handed in again, with
    the shards that it had not finished. One that reaches its time limit is not, for it would reach it again: the next
    of its shards has failed.

    Attributes:
        folder: Where the jobs' files go, seen by all machines. They are removed at the end, but for those of
            jobs that failed or died too often.
        parameters: What SLURM is asked for, as `submitit.AutoExecutor.update_parameters` has it: timeout_min
            (60 by default), cpus_per_task, mem_gb, slurm_partition, slurm_account, slurm_array_parallelism ...
        max_jobs: How many jobs at most: SLURM limits arrays, to 1001 by default, and each job imports and
            compiles for some ten seconds before it computes.
        max_retries: How often a job that died is handed in again, without having finished a shard.
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
        shares = [deque(tasks[i :: self.max_jobs]) for i in range(min(self.max_jobs, len(tasks)))]
        with executor.batch():
            handed_in = [executor.submit(_several, job, list(share), folder) for share in shares]
        under_way = {submitted: (share, 0) for submitted, share in zip(handed_in, shares, strict=True)}
        try:
            while under_way:
                ended = {submitted for submitted in under_way if submitted.done()}
                # Not asked for by name: on shared disks a name that was not there then may stay unseen for a while.
                there = set(os.listdir(folder))
                for submitted, (share, deaths) in list(under_way.items()):
                    left = len(share)
                    while share and (submitted in ended or _name(share[0]) in there):
                        if (result := _taken(folder / _name(share[0]))) is None:
                            break
                        yield result_of(share.popleft(), result)
                    under_way[submitted] = share, deaths if len(share) == left else 0
                for submitted in ended:
                    share, deaths = under_way.pop(submitted)
                    if share:
                        self._check_may_go_on(submitted, share, deaths + 1)
                        again = executor.submit(_several, job, list(share), folder)
                        under_way[again] = share, deaths + 1
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

    def _check_may_go_on(self, job: Any, share: Sequence[int], deaths: int) -> None:
        """Raises _JobError where a job that has ended with shards left is not to be handed in again."""
        from submitit.core.utils import FailedJobError, UncompletedJobError

        try:
            job.result()
        except FailedJobError as error:  # our function was not even begun
            how, cause = "failed", error
        except UncompletedJobError as error:
            how, cause = f"died {deaths} times", error
            if deaths <= self.max_retries:
                return
        else:
            how, cause = "left no results", None
        named = ", ".join([*map(str, itertools.islice(share, 5)), *(["..."] if len(share) > 5 else [])])
        raise _JobError(f"the job of shards {named} {how}: what it said is in {job.paths.stderr}") from cause


class _JobError(RunError):
    """A job failed as a whole, and not in one of its shards."""


def _several(job: Job, tasks: Sequence[int], folder: Path) -> None:
    """What a job does: its tasks, up to the first that fails, each into a file."""
    for task in tasks:
        result, file = job(task), folder / _name(task)
        unfinished = file.with_suffix(".unfinished")
        with unfinished.open("wb") as opened:
            pickle.dump(result, opened, protocol=pickle.HIGHEST_PROTOCOL)
        unfinished.replace(file)
        if isinstance(result, Failed):
            return


def _taken(file: Path) -> Arrays | Failed | None:
    """What is in the file, which is gone then; None where there is none."""
    try:
        with file.open("rb") as opened:
            result = pickle.load(opened)
    except FileNotFoundError:
        return None
    file.unlink()
    return result


def _name(task: int) -> str:
    return f"{task}.result"


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):  # other runs have files there
        folder.parent.rmdir()
