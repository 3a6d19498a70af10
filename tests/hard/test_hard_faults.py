"""Tests of real faults of the machine: a full disk, a folder that cannot be written, Ctrl-C, kills, a clock that jumps.

Each ends in one line and a status, and keeps what was computed. `python tests/hard/kills.py` kills a sweep 200 times.
"""

import io
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import chdir, contextmanager, redirect_stderr

import numpy as np
import pytest
import xarray as xr
from commands import end_of, start, wait_for
from kills import Kills

import vibrojax as vj
from vibrojax.cli import main

CHUNKS = 12
SWEEP = f"""
scene = "penetration"
[grid]
frequency = {{ start = 10, stop = 40, num = {CHUNKS} }}
force = [100e3, 200e3, 300e3, 400e3]
[run]
settle = 0.8
observe = 0.4
chunk = 4
step = 1e-4
"""


def start_sweep(folder, *options, before="") -> subprocess.Popen:
    return start("sweep", "map.toml", "--quiet", *options, before=before, cwd=folder)


def run_sweep(folder) -> tuple[int, str]:
    """Return the status and the errors of the command, run in this process."""
    with chdir(folder), redirect_stderr(io.StringIO()) as errors:
        return main(["sweep", "map.toml", "--quiet"]), errors.getvalue()


def one_line(text: str) -> str:
    assert text.startswith("vibrojax: ") and text.count("\n") == 1, text
    return text


def chunks(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "map.nc.chunks").glob("*.zip")}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "map.toml").write_text(SWEEP)
    return tmp_path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the dataset of a sweep that nothing disturbs."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "map.toml").write_text(SWEEP)
    assert run_sweep(folder) == (0, "")
    return folder / "map.nc"


def assert_same(path, reference) -> None:
    """Check that variables and coordinates are equal bit for bit; among attributes only times and dates may differ."""
    with xr.open_dataset(path) as result, xr.open_dataset(reference) as expected:
        xr.testing.assert_identical(result.drop_attrs(deep=False), expected.drop_attrs(deep=False))
        differing = {name for name in expected.attrs if result.attrs[name] != expected.attrs[name]}
        assert differing <= {"history", "wall_time_s"}


@contextmanager
def limited_files(size: int):
    """Limit the size of files: the kernel refuses the rest, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def test_disk_fills_at_any_byte(tmp_path):
    """A dataset is written whole, or not at all and with the system's reason."""
    values = np.random.default_rng(0).random(2000)
    dataset = xr.Dataset({"x": ("lane", values)}, attrs={"source": "vibrojax 0"})
    out = tmp_path / "out.nc"
    vj.write_dataset(dataset, out)
    size, seen = out.stat().st_size, set()
    for limit in [*range(1, size, size // 40), size]:
        out.unlink(missing_ok=True)
        try:
            with limited_files(limit):
                vj.write_dataset(dataset, out)
            seen.add("whole")
            xr.testing.assert_identical(vj.open_dataset(out), dataset)
        except OSError as error:
            seen.add(error.strerror)
            assert list(tmp_path.iterdir()) == []
    assert seen == {"File too large", "whole"}


def test_full_disk(folder, whole):
    """The disk is full at the first chunk, then at the dataset: finished chunks are kept, and used in the end."""
    with limited_files(1200):
        status, errors = run_sweep(folder)
    advice = "finished chunks are kept; to go on: vibrojax sweep map.toml -o map.nc\n"
    assert status == 1 and one_line(errors).endswith(f".zip: File too large; {advice}")
    with limited_files(8000):  # the chunks are smaller, the dataset is larger
        status, errors = run_sweep(folder)
    assert status == 1 and one_line(errors) == f"vibrojax: map.nc: File too large; {advice}"
    assert len(chunks(folder)) == CHUNKS
    assert not (folder / "map.nc").exists()
    assert run_sweep(folder) == (0, "")
    assert_same(folder / "map.nc", whole)
    assert sorted(path.name for path in folder.iterdir()) == ["map.nc", "map.png", "map.toml"]


BOUND_BY_MODES = """
import ctypes
if os.geteuid() == 0:  # root obeys the modes of files too, once it has dropped CAP_DAC_OVERRIDE (1) for what it starts
    assert ctypes.CDLL(None).prctl(24, 1, 0, 0, 0) == 0
"""


def test_chunks_closed_deleted_truncated_and_flipped(folder, whole):
    """The folder is closed while the sweep runs, and its chunks stay. Then each damaged chunk is reported and computed
    again; the others are used."""
    process = start_sweep(folder, before=BOUND_BY_MODES)
    wait_for(lambda: len(chunks(folder)) >= 3, process)
    closed = folder / "map.nc.chunks"
    closed.chmod(0o555)
    status, errors = end_of(process)
    closed.chmod(0o755)
    assert status == 1 and "Permission denied; finished chunks are kept; to go on" in one_line(errors)
    paths = sorted(closed.glob("*.zip"))
    assert len(paths) >= 3
    paths[0].unlink()
    os.truncate(paths[1], 100)
    flipped = bytearray(paths[2].read_bytes())
    flipped[len(flipped) // 2] ^= 16
    paths[2].write_bytes(flipped)
    (closed / "manifest.json").write_bytes(b"{")
    status, errors = run_sweep(folder)
    lines = [f"vibrojax: warning: {path.relative_to(folder)}: damaged; computed again" for path in paths[1:3]]
    assert (status, errors.splitlines()) == (0, lines)
    assert_same(folder / "map.nc", whole)


def test_two_processes_on_one_output(folder, whole):
    """One process computes and the other is refused; both never compute at once. Fresh processes give the same bits."""
    processes = [start_sweep(folder) for _ in range(2)]
    results = sorted(end_of(process) for process in processes)
    assert results[0] == (0, "")
    status, errors = results[1]
    if status:  # otherwise it came after the other one had ended
        assert status == 2 and "map.nc.chunks: another process is at work there" in one_line(errors)
    assert_same(folder / "map.nc", whole)


TERMINATED = pytest.param(signal.SIGTERM, 143, "terminated; ", marks=pytest.mark.long)


@pytest.mark.parametrize(
    ("sent", "status", "word"), [(signal.SIGINT, 130, "interrupted; "), TERMINATED, (signal.SIGKILL, -9, "")]
)
def test_ctrl_c_is_answered_at_once(folder, whole, sent, status, word):
    """Ctrl-C and SIGTERM are answered with how to continue, which works; after SIGKILL too, finished chunks are used.
    The limit is a second or, if other work slows the machine, twice the time of importing jax there."""
    process = start_sweep(folder, "--fresh")
    wait_for(lambda: chunks(folder), process)
    began = time.monotonic()
    process.send_signal(sent)
    ended, errors = end_of(process)
    took = time.monotonic() - began
    assert ended == status
    if word:
        assert word in one_line(errors) and "to go on: vibrojax sweep map.toml" in errors
    if took >= 1.0:
        began = time.monotonic()
        subprocess.run([sys.executable, "-c", "import jax"], check=True)
        assert took < 2 * (time.monotonic() - began)
    assert run_sweep(folder) == (0, "")
    assert_same(folder / "map.nc", whole)


@pytest.mark.long
@pytest.mark.parametrize("backend", ["alone", "pool"])
def test_kills(tmp_path, backend):
    kills = Kills(tmp_path)
    assert kills.run_once(1, backend) >= 1
    assert kills.counts["chunks lost"] == kills.counts["chunks computed twice"] == 0
