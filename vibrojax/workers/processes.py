"""Workers on this machine: processes that are spawned, share the chunks of a sweep, and end with the one that began."""

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from vibrojax.devices import usable_cores
from vibrojax.errors import InputError
from vibrojax.input.definition import Sweep
from vibrojax.store.shards import Shards
from vibrojax.timings import LOG
from vibrojax.workers.executor import pickled
from vibrojax.workers.member import Finished, compute_shared
from vibrojax.workers.work import Work

DEATHS = 3
"""Workers that may die one after the other, no chunk being finished in between, before it is given up."""

_ONE_THREAD_EACH = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_SPAWN = multiprocessing.get_context("spawn")


class WorkersDied(OSError):
    """Workers die as soon as they are started."""


def by_processes(sweep: Sweep, shards: Shards, order: Sequence[int], count: int, finished: Finished) -> list[int]:
    """Have the chunks of `order` computed by `count` processes, each with its share of the cores.

    One that dies is replaced, and its chunk taken by another. When this process ends, however it ends, so do they.

    **Returns:** the indices of chunks that raised with a worker.

    **Raises:** `InputError` where the sweep cannot be sent to other processes, or as a chunk does; `WorkersDied` where
    they cannot live.
    """
    task = pickled(sweep)
    workers: dict[int, tuple[SpawnProcess, Connection]] = {}
    share = max(1, usable_cores() // count)
    failed: set[int] = set()
    began, busy, deaths, over = time.monotonic(), 0.0, 0, 0

    def start() -> None:
        ours, theirs = _SPAWN.Pipe(duplex=False)
        place = (str(shards.folder), dict(shards.manifest))
        worker = _SPAWN.Process(target=_work, args=(task, place, list(order), share, theirs), daemon=True)
        with _one_thread_each(share), _without_interrupts():
            worker.start()
        theirs.close()
        assert worker.pid is not None
        workers[worker.pid] = worker, ours

    try:
        for _ in range(min(count, len(order))):
            start()
        while workers:
            ready = wait([connection for _, connection in workers.values()])
            for number, (worker, connection) in list(workers.items()):
                if connection not in ready:
                    continue
                try:
                    kind, *said = connection.recv()
                except (EOFError, OSError, pickle.UnpicklingError):  # it has ended, perhaps in the middle of a word
                    worker.join()
                    connection.close()
                    del workers[number]
                    shards.claims.release_of(number)
                    if worker.exitcode == 0:
                        over += 1
                        continue
                    deaths += 1
                    LOG.info("worker %d died (%s)", number, worker.exitcode)
                    if deaths > DEATHS + count:
                        raise WorkersDied(
                            f"workers die before they finish a chunk (the last one with status {worker.exitcode}: "
                            "perhaps there is not enough memory for so many)"
                        ) from None
                    start()
                    continue
                if kind == "input":
                    raise InputError(said[0])
                if kind == "failed":
                    failed.add(said[0])
                    continue
                deaths = 0
                busy += said[1]
                finished(*said)
    finally:
        for number, (worker, connection) in workers.items():
            worker.kill()
            worker.join()
            connection.close()
            with suppress(OSError):
                shards.claims.release_of(number)
    passed = (time.monotonic() - began) * min(count, len(order))
    LOG.info("workers: %d, busy %.1f s of %.1f s", count, busy, passed)
    return sorted(failed)


def _work(
    task: bytes, place: tuple[str, Mapping[str, object]], order: list[int], threads: int, told: Connection
) -> None:
    """What a worker does."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    folder, manifest = place
    shards = Shards(Path(folder), manifest)
    shards.join()
    try:
        work = Work(pickle.loads(task), threads)
        compute_shared(
            shards,
            work,
            order,
            finished=lambda index, seconds: told.send(("finished", index, seconds)),
            failed=lambda index, _: told.send(("failed", index)),
            patient=True,
        )
    except InputError as error:
        told.send(("input", str(error)))
    except BrokenPipeError:  # nobody listens any more
        pass
    finally:
        shards.claims.close()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """What is started here does not hear Ctrl-C, which a terminal sends to all; it ends with this process."""
    resource_tracker.ensure_running()  # which would let interrupts through again, when a worker first asks for it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _one_thread_each(share: int) -> Iterator[None]:
    """What is started here leaves the other cores to the others, in libraries of linear algebra too."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD_EACH}
    os.environ |= {name: str(share) for name in _ONE_THREAD_EACH if name not in os.environ}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
