"""Measure the overhead of workers over a plain run, and their idle time at the end.

    python tests/benchmarks/workers.py overhead [MINUTES [ROUNDS]]     5 minutes of a plain run, 3 rounds: half an hour
    python tests/benchmarks/workers.py idle                            a minute

*overhead*: compare a plain run, whose threads use all cores, with one of as many workers as cores, on the same sweep in
turn. The times are wall time and processor time of the whole command with its workers. The number of lanes is chosen to
take MINUTES. Nothing else should run meanwhile; otherwise only the processor time is meaningful.

*idle*: run lanes whose costs differ by a factor of a hundred, because their contact dampers are stiff, with 2 and with
4 workers. The output gives the computing and the idle time of each worker.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vibrojax.compile.xla import usable_cores
from vibrojax.maps.read import read_sweep
from vibrojax.maps.run import estimate

MAP = """
scene = "vibro-impact"
starts = ["stuck"]
[grid]
beta = {{ start = 0.25, stop = 0.60, num = {rows} }}
gamma = {{ start = 0.60, stop = 0.80, num = 512 }}
"""
STIFF = """
scene = "vibro-impact"
starts = ["stuck"]
unusual = true
[grid]
c2 = { start = 200, stop = 1e6, num = 32, spacing = "log" }
gamma = { start = 0.60, stop = 0.80, num = 256 }
[run]
settle = 8.0
observe = 4.0
chunk = 256
"""


def taken(*words: str) -> tuple[float, float, str]:
    """Return wall time and processor time [s] of a command and its workers, and its output."""
    before, clock = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    command = [sys.executable, "-m", "vibrojax", "sweep", *words]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    done = subprocess.run(command, check=True, env=os.environ | {"MPLBACKEND": "agg"}, **pipes)
    passed, after = time.monotonic() - clock, resource.getrusage(resource.RUSAGE_CHILDREN)
    return passed, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stderr


def overhead(folder: Path, minutes: float, rounds: int) -> None:
    """Print the times of a plain run and of one with workers, in turn."""
    file, out, cores = folder / "map.toml", folder / "out.nc", usable_cores()
    file.write_text(MAP.format(rows=1000))
    rows = max(8, round(1000 * 60 * minutes / estimate(read_sweep(file), to_file=True)["step_s"]))
    file.write_text(MAP.format(rows=rows))
    print(f"{rows * 512} lanes, {cores} cores")
    for _ in range(rounds):
        found = []
        for name, words in (("plain", ()), (f"{cores} workers", ("--workers", str(cores)))):
            clock, processor, _ = taken(str(file), "-o", str(out), "--fresh", "--quiet", *words)
            found.append((clock, processor))
            print(f"{name:12} {clock:7.1f} s, processor {processor:7.1f} s", flush=True)
        over = [f"{100 * (second / first - 1):+.1f} %" for first, second in zip(*found, strict=True)]
        print(f"{'over':12} {over[0]:>9}, processor {over[1]:>9}", flush=True)


def idle(folder: Path) -> None:
    """Print the idle time of each worker."""
    file = folder / "stiff.toml"
    file.write_text(STIFF)
    for count in ("2", "4"):
        said = taken(str(file), "-o", str(folder / "out.nc"), "--fresh", "--verbose", "--workers", count)[2]
        print(next(line for line in said.splitlines() if "workers: " in line), flush=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        if sys.argv[1:2] == ["idle"]:
            idle(Path(place))
        else:
            numbers = [float(one) for one in sys.argv[2:]]
            overhead(Path(place), numbers[0] if numbers else 5.0, int(numbers[1]) if numbers[1:] else 3)
