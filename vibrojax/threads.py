"""Threads: work that can always be interrupted, one pool for compiled programs, and drivers that call it.

All threads are daemons: an interrupt ends the process without waiting for compiled code.
"""

import contextvars
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed, wait
from contextlib import contextmanager, suppress
from functools import cache
from queue import SimpleQueue
from typing import Any, TypeVar

Worker = TypeVar("Worker")
Item = TypeVar("Item")
Result = TypeVar("Result")

asked_to_end: list[BaseException] = []
"""Exceptions requested by signals. Signal handlers append them to this list, since jax drops exceptions raised during
garbage collection."""

_CLEAN_UP: list[Callable[[], object]] = []

Tasks = SimpleQueue[tuple[Future[Any], Callable[..., Any], Any] | None]
"""Futures, each with the function and the item that give its result; a thread ends at None."""

_member = threading.local()
"""Holds `within`: True in a thread of the pool."""


@contextmanager
def on_leaving(action: Callable[[], object]) -> Iterator[None]:
    """Register `action`, which `leave` calls if the process is interrupted within this context."""
    _CLEAN_UP.append(action)
    try:
        yield
    finally:
        _CLEAN_UP.remove(action)


def leave() -> None:
    """Call the registered actions and ignore their errors; an interrupt ends the command without its threads."""
    for action in list(_CLEAN_UP):
        with suppress(Exception):
            action()


def _serve(tasks: Tasks, *worker: object) -> None:
    """Compute the futures of a queue. A thread of the pool has a `worker`, with which it calls the functions."""
    _member.within = bool(worker)
    while (task := tasks.get()) is not None:
        future, work, item = task
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(work(*worker, item))
            except BaseException as error:
                future.set_exception(error)
        del task, future, work, item  # a waiting thread holds no results


@cache
def _pool(workers: tuple[Any, ...]) -> Tasks:
    """Start threads that never end, one for each worker, and return the queue of their tasks."""
    tasks: Tasks = SimpleQueue()
    for worker in workers:
        threading.Thread(target=_serve, args=(tasks, worker), daemon=True).start()
    return tasks


os.register_at_fork(after_in_child=_pool.cache_clear)  # the child has none of the threads


def in_own_thread(work: Callable[[], Result]) -> Result:
    """Run `work` in a thread while the calling thread only waits; return its result, or raise its exception.

    Python handles an interrupt only between two bytecode instructions of its main thread. Compiling the lanes' program
    or reading a file can take seconds within one instruction, and jax drops an interrupt during garbage collection.
    After an interrupt, the thread is abandoned.
    """
    future: Future[Result] = Future()
    tasks: Tasks = SimpleQueue()
    tasks.put((future, lambda _: work(), None))
    tasks.put(None)
    threading.Thread(target=_serve, args=(tasks,), name="work", daemon=True).start()
    while not wait([future], 0.2).done:  # a signal that another thread receives does not end waiting
        if asked_to_end:
            raise asked_to_end[0]
    return future.result()


def in_parallel(
    work: Callable[[Worker, Item], Result], items: Sequence[Item], workers: Sequence[Worker]
) -> Iterator[tuple[int, Result]]:
    """Call `work(worker, item)` for every item, in the threads of a pool, one per worker, that all callers share.

    **Returns:** an iterator over (index of the item, result), in the order of completion.

    **Raises:** the exception of a call of `work`. After an exception, and if the iterator is closed early (by an
    interrupt), no further call begins. The caller does not wait for those that are under way.
    """
    if getattr(_member, "within", False):  # a thread of the pool does not wait for the pool
        return ((index, work(workers[0], item)) for index, item in enumerate(items))
    return _results(_pool(tuple(workers)), work, items)


def by_drivers(work: Callable[[Item], Result], items: Sequence[Item], drivers: int) -> Iterator[tuple[int, Result]]:
    """Call `work(item)` for every item in at most `drivers` threads of their own; otherwise as `in_parallel`.

    `work` may itself call `in_parallel`. The threads have the context variables of the caller.
    """
    tasks: Tasks = SimpleQueue()
    threads = min(drivers, len(items))
    for _ in range(threads):
        threading.Thread(target=contextvars.copy_context().run, args=(_serve, tasks), daemon=True).start()
    try:
        yield from _results(tasks, work, items)
    finally:
        for _ in range(threads):
            tasks.put(None)


def _results(tasks: Tasks, work: Callable[..., Any], items: Sequence[Any]) -> Iterator[tuple[int, Any]]:
    """Queue the call of `work` for each item; yield (index, result) as each call is finished."""
    index_of: dict[Future[Any], int] = {Future(): index for index in range(len(items))}
    for future, index in index_of.items():
        tasks.put((future, work, items[index]))
    try:
        for future in as_completed(list(index_of)):
            yield index_of.pop(future), future.result()
    finally:
        for future in index_of:
            future.cancel()
