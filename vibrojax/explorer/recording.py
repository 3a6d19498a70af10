"""Recording of motions from initial states, many lanes at once, and their preparation for the explorer page.

A `Cell` holds the motion of one lane as the page shows it, see [vibrojax.explorer.encoding][].
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from vibrojax.compile.xla import precision
from vibrojax.explorer.encoding import EVENTS, STUCK, TOUCHING, Cell, StateColumn
from vibrojax.lanes.compiler import lane_function
from vibrojax.lanes.record import Record, SampledMotion, events, record_batch, sample, states_shown
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
