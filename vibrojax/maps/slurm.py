"""Chunks computed by jobs of SLURM, with submitit."""

import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vibrojax.errors import InputError
from vibrojax.io.threads import on_leaving

LIMIT_MINUTES = 24 * 60
"""Time limit of a job [min] if SBATCH_TIMELIMIT is not set; sites have their own limits."""


class SlurmExecutor:
    """An executor that runs each call in a job of its own, at most `jobs` at a time. Leaving it cancels the jobs.

    `folder`: the folder of the jobs, which all machines can access; it is removed at the end unless a job has failed.

    **Raises:** `InputError` if no job can be submitted, or if other users can write to the folder.
    """

    def __init__(self, folder: Path, jobs: int, cluster: str = "slurm") -> None:
        place = "--workers slurm"
        try:
            import submitit
        except ImportError:
            raise InputError(f'{place}: submitit is not installed; pip install "vibrojax[slurm]"') from None
        missing = [program for program in ("sbatch", "srun") if cluster == "slurm" and shutil.which(program) is None]
        if missing:
            raise InputError(f"{place}: there is no {' and no '.join(missing)} here; run it where SLURM takes jobs")
        _make_private(folder)
        self._folder, self._max_workers = folder, jobs  # `by_executor` reads the number of workers
        self._executor = submitit.AutoExecutor(folder=folder, cluster=cluster)
        self._executor.update_parameters(name="vibrojax", timeout_min=LIMIT_MINUTES, cpus_per_task=1)
        self._jobs: list[Any] = []
        self._leaving = on_leaving(self.cancel)

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        """Submit `fn(*args)` as a job, and return the job."""
        job = self._executor.submit(fn, *args)
        self._jobs.append(job)
        return job

    def cancel(self) -> None:
        """Cancel the jobs that have not ended."""
        for job in self._jobs:
            if not job.done():
                job.cancel(check=False)

    def __enter__(self) -> "SlurmExecutor":
        self._leaving.__enter__()
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        self._leaving.__exit__(None, None, None)
        self.cancel()
        if error is None:
            shutil.rmtree(self._folder, ignore_errors=True)


def _make_private(folder: Path) -> None:
    """Create a folder that only this user can write to, since jobs and this process unpickle its files."""
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    shared = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if status.st_uid != os.geteuid() or shared or not stat.S_ISDIR(status.st_mode):
        raise InputError(f"{folder}: others can write to it, and could run code in the jobs; remove it")
