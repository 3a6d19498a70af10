"""Atomic writes: under a temporary name, synced, then renamed, so that a file appears whole or not at all."""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vibrojax.io.claims import GONE, process_start

ZARR = ".zarr"
"""Suffix of a dataset that is a folder, a Zarr store."""


@contextmanager
def atomic_write(path: Path, ending: str = "tmp") -> Iterator[Path]:
    """Yield the temporary name of a file that becomes `path` when the block ends.

    Nothing remains of a block that fails. Temporary files of `path` from killed processes are removed.

    **Arguments:**

    - `path`: the final name.
    - `ending`: suffix of the temporary name, for libraries that derive the format from it.

    **Raises:** `OSError` if the disk is full or the folder cannot be written.
    """
    temporary = re.compile(re.escape(f".{path.name}.") + r"(\d+)" + re.escape(f".{ending}"))
    for other in path.parent.iterdir():
        match = temporary.fullmatch(other.name)
        if match and process_start(int(match[1])) == GONE:
            other.unlink(missing_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.{ending}")
    try:
        yield part
        commit(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield the temporary folder that becomes `path` when the block ends; nothing remains of a block that fails."""
    part, before = (path.with_name(f".{path.name}.{kind}") for kind in ("tmp", "before"))
    for leftover in (part, before):  # by a process that was killed
        shutil.rmtree(leftover, ignore_errors=True)
    try:
        yield part
        for file in part.rglob("*"):
            if file.is_file():
                _sync(file)
        if path.exists():  # a folder does not replace another one
            path.rename(before)
        part.rename(path)
        _sync_folder(path.parent)
    finally:
        for leftover in (part, before):
            shutil.rmtree(leftover, ignore_errors=True)


def commit(part: Path, path: Path) -> None:
    """Rename the finished file `part` to `path`, with content and name on the disk when this returns."""
    _sync(part)
    os.replace(part, path)
    _sync_folder(path.parent)


def _sync(path: Path) -> None:
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":  # elsewhere a folder cannot be opened
        return
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
