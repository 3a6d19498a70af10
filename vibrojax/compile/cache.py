"""Disk cache of compiled kernels and their descriptions, in the user's cache folder.

A cached kernel is machine code that this process runs. Whoever can write the file can thus run code with the rights of
the user. There are two safeguards:

- Only files that nobody but the user can have written are loaded. The file and the folder `kernels` must belong to the
  user, and neither group nor others may write to them. An access control list that grants more rights shows in the
  group's permission bits. Owner and permissions are checked on open descriptors. The file is opened relative to the
  folder's descriptor, without following symbolic links. The folders above `kernels` therefore do not matter: renaming
  `kernels` does not make another folder belong to the user. This holds in `/tmp` as well, where the sticky bit is set.
  A parent folder that everybody can write to and that lacks the sticky bit is rejected nevertheless, because such
  permissions are a mistake.
- A hash of key and content detects damage and mix-ups: an incomplete file, a flipped bit, a file under the wrong key.
  The hash does not protect against an attacker, who can compute it too.

If a file or folder is rejected, its kernels are compiled again and its path is logged once (`--verbose`). Where files
have no POSIX owners (Windows), nothing is cached.
"""

import os
import re
import secrets
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from platformdirs import user_cache_path

from vibrojax.progress import LOG

CACHE_VARIABLE = "VIBROJAX_CACHE"
"""Environment variable for the path of another cache folder, or to turn the cache off ("off", "0", "no", "none")."""

KEPT_BYTES, KEPT_DAYS = 100e6, 90
"""Limits of total size and unused age: the kernels of a study fit, and those of an abandoned version are deleted."""

MAGIC = b"vibrojax kernel 1\n"
"""First bytes of every cache file."""

HEADER = len(MAGIC) + sha256().digest_size
"""Length of the header of a cache file [bytes]: magic bytes and hash."""

KEY, TEMPORARY = re.compile(r"[0-9a-f]{64}"), ".vibrojax-"
"""Names of cache files: a SHA-256 hash, and the prefix of files that are being written."""

HALF_WRITTEN_SECONDS = 3600
"""Age [s] above which a temporary file is deleted as a leftover of a killed process."""

_refused: set[Path] = set()
"""Folders whose rejection has been logged."""

T = TypeVar("T")


class CacheRefused(Exception):
    """A folder or file was rejected because it is damaged or because another user may have written it."""


def user_folder() -> Path | None:
    """Return the cache folder of this package, or None if the cache is off."""
    chosen = os.environ.get(CACHE_VARIABLE, "")
    if chosen.lower() in ("off", "0", "no", "none") or not hasattr(os, "geteuid"):
        return None
    return Path(chosen).expanduser() if chosen else user_cache_path("vibrojax", appauthor=False)


def folder() -> Path | None:
    """Return the folder of cached kernels, or None if the cache is off."""
    path = user_folder()
    return None if path is None else path / "kernels"


def read(key: str) -> bytes | None:
    """Return the cached content of a key, or None if there is none that can be trusted."""

    def content(path: Path, where: int) -> bytes:
        with os.fdopen(open_own(path / key, stat.S_ISREG, os.O_NONBLOCK, where), "rb") as file:
            whole = file.read()
        if whole[:HEADER] != MAGIC + _digest(key, whole[HEADER:]):
            raise CacheRefused(f"{path / key}: is damaged, or does not belong under this name")
        with suppress(OSError):
            os.utime(key, dir_fd=where)  # the least recently used files are deleted first
        return whole[HEADER:]

    return _in_folder(content)


def write(key: str, content: bytes) -> None:
    """Cache content under a key, completely or not at all, and delete old files."""

    def replace(path: Path, where: int) -> None:
        temporary = f"{TEMPORARY}{secrets.token_hex(8)}"
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=where)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(MAGIC + _digest(key, content) + content)
            os.replace(temporary, key, src_dir_fd=where, dst_dir_fd=where)
        except BaseException:
            os.unlink(temporary, dir_fd=where)
            raise
        _delete_old(where)

    path = folder()
    if path is not None:
        with suppress(OSError):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            path.mkdir(mode=0o700, exist_ok=True)
        _in_folder(replace)


def _in_folder(use: Callable[[Path, int], T]) -> T | None:
    """Return `use(folder, descriptor)` of the opened cache folder; None if it cannot be used or is not trusted."""
    path = folder()
    if path is None:
        return None
    try:
        above = os.stat(path.parent)
        if above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX:
            raise CacheRefused(f"{path.parent}: others can write to it")
        descriptor = open_own(path, stat.S_ISDIR, os.O_DIRECTORY)
        try:
            return use(path, descriptor)
        finally:
            os.close(descriptor)
    except CacheRefused as refusal:
        if path not in _refused:
            _refused.add(path)
            LOG.info("cache refused: %s; kernels are compiled again", refusal)
    except OSError:
        pass
    return None


def open_own(
    path: Path,
    is_kind: Callable[[int], bool],
    flags: int = 0,
    where: int | None = None,
    refused: int = stat.S_IWGRP | stat.S_IWOTH,
) -> int:
    """Return the descriptor of a file or folder, or of a file in the folder with the descriptor `where`.

    **Raises:** `CacheRefused` if it belongs to another user, has one of the `refused` permissions, by default those of
    others to write it, or is of another kind; `FileNotFoundError`.
    """
    flags |= os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        descriptor = os.open(path if where is None else path.name, flags, dir_fd=where)
    except FileNotFoundError:
        raise
    except OSError as error:  # not a folder, a symbolic link, or unreadable because it belongs to another user
        raise CacheRefused(f"{path}: {error.strerror}") from None
    status = os.fstat(descriptor)
    problems = {
        "is not a regular file": not is_kind(status.st_mode),
        "belongs to another user": status.st_uid != os.geteuid(),
        "others can write to it": status.st_mode & refused,
    }
    for problem, applies in problems.items():
        if applies:
            os.close(descriptor)
            raise CacheRefused(f"{path}: {problem}")
    return descriptor


def _digest(key: str, content: bytes) -> bytes:
    return sha256(key.encode() + b"\n" + content).digest()


def _delete_old(where: int) -> None:
    """Delete kernels that have not been used for `KEPT_DAYS`, and leftover temporary files.

    If the total size exceeds `KEPT_BYTES`, the least recently used kernels are deleted as well. Everything else in the
    folder stays: folders, links, files with other names, and files that do not begin with `MAGIC`.
    """
    with os.scandir(where) as entries:
        files = [(entry.name, entry.stat(follow_symlinks=False)) for entry in entries]
    total, now = 0, time.time()
    for name, status in sorted(files, key=lambda file: -file[1].st_mtime):
        age = now - status.st_mtime
        if not stat.S_ISREG(status.st_mode):
            continue
        if KEY.fullmatch(name):
            total += status.st_size
            drop = (age > 86400 * KEPT_DAYS or total > KEPT_BYTES) and _is_own(where, name)
        else:
            drop = name.startswith(TEMPORARY) and age > HALF_WRITTEN_SECONDS
        if drop:
            with suppress(OSError):
                os.unlink(name, dir_fd=where)


def _is_own(where: int, name: str) -> bool:
    """Return whether a file begins with `MAGIC`."""
    with suppress(OSError), os.fdopen(os.open(name, os.O_RDONLY | os.O_NOFOLLOW, dir_fd=where), "rb") as file:
        return file.read(len(MAGIC)) == MAGIC
    return False
