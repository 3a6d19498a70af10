"""Work shared by several threads, whose caller an interrupt still reaches."""

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
    """Call `work(worker, item)` for every item, in one thread per worker; each takes the next item when it is free.

    **Returns:** an iterator over (index of the item, result), in the order of completion.

    **Raises:** the exception of a work. Then, and if the iterator is closed early (an interrupt), threads stop after
    their current item, and nothing waits for them.
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
