"""Atomic writes: a file is written under a temporary name, synced, then renamed.

It therefore appears complete or not at all.
"""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vibrojax.io.claims import GONE, process_start

ZARR = ".zarr"
"""Suffix of a dataset stored as a folder (Zarr store)."""


@contextmanager
def atomic_write(path: Path, ending: str = "tmp") -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `path` when the `with` block ends, or deleted if the block raises.

    Temporary files for `path` left by killed processes are also removed. `ending` is the suffix of the temporary name,
    for libraries that derive the file format from the suffix.

    **Raises:** `OSError` if the disk is full or the folder is not writable.
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
    """Yield a temporary folder: renamed to `path` when the `with` block ends, or deleted if the block raises."""
    part, before = (path.with_name(f".{path.name}.{kind}") for kind in ("tmp", "before"))
    for leftover in (part, before):  # left by a killed process
        _remove(leftover)
    part.mkdir()  # raises `OSError` now if the parent folder is missing or not writable
    try:
        yield part
        for file in part.rglob("*"):
            if file.is_file():
                _sync(file)
        if path.exists():  # renaming cannot replace an existing folder
            path.rename(before)
        part.rename(path)
        _sync_folder(path.parent)
    finally:
        for leftover in (part, before):
            _remove(leftover)


def commit(part: Path, path: Path) -> None:
    """Rename the finished file `part` to `path`; on return, content and name are synced to disk."""
    _sync(part)
    os.replace(part, path)
    _sync_folder(path.parent)


def _remove(path: Path) -> None:
    """Remove a folder with all that it contains, or a file."""
    if path.is_file():
        path.unlink()
    shutil.rmtree(path, ignore_errors=True)


def _sync(path: Path) -> None:
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":  # other systems cannot open a folder
        return
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
