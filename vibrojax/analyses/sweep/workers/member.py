"""One of several processes that share the chunks of a sweep in a folder: it computes unclaimed chunks one by one."""

import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from vibrojax.analyses.sweep.workers.work import SECONDS, Work
from vibrojax.errors import InputError
from vibrojax.io.shards import Shards
from vibrojax.sweep.engine.batch import Report, unreported

RELEASE_POLL_SECONDS = 0.3
"""Interval [s] between two checks for chunks that other processes have released."""

Finished = Callable[[int, float], None]
"""Function that receives the index of a chunk that a worker has finished, and the computing time [s]."""

Failed = Callable[[int, Exception], None]
"""Function that receives the index of a chunk that could not be computed, and the error."""


class WorkersDied(OSError):
    """An error: workers ended before they finished their chunks."""


@dataclass(frozen=True)
class Job:
    """The work of one process among several: compute chunks of `order` until none remains. A job can be pickled.

    `task` is the pickled sweep; `folder` and `manifest` are those of its `Shards`; `threads` is that of `Work`.
    """

    task: bytes
    folder: str
    manifest: dict[str, object]
    order: list[int]
    threads: int | None = None

    def run(self, finished: Finished, failed: Failed) -> None:
        """Compute chunks, including those of processes that die meanwhile."""
        shards = Shards(Path(self.folder), self.manifest, shared=True)
        try:
            work = Work(pickle.loads(self.task), self.threads)
            compute_shared(shards, work, self.order, finished, failed, patient=True)
        finally:
            shards.claims.close()


def raise_failure(index: int, error: Exception) -> None:
    """Raise the error of a chunk, which ends a process that the user has started."""
    raise error


def compute_shared(
    shards: Shards,
    work: Work,
    order: Sequence[int],
    finished: Finished = lambda index, seconds: None,
    failed: Failed = raise_failure,
    report: Report = unreported,
    patient: bool = False,
) -> None:
    """Compute the chunks of `order` that do not exist and that no other process has claimed.

    With `patient`, also wait for the claimed chunks, and take over the chunk of a process that dies.
    """
    remaining = list(order)
    while True:
        existing = shards.there()
        remaining = [index for index in remaining if index not in existing]
        index = next((index for index in remaining if shards.claim(index)), None)
        if index is None:
            if not remaining or not patient:
                return
            time.sleep(RELEASE_POLL_SECONDS)
            continue
        try:
            features = work.compute(index, report)
            shards.write(index, features)
        except InputError:
            raise
        except Exception as error:
            shards.record_failure(index, f"{type(error).__name__}: {error}")
            remaining.remove(index)
            failed(index, error)
        else:
            finished(index, float(features[SECONDS]))
        finally:
            shards.release(index)
