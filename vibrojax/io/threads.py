"""Work in a separate thread, so that the caller can always be interrupted, and clean-up after an interrupt."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import TypeVar

Result = TypeVar("Result")

asked_to_end: list[BaseException] = []
"""Exceptions requested by signals. Signal handlers append them to this list, since jax drops exceptions raised during
garbage collection."""

_POLL_SECONDS = 0.2
"""Longest delay [s] before an interrupt is handled."""

_CLEAN_UP: list[Callable[[], object]] = []


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


def in_own_thread(work: Callable[[], Result], seconds: float | None = None) -> Result:
    """Run `work` in a thread while the calling thread only waits; return its result, or raise its exception.

    Python handles an interrupt only between two bytecode instructions of its main thread. Compiling the lanes' program
    or reading a file can take seconds within one instruction, and jax drops an interrupt during garbage collection.

    **Raises:** `TimeoutError` after `seconds` (None: no limit). After a timeout or interrupt, the thread is abandoned.
    """
    future: Future[Result] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, name="work", daemon=True).start()
    end = math.inf if seconds is None else time.monotonic() + seconds
    while True:  # poll: a signal that another thread receives does not end waiting
        if asked_to_end and not future.done():
            raise asked_to_end[0]
        try:
            return future.result(min(_POLL_SECONDS, max(0.0, end - time.monotonic())))
        except TimeoutError:
            if future.done():
                return future.result()
            if time.monotonic() >= end:
                raise
