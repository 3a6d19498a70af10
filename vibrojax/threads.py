"""Threads: work that can always be interrupted, one pool for compiled programs, and drivers that call it."""

import contextvars
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
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

_POLL_SECONDS = 0.2
"""Longest delay [s] before an interrupt is handled."""

_CLEAN_UP: list[Callable[[], object]] = []

Calls = SimpleQueue[Callable[[int], None] | None]
"""Functions of the number of the thread that calls them; a thread ends at None."""

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


def in_own_thread(work: Callable[[], Result]) -> Result:
    """Run `work` in a thread while the calling thread only waits; return its result, or raise its exception.

    Python handles an interrupt only between two bytecode instructions of its main thread. Compiling the lanes' program
    or reading a file can take seconds within one instruction, and jax drops an interrupt during garbage collection.
    After an interrupt, the thread is abandoned.
    """
    future: Future[Result] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, name="work", daemon=True).start()
    while not wait([future], _POLL_SECONDS).done:  # a signal that another thread receives does not end waiting
        if asked_to_end:
            raise asked_to_end[0]
    return future.result()


def _make(calls: Calls, number: int, within: bool) -> None:
    """Make the calls of a queue."""
    _member.within = within
    while (call := calls.get()) is not None:
        call(number)


@cache
def _pool(threads: int) -> Calls:
    """Start threads that never end, and return the queue of their calls."""
    calls: Calls = SimpleQueue()
    for number in range(threads):
        threading.Thread(target=_make, args=(calls, number, True), daemon=True).start()
    return calls


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # the child has none of the threads


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
    return _results(_pool(len(workers)), lambda number, index: work(workers[number], items[index]), len(items))


def by_drivers(work: Callable[[Item], Result], items: Sequence[Item], drivers: int) -> Iterator[tuple[int, Result]]:
    """Call `work(item)` for every item in at most `drivers` threads of their own; otherwise as `in_parallel`.

    `work` may itself call `in_parallel`. The threads have the context variables of the caller.
    """
    calls: Calls = SimpleQueue()
    threads = min(drivers, len(items))
    for _ in range(threads):
        context = contextvars.copy_context()
        threading.Thread(target=context.run, args=(_make, calls, 0, False), daemon=True).start()
    try:
        yield from _results(calls, lambda _, index: work(items[index]), len(items))
    finally:
        for _ in range(threads):
            calls.put(None)


def _results(calls: Calls, work: Callable[[int, int], Any], count: int) -> Iterator[tuple[int, Any]]:
    """Call `work(thread, index)` for each index below `count`; yield (index, result) as each call is finished."""
    done: SimpleQueue[tuple[int, Any] | BaseException] = SimpleQueue()
    over = False

    def call(index: int) -> Callable[[int], None]:
        def made(number: int) -> None:
            try:
                if not over:
                    done.put((index, work(number, index)))
            except BaseException as error:
                done.put(error)

        return made

    for index in range(count):
        calls.put(call(index))
    try:
        for _ in range(count):
            result = done.get()
            if isinstance(result, BaseException):
                raise result
            yield result
    finally:
        over = True
