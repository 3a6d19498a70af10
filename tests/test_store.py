"""Test that finished chunks beside the output survive a crash, and that damaged or foreign ones are never accepted."""

import json
import os
import zipfile
from io import BytesIO

import numpy as np
import pytest

from vibrojax.errors import InputError
from vibrojax.io.identity import canonical, digest
from vibrojax.maps.store import FORMAT, open_store

MANIFEST = {"scene": "rotary", "chunk": 4, "grid.beta": [0.1, 0.2], "version": "1"}
OWNER = digest(json.loads(canonical(MANIFEST | {"store": FORMAT})))


def arrays(index: int) -> dict[str, np.ndarray]:
    regime = np.full(4, index, np.int8)
    return {"period": np.array([0.1, np.nan, index, 3.0]), "regime": regime, "kept": np.arange(8.0).reshape(4, 2)}


@pytest.fixture
def store(tmp_path):
    """Return a closed folder in which chunks 0 and 2 are finished."""
    with open_store(tmp_path / "out.nc.chunks", MANIFEST, resume=True) as opened:
        opened.write(2, arrays(2))
        opened.write(0, arrays(0))
    return opened


def reopen(store, resume=True, **changes):
    return open_store(store.folder, MANIFEST | changes, resume)


def chunk_path(store, index):
    return store.folder / f"chunk-{index:08d}.zip"


def test_no_flipped_bit_changes_a_value(store):
    """A few bits of an archive mean nothing, such as those of its date."""
    path, detected = chunk_path(store, 2), 0
    content = path.read_bytes()
    for place in range(len(content)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        chunk = store.read(2)
        detected += chunk is None
        for name, x in (chunk or {}).items():
            np.testing.assert_array_equal(x, arrays(2)[name], strict=True)
        path.write_bytes(content)
    assert detected > 0.6 * len(content)


def test_chunk_in_place_of_another_is_detected(store):
    os.replace(chunk_path(store, 2), chunk_path(store, 1))
    with reopen(store) as opened:
        assert opened.finished() == {0}


def archive(name: str, content: bytes, compression=zipfile.ZIP_STORED) -> bytes:
    """Return a file of the sweep's chunk 1 with one member."""
    file = BytesIO()
    with zipfile.ZipFile(file, "w", compression) as members:
        members.comment = f"{OWNER} 1".encode()
        members.writestr(name, content)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"no archive",
        archive('["x", "<f8"]', bytes(8)),
        archive('["x", "<f8", []]', bytes(16)),
        archive('["x", "<f8", [99999999, 99999999]]', bytes(8)),
        archive('["x", "|O8", []]', bytes(8)),
        archive('["x", "<f8", [4]]', bytes(32), zipfile.ZIP_DEFLATED),
    ],
    ids=["no-archive", "no-shape", "too-long", "too-short", "objects", "compressed"],  # archives contain the time
)
def test_files_from_anywhere_are_refused(store, content):
    """No pickle is loaded, nothing unpacks to more than its size, and no array exceeds its file."""
    with reopen(store) as opened:
        chunk_path(opened, 1).write_bytes(content)
        assert opened.finished() == {0, 2}


def test_changed_manifest_is_refused(store):
    with pytest.raises(InputError) as caught, reopen(store, chunk=8):
        pass
    line = str(caught.value)
    assert "chunk was 4, is 8" in line and "--fresh" in line and "\n" not in line and "scene" not in line
    with reopen(store) as opened:  # nothing was lost, and the lock is free
        assert opened.finished() == {0, 2}
    with reopen(store, resume=False, chunk=8) as opened:
        assert opened.finished() == set()
    with reopen(store, chunk=8) as opened:
        assert opened.finished() == set()


def test_chunks_are_checked_individually_without_valid_manifest(store):
    (store.folder / "manifest.json").write_bytes(b"{")
    with reopen(store) as opened:
        assert opened.finished() == {0, 2}
    (store.folder / "manifest.json").write_bytes(b"{")
    with reopen(store, chunk=8) as opened:
        assert opened.finished() == set()


def test_partial_file_of_killed_process_is_removed(store):
    half = store.folder / "chunk-00000001.zip.tmp"
    half.write_bytes(b"half")
    with reopen(store) as opened:
        assert not half.exists() and opened.finished() == {0, 2}


def test_foreign_files_are_kept(store):
    note = store.folder / "note.txt"
    note.write_text("mine")
    with reopen(store, resume=False) as opened:
        opened.remove()
    assert [path.name for path in store.folder.iterdir()] == ["note.txt"]
