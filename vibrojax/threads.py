"""Work in a thread of its own, which nothing in it can keep the caller from leaving."""

import threading
from collections.abc import Callable
from typing import TypeVar

Found = TypeVar("Found")


def apart(work: Callable[[], Found], seconds: float | None = None) -> Found:
    """What `work` returns, done in a thread while this one only waits; raises what it raised.

    An interrupt reaches Python's main thread between two of its own instructions. One that compiles lanes or reads a
    file is for seconds at none of them, and jax drops an interrupt that comes while it collects garbage.

    **Raises:** `TimeoutError` where it has taken more than `seconds`. Then, and after an interrupt, the thread is left
    to itself.
    """
    found: list[Found] = []
    raised: list[BaseException] = []

    def run() -> None:
        try:
            found.append(work())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, name="work", daemon=True)
    thread.start()
    thread.join(seconds)
    if raised:
        raise raised[0]
    if not found:
        raise TimeoutError
    return found[0]
