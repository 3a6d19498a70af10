"""A lock that keeps two processes from one output."""

from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from vibrojax.errors import InputError

_PATIENCE = 0.2
"""Seconds in which a process that is just ending may let go of the lock, and remove its file."""


class Lock:
    """An exclusive lock on the file at `path`, held until released; it is waited for so many seconds of `patience`.

    It is the system's own lock on the open file: the system lets go of it when the process ends, however it ends, so
    that the file that a killed process leaves behind keeps nobody out. A file system that has no locks goes without.

    **Raises:** `InputError` where another process holds it, or where the file cannot be written.
    """

    def __init__(self, path: Path, patience: float = _PATIENCE) -> None:
        self.path = path
        # Any thread may let go of it: a sweep runs in a thread of its own.
        self._lock = FileLock(path, timeout=patience, thread_local=False)
        try:
            self._lock.acquire()  # makes the folder again, if another process has just finished and removed it
        except Timeout:
            line = f"{path.parent}: another process is at work there; wait for it, or give another output"
            raise InputError(line) from None
        except OSError as error:
            if error.filename is not None:  # the file could not be opened, let alone locked
                raise InputError(f"{path}: cannot be written ({error.strerror}); give another output") from None

    def release(self, remove: bool = False) -> None:
        """Let go; with `remove`, the file goes first, while no other process can hold it."""
        if remove:
            with suppress(PermissionError):  # Windows keeps an open file, and removes it on release
                self.path.unlink(missing_ok=True)
        self._lock.release()


def is_held(path: Path) -> bool:
    """Whether a process has the lock at `path`; nothing is changed."""
    if not path.exists():
        return False
    try:
        with FileLock(path, timeout=0, thread_local=False):
            return False
    except (Timeout, OSError):
        return True
