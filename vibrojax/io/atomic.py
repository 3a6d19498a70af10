"""Atomic writes: under a temporary name, synced, then renamed, so that a file appears whole or not at all."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ZARR = ".zarr"
"""How the name of a dataset ends that is no file but a folder: a Zarr store."""


@contextmanager
def atomic_write(path: Path, ending: str = "tmp") -> Iterator[Path]:
    """The temporary name under which to write what becomes `path` when the block ends.

    Nothing is left of a block that fails; what a process that was killed has left of `path` is removed.

    **Arguments:**

    - `path`: the file to be.
    - `ending`: how the temporary name ends, for libraries that go by it.

    **Raises:** `OSError` where the disk or the folder does not take it.
    """
    temporary = re.compile(re.escape(f".{path.name}.") + r"(\d+)" + re.escape(f".{ending}"))
    for other in path.parent.iterdir():
        match = temporary.fullmatch(other.name)
        if match and not _runs(int(match[1])):
            other.unlink(missing_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.{ending}")
    try:
        yield part
        sync(part)
        os.replace(part, path)
        sync_folder(path.parent)
    finally:
        part.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Have the file's content on the disk."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk."""
    if os.name != "posix":  # elsewhere a folder cannot be opened
        return
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _runs(process: int) -> bool:
    """Whether the process of this number is running."""
    if os.name != "posix":  # elsewhere to ask is to end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        return True
    return True
