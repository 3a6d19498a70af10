"""Work in a thread of its own, so that Ctrl-C is answered at once."""

import threading
from collections.abc import Callable


def interruptible(work: Callable[[], None]) -> None:
    """Do `work` in a thread while this one only waits; raises what the work raised.

    An interrupt reaches Python's main thread between two of its own instructions. One that compiles lanes or writes a
    file is for seconds at none of them, and jax drops an interrupt that reaches it while it collects garbage. After an
    interrupt the thread is left to itself, for the process to end.
    """
    raised: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, name="work", daemon=True)
    thread.start()
    thread.join()
    if raised:
        raise raised[0]
