"""Motions for the explorer page: recorded from initial states, many lanes at once, or taken from a trajectory.

A `Cell` holds the motion of one lane as the page shows it, see [vibrojax.explorer.encoding][].
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.compile.trees import map_leaves
from vibrojax.compile.xla import precision
from vibrojax.errors import printable
from vibrojax.explorer.encoding import EVENTS, STUCK, TOUCHING, Cell, StateColumn
from vibrojax.io.attributes import parameters_of
from vibrojax.io.runs import with_events
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.record import Record, SampledMotion, events, moving, record_batch, sample, states_shown
from vibrojax.pictures.motion import unsettled_text
from vibrojax.scenes import HasContact, HasFriction, Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Lane, Located, lane_at

RECORDED_LANES = 128  # number of lanes that are recorded at once; their steps take about 20 MB
RECORD_BATCH_STEPS, RECORD_MAX_BATCHES = 64, 40  # steps of each lane per batch, and most batches of a record
RECORD_ACCURACY = Accuracy(tolerance=1e-9, stride=LOCATED_STRIDE, step=np.inf)
SHOWN_RETURNS, SECTION_RETURNS = 5, 48  # return intervals and section crossings shown of a lane that is not periodic
SHOWN_SECONDS = 2.0  # displayed time of a lane that never crosses the section
RETURN_SAMPLES, CELL_MAX_SAMPLES = 56, 180  # samples per return interval, and most of a motion of up to four states
TRAJECTORY_FINENESS = 6  # samples of a trajectory, the only motion of its page, in units of those of a lane
LEAST_JUMP = 2e-3  # least difference of the values beside a jump, in units of the state's range: a pixel of a plot
PULSE_TOLERANCE = 1e-3  # greatest difference of states one period apart, relative to half their peak-to-peak ranges
PULSE_MAX_CYCLES, LAST_PULSES = 8, 32  # longest period in pulses, and pulses at the end of a motion that are compared
STEP_PLACES = 6  # number of points in each step at which the path of the states is measured
EVENT_PRIORITY = ("section", "switch", "release", "slip", "slide", "stick", "impact")  # of simultaneous ones the last
TIME_TOLERANCE = 1e-6  # times count as equal if they differ by less than this fraction of the motion's duration
SECTION_STATES = ("x1", "x2", "v2", "x3", "v3")  # shown at section crossings, if the scene has them

Samples = Float[np.ndarray, " samples"]
Moments = Mapping[str, np.ndarray]  # times [s] of the events of a motion, by kind


class Excerpt(NamedTuple):
    """The part of a motion that a cell shows; of many lanes, the values are arrays.

    - `repeats`: True if exactly one period of the motion is shown.
    - `begin`, `shown` [s]: begin and length of the part. Section crossings are listed after `crossings_from` [s].
    - `recorded` [s]: time to simulate.
    - `returns`: number of return intervals shown.
    """

    repeats: Any
    begin: Any
    shown: Any
    crossings_from: Any
    recorded: Any
    returns: Any

    def of(self, lanes: Any) -> "Excerpt":
        return Excerpt(*(values[lanes] for values in self))


def last_excerpt(returns: np.ndarray, cycles: int, earliest: float, end: float) -> Excerpt:
    """Return the last part of a motion: its last period, or some return intervals if it is not periodic.

    **Arguments:** `returns` [s]: times of the section crossings; `cycles`: number of return intervals per period, or 0;
    `earliest`, `end` [s]: where a part without a section crossing may begin, and where it ends.
    """
    repeats = 0 < cycles < len(returns)
    count = cycles if repeats else min(SHOWN_RETURNS, len(returns) - 1)
    if count < 1:
        begin = max(earliest, end - SHOWN_SECONDS)
        return Excerpt(False, begin, end - begin, end, end, 0)
    begin, last = float(returns[-1 - count]), float(returns[-1])
    listed = begin if repeats else float(returns[max(len(returns) - 1 - SECTION_RETURNS, 0)])
    return Excerpt(repeats, begin, last - begin, listed, end, count)


def repeated_pulses(passed: Float[np.ndarray, "pulses states"], swing: Float[np.ndarray, " states"]) -> int:
    """Return the number of pulses per period of a motion, or 0 if the motion is not periodic.

    `passed`: states at the beginnings of pulses; `swing`: half the peak-to-peak range of each state.
    """
    for cycles in range(1, PULSE_MAX_CYCLES + 1):
        away = np.abs(passed[cycles:] - passed[:-cycles]) / np.maximum(swing, np.finfo(float).tiny)
        if len(passed) > 3 * cycles and (away < PULSE_TOLERANCE).all():
            return cycles
    return 0


def finite(numbers: Mapping[str, Any]) -> dict[str, int | float | None]:
    """Return the values of variables for JSON: None where one is not finite."""
    return {name: x if isinstance(x, int) or np.isfinite(x) else None for name, x in numbers.items()}


def _cell(
    excerpt: Excerpt,
    moments: Moments,
    path: tuple[Samples, Float[np.ndarray, "states samples"]],
    ends: np.ndarray,
    states_at: Callable[[Samples], tuple[dict[str, tuple[Any, str, str]], np.ndarray]],
    crossings: Callable[[np.ndarray], dict[str, np.ndarray]],
    fineness: int = 1,
) -> Cell:
    """Return a part of a motion.

    **Arguments:** `path`: times and states that show how the states move; `ends`: times of all events, which get a
    sample, or one on each side of a jump. `states_at`: function of times that returns the states' values, units and
    meanings by name, and flags without events; `crossings`: function of the times of section crossings that returns the
    states there; `fineness`: ratio of the number of samples to that of a lane.
    """
    tolerance = TIME_TOLERANCE * float(excerpt.shown)
    times = _sample_times(*path, ends, int(excerpt.returns), fineness)
    inside = np.unique(ends[(ends > times[0] + tolerance) & (ends < times[-1] - tolerance)])
    sampled, flags = states_at(np.concatenate([times, inside - tolerance, inside + tolerance]))
    table = np.stack([values for values, *_ in sampled.values()])
    states, before, after = np.split(table, [len(times), len(times) + len(inside)], axis=1)
    flags, swing = flags[: len(times)], np.ptp(states, axis=1)
    jumps = inside[(np.abs(after - before) > LEAST_JUMP * swing[:, None]).any(axis=0)]
    if jumps.size:
        nearest = jumps[np.searchsorted((jumps[1:] + jumps[:-1]) / 2, times)]
        times = np.sort(np.concatenate([times[np.abs(times - nearest) > tolerance], jumps, jumps]))
        sides = np.zeros(len(times))
        for index, side in enumerate((-tolerance, tolerance)):
            sides[np.searchsorted(times, jumps) + index] = side
        sampled, flags = states_at(times + sides)
        states = np.stack([values for values, *_ in sampled.values()])
    for name in EVENT_PRIORITY:
        events = moments.get(name, np.zeros(0))
        indices = np.searchsorted(times, events - tolerance)
        indices = indices[(indices < len(times)) & (events >= times[0] - tolerance)]
        flags[indices] = flags[indices] & (STUCK | TOUCHING) | EVENTS.index(name)
    last = excerpt.begin + excerpt.shown + tolerance if excerpt.repeats else np.inf
    returns = moments["section"]
    passed = returns[(returns > excerpt.crossings_from + tolerance) & (returns < last)][:SECTION_RETURNS]
    return Cell(
        lane=-1,
        kind="orbit" if excerpt.repeats else "motion",
        note="" if excerpt.returns else "it passes no section",
        returns=int(excerpt.returns),
        duration=float(excerpt.shown),
        columns=tuple(_column(name, unit, meaning) for name, (_, unit, meaning) in sampled.items()),
        time=times - float(excerpt.begin),
        states=dict(zip(sampled, states, strict=True)),
        flags=flags,
        section=crossings(passed) if len(passed) else {},
    )


@lru_cache
def _column(name: str, unit: str, meaning: str) -> StateColumn:
    return StateColumn(name, printable(unit, 200), printable(meaning, 200))


def _sample_times(times: np.ndarray, states: np.ndarray, events: np.ndarray, returns: int, fineness: int) -> np.ndarray:
    """Return the times of samples: evenly spaced along the path of a motion, and at events within it.

    The path length is the sum of the elapsed time and the changes of all `states` (states, times), each relative to its
    peak-to-peak range. A blow that lasts a hundredth of the time therefore gets more than a hundredth of the samples.
    `returns`: number of return intervals in the motion.
    """
    swing = np.ptp(states, axis=1)
    moving = swing > 1e-12 * np.abs(states).max(axis=1)
    changes = np.abs(np.diff(states[moving], axis=1)) / swing[moving][:, None]
    lengths = len(states) * np.diff(times) / (times[-1] - times[0]) + changes.sum(axis=0)
    path = np.concatenate([[0.0], np.cumsum(lengths)])
    # The bit's fast oscillation on the rock has a share of the path of its own.
    count = round(fineness * min(RETURN_SAMPLES * max(returns, 1), CELL_MAX_SAMPLES) * max(1.0, len(states) / 4))
    even = np.interp(np.linspace(0.0, path[-1], count + 1), path, times)
    samples = np.unique(np.concatenate([even, events[(events > times[0]) & (events < times[-1])]]))
    is_new = np.diff(samples) > TIME_TOLERANCE * (times[-1] - times[0])
    return samples[np.concatenate([[True], is_new])]


@lane_function(static=1)
def _first_step(scene: Scene[Any], p: dict[str, Any], state: Values) -> tuple[Any, Lane]:
    """Return the scene's constants, adapted to the initial `state`, and the lanes in this state at t = 0."""
    constants = scene.scaled(scene.constants(p), state)
    return constants, lane_at(scene, constants, state)


def record_cells(
    scene: Scene[Any], parameters: Mapping[str, np.ndarray], state: Float[np.ndarray, "states lanes"], excerpt: Excerpt
) -> Iterator[Cell]:
    """Simulate the excerpts of lanes from their states at a section crossing; yield the motions in order."""
    for first in range(0, state.shape[1], RECORDED_LANES):
        subset = slice(first, first + RECORDED_LANES)
        used = {name: parameters[name][subset] for name in scene.parameters()}
        yield from _batch_cells(scene, used, state[:, subset], excerpt.of(subset))


def _batch_cells(
    scene: Scene[Any], parameters: dict[str, np.ndarray], state: np.ndarray, excerpt: Excerpt
) -> list[Cell]:
    stepper = Located()
    with precision("float64"):
        constants, lane = _first_step(scene, parameters, tuple(state))
        accuracy = Accuracy(*(np.float64(x) for x in RECORD_ACCURACY))
        parts = []
        for _ in range(RECORD_MAX_BATCHES):
            lane, _, part = record_batch(
                scene, stepper, None, RECORD_BATCH_STEPS, constants, lane, (), accuracy, np.float64(0), excerpt.recorded
            )
            parts.append({name: np.asarray(x) for name, x in part.items()})
            if not (np.asarray(lane.clock.until(excerpt.recorded)) > 0).any():
                break
        steps = {name: np.concatenate([part[name] for part in parts]) for name in Record._fields}
        # The steps of one lane after another, without those of lanes that wait for the others at their end.
        taken = (steps["dt"] > 0) | steps["hits"].any(axis=1)
        of, step = np.nonzero(taken.T)
        after = np.concatenate([steps["mode"][1:], steps["mode"][-1:]])
        after, *columns = (np.moveaxis(x, -1, 0)[of, step] for x in (after, *steps.values()))
        record = Record(**dict(zip(steps, columns, strict=True)))
        own = map_leaves(lambda x: np.broadcast_to(x, excerpt.recorded.shape)[of], constants)
        ends = np.cumsum(taken.sum(axis=0)).tolist()
        lanes = [slice(*pair) for pair in zip([0, *ends], ends, strict=False)]
        return [
            cell_of_record(scene, Record(*(x[lane] for x in record)), moments, excerpt.of(index))
            for index, (lane, moments) in enumerate(
                zip(lanes, event_times(scene, own, record, after, lanes), strict=True)
            )
        ]


def event_times(
    scene: Scene[Any], c: Any, record: Record, after: np.ndarray | None = None, lanes: Sequence[slice] = (slice(None),)
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the times [s] of each lane's events by kind; under pulses, a pulse begins in place of a section crossing.

    The arguments are those of [vibrojax.lanes.record.events][].
    """
    begins: np.ndarray | None = None
    pulse_begins = getattr(scene, "pulse_begins", None)
    if scene.section is None and pulse_begins is not None and "pulse" in scene.event_names:
        hits = dict(zip(scene.event_names, record.hits.T, strict=True))
        begins = np.asarray(pulse_begins(c, tuple(record.mode.T), hits))
    for lane, (times, kinds) in zip(lanes, events(scene, c, record, after, lanes), strict=True):
        moments = {name: times[kinds == flag] for flag, name in enumerate(EVENTS) if flag}
        if begins is not None:
            moments["section"] = (record.start[lane] + record.dt[lane])[begins[lane]]
        yield moments


def cell_of_record(scene: Scene[Any], record: Record, moments: Moments, excerpt: Excerpt) -> Cell:
    """Return the motion of one lane, given its record and the times [s] of its events by kind."""
    ends, after = np.asarray(record.start + record.dt), np.asarray(record.after)
    reached = float(ends[-1]) if len(ends) else 0.0
    begin, shown = float(excerpt.begin), float(excerpt.shown)
    if not excerpt.returns:  # without a section crossing, show as much as was recorded
        shown = min(shown, reached)
        excerpt = excerpt._replace(shown=shown)
    if not shown > 0 or reached < begin + 0.999 * shown or not np.isfinite(after).all():
        return Cell(-1, "none", "its motion could not be recorded: it took too many steps")
    fractions = np.arange(STEP_PLACES) / STEP_PLACES
    places = (record.start[:, None] + record.dt[:, None] * fractions).ravel()
    places = np.unique(np.concatenate([places[(places > begin) & (places < begin + shown)], [begin, begin + shown]]))
    names = [name for name in scene.driving_part().return_states if name in scene.state_names]
    whole = moving(record)

    def states_at(times: Samples) -> tuple[dict[str, tuple[Any, str, str]], np.ndarray]:
        states, modes, step_of = sample(whole, times)
        flags = np.zeros(len(times), np.uint8)
        if isinstance(scene, HasFriction):
            flags |= np.where(modes[scene.mode_place("slip")] == 0, STUCK, 0).astype(np.uint8)
        if isinstance(scene, HasContact):
            flags |= np.where(modes[scene.mode_place("touching")] != 0, TOUCHING, 0).astype(np.uint8)
        return states_shown(scene, SampledMotion(times, states, modes), whole, step_of), flags

    def crossings(passed: np.ndarray) -> dict[str, np.ndarray]:
        return {name: after[np.searchsorted(ends, passed), scene.place(name)] for name in names}

    path = places, np.asarray(sample(whole, places)[0])
    return _cell(excerpt, moments, path, ends[np.asarray(record.hits).any(axis=1)], states_at, crossings)


def cell_of(motion: xr.Dataset, lane: int = -1) -> Cell:
    """Return the part of a trajectory that the explorer page shows: its last period or its last section crossings.

    Without events, as with a solver of diffrax, the last seconds are shown. The `numbers` of the cell are the features
    of the motion, with the names of a sweep's variables.
    """
    time, data = with_events(motion)
    times_of, kinds = (motion[n].values if n in motion else np.zeros(0) for n in ("event_time", "event_kind"))
    moments = {name: times_of[kinds == flag] for flag, name in enumerate(EVENTS) if flag}
    cycles = int(motion["cycles"]) if "cycles" in motion else 0
    if not len(moments["section"]) and "applied_force" in motion:
        # Pulses begin in place of section crossings. With fewer samples than pulses, a period cannot be detected.
        pulses = float(time[-1]) * (frequency := parameters_of(motion).get("frequency", 0.0))
        begins = np.arange(int(pulses + 1e-9) + 1) / frequency if 0 < pulses < len(time) else np.zeros(0)
        states = [motion["v3"].values, motion["x3"].values - motion["x4"].values]
        passed = np.stack([np.interp(begins, time, x) for x in states], axis=1)
        cycles, moments["section"] = repeated_pulses(passed[-LAST_PULSES:], np.ptp(states, axis=1) / 2), begins
    excerpt = last_excerpt(moments["section"], cycles, float(time[0]), float(time[-1]))
    begin, end = excerpt.begin, excerpt.begin + excerpt.shown
    data = {name: state for name, state in data.items() if not name.endswith("_force")}

    about = {name: (str(x.attrs.get("units", "")), str(x.attrs.get("long_name", ""))) for name, x in data.items()}

    def states_at(times: Samples) -> tuple[dict[str, tuple[Any, str, str]], np.ndarray]:
        """Return interpolated states; the striker touches the bit between an impact and a release."""
        flags, later = np.zeros(len(times), np.uint8), times + TIME_TOLERANCE * excerpt.shown
        if "stuck" in motion:
            stuck = motion["stuck"].values
            samples = np.searchsorted(motion["time"].values, later, side="right") - 1
            flags |= np.where(stuck[np.clip(samples, 0, len(stuck) - 1)] == 1, STUCK, 0).astype(np.uint8)
        impacts, releases = (np.searchsorted(moments[name], later) for name in ("impact", "release"))
        flags |= np.where(impacts > releases, TOUCHING, 0).astype(np.uint8)
        return {name: (np.interp(times, time, x.values), *about[name]) for name, x in data.items()}, flags

    def crossings(passed: np.ndarray) -> dict[str, np.ndarray]:
        return {name: np.interp(passed, time, data[name].values) for name in SECTION_STATES if name in data}

    inside = np.concatenate([[begin], time[(time > begin) & (time < end)], [end]])
    path = inside, np.stack([np.interp(inside, time, x.values) for x in data.values()])
    ends = np.concatenate([moments[name] for name in EVENTS[1:]])
    cell = _cell(excerpt, moments, path, ends, states_at, crossings, TRAJECTORY_FINENESS)
    numbers = finite({str(name): x.values.item() for name, x in motion.data_vars.items() if x.ndim == 0})
    unsettled = unsettled_text(float(motion.get("drift_estimate", np.nan)))
    return replace(cell, lane=lane, numbers=numbers, note="; ".join(filter(None, (cell.note, unsettled))))
