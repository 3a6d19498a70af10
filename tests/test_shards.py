"""Test that finished chunks beside the output survive a crash, and that damaged or foreign ones are never accepted."""

import errno
import gc
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Timer

import numpy as np
import pytest

from vibrojax.errors import InputError
from vibrojax.io import atomic
from vibrojax.maps.shards import DamagedShard, Shards, _locked

MANIFEST = {"scene": "rotary", "chunk": 4, "grid.beta": [0.1, 0.2], "version": "1"}


def arrays(index: int) -> dict[str, np.ndarray]:
    regime = np.full(4, index, np.int8)
    return {"period": np.array([0.1, np.nan, index, 3.0]), "regime": regime, "kept": np.arange(8.0).reshape(4, 2)}


@pytest.fixture
def shards(tmp_path):
    """Return a closed folder in which chunks 0 and 2 are finished."""
    opened = Shards(tmp_path / "out.nc.chunks", MANIFEST)
    opened.open(resume=True)
    opened.write(2, arrays(2))
    opened.write(0, arrays(0))
    opened.close()
    return opened


def reopen(shards, resume=True, **changes) -> Shards:
    opened = Shards(shards.folder, MANIFEST | changes)
    opened.open(resume)
    return opened


def shard_path(shards, index):
    return shards.folder / f"chunk-{index:08d}.shard"


def test_finished_chunks_are_read_after_reopening(shards):
    with reopen(shards) as opened:
        assert opened.finished() == {0, 2}
        for index in (0, 2):
            chunk, expected = opened.read(index), arrays(index)
            assert chunk.keys() == expected.keys()
            for name in expected:
                np.testing.assert_array_equal(chunk[name], expected[name], strict=True)
        with pytest.raises(DamagedShard):
            opened.read(1)


def flip_bit(path, place):
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


DAMAGES = [*((flip_bit, place) for place in (0, 31, 32, 100, -1)), *((os.truncate, size) for size in (0, 10, 32, 200))]


@pytest.mark.parametrize(("damage", "place"), DAMAGES)
def test_damaged_shard_is_detected(shards, damage, place, capsys):
    damage(shard_path(shards, 2), place)
    with reopen(shards) as opened:
        assert opened.finished() == {0}
        line = capsys.readouterr().err
        assert line.count("\n") == 1 and "chunk-00000002" in line and "; computed again" in line
        with pytest.raises(DamagedShard):
            opened.read(2)
        opened.write(2, arrays(2))
        assert opened.finished() == {0, 2}


@pytest.fixture
def switching_threads():
    """Let threads switch at any moment, even while an object is created: each garbage collection runs Python code."""
    interval, threshold = sys.getswitchinterval(), gc.get_threshold()
    gc.callbacks.append(lambda phase, info: sum(range(50)))
    gc.set_threshold(20)
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)
    gc.set_threshold(*threshold)
    gc.callbacks.pop()


def test_threads_read_concurrently(shards, switching_threads):
    with ThreadPoolExecutor(3) as threads:
        for chunk in threads.map(lambda _: shards.read(2), range(3000)):
            np.testing.assert_array_equal(chunk["kept"], arrays(2)["kept"])


def test_shard_in_place_of_another_is_detected(shards):
    os.replace(shard_path(shards, 2), shard_path(shards, 1))
    with reopen(shards) as opened:
        assert opened.finished() == {0}


def shard_content(header: object, numbers: int = 1) -> bytes:
    return json.dumps(header).encode() + b"\n" + bytes(8 * numbers)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no header",
        b"{}",
        shard_content({}),
        shard_content([["x", "<f8", []]]),
        shard_content({"x": 1}),
        shard_content({"x": ["<f8", [2]]}),
        shard_content({"x": ["<f8", []]}, 2),
        shard_content({"x": ["<f8", [99999999, 99999999]]}),
        shard_content({"x": ["<f8", [3, -1]], "y": ["<f8", [4]]}),
        shard_content({"x": ["<f8", [0.5]]}),
        shard_content({"x": ["<f8", 1]}),
        shard_content({"x": ["|O8", []]}),
        shard_content({"x": ["f8,f8", []]}, 2),
        b"[" * 10000 + b"\n",
        b"{" + b" " * 100000 + b"}\n",
    ],
)
def test_invalid_content_with_valid_checksum_is_refused(shards, content):
    """A folder may come from anywhere, so no pickle is loaded and no array exceeds its file."""
    with reopen(shards) as opened:
        opened._put(shard_path(opened, 1), opened._checksum(1, content), content)
        assert opened.finished() == {0, 1, 2}
        with pytest.raises(DamagedShard, match=r"chunk-00000001.*cannot be read"):
            opened.read(1)


def test_changed_manifest_is_refused(shards):
    with pytest.raises(InputError) as caught:
        reopen(shards, chunk=8)
    line = str(caught.value)
    assert "chunk was 4, is 8" in line and "--fresh" in line and "\n" not in line and "scene" not in line
    with reopen(shards) as opened:  # nothing was lost, and the lock is free
        assert opened.finished() == {0, 2}
    with reopen(shards, resume=False, chunk=8) as opened:
        assert opened.finished() == set()
    with reopen(shards, chunk=8) as opened:
        assert opened.finished() == set()


def test_manifest_without_chunks_may_change(shards):
    shard_path(shards, 0).unlink()
    shard_path(shards, 2).unlink()
    reopen(shards, chunk=8).close()


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"sha256": "0", "manifest": {"scene": "other"}}'])
def test_shards_are_checked_individually_without_valid_manifest(shards, damage):
    (shards.folder / "manifest.json").write_bytes(damage)
    with reopen(shards) as opened:
        assert opened.finished() == {0, 2}
    (shards.folder / "manifest.json").write_bytes(damage)
    with reopen(shards, chunk=8) as opened:
        assert opened.finished() == set()


def test_partial_file_of_killed_process_is_removed(shards):
    half = shards.folder / "chunk-00000001.shard.tmp"
    half.write_bytes(b"half")
    with reopen(shards) as opened:
        assert not half.exists() and opened.finished() == {0, 2}


def test_failed_write_leaves_no_finished_chunk(shards, monkeypatch):
    with reopen(shards) as opened:
        monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(OSError, match="No space"):
            opened.write(1, arrays(1))
        monkeypatch.undo()
        assert opened.finished() == {0, 2}


def test_folder_removed_during_write_is_recreated(shards, monkeypatch):
    opened, removals = reopen(shards), iter([1, 2])
    finish = atomic.commit

    def commit(part, path):
        if next(removals, None):
            shutil.rmtree(opened.folder)
        finish(part, path)

    monkeypatch.setattr("vibrojax.maps.shards.commit", commit)
    opened.write(1, arrays(1))
    assert opened.finished() == {1}


def test_two_processes_cannot_use_same_folder(shards):
    with reopen(shards):
        code = "import sys; from pathlib import Path; from vibrojax.maps.shards import Shards; "
        code += "Shards(Path(sys.argv[1]), {}).open(resume=False)"
        other = subprocess.run([sys.executable, "-c", code, str(shards.folder)], capture_output=True, text=True)
        assert other.returncode == 1 and "another process is at work there" in other.stderr
    with reopen(shards) as opened:  # resume=False of the other process removed nothing
        assert opened.finished() == {0, 2}


def test_lock_of_killed_process_is_free(shards):
    """The operating system releases the lock when the process ends. The lock file that remains has no effect."""
    code = "import sys, time; from pathlib import Path; from vibrojax.maps.shards import Shards; "
    code += (
        "taken = Shards(Path(sys.argv[1]), {}); taken.open(resume=False); print('taken', flush=True); time.sleep(60)"
    )
    other = subprocess.Popen([sys.executable, "-c", code, str(shards.folder)], stdout=subprocess.PIPE, text=True)
    with other:
        assert other.stdout.readline() == "taken\n"
        with pytest.raises(InputError, match="another process is at work there"):
            reopen(shards)
        other.kill()
    assert (shards.folder / "lock").exists()
    with reopen(shards, resume=False) as opened:
        opened.write(1, arrays(1))
        assert opened.finished() == {1}


def test_lock_is_retried_if_its_file_was_removed(shards):
    """A process that ends removes the file first and then releases the lock."""
    path = shards.folder / "lock"
    first = _locked(path)
    ending = Timer(0.05, lambda: (path.unlink(), first.release()))
    ending.start()
    second = _locked(path)
    assert path.exists()
    with pytest.raises(InputError, match="another process"):
        _locked(shards.folder / "lock")
    second.release()
    ending.join()


def test_lock_that_cannot_be_created_is_refused(tmp_path):
    (tmp_path / "lock").mkdir()
    with pytest.raises(InputError, match="lock: cannot be written"):
        _locked(tmp_path / "lock")


def test_file_system_without_locks_is_accepted(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    _locked(tmp_path / "lock").release()


def test_folder_is_removed_at_end(shards):
    with reopen(shards) as opened:
        opened.remove()
    assert not shards.folder.exists()
    with reopen(shards) as opened:
        assert opened.finished() == set()


def test_foreign_files_are_kept(shards):
    note = shards.folder / "note.txt"
    note.write_text("mine")
    with reopen(shards, resume=False) as opened:
        opened.remove()
    assert [path.name for path in shards.folder.iterdir()] == ["note.txt"]


def test_file_in_place_of_folder_is_refused(tmp_path):
    (tmp_path / "out.nc.chunks").write_text("")
    with pytest.raises(InputError, match="cannot be made a folder"):
        Shards(tmp_path / "out.nc.chunks", MANIFEST).open(resume=True)
