"""Seals of datasets: a digest that shows damage, and a code that shows that this user wrote them on this account.

A seal is part of the file and not of the dataset: bytes after the end of an HDF5 file, which its readers ignore, and a
key of the file `.zmetadata` of a store. Whatever changes a dataset with another tool writes it without the seal, and
the dataset then opens as one of unknown origin. A flipped bit, a lost block or a truncated end breaks the seal.

The code is an HMAC of the digest with a secret in the cache folder (see [vibrojax.compile.cache][]). It tells
the user's own files, which are read in this process, from files of unknown origin, which a process of their own reads
(`io.untrusted`).
"""

import hashlib
import hmac
import json
import os
import secrets
import stat
import struct
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from platformdirs import user_cache_path

from vibrojax.errors import InputError
from vibrojax.io.files import read_regular

MAGIC = b"\nvibrojax seal 1\n"
"""First bytes of the seal of a file; the digest and the code follow."""

KEY = "vibrojax_seal"
"""Key of the seal in the metadata of a store."""

METADATA = ".zmetadata"
"""Name of the file with all metadata of a Zarr store of format 2."""

LARGEST_METADATA = 64 * 2**20
"""Greatest size of the metadata [bytes]."""

_SIZE = hashlib.sha256().digest_size
_LENGTH = len(MAGIC) + 2 * _SIZE
_PIECE = 1 << 20

_HDF5 = b"\x89HDF\r\n\x1a\n"
_END_ADDRESS = {0: 40, 1: 44, 2: 28, 3: 28}
"""Position of the address of the file's end in the superblock of HDF5, by its version."""


class Seal(NamedTuple):
    """The SHA-256 of the content of a file or store, and its code."""

    digest: bytes
    code: bytes


def seal(path: Path) -> None:
    """Seal a complete file or store; its content must not change afterwards."""
    digest = _digest(path)
    code = hmac.digest(_secret() or b"", digest, "sha256")
    if path.is_dir():
        metadata = _metadata(path) | {KEY: {"sha256": digest.hex(), "code": code.hex()}}
        (path / METADATA).write_text(json.dumps(metadata))
    else:
        with open(path, "ab") as file:
            file.write(MAGIC + digest + code)


def is_own(path: Path) -> bool:
    """Return whether this user wrote a file or store, and nothing has changed it since.

    **Raises:** `InputError` if the content is not what the seal states.
    """
    given = seal_of(path)
    if given is None:
        if not path.is_dir() and _continues(path):
            raise _damaged(path)  # something follows the end, and it is no seal
        return False
    if given.digest != _digest(path, leave_out=_LENGTH):
        raise _damaged(path)
    secret = _secret()
    return secret is not None and hmac.compare_digest(given.code, hmac.digest(secret, given.digest, "sha256"))


def seal_of(path: Path) -> Seal | None:
    """Return the seal of a file or store, broken or not, or None if it has none."""
    if path.is_dir():
        stated = _metadata(path).get(KEY)
        if stated is None:
            return None
        with suppress(ValueError, TypeError, LookupError):
            return Seal(bytes.fromhex(stated["sha256"]), bytes.fromhex(stated["code"]))
        return Seal(b"", b"")
    with open(path, "rb") as file, suppress(OSError):  # the file is shorter
        file.seek(-_LENGTH, os.SEEK_END)
        end = file.read(_LENGTH)
        if end.startswith(MAGIC):
            return Seal(end[len(MAGIC) : -_SIZE], end[-_SIZE:])
    return None


def _continues(path: Path) -> bool:
    """Return whether a file is longer than its HDF5 superblock says."""
    with open(path, "rb") as file:
        start = file.read(64)
    end = _END_ADDRESS.get(start[8]) if len(start) == 64 and start.startswith(_HDF5) else None
    return end is not None and os.path.getsize(path) > int(struct.unpack_from("<Q", start, end)[0])


def _damaged(path: Path) -> InputError:
    problem = "is damaged: its content is not what was written"
    return InputError(f"{path}: {problem}; take a copy, or compute it again (remove the file first)")


def _metadata(path: Path) -> dict[str, Any]:
    metadata: dict[str, Any] = json.loads(read_regular(path / METADATA, LARGEST_METADATA))
    return metadata


def _digest(path: Path, leave_out: int = 0) -> bytes:
    """Return the SHA-256 of a file, but for its last `leave_out` bytes, or of a store, but for its seal."""
    if not path.is_dir():
        digest, size = hashlib.sha256(), os.path.getsize(path) - leave_out
        with open(path, "rb") as file:
            while size > 0 and (piece := file.read(min(_PIECE, size))):
                digest.update(piece)
                size -= len(piece)
        return digest.digest()
    metadata = {key: value for key, value in _metadata(path).items() if key != KEY}
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    names = {file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file()}
    for name in sorted(names - {METADATA}):
        digest.update(json.dumps(name).encode() + _digest(path / name))
    return digest.digest()


@cache
def _secret() -> bytes | None:
    """Return the user's secret, which is made at its first use; None where no file can be private, or none is kept."""
    chosen = os.environ.get("VIBROJAX_CACHE", "")
    if chosen.lower() in ("off", "0", "no", "none") or not hasattr(os, "geteuid"):
        return None
    path = (Path(chosen).expanduser() if chosen else user_cache_path("vibrojax", appauthor=False)) / "seal"
    new = path.with_name(f".seal-{secrets.token_hex(8)}")
    try:
        if not path.exists():
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            handle = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "wb") as file:
                file.write(secrets.token_bytes(_SIZE))
            with suppress(FileExistsError):
                os.link(new, path)  # of several processes, the first one decides
            new.unlink()
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as file:
            status, secret = os.fstat(handle), file.read(_SIZE + 1)
    except OSError:
        return None
    private = stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o077
    return secret if private and len(secret) == _SIZE else None
