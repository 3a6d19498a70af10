"""Kill a sweep, or a worker of its pool, at random instants: no finished chunk may be lost or computed twice.

    python tests/hard/kills.py [KILLS [SEED]]     200 kills, some 15 minutes

A sweep continues in one folder, alone or with a pool of processes. After a random time, a random process of the sweep
is killed (SIGKILL, which cannot be caught). If it was the driver, the sweep starts again. All finished chunks are
watched: one that vanishes was lost, one that is replaced was computed twice. At the end the dataset equals that of an
undisturbed sweep bit for bit, and no other file remains.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import xarray as xr

ROOT = Path(__file__).parents[2]
SWEEP = """
scene = "penetration"
[grid]
frequency = { start = 10, stop = 40, num = 20 }
force = { start = 100e3, stop = 300e3, num = 15 }
[run]
settle = 0.4
observe = 0.4
chunk = 10
"""
POOL = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
if __name__ == "__main__":
    from vibrojax.maps.read import read_sweep
    from vibrojax.maps.run import run_to_file
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        run_to_file(read_sweep("sweep.toml"), Path("out.nc"), progress=False, executor=executor)
"""
COMMAND = ("-m", "vibrojax", "sweep", "sweep.toml", "--quiet", "-o")
WORDS = {"alone": (*COMMAND, "out.nc"), "pool": ("pool.py",)}


def workers(driver: int) -> list[int]:
    """Return the numbers of the processes of a driver that compute chunks."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            is_child = int(stat.read_text().rpartition(")")[2].split()[1]) == driver
            if is_child and "spawn_main" in stat.with_name("cmdline").read_text():
                found.append(int(stat.parent.name))
    return found


def kill(process: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)


class Kills:
    """A series of kills of one sweep in `folder`; `counts` holds the counts of kills and of their effects."""

    def __init__(self, folder: Path, seed: int = 0):
        self.folder, self.random, self.counts = folder, random.Random(seed), Counter()
        self.out, self.chunks = folder / "out.nc", folder / "out.nc.chunks"
        (folder / "sweep.toml").write_text(SWEEP)
        (folder / "pool.py").write_text(POOL)
        process = self._start(*COMMAND, "whole.nc")
        while process.poll() is None and not any(folder.glob("whole.nc.chunks/*.zip")):
            time.sleep(0.02)
        began = time.monotonic()
        errors = process.communicate()[1]
        assert process.returncode == 0, errors
        self.duration = time.monotonic() - began

    def run_once(self, most: int, backend: str = "alone") -> int:
        """Start over, kill at most `most` times, then let the sweep finish and compare its dataset."""
        self.out.unlink(missing_ok=True)
        seen, kills = {}, 0
        while not self.out.exists():
            process, kill_at = self._start(*WORDS[backend]), np.inf  # a random time after the first chunk
            while process.poll() is None:
                self._look(seen)
                if seen and kill_at == np.inf:
                    kill_at = time.monotonic() + self.random.uniform(0.0, 0.9 * self.duration)
                if kills < most and time.monotonic() > kill_at:
                    victims = [process.pid, *workers(process.pid)]
                    victim = self.random.choice(victims)
                    kill(victim)
                    self.counts[f"{backend}: {'driver' if victim == process.pid else 'worker'} killed"] += 1
                    kills, kill_at = kills + 1, time.monotonic() + self.random.uniform(0.3, 4.0)
                    if victim == process.pid:
                        process.wait()
                        for worker in victims[1:]:  # Python's own pool waits for ever
                            kill(worker)
                time.sleep(0.02)
            errors = process.communicate()[1]
            assert process.returncode in (0, -signal.SIGKILL), errors
        with xr.open_dataset(self.folder / "whole.nc") as expected, xr.open_dataset(self.out) as result:
            xr.testing.assert_identical(result.drop_attrs(deep=False), expected.drop_attrs(deep=False))
        self.counts["datasets the same, bit for bit"] += 1
        for path in self.chunks.glob("*"):  # left by a process that was killed while it removed them
            path.unlink()
        return kills

    def _look(self, seen: dict) -> None:
        """Count the chunks that are lost and those that are made twice."""
        finished = {}
        with contextlib.suppress(FileNotFoundError):
            for path in self.chunks.glob("*.zip"):
                status = path.stat()
                finished[path.name] = (status.st_ino, status.st_mtime_ns)
            self.counts["chunks computed twice"] += sum(seen.get(name, made) != made for name, made in finished.items())
            if not self.out.exists():  # otherwise the sweep is removing them
                self.counts["chunks lost"] += len(seen.keys() - finished)
        seen |= finished

    def _start(self, *arguments: str) -> subprocess.Popen:
        about = {"cwd": self.folder, "env": os.environ | {"PYTHONPATH": str(ROOT)}}
        files = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        return subprocess.Popen([sys.executable, *arguments], **about, **files)


def main(most: str = "200", seed: str = "0") -> None:
    with tempfile.TemporaryDirectory() as folder:
        kills, done = Kills(Path(folder), int(seed)), 0
        while done < int(most):
            done += kills.run_once(min(10, int(most) - done), kills.random.choice([*WORDS]))
            print(f"{done} kills: " + ", ".join(f"{effect}: {n}" for effect, n in kills.counts.items()), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
