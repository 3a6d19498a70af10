"""Seals of datasets: this process reads datasets whose seal names this user and account, and copies of all others.

A seal is a digest that shows damage, and a code that shows that this user wrote the dataset. It is part of the file and
not of the dataset: bytes after the end of an HDF5 file, which its readers ignore, and a key of the file `.zmetadata` of
a store. Whatever changes a dataset with another tool writes it without the seal, and the dataset then opens as one of
unknown origin. A flipped bit, a lost block or a truncated end breaks the seal. The code is an HMAC of the digest with a
secret in the cache folder (see [vibrojax.compile.cache][]).

A dataset of unknown origin is read in a process of its own, which damage and hostile content cannot outlive
(`untrusted_copy.py`). In this process, HDF5 would hold its lock for good where a damaged file makes it loop, and every
later file would wait. The metadata of a Zarr store are checked before a library opens it, because they name code that
decodes its chunks.
"""

import hashlib
import hmac
import json
import os
import re
import secrets
import stat
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import netCDF4

from vibrojax.compile.cache import CacheRefused, open_own, user_folder
from vibrojax.errors import InputError, printable, shown
from vibrojax.io.files import read_regular
from vibrojax.threads import in_own_thread

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

_HDF5 = b"\x89HDF\r\n\x1a\n"
_END_ADDRESS = {0: 40, 1: 44, 2: 28, 3: 28}
"""Position of the address of the file's end in the superblock of HDF5, by its version."""


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
    if given is not None:
        stated, code = given
        if stated == _digest(path, leave_out=_LENGTH):
            secret = _secret()
            return secret is not None and hmac.compare_digest(code, hmac.digest(secret, stated, "sha256"))
    elif path.is_dir():
        return False
    else:
        with open(path, "rb") as file:
            start = file.read(64)
        end = _END_ADDRESS.get(start[8]) if len(start) == 64 and start.startswith(_HDF5) else None
        # The superblock states the length of the file: what follows and is no seal is a broken one.
        if end is None or os.path.getsize(path) <= struct.unpack_from("<Q", start, end)[0]:
            return False
    problem = "is damaged: its content is not what was written"
    raise InputError(f"{path}: {problem}; take a copy, or compute it again (remove the file first)")


def seal_of(path: Path) -> tuple[bytes, bytes] | None:
    """Return the seal of a file or store, broken or not: SHA-256 of its content and code; None if it has none."""
    if path.is_dir():
        stated = _metadata(path).get(KEY)
        if stated is None:
            return None
        with suppress(ValueError, TypeError, LookupError):
            return bytes.fromhex(stated["sha256"]), bytes.fromhex(stated["code"])
        return b"", b""
    with open(path, "rb") as file, suppress(OSError):  # the file is shorter
        file.seek(-_LENGTH, os.SEEK_END)
        end = file.read(_LENGTH)
        if end.startswith(MAGIC):
            return end[len(MAGIC) : -_SIZE], end[-_SIZE:]
    return None


def _metadata(path: Path) -> dict[str, Any]:
    return dict(json.loads(read_regular(path / METADATA, LARGEST_METADATA)))


def _digest(path: Path, leave_out: int = 0) -> bytes:
    """Return the SHA-256 of a file, but for its last `leave_out` bytes, or of a store, but for its seal."""
    if not path.is_dir():
        digest, size = hashlib.sha256(), os.path.getsize(path) - leave_out
        with open(path, "rb") as file:
            while size > 0 and (piece := file.read(min(1 << 20, size))):
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
    folder = user_folder()
    if folder is None:
        return None
    path, new = folder / "seal", folder / f".seal-{secrets.token_hex(8)}"
    try:
        if not path.exists():
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(secrets.token_bytes(_SIZE))
            with suppress(FileExistsError):
                os.link(new, path)  # of several processes, the first one decides
            new.unlink()
        with os.fdopen(open_own(path, stat.S_ISREG, refused=stat.S_IRWXG | stat.S_IRWXO), "rb") as file:
            secret = file.read(_SIZE + 1)
    except (OSError, CacheRefused):
        return None
    return secret if len(secret) == _SIZE else None


LAZY_FROM = 128e6
"""Size of a dataset [bytes] above which its variables are read lazily."""

MOST_PACKED = 2000
"""Largest accepted ratio of dataset size to file size: zlib reaches 1000; a malicious file may claim any size."""

PROCESSOR_SECONDS, SLOWEST = 6.0, 2e7
"""Processor time for reading a file: a constant [s], plus the file size divided by `SLOWEST` [bytes/s]."""

_OVERLOAD = 5.0
"""Ratio of elapsed time to processor time above which a file that does not end is given up."""

TYPES = re.compile(r"[<>|][biufSU]\d+")
"""Types of values: booleans, integers, floats, and strings of fixed length."""

COMPRESSORS = ("blosc", "zstd", "zlib", "gzip", "bz2", "lz4")
"""Compressors that only decompress; others may run code."""


@contextmanager
def readable(path: Path) -> Iterator[Path]:
    """Yield the path from which this process may read a dataset: `path` if the user's seal is intact, else a copy.

    The copy lasts as long as the `with` block. Of a dataset above `LAZY_FROM`, the first and last values are tried, and
    `path` is returned.

    **Raises:** `InputError` if the dataset is damaged, refers to other files, or takes too much time or memory.
    """
    if path.is_dir():
        check_store(path)
    if in_own_thread(lambda: is_own(path)):
        yield path
        return
    with TemporaryDirectory(prefix="vibrojax-") as folder:
        copy = Path(folder) / f"copy{path.suffix}"
        yield copy if in_own_thread(lambda: _copied(path, copy)) else path


def global_attributes(path: Path) -> dict[str, Any]:
    """Return the attributes of a dataset in a file or store.

    **Raises:** `InputError` if no dataset is there, or it cannot be read.
    """
    if not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: is not a dataset")

    def read(source: Path) -> dict[str, Any]:
        with netCDF4.Dataset(source) as dataset:
            return {name: dataset.getncattr(name) for name in dataset.ncattrs()}

    try:
        with readable(path) as source:
            if not source.is_dir():
                return in_own_thread(lambda: read(source))
            attributes = json.loads(read_regular(source / ".zattrs", LARGEST_METADATA))
            return attributes if isinstance(attributes, dict) else {}
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: its attributes cannot be read ({type(error).__name__})") from None


def _copied(path: Path, copy: Path) -> bool:
    """Copy a dataset; return False if it is too large to be copied."""
    kind = "as Zarr" if path.is_dir() else "as netCDF"
    size = sum(file.stat().st_size for file in path.rglob("*")) if path.is_dir() else path.stat().st_size
    seconds = PROCESSOR_SECONDS + size / SLOWEST
    limits = (f"{LAZY_FROM:g}", str(MOST_PACKED), f"{seconds:.0f}")
    script = Path(__file__).with_name("untrusted_copy.py")
    words = [sys.executable, "-P", str(script), str(path.absolute()), str(copy), *limits]
    try:
        ended = subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=_OVERLOAD * seconds
        )
        answer = json.loads(ended.stdout.splitlines()[-1])
    except (subprocess.TimeoutExpired, IndexError, ValueError):  # killed by a limit, or by what it read
        why = f"its structure is damaged, or this machine is overloaded; the limit is {seconds:.0f} s"
        raise InputError(f"{path}: cannot be read {kind}: {why}") from None
    if problem := answer.get("problem"):
        raise InputError(f"{path}: cannot be read {kind} ({printable(problem, 200)})")
    return not answer["large"]


def check_store(path: Path) -> None:
    """Raise `InputError` if a store is not of format 2, or has types, codecs or links that this package never writes.

    Of other codecs, some run code that the store contains (pickle).
    """
    for file in path.rglob("*"):
        if file.is_symlink() or not (file.is_file() or file.is_dir()):
            raise InputError(f"{path}: {shown(file.name)} is a link or a device; a store has files and folders only")
        if file.name == "zarr.json":
            raise InputError(f"{path}: is a Zarr store of format 3; write it with zarr_format=2")
    try:
        entries = json.loads(read_regular(path / METADATA, LARGEST_METADATA))["metadata"].items()
        arrays = {key.removesuffix("/.zarray"): {**about} for key, about in entries if key.endswith(".zarray")}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: has no file {METADATA}; give a store that this package wrote") from None
    except (OSError, ValueError, LookupError, AttributeError, TypeError, RecursionError):
        raise InputError(f"{path}: its metadata are damaged") from None
    for name, about in arrays.items():
        filters, compressor = about.get("filters") or [], about.get("compressor")
        codecs = [codec.get("id") if isinstance(codec, dict) else codec for codec in filters]
        used = compressor.get("id") if isinstance(compressor, dict) else compressor
        is_text = (about.get("dtype"), *codecs) == ("|O", "vlen-utf8")  # strings of variable length
        dtype, what = str(about.get("dtype")), ""
        if not is_text and not TYPES.fullmatch(dtype):
            what = f"values of the type {shown(dtype)}; datasets hold numbers and text"
        elif codecs and not is_text:
            what = f"the filter {shown(codecs[0])}, which is not accepted"
        elif used is not None and used not in COMPRESSORS:
            what = f"the compressor {shown(used)}; accepted are {', '.join(COMPRESSORS)}"
        elif not name or "/" in name or name.startswith("."):
            what = "a name that is no variable's"
        if what:
            raise InputError(f"{path}: {shown(name)} has {what}")
