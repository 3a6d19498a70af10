"""Chunks by an executor: any `concurrent.futures.Executor`, or what has `submit` like one."""

import pickle
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, ProcessPoolExecutor, wait
from functools import lru_cache
from threading import Lock
from typing import Any, Protocol, runtime_checkable

from vibrojax.analyses.sweep.workers.work import Work
from vibrojax.compile.devices import usable_cores
from vibrojax.errors import InputError, Place
from vibrojax.progress import LOG
from vibrojax.sweep.engine.batch import Features
from vibrojax.sweep.input.definition import Sweep

AHEAD = 256
"""Chunks that are handed over before any of them is done, to an executor that does not say how many workers it has."""

QUEUED = 2
"""Chunks that are handed over for each worker of one that does: none waits for its next one."""

POLLED = 0.2
"""Seconds between two looks at what is underway, of executors whose futures are not those of Python."""

Store = Callable[[int, Features], None]
"""Takes a chunk's index and its features when they are there."""


@runtime_checkable
class Executor(Protocol):
    """What computes chunks: Python's, dask's, loky's, MPI's; submitit's has the same `submit`."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        """Have `fn(*args)` computed; a future, which has `done()`, `result()` and `cancel()`."""


def check_executor(executor: object) -> None:
    """Raise `InputError` where it cannot compute chunks."""
    if not callable(getattr(executor, "submit", None)):
        raise InputError(
            f"executor: {type(executor).__name__} has no submit; give a concurrent.futures.Executor, "
            "like ProcessPoolExecutor(mp_context=multiprocessing.get_context('spawn'))"
        )
    context = getattr(executor, "_mp_context", None)
    if isinstance(executor, ProcessPoolExecutor) and context is not None and context.get_start_method() == "fork":
        raise InputError(
            "executor: its processes are forked, and jax hangs in such; "
            "make it with mp_context=multiprocessing.get_context('spawn')"
        )


def by_executor(sweep: Sweep, executor: Executor, order: Sequence[int], store: Store) -> None:
    """Have the chunks of a sweep computed, in this order, and `store` each when it is done, in this thread.

    A chunk whose worker raises, and all that are left where the executor breaks down (a process of Python's own pool
    died, or the scheduler is gone), are computed here. What a chunk is computed from is handed over with it.

    **Raises:** what a chunk raises here as well; `InputError` where the sweep cannot be sent to other processes.
    """
    task, threads = pickled(sweep), _threads_each(executor)
    ahead = _workers_of(executor) * QUEUED or AHEAD
    waiting = deque(order)
    left: list[int] = []
    running: dict[Any, int] = {}
    began, busy = time.monotonic(), 0.0
    try:
        while waiting or running:
            while waiting and len(running) < ahead:
                try:
                    running[executor.submit(compute_chunk, task, waiting[0], threads)] = waiting[0]
                except InputError:
                    raise
                except Exception as error:  # it takes no more
                    _warn(f"the executor takes no more chunks ({_told(error)}); the rest is computed here")
                    left += waiting
                    waiting.clear()
                    break
                waiting.popleft()
            for future in _done(list(running)):
                index = running.pop(future)
                try:
                    features = future.result()
                except InputError:
                    raise
                except (BrokenExecutor, CancelledError) as error:
                    if not left:
                        _warn(f"the executor broke down ({_told(error)}); the rest is computed here")
                    left += [index, *waiting]
                    waiting.clear()
                except Exception as error:
                    _warn(f"chunk {index} failed with a worker ({_told(error)}); computed here")
                    left.append(index)
                else:
                    busy += float(features["seconds"])
                    store(index, features)
    finally:
        for future in running:
            future.cancel()
    LOG.info("workers: %.1f s busy in %.1f s", busy, time.monotonic() - began)
    if left:
        work = Work(sweep)
        for index in left:
            store(index, work.compute(index))


def compute_chunk(task: bytes, index: int, threads: int | None) -> Features:
    """A chunk's features, computed in a worker; `task`: the pickled sweep."""
    with _MAKING:
        work = _work(task, threads)
    return work.compute(index)


_MAKING = Lock()


@lru_cache(maxsize=2)
def _work(task: bytes, threads: int | None) -> Work:
    """What a worker computes the chunks of a sweep with: compiled once."""
    work = Work(pickle.loads(task), threads)
    work.chunks.compile()
    return work


def pickled(sweep: Sweep) -> bytes:
    """The sweep, to be sent to other processes; raises `InputError` where it cannot be."""
    try:
        return pickle.dumps(sweep)
    except Exception as error:  # whatever the parts of somebody's own scene say
        raise Place(sweep.file).error(
            f"cannot be sent to other processes ({_told(error)}); "
            "let functions of your own scene or law be defined in a module of their own, not be lambdas"
        ) from None


def _done(futures: list[Any]) -> list[Any]:
    """Those that are done, at least one of them."""
    if all(isinstance(future, Future) for future in futures):
        return list(wait(futures, return_when=FIRST_COMPLETED).done)
    while not (done := [future for future in futures if future.done()]):
        time.sleep(POLLED)
    return done


def _workers_of(executor: object) -> int:
    """How many workers an executor has; 0 where it does not say."""
    known = getattr(executor, "_max_workers", None)
    return known if isinstance(known, int) and known > 0 else 0


def _threads_each(executor: object) -> int:
    """Threads by which a worker computes: its share of the cores, where the workers are all on this machine."""
    beside = _workers_of(executor)
    return max(1, usable_cores() // beside) if beside else 1


def _told(error: BaseException) -> str:
    first = (str(error).splitlines() or [""])[0]
    return f"{type(error).__name__}: {first}" if first else type(error).__name__


def _warn(text: str) -> None:
    print(f"vibrojax: warning: {text}", file=sys.stderr)
