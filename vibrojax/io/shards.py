"""Finished chunks of a sweep as files beside its output, so that nothing computed is lost."""

import hashlib
import io
import json
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Shaped

from vibrojax.errors import InputError
from vibrojax.io import npz
from vibrojax.io.atomic import sync_folder
from vibrojax.io.claims import Claims, this_process
from vibrojax.io.folder import LOCK, chunk_name, failure_name, is_to_go, shard_index, shard_name
from vibrojax.io.lock import Lock
from vibrojax.io.manifest import MANIFEST, Manifest

_WHOLE = "all"
"""What one claims who has all chunks for himself."""
_PATIENCE = 30.0
"""Seconds that one of many processes which begin together waits for the others to have looked at the manifest."""
_DAMAGES_SHOWN = 3
_DIGEST_SIZE = hashlib.sha256().digest_size

Arrays = Mapping[str, Shaped[np.ndarray, "..."]]
"""The arrays of a chunk by name: features (lanes,) or (lanes, rows)."""


class DamagedShard(Exception):
    """A shard that is missing, cut short or changed; its chunk is computed again."""


class Shards:
    """The finished chunks of one sweep, as immutable files in one folder.

    Each file is the SHA-256 of (manifest, index, content) and then the content, an npz. A file of another manifest, of
    another index, cut short or with a flipped bit is therefore recognised, and counts as missing.

    **Arguments:**

    - `folder`: the folder `OUT.nc.chunks`.
    - `manifest`: all that the results depend on, as JSON values.
    - `about`: what else there is to tell of the sweep, as JSON values.
    """

    def __init__(
        self, folder: Path, manifest: Mapping[str, object], about: Mapping[str, object] = MappingProxyType({})
    ) -> None:
        self.folder, self._about = folder, dict(about)
        self.claims = Claims(folder)
        self._manifest = Manifest(manifest)
        self._lock: Lock | None = None
        self._shared = False

    @property
    def manifest(self) -> dict[str, object]:
        """All that the results depend on."""
        return self._manifest.values

    def open(self, resume: bool) -> None:
        """Take the folder for this process and make it ready.

        With `resume` what is there stays, unless its manifest differs; otherwise it is removed.

        **Raises:** `InputError` where another process is at work there, the folder cannot be written, or, with
        `resume`, its manifest differs.
        """
        self._make_folder()
        self._lock = Lock(self.folder / LOCK)
        try:
            self._check_claims()
            if resume:
                self._check_manifest()
            else:
                self._clear(shards=True)
            self._clear(shards=False)
            self._write_manifest()
            self.claims.take(_WHOLE)
        except BaseException:
            self.close()
            raise

    def share(self) -> None:
        """Make the folder ready for several processes, each of which takes a chunk by its claim; what is there stays.

        **Raises:** `InputError` where a process has it for itself, it cannot be written, or its manifest differs.
        """
        self._make_folder()
        self._check_claims(_WHOLE)
        lock = Lock(self.folder / LOCK, _PATIENCE)
        try:
            self._check_manifest()
            if not (self.folder / MANIFEST).exists():
                self._write_manifest()
        finally:
            lock.release()
        self._shared = True

    def join(self) -> None:
        """Work in the folder of another process that has it for itself, and has asked for that."""
        self._shared = True

    def finished(self) -> set[int]:
        """The indices of the chunks that are there and whole; says which are damaged, on stderr."""
        whole: set[int] = set()
        damages: list[DamagedShard] = []
        for index in sorted(self._indices()):
            try:
                self._content(index)
                whole.add(index)
            except DamagedShard as damage:
                damages.append(damage)
        for shown_damage in damages[:_DAMAGES_SHOWN]:
            report_damage(shown_damage)
        if len(damages) > _DAMAGES_SHOWN:
            report_damage(f"{self.folder}: {len(damages) - _DAMAGES_SHOWN} more chunks are damaged")
        return whole

    def there(self) -> set[int]:
        """The indices of the chunks that are there; whether they are whole is not looked at."""
        return set(self._indices())

    def has(self, index: int) -> bool:
        """Whether a chunk is there; not whether it is whole."""
        return self._path(index).exists()

    def size(self, index: int) -> int:
        """Bytes of a chunk that is there."""
        return self._path(index).stat().st_size

    def discard(self, index: int) -> None:
        """Remove a chunk that is not whole, if it is there."""
        self._path(index).unlink(missing_ok=True)

    def claim(self, index: int) -> bool:
        """Take a chunk for this process; False where another has it, or it is there."""
        name = chunk_name(index)
        if not self.claims.take(name):
            return False
        if self.has(index):  # finished between the look and the claim
            self.claims.release(name)
            return False
        return True

    def let_go(self, index: int) -> None:
        """Let go of a chunk that this process took."""
        self.claims.release(chunk_name(index))

    def failed(self, index: int, why: str) -> None:
        """Have it known that a chunk could not be computed."""
        content = json.dumps({"chunk": index, "by": this_process().text, "why": why})
        self._put(self.folder / failure_name(index), content.encode())

    def has_failed(self, index: int) -> bool:
        """Whether a chunk is known to have failed."""
        return (self.folder / failure_name(index)).exists()

    def write(self, index: int, arrays: Arrays) -> None:
        """Store a chunk's arrays; when this returns they are on the disk, whole."""
        buffer = io.BytesIO()
        named: dict[str, Any] = dict(arrays)  # of numpy's own keywords, which older ones lack, none is among the names
        np.savez(buffer, **named)
        content = buffer.getbuffer()
        with content:
            self._put(self._path(index), self._checksum(index, content), content)
        (self.folder / failure_name(index)).unlink(missing_ok=True)

    def read(self, index: int) -> dict[str, np.ndarray]:
        """A chunk's arrays by name, as they were written; not to be written to.

        **Raises:** `DamagedShard` where they are not there or not whole.
        """
        return npz.arrays(self._content(index))

    def remove(self) -> None:
        """Remove the chunks and, where nothing else lies in it, the folder; lets go of it."""
        self._clear(shards=True)
        self.claims.close()
        (self.folder / MANIFEST).unlink(missing_ok=True)
        if self._lock is None:
            with suppress(InputError):  # another one has just come to look
                self._lock = Lock(self.folder / LOCK)
        if self._lock is not None:
            self._lock.release(remove=True)
            self._lock = None
        try:
            self.folder.rmdir()
        except OSError:  # other files lie there: they stay
            return

    def close(self) -> None:
        """Let another process have the folder; what is in it stays."""
        self.claims.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> "Shards":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _path(self, index: int) -> Path:
        return self.folder / shard_name(index)

    def _indices(self) -> list[int]:
        try:
            found = [shard_index(name) for name in os.listdir(self.folder)]
        except FileNotFoundError:  # all is done, and the folder removed
            return []
        return [index for index in found if index is not None]

    def _checksum(self, index: int, content: bytes | memoryview) -> bytes:
        digest = hashlib.sha256(f"{self._manifest.digest} {index}\n".encode())
        digest.update(content)
        return digest.digest()

    def _content(self, index: int) -> memoryview:
        """A shard's npz, its checksum verified."""
        path = self._path(index)
        try:
            data = memoryview(path.read_bytes())
        except OSError as error:
            raise DamagedShard(f"{path}: cannot be read ({error.strerror})") from None
        if self._checksum(index, data[_DIGEST_SIZE:]) != data[:_DIGEST_SIZE]:
            raise DamagedShard(f"{path}: damaged")
        return data[_DIGEST_SIZE:]

    def _put(self, path: Path, *parts: bytes | memoryview) -> None:
        """Write a file so that it is either whole or not there, whenever the power goes."""
        if not self._shared:
            self.folder.mkdir(exist_ok=True)  # somebody may have removed it meanwhile
        temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
        try:
            with open(temporary, "wb") as file:
                for part in parts:
                    file.write(part)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except OSError as error:  # a write does not say of which file
            temporary.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(path)) from None
        sync_folder(self.folder)

    def _clear(self, shards: bool) -> None:
        """Remove the shards, or the unfinished files of a process that was killed; nothing that is not ours."""
        for path in self.folder.iterdir():
            if is_to_go(path.name, shards):
                path.unlink(missing_ok=True)

    def _check_claims(self, name: str = "") -> None:
        """Raise where another process has what is called `name`, or anything."""
        for held in self.claims.held():
            if not held.stale and held.name.startswith(name):
                line = f"{self.folder}: another process is at work there ({held.owner.text}, at {held.name})"
                raise InputError(f"{line}; wait for it, or give another output")

    def _make_folder(self) -> None:
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            line = f"{self.folder}: cannot be made a folder ({error.strerror}); give another output"
            raise InputError(line) from None

    def _write_manifest(self) -> None:
        self._put(self.folder / MANIFEST, self._manifest.content(self._about))

    def _check_manifest(self) -> None:
        """Raise where the chunks in the folder are of something else; where its manifest is not whole each of them
        tells for itself."""
        differing = self._manifest.changes_since(self.folder / MANIFEST)
        if differing and self._indices():
            raise InputError(
                f"{self.folder}: holds chunks of another sweep: {differing}; "
                "--fresh starts over, or give another output"
            )


def report_damage(damage: DamagedShard | str) -> None:
    """Say on stderr what is damaged, and that it is computed again."""
    print(f"vibrojax: warning: {damage}; computed again", file=sys.stderr)
