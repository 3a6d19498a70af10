"""Threads that share calls: every call is run once, by no more threads than there are workers, and none waits idle."""

import threading
import time

import pytest

from vibrojax.sweep.engine.parallel import free_threads, in_parallel

WORKERS = ["a", "b", "c"]


def nested(inner: int, call):
    """Work that makes `inner` calls of its own, and returns their sum."""

    def work(_, item):
        parts = in_parallel(lambda worker, k: call(worker, item, k), range(inner), WORKERS)
        return sum(result for _, result in parts)

    return work


@pytest.mark.parametrize("outer", [1, 2, 3, 7])
def test_inner_calls_run_once_in_the_same_threads(outer):
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


def test_a_thread_without_an_item_helps():
    """Two inner calls that wait for each other are run at the same time, by the thread of the item and a free one."""
    meeting = threading.Barrier(2, timeout=20)
    assert len(dict(in_parallel(nested(2, lambda *_: bool(meeting.wait() >= 0)), [0], ["a", "b"]))) == 1


def test_the_error_of_an_inner_call_is_raised_and_ends_the_threads():
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


def test_free_threads():
    """Outside of all threads: all of them. Inside: only idle ones while items wait, then all, idle soon."""
    assert free_threads(3) == 3
    together, inside = threading.Barrier(3), {}

    def work(worker, item):
        inside[item] = free_threads(3)
        if item < 3:
            together.wait(20)

    list(in_parallel(work, range(4), WORKERS))
    assert inside == {0: 1, 1: 1, 2: 1, 3: 3}
