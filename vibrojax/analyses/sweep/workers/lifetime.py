"""Ends of processes: clean-up after an interrupt, and workers that end with their parent.

This module imports nothing heavy: a worker must notice the end of its parent from its start on.
"""

import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait

_ACTIONS: list[Callable[[], object]] = []


@contextmanager
def on_leaving(action: Callable[[], object]) -> Iterator[None]:
    """Register `action` to be called if the process is interrupted within this context."""
    _ACTIONS.append(action)
    try:
        yield
    finally:
        _ACTIONS.remove(action)


def leave() -> None:
    """Call the registered actions and ignore their errors; an interrupt ends the command without its threads."""
    for action in list(_ACTIONS):
        with suppress(Exception):
            action()


def work_for_parent(job: bytes, messages: Connection) -> None:
    """Run a pickled `Job` in a spawned process; send (index, seconds) for each chunk, (index, None) if it failed."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(BrokenPipeError):  # the parent has ended
        pickle.loads(job)(
            finished=lambda index, seconds: messages.send((index, seconds)),
            failed=lambda index: messages.send((index, None)),
        )


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
