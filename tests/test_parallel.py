"""Test threads that share calls: each call runs once, in at most one thread per worker, and no thread waits idle."""

import threading
import time

import pytest

from vibrojax.lanes.parallel import free_threads, in_parallel

WORKERS = ["a", "b", "c"]


def nested(inner: int, call):
    """Return a work function that makes `inner` calls of its own and returns their sum."""

    def work(_, item):
        parts = in_parallel(lambda worker, k: call(worker, item, k), range(inner), WORKERS)
        return sum(result for _, result in parts)

    return work


@pytest.mark.parametrize("outer", [1, 2, 3, 7])
def test_inner_calls_run_once_in_same_threads(outer):
    seen, threads = [], set()

    def call(worker, item, k):
        seen.append((item, k))
        threads.add((threading.get_ident(), worker))
        time.sleep(1e-4)
        return 10 * item + k

    results = dict(in_parallel(nested(5, call), range(outer), WORKERS))
    assert results == {item: 50 * item + 10 for item in range(outer)}
    assert sorted(seen) == [(item, k) for item in range(outer) for k in range(5)]
    assert len(threads) <= len(WORKERS)


def test_idle_thread_takes_inner_calls():
    """Two inner calls wait for each other. One runs in the item's thread, the other in an idle thread."""
    meeting = threading.Barrier(2, timeout=20)
    assert len(dict(in_parallel(nested(2, lambda *_: bool(meeting.wait() >= 0)), [0], ["a", "b"]))) == 1


def test_error_in_inner_call_is_raised_and_stops_threads():
    before = set(threading.enumerate())

    def call(worker, item, k):
        if (item, k) == (1, 3):
            raise OSError("on purpose")
        return 0

    with pytest.raises(OSError, match="on purpose"):
        list(in_parallel(nested(5, call), range(4), WORKERS))
    for thread in set(threading.enumerate()) - before:
        thread.join(20)
        assert not thread.is_alive()


def test_number_of_free_threads():
    """Outside a parallel call all threads are free. Inside, only idle ones are, and all once no item waits."""
    assert free_threads(3) == 3
    barrier, free_by_item = threading.Barrier(3), {}

    def work(worker, item):
        free_by_item[item] = free_threads(3)
        if item < 3:
            barrier.wait(20)

    list(in_parallel(work, range(4), WORKERS))
    assert free_by_item == {0: 1, 1: 1, 2: 1, 3: 3}
