"""Time the finished map: from a fresh process, with the compile cache, and the lanes alone with and without early ends.

    python tests/benchmarks/finished_map.py

A printout, not a test. Nothing else should run meanwhile; it takes about two minutes.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import vibrojax as vj
from vibrojax.maps.read import read_sweep
from vibrojax.studies.accuracy import machine

COMMAND = (sys.executable, "-m", "vibrojax")
BOX = {
    "beta": {"start": 0.25, "stop": 0.6, "num": 36},
    "gamma": {"start": 0.6, "stop": 0.8, "num": 21},
    "v": {"start": 0.5, "stop": 2.0, "num": 4, "spacing": "log"},
    "delta": [-0.005, 0.005],
}
REPEATS = 5


def process(*command: str, cache: str | None = None) -> float:
    """Return the wall time of a fresh process [s]."""
    environment = os.environ | {"VIBROJAX_CACHE": cache or "off"}
    began = time.perf_counter()
    subprocess.run(command, env=environment, check=True, capture_output=True)
    return time.perf_counter() - began


def told(what: str, seconds: list[float], more: str = "") -> None:
    half = (max(seconds) - min(seconds)) / 2
    print(f"{what:58}{statistics.median(seconds):8.2f} s  ± {half:.2f}  {more}", flush=True)


def main() -> None:
    print(", ".join(f"{name} {value}" for name, value in machine().items()), "\n", flush=True)
    told("python -c pass", [process(sys.executable, "-c", "pass") for _ in range(REPEATS)])
    told("vibrojax --help", [process(*COMMAND, "--help") for _ in range(REPEATS)])
    told("import vibrojax", [process(sys.executable, "-c", "import vibrojax") for _ in range(REPEATS)])
    with tempfile.TemporaryDirectory() as folder:
        out, cache = Path(folder) / "map.nc", str(Path(folder) / "cache")
        sweep = (*COMMAND, "sweep", "regime-map", "--fresh", "-o", str(out))
        told("vibrojax sweep regime-map, picture and all", [process(*sweep) for _ in range(3)])
        told("the same, filling a compile cache", [process(*sweep, cache=cache)])
        told("the same, from the compile cache", [process(*sweep, cache=cache) for _ in range(3)])
    for early in (False, True):
        sweep = read_sweep({"scene": "vibro-impact", "grid": BOX, "run": {"end_early": early}})
        vj.run_sweep(sweep, progress=False)  # compiles
        seconds, steps = [], 0
        for _ in range(REPEATS):
            began = time.perf_counter()
            dataset = vj.run_sweep(sweep, progress=False)
            seconds.append(time.perf_counter() - began)
            steps = json.loads(dataset.attrs["solver"])["steps"]
        each = 1e6 * statistics.median(seconds) / sweep.lanes / (sweep.run.settle + sweep.run.observe)
        more = f"{each:.1f} microseconds per lane-second, {steps / sweep.lanes:.0f} steps a lane"
        told(f"{sweep.lanes:,} lanes, certified, end_early = {str(early).lower()}", seconds, more)


if __name__ == "__main__":
    main()
