"""Test workers that die and drivers that are killed or interrupted: no finished chunk is lost, no process remains.

`python tests/hard/kills.py 200 0 all` repeats this two hundred times, through all entry points.
"""

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from commands import start

import vibrojax as vj
from vibrojax.analyses.sweep.run import run_to_file
from vibrojax.sweep.input.read import read_sweep

# Six chunks of about half a second each, so that even a busy machine polls while a chunk is computed.
TEXT = """
scene = "vibro-impact"
[grid]
beta = [0.3, 0.4, 0.5]
gamma = [0.6, 0.7, 0.75, 0.8]
[run]
settle = 3000.0
observe = 2.0
end_early = false
chunk = 2
"""

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks for processes where Linux has them"),
    pytest.mark.long,
]


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture
def command():
    """Return a function that starts the command. Processes that still run when the test ends are killed."""
    processes = []

    def start_command(*words: object) -> "subprocess.Popen[str]":
        processes.append(start(*words))
        return processes[-1]

    yield start_command
    for process in processes:
        process.kill()
        process.communicate()


def workers_of(process: int) -> list[int]:
    """Return the spawned workers of a process."""
    children = Path(f"/proc/{process}/task/{process}/children")
    pids = [int(pid) for path in children.parent.parent.glob("*/children") for pid in path.read_text().split()]
    commands = {pid: Path(f"/proc/{pid}/cmdline").read_bytes() for pid in pids}
    return [pid for pid, command in commands.items() if b"spawn_main" in command and b"resource_tracker" not in command]


def claim_texts(folder: Path) -> list[str]:
    """Return the texts of the claims in a folder."""
    texts = []
    for path in folder.glob("*.claim"):
        with contextlib.suppress(FileNotFoundError):
            texts.append(path.read_text())
    return texts


def wait_for(condition, seconds=300.0):
    """Return the first true value of a condition; the limit only ends a test that would hang."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return value


def stop_within_chunk(process, folder) -> bool:
    """Stop a process and return whether it has finished a chunk and holds another. If not, let it continue."""
    process.send_signal(signal.SIGSTOP)
    holds = any(f'"process": {process.pid},' in text for text in claim_texts(folder))
    if holds and list(folder.glob("chunk-*[02468].shard")):
        return True
    process.send_signal(signal.SIGCONT)
    assert process.poll() is None
    return False


def test_chunk_of_dead_worker_is_computed_by_another(file, command):
    """If the driver is killed or interrupted, its workers end too, and finished chunks remain."""
    out = file.with_name("out.nc")
    folder = out.with_name("out.nc.chunks")
    driver = command("sweep", file, "-o", out, "--workers", "2", "--quiet")
    before = wait_for(lambda: len(pids := workers_of(driver.pid)) == 2 and list(folder.glob("chunk-*.claim")) and pids)
    os.kill(before[0], signal.SIGKILL)
    wait_for(
        lambda: driver.poll() is not None or set(workers_of(driver.pid)) - set(before)
    )  # a new worker took its place
    wait_for(lambda: driver.poll() is not None or list(folder.glob("*.shard")))
    assert driver.poll() is None  # chunks remain to be computed
    workers, finished = workers_of(driver.pid), {path: path.stat().st_mtime_ns for path in folder.glob("*.shard")}
    driver.kill()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    resumed = command("sweep", file, "-o", out, "--workers", "2")
    workers = wait_for(lambda: len(pids := workers_of(resumed.pid)) == 2 and pids)
    resumed.send_signal(signal.SIGINT)
    assert resumed.wait() == 130
    message = resumed.stderr.read()
    assert f"to go on: vibrojax sweep {file} -o {out} --workers 2" in message and "Traceback" not in message
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    run_to_file(read_sweep(file), out, progress=False)
    expected = vj.run_sweep(file, progress=False)
    xr.testing.assert_identical(vj.open_dataset(out).drop_attrs(), expected.drop_attrs())
    assert {path.name for path in file.parent.iterdir()} == {"map.toml", "out.nc"}


def test_share_resumes_after_kill(file, command):
    """One of two concurrent shares is killed. Another process of the same share resumes where it stopped."""
    out = file.with_name("out.nc")
    folder = out.with_name("out.nc.chunks")
    first, second = (command("sweep", file, "-o", out, "--only", f"{part}/2", "--quiet") for part in (1, 2))
    wait_for(lambda: stop_within_chunk(first, folder))
    first.kill()
    first.wait()
    assert (second.wait(), second.stderr.read()) == (0, "")
    assert not out.exists()
    info = command("info", out)
    assert info.wait() == 0
    claim_lines = [line for line in info.stdout if "chunk-" in line]
    assert claim_lines and all("(has ended)" in line for line in claim_lines)
    finished = {path: path.stat().st_mtime_ns for path in folder.glob("*.shard")}
    resumed = command("sweep", file, "-o", out, "--only", "1/2", "--quiet")
    seen = {}
    while resumed.poll() is None:
        for path in finished:
            with contextlib.suppress(FileNotFoundError):  # they are removed at the end
                seen[path] = path.stat().st_mtime_ns
        time.sleep(0.02)
    assert resumed.wait() == 0 and seen == finished
    assert np.all(vj.open_dataset(out).status == 0) and not folder.exists()


def test_process_with_exclusive_folder_is_not_disturbed(file, command):
    file.write_text(TEXT.replace("3000.0", "60000.0"))
    out = file.with_name("out.nc")
    driver = command("sweep", file, "-o", out, "--workers", "2", "--quiet")
    wait_for(lambda: list(out.with_name("out.nc.chunks").glob("chunk-*.claim")))
    for words in (("--only", "1/2"), ()):
        other = command("sweep", file, "-o", out, *words)
        _, message = other.communicate()
        assert other.returncode == 2 and "another process is at work there" in message, message
    info = command("info", out.with_name("out.nc.chunks"))
    assert info.wait() == 0
    assert f", process {workers_of(driver.pid)[0]}, since 20" in info.stdout.read()
    driver.kill()
    shared = command("sweep", file, "-o", out, "--only", "1/2", "--quiet")
    wait_for(lambda: any(f'"process": {shared.pid},' in text for text in claim_texts(out.with_name("out.nc.chunks"))))
    alone = command("sweep", file, "-o", out)
    assert alone.wait() == 2
    message = alone.stderr.read()
    assert "another process is at work there (" in message and f"process {shared.pid}" in message
    shared.kill()
