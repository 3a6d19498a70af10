"""Atomic writes: a file is written under a temporary name, synced, then renamed.

It therefore appears complete or not at all.
"""

import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vibrojax.io.files import new_file
from vibrojax.io.identity import check_ours

ZARR = ".zarr"
"""Suffix of a dataset stored as a folder (Zarr store)."""


@contextmanager
def atomic_write(path: Path, ending: str = "tmp") -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `path` when the `with` block ends, or deleted if the block raises.

    The temporary file exists and is empty. Its name cannot be guessed, so that in a folder to which others can write,
    no link of theirs takes its place. Temporary files for `path` left by killed processes are removed. `ending` is the
    suffix of the temporary name, for libraries that derive the file format from the suffix.

    **Raises:** `OSError` if the disk is full or the folder is not writable; `InputError` if there is a file at `path`
    that this package has not written.
    """
    check_ours(path)
    part = _cleared(path, ending)
    new_file(part).close()
    try:
        yield part
        commit(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder: renamed to `path` when the `with` block ends, or deleted if the block raises.

    **Raises:** as for `atomic_write`.
    """
    restore(path)
    check_ours(path)
    part, before = _cleared(path, "tmp"), _cleared(path, "before")
    part.mkdir()  # raises `OSError` now if the parent folder is missing or not writable
    try:
        yield part
        for file in (*part.rglob("*"), part):
            _sync(file)
        if path.exists():  # renaming cannot replace an existing folder; if this process ends now, `restore` undoes it
            path.rename(before)
        try:
            part.rename(path)
        except BaseException:
            restore(path, before)
            raise
        _sync(path.parent)
    finally:
        _remove(part)
        _remove(before)


def restore(path: Path, before: Path | None = None) -> None:
    """Rename a folder back to `path` if the process that was replacing it has ended between two renames.

    `before`: the temporary name of the folder; None: look for it.
    """
    if path.exists():
        return
    leftovers = _leftovers(path, "before") if before is None else [before]
    for other in leftovers[:1]:
        with suppress(OSError):  # there is none, or another process has restored it
            other.rename(path)


def commit(part: Path, path: Path) -> None:
    """Rename the finished file `part` to `path`; on return, content and name are synced to disk."""
    _sync(part)
    os.replace(part, path)
    _sync(path.parent)


def _cleared(path: Path, ending: str) -> Path:
    """Remove the leftovers for `path`, and return a new temporary name next to it.

    The name states this machine, since processes of machines that share a folder may have the same number, the number
    of this process, and a random part.
    """
    for leftover in _leftovers(path, ending):
        _remove(leftover)
    return path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(8)}.{ending}")


def _leftovers(path: Path, ending: str) -> list[Path]:
    """Return what processes of this machine that have ended left for `path` under temporary names."""
    prefix, suffix = (re.escape(text) for text in (f".{path.name}.{socket.gethostname()}-", f".{ending}"))
    temporary = re.compile(rf"{prefix}(\d+)-[0-9a-f]{{16}}{suffix}")
    names = ((other, temporary.fullmatch(other.name)) for other in path.parent.iterdir())
    return [other for other, match in names if match and _has_ended(int(match[1]))]


def _has_ended(process: int) -> bool:
    """Return whether a process of this machine is known to have ended."""
    with suppress(OSError):  # no such process, or a system without /proc
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # a process of another user
        pass
    return False


def _remove(path: Path) -> None:
    """Remove a folder with all that it contains, or a file or link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
