"""One of several processes that share the chunks of a sweep in a folder, each taking the next that nobody has."""

import time
from collections.abc import Callable, Sequence

from vibrojax.analyses.sweep.workers.work import SECONDS, Work
from vibrojax.errors import InputError
from vibrojax.io.shards import Shards
from vibrojax.sweep.engine.batch import Report, unreported

POLLED = 0.3
"""Seconds between two looks for chunks that others let go of."""

Finished = Callable[[int, float], None]
"""Is called with the index of a chunk that this process has finished, and the seconds that it took."""

Failed = Callable[[int, Exception], None]
"""Is called with the index of a chunk that could not be computed, and why."""


def unfinished_alone(index: int, error: Exception) -> None:
    """What is raised in a process that nobody has started is raised there."""
    raise error


def compute_shared(
    shards: Shards,
    work: Work,
    order: Sequence[int],
    finished: Finished = lambda index, seconds: None,
    failed: Failed = unfinished_alone,
    report: Report = unreported,
    patient: bool = False,
) -> list[int]:
    """Compute chunks of `order` that are not there and that no other process has, until there are none.

    **Arguments:**

    - `patient`: wait for those that others have: where one of them dies, its chunk is taken over.

    **Returns:** the indices of those that others still have.
    """
    left = list(order)
    while True:
        there = shards.there()
        left = [index for index in left if index not in there]
        mine = next((index for index in left if shards.claim(index)), None)
        if mine is None:
            if not left or not patient:
                return left
            time.sleep(POLLED)
            continue
        try:
            features = work.compute(mine, report)
            shards.write(mine, features)
        except InputError:
            raise
        except Exception as error:
            shards.failed(mine, f"{type(error).__name__}: {error}")
            left.remove(mine)
            failed(mine, error)
        else:
            finished(mine, float(features[SECONDS]))
        finally:
            shards.let_go(mine)
