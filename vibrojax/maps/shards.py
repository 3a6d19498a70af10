"""Finished chunks of a sweep, stored as files (shards) next to its output, so that no computed chunk is lost."""

import hashlib
import json
import math
import os
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout
from jaxtyping import Shaped

from vibrojax.errors import InputError, counted
from vibrojax.io.atomic import commit
from vibrojax.io.files import new_file
from vibrojax.io.manifest import MANIFEST, canonical, changes_since, digest, is_manifest

LOCK = "lock"
"""Name of the lock file in a folder of chunks."""

CHUNKS = ".chunks"
"""Suffix of the folder of chunks next to an output file."""

_LOCK_PATIENCE = 0.2
"""Time [s] to wait for the lock, so that a process that is just ending can release it and remove its file."""

_HEADER_SIZE = 1 << 16
"""Largest header [bytes] that is parsed: each of the many arrays takes about 40."""

_NUMBERS = re.compile(r"[<>|][biuf]\d")
"""Types of the arrays that are stored: booleans and real numbers."""

_WRITE_ATTEMPTS = 5
"""Times that a file is written anew while the user removes its folder; removing a folder takes milliseconds."""

_DAMAGES_SHOWN = 3
_DIGEST_SIZE = hashlib.sha256().digest_size

SHARD = re.compile(r"chunk-(\d{8,})\.shard")
"""Pattern of the file name of a finished chunk; its group is the chunk's index."""

_LEFTOVER = re.compile(r"(manifest\.json|chunk-\d{8,}\.shard)(\.\d+)*\.tmp")
"""Unfinished files of a killed process, which a new run removes. Other files stay."""

Arrays = Mapping[str, Shaped[np.ndarray, "..."]]
"""The arrays of a chunk by name: features of shape (lanes,) or (lanes, rows)."""


class DamagedShard(Exception):
    """Error of a shard that is missing, truncated or changed; its chunk is computed again."""


class Shards:
    """The finished chunks of one sweep, as immutable files in one folder.

    Each file consists of the SHA-256 of (manifest, index, content), followed by the content: a line of JSON with the
    type and shape of each array by name, then the arrays' bytes in this order. A file with another manifest or index, a
    truncated file or a flipped bit is therefore detected. The chunk then counts as missing. (It is not an npy file,
    because numpy parses the header of one with `ast`, which fails in Python 3.11 when two threads use it at once:
    CPython issue 106905.)

    **Arguments:**

    - `folder`: the folder `OUT.nc.chunks`.
    - `manifest`: everything that the results depend on, as JSON values.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, object]) -> None:
        self.folder = folder
        self.manifest: dict[str, object] = json.loads(canonical(manifest))
        self._digest = digest(self.manifest)
        self._lock: FileLock | None = None

    def open(self, resume: bool) -> None:
        """Prepare the folder for exclusive use by this process.

        With `resume`, finished chunks are kept; otherwise they are removed.

        **Raises:** `InputError` if another process is working there, the folder is not writable, or, with `resume`, the
        chunks belong to another manifest.
        """
        self._make_folder()
        self._lock = _locked(self.folder / LOCK)
        try:
            if resume:
                self._check_manifest()
            self._clear(shards=not resume)
            self._write_manifest()
        except BaseException:
            self.close()
            raise

    def finished(self) -> set[int]:
        """Return the indices of the intact chunks; report damaged chunks on stderr."""
        whole, damages = set[int](), list[str]()
        for index in sorted(self.there()):
            try:
                self._content(index)
                whole.add(index)
            except DamagedShard as damage:
                damages.append(str(damage))
        if more := damages[_DAMAGES_SHOWN:]:
            damages[_DAMAGES_SHOWN:] = [
                f"{self.folder}: {counted(len(more), 'more chunk is', 'more chunks are')} damaged"
            ]
        for line in damages:
            report_damage(line)
        return whole

    def there(self) -> set[int]:
        """Return the indices of the existing chunks, without verifying that they are intact."""
        try:
            return {int(match[1]) for match in map(SHARD.fullmatch, os.listdir(self.folder)) if match}
        except FileNotFoundError:  # the sweep is finished, and the folder removed
            return set()

    def write(self, index: int, arrays: Arrays) -> None:
        """Store the arrays of a chunk; on return, the file is complete on the disk."""
        header = json.dumps({name: (x.dtype.str, x.shape) for name, x in arrays.items()}).encode() + b"\n"
        content = b"".join([header, *(x.tobytes() for x in arrays.values())])
        self._put(self._path(index), self._checksum(index, content), content)

    def read(self, index: int) -> dict[str, np.ndarray]:
        """Return the arrays of a chunk by name.

        **Raises:** `DamagedShard` if the file is missing or damaged.
        """
        content = self._content(index)
        try:
            return _arrays(content)
        except Exception as error:  # a malformed header causes many types of exceptions
            raise DamagedShard(f"{self._path(index)}: cannot be read ({type(error).__name__})") from None

    def remove(self) -> None:
        """Remove the chunks and release the folder; remove the folder, too, unless it holds other files."""
        self._clear(shards=True)
        (self.folder / MANIFEST).unlink(missing_ok=True)
        with suppress(InputError):  # another process has just locked the folder
            self._lock = self._lock or _locked(self.folder / LOCK)
            with suppress(PermissionError):  # Windows cannot delete an open file; releasing the lock removes it
                (self.folder / LOCK).unlink(missing_ok=True)  # while no other process can hold the lock
        self.close()
        with suppress(OSError):  # the folder holds other files
            self.folder.rmdir()

    def close(self) -> None:
        """Release the folder and keep its content."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> "Shards":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _path(self, index: int) -> Path:
        return self.folder / f"{_chunk_name(index)}.shard"

    def _checksum(self, index: int, content: bytes | memoryview) -> bytes:
        digest = hashlib.sha256(f"{self._digest} {index}\n".encode())
        digest.update(content)
        return digest.digest()

    def _content(self, index: int) -> memoryview:
        """Return the content of a shard after verifying its checksum."""
        path = self._path(index)
        try:
            data = memoryview(path.read_bytes())
        except OSError as error:
            raise DamagedShard(f"{path}: cannot be read ({error.strerror})") from None
        if self._checksum(index, data[_DIGEST_SIZE:]) != data[:_DIGEST_SIZE]:
            raise DamagedShard(f"{path}: damaged")
        return data[_DIGEST_SIZE:]

    def _put(self, path: Path, *parts: bytes | memoryview) -> None:
        """Write a file that is complete or absent, even after a power failure.

        A folder that the user removes meanwhile is made again, and the file is then written once more.
        """
        temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
        for attempt in reversed(range(_WRITE_ATTEMPTS)):
            self.folder.mkdir(exist_ok=True)
            try:
                with new_file(temporary) as file:
                    file.writelines(parts)
                commit(temporary, path)
                return
            except OSError as error:  # an error while writing does not state the file name
                temporary.unlink(missing_ok=True)
                if attempt and isinstance(error, FileNotFoundError):
                    continue
                raise OSError(error.errno, error.strerror, str(path)) from None

    def _clear(self, shards: bool) -> None:
        """Remove leftovers of killed processes and, with `shards`, the finished chunks; other files stay."""
        for path in self.folder.iterdir():
            if _LEFTOVER.fullmatch(path.name) or (shards and SHARD.fullmatch(path.name)):
                path.unlink(missing_ok=True)

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            line = f"{self.folder}: cannot be made a folder ({error.strerror}); give another output"
            raise InputError(line) from None
        manifest = self.folder / MANIFEST
        if manifest.exists() and not self.there() and not is_manifest(manifest):
            line = f"{manifest}: exists already, and does not say that vibrojax wrote it"
            raise InputError(f"{line}; give another output, or remove it")

    def _write_manifest(self) -> None:
        content = {"sha256": self._digest, "manifest": self.manifest}
        self._put(self.folder / MANIFEST, json.dumps(content, indent=1).encode())

    def _check_manifest(self) -> None:
        """Raise `InputError` if the chunks belong to another sweep.

        Without an intact manifest file, the checksum of each chunk detects chunks of another sweep.
        """
        differences = changes_since(self.folder / MANIFEST, self.manifest)
        if differences and self.there():
            advice = "--fresh starts over, or give another output"
            raise InputError(f"{self.folder}: holds chunks of another sweep: {differences}; {advice}")


def _arrays(content: memoryview) -> dict[str, np.ndarray]:
    """Return the arrays of the content of a shard, which may come from anywhere."""
    header, line_end, _ = bytes(content[:_HEADER_SIZE]).partition(b"\n")
    if not line_end:
        raise ValueError("no header")
    arrays, begin = dict[str, np.ndarray](), len(header) + 1
    for name, (kind, shape) in json.loads(header).items():
        if not _NUMBERS.fullmatch(kind) or min(shape, default=0) < 0:
            raise ValueError("not an array of booleans or real numbers")
        dtype = np.dtype(kind)
        end = begin + math.prod(shape) * dtype.itemsize
        arrays[name] = np.frombuffer(content[begin:end], dtype).reshape(shape).copy()
        begin = end
    if begin != len(content):
        raise ValueError("not the arrays of the size of the file")
    return arrays


def report_damage(damage: object) -> None:
    """Warn on stderr about a damaged chunk, which is computed again."""
    print(f"vibrojax: warning: {damage}; computed again", file=sys.stderr)


def _chunk_name(index: int) -> str:
    return f"chunk-{index:08d}"


def _locked(path: Path) -> FileLock:
    """Return an exclusive lock on the file at `path`.

    The operating system locks the open file, and releases the lock when the process ends, even if it is killed. A file
    that remains therefore blocks no other process. On a file system without locks there is no protection.

    **Raises:** `InputError` if another process holds the lock, or the file is not writable.
    """
    # Any thread may release it: a sweep runs in a thread of its own.
    lock = FileLock(path, timeout=_LOCK_PATIENCE, thread_local=False)
    try:
        lock.acquire()  # creates the folder again if another process has just finished and removed it
    except Timeout:
        line = f"{path.parent}: another process is at work there; wait for it, or give another output"
        raise InputError(line) from None
    except OSError as error:
        if error.filename is not None:  # the file could not even be opened
            raise InputError(f"{path}: cannot be written ({error.strerror}); give another output") from None
    return lock
