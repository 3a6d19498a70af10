"""Running work in a separate thread, so that the caller can always be interrupted."""

import threading
import time
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")

asked_to_end: list[BaseException] = []
"""Exceptions requested by signals. Signal handlers append them to this list, since jax drops exceptions raised during
garbage collection."""

_POLL_SECONDS = 0.2
"""Longest delay [s] before an interrupt is handled."""


def in_own_thread(work: Callable[[], Result], seconds: float | None = None) -> Result:
    """Run `work` in a thread while the calling thread only waits.

    Python handles an interrupt only between two bytecode instructions of its main thread. Compiling the lanes' program
    or reading a file can take seconds within one instruction, and jax drops an interrupt during garbage collection.

    **Arguments:**

    - `work`: the function to call.
    - `seconds`: maximum time to wait [s]; None: no limit.

    **Returns:** the result of `work`.

    **Raises:** any exception of `work`; `TimeoutError` after `seconds`. After a timeout or an interrupt, the thread is
    abandoned.
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
    # Poll: a signal that another thread receives does not end `join`.
    while thread.is_alive() and (end is None or time.monotonic() < end):
        if asked_to_end:
            raise asked_to_end[0]
        thread.join(_POLL_SECONDS if end is None else min(_POLL_SECONDS, max(0.0, end - time.monotonic())))
    if errors:
        raise errors[0]
    if not results:
        raise TimeoutError
    return results[0]
