"""Work done by several threads at once, whose caller an interrupt still reaches."""

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
    """`work(worker, item)` for every item, by one thread for each worker; each takes the next item when it is free.

    **Returns:** an iterator over (index of the item, what its work returned), in the order in which they are done.

    **Raises:** what a work raised. Then, and where the iterator is closed early (an interrupt), threads stop after the
    item they are at, and nothing waits for them.
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
