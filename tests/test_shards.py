"""Chunks beside the output: they outlive a crash, and a damaged or foreign one is never taken for a whole one."""

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
from vibrojax.io.claims import lock
from vibrojax.io.shards import DamagedShard, Shards

MANIFEST = {"scene": "rotary", "chunk": 4, "grid.beta": [0.1, 0.2], "version": "1"}


def arrays(index: int) -> dict[str, np.ndarray]:
    regime = np.full(4, index, np.int8)
    return {"period": np.array([0.1, np.nan, index, 3.0]), "regime": regime, "kept": np.arange(8.0).reshape(4, 2)}


@pytest.fixture
def shards(tmp_path):
    """A folder in which chunks 0 and 2 are finished, and nobody at work."""
    opened = Shards(tmp_path / "out.nc.chunks", MANIFEST)
    opened.open(resume=True)
    opened.write(2, arrays(2))
    opened.write(0, arrays(0))
    opened.close()
    return opened


def again(shards, resume=True, **changes) -> Shards:
    opened = Shards(shards.folder, MANIFEST | changes)
    opened.open(resume)
    return opened


def shard(shards, index):
    return shards.folder / f"chunk-{index:08d}.shard"


def test_what_is_finished_is_found_again(shards):
    with again(shards) as opened:
        assert opened.finished() == {0, 2}
        for index in (0, 2):
            found, expected = opened.read(index), arrays(index)
            assert found.keys() == expected.keys()
            for name in expected:
                np.testing.assert_array_equal(found[name], expected[name], strict=True)
        with pytest.raises(DamagedShard):
            opened.read(1)


def flip(path, place):
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


DAMAGES = [*((flip, place) for place in (0, 31, 32, 100, -1)), *((os.truncate, size) for size in (0, 10, 32, 200))]


@pytest.mark.parametrize(("damage", "place"), DAMAGES)
def test_a_damaged_shard_is_found_out(shards, damage, place, capsys):
    damage(shard(shards, 2), place)
    with again(shards) as opened:
        assert opened.finished() == {0}
        line = capsys.readouterr().err
        assert line.count("\n") == 1 and "chunk-00000002" in line and "; computed again" in line
        with pytest.raises(DamagedShard):
            opened.read(2)
        opened.write(2, arrays(2))
        assert opened.finished() == {0, 2}


@pytest.fixture
def switching_threads():
    """Threads take turns at any moment, even while an object is made: each garbage collection runs Python code."""
    interval, threshold = sys.getswitchinterval(), gc.get_threshold()
    gc.callbacks.append(lambda phase, info: sum(range(50)))
    gc.set_threshold(20)
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)
    gc.set_threshold(*threshold)
    gc.callbacks.pop()


def test_threads_read_at_once(shards, switching_threads):
    with ThreadPoolExecutor(3) as threads:
        for found in threads.map(lambda _: shards.read(2), range(3000)):
            np.testing.assert_array_equal(found["kept"], arrays(2)["kept"])


def test_a_shard_in_anothers_place_is_found_out(shards):
    os.replace(shard(shards, 2), shard(shards, 1))
    with again(shards) as opened:
        assert opened.finished() == {0}


def content_of(header: object, numbers: int = 1) -> bytes:
    return json.dumps(header).encode() + b"\n" + bytes(8 * numbers)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no header",
        b"{}",
        content_of({}),
        content_of([["x", "<f8", []]]),
        content_of({"x": 1}),
        content_of({"x": ["<f8", [2]]}),
        content_of({"x": ["<f8", []]}, 2),
        content_of({"x": ["<f8", [99999999, 99999999]]}),
        content_of({"x": ["<f8", [3, -1]], "y": ["<f8", [4]]}),
        content_of({"x": ["<f8", [0.5]]}),
        content_of({"x": ["<f8", 1]}),
        content_of({"x": ["|O8", []]}),
        content_of({"x": ["f8,f8", []]}, 2),
        b"[" * 10000 + b"\n",
        b"{" + b" " * 100000 + b"}\n",
    ],
)
def test_content_that_is_not_a_chunk_is_refused_though_its_checksum_is_right(shards, content):
    """A folder may come from anywhere: no pickle is loaded, and no array is larger than its file."""
    with again(shards) as opened:
        opened._put(shard(opened, 1), opened._checksum(1, content), content)
        assert opened.finished() == {0, 1, 2}
        with pytest.raises(DamagedShard, match=r"chunk-00000001.*cannot be read"):
            opened.read(1)


def test_a_changed_manifest_is_refused(shards):
    with pytest.raises(InputError) as caught:
        again(shards, chunk=8)
    line = str(caught.value)
    assert "chunk was 4, is 8" in line and "--fresh" in line and "\n" not in line and "scene" not in line
    with again(shards) as opened:  # nothing was lost, and the lock is free
        assert opened.finished() == {0, 2}
    with again(shards, resume=False, chunk=8) as opened:
        assert opened.finished() == set()
    with again(shards, chunk=8) as opened:
        assert opened.finished() == set()


def test_a_manifest_without_chunks_binds_nobody(shards):
    shard(shards, 0).unlink()
    shard(shards, 2).unlink()
    again(shards, chunk=8).close()


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"sha256": "0", "manifest": {"scene": "other"}}'])
def test_without_a_whole_manifest_each_shard_tells_for_itself(shards, damage):
    (shards.folder / "manifest.json").write_bytes(damage)
    with again(shards) as opened:
        assert opened.finished() == {0, 2}
    (shards.folder / "manifest.json").write_bytes(damage)
    with again(shards, chunk=8) as opened:
        assert opened.finished() == set()


def test_what_a_killed_process_left_is_cleared(shards):
    half = shards.folder / "chunk-00000001.shard.tmp"
    half.write_bytes(b"half")
    with again(shards) as opened:
        assert not half.exists() and opened.finished() == {0, 2}


def test_a_write_that_fails_leaves_nothing_that_counts(shards, monkeypatch):
    with again(shards) as opened:
        monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(OSError, match="No space"):
            opened.write(1, arrays(1))
        monkeypatch.undo()
        assert opened.finished() == {0, 2}


def test_a_folder_removed_during_a_write_is_made_again(shards, monkeypatch):
    opened, times = again(shards), iter([1, 2])
    finish = atomic.commit

    def commit(part, path):
        if next(times, None):
            shutil.rmtree(opened.folder)
        finish(part, path)

    monkeypatch.setattr("vibrojax.io.shards.commit", commit)
    opened.write(1, arrays(1))
    assert opened.finished() == {1}


def test_two_processes_do_not_share_a_folder(shards):
    with again(shards):
        code = "import sys; from pathlib import Path; from vibrojax.io.shards import Shards; "
        code += "Shards(Path(sys.argv[1]), {}).open(resume=False)"
        other = subprocess.run([sys.executable, "-c", code, str(shards.folder)], capture_output=True, text=True)
        assert other.returncode == 1 and "another process is at work there" in other.stderr
    with again(shards) as opened:  # --fresh of the other has removed nothing
        assert opened.finished() == {0, 2}


def test_a_killed_process_keeps_nobody_out(shards):
    """The lock is the system's, which lets go of it with the process; the file that it leaves behind binds nobody."""
    code = "import sys, time; from pathlib import Path; from vibrojax.io.shards import Shards; "
    code += (
        "taken = Shards(Path(sys.argv[1]), {}); taken.open(resume=False); print('taken', flush=True); time.sleep(60)"
    )
    other = subprocess.Popen([sys.executable, "-c", code, str(shards.folder)], stdout=subprocess.PIPE, text=True)
    with other:
        assert other.stdout.readline() == "taken\n"
        with pytest.raises(InputError, match="another process is at work there"):
            again(shards)
        other.kill()
    assert (shards.folder / "lock").exists()
    with again(shards, resume=False) as opened:
        opened.write(1, arrays(1))
        assert opened.finished() == {1}


def test_a_lock_that_was_removed_meanwhile_is_taken_anew(shards):
    """As by a process that ends: it removes the file, and then lets go."""
    path = shards.folder / "lock"
    first = lock(path)
    ending = Timer(0.05, lambda: (path.unlink(), first.release()))
    ending.start()
    second = lock(path)
    assert path.exists()
    with pytest.raises(InputError, match="another process"):
        lock(shards.folder / "lock")
    second.release()
    ending.join()


def test_a_lock_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "lock").mkdir()
    with pytest.raises(InputError, match="lock: cannot be written"):
        lock(tmp_path / "lock")


def test_a_file_system_without_locks_goes_without(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    lock(tmp_path / "lock").release()


def test_the_folder_goes_when_all_is_done(shards):
    with again(shards) as opened:
        opened.remove()
    assert not shards.folder.exists()
    with again(shards) as opened:
        assert opened.finished() == set()


def test_what_is_not_ours_stays(shards):
    note = shards.folder / "note.txt"
    note.write_text("mine")
    with again(shards, resume=False) as opened:
        opened.remove()
    assert [path.name for path in shards.folder.iterdir()] == ["note.txt"]


def test_a_file_in_the_folders_place_is_refused(tmp_path):
    (tmp_path / "out.nc.chunks").write_text("")
    with pytest.raises(InputError, match="cannot be made a folder"):
        Shards(tmp_path / "out.nc.chunks", MANIFEST).open(resume=True)
