"""Finished chunks of a sweep, stored as files next to its output, so that no computed chunk is lost."""

import json
import os
import re
import sys
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout
from jaxtyping import Shaped

from vibrojax.errors import InputError
from vibrojax.io.atomic import commit
from vibrojax.io.files import new_file
from vibrojax.io.identity import canonical, changes, digest

LOCK, MANIFEST = "lock", "manifest.json"
"""Names of the lock file and of the manifest in a folder of chunks."""

CHUNKS = ".chunks"
"""Suffix of the folder of chunks next to an output file."""

FORMAT = 2
"""Version of the format of stored chunks; chunks of another version are refused."""

_NUMBERS = re.compile(r"[<>|][biuf]\d")
"""Types of the arrays that are stored: booleans and real numbers."""

FILE = re.compile(r"chunk-(\d{8,})\.(?:zip|shard)")
"""Pattern of the file name of a finished chunk, also of version 1; its group is the chunk's index."""

_LEFTOVER = re.compile(r"(manifest\.json|chunk-\d{8,}\.(zip|shard))(\.\d+)*\.tmp")
"""Unfinished files of a killed process, which a new run removes. Other files stay."""

Arrays = Mapping[str, Shaped[np.ndarray, "..."]]
"""The arrays of a chunk by name: variables of shape (lanes,) or (lanes, rows), and numbers of shape ()."""


class Store:
    """The finished chunks of one sweep, as immutable archives in one folder that `open_store` opens.

    A file with another manifest or index, a truncated file and a flipped bit (by the CRC of each array) are detected.
    The chunk then counts as missing. The name of each member of an archive, as JSON, is the name, type and shape of an
    array. (It is no npz file, because numpy parses headers with `ast`, which fails in Python 3.11 when two threads use
    it at once: CPython issue 106905.)

    - `folder`: the folder `OUT.nc.chunks`.
    - `manifest`: everything that the results depend on, as JSON values.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, object]) -> None:
        self.folder = folder
        self.manifest: dict[str, object] = json.loads(canonical({**manifest, "store": FORMAT}))
        self._digest = digest(self.manifest)

    def finished(self) -> set[int]:
        """Return the indices of the intact chunks; warn of the others, see `read`."""
        return {index for index in sorted(self.indices()) if self.read(index) is not None}

    def indices(self) -> set[int]:
        """Return the indices of the existing chunks, without verifying that they are intact."""
        try:
            return {int(match[1]) for match in map(FILE.fullmatch, os.listdir(self.folder)) if match}
        except FileNotFoundError:  # the sweep is finished, and the folder removed
            return set()

    def write(self, index: int, arrays: Arrays) -> None:
        """Store the arrays of a chunk; on return, the file is complete on the disk."""
        content, (path, owner) = BytesIO(), self._file(index)
        with zipfile.ZipFile(content, "w") as file:
            file.comment = owner
            for name, x in arrays.items():
                file.writestr(zipfile.ZipInfo(json.dumps([name, x.dtype.str, x.shape])), x.tobytes())  # without a date
        self.put(path, content.getbuffer())

    def read(self, index: int) -> dict[str, np.ndarray] | None:
        """Return the arrays of a chunk by name; None, with a warning on stderr, if the file is missing or damaged."""
        (path, owner), arrays = self._file(index), dict[str, np.ndarray]()
        try:
            with zipfile.ZipFile(path) as file:
                if file.comment != owner:
                    raise ValueError("of another sweep or chunk")
                for info in file.infolist():
                    name, kind, shape = json.loads(info.filename)
                    # Nothing unpacks to more than its size, and nothing is unpickled.
                    if info.compress_type != zipfile.ZIP_STORED or not _NUMBERS.fullmatch(kind):
                        raise ValueError("not an array of booleans or real numbers")
                    arrays[name] = np.frombuffer(bytearray(file.read(info)), kind).reshape(shape)
            return arrays
        except OSError as error:
            problem = f"cannot be read ({error.strerror or 'damaged'})"
        except Exception:  # a malformed archive causes many types of exceptions
            problem = "damaged"
        print(f"vibrojax: warning: {path}: {problem}; computed again", file=sys.stderr)
        return None

    def clear(self, chunks: bool) -> None:
        """Remove leftovers of killed processes and, with `chunks`, the finished chunks; other files stay."""
        for path in self.folder.iterdir():
            if _LEFTOVER.fullmatch(path.name) or (chunks and FILE.fullmatch(path.name)):
                path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the chunks; the folder follows when it is closed, unless it holds other files."""
        self.clear(chunks=True)
        (self.folder / MANIFEST).unlink(missing_ok=True)
        (self.folder / LOCK).unlink(missing_ok=True)  # while no other process can hold the lock

    def _file(self, index: int) -> tuple[Path, bytes]:
        """Return the path of a chunk, and its owner: the digest of the manifest, with the index."""
        return self.folder / f"chunk-{index:08d}.zip", f"{self._digest} {index}".encode()

    def put(self, path: Path, content: bytes | memoryview) -> None:
        """Write a file that is complete or absent, even after a power failure."""
        temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
        try:
            self.folder.mkdir(exist_ok=True)  # the user may have removed it
            with new_file(temporary) as file:
                file.write(content)
            commit(temporary, path)
        except OSError as error:  # an error while writing does not state the file name
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def open_store(folder: Path, manifest: Mapping[str, object], resume: bool) -> Iterator[Store]:
    """Open the chunks of a sweep for a `with` block, in which no other process can open them.

    With `resume`, finished chunks are kept; otherwise they are removed.

    **Raises:** `InputError` if another process is working there, the folder is not writable, or, with `resume`, the
    chunks belong to another manifest.
    """
    store = Store(folder, manifest)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made a folder ({error.strerror}); give another output") from None
    path, before = folder / MANIFEST, None
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        stored = json.loads(path.read_bytes())
        is_intact = isinstance(stored["manifest"], dict) and digest(stored["manifest"]) == stored["sha256"]
        before = stored["manifest"] if is_intact else {}
    if before is None and path.exists() and not store.indices():
        line = f"{path}: exists already, and does not say that vibrojax wrote it"
        raise InputError(f"{line}; give another output, or remove it")
    # The operating system locks the open file, and releases the lock when the process ends, even if it is killed. A
    # file that remains therefore blocks no other process. On a file system without locks there is no protection. A
    # process that is just ending has 0.2 s for it. Any thread may release the lock: a sweep runs in one of its own.
    lock = FileLock(folder / LOCK, timeout=0.2, thread_local=False)
    try:
        lock.acquire()  # creates the folder again if another process has just finished and removed it
    except Timeout:
        raise InputError(f"{folder}: another process is at work there; wait for it, or give another output") from None
    except OSError as error:
        if error.filename is not None:  # the file could not even be opened
            raise InputError(f"{folder / LOCK}: cannot be written ({error.strerror}); give another output") from None
    try:
        # Without an intact manifest, each chunk itself shows that it belongs to another sweep.
        if resume and before and store.indices() and (differences := changes(before, store.manifest)):
            advice = "--fresh starts over, or give another output"
            raise InputError(f"{folder}: holds chunks of another sweep: {differences}; {advice}")
        store.clear(chunks=not resume)
        content = {"sha256": digest(store.manifest), "manifest": store.manifest}
        store.put(path, json.dumps(content, indent=1).encode())
        yield store
    finally:
        lock.release()
    with suppress(OSError):  # the folder is not empty
        folder.rmdir()
