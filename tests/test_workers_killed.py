"""Workers that die, drivers that are killed or interrupted: nothing that is finished is lost, nobody is left behind.

`python tests/hard/kills.py 200 0 all` does so two hundred times, over all doors.
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

# Six chunks of about half a second each: long enough that a busy machine still looks while one is computed.
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
    """Starts the command with some words; what still runs when the test ends is killed."""
    started = []

    def begin(*words: object) -> "subprocess.Popen[str]":
        started.append(start(*words))
        return started[-1]

    yield begin
    for one in started:
        one.kill()
        one.communicate()


def workers_of(process: int) -> list[int]:
    """The spawned workers of a process."""
    children = Path(f"/proc/{process}/task/{process}/children")
    found = [int(one) for path in children.parent.parent.glob("*/children") for one in path.read_text().split()]
    commands = {one: Path(f"/proc/{one}/cmdline").read_bytes() for one in found}
    return [one for one, command in commands.items() if b"spawn_main" in command and b"resource_tracker" not in command]


def claims(folder: Path) -> list[str]:
    """What the claims in a folder say."""
    found = []
    for path in folder.glob("*.claim"):
        with contextlib.suppress(FileNotFoundError):
            found.append(path.read_text())
    return found


def wait_for(condition, seconds=300.0):
    """Return the first true value of a condition; the limit only ends a test that would hang."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end
        time.sleep(0.02)
    return value


def stopped_amid_a_chunk(process, folder) -> bool:
    """Stop a process and say whether it has finished a chunk and holds another; it continues where it has not."""
    process.send_signal(signal.SIGSTOP)
    holds = any(f'"process": {process.pid},' in text for text in claims(folder))
    if holds and list(folder.glob("chunk-*[02468].shard")):
        return True
    process.send_signal(signal.SIGCONT)
    assert process.poll() is None
    return False


def test_a_worker_that_dies_gives_its_chunk_to_another(file, command):
    """And when the one who began is killed, or interrupted, its workers are gone too, and what is finished stays."""
    out = file.with_name("out.nc")
    folder = out.with_name("out.nc.chunks")
    began = command("sweep", file, "-o", out, "--workers", "2", "--quiet")
    before = wait_for(lambda: len(found := workers_of(began.pid)) == 2 and list(folder.glob("chunk-*.claim")) and found)
    os.kill(before[0], signal.SIGKILL)
    wait_for(lambda: began.poll() is not None or set(workers_of(began.pid)) - set(before))  # another took its place
    wait_for(lambda: began.poll() is not None or list(folder.glob("*.shard")))
    assert began.poll() is None  # there is more to do
    workers, finished = workers_of(began.pid), {path: path.stat().st_mtime_ns for path in folder.glob("*.shard")}
    began.kill()
    wait_for(lambda: not any(Path(f"/proc/{one}").exists() for one in workers))
    again = command("sweep", file, "-o", out, "--workers", "2")
    workers = wait_for(lambda: len(found := workers_of(again.pid)) == 2 and found)
    again.send_signal(signal.SIGINT)
    assert again.wait() == 130
    said = again.stderr.read()
    assert f"to go on: vibrojax sweep {file} -o {out} --workers 2" in said and "Traceback" not in said
    wait_for(lambda: not any(Path(f"/proc/{one}").exists() for one in workers))
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    run_to_file(read_sweep(file), out, progress=False)
    expected = vj.run_sweep(file, progress=False)
    xr.testing.assert_identical(vj.open_dataset(out).drop_attrs(), expected.drop_attrs())
    assert {path.name for path in file.parent.iterdir()} == {"map.toml", "out.nc"}


def test_shares_take_over_from_one_that_was_killed(file, command):
    """Of two shares at once one is killed; another process of the same share goes on where it was."""
    out = file.with_name("out.nc")
    folder = out.with_name("out.nc.chunks")
    first, second = (command("sweep", file, "-o", out, "--only", f"{part}/2", "--quiet") for part in (1, 2))
    wait_for(lambda: stopped_amid_a_chunk(first, folder))
    first.kill()
    first.wait()
    assert (second.wait(), second.stderr.read()) == (0, "")
    assert not out.exists()
    told = command("info", out)
    assert told.wait() == 0
    held = [line for line in told.stdout if "chunk-" in line]
    assert held and all("(has ended)" in line for line in held)
    finished = {path: path.stat().st_mtime_ns for path in folder.glob("*.shard")}
    again = command("sweep", file, "-o", out, "--only", "1/2", "--quiet")
    seen = {}
    while again.poll() is None:
        for path in finished:
            with contextlib.suppress(FileNotFoundError):  # at the end they are removed
                seen[path] = path.stat().st_mtime_ns
        time.sleep(0.02)
    assert again.wait() == 0 and seen == finished
    assert np.all(vj.open_dataset(out).status == 0) and not folder.exists()


def test_one_who_has_the_folder_for_himself_is_left_alone(file, command):
    file.write_text(TEXT.replace("3000.0", "60000.0"))
    out = file.with_name("out.nc")
    began = command("sweep", file, "-o", out, "--workers", "2", "--quiet")
    wait_for(lambda: list(out.with_name("out.nc.chunks").glob("chunk-*.claim")))
    for words in (("--only", "1/2"), ()):
        other = command("sweep", file, "-o", out, *words)
        _, said = other.communicate()
        assert other.returncode == 2 and "another process is at work there" in said, said
    told = command("info", out.with_name("out.nc.chunks"))
    assert told.wait() == 0
    assert f", process {workers_of(began.pid)[0]}, since 20" in told.stdout.read()
    began.kill()
    shared = command("sweep", file, "-o", out, "--only", "1/2", "--quiet")
    wait_for(lambda: any(f'"process": {shared.pid},' in text for text in claims(out.with_name("out.nc.chunks"))))
    alone = command("sweep", file, "-o", out)
    assert alone.wait() == 2
    said = alone.stderr.read()
    assert "another process is at work there (" in said and f"process {shared.pid}" in said
    shared.kill()
