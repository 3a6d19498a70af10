"""A lock that keeps two processes from one output."""

import os
from pathlib import Path

from vibrojax.errors import InputError

try:
    import fcntl
except ImportError:  # no such locks on this system: two processes on one output are the user's care
    fcntl = None


class Lock:
    """An exclusive lock on the file at `path`, held until released; the system lets go of it when the process ends.

    Raises `InputError` where another holds it.
    """

    def __init__(self, path: Path):
        self.path = path
        self._file = _locked(path)

    def release(self, remove: bool = False) -> None:
        """Let go; with `remove`, the file goes first, while nobody else can have it."""
        if remove:
            self.path.unlink(missing_ok=True)
        os.close(self._file)


def _locked(path: Path) -> int:
    while True:
        file = _open(path)
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            line = f"{path.parent}: another process is at work there; wait for it, or give another output"
            raise InputError(line) from None
        except OSError:  # a file system without locks
            return file
        if _same(file, path):
            return file
        os.close(file)  # removed by its holder between open and lock: what is there now is another file


def _open(path: Path) -> int:
    try:
        path.parent.mkdir(exist_ok=True)  # another process may just have finished, and removed it
        return os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another output") from None


def _same(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.stat(path))
    except FileNotFoundError:
        return False
