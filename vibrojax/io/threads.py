"""Work in a thread of its own, which nothing in it can keep the caller from leaving."""

import threading
import time
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")

asked_to_end: list[BaseException] = []
"""What signals have asked for, as their handlers enter it: jax drops what is raised while it collects garbage."""

_PATIENCE = 0.2
"""Seconds after which an interrupt is answered at the latest."""


def in_own_thread(work: Callable[[], Result], seconds: float | None = None) -> Result:
    """Do `work` in a thread while this one only waits.

    An interrupt reaches Python's main thread between two of its own instructions. One that compiles lanes or reads a
    file is for seconds at none of them, and jax drops an interrupt that comes while it collects garbage.

    **Arguments:**

    - `work`: what to do.
    - `seconds`: how long to wait [s]; None: to the end.

    **Returns:** what `work` returned.

    **Raises:** what `work` raised; `TimeoutError` where it has taken more than `seconds`. Then, and after an interrupt,
    the thread is left to itself.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(work())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, name="work", daemon=True)
    thread.start()
    end = None if seconds is None else time.monotonic() + seconds
    # Again and again: a signal that another thread has received does not end a wait.
    while thread.is_alive() and (end is None or time.monotonic() < end):
        if asked_to_end:
            raise asked_to_end[0]
        thread.join(_PATIENCE if end is None else min(_PATIENCE, max(0.0, end - time.monotonic())))
    if errors:
        raise errors[0]
    if not results:
        raise TimeoutError
    return results[0]
