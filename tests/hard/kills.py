"""Kills a sweep, its workers and drivers at random instants: no finished chunk is lost or made twice.

    python tests/hard/kills.py [KILLS [SEED [DOOR ...]]]        200 kills of a single process, some quarter of an hour
    python tests/hard/kills.py 200 0 all                        200 kills over all doors

A sweep goes on in one folder, each time by a door chosen by chance: this process alone, two spawned workers, three
shares at once, a dask cluster, a pool of Python's, submitit's local jobs as an executor and as an array. A process of
it, chosen by chance, is killed (SIGKILL, which nothing can catch) a random time after; where it was the driver, the
sweep is started again. All the while every finished chunk is looked at: one that vanishes was lost, one that is
replaced was made twice. At the end the dataset is that of a sweep that nobody killed, bit for bit, and nothing lies
about.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
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
OUT = "out.nc"

_SCRIPT = """
import sys, functools, multiprocessing
from pathlib import Path
if __name__ == "__main__":
    import vibrojax.analyses.sweep.run as sweeping
    from vibrojax.sweep.input.read import read_sweep
    sweep, out = read_sweep(sys.argv[1]), Path(sys.argv[2])
"""
_POOL = """
    from concurrent.futures import ProcessPoolExecutor
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        sweeping.run_to_file(sweep, out, progress=False, executor=executor)
"""
_SUBMITIT = """
    import submitit
    executor = submitit.LocalExecutor(folder=out.with_name("jobs"))
    sweeping.run_to_file(sweep, out, progress=False, executor=executor)
"""
_ARRAY = """
    sweeping.by_slurm = functools.partial(sweeping.by_slurm, cluster="local")
    sweeping.run_to_file(sweep, out, progress=False, jobs=2)
"""
SCRIPTS = {"pool": _POOL, "submitit": _SUBMITIT, "array": _ARRAY}
DOORS = {"plain": 1, "processes": 3, "only": 3, "dask": 2, "pool": 2, "array": 2, "submitit": 0.3}
"""The doors, and how often each is taken: submitit starts a process for every chunk."""

WORKERS = ("spawn_main", "submitit.core._submit")
"""What stands in the commands of processes that compute chunks."""


def children(process: int) -> list[int]:
    """All processes below one, by number."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == process:
                found += [int(stat.parent.name), *children(int(stat.parent.name))]
    return found


def computing(processes: list[int]) -> list[int]:
    """Those of them that compute chunks: not what looks after their semaphores, nor what is not yet what it will be."""
    found = []
    for process in processes:
        with contextlib.suppress(OSError):
            command = Path(f"/proc/{process}/cmdline").read_text()
            if any(word in command for word in WORKERS) and "resource_tracker" not in command:
                found.append(process)
    return found


class Watch:
    """Looks at the finished chunks all the while; `lost` and `twice` are counted."""

    def __init__(self, folder: Path, out: Path):
        self.folder, self.out, self.seen, self.lost, self.twice = folder, out, {}, 0, 0
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._look, daemon=True)
        self.thread.start()

    def _look(self) -> None:
        while not self.over.wait(0.02):
            self.look()

    def look(self) -> None:
        found = {}
        with contextlib.suppress(FileNotFoundError):
            for entry in os.scandir(self.folder):
                if entry.name.endswith(".shard"):
                    with contextlib.suppress(FileNotFoundError):
                        about = entry.stat()
                        found[entry.name] = (about.st_ino, about.st_mtime_ns)
        self.twice += sum(1 for name, one in found.items() if self.seen.get(name, one) != one)
        if not self.out.exists():  # else they are being removed
            self.lost += sum(1 for name in self.seen if name not in found)
        self.seen |= found

    def close(self) -> None:
        self.over.set()
        self.thread.join()


class Kills:
    """Kills of one sweep in `folder`; `counted` says where they fell and what was seen after them."""

    def __init__(self, folder: Path, seed: int = 0, doors: tuple[str, ...] = ("plain",)):
        self.folder, self.random, self.counted, self.doors = folder, random.Random(seed), Counter(), doors
        self.out, self.wanted = folder / OUT, ""
        (folder / "sweep.toml").write_text(SWEEP)
        for name, text in SCRIPTS.items():
            (folder / f"by_{name}.py").write_text(_SCRIPT + text)
        self.whole = folder / "whole.nc"
        for _ in range(2):  # the first one compiles
            began = time.monotonic()
            whole = self._command("sweep.toml", "-o", self.whole.name)
            said = whole.communicate()[1]
            assert whole.returncode == 0, said
            self.longest = time.monotonic() - began
        self.cluster, self.seen_all = None, time.monotonic()
        if "dask" in doors:
            self.cluster = self._cluster()

    def close(self) -> None:
        if self.cluster is not None:
            self.cluster.close()

    def one_run(self, most: int) -> int:
        """Start over, kill at most `most` times, then let it end."""
        self.out.unlink(missing_ok=True)
        watch, kills = Watch(self.folder / f"{OUT}.chunks", self.out), 0
        while not self.out.exists():
            [door] = self.random.choices(self.doors, [DOORS[one] for one in self.doors])
            started = self._started(door)
            self.seen_all = began = time.monotonic()
            wait = self.random.uniform(0.0, 0.9 * self.longest)
            while any(one.poll() is None for one in started):
                time.sleep(0.02)
                self.wanted = self.wanted or self.random.choice(["driver", "worker", "worker"])
                if door == "only":
                    self.wanted = "driver"
                if door == "dask" and not self._dask_workers() and time.monotonic() - self.seen_all > 30.0:
                    self._begun_anew(started)
                if kills < most and time.monotonic() - began > wait and (victim := self._victim(door, started)):
                    self._kill(door, victim, started)
                    kills, self.wanted = kills + 1, ""
                    began, wait = time.monotonic(), self.random.uniform(0.3, 4.0)
            for one in started:
                said = one.communicate()[1].decode()
                status = one.returncode
                busy = status == 2 and "another process is at work there" in said
                # All jobs were killed, or so many workers in a row that it was given up: what is finished is kept.
                ended = status == 1 and ("the jobs ended, and" in said or "workers die before they finish" in said)
                self.counted["given up after kills in a row"] += ended
                assert status in (0, -signal.SIGKILL) or busy or ended, (door, status, said)
                if busy:  # jobs that outlive who began them
                    time.sleep(0.5)
        watch.close()
        self.counted["chunks lost"] += watch.lost
        self.counted["chunks computed twice"] += watch.twice
        self._compare()
        return kills

    def _victim(self, door: str, started: list[subprocess.Popen]) -> int | None:
        drivers = [one.pid for one in started if one.poll() is None]
        below = [process for one in drivers for process in children(one)]
        if door == "dask" and self.cluster is not None:
            below += self._dask_workers()
        choice = drivers if self.wanted == "driver" or door == "plain" else computing(below)
        return self.random.choice(choice) if choice else None

    def _dask_workers(self) -> list[int]:
        """Those of dask, once all of them are there: one that is killed while it starts its nanny gives up at times."""
        nannies = list(self.cluster.workers.values())
        if len(nannies) == 2 and all(one.status.name == "running" and one.pid for one in nannies):
            self.seen_all = time.monotonic()
            return [one.pid for one in nannies]
        return []

    def _begun_anew(self, started: list[subprocess.Popen]) -> None:
        """A new cluster, where dask has given up its workers: a sweep would wait for them, as it should."""
        for one in started:
            one.kill()
        self.counted["clusters of dask begun anew"] += 1
        self.cluster.close(timeout=10)
        self.cluster, self.seen_all = self._cluster(), time.monotonic()

    def _cluster(self):
        from distributed import LocalCluster

        return LocalCluster(2, processes=True, threads_per_worker=1, dashboard_address=":0")

    def _kill(self, door: str, victim: int, started: list[subprocess.Popen]) -> None:
        driver = next((one for one in started if one.pid == victim), None)
        left = children(victim) if driver else []
        with contextlib.suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
        self.counted[f"{door}: {'driver' if driver else 'worker'} killed"] += 1
        if driver is None:
            return
        driver.wait()
        if door in ("processes", "pool"):
            self._no_orphans(left, strict=door == "processes")

    def _no_orphans(self, left: list[int], strict: bool) -> None:
        end = time.monotonic() + 5.0
        while (still := computing(left)) and time.monotonic() < end:
            time.sleep(0.02)
        if strict:
            self.counted["orphans"] += len(still)
        for process in still:  # of Python's own pool, which waits for ever
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)

    def _started(self, door: str) -> list[subprocess.Popen]:
        if door == "plain":
            return [self._command("sweep.toml", "-o", OUT)]
        if door == "processes":
            return [self._command("sweep.toml", "-o", OUT, "--workers", "2")]
        if door == "only":
            return [self._command("sweep.toml", "-o", OUT, "--only", f"{part}/3") for part in (1, 2, 3)]
        if door == "dask":
            address = self.cluster.scheduler_address.replace("tcp://", "dask://")
            return [self._command("sweep.toml", "-o", OUT, "--workers", address)]
        return [self._process(f"by_{door}.py", "sweep.toml", OUT)]

    def _command(self, *words: str) -> subprocess.Popen:
        return self._process("-m", "vibrojax", "sweep", *words, "--quiet")

    def _process(self, *words: str) -> subprocess.Popen:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "VIBROJAX_CACHE": str(self.folder / "cache")}
        pipe = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        return subprocess.Popen([sys.executable, *words], cwd=self.folder, env=environment, **pipe)

    def _compare(self) -> None:
        """The dataset is the same, and nothing lies about."""
        with xr.open_dataset(self.whole) as expected, xr.open_dataset(self.out) as found:
            for name in expected.variables:
                np.testing.assert_array_equal(found[name].values, expected[name].values, err_msg=name)
            assert list(found.variables) == list(expected.variables)
        self.counted["datasets the same, bit for bit"] += 1
        chunks = self.folder / f"{OUT}.chunks"
        if chunks.exists():  # of who was killed while it removed them
            self.counted["folders left by a kill after the end"] += 1
            for path in chunks.iterdir():
                path.unlink()
            chunks.rmdir()
        self.counted["half-written files left"] += len([p for p in self.folder.iterdir() if p.name.endswith(".part")])


def main(most: str = "200", seed: str = "0", *doors: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        kills, done = Kills(Path(folder), int(seed), tuple(DOORS) if doors == ("all",) else doors or ("plain",)), 0
        try:
            while done < int(most):
                done += kills.one_run(min(10, int(most) - done))
                print(f"{done} kills: " + ", ".join(f"{what}: {n}" for what, n in kills.counted.items()), flush=True)
        finally:
            kills.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
