"""Clean-up after an interrupt, which ends the command without waiting for its threads."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

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
    """Call the registered actions and ignore their errors."""
    for action in list(_ACTIONS):
        with suppress(Exception):
            action()
