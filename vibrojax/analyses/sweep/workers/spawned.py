"""What a spawned worker does; nothing heavy is imported before it watches the process that began it."""

import multiprocessing
import os
import pickle
import threading
from multiprocessing.connection import Connection, wait
from pathlib import Path


def work(
    task: bytes, folder: str, manifest: dict[str, object], order: list[int], threads: int, told: Connection
) -> None:
    """Compute chunks that nobody has, until there are none, and tell of each."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from vibrojax.analyses.sweep.workers.member import compute_shared
    from vibrojax.analyses.sweep.workers.work import Work
    from vibrojax.errors import InputError
    from vibrojax.io.shards import Shards

    shards = Shards(Path(folder), manifest)
    shards.join()
    try:
        compute_shared(
            shards,
            Work(pickle.loads(task), threads),
            order,
            finished=lambda index, seconds: told.send(("finished", index, seconds)),
            failed=lambda index, _: told.send(("failed", index)),
            patient=True,
        )
    except InputError as error:
        told.send(("input", str(error)))
    except BrokenPipeError:  # nobody listens any more
        pass
    finally:
        shards.claims.close()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
