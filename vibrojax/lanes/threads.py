"""Threads: one pool, which calls compiled programs, and drivers, which each compute a chunk by calls of the pool."""

import contextvars
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from queue import SimpleQueue
from typing import Any, TypeVar

Worker = TypeVar("Worker")
Item = TypeVar("Item")
Result = TypeVar("Result")


class _Pool:
    """Threads that call functions of their number, in the order of `calls`."""

    def __init__(self, threads: int) -> None:
        self.calls: SimpleQueue[Callable[[int], None]] = SimpleQueue()
        for number in range(threads):
            threading.Thread(target=self._run, args=(number,), daemon=True).start()

    def _run(self, number: int) -> None:
        _Member.within = True
        while True:
            self.calls.get()(number)


class _CurrentMember(threading.local):
    """A flag of the current thread: True if it is one of a pool."""

    within = False


_Member = _CurrentMember()
_pool = cache(_Pool)
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
    if _Member.within:  # a thread of the pool does not wait for the pool
        yield from ((index, work(workers[0], item)) for index, item in enumerate(items))
        return
    pool = _pool(len(workers))
    calls = _Calls(lambda number, index: work(workers[number], items[index]))
    for index in range(len(items)):
        pool.calls.put(partial(calls, index=index))
    yield from calls.results(len(items))


def by_drivers(work: Callable[[Item], Result], items: Sequence[Item], drivers: int) -> Iterator[tuple[int, Result]]:
    """Call `work(item)` for every item in at most `drivers` threads of their own; otherwise as `in_parallel`.

    `work` may itself call `in_parallel`. The threads have the context variables of the caller.
    """
    calls = _Calls(lambda _, index: work(items[index]))
    numbers = iter(range(len(items)))
    lock = threading.Lock()

    def drive() -> None:
        while not calls.over:
            with lock:
                index = next(numbers, None)
            if index is None:
                return
            calls(0, index)

    for _ in range(min(drivers, len(items))):
        threading.Thread(target=contextvars.copy_context().run, args=(drive,), daemon=True).start()
    yield from calls.results(len(items))


class _Calls:
    """Calls of one function, and their results as they are finished."""

    def __init__(self, work: Callable[[int, int], Any]) -> None:
        self._work = work
        self._done: SimpleQueue[tuple[int, Any] | BaseException] = SimpleQueue()
        self.over = False

    def __call__(self, number: int, index: int) -> None:
        if self.over:
            return
        try:
            self._done.put((index, self._work(number, index)))
        except BaseException as error:
            self._done.put(error)

    def results(self, count: int) -> Iterator[tuple[int, Any]]:
        try:
            for _ in range(count):
                result = self._done.get()
                if isinstance(result, BaseException):
                    raise result
                yield result
        finally:
            self.over = True
