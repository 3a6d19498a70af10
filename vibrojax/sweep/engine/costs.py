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

from vibrojax.errors import Place
from vibrojax.io.dataset import UP_TO
from vibrojax.io.formatting import size_text, time_text
from vibrojax.models.scenes import HasContact, HasFriction, HasRock
from vibrojax.sweep.engine.batch import steps_at_most
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.underway import OBSERVING
from vibrojax.sweep.engine.validity import flight_rates
from vibrojax.sweep.input.definition import Sweep


class LaneCosts(NamedTuple):
    """Costs of a lane, which depend on the physics that its scene models.

    - `event_rate`: steps that end at events per simulated second [1/s], in addition to the steps of the flight.
    - `chunk_bytes`, `file_bytes`: size of a lane in a finished chunk, and in the dataset before packing.
    """

    event_rate: float
    chunk_bytes: int
    file_bytes: int


FRICTION_COSTS = LaneCosts(12.0, 152, 98)
CONTACT_COSTS = LaneCosts(45.0, 232, 170)
ROCK_COSTS = LaneCosts(190.0, 272, 210)
PULSE_COSTS = LaneCosts(1000.0, 88, 50)
"""Means over the bundled sweeps. Each impact on rock and each pulse causes a cascade of events."""

STEP_SECONDS = 75e-9
"""Time of one step of one lane while it settles [s]: between 53 ns in rotary and 92 ns in coupled-drilling."""

COMPILE_SECONDS = 1.2
"""Time to compile a scene's programs [s]: between 0.5 s in penetration and 1.9 s in coupled-drilling."""

START_SECONDS = 2.0
"""Time for imports, reading, writing and plotting [s]."""

LANE = 25e-6
"""Time per lane in addition to its steps [s]: to initialize, measure, store, label and write it."""

YARDSTICK = 1.92e-3
"""Time of the benchmark in `slowness` on the machine on which the constants were measured [s]."""

CHECK_RUN, ENDING_EARLY, ENDING_ON_ORBITS, EXPONENTS = 1.5, 0.75, 0.6, 8.0
"""Factors on the work of a lane's steps. The check run adds half as many steps. Early stopping saves a quarter of the
work, and two fifths if lanes also stop on known orbits. Lyapunov exponents require long runs of the irregular lanes,
which are about a quarter of a map."""

ORBIT_BYTES, RETURN_BYTES = (136, 108), 48
"""Size of a lane's orbit in a chunk and in the dataset, and size of each stored section crossing in both [bytes]."""

PACKED, PACKED_LARGE = 0.6, 0.75
"""Ratio of packed to unpacked size of a dataset, and the same for a dataset so large that only a part is packed."""

STEPPED_MAX_LANES = 2**40
"""Number of lanes above which a sweep is certainly rejected and its stiffness is therefore not sampled."""

SAMPLES, SAMPLE = 8, 256
"""Number of positions in a sweep, and number of lanes at each position, for which steps are estimated. In a smaller
sweep, the steps of all lanes are."""

LanesFloat = Float[np.ndarray, " lanes"]
LaneNumbers = Int[np.ndarray, " lanes"]


class Seconds(NamedTuple):
    """Times to launch, compile and step [s]. Only the time to step depends on the number of lanes."""

    start: float
    compile: float
    step: float


def processor_time(chunks: Chunks) -> Seconds:
    """Return a rough estimate of a sweep's processor time, without compiling or stepping."""
    run, speed = chunks.sweep.run, slowness()
    step = STEP_SECONDS * CHECK_RUN * (1 + (OBSERVING - 1) / (1 + run.settle / run.observe))
    ends_on_orbits = chunks.ends_early and chunks.ends_on_orbits
    if chunks.ends_early:
        step *= ENDING_ON_ORBITS if ends_on_orbits else ENDING_EARLY
    if run.lyapunov:
        step *= EXPONENTS
    # Orbits and exponents have programs of their own, about as large as those that step lanes.
    compiling = COMPILE_SECONDS * (1 + ends_on_orbits + run.orbits + run.lyapunov)
    stepping = step * _steps(chunks) + LANE * chunks.sweep.lanes
    return Seconds(speed * START_SECONDS, speed * compiling, speed * stepping)


def lane_bytes(sweep: Sweep) -> tuple[int, int]:
    """Return the size of a lane in a finished chunk, and in the dataset before packing [bytes]."""
    costs, run = _lane_costs(sweep), sweep.run
    in_chunk, in_file = ORBIT_BYTES if run.orbits else (0, 0)
    returns = RETURN_BYTES * run.keep_returns
    return costs.chunk_bytes + returns + in_chunk, costs.file_bytes + returns + in_file


def packed_share(sweep: Sweep) -> float:
    """Return the ratio of packed to unpacked size of the dataset."""
    return PACKED_LARGE if lane_bytes(sweep)[1] * sweep.lanes > UP_TO else PACKED


def by_the_clock(processor: Seconds, cores: int) -> Seconds:
    """Return the wall time on an idle machine with `cores` cores."""
    return processor._replace(step=processor.step / cores)


def lane_steps(chunks: Chunks, numbers: LaneNumbers) -> LanesFloat:
    """Return the estimated number of steps of each lane in `numbers` (lanes,)."""
    sweep, run, accuracy = chunks.sweep, chunks.sweep.run, chunks.accuracy
    scene, seconds = sweep.system, run.settle + run.observe
    rates = np.full(len(numbers), 1 / accuracy.step)
    with np.errstate(all="ignore"):
        if not run.stepper.smooths:
            rates += _lane_costs(sweep).event_rate
            if isinstance(scene, HasFriction) and sweep.lanes <= STEPPED_MAX_LANES:
                rates += flight_rates(scene, sweep.values_of(numbers)[0]) / accuracy.stride
        return np.minimum(np.nan_to_num(rates, nan=np.inf) * seconds, steps_at_most(seconds, accuracy))


def _lane_costs(sweep: Sweep) -> LaneCosts:
    scene = sweep.system
    if isinstance(scene, HasRock):
        return ROCK_COSTS if scene.autonomous else PULSE_COSTS
    return CONTACT_COSTS if isinstance(scene, HasContact) else FRICTION_COSTS


def _steps(chunks: Chunks) -> float:
    """Return the estimated steps of all lanes.

    Each lane counts as many steps as the slowest lane of its block, because the others wait for it.
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
    return float(np.mean(slowest)) * block * -(-lanes // block)


@cache
def slowness() -> float:
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


SWEEP_MAX_SECONDS = 10 * 365.25 * 86400.0
"""Longest accepted time of a sweep [s]: ten years."""


class Cost(TypedDict):
    """Estimated cost of a sweep: numbers of lanes and chunks, bytes of memory and disk, seconds.

    - `file_bytes`: the part of `disk_bytes` that remains after the sweep.
    - `time_s`: wall time on an idle machine, the sum of `compile_s` and `step_s`. `compile_s` does not depend on the
      number of lanes.
    - `processor_s`: processor time of all cores together.
    - `hour_workers`: number of single-core processes that together finish within an hour, or 0 if no number does.
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
    limits = [
        (cost["memory_bytes"], memory(), size_text, "memory"),
        (cost["disk_bytes"], None if out is None else _free(out), size_text, "disk"),
        (cost["time_s"], SWEEP_MAX_SECONDS, time_text, "time"),
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
    lanes = "1 lane needs" if sweep.lanes == 1 else f"{sweep.lanes} lanes need"
    available = " and ".join(short.values())
    raise Place(sweep.file).at(key).error(f"{lanes} about {needs}; there is {available}: {advice}")


def _free(out: Path) -> int:
    """Return the free space on the disk of `out`, including the space of chunks already stored for it [bytes]."""
    chunks = out.with_name(f"{out.name}.chunks")
    taken = sum(path.stat().st_size for path in chunks.iterdir()) if chunks.is_dir() else 0
    return shutil.disk_usage(out.parent).free + taken


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
