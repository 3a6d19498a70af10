"""Distribution of work over several threads. The calling thread can still be interrupted."""

import threading
from collections.abc import Callable, Iterator, Sequence
from queue import SimpleQueue
from typing import TypeVar

Worker = TypeVar("Worker")
Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(
    work: Callable[[Worker, Item], Result], items: Sequence[Item], workers: Sequence[Worker]
) -> Iterator[tuple[int, Result]]:
    """Call `work(worker, item)` for every item, in one thread per worker. A free thread takes the next item.

    **Returns:** an iterator over (index of the item, result), in the order of completion.

    **Raises:** the exception of a call of `work`. After an exception, and if the iterator is closed early (by an
    interrupt), the threads stop after their current item. The caller does not wait for them.
    """
    done: SimpleQueue[tuple[int, Result] | BaseException] = SimpleQueue()
    waiting = iter(range(len(items)))
    taking = threading.Lock()
    stopped = threading.Event()

    def run(worker: Worker) -> None:
        while not stopped.is_set():
            with taking:
                index = next(waiting, None)
            if index is None:
                return
            try:
                done.put((index, work(worker, items[index])))
            except BaseException as error:
                done.put(error)
                return

    for worker in workers[: len(items)]:
        threading.Thread(target=run, args=(worker,), daemon=True).start()
    try:
        for _ in items:
            result = done.get()
            if isinstance(result, BaseException):
                raise result
            yield result
    finally:
        stopped.set()
