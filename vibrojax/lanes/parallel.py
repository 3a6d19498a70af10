"""Calls in parallel threads. A thread that waits for some of its calls meanwhile runs those of other threads."""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from queue import SimpleQueue
from typing import Any, TypeVar

Worker = TypeVar("Worker")
Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    work: Callable[[Worker, Item], Result], items: Sequence[Item], workers: Sequence[Worker]
) -> Iterator[tuple[int, Result]]:
    """Call `work(worker, item)` for every item, in one thread per worker. A free thread takes the next item.

    If `work` itself calls `in_parallel`, no threads are added: the same threads run the inner calls, each those of its
    own item first. So no thread is idle while another one has calls that wait.

    **Returns:** an iterator over (index of the item, result), in the order of completion.

    **Raises:** the exception of a call of `work`. After an exception, and if the iterator is closed early (by an
    interrupt), the threads stop after their current item. The caller does not wait for them.
    """
    if (crew := _Member.crew) is not None:
        yield from crew.share(_Calls(work, items, workers))
        return
    done: SimpleQueue[tuple[int, Result] | BaseException] = SimpleQueue()
    crew = _Crew(len(workers), range(len(items)))

    def run(number: int, worker: Worker) -> None:
        _Member.crew, _Member.number = crew, number
        try:
            while not crew.stopped:
                with crew.changed:
                    index = crew.waiting.popleft() if crew.waiting else None
                if index is None:
                    crew.help(None)
                    return
                done.put((index, work(worker, items[index])))
        except BaseException as error:
            done.put(error)

    for number, worker in enumerate(workers):
        threading.Thread(target=run, args=(number, worker), daemon=True).start()
    try:
        for _ in items:
            result = done.get()
            if isinstance(result, BaseException):
                raise result
            yield result
    finally:
        crew.stop()


def free_threads(workers: int) -> int:
    """Return the number of threads, this one included, that take calls of `in_parallel` at once or soon.

    These are the idle threads, or all of them if no item waits: each is then idle as soon as it finishes its own.
    `workers`: number of threads that `in_parallel` would start outside of its own threads.
    """
    crew = _Member.crew
    if crew is None:
        return workers
    return 1 + crew.idle if crew.waiting else crew.threads


class _Stopped(BaseException):
    """Ends a thread whose crew has stopped."""


class _Calls:
    """Calls of one `in_parallel`: those that wait, and the results of the finished ones."""

    def __init__(self, work: Callable[..., Any], items: Sequence[Any], workers: Sequence[Any]) -> None:
        self._work, self._items, self._workers = work, items, workers
        self.waiting = deque(range(len(items)))
        self.finished: list[tuple[int, Any]] = []
        self.error: BaseException | None = None

    @property
    def over(self) -> bool:
        return self.error is not None or len(self.finished) == len(self._items)

    def run(self, index: int) -> None:
        try:
            result = self._work(self._workers[_Member.number % len(self._workers)], self._items[index])
        except BaseException as error:
            self.error = error
        else:
            self.finished.append((index, result))


class _Crew:
    """Threads that run each other's calls.

    `threads`: number of threads; `idle`: number of those that wait for calls; `waiting`: items that none has taken.
    """

    def __init__(self, threads: int, items: Iterable[int]) -> None:
        self.threads, self.waiting = threads, deque(items)
        self.changed = threading.Condition()
        self.stopped = False
        self.idle = 0
        self._shared: list[_Calls] = []

    def share(self, calls: _Calls) -> list[tuple[int, Any]]:
        """Run calls in this thread and in others that wait, and return the results."""
        with self.changed:
            self._shared.append(calls)
            self.changed.notify(len(calls.waiting))
        try:
            self.help(calls)
        finally:
            with self.changed:
                self._shared.remove(calls)
        if calls.error is not None:
            raise calls.error
        return calls.finished

    def help(self, own: _Calls | None) -> None:
        """Run waiting calls, first of the `own` ones, until these are over, or without `own` ones until the end."""
        while True:
            with self.changed:
                while (found := self._next(own)) is None:
                    if own is not None and own.over:
                        return
                    if self.stopped:
                        raise _Stopped
                    self.idle += 1
                    self.changed.wait()
                    self.idle -= 1
            calls, index = found
            calls.run(index)
            if calls.over:
                with self.changed:
                    self.changed.notify_all()

    def _next(self, own: _Calls | None) -> tuple[_Calls, int] | None:
        if self.stopped or (own is not None and own.over):
            return None
        for calls in self._shared if own is None else (own, *self._shared):
            if calls.waiting and calls.error is None:
                return calls, calls.waiting.popleft()
        return None

    def stop(self) -> None:
        with self.changed:
            self.stopped = True
            self.changed.notify_all()


class _CurrentMember(threading.local):
    """The crew of the current thread, if any, and the thread's number in it."""

    crew: _Crew | None = None
    number: int = 0


_Member = _CurrentMember()
