"""How much processor time a sweep will take, told before any work: so much to compile its scene, and its lanes' steps.

What a scene takes was measured on one machine; a yardstick of some milliseconds tells how much faster or slower the one
in use is. `python tests/benchmarks/estimates.py` compares all bundled sweeps with what they take, and prints the
numbers of the tables here anew.
"""

import bz2
import time
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.io.packing import UP_TO
from vibrojax.models.scenes import HasContact, HasFriction, HasRock, Scene
from vibrojax.sweep.engine.batch import steps_at_most
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.underway import OBSERVING
from vibrojax.sweep.engine.validity import flight_rates
from vibrojax.sweep.input.definition import Sweep


class Costs(NamedTuple):
    """What a scene takes on the machine of reference, in seconds of processor time.

    - `compile`: to compile its programs; `step`: a step of a lane while it settles.
    - `rate`: steps in a simulated second [1/s] that end at events, beside those that flight asks for.
    - `chunk_bytes`, `file_bytes`: of a lane, in a finished chunk and in the dataset before it is packed.
    - `packed`: what packing leaves of a dataset, and of one so large that only some of it is packed.
    """

    compile: float
    step: float
    rate: float
    chunk_bytes: int
    file_bytes: int
    packed: tuple[float, float]


COSTS = {
    "rotary": Costs(1.2, 53e-9, 12.0, 152, 98, (0.5, 0.6)),
    "vibro-impact": Costs(1.6, 75e-9, 45.0, 232, 170, (0.7, 0.95)),
    "drilling": Costs(1.9, 80e-9, 180.0, 272, 210, (0.55, 0.75)),
    "coupled-drilling": Costs(1.9, 92e-9, 200.0, 272, 210, (0.6, 0.8)),
    "penetration": Costs(0.7, 53e-9, 1000.0, 88, 50, (0.4, 0.6)),
}
OF_ORBITS, OF_A_RETURN = (136, 108), (48, 48)
"""Bytes of a lane with orbits, and of each return that is kept, beside those."""

START = 1.6
"""Seconds to start, to read and write, and to draw."""

OVERLAP = 0.6
"""Part of the time to compile that passes on several cores: the programs are compiled beside each other."""

YARDSTICK = 1.92e-3
"""Seconds that the yardstick takes on the machine of reference."""

CHECK_RUN = 1.5
"""Work with the check run, without it being 1."""

LANE = 25e-6
"""Seconds of a lane beside its steps: to begin and to measure it, to store, label and write it."""

ENDING_EARLY = 0.75
"""Part of the work that is left where settled lanes end early."""

SMOOTHED = 0.6
"""A smoothed step's time, a located one's being 1."""


class Seconds(NamedTuple):
    """Time to start, to compile, which takes no longer for more lanes, and for the lanes' steps."""

    start: float
    compile: float
    step: float


ORBITS = Seconds(start=1.0, compile=2.0, step=1.2)
"""How many times that a sweep with orbits takes."""

ENDS_ON_ORBITS = Seconds(start=1.0, compile=2.0, step=0.8)
"""How many times that one takes whose lanes end on orbits, see [vibrojax.periodic.early][]: from 0.6 to 0.95 of the
steps, the less the more lanes settle slowly."""

LYAPUNOV = Seconds(start=1.0, compile=1.5, step=8.0)
"""How many times that one with exponents takes, where a quarter of its lanes is irregular; each of these takes 8 ms."""

MOST_LANES = 2**40
"""More than anybody steps."""

SAMPLES, SAMPLE = 8, 256
"""In so many places of a sweep, if it has more lanes, so many are looked at for how stiff they are."""

Rates = Float[np.ndarray, " lanes"]
Numbers = Int[np.ndarray, " lanes"]


def processor_time(chunks: Chunks) -> Seconds:
    """What a sweep takes, in seconds of processor time, roughly; nothing is compiled or stepped for it."""
    run, costs, slower = chunks.sweep.run, _costs(chunks.sweep.system), slowness()
    share = CHECK_RUN * (ENDING_EARLY if chunks.ends_early else 1.0)
    step = costs.step * (SMOOTHED if run.stepper.smooths else 1.0)
    observing = 1 + (OBSERVING - 1) / (1 + run.settle / run.observe)
    stepping = step * share * observing * _steps(chunks, costs.rate)
    compiling = costs.compile
    if chunks.ends_early and chunks.ends_on_orbits:
        compiling, stepping = compiling * ENDS_ON_ORBITS.compile, stepping * ENDS_ON_ORBITS.step
    if run.orbits:
        compiling, stepping = compiling * ORBITS.compile, stepping * ORBITS.step
    if run.lyapunov:
        compiling, stepping = compiling * LYAPUNOV.compile, stepping * LYAPUNOV.step
    return Seconds(slower * START, slower * compiling, slower * (stepping + LANE * chunks.sweep.lanes))


def lane_bytes(sweep: Sweep) -> tuple[int, int]:
    """Bytes of a lane in a finished chunk, and in the dataset before it is compressed."""
    costs, run = _costs(sweep.system), sweep.run
    kept = [one * run.keep_returns for one in OF_A_RETURN]
    orbits = OF_ORBITS if run.orbits else (0, 0)
    return costs.chunk_bytes + kept[0] + orbits[0], costs.file_bytes + kept[1] + orbits[1]


def packed_share(sweep: Sweep) -> float:
    """What packing leaves of the dataset, a part of its bytes."""
    _, file_bytes = lane_bytes(sweep)
    return _costs(sweep.system).packed[file_bytes * sweep.lanes > UP_TO]


def by_the_clock(processor: Seconds, cores: int) -> Seconds:
    """The seconds that pass meanwhile on an idle machine with so many cores."""
    beside = OVERLAP if cores > 1 else 1.0
    return Seconds(processor.start, beside * processor.compile, processor.step / cores)


def _costs(scene: Scene[Any]) -> Costs:
    """Those of the scene, or of the package's that has as much in it."""
    if scene.name in COSTS:
        return COSTS[scene.name]
    if isinstance(scene, HasRock):
        return COSTS["drilling" if scene.autonomous else "penetration"]
    return COSTS["vibro-impact" if isinstance(scene, HasContact) else "rotary"]


def _steps(chunks: Chunks, at_events: float) -> float:
    """Steps of all lanes of the run, those counted in which lanes of a block wait for its slowest."""
    sweep, block = chunks.sweep, chunks.engine.programs.block
    if sweep.lanes > MOST_LANES:
        numbers = np.zeros(1, int)
    elif sweep.lanes <= SAMPLES * SAMPLE:
        numbers = np.arange(sweep.lanes)
    else:
        firsts = np.linspace(0, sweep.lanes - SAMPLE, SAMPLES).astype(int)
        numbers = (firsts[:, None] + np.arange(SAMPLE)).ravel()
    steps = _lane_steps(chunks, at_events, numbers)
    # Lanes of one pace go together: the first of each block is its slowest.
    slowest = np.sort(steps)[::-1][::block]
    return float(np.mean(slowest)) * block * -(-sweep.lanes // block)


def lane_steps(chunks: Chunks, numbers: Numbers) -> Rates:
    """Steps that lanes take, roughly, by their numbers (lanes,)."""
    return _lane_steps(chunks, _costs(chunks.sweep.system).rate, numbers)


def _lane_steps(chunks: Chunks, at_events: float, numbers: Numbers) -> Rates:
    run, accuracy = chunks.sweep.run, chunks.accuracy
    seconds = run.settle + run.observe
    asked = 1 / accuracy.step if run.stepper.smooths else at_events + 1 / accuracy.step
    with np.errstate(all="ignore"):
        rates = asked + _in_flight(chunks.sweep, numbers) / accuracy.stride
        return np.minimum(np.nan_to_num(rates, nan=np.inf) * seconds, steps_at_most(seconds, accuracy))


def _in_flight(sweep: Sweep, numbers: Numbers) -> Rates:
    """Fastest rates in flight [1/s] of lanes; none where steps do not follow from them."""
    scene = sweep.system
    if not isinstance(scene, HasFriction) or sweep.run.stepper.smooths or sweep.lanes > MOST_LANES:
        return np.zeros(len(numbers))
    return np.broadcast_to(flight_rates(scene, sweep.values_of(numbers)[0]), len(numbers))


@cache
def slowness() -> float:
    """Processor time of this machine for what takes the machine of reference one second, by a yardstick of some 10 ms.

    Compression branches and looks up much, as compilers do; its own time is taken, whatever else the machine does.
    """
    text = np.random.default_rng(0).integers(0, 40, 30_000, dtype=np.uint8).tobytes()
    taken = []
    for _ in range(6):
        began = time.thread_time()
        bz2.compress(text)
        taken.append(time.thread_time() - began)
    return min(taken) / YARDSTICK
