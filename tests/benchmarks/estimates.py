"""Compare the estimates of `--dry-run` with measurements for each bundled sweep, in seconds of processor time.

    python tests/benchmarks/estimates.py [NAME ...]

A printout, not a test: a table with the ratios, and the constants of `vibrojax/maps/costs.py` on this machine
with this version of jax. Each sweep runs in a separate process with an empty cache. The benchmark takes five minutes.
Other work on the machine has little effect, since only the processor time of the process counts.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import jax

from vibrojax.cli import main
from vibrojax.lanes.chunks import Chunks
from vibrojax.maps.costs import STEP_SECONDS, YARDSTICK, machine_factor, processor_time
from vibrojax.maps.read import read_sweep
from vibrojax.settings.toml import bundled_names

WITHIN = 2.0
"""Factor within which the estimates should be."""


def processor() -> float:
    """Return the processor time of this process [s]."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def timed(kind: type, method: str, spent: dict[str, float]) -> None:
    """Add up the time of a method in `spent`."""
    plain = getattr(kind, method)

    def call(*given: object) -> object:
        began = processor()
        try:
            return plain(*given)
        finally:
            spent[method] = spent.get(method, 0.0) + processor() - began

    setattr(kind, method, call)


def one(name: str) -> None:
    """Run a sweep in this process, as the command does, and print estimated and measured times."""
    chunks = Chunks(read_sweep(name))
    said = processor_time(chunks)
    spent: dict[str, float] = {}
    timed(Chunks, "compile", spent)
    timed(Chunks, "compute", spent)
    with tempfile.TemporaryDirectory() as folder:
        assert main(["sweep", name, "-o", str(Path(folder) / "out.nc"), "--quiet"]) == 0
    step = spent["compute"] - spent["compile"]
    took = (processor() - spent["compute"], spent["compile"], step)
    told = {"name": name, "scene": chunks.sweep.scene, "said": said, "took": took, "slowness": machine_factor()}
    print(json.dumps(told))


def in_its_own_process(name: str) -> dict:
    """Return the output of `one` from a process with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"VIBROJAX_CACHE": cache, "MPLBACKEND": "agg"}
        command = [sys.executable, __file__, "--one", name]
        done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def table(names: list[str]) -> None:
    """Run the sweeps and print the table."""
    print(f"jax {jax.__version__}; seconds of processor time: said, took\n")
    print(f"{'':24}{'start':>14}{'compile':>14}{'step':>14}{'all':>14}  said/took")
    ratios, rows = [], []
    for name in names:
        row = in_its_own_process(name)
        said, took = ([*row[key], sum(row[key])] for key in ("said", "took"))
        ratios.append(said[-1] / took[-1])
        rows.append(row)
        pairs = "".join(f"{a:7.1f}{b:7.1f}" for a, b in zip(said, took, strict=True))
        print(f"{name:24}{pairs}  {ratios[-1]:.2f}", flush=True)
    beyond = sum(not 1 / WITHIN <= ratio <= WITHIN for ratio in ratios)
    print(f"\n{min(ratios):.2f} to {max(ratios):.2f}; {beyond} of {len(ratios)} not within a factor of {WITHIN}")
    fitted(rows)


def fitted(rows: list[dict]) -> None:
    """Print the constants that match the measurements: means over the sweeps of each scene."""
    slower = sum(row["slowness"] for row in rows) / len(rows)
    start, compiling = (sum(row["took"][i] / row["slowness"] for row in rows) / len(rows) for i in (0, 1))
    step = STEP_SECONDS * sum(row["took"][2] for row in rows) / sum(row["said"][2] for row in rows)
    print(f"\nyardstick {YARDSTICK * slower * 1e3:.2f} ms; on the machine of reference, by this:")
    print(f"start {start:.1f} s, compile {compiling:.1f} s, step {step * 1e9:.0f} ns")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        one(sys.argv[2])
    else:
        table(sys.argv[1:] or bundled_names())
