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
from vibrojax.models.scenes import HasContact, HasFriction, Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Lane, Located, lane_at
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.simulation.dense_output import Record, record_batch, sample
from vibrojax.sweep.simulation.trajectory import SampledMotion, impact_begins, lowest_velocity, states_shown

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
"""Number of evenly spaced samples per return interval, and maximum for a motion; samples at events are added."""

STEP_PLACES = 6
"""Number of points in each step at which the path of the states is measured."""

EVENT_PRIORITY = ("section", "release", "slip", "stick", "impact")
"""Order of simultaneous events; the page shows the last in this list."""

TIME_TOLERANCE = 1e-6
"""Times count as equal if they differ by less than this fraction of the motion's duration."""

Steps = dict[str, np.ndarray]
"""The fields of a `Record` by name. For several lanes, the last axis is the lane axis."""


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
        """Return the excerpt of one lane, or of several."""
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


def _batch_cells(scene: Scene[Any], parameters: dict[str, np.ndarray], excerpt: Excerpt) -> Iterator[Cell]:
    stepper = Located()
    with precision("float64"):
        constants, lane = _first_step(scene, parameters, tuple(excerpt.state))
        accuracy = Accuracy(*(np.float64(x) for x in RECORD_ACCURACY))
        parts = []
        for _ in range(RECORD_MAX_BATCHES):
            lane, part = record_batch(scene, stepper, RECORD_BATCH_STEPS, constants, lane, accuracy, excerpt.recorded)
            parts.append({name: np.asarray(x) for name, x in part.items()})
            if not (np.asarray(lane.clock.until(excerpt.recorded)) > 0).any():
                break
        steps = {name: np.concatenate([part[name] for part in parts]) for name in Record._fields}
        events = step_events(scene, constants, steps)
    for index in range(excerpt.state.shape[1]):
        own_steps = {name: x[..., index] for name, x in steps.items()}
        own_events = {name: mask[:, index] for name, mask in events.items()}
        yield cell_of_steps(scene, own_steps, own_events, excerpt.lanes(index))


def step_events(scene: Scene[Any], c: Any, steps: Steps) -> dict[str, np.ndarray]:
    """Return, for each name in `EVENTS`, a mask (steps, lanes) of the steps that end with this event."""
    hits = {name: steps["hits"][:, index] for index, name in enumerate(scene.event_names)}
    masks: dict[str, np.ndarray] = {}
    if isinstance(scene, HasFriction):
        slip = steps["mode"][:, scene.mode_place("slip")]
        after = np.concatenate([slip[1:], slip[-1:]])
        masks["stick"] = hits["friction"] & (slip != 0) & (after == 0)
        masks["slip"] = hits["friction"] & (after != 0)
    if isinstance(scene, HasContact):
        shape = steps["dt"].shape
        flat = jax.tree.map(lambda x: np.broadcast_to(np.asarray(x), shape).ravel(), c)
        modes, states = (tuple(np.moveaxis(x, 1, 0).reshape(x.shape[1], -1)) for x in (steps["mode"], steps["after"]))
        flags = {name: mask.ravel() for name, mask in hits.items()}
        masks["impact"] = np.asarray(impact_begins(scene, flat, modes, states, flags)).reshape(shape)
        masks["release"] = hits["contact"] & (steps["mode"][:, scene.mode_place("touching")] != 0)
    masks["section"] = _section_returns(scene, c, steps, hits)
    return masks


def _section_returns(scene: Scene[Any], c: Any, steps: Steps, hits: dict[str, np.ndarray]) -> np.ndarray:
    """Return a mask of the steps that end in a section crossing or, under pulses, at the beginning of a pulse.

    A crossing counts only if the velocity has passed the re-arming level since the previous crossing.
    """
    shape = steps["dt"].shape
    section = scene.section
    if section is None:
        pulse_begins = getattr(scene, "pulse_begins", None)
        if pulse_begins is None or "pulse" not in hits:
            return np.zeros(shape, bool)
        return np.asarray(pulse_begins(c, tuple(np.moveaxis(steps["mode"], 1, 0)), hits))
    sign, marker = 1.0 if section.rising else -1.0, scene.marker_of(section.velocity)
    falling = steps["falling"][:, scene.marker_names.index(marker)]
    crossings = hits[marker] & (~falling if section.rising else falling)
    tau = np.where(steps["dt"] > 0, steps["dt"] / np.where(steps["h"] > 0, steps["h"], 1), 0)
    velocity = np.moveaxis(steps["polynomials"][:, scene.place(section.velocity)], 1, 0)
    lowest = np.asarray(lowest_velocity([sign * order.ravel() for order in velocity], tau.ravel())).reshape(shape)
    is_low = lowest < sign * np.asarray(section.rearm(c))
    armed, returns = np.zeros(shape[1], bool), np.zeros(shape, bool)
    for step in range(shape[0]):
        armed |= is_low[step]
        returns[step] = crossings[step] & armed
        armed &= ~returns[step]
    return returns


def cell_of_steps(scene: Scene[Any], steps: Steps, events: dict[str, np.ndarray], excerpt: Excerpt) -> Cell:
    """Return the motion of one lane, given its steps and a mask of the steps that end with each event."""
    taken = (steps["dt"] > 0) | steps["hits"].any(axis=1)
    steps = {name: x[taken] for name, x in steps.items()}
    record, ends = Record(**steps), steps["start"] + steps["dt"]
    reached = float(ends[-1]) if len(ends) else 0.0
    first, duration = float(excerpt.skipped), float(excerpt.shown)
    if not excerpt.returns:  # without a section crossing, show as much as was recorded
        duration = min(duration, reached)
    if not duration > 0 or reached < first + 0.999 * duration or not np.isfinite(steps["after"]).all():
        return Cell(-1, "none", "its motion could not be recorded: it took too many steps")
    tolerance = duration * TIME_TOLERANCE
    fractions = np.arange(STEP_PLACES) / STEP_PLACES
    places = (np.asarray(record.start)[:, None] + np.asarray(record.dt)[:, None] * fractions).ravel()
    places = np.unique(
        np.concatenate([places[(places > first) & (places < first + duration)], [first, first + duration]])
    )
    even = evenly_spaced(places, np.asarray(sample(record, places)[0]), int(excerpt.returns))
    events_inside = ends[steps["hits"].any(axis=1) & (ends > first) & (ends < first + duration)]
    times = merged_times(even, events_inside, tolerance)
    states, modes, step_of = sample(record, times)
    shown = states_shown(scene, SampledMotion(times, states, modes), record, step_of)
    flags = np.zeros(len(times), np.uint8)
    if isinstance(scene, HasFriction):
        flags |= np.where(modes[scene.mode_place("slip")] == 0, STUCK, 0).astype(np.uint8)
    if isinstance(scene, HasContact):
        flags |= np.where(modes[scene.mode_place("touching")] != 0, TOUCHING, 0).astype(np.uint8)
    mark_events(flags, times, {name: ends[mask[taken]] for name, mask in events.items()}, tolerance)
    last = first + duration + tolerance if excerpt.repeats else np.inf
    passed = np.flatnonzero(events["section"][taken] & (ends > first + tolerance) & (ends < last))[:SECTION_RETURNS]
    names = [name for name in scene.driving_part().return_states if name in scene.state_names]
    return Cell(
        lane=-1,
        kind="orbit" if excerpt.repeats else "motion",
        note="" if excerpt.returns else "it passes no section",
        returns=int(excerpt.returns),
        duration=duration,
        columns=tuple(StateColumn(name, state.unit, state.long_name) for name, state in shown.items()),
        time=times - first,
        states={name: np.asarray(state.values) for name, state in shown.items()},
        flags=flags,
        section={name: steps["after"][passed, scene.place(name)] for name in names} if len(passed) else {},
    )


def evenly_spaced(times: np.ndarray, states: np.ndarray, returns: int) -> np.ndarray:
    """Return the times of samples that are evenly spaced along the path of a motion.

    The path length is the sum of the elapsed time and the changes of all `states` (states, times), each relative to its
    peak-to-peak range. A blow that lasts a hundredth of the time therefore gets more than a hundredth of the samples.
    `returns`: number of return intervals in the motion.
    """
    swing = np.ptp(states, axis=1)
    moving = swing > 1e-12 * np.abs(states).max(axis=1)
    changes = np.abs(np.diff(states[moving], axis=1)) / swing[moving][:, None]
    lengths = len(states) * np.diff(times) / (times[-1] - times[0]) + changes.sum(axis=0)
    path = np.concatenate([[0.0], np.cumsum(lengths)])
    count = min(RETURN_SAMPLES * max(returns, 1), CELL_MAX_SAMPLES)
    return np.interp(np.linspace(0.0, path[-1], count + 1), path, times)


def merged_times(samples: np.ndarray, events: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the sorted times of samples and events, without those closer to the previous time than the tolerance."""
    times = np.unique(np.concatenate([samples, events]))
    return times[np.concatenate([[True], np.diff(times) > tolerance])]


def mark_events(flags: np.ndarray, times: np.ndarray, events: Mapping[str, np.ndarray], tolerance: float) -> None:
    """Store the number of each event in the flag of the sample at the time of the event."""
    for name in EVENT_PRIORITY:
        moments = events.get(name, np.zeros(0))
        indices = np.searchsorted(times, moments - tolerance)
        indices = indices[(indices < len(times)) & (moments >= times[0] - tolerance)]
        flags[indices] = flags[indices] & (STUCK | TOUCHING) | EVENTS.index(name)
