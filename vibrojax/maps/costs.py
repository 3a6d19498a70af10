"""Estimate of the processor time, memory and disk space of a sweep before it runs, without compiling or stepping.

The estimate is within about a factor of two of the true cost. `--dry-run --measure` computes some chunks instead.
`python tests/benchmarks/estimates.py` compares the estimates of all bundled sweeps with their true times, and prints
measured values of the constants of this file.
"""

import bz2
import os
import shutil
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypedDict

import numpy as np
from jaxtyping import Float, Int

from vibrojax.errors import Place, counted
from vibrojax.io.formatting import size_text, time_text
from vibrojax.lanes.batch import steps_at_most
from vibrojax.lanes.chunks import Chunks
from vibrojax.lanes.labelled import fastest_rates
from vibrojax.lanes.underway import OBSERVING
from vibrojax.maps.sweep import Sweep
from vibrojax.scenes import HasContact, HasFriction, HasRock

FRICTION_EVENTS, CONTACT_EVENTS, ROCK_EVENTS, PULSE_EVENTS = 12.0, 45.0, 190.0, 1000.0
"""Steps that end at events per simulated second [1/s], in addition to the steps of the flight: means over the bundled
sweeps. Each impact on rock and each pulse causes a cascade of events."""

STEP_SECONDS = 75e-9
"""Time of one step of one lane while it settles [s]: between 53 ns in rotary and 92 ns in coupled-drilling."""

COMPILE_SECONDS = 1.2
"""Time to compile a scene's programs [s]: between 0.5 s in penetration and 1.9 s in coupled-drilling."""

START_SECONDS = 2.0
"""Time for imports, reading, writing and plotting [s]."""

LANE = 25e-6
"""Time per lane in addition to its steps [s]: to initialize, measure, store, label and write it."""

YARDSTICK = 1.92e-3
"""Time of the benchmark in `machine_factor` on the machine on which the constants were measured [s]."""

CHECK_RUN, ENDING_EARLY, ENDING_ON_ORBITS, EXPONENTS = 1.5, 0.75, 0.6, 8.0
"""Factors on the work of a lane's steps. The check run adds half as many steps. Early stopping saves a quarter of the
work, and two fifths if lanes also stop on known orbits. Lyapunov exponents require long runs of the irregular lanes,
which are about a quarter of a map."""

CHUNK_BYTES, FILE_BYTES, PACKED = 272, 210, 0.75
"""Size of a lane in a finished chunk, in the dataset before packing [bytes], and ratio of packed to unpacked size: the
largest of the bundled sweeps."""

ORBIT_BYTES, RETURN_BYTES = (136, 108), 48
"""Size of a lane's orbit in a chunk and in the dataset, and size of each stored section crossing in both [bytes]."""

STEPPED_MAX_LANES = 2**40
"""Number of lanes above which a sweep is certainly rejected and its stiffness is therefore not sampled."""

SAMPLES, SAMPLE = 8, 256
"""Number of positions in a sweep, and number of lanes at each position, for which steps are estimated. In a smaller
sweep, the steps of all lanes are."""

LanesFloat = Float[np.ndarray, " lanes"]
LaneNumbers = Int[np.ndarray, " lanes"]


class Seconds(NamedTuple):
    """Processor times to launch, compile and step [s]. Only the time to step depends on the lanes, and is parallel."""

    start: float
    compile: float
    step: float


def processor_time(chunks: Chunks) -> Seconds:
    """Return a rough estimate of a sweep's processor time, without compiling or stepping."""
    run, speed = chunks.sweep.run, machine_factor()
    step = STEP_SECONDS * CHECK_RUN * (1 + (OBSERVING - 1) / (1 + run.settle / run.observe))
    ends_on_orbits = chunks.ends_early and chunks.ends is not None
    if chunks.ends_early:
        step *= ENDING_ON_ORBITS if ends_on_orbits else ENDING_EARLY
    if run.lyapunov:
        step *= EXPONENTS
    # Orbits and exponents have programs of their own, about as large as those that step lanes.
    compiling = COMPILE_SECONDS * (1 + ends_on_orbits + run.orbits + run.lyapunov)
    stepping = step * estimated_steps(chunks).total + LANE * chunks.sweep.lanes
    return Seconds(speed * START_SECONDS, speed * compiling, speed * stepping)


def lane_bytes(sweep: Sweep) -> tuple[int, int]:
    """Return the size of a lane in a finished chunk, and in the dataset before packing [bytes]."""
    in_chunk, in_file = ORBIT_BYTES if sweep.run.orbits else (0, 0)
    returns = RETURN_BYTES * sweep.run.keep_returns
    return CHUNK_BYTES + returns + in_chunk, FILE_BYTES + returns + in_file


def lane_steps(chunks: Chunks, numbers: LaneNumbers) -> LanesFloat:
    """Return the estimated number of steps of each lane in `numbers` (lanes,)."""
    sweep, run, accuracy = chunks.sweep, chunks.sweep.run, chunks.accuracy
    scene, seconds = sweep.system, run.settle + run.observe
    rates = np.full(len(numbers), 1 / accuracy.step)
    with np.errstate(all="ignore"):
        if not run.stepper.smooths:
            if isinstance(scene, HasRock):
                rates += ROCK_EVENTS if scene.autonomous else PULSE_EVENTS
            else:
                rates += CONTACT_EVENTS if isinstance(scene, HasContact) else FRICTION_EVENTS
            if isinstance(scene, HasFriction) and sweep.lanes <= STEPPED_MAX_LANES:
                rates += fastest_rates(scene, sweep.values_of(numbers)[0]).flight / accuracy.stride
        return np.minimum(np.nan_to_num(rates, nan=np.inf) * seconds, steps_at_most(seconds, accuracy))


class Steps(NamedTuple):
    """Estimated steps of the slowest lane of a sweep, and of all its lanes."""

    slowest: float
    total: float


def estimated_steps(chunks: Chunks) -> Steps:
    """Return the estimated steps of a sweep.

    In the total, each lane counts as many steps as the slowest lane of its block, because the others wait for it.
    """
    lanes, block = chunks.sweep.lanes, chunks.engine.programs.block
    if lanes > STEPPED_MAX_LANES:
        numbers = np.zeros(1, int)
    elif lanes <= SAMPLES * SAMPLE:
        numbers = np.arange(lanes)
    else:
        firsts = np.linspace(0, lanes - SAMPLE, SAMPLES).astype(int)
        numbers = (firsts[:, None] + np.arange(SAMPLE)).ravel()
    # Blocks hold lanes of similar pace. After sorting, the first lane of each block is its slowest.
    slowest = np.sort(lane_steps(chunks, numbers))[::-1][::block]
    return Steps(float(slowest[0]), float(np.mean(slowest)) * block * -(-lanes // block))


@cache
def machine_factor() -> float:
    """Return the ratio of processor times of this machine and the reference machine, from a benchmark of some 10 ms.

    The benchmark compresses data, which like compilation consists mostly of branches and table lookups. The shortest of
    six runs is used, because other load on the machine can only make runs longer.
    """
    text = np.random.default_rng(0).integers(0, 40, 30_000, dtype=np.uint8).tobytes()
    seconds = []
    for _ in range(6):
        began = time.thread_time()
        bz2.compress(text)
        seconds.append(time.thread_time() - began)
    return min(seconds) / YARDSTICK


class Cost(TypedDict):
    """Estimated cost of a sweep: numbers of lanes and chunks, bytes of memory and disk, seconds.

    `file_bytes` is the part of `disk_bytes` that remains. `time_s`, the wall time on an idle machine, is the sum of
    `compile_s`, which does not depend on the lanes, and `step_s`; `processor_s` is the time of all cores together.
    `hour_workers`: number of single-core processes that together finish within an hour, or 0 if no number does.
    """

    lanes: int
    chunks: int
    memory_bytes: float
    disk_bytes: float
    file_bytes: float
    hour_workers: int
    time_s: float
    compile_s: float
    step_s: float
    processor_s: float


def check_size(sweep: Sweep, cost: Cost, out: Path | None = None) -> None:
    """Raise `InputError` if the sweep needs more memory, disk or time than is available.

    `cost`: estimated cost. `out`: output file, or None if the result stays in memory.
    """
    free = None
    if out is not None:  # chunks that are already stored for `out` need no more space
        chunks = out.with_name(f"{out.name}.chunks")
        taken = sum(path.stat().st_size for path in chunks.iterdir()) if chunks.is_dir() else 0
        free = shutil.disk_usage(out.parent).free + taken
    limits = [
        (cost["memory_bytes"], memory(), size_text, "memory"),
        (cost["disk_bytes"], free, size_text, "disk"),
        (cost["time_s"], 10 * 365.25 * 86400.0, time_text, "time"),
    ]
    short = {name: f"{text(most)} of {name}" for need, most, text, name in limits if most is not None and need > most}
    if not short:
        return
    if set(short) == {"time"} and sweep.run.settle + sweep.run.observe > 1e6:
        key, advice = "run", "settle and observe for a shorter time"
    elif sweep.run.keep_returns > 1000:
        key, advice = "run.keep_returns", "keep fewer returns, or run fewer lanes"
    else:
        key, advice = ("points", "give fewer of them") if sweep.points is not None else ("grid", "give shorter axes")
    needs = ", ".join(f"{text(need)} of {name}" for need, _, text, name in limits)
    lanes = counted(sweep.lanes, "lane needs", "lanes need")
    available = " and ".join(short.values())
    raise Place(sweep.file).at(key).error(f"{lanes} about {needs}; there is {available}: {advice}")


def memory() -> float | None:
    """Return the memory available to this process [bytes], or None if it is unknown."""
    try:
        total = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return None
    try:  # a container may have less
        return min(total, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return total
