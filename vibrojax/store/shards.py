"""Finished chunks of a sweep as files beside its output, so that nothing computed is lost."""

import hashlib
import io
import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vibrojax.errors import InputError, shown
from vibrojax.store._aside import sync_folder
from vibrojax.store._lock import Lock

_MANIFEST = "manifest.json"
_LOCK = "lock"
_SHARD = re.compile(r"chunk-(\d{8,})\.shard")
_DAMAGES_TOLD = 3
_DIGEST_SIZE = hashlib.sha256().digest_size


class DamagedShard(Exception):
    """A shard that is missing, cut short or changed; its chunk is computed again."""


class Shards:
    """The finished chunks of one sweep, as immutable files in one folder.

    Each file is the SHA-256 of (manifest, index, content) and then the content, an npz. A file of another manifest, of
    another index, cut short or with a flipped bit is therefore found out, and counts as missing.

    **Arguments:**

    - `folder`: the folder `OUT.nc.chunks`.
    - `manifest`: all that the results depend on, as JSON values.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, object]):
        self.folder = Path(folder)
        # Through JSON, so that it equals what is read back.
        self.manifest = json.loads(_canonical(manifest))
        self.digest = hashlib.sha256(_canonical(self.manifest)).hexdigest()
        self._lock: Lock | None = None

    def open(self, resume: bool) -> None:
        """Take the folder for this process and make it ready.

        With `resume` what is there stays, unless its manifest differs; otherwise it is removed.

        Raises `InputError` where another process is at work there, the folder cannot be written, or, with `resume`,
        its manifest differs.
        """
        try:
            self.folder.mkdir(exist_ok=True)
        except OSError as error:
            line = f"{self.folder}: cannot be made a folder ({error.strerror}); give another output"
            raise InputError(line) from None
        self._lock = Lock(self.folder / _LOCK)
        try:
            if resume:
                self._check_manifest()
            else:
                self._clear(shards=True)
            self._clear(shards=False)
            text = json.dumps({"sha256": self.digest, "manifest": self.manifest}, indent=1)
            self._put(self.folder / _MANIFEST, text.encode())
        except BaseException:
            self.close()
            raise

    def finished(self) -> set[int]:
        """The indices of the chunks that are there and whole; says which are damaged, on stderr."""
        whole, damages = set(), []
        for index in sorted(self._indices()):
            try:
                self._content(index)
                whole.add(index)
            except DamagedShard as damage:
                damages.append(damage)
        for damage in damages[:_DAMAGES_TOLD]:
            tell(damage)
        if len(damages) > _DAMAGES_TOLD:
            tell(f"{self.folder}: {len(damages) - _DAMAGES_TOLD} more chunks are damaged")
        return whole

    def write(self, index: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Store a chunk's arrays; when this returns they are on the disk, whole."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        content = buffer.getbuffer()
        with content:
            self._put(self._path(index), self._checksum(index, content), content)

    def read(self, index: int) -> dict[str, np.ndarray]:
        """A chunk's arrays; raises `DamagedShard` where they are not there or not whole."""
        with np.load(io.BytesIO(self._content(index)), allow_pickle=False) as arrays:
            return dict(arrays)

    def remove(self) -> None:
        """Remove the chunks and, where nothing else lies in it, the folder; ends this object's hold on it."""
        self._clear(shards=True)
        (self.folder / _MANIFEST).unlink(missing_ok=True)
        if self._lock is not None:
            self._lock.release(remove=True)
            self._lock = None
        try:
            self.folder.rmdir()
        except OSError:  # somebody else's files lie there: they stay
            return

    def close(self) -> None:
        """Let another process have the folder; what is in it stays."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> "Shards":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _path(self, index: int) -> Path:
        return self.folder / f"chunk-{index:08d}.shard"

    def _indices(self) -> list[int]:
        found = (_SHARD.fullmatch(path.name) for path in self.folder.iterdir())
        return [int(match[1]) for match in found if match]

    def _checksum(self, index: int, content: bytes | memoryview) -> bytes:
        digest = hashlib.sha256(f"{self.digest} {index}\n".encode())
        digest.update(content)
        return digest.digest()

    def _content(self, index: int) -> memoryview:
        """A shard's npz, its checksum proved."""
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
        self.folder.mkdir(exist_ok=True)  # somebody may have removed it meanwhile
        temporary = path.with_name(path.name + ".tmp")
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
            ours = path.name.removesuffix(".tmp")
            unfinished = ours != path.name
            if (_SHARD.fullmatch(ours) or ours == _MANIFEST) and (unfinished or (shards and ours != _MANIFEST)):
                path.unlink(missing_ok=True)

    def _check_manifest(self) -> None:
        """Raise where the chunks in the folder are of something else."""
        try:
            stored = json.loads((self.folder / _MANIFEST).read_bytes())
            other, digest = dict(stored["manifest"]), stored["sha256"]
        except (OSError, ValueError, KeyError, TypeError):
            return  # missing or damaged: the checksum of each shard tells whether it belongs here
        if digest == self.digest or hashlib.sha256(_canonical(other)).hexdigest() != digest:
            return
        if not self._indices():
            return
        names = [name for name in {**other, **self.manifest} if other.get(name, ...) != self.manifest.get(name, ...)]
        changes = [f"{name} was {_told(other, name)}, is {_told(self.manifest, name)}" for name in names[:3]]
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        raise InputError(
            f"{self.folder}: holds chunks of another sweep: {'; '.join(changes)}{more}; "
            "--fresh starts over, or give another output"
        )


def tell(damage: object) -> None:
    """Say on stderr what has been found damaged."""
    print(f"vibrojax: warning: {damage}; computed again", file=sys.stderr)


def _canonical(manifest: Mapping[str, object]) -> bytes:
    return json.dumps(manifest, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def _told(manifest: Mapping[str, object], name: str) -> str:
    return " ".join(shown(manifest[name]).split()) if name in manifest else "not there"
