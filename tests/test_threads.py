"""Test threads that share work: each item once, context variables of the caller, and no new call after an error."""

import time
from contextvars import ContextVar

import pytest

from vibrojax.threads import by_drivers, in_parallel

SETTING: ContextVar[int] = ContextVar("SETTING", default=0)


def test_each_item_is_computed_once():
    """Drivers may use the pool, and a thread of the pool computes its own items itself."""
    pool = ["first", "second"]

    def nested(worker: str, item: int) -> int:
        return sum(result for _, result in in_parallel(lambda _, x: x, range(item), pool))

    def drive(item: int) -> int:
        return sum(result for _, result in in_parallel(nested, range(item), pool)) + SETTING.get()

    SETTING.set(100)
    expected = {index: sum(k * (k - 1) // 2 for k in range(item)) + 100 for index, item in enumerate(range(9))}
    assert dict(by_drivers(drive, range(9), 3)) == expected


def test_no_call_begins_after_an_error():
    calls = []

    def work(item: int) -> None:
        calls.append(item)
        time.sleep(0.01)
        if item == 2:
            raise ValueError("wrong")

    with pytest.raises(ValueError, match="wrong"):
        list(by_drivers(work, range(100), 1))
    assert 3 <= len(calls) < 100
