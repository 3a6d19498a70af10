"""Rough processor time and bytes of a sweep, before any work: the time to compile its scene, and that of its steps.

The estimate is within about a factor of two of what a sweep takes. `--dry-run --measure` computes some chunks
instead. `python tests/benchmarks/estimates.py` compares the estimates of all bundled sweeps with their true times, and
prints the constants of this file as measured.
"""

import bz2
import time
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.io.packing import UP_TO
from vibrojax.models.scenes import HasContact, HasFriction, HasRock
from vibrojax.sweep.engine.batch import steps_at_most
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.underway import OBSERVING
from vibrojax.sweep.engine.validity import flight_rates
from vibrojax.sweep.input.definition import Sweep


class LaneCosts(NamedTuple):
    """Costs of a lane by what its scene models.

    - `event_rate`: steps that end at events in a simulated second [1/s], in addition to the flight's.
    - `chunk_bytes`, `file_bytes`: in a finished chunk, and in the dataset before it is packed.
    """

    event_rate: float
    chunk_bytes: int
    file_bytes: int


FRICTION_COSTS = LaneCosts(12.0, 152, 98)
CONTACT_COSTS = LaneCosts(45.0, 232, 170)
ROCK_COSTS = LaneCosts(190.0, 272, 210)
PULSE_COSTS = LaneCosts(1000.0, 88, 50)
"""Means over the bundled sweeps. Blows on rock and pulses bring a cascade of events each."""

STEP_SECONDS = 75e-9
"""A step of one lane while it settles: 53 ns in rotary to 92 ns in coupled-drilling."""

COMPILE_SECONDS = 1.2
"""Compilation of a scene's programs: 0.5 s in penetration to 1.9 s in coupled-drilling."""

START_SECONDS = 2.0
"""Import, reading, writing and drawing."""

LANE = 25e-6
"""Seconds of a lane besides its steps: to start, measure, store, label and write it."""

YARDSTICK = 1.92e-3
"""Seconds of the yardstick on the machine where the constants were measured."""

CHECK_RUN, ENDING_EARLY, ENDING_ON_ORBITS, EXPONENTS = 1.5, 0.75, 0.6, 8.0
"""Factors of a lane's steps. The check run takes every second step. Of lanes that may end early, a quarter of the work
is saved, with ends on orbits two fifths. Exponents follow the irregular lanes, about a quarter of a map, for long."""

ORBIT_BYTES, RETURN_BYTES = (136, 108), 48
"""Bytes of a lane's orbit, in a chunk and in the dataset; and of each return that is kept, in either."""

PACKED, PACKED_LARGE = 0.6, 0.75
"""Share of a dataset's bytes that packing leaves, and that of a dataset so large that only some of it is packed."""

STEPPED_MAX_LANES = 2**40
"""More lanes than anybody steps: such a sweep is refused, and its stiffness is not sampled."""

SAMPLES, SAMPLE = 8, 256
"""Places of a sweep, and lanes at each, whose steps are estimated; in a smaller sweep, all lanes are."""

LanesFloat = Float[np.ndarray, " lanes"]
LaneNumbers = Int[np.ndarray, " lanes"]


class Seconds(NamedTuple):
    """Time to start, to compile, which does not depend on the number of lanes, and to step."""

    start: float
    compile: float
    step: float


def processor_time(chunks: Chunks) -> Seconds:
    """Return a rough estimate of a sweep's processor time in seconds; nothing is compiled or stepped for it."""
    run, speed = chunks.sweep.run, slowness()
    step = STEP_SECONDS * CHECK_RUN * (1 + (OBSERVING - 1) / (1 + run.settle / run.observe))
    ends_on_orbits = chunks.ends_early and chunks.ends_on_orbits
    if chunks.ends_early:
        step *= ENDING_ON_ORBITS if ends_on_orbits else ENDING_EARLY
    if run.lyapunov:
        step *= EXPONENTS
    # Orbits and exponents bring programs of their own, about as large as those that step.
    compiling = COMPILE_SECONDS * (1 + ends_on_orbits + run.orbits + run.lyapunov)
    stepping = step * _steps(chunks) + LANE * chunks.sweep.lanes
    return Seconds(speed * START_SECONDS, speed * compiling, speed * stepping)


def lane_bytes(sweep: Sweep) -> tuple[int, int]:
    """Return the bytes of a lane in a finished chunk, and in the dataset before it is compressed."""
    costs, run = _lane_costs(sweep), sweep.run
    in_chunk, in_file = ORBIT_BYTES if run.orbits else (0, 0)
    returns = RETURN_BYTES * run.keep_returns
    return costs.chunk_bytes + returns + in_chunk, costs.file_bytes + returns + in_file


def packed_share(sweep: Sweep) -> float:
    """Return the share of the dataset's bytes that packing leaves."""
    return PACKED_LARGE if lane_bytes(sweep)[1] * sweep.lanes > UP_TO else PACKED


def by_the_clock(processor: Seconds, cores: int) -> Seconds:
    """Return the seconds by the clock on an idle machine with that many cores."""
    return processor._replace(step=processor.step / cores)


def lane_steps(chunks: Chunks, numbers: LaneNumbers) -> LanesFloat:
    """Return a rough number of steps of lanes, by the numbers of the lanes (lanes,)."""
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
    """Return the steps of all lanes, each counted as the slowest of its block, for which the others wait."""
    lanes, block = chunks.sweep.lanes, chunks.engine.programs.block
    if lanes > STEPPED_MAX_LANES:
        numbers = np.zeros(1, int)
    elif lanes <= SAMPLES * SAMPLE:
        numbers = np.arange(lanes)
    else:
        firsts = np.linspace(0, lanes - SAMPLE, SAMPLES).astype(int)
        numbers = (firsts[:, None] + np.arange(SAMPLE)).ravel()
    # Lanes of similar pace form a block: the first of each is its slowest.
    slowest = np.sort(lane_steps(chunks, numbers))[::-1][::block]
    return float(np.mean(slowest)) * block * -(-lanes // block)


@cache
def slowness() -> float:
    """Return the processor time of this machine over that of the machine of reference, by a yardstick of some 10 ms.

    Compression branches and looks up much, as compilers do. The shortest of six runs counts: other work on the machine
    only makes runs longer.
    """
    text = np.random.default_rng(0).integers(0, 40, 30_000, dtype=np.uint8).tobytes()
    seconds = []
    for _ in range(6):
        began = time.thread_time()
        bz2.compress(text)
        seconds.append(time.thread_time() - began)
    return min(seconds) / YARDSTICK
