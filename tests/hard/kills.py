"""Kills a sweep at random instants, again and again, and proves that no finished chunk is lost.

    python tests/hard/kills.py [KILLS [SEED]]        200 kills, some quarter of an hour

A sweep in a process of its own is killed (SIGKILL, which nothing can catch) a random time after it began, and started
again, until it ends. After each kill every chunk that was there before is still there, byte for byte; at the end the
dataset is that of a sweep that nobody killed, bit for bit. It prints how many kills fell where, and what was lost.
"""

import contextlib
import hashlib
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
chunk = 5
"""
CHUNKS = 60
OUT = "out.nc"


def cached(folder: Path) -> dict[str, str]:
    """The environment in which a process takes its compiled programs from others before it."""
    names = ("MIN_COMPILE_TIME_SECS", "MIN_ENTRY_SIZE_BYTES")
    always = {f"JAX_PERSISTENT_CACHE_{name}": "0" for name in names}
    return {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache")} | always


def assert_same(one: Path, other: Path) -> None:
    """The variables of two datasets are the same, bit for bit, in the same order."""
    with xr.open_dataset(one) as found, xr.open_dataset(other) as expected:
        for name in expected.variables:
            np.testing.assert_array_equal(found[name].values, expected[name].values, err_msg=name)
        assert list(found.variables) == list(expected.variables)


class Kills:
    """Kills of one sweep in `folder`; `counted` says where they fell and what was seen after them."""

    def __init__(self, folder: Path, seed: int = 0):
        self.folder, self.random, self.counted = folder, random.Random(seed), Counter()
        (folder / "sweep.toml").write_text(SWEEP)
        self.whole = self.folder / "whole.nc"
        for _ in range(2):  # the first one compiles
            began = time.monotonic()
            assert self._started(self.whole).wait() == 0
            self.longest = time.monotonic() - began

    def one_run(self, most: int) -> int:
        """Start over, kill at most `most` times, then let it end."""
        kills, out = 0, self.folder / OUT
        out.unlink(missing_ok=True)
        while kills < most:
            before = self._chunks()
            process = self._started(out)
            self._wait(process, len(before))
            process.send_signal(signal.SIGKILL)
            status = process.wait()
            if status == 0:
                break
            assert status == -signal.SIGKILL, f"status {status}"
            kills += 1
            self._check(before, out)
        else:
            assert self._started(out).wait() == 0
        self._compare(out)
        return kills

    def _wait(self, process: subprocess.Popen, before: int) -> None:
        """Wait for a random instant: within the whole run, or a moment after some more chunks are there."""
        chunks = self.random.choice([0, self.random.randint(before, CHUNKS)])
        moment = self.random.uniform(0.0, 0.1 if chunks else self.longest)
        while chunks and process.poll() is None and len(self._chunks()) < chunks:
            time.sleep(0.01)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(moment)

    def _started(self, out: Path) -> subprocess.Popen:
        command = [sys.executable, "-m", "vibrojax", "sweep", str(self.folder / "sweep.toml"), "-o", str(out)]
        environment = os.environ | {"PYTHONPATH": str(ROOT)} | cached(self.folder)
        return subprocess.Popen([*command, "--quiet"], cwd=self.folder, env=environment)

    def _chunks(self) -> dict[str, str]:
        """The checksum of each finished chunk."""
        folder = self.folder / f"{OUT}.chunks"
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.glob("*.shard"))}

    def _check(self, before: dict[str, str], out: Path) -> None:
        after = self._chunks()
        if out.exists():  # it was killed after the dataset was whole, while chunks were removed or drawn
            self.counted["killed when the dataset was whole"] += 1
            assert_same(out, self.whole)
            out.unlink()
            return
        self.counted["chunks lost"] += sum(after.get(name) != digest for name, digest in before.items())
        self.counted["killed before the first chunk" if not after else "killed between the chunks"] += 1
        self.counted["half-written files left"] += len(list(self.folder.glob(f"{OUT}.chunks/*.tmp")))

    def _compare(self, out: Path) -> None:
        """The dataset is the same, and nothing lies about."""
        assert_same(out, self.whole)
        left = [path.name for path in self.folder.iterdir() if path.name.endswith((".tmp", ".part", ".chunks"))]
        assert left == [], left
        self.counted["datasets the same, bit for bit"] += 1


def main(most: int = 200, seed: int = 0) -> None:
    with tempfile.TemporaryDirectory() as folder:
        kills = Kills(Path(folder), seed)
        print(f"a whole sweep takes {kills.longest:.1f} s", flush=True)
        done = 0
        while done < most:
            done += kills.one_run(min(10, most - done))
            print(f"{done} kills: " + ", ".join(f"{what}: {n}" for what, n in kills.counted.items()), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
