"""Cost of a sweep: limits that are checked before it runs, and the cost of the whole, extrapolated from a few lanes."""

import shutil
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vibrojax.compile.xla import threads
from vibrojax.errors import Place, counted
from vibrojax.io.files import memory, size_text, time_text
from vibrojax.io.writers import COMPRESSED
from vibrojax.lanes.engine import steps_at_most
from vibrojax.lanes.inputs import Index, PerLane
from vibrojax.lanes.labels import fastest_rates
from vibrojax.maps.dataset import REGION, stored
from vibrojax.maps.store import CHUNKS
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.lane_stages import lane_run
from vibrojax.progress import quiet
from vibrojax.scenes import HasContact, HasFriction, HasRock

FRICTION_EVENTS, CONTACT_EVENTS, ROCK_EVENTS, PULSE_EVENTS = 12.0, 45.0, 190.0, 1000.0
"""Steps that end at events per simulated second [1/s], in addition to the steps of the flight: means over the bundled
sweeps. Each impact on rock and each pulse causes a cascade of events."""

STEP_SECONDS = 1.5e-7
"""Time of one step of one lane on one core, check run included [s], to reject sweeps that would take years."""

LANE_BYTES, ORBIT_BYTES, RETURN_BYTES, PACKED = 210.0, 108.0, 48.0, 0.75
"""Size of a lane, of its orbit and of a stored section crossing [bytes], and ratio of packed to unpacked size."""

PROGRAM_BYTES, LOOP_BYTES = 450e6, 4000.0
"""Memory for imported and compiled code, and for a lane in the time loop [bytes]."""

TRIED_RUNS, TRIED_RUN = 8, 32
"""Number of runs of consecutive lanes that `tried` computes, and their length; neighbours may share orbits."""

SAMPLED_RUNS, SAMPLED_RUN = 8, 256
"""The same for lanes whose steps are estimated."""

SPREAD_MAX_LANES = 2**40
"""Number of lanes over which samples are spread; a larger sweep is certainly rejected."""

YEARS = 10 * 365.25 * 86400.0
"""Longest time of a sweep [s]."""


class Cost(NamedTuple):
    """Memory [bytes], disk space while the sweep runs and of the finished file [bytes], and time on all cores [s]."""

    memory: float
    disk: float
    file: float
    seconds: float


def spread(lanes: int, runs: int, length: int) -> Index:
    """Return the numbers of lanes in runs that are spread over a sweep, or of all its lanes if they are few."""
    if lanes <= runs * length:
        return np.arange(lanes)
    firsts = np.linspace(0, min(lanes, SPREAD_MAX_LANES) - length, runs).astype(int)
    return (firsts[:, None] + np.arange(length)).ravel()


def tried(sweep: Sweep) -> Cost:
    """Compute one chunk of at most 256 lanes, discard it, and return the cost of the whole sweep to a file."""
    row = 0 if sweep.run.carry is None else len(sweep.axes[sweep.run.carry])
    if 0 < row <= TRIED_RUNS * TRIED_RUN:
        inputs = sweep.inputs(0, min(TRIED_RUNS * TRIED_RUN // row * row, sweep.lanes))
    else:
        inputs = sweep.inputs_of(spread(sweep.lanes, TRIED_RUNS, TRIED_RUN))
    run = lane_run(inputs, sweep.plan)
    with quiet():
        began = time.monotonic()
        run.chunk(inputs.of(np.arange(1)))
        compiled = time.monotonic()
        arrays = stored(run.chunk(inputs), 0.0)
        ended = time.monotonic()
    size = sum(x.nbytes for x in arrays.values()) / len(inputs)
    seconds = compiled - began + (ended - compiled) * sweep.lanes / len(inputs)
    return _cost(sweep, True, size, seconds)


def _cost(sweep: Sweep, to_file: bool, lane_bytes: float, seconds: float) -> Cost:
    cores, chunk = threads(), sweep.plan.chunk
    memory = PROGRAM_BYTES + min(cores, sweep.chunks) * chunk * LOOP_BYTES
    # The regions of a dataset are read, joined and written; in memory, chunks and dataset exist at once.
    memory += 2 * lane_bytes * (3 * min(REGION, sweep.lanes) if to_file else sweep.lanes)
    file = lane_bytes * sweep.lanes * (PACKED if sweep.lanes > COMPRESSED else 1.0)
    return Cost(memory, file + lane_bytes * sweep.lanes, file, seconds)


def estimated_steps(sweep: Sweep) -> PerLane:
    """Return the estimated steps of lanes spread over a sweep, of all if it is small, without running any."""
    run, scene = sweep.run, sweep.system
    accuracy, seconds = run.accuracy(scene), run.settle + run.observe
    parameters, _ = sweep.values_of(spread(sweep.lanes, SAMPLED_RUNS, SAMPLED_RUN))
    rates = np.full(len(next(iter(parameters.values()))), 1 / accuracy.step)
    with np.errstate(all="ignore"):
        if not run.stepper.smooths:
            if isinstance(scene, HasRock):
                rates += ROCK_EVENTS if scene.autonomous else PULSE_EVENTS
            else:
                rates += CONTACT_EVENTS if isinstance(scene, HasContact) else FRICTION_EVENTS
            if isinstance(scene, HasFriction):
                rates += fastest_rates(scene, parameters).flight / accuracy.stride
        return np.minimum(np.nan_to_num(rates, nan=np.inf) * seconds, steps_at_most(seconds, accuracy))


def check_size(sweep: Sweep, out: Path | None = None, to_file: bool = False, cost: Cost | None = None) -> None:
    """Raise `InputError` if the sweep needs more memory, disk or time than is available.

    **Arguments:** `out`: output file, or None if the result stays in memory; `to_file`: whether finished chunks are
    kept on the disk, or in memory; `cost`: instead of an estimate, whose time is good to a factor of a few.
    """
    if cost is None:
        size = LANE_BYTES + RETURN_BYTES * sweep.run.keep_returns + ORBIT_BYTES * sweep.run.orbits
        cost = _cost(sweep, to_file, size, STEP_SECONDS * estimated_steps(sweep).mean() * sweep.lanes / threads())
    free = None
    if out is not None:  # chunks that are already stored for `out` need no more space
        chunks = out.with_name(out.name + CHUNKS)
        taken = sum(path.stat().st_size for path in chunks.iterdir()) if chunks.is_dir() else 0
        free = shutil.disk_usage(out.parent).free + taken
    limits = [
        (cost.memory, memory(), size_text, "memory"),
        (cost.disk, free, size_text, "disk"),
        (cost.seconds, YEARS, time_text, "time"),
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
