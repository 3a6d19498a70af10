"""The main function of a spawned worker, which starts to watch the parent process before any heavy import."""

import multiprocessing
import os
import pickle
import threading
from multiprocessing.connection import Connection, wait

from vibrojax.errors import InputError


def work(job: bytes, messages: Connection) -> None:
    """Run a pickled `Job`, and send a message for each chunk."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        pickle.loads(job).run(
            finished=lambda index, seconds: messages.send(("finished", index, seconds)),
            failed=lambda index, _: messages.send(("failed", index, 0.0)),
        )
    except InputError as error:
        messages.send(("input", str(error), 0.0))
    except BrokenPipeError:  # the parent has ended
        pass


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
