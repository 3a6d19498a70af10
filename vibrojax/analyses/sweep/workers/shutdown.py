"""What is still to be done when an interrupt ends the command, which waits for none of its threads."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_LEFT: list[Callable[[], object]] = []


@contextmanager
def on_leaving(do: Callable[[], object]) -> Iterator[None]:
    """Have `do` called where the process leaves while this context lasts."""
    _LEFT.append(do)
    try:
        yield
    finally:
        _LEFT.remove(do)


def leave() -> None:
    """Do what is left to do; what fails in it is not waited for."""
    for do in list(_LEFT):
        with suppress(Exception):
            do()
