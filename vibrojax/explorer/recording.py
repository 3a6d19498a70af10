"""Motions for the explorer page: recorded from initial states, many lanes at once, or taken from a trajectory.

A `Cell` holds the motion of one lane as the page shows it, see [vibrojax.explorer.encoding][].
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.compile.xla import precision
from vibrojax.errors import InputError, printable
from vibrojax.explorer import document
from vibrojax.explorer.document import Document
from vibrojax.explorer.encoding import EVENTS, STUCK, TOUCHING, Cell, StateColumn, pack
from vibrojax.io.attributes import parameters_of, run_of
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.record import Record, SampledMotion, events, record_batch, sample, states_shown
from vibrojax.lazy import jax
from vibrojax.scenes import HasContact, HasFriction, Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Lane, Located, lane_at

RECORDED_LANES = 128
"""Number of lanes that are recorded at once; their steps take about 20 MB."""

RECORD_BATCH_STEPS, RECORD_MAX_BATCHES = 64, 40
"""Number of steps of each lane per batch, and maximum number of batches of a record."""

RECORD_ACCURACY = Accuracy(tolerance=1e-9, stride=LOCATED_STRIDE, step=np.inf)

SHOWN_RETURNS, SECTION_RETURNS = 5, 48
"""For a lane that is not periodic: number of return intervals whose motion is shown, and number of section crossings
whose states are shown."""

SHOWN_SECONDS = 2.0
"""Displayed time of a lane that never crosses the section."""

RETURN_SAMPLES, CELL_MAX_SAMPLES = 56, 180
"""Number of evenly spaced samples per return interval, and maximum for a motion, of up to four states; more states have
more. Samples at events are added."""

PULSE_TOLERANCE, PULSE_MAX_CYCLES = 1e-3, 8
"""Largest difference of states one period apart, relative to half their peak-to-peak ranges, and longest period in
pulses."""

STEP_PLACES = 6
"""Number of points in each step at which the path of the states is measured."""

EVENT_PRIORITY = ("section", "switch", "release", "slip", "slide", "stick", "impact")
"""Order of simultaneous events; the page shows the last in this list."""

TIME_TOLERANCE = 1e-6
"""Times count as equal if they differ by less than this fraction of the motion's duration."""


HISTORY_BINS = 1200
"""Number of time intervals, of each of which the least and greatest value are shown: one per pixel of a wide plot."""

SECTION_STATES = ("x1", "x2", "v2", "x3", "v3")
"""States whose values at section crossings are shown, if the scene has them."""

LAST_PULSES = 32
"""Number of pulses at the end of a motion whose states are compared to find its period."""


class Excerpt(NamedTuple):
    """The part of each lane's motion to record and to show.

    - `state` (states, lanes): initial state, at a section crossing, with all states of the scene.
    - `repeats` (lanes,): True if exactly one period of the motion is shown.
    - `skipped`, `shown`, `recorded` [s] (lanes,): time left out at first, time shown after it, and time to simulate.
    - `returns` (lanes,): number of return intervals shown.
    """

    state: Float[np.ndarray, "states lanes"]
    repeats: np.ndarray
    skipped: Float[np.ndarray, " lanes"]
    shown: Float[np.ndarray, " lanes"]
    recorded: Float[np.ndarray, " lanes"]
    returns: Int[np.ndarray, " lanes"]

    def lanes(self, which: Any) -> "Excerpt":
        return Excerpt(*(values[..., which] for values in self))


@lane_function(static=1)
def _first_step(scene: Scene[Any], p: dict[str, Any], state: Values) -> tuple[Any, Lane]:
    """Return the scene's constants, adapted to the initial `state`, and the lanes in this state at t = 0.

    `p`: parameters of the scene, by name.
    """
    constants = scene.scaled(scene.constants(p), state)
    return constants, lane_at(scene, constants, state)


def record_cells(scene: Scene[Any], parameters: dict[str, np.ndarray], excerpt: Excerpt) -> Iterator[Cell]:
    """Simulate the excerpts of lanes, and yield the motion of each lane in order."""
    for first in range(0, excerpt.state.shape[1], RECORDED_LANES):
        subset = slice(first, first + RECORDED_LANES)
        used = {name: parameters[name][subset] for name in scene.parameters()}
        yield from _batch_cells(scene, used, excerpt.lanes(subset))


def _batch_cells(scene: Scene[Any], parameters: dict[str, np.ndarray], excerpt: Excerpt) -> list[Cell]:
    stepper = Located()
    with precision("float64"):
        constants, lane = _first_step(scene, parameters, tuple(excerpt.state))
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
        leaves, structure = jax.tree.flatten(constants)
        cells = []
        for index in range(excerpt.state.shape[1]):
            own = jax.tree.unflatten(structure, [np.broadcast_to(x, excerpt.recorded.shape)[index] for x in leaves])
            record = Record(**{name: x[..., index] for name, x in steps.items()})
            cells.append(cell_of_record(scene, record, event_times(scene, own, record), excerpt.lanes(index)))
    return cells


def event_times(scene: Scene[Any], c: Any, record: Record) -> dict[str, np.ndarray]:
    """Return the times [s] of one lane's events by kind; under pulses, a pulse begins in place of a section crossing.

    `c`: constants of the scene, for this lane.
    """
    times, kinds = events(scene, c, record)
    moments = {name: times[kinds == flag] for flag, name in enumerate(EVENTS) if flag}
    pulse_begins = getattr(scene, "pulse_begins", None)
    if scene.section is None and pulse_begins is not None and "pulse" in scene.event_names:
        hits = dict(zip(scene.event_names, record.hits.T, strict=True))
        begins = np.asarray(pulse_begins(c, tuple(record.mode.T), hits))
        moments["section"] = (record.start + record.dt)[begins]
    return moments


def cell_of_record(scene: Scene[Any], record: Record, moments: Mapping[str, np.ndarray], excerpt: Excerpt) -> Cell:
    """Return the motion of one lane, given its record and the times [s] of its events by kind."""
    taken = (record.dt > 0) | record.hits.any(axis=1)
    record = Record(*(x[taken] for x in record))
    ends, after = np.asarray(record.start + record.dt), np.asarray(record.after)
    reached = float(ends[-1]) if len(ends) else 0.0
    first, duration = float(excerpt.skipped), float(excerpt.shown)
    if not excerpt.returns:  # without a section crossing, show as much as was recorded
        duration = min(duration, reached)
    if not duration > 0 or reached < first + 0.999 * duration or not np.isfinite(after).all():
        return Cell(-1, "none", "its motion could not be recorded: it took too many steps")
    tolerance = duration * TIME_TOLERANCE
    fractions = np.arange(STEP_PLACES) / STEP_PLACES
    places = (record.start[:, None] + record.dt[:, None] * fractions).ravel()
    places = np.unique(
        np.concatenate([places[(places > first) & (places < first + duration)], [first, first + duration]])
    )
    path = np.asarray(sample(record, places)[0])
    times = sample_times(places, path, ends[np.asarray(record.hits).any(axis=1)], int(excerpt.returns))
    states, modes, step_of = sample(record, times)
    shown = states_shown(scene, SampledMotion(times, states, modes), record, step_of)
    flags = np.zeros(len(times), np.uint8)
    if isinstance(scene, HasFriction):
        flags |= np.where(modes[scene.mode_place("slip")] == 0, STUCK, 0).astype(np.uint8)
    if isinstance(scene, HasContact):
        flags |= np.where(modes[scene.mode_place("touching")] != 0, TOUCHING, 0).astype(np.uint8)
    mark_events(flags, times, moments, tolerance)
    last = first + duration + tolerance if excerpt.repeats else np.inf
    returns = moments["section"]
    passed = np.searchsorted(ends, returns[(returns > first + tolerance) & (returns < last)][:SECTION_RETURNS])
    names = [name for name in scene.driving_part().return_states if name in scene.state_names]
    return Cell(
        lane=-1,
        kind="orbit" if excerpt.repeats else "motion",
        note="" if excerpt.returns else "it passes no section",
        returns=int(excerpt.returns),
        duration=duration,
        columns=tuple(
            StateColumn(name, state.attrs["units"], state.attrs["long_name"]) for name, state in shown.items()
        ),
        time=times - first,
        states={name: np.asarray(state.values) for name, state in shown.items()},
        flags=flags,
        section={name: after[passed, scene.place(name)] for name in names} if len(passed) else {},
    )


def sample_times(times: np.ndarray, states: np.ndarray, events: np.ndarray, returns: int) -> np.ndarray:
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
    count = round(min(RETURN_SAMPLES * max(returns, 1), CELL_MAX_SAMPLES) * max(1.0, len(states) / 4))
    even = np.interp(np.linspace(0.0, path[-1], count + 1), path, times)
    samples = np.unique(np.concatenate([even, events[(events > times[0]) & (events < times[-1])]]))
    is_new = np.diff(samples) > TIME_TOLERANCE * (times[-1] - times[0])
    return samples[np.concatenate([[True], is_new])]


def repeated_pulses(passed: Float[np.ndarray, "pulses states"], swing: Float[np.ndarray, " states"]) -> int:
    """Return the number of pulses per period of a motion, or 0 if the motion is not periodic.

    `passed`: states at the beginnings of pulses; `swing`: half the peak-to-peak range of each state.
    """
    for cycles in range(1, PULSE_MAX_CYCLES + 1):
        away = np.abs(passed[cycles:] - passed[:-cycles]) / np.maximum(swing, np.finfo(float).tiny)
        if len(passed) > 3 * cycles and (away < PULSE_TOLERANCE).all():
            return cycles
    return 0


def mark_events(flags: np.ndarray, times: np.ndarray, events: Mapping[str, np.ndarray], tolerance: float) -> None:
    """Store the number of each event in the flag of the sample at the time of the event."""
    for name in EVENT_PRIORITY:
        moments = events.get(name, np.zeros(0))
        indices = np.searchsorted(times, moments - tolerance)
        indices = indices[(indices < len(times)) & (moments >= times[0] - tolerance)]
        flags[indices] = flags[indices] & (STUCK | TOUCHING) | EVENTS.index(name)


# Of a trajectory.


def motion_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of a trajectory, given the dataset of `simulate`."""
    if not ds.sizes["time"]:
        raise InputError("explore: the motion has no samples")
    if any(np.isinf(data.values).any() for data in ds.data_vars.values() if data.dtype.kind == "f"):
        raise InputError("explore: the motion has values that are not finite")
    names = [str(name) for name, data in ds.data_vars.items() if data.ndim == 0 and data.dtype.kind in "fiu"]
    return document.document_with(
        ds,
        "motion",
        [document.variable_document(ds[name]) | {"map": None} for name in names],
        lanes=pack(np.zeros(1, np.int32)) | {"axes": []},
        run=document.run_document(ds) | {"duration": document.command_seconds(float(ds["time"][-1]))},
        history=_history(ds),
    )


def _history(ds: xr.Dataset) -> Document:
    """Return all variables along time, reduced to the two extremes in each time interval, in order of time."""
    time = ds["time"].values
    bins = np.array_split(np.arange(len(time)), min(HISTORY_BINS, len(time)))
    columns: list[Document] = []
    for name, data in ds.data_vars.items():
        if data.dims != ("time",) or data.dtype.kind != "f":
            continue
        values = data.values
        extremes = [sorted((part[np.argmin(values[part])], part[np.argmax(values[part])])) for part in bins]
        columns.append(
            {
                "name": str(name),
                "units": document.one_line(data.attrs.get("units", "")),
                "long_name": document.one_line(data.attrs.get("long_name", "")) or str(name),
                "data": pack(values[np.ravel(extremes)].astype(float)),
            }
        )
    ends = np.ravel([[time[part[0]], time[part[-1]]] for part in bins])
    return {"time": pack(ends), "columns": columns, "observed_from": run_of(ds).get("settle")}


def cell_of(motion: xr.Dataset, lane: int = -1) -> Cell:
    """Return the part of a trajectory that the explorer page shows: its last period or its last section crossings.

    **Arguments:** `motion`: the dataset of `simulate`. Without events, as with a solver of diffrax, the last seconds
    are shown. `lane`: number of the lane, -1 for a motion simulated live.

    **Returns:** a `Cell`. Its `numbers` are the features of the motion, with the names of a sweep's variables.
    """
    time = motion["time"].values
    moments, kinds = (motion[n].values if n in motion else np.zeros(0) for n in ("event_time", "event_kind"))
    events = {name: moments[kinds == flag] for flag, name in enumerate(EVENTS) if flag}
    returns, cycles = events["section"], int(motion["cycles"]) if "cycles" in motion else 0
    if not len(returns) and "applied_force" in motion:
        # Pulses begin in place of section crossings. With fewer samples than pulses, a period cannot be detected.
        pulses = float(time[-1]) * (frequency := parameters_of(motion).get("frequency", 0.0))
        returns = np.arange(int(pulses + 1e-9) + 1) / frequency if 0 < pulses < len(time) else np.zeros(0)
        states = [motion["v3"].values, motion["x3"].values - motion["x4"].values]
        passed = np.stack([np.interp(returns, time, x) for x in states], axis=1)
        cycles = repeated_pulses(passed[-LAST_PULSES:], np.ptp(states, axis=1) / 2)
    kind = "orbit" if cycles and len(returns) > cycles else "motion"
    shown = cycles if kind == "orbit" else min(SHOWN_RETURNS, max(len(returns) - 1, 0))
    if shown:
        begin, end = float(returns[-1 - shown]), float(returns[-1])
    else:
        begin, end = max(float(time[0]), float(time[-1]) - SHOWN_SECONDS), float(time[-1])
    data = {
        str(name): state
        for name, state in motion.data_vars.items()
        if state.dims == ("time",) and state.dtype.kind == "f" and not str(name).endswith("_force")
    }
    inside = np.concatenate([[begin], time[(time > begin) & (time < end)], [end]])
    path = np.stack([np.interp(inside, time, x.values) for x in data.values()])
    times = sample_times(inside, path, np.concatenate(list(events.values())), shown)
    tolerance = TIME_TOLERANCE * (end - begin)
    units = {name: [printable(x.attrs.get(key, ""), 200) for key in ("units", "long_name")] for name, x in data.items()}
    passed = returns[1:] if kind == "motion" else returns[len(returns) - cycles :]
    section = [name for name in SECTION_STATES if name in data] if len(passed) else []
    numbers = {str(name): x.values.item() for name, x in motion.data_vars.items() if x.ndim == 0}
    return Cell(
        lane=lane,
        kind=kind,
        note="" if shown else "it passes no section",
        returns=shown,
        duration=end - begin,
        columns=tuple(StateColumn(name, *texts) for name, texts in units.items()),
        time=times - begin,
        states={name: np.interp(times, time, x.values) for name, x in data.items()},
        flags=_flags(motion, times, events, tolerance),
        section={name: np.interp(passed[-SECTION_RETURNS:], time, data[name].values) for name in section},
        numbers={name: x if isinstance(x, int) or np.isfinite(x) else None for name, x in numbers.items()},
    )


def _flags(motion: xr.Dataset, times: np.ndarray, events: dict[str, Any], tolerance: float) -> np.ndarray:
    """Return the flags of samples: bit sticks, striker touches the bit, and the event at the sample."""
    flags = np.zeros(len(times), np.uint8)
    if "stuck" in motion:
        samples = np.searchsorted(motion["time"].values, times + tolerance, side="right") - 1
        stuck = motion["stuck"].values[np.clip(samples, 0, motion.sizes["time"] - 1)]
        flags |= np.where(stuck == 1, STUCK, 0).astype(np.uint8)
    if len(events["impact"]) or len(events["release"]):
        begun = np.searchsorted(events["impact"], times + tolerance)
        ended = np.searchsorted(events["release"], times + tolerance)
        flags |= np.where(begun > ended, TOUCHING, 0).astype(np.uint8)
    mark_events(flags, times, events, tolerance)
    return flags
