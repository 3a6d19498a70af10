"""By whom a sweep is computed: what `--workers` and `--only` say, and the door to each engine."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from vibrojax.errors import InputError, shown

if TYPE_CHECKING:
    from vibrojax.analyses.sweep.workers.executor import Executor

DASK, SLURM = "dask://", "slurm"

_PATIENCE = "10 s"
"""How long a scheduler is waited for that does not answer."""

_MOST = 1000
_JOBS = 10
"""Jobs of SLURM where it is not said how many."""


class Workers(NamedTuple):
    """Who computes: so many `processes` on this machine, the scheduler of dask at `dask`, or so many `jobs` of SLURM;
    all None where this process does."""

    processes: int | None = None
    dask: str | None = None
    jobs: int | None = None


def read_workers(text: str | None) -> Workers:
    """What `--workers` says; raises `InputError`, in one line, where it says nothing."""
    if text is None:
        return Workers()
    if text.isdecimal() and 1 <= int(text) <= _MOST:
        return Workers(processes=int(text))
    if text.startswith(DASK) and text.removeprefix(DASK).rpartition(":")[2].isdecimal():
        return Workers(dask=text.removeprefix(DASK))
    kind, colon, count = text.partition(":")
    if kind == SLURM and (not colon or (count.isdecimal() and 1 <= int(count) <= _MOST)):
        return Workers(jobs=int(count or _JOBS))
    raise InputError(f"--workers: {shown(text)} is no number (1 to {_MOST}), dask://HOST:PORT, slurm or slurm:JOBS")


def read_share(text: str | None) -> tuple[int, int] | None:
    """What `--only` says: (I, N); raises `InputError`, in one line, where it says nothing."""
    if text is None:
        return None
    part, slash, whole = text.partition("/")
    if slash and part.isdecimal() and whole.isdecimal() and 1 <= int(part) <= int(whole):
        return int(part), int(whole)
    raise InputError(f"--only: {shown(text)} is no I/N with I from 1 to N; write 2/3 for the second of three shares")


@contextmanager
def dask_executor(address: str) -> Iterator["Executor"]:
    """The workers of the scheduler of dask at HOST:PORT; raises `InputError` where it, or dask, is not there."""
    at = f"--workers {DASK}{address}"
    try:
        from distributed import Client
    except ImportError:
        raise InputError(f'{at}: dask is not installed; pip install "vibrojax[dask]"') from None
    try:
        client = Client(f"tcp://{address}", timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:  # asyncio's TimeoutError is an OSError
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{at}: no scheduler of dask answers there ({first}); start one: dask scheduler") from None
    with client:
        yield client.get_executor()
