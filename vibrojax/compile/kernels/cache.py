"""Disk cache, in the user's cache folder, of compiled kernels and of the results of their comparison with XLA.

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
have no POSIX owners (Windows), only the hash is checked: a user's own cache folder is private there.
"""

import os
import re
import secrets
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from platformdirs import user_cache_path

from vibrojax.progress import LOG

CACHE_VARIABLE = "VIBROJAX_CACHE"
"""Environment variable for the path of another cache folder, or for one of `CACHE_OFF`."""

CACHE_OFF = ("off", "0", "no", "none")
"""Values of the environment variable that turn the cache off."""

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

HAS_OWNERS = hasattr(os, "geteuid")
"""True if files have POSIX owners."""

_refused: set[Path] = set()
"""Folders whose rejection has been logged."""


class CacheRefused(Exception):
    """A folder or file was rejected because it is damaged or because another user may have written it."""


class Folder(NamedTuple):
    """A cache folder and its open descriptor (None if files have no POSIX owners)."""

    path: Path
    descriptor: int | None

    def name(self, file: str) -> str | Path:
        """Return a file's path for calls with `dir_fd=descriptor`."""
        return file if self.descriptor is not None else self.path / file


def folder() -> Path | None:
    """Return the folder of cached kernels, or None if the cache is off."""
    chosen = os.environ.get(CACHE_VARIABLE, "")
    if chosen.lower() in CACHE_OFF:
        return None
    return (Path(chosen).expanduser() if chosen else user_cache_path("vibrojax", appauthor=False)) / "kernels"


def read(key: str) -> bytes | None:
    """Return the cached content of a key, or None if there is none that can be trusted."""
    path = folder()
    if path is None:
        return None
    try:
        with _open_folder(path) as where:
            content = _read_file(where, key)
            with suppress(OSError):
                os.utime(where.name(key), dir_fd=where.descriptor)  # the least recently used files are deleted first
            return content
    except CacheRefused as refusal:
        _log_once(path, refusal)
    except OSError:
        pass
    return None


def write(key: str, content: bytes) -> None:
    """Cache content under a key, completely or not at all, and delete old files."""
    path = folder()
    if path is None:
        return
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.mkdir(mode=0o700, exist_ok=True)
        with _open_folder(path) as where:
            _write_file(where, key, MAGIC + _digest(key, content) + content)
            _delete_old(where)
    except CacheRefused as refusal:
        _log_once(path, refusal)
    except OSError:
        pass


@contextmanager
def _open_folder(path: Path) -> Iterator[Folder]:
    """Open a cache folder.

    **Raises:** `CacheRefused` if the folder cannot be trusted, `OSError` if the folder does not exist.
    """
    if not HAS_OWNERS:
        yield Folder(path, None)
        return
    above = os.stat(path.parent)
    if above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX:
        raise CacheRefused(f"{path.parent}: others can write to it")
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        raise
    except OSError as error:  # not a folder, a symbolic link, or an unreadable folder of another user
        raise CacheRefused(f"{path}: {error.strerror}") from None
    try:
        _check_owner(descriptor, path)
        yield Folder(path, descriptor)
    finally:
        os.close(descriptor)


def _read_file(where: Folder, key: str) -> bytes:
    """Return the content of the file for a key.

    **Raises:** `CacheRefused` if others may have written the file, if it is damaged, or if it belongs to another key.
    """
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        descriptor = os.open(where.name(key), flags | getattr(os, "O_BINARY", 0), dir_fd=where.descriptor)
    except FileNotFoundError:
        raise
    except OSError as error:  # a symbolic link, or a file that only another user can read
        raise CacheRefused(f"{where.path / key}: {error.strerror}") from None
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise CacheRefused(f"{where.path / key}: is not a regular file")
        if HAS_OWNERS:
            _check_owner(descriptor, where.path / key)
        whole = file.read()
    header, content = whole[:HEADER], whole[HEADER:]
    if header != MAGIC + _digest(key, content):
        raise CacheRefused(f"{where.path / key}: is damaged, or does not belong under this name")
    return content


def _write_file(where: Folder, key: str, whole: bytes) -> None:
    """Write a file that only the user can read. It has a temporary name until it is complete."""
    temporary = where.name(f"{TEMPORARY}{secrets.token_hex(8)}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    handle = os.open(temporary, flags, 0o600, dir_fd=where.descriptor)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(whole)
        os.replace(temporary, where.name(key), src_dir_fd=where.descriptor, dst_dir_fd=where.descriptor)
    except BaseException:
        os.unlink(temporary, dir_fd=where.descriptor)
        raise


def _check_owner(descriptor: int, path: Path) -> None:
    """Raise `CacheRefused` unless an open file or folder belongs to this user and nobody else can write to it."""
    status = os.fstat(descriptor)
    if status.st_uid != os.geteuid():
        raise CacheRefused(f"{path}: belongs to another user")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise CacheRefused(f"{path}: others can write to it")


def _digest(key: str, content: bytes) -> bytes:
    return sha256(key.encode() + b"\n" + content).digest()


def _log_once(path: Path, refusal: CacheRefused) -> None:
    """Log the first rejection of a folder or of a file in the folder."""
    if path not in _refused:
        _refused.add(path)
        LOG.info("cache refused: %s; kernels are compiled again", refusal)


def _delete_old(where: Folder) -> None:
    """Delete kernels that have not been used for `KEPT_DAYS`, and leftover temporary files.

    If the total size exceeds `KEPT_BYTES`, the least recently used kernels are deleted as well. Everything else in the
    folder stays: folders, links, files with other names, and files that do not begin with `MAGIC`.
    """
    with os.scandir(where.path if where.descriptor is None else where.descriptor) as entries:
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
                os.unlink(where.name(name), dir_fd=where.descriptor)


def _is_own(where: Folder, name: str) -> bool:
    """Return whether a file begins with `MAGIC`."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    with suppress(OSError), os.fdopen(os.open(where.name(name), flags, dir_fd=where.descriptor), "rb") as file:
        return file.read(len(MAGIC)) == MAGIC
    return False
