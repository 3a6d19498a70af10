"""The options `--workers` and `--only`, and the connection to a dask scheduler."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from vibrojax.errors import InputError, shown

if TYPE_CHECKING:
    from vibrojax.analyses.sweep.workers.executor import Executor

DASK, SLURM = "dask://", "slurm"

SCHEDULER_TIMEOUT = "10 s"
"""Maximum time to wait for a response of the scheduler."""

MAX_WORKERS = 1000
"""Maximum number of processes or jobs; a larger number is assumed to be a typing error."""

DEFAULT_JOBS = 10
"""Number of SLURM jobs if the option specifies none."""


class Workers(NamedTuple):
    """The workers of a sweep: local `processes`, a `dask` scheduler HOST:PORT, or SLURM `jobs`.

    If all are None, this process computes the sweep.
    """

    processes: int | None = None
    dask: str | None = None
    jobs: int | None = None


def read_workers(text: str | None) -> Workers:
    """Return the workers that `--workers` specifies; raise `InputError` if the option is malformed."""
    if text is None:
        return Workers()
    if text.isdecimal() and 1 <= int(text) <= MAX_WORKERS:
        return Workers(processes=int(text))
    if text.startswith(DASK) and text.removeprefix(DASK).rpartition(":")[2].isdecimal():
        return Workers(dask=text.removeprefix(DASK))
    kind, colon, count = text.partition(":")
    if kind == SLURM and (not colon or (count.isdecimal() and 1 <= int(count) <= MAX_WORKERS)):
        return Workers(jobs=int(count or DEFAULT_JOBS))
    choices = f"a number (1 to {MAX_WORKERS}), dask://HOST:PORT, slurm or slurm:JOBS"
    raise InputError(f"--workers: {shown(text)} is not {choices}")


def read_share(text: str | None) -> tuple[int, int] | None:
    """Return (I, N) of `--only I/N`, or None without the option; raise `InputError` if it is malformed."""
    if text is None:
        return None
    part, slash, whole = text.partition("/")
    if slash and part.isdecimal() and whole.isdecimal() and 1 <= int(part) <= int(whole):
        return int(part), int(whole)
    raise InputError(f"--only: {shown(text)} is not I/N with I from 1 to N; write 2/3 for the second of three shares")


@contextmanager
def dask_executor(address: str) -> Iterator["Executor"]:
    """Yield the executor of the dask scheduler at HOST:PORT; raise `InputError` if dask or the scheduler is missing."""
    place = f"--workers {DASK}{address}"
    try:
        from distributed import Client
    except ImportError:
        raise InputError(f'{place}: dask is not installed; pip install "vibrojax[dask]"') from None
    try:
        client = Client(f"tcp://{address}", timeout=SCHEDULER_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # asyncio's TimeoutError is an OSError
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{place}: no scheduler of dask answers there ({reason}); start one: dask scheduler") from None
    with client:
        yield client.get_executor()
