"""Kill a sweep, its workers and drivers at random instants: no finished chunk may be lost or computed twice.

    python tests/hard/kills.py [KILLS [SEED [BACKEND ...]]]     200 kills of a single process, some 15 minutes
    python tests/hard/kills.py 200 0 all                        200 kills over all backends

A sweep continues in one folder, each time through a random backend. The backends are this process alone, a dask
cluster, a pool of Python's, and submitit's local jobs. After a random time, a random process of the sweep is killed
(SIGKILL, which cannot be caught). If it was the driver, the sweep starts again.

All finished chunks are watched: one that vanishes was lost, one that is replaced was computed twice. At the end the
dataset equals that of an undisturbed sweep bit for bit, and no other file remains.
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
import sys, multiprocessing
from pathlib import Path
if __name__ == "__main__":
    import vibrojax.maps.run as sweeping
    from vibrojax.maps.read import read_sweep
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
SCRIPTS = {"pool": _POOL, "submitit": _SUBMITIT}
BACKENDS = {"plain": 1, "dask": 2, "pool": 2, "submitit": 0.3}
"""Backends of a sweep and their weights: submitit starts a process for every chunk."""

WORKERS = ("spawn_main", "submitit.core._submit")
"""Words in the commands of processes that compute chunks."""


def children(process: int) -> list[int]:
    """Return the numbers of all processes below one."""
    below = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == process:
                below += [int(stat.parent.name), *children(int(stat.parent.name))]
    return below


def computing_chunks(processes: list[int]) -> list[int]:
    """Return those that compute chunks, without resource trackers and without processes that are still starting."""
    workers = []
    for process in processes:
        with contextlib.suppress(OSError):
            command = Path(f"/proc/{process}/cmdline").read_text()
            if any(word in command for word in WORKERS) and "resource_tracker" not in command:
                workers.append(process)
    return workers


class Watch:
    """A watch over the finished chunks, which counts those that are `lost` and those that are made `twice`."""

    def __init__(self, folder: Path, out: Path):
        self.folder, self.out, self.seen, self.lost, self.twice = folder, out, {}, 0, 0
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self._look, daemon=True)
        self.thread.start()

    def _look(self) -> None:
        while not self.stopped.wait(0.02):
            self.look()

    def look(self) -> None:
        finished = {}
        with contextlib.suppress(FileNotFoundError):
            for entry in os.scandir(self.folder):
                if entry.name.endswith(".zip"):
                    with contextlib.suppress(FileNotFoundError):
                        status = entry.stat()
                        finished[entry.name] = (status.st_ino, status.st_mtime_ns)
        self.twice += sum(1 for name, identity in finished.items() if self.seen.get(name, identity) != identity)
        if not self.out.exists():  # otherwise the sweep is removing them
            self.lost += sum(1 for name in self.seen if name not in finished)
        self.seen |= finished

    def close(self) -> None:
        self.stopped.set()
        self.thread.join()


class Kills:
    """A series of kills of one sweep in `folder`; `counts` holds the counts of kills and of their effects."""

    def __init__(self, folder: Path, seed: int = 0, backends: tuple[str, ...] = ("plain",)):
        self.folder, self.random, self.counts, self.backends = folder, random.Random(seed), Counter(), backends
        self.out, self.victim_kind = folder / OUT, ""
        (folder / "sweep.toml").write_text(SWEEP)
        for name, text in SCRIPTS.items():
            (folder / f"by_{name}.py").write_text(_SCRIPT + text)
        self.whole = folder / "whole.nc"
        for _ in range(2):  # the first run compiles
            began = time.monotonic()
            whole = self._command("sweep.toml", "-o", self.whole.name)
            errors = whole.communicate()[1]
            assert whole.returncode == 0, errors
            self.duration = time.monotonic() - began
        self.cluster, self.workers_seen_at = None, time.monotonic()
        if "dask" in backends:
            self.cluster = self._cluster()

    def close(self) -> None:
        if self.cluster is not None:
            self.cluster.close()

    def run_once(self, most: int) -> int:
        """Start over, kill at most `most` times, then let the sweep finish."""
        self.out.unlink(missing_ok=True)
        watch, kills = Watch(self.folder / f"{OUT}.chunks", self.out), 0
        while not self.out.exists():
            [backend] = self.random.choices(self.backends, [BACKENDS[name] for name in self.backends])
            processes = self._start(backend)
            self.workers_seen_at = began = time.monotonic()
            wait = self.random.uniform(0.0, 0.9 * self.duration)
            while any(process.poll() is None for process in processes):
                time.sleep(0.02)
                self.victim_kind = self.victim_kind or self.random.choice(["driver", "worker", "worker"])
                if backend == "dask" and not self._dask_workers() and time.monotonic() - self.workers_seen_at > 30.0:
                    self._restart_cluster(processes)
                if kills < most and time.monotonic() - began > wait and (victim := self._victim(backend, processes)):
                    self._kill(backend, victim, processes)
                    kills, self.victim_kind = kills + 1, ""
                    began, wait = time.monotonic(), self.random.uniform(0.3, 4.0)
            for process in processes:
                errors = process.communicate()[1].decode()
                status = process.returncode
                busy = status == 2 and "another process is at work there" in errors
                assert status in (0, -signal.SIGKILL) or busy, (backend, status, errors)
        watch.close()
        self.counts["chunks lost"] += watch.lost
        self.counts["chunks computed twice"] += watch.twice
        self._compare()
        return kills

    def _victim(self, backend: str, processes: list[subprocess.Popen]) -> int | None:
        drivers = [process.pid for process in processes if process.poll() is None]
        below = [process for driver in drivers for process in children(driver)]
        if backend == "dask" and self.cluster is not None:
            below += self._dask_workers()
        choice = drivers if self.victim_kind == "driver" or backend == "plain" else computing_chunks(below)
        return self.random.choice(choice) if choice else None

    def _dask_workers(self) -> list[int]:
        """Return dask's workers once all of them run: a nanny may give up if its worker is killed while it starts."""
        nannies = list(self.cluster.workers.values())
        if len(nannies) == 2 and all(nanny.status.name == "running" and nanny.pid for nanny in nannies):
            self.workers_seen_at = time.monotonic()
            return [nanny.pid for nanny in nannies]
        return []

    def _restart_cluster(self, processes: list[subprocess.Popen]) -> None:
        """Start a new cluster if dask has given up its workers: a sweep would wait for them, as it should."""
        for process in processes:
            process.kill()
        self.counts["clusters of dask begun anew"] += 1
        self.cluster.close(timeout=10)
        self.cluster, self.workers_seen_at = self._cluster(), time.monotonic()

    def _cluster(self):
        from distributed import LocalCluster

        return LocalCluster(2, processes=True, threads_per_worker=1, dashboard_address=":0")

    def _kill(self, backend: str, victim: int, processes: list[subprocess.Popen]) -> None:
        driver = next((process for process in processes if process.pid == victim), None)
        descendants = children(victim) if driver else []
        with contextlib.suppress(ProcessLookupError):
            os.kill(victim, signal.SIGKILL)
        self.counts[f"{backend}: {'driver' if driver else 'worker'} killed"] += 1
        if driver is None:
            return
        driver.wait()
        for process in computing_chunks(descendants):  # Python's own pool waits for ever
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)

    def _start(self, backend: str) -> list[subprocess.Popen]:
        if backend == "plain":
            return [self._command("sweep.toml", "-o", OUT)]
        if backend == "dask":
            address = self.cluster.scheduler_address.replace("tcp://", "dask://")
            return [self._command("sweep.toml", "-o", OUT, "--workers", address)]
        return [self._process(f"by_{backend}.py", "sweep.toml", OUT)]

    def _command(self, *arguments: str) -> subprocess.Popen:
        return self._process("-m", "vibrojax", "sweep", *arguments, "--quiet")

    def _process(self, *arguments: str) -> subprocess.Popen:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "VIBROJAX_CACHE": str(self.folder / "cache")}
        pipe = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        return subprocess.Popen([sys.executable, *arguments], cwd=self.folder, env=environment, **pipe)

    def _compare(self) -> None:
        """Check that the dataset is the same and that no other file remains."""
        with xr.open_dataset(self.whole) as expected, xr.open_dataset(self.out) as result:
            for name in expected.variables:
                np.testing.assert_array_equal(result[name].values, expected[name].values, err_msg=name)
            assert list(result.variables) == list(expected.variables)
        self.counts["datasets the same, bit for bit"] += 1
        chunks = self.folder / f"{OUT}.chunks"
        if chunks.exists():  # left by a process that was killed while it removed them
            self.counts["folders left by a kill after the end"] += 1
            for path in chunks.iterdir():
                path.unlink()
            chunks.rmdir()
        self.counts["half-written files left"] += len([p for p in self.folder.iterdir() if p.name.endswith(".part")])


def main(most: str = "200", seed: str = "0", *backends: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        names = tuple(BACKENDS) if backends == ("all",) else backends or ("plain",)
        kills, done = Kills(Path(folder), int(seed), names), 0
        try:
            while done < int(most):
                done += kills.run_once(min(10, int(most) - done))
                print(f"{done} kills: " + ", ".join(f"{effect}: {n}" for effect, n in kills.counts.items()), flush=True)
        finally:
            kills.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
