"""Workers as SLURM jobs, submitted with submitit: an array of jobs that share the chunks of a sweep in its folder."""

import os
import shutil
import stat
import time
from collections.abc import Sequence
from pathlib import Path

from vibrojax.analyses.sweep.workers.executor import pickled
from vibrojax.analyses.sweep.workers.member import Finished, Job, WorkersDied
from vibrojax.analyses.sweep.workers.shutdown import on_leaving
from vibrojax.errors import InputError
from vibrojax.io.shards import Shards
from vibrojax.sweep.input.definition import Sweep

LIMIT_MINUTES = 24 * 60
"""Time limit of a job [min] if SBATCH_TIMELIMIT is not set; sites have their own limits."""

CHUNK_POLL_SECONDS = 2.0
"""Interval [s] between two checks for finished chunks."""


class SlurmJob(Job):
    """A job that SLURM may stop and restart."""

    def __call__(self) -> None:
        # A failure is recorded in the folder; the process that submitted the jobs then computes the chunk.
        self.run(finished=lambda index, seconds: None, failed=lambda index, error: None)

    def checkpoint(self) -> object:
        """Return the object that submitit submits again after SLURM has stopped the job."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


def check_slurm(name: str) -> None:
    """Raise `InputError` if no job can be submitted; `name`: the option that requests jobs."""
    try:
        import submitit  # noqa: F401
    except ImportError:
        raise InputError(f'{name}: submitit is not installed; pip install "vibrojax[slurm]"') from None
    missing = [program for program in ("sbatch", "srun") if shutil.which(program) is None]
    if missing:
        raise InputError(
            f"{name}: there is no {' and no '.join(missing)} on this machine; "
            "run it where jobs are handed to SLURM, or give a number of processes"
        )


def by_slurm(
    sweep: Sweep, shards: Shards, order: Sequence[int], count: int, finished: Finished, cluster: str = "slurm"
) -> list[int]:
    """Compute the chunks of `order` with `count` jobs, which write them to a folder that all machines can access.

    Further SLURM options (partition, account, memory, time) are read from the environment variables SBATCH_*. An
    interrupt of this process cancels the jobs; if this process is killed, the jobs continue.

    **Returns:** the indices of the chunks whose computation raised an exception in a job.

    **Raises:** `WorkersDied` if the jobs end before all chunks exist; `InputError` if other users can write to the
    jobs' folder.
    """
    import submitit

    logs = shards.folder.with_suffix(".jobs").absolute()
    _make_private(logs)
    executor = submitit.AutoExecutor(folder=logs, cluster=cluster)
    executor.update_parameters(name="vibrojax", timeout_min=LIMIT_MINUTES, cpus_per_task=1)
    task = SlurmJob(pickled(sweep), str(shards.folder.absolute()), shards.manifest.values, list(order))
    with executor.batch():
        jobs = [executor.submit(task) for _ in range(min(count, len(order)))]

    def cancel() -> None:
        for job in jobs:
            if not job.done():
                job.cancel(check=False)

    unfinished, ended = set(order), False
    with on_leaving(cancel):
        try:
            while unfinished and not ended:
                ended = all(job.done() for job in jobs)  # before the chunks are checked for the last time
                new = unfinished & shards.there()
                for index in sorted(new):
                    finished(index, 0.0)
                unfinished -= new
                if unfinished and not ended:
                    time.sleep(CHUNK_POLL_SECONDS)
        except BaseException:
            cancel()
            raise
    failed = {index for index in unfinished if shards.has_failed(index)}
    if unfinished - failed:
        raise WorkersDied(
            f"the jobs ended, and {len(unfinished)} of {len(order)} chunks are not there; what they said: {logs}"
        )
    cancel()
    shutil.rmtree(logs, ignore_errors=True)
    return sorted(failed)


def _make_private(folder: Path) -> None:
    """Create a folder that only this user can write to, since jobs and this process unpickle its files."""
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    shared = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if status.st_uid != os.geteuid() or shared or not stat.S_ISDIR(status.st_mode):
        raise InputError(f"{folder}: others can write to it, and could run code in the jobs; remove it")
