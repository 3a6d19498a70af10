"""Workers as jobs of SLURM, through submitit: an array of jobs that share the chunks of a sweep in its folder."""

import os
import pickle
import shutil
import stat
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from vibrojax.analyses.sweep.workers.executor import pickled
from vibrojax.analyses.sweep.workers.member import Finished, compute_shared
from vibrojax.analyses.sweep.workers.processes import WorkersDied
from vibrojax.analyses.sweep.workers.shutdown import on_leaving
from vibrojax.analyses.sweep.workers.work import Work
from vibrojax.errors import InputError
from vibrojax.io.shards import Shards
from vibrojax.sweep.input.definition import Sweep

LIMIT_MINUTES = 24 * 60
"""Time limit of a job where SBATCH_TIMELIMIT does not say: sites have limits of their own."""

POLLED = 2.0
"""Seconds between two looks at what is there."""


class Job:
    """What a job does: chunks that nobody has, until there are none. SLURM may stop it and start it again."""

    def __init__(self, task: bytes, folder: str, manifest: Mapping[str, object], order: Sequence[int]) -> None:
        self.task, self.folder, self.manifest, self.order = task, folder, dict(manifest), list(order)

    def __call__(self) -> int:
        shards = Shards(Path(self.folder), self.manifest)
        shards.join()
        done: list[int] = []
        try:
            work = Work(pickle.loads(self.task))
            compute_shared(
                shards,
                work,
                self.order,
                finished=lambda index, _: done.append(index),
                failed=lambda index, _: None,  # it is written down; the process that began the jobs computes it
                patient=True,
            )
        finally:
            shards.claims.close()
        return len(done)

    def checkpoint(self) -> object:
        """What submitit starts again where SLURM has stopped the job."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


def check_slurm(name: str) -> None:
    """Raise `InputError`, in one line, where no job can be handed to SLURM; `name`: what asked for it."""
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
    """Have the chunks of `order` computed by `count` jobs, which write them into the folder that all machines see.

    What SLURM is to be told beyond that (partition, account, memory, time) it takes from the environment, SBATCH_*.
    When this process is interrupted the jobs are cancelled; where it is killed they go on.

    **Returns:** the indices of chunks that raised with a job.

    **Raises:** `WorkersDied` where the jobs end and chunks are not there; `InputError` if others can write to the jobs'
    folder.
    """
    import submitit

    logs = shards.folder.with_suffix(".jobs").absolute()
    _make_private(logs)
    executor = submitit.AutoExecutor(folder=logs, cluster=cluster)
    executor.update_parameters(name="vibrojax", timeout_min=LIMIT_MINUTES, cpus_per_task=1)
    job = Job(pickled(sweep), str(shards.folder.absolute()), shards.manifest, order)
    with executor.batch():
        jobs = [executor.submit(job) for _ in range(min(count, len(order)))]
    left = set(order)
    with on_leaving(lambda: _cancel(jobs)):
        try:
            over = False
            while left:
                came = left & shards.there()
                for index in sorted(came):
                    finished(index, 0.0)
                left -= came
                if over or not left:
                    break
                over = all(one.done() for one in jobs)  # and look once more
                time.sleep(0.0 if over else POLLED)
        except BaseException:
            _cancel(jobs)
            raise
    failed = {one for one in left if shards.has_failed(one)}
    if left - failed:
        raise WorkersDied(
            f"the jobs ended, and {len(left)} of {len(order)} chunks are not there; what they said: {logs}"
        )
    _cancel(jobs)
    shutil.rmtree(logs, ignore_errors=True)
    return sorted(failed)


def _make_private(folder: Path) -> None:
    """Make a folder to which this user alone writes: jobs, and this process, unpickle the files in it."""
    folder.mkdir(mode=0o700, exist_ok=True)
    about = folder.lstat()
    if about.st_uid != os.geteuid() or about.st_mode & (stat.S_IWGRP | stat.S_IWOTH) or not stat.S_ISDIR(about.st_mode):
        raise InputError(f"{folder}: others can write to it, and could run code in the jobs; remove it")


def _cancel(jobs: Sequence[Any]) -> None:
    for one in jobs:
        if not one.done():
            one.cancel(check=False)
