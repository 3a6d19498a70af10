"""Test the threads: drivers whose calls share one pool, errors, interrupts, and the context of the caller."""

import threading
import time

import pytest

from vibrojax.compile.xla import threads, with_threads
from vibrojax.threads import by_drivers, in_parallel

WORKERS = ["a", "b", "c"]


def nested(inner: int, call):
    """Return a work function that makes `inner` calls of its own and returns their sum."""
    return lambda item: sum(
        result for _, result in in_parallel(lambda worker, k: call(worker, item, k), range(inner), WORKERS)
    )


@pytest.mark.parametrize("outer", [1, 2, 7])
def test_calls_of_drivers_run_once_in_one_pool(outer):
    seen, used = [], set()

    def call(worker, item, k):
        seen.append((item, k))
        used.add((threading.get_ident(), worker))
        time.sleep(1e-4)
        return 10 * item + k

    results = dict(by_drivers(nested(5, call), range(outer), 3))
    assert results == {item: 50 * item + 10 for item in range(outer)}
    assert sorted(seen) == [(item, k) for item in range(outer) for k in range(5)]
    assert len(used) <= len(WORKERS)


def test_calls_within_the_pool_run_at_once():
    """A call of the pool that waited for others of the pool might wait for ever."""
    results = in_parallel(
        lambda _, item: sum(dict(in_parallel(lambda _, k: k, range(4), WORKERS)).values()), range(9), WORKERS
    )
    assert dict(results) == dict.fromkeys(range(9), 6)


def test_error_is_raised_and_no_further_call_begins():
    begun = []

    def call(worker, item, k):
        begun.append((item, k))
        if item == 0:
            raise OSError("on purpose")
        time.sleep(0.01)

    with pytest.raises(OSError, match="on purpose"):
        list(by_drivers(nested(5, call), range(200), 3))
    time.sleep(0.1)
    count = len(begun)
    time.sleep(0.1)
    assert len(begun) == count < 200


def test_drivers_have_the_number_of_threads_of_their_caller():
    with with_threads(5):
        assert dict(by_drivers(lambda _: threads(), range(3), 2)) == dict.fromkeys(range(3), 5)
