"""One lane step by step: the polynomial of every step is stored, so that states and forces are known at any time."""

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.compile.trees import map_leaves
from vibrojax.errors import InputError, Place
from vibrojax.io.files import memory, size_text
from vibrojax.io.variables import Variable
from vibrojax.lanes.compiler import lane_function
from vibrojax.lazy import jax, jnp
from vibrojax.measures.recorder import Features, Records
from vibrojax.measures.section import lowest
from vibrojax.physics.arrays import Array
from vibrojax.scenes import Driven, HasContact, HasFriction, HasImpacts, HasRock, Scene
from vibrojax.scenes.declared import Values
from vibrojax.stepping import Accuracy, Goal, Lane, Stepper, lane_at

BATCH = 512
"""Number of steps per call of the compiled program, large enough for a small overhead of the call."""

RECORD_MAX_STEPS = 20_000 * BATCH
"""Maximum number of steps of a motion. Ten million steps take some gigabytes; a longer motion is probably a mistake."""

EVENTFUL, SHORTEST_BATCH = 0.9, 1e-5
"""Fraction of the steps of a batch that end at events, and length of the batch in units of 1/rate, at which events
follow one another without end. Bounces that come to rest last longer: the last 250 take 1e-4."""

_COPIES = 3
"""Number of copies of the polynomials in memory at once: in batches, concatenated, and during evaluation."""


class Record(NamedTuple):
    """The steps of one lane, along the first axis of the arrays.

    - `start`, `dt` [s]: beginning and length of each step; `h` [s]: length scale of the polynomials, more than `dt` if
      an event ends the step.
    - `polynomials`: coefficients of the states in powers of (t - start)/h.
    - `mode`: mode at the beginning of the step; `after`: state at the beginning of the next step.
    - `hits`: True for the guards and markers whose zero ends the step; `falling`: for markers that cross zero
      downwards.
    """

    start: Float[Array, " steps"]
    h: Float[Array, " steps"]
    dt: Float[Array, " steps"]
    polynomials: Float[Array, "steps states orders"]
    mode: Float[Array, "steps modes"]
    after: Float[Array, "steps states"]
    hits: Bool[Array, "steps events"]
    falling: Bool[Array, "steps markers"]


def record(
    scene: Scene[Any],
    stepper: Stepper,
    constants: Any,
    state: Values,
    accuracy: Accuracy,
    duration: float,
    report: Callable[[float], None] | None = None,
    most_steps: int = RECORD_MAX_STEPS,
    recorder: Records | None = None,
    begin: float = 0.0,
) -> tuple[Record, Features]:
    """Step one lane from t = 0 to `duration` [s]; return its steps, and its features from the time `begin` [s] on.

    The features, by name, have the shape (1,), or (1, returns) for the last section crossings. One step ends at the
    time `begin`.

    **Arguments:** `constants`, `state`: constants of the scene and initial state, each (1,); `report(t)`: is called
    after each batch of steps; `recorder`: recorder that measures the features, None if there are none.

    **Raises:** `InputError` if the motion takes more than `most_steps` steps, or if events follow each other for ever.
    """
    constants, lane = begun(scene, constants, state)
    settled = carry = () if recorder is None else _settling(scene, recorder, lane)
    parts: list[Any] = []
    for first, end in ((0.0, begin), (begin, duration)) if recorder is not None else ((0.0, duration),):
        if recorder is not None:
            # Recorded steps end on the section throughout. A sweep's steps do so only during the observation.
            carry = _begin(scene, recorder, constants, lane, settled)
        while True:
            if len(parts) >= ceil(most_steps / BATCH):
                raise InputError(
                    f"simulate: duration: {most_steps} steps, all there is room for, led to "
                    f"{float(lane.clock.high[0]):.3g} s of {duration:g} s; give a shorter duration, or a softer contact"
                )
            lane, carry, part = record_batch(
                scene, stepper, recorder, BATCH, constants, lane, carry, accuracy, np.float64(first), np.float64(end)
            )
            parts.append({name: np.asarray(x)[..., 0] for name, x in part.items()})
            if report:
                report(float(lane.clock.high[0]))
            if not float(lane.clock.until(end)[0]) > 0:
                break
            names = _accumulating(scene, constants, lane, parts[-1])
            if names or not parts[-1]["dt"].any():
                raise InputError(
                    f"simulate: at {float(lane.clock.high[0]):.6g} s, events follow one another without end"
                    f"{': ' if names else ''}{' and '.join(names)}; a reset must move the state off the event's own "
                    "surface, and only stops with velocity= and restitution= can hold a motion after many bounces"
                )
        if recorder is not None:
            settled = recorder.settled(settled, carry)
    whole = Record(**{name: np.concatenate([part[name] for part in parts]) for name in Record._fields})
    features = {} if recorder is None else _read(scene, recorder, constants, carry)
    return Record(*(x[(whole.dt > 0) | whole.hits.any(axis=1)] for x in whole)), {
        name: np.moveaxis(np.asarray(x), -1, 0) for name, x in features.items()
    }


def _accumulating(scene: Scene[Any], constants: Any, lane: Lane, steps: dict[str, Any]) -> list[str]:
    """Return the names of the events at which nearly all steps end, if they are too short for a motion to go on."""
    if steps["hits"].any(axis=1).mean() < EVENTFUL:
        return []
    if steps["dt"].sum() * float(_rate(scene, constants, lane.mode)[0]) > SHORTEST_BATCH:
        return []
    guards = zip(scene.guard_names, steps["hits"].T, strict=False)  # markers come last
    return [name for name, hit in guards if hit.mean() > 1 - EVENTFUL]


@lane_function(static=2)
def _settling(scene: Scene[Any], recorder: Records, lane: Lane) -> Any:
    return recorder.settling(scene, lane)


@lane_function(static=2)
def _begin(scene: Scene[Any], recorder: Records, c: Any, lane: Lane, settled: Any) -> Any:
    return recorder.begin(scene, c, lane, settled)


@lane_function(static=2)
def _read(scene: Scene[Any], recorder: Records, c: Any, carry: Any) -> Features:
    return recorder.read(scene, c, carry)


@lane_function(static=1)
def begun(scene: Scene[Any], constants: Any, state: Values) -> tuple[Any, Lane]:
    """Return the constants, scaled for a motion from `state`, and the lane at t = 0 in this state."""
    constants = scene.scaled(constants, state)
    return constants, lane_at(scene, constants, state)


@lane_function(static=4)
def record_batch(
    scene: Scene[Any],
    stepper: Stepper,
    recorder: Records | None,
    count: int,
    constants: Any,
    lane: Lane,
    carry: Any,
    accuracy: Accuracy,
    begin: Array,
    end: Array,
) -> tuple[Lane, Any, Any]:
    """Step lanes `count` times, or fewer if they reach the time `end` [s], and record their steps.

    `carry`: carry of the recorder for an observation from `begin` to `end`, () without a recorder.

    **Returns:** the lanes and the carry after the steps, and the fields of `Record` by name,
    arrays (steps, ..., lanes).
    """

    def flags(names: tuple[str, ...], flags_of: Any, like: Array) -> Array:
        return jnp.stack([flags_of[name] for name in names]) if names else jnp.zeros((0, *like.shape), bool)

    def advance(now: tuple[Lane, Any], _: None) -> tuple[tuple[Lane, Any], Any]:
        lane, carry = now
        moving = lane.clock.until(end) > 0
        new, step = stepper.step(scene, constants, lane, accuracy, Goal(end, moving))
        if recorder is not None:
            carry = recorder.step(scene, constants, carry, new, step)
            carry = recorder.take_returns(scene, constants, carry, new, (new.clock.high - begin) / (end - begin))
        columns = {
            "start": lane.clock.high,
            "h": step.h,
            "dt": step.dt,
            "polynomials": jnp.stack([jnp.stack(series) for series in step.polynomials]),
            "mode": jnp.stack(step.mode),
            "after": jnp.stack(step.after),
            "hits": flags(scene.event_names, step.hits, moving),
            "falling": flags(scene.marker_names, step.falling, moving),
        }
        return (new, carry), columns

    (lane, carry), steps = jax.lax.scan(advance, (lane, carry), length=count)
    return lane, carry, steps


def sample(
    record: Record, times: Float[np.ndarray, " samples"]
) -> tuple[Float[Array, "states samples"], Float[Array, "modes samples"], Int[Array, " samples"]]:
    """Return states and modes at `times` [s], and the index of the step that contains each sample.

    `record`: steps of nonzero length, see `moving`.
    """
    start = record.start
    step = np.clip(np.searchsorted(start, times, side="right") - 1, 0, len(start) - 1)
    tau = np.minimum(times - start[step], record.dt[step]) / record.h[step]
    return _evaluate(record.polynomials[step], tau).T, record.mode[step].T, step


def moving(record: Record) -> Record:
    """Return the steps of nonzero length; the others only switch the mode."""
    mask = record.dt > 0
    return record if mask.all() else Record(*(x[mask] for x in record))


def accumulated(record: Record, state: int) -> Float[np.ndarray, " steps"]:
    """Return the offset in each step that makes a state continuous in spite of its resets to zero."""
    polynomials = record.polynomials[:, state : state + 1]
    start = polynomials[:, 0, 0]
    growth = _evaluate(polynomials, record.dt / record.h)[:, 0] - start
    return np.concatenate([[0.0], np.cumsum(growth)[:-1]]) - start


def _evaluate(
    coefficients: Float[Array, "steps states orders"], tau: Float[Array, " steps"]
) -> Float[Array, "steps states"]:
    """Evaluate polynomials at `tau`."""
    return reduce(lambda values, x: values * tau[:, None] + x, coefficients.transpose(2, 0, 1)[::-1])


def check_size(
    place: Place,
    scene: Scene[Any],
    constants: Any,
    duration: float,
    accuracy: Accuracy,
    stepper: Stepper | None,
    samples: int,
) -> int:
    """Return the maximum number of steps that fit in memory.

    `constants`: constants of the scene, each (1,); `stepper`: None for a diffrax solver, whose steps are not stored.

    **Raises:** `InputError` if the motion takes more steps, even without events.
    """
    if stepper is None:
        from vibrojax.stepping.adaptive import MOST_STEPS as most

        step_bytes, requested = 0.0, 0.0
    else:
        numbers = 3 + len(scene.states) * (stepper.degree + 2) + len(scene.modes)
        step_bytes = 8.0 * numbers + len(scene.guard_names) + 2 * len(scene.markers)
        most, requested = RECORD_MAX_STEPS, 1 / accuracy.step
    available = memory() if step_bytes else None
    if available is not None:
        most = max(min(most, int((available - 2 * samples * step_bytes) / (_COPIES * step_bytes))), 0)
    # A diffrax solver chooses its own steps, but these must resolve the oscillation on the main spring.
    if stepper is None and isinstance(scene, HasFriction):
        natural = float(scene.spring_rate(constants)[0]) / accuracy.stride
    else:
        calmest = tuple(np.full(1, mode.calmest) for mode in scene.modes)
        natural = float(_rate(scene, constants, calmest)[0]) / accuracy.stride
    steps = duration * max(natural, requested)
    if steps <= most:
        return most
    needs = f"{steps:.3g} steps" + (f" and {size_text(_COPIES * steps * step_bytes)} of memory" if step_bytes else "")
    allowed = f"{most:.3g} steps" + (f" and {size_text(available)} of memory" if available else "")
    advice = "give a shorter duration" + (", a longer step or a greater error" if requested > natural else "")
    raise place.at("duration").error(f"{duration:g} s need about {needs}; there is room for {allowed}: {advice}")


@lane_function(static=1)
def _rate(scene: Scene[Any], constants: Any, mode: Values) -> Array:
    return scene.rate(constants, mode)


KINDS = ("none", "stick", "slip", "impact", "release", "section", "switch", "slide")
"""Meanings of the CF flag values of `event_kind`."""

FORCES = {
    "friction_force": "friction force of the rock on the bit, against its sliding",
    "impact_force": "contact force between striker and bit",
    "applied_force": "given force on the bit",
    "rock_force": "resistance of the rock under the bit",
}
"""Meanings of the sampled forces [N], by variable name."""


OBSERVED_SHARE = 1 / 6
"""Observed part of a motion, as a fraction of its duration: that of a sweep's defaults."""


def window(scene: Scene[Any], duration: float) -> tuple[float, float]:
    """Return the beginning and the length of the observation of a motion with this `duration` [s].

    The observation has at least the scene's usual length, or half of a short motion.
    """
    observe = max(OBSERVED_SHARE * duration, min(scene.usual_times[1], duration / 2))
    return duration - observe, observe


class SampledMotion(NamedTuple):
    """Sampled states and modes at `times` [s]."""

    times: Float[np.ndarray, " samples"]
    states: Float[Array, "states samples"]
    modes: Float[Array, "modes samples"]


Events = tuple[Float[np.ndarray, " events"], Int[np.ndarray, " events"]]
"""Events in the order of time: times [s], and kinds as indices into `KINDS`."""


def events(
    scene: Scene[Any], c: Any, record: Record, after: np.ndarray | None = None, lanes: Sequence[slice] = (slice(None),)
) -> Iterator[Events]:
    """Yield the events of each lane, whose steps are a slice of the `record`.

    `c`: constants of the scene, for one lane or for each step; `after` (steps, modes): modes at the end of each step,
    by default those of the next one.
    """
    masks: dict[str, Bool[Array, " steps"]] = {}
    hits = dict(zip(scene.event_names, record.hits.T, strict=True))
    after = np.concatenate([record.mode[1:], record.mode[-1:]]) if after is None else after
    masks |= scene.events_of(tuple(record.mode.T), tuple(after.T), hits)
    if isinstance(scene, HasFriction):
        place = scene.mode_place("slip")
        slip, next_slip = record.mode[:, place], after[:, place]
        masks["stick"] = hits["friction"] & (slip != 0) & (next_slip == 0)
        masks["slip"] = hits["friction"] & (next_slip != 0)
    if isinstance(scene, HasImpacts):
        modes, states = tuple(record.mode.T), tuple(record.after.T)
        masks["impact"] = np.asarray(impact_begins(scene, scalars(c), modes, states, hits))
    if isinstance(scene, HasContact):
        masks["release"] = hits["contact"] & (record.mode[:, scene.mode_place("touching")] != 0)
    if scene.section is not None:
        masks["section"] = _returns(scene, c, record, lanes)
    time = np.asarray(record.start + record.dt)
    numbers = np.array([KINDS.index(name) for name in masks], np.int8)
    table = np.stack([*masks.values()]) if masks else np.zeros((0, len(time)), bool)
    for lane in lanes:
        kind, step = np.nonzero(table[:, lane])
        times = time[lane][step]
        order = np.argsort(times, kind="stable")
        yield times[order], numbers[kind[order]]


def _returns(scene: Scene[Any], c: Any, record: Record, lanes: Sequence[slice]) -> Bool[np.ndarray, " steps"]:
    """Return a mask of the steps of `lanes` that end in a section crossing.

    A crossing counts only if the velocity has passed the re-arming level since the previous crossing.
    """
    section = scene.section
    assert section is not None
    sign, marker = 1.0 if section.rising else -1.0, scene.marker_of(section.velocity)
    falling = record.falling[:, scene.marker_names.index(marker)]
    returns = record.hits[:, scene.event_names.index(marker)] & (~falling if section.rising else falling)
    passed = np.zeros(len(returns), bool)
    # A step that only switches the mode has length zero, and its velocity does not change.
    tau = np.where(record.dt > 0, record.dt / np.where(record.h > 0, record.h, 1), 0)
    velocity = [sign * coefficient for coefficient in record.polynomials[:, scene.place(section.velocity)].T]
    low = np.asarray(lowest_velocity(velocity, tau)) < sign * np.ravel(section.rearm(c))
    for lane in lanes:
        places = np.flatnonzero(returns[lane])
        passed[lane][places] = np.diff(np.cumsum(low[lane])[places], prepend=0) > 0
    return passed


def forces(scene: Scene[Any], c: Any, motion: SampledMotion, width: float | None) -> dict[str, xr.Variable]:
    """Return the sampled forces [N] by name; `width`: that of the smoothed friction switch [m/s], None if it is sharp.

    Friction is the force of the springs on the bit minus the bit's mass times acceleration.
    """
    values = _forces(scene, width is None, scalars(c), tuple(motion.modes), tuple(motion.states), width or 0.0)
    return {name: along_time(np.asarray(force) + 0.0, "N", FORCES[name]) for name, force in values.items()}  # no -0.0


@lane_function(static=2)
def _forces(scene: Scene[Any], is_sharp: bool, c: Any, modes: Values, states: Values, width: Any) -> dict[str, Array]:
    values: dict[str, Any] = {}
    if isinstance(scene, HasFriction):
        rates = scene.field(c, modes, states) if is_sharp else scene.smoothed_field(c, modes, states, width)
        values["friction_force"] = scene.pull(c, states) - scene.bit(c).mass * rates[scene.place(scene.bit_velocity)]
    if isinstance(scene, HasContact):
        values["impact_force"] = scene.contact_force(c, modes, states)
    if isinstance(scene, Driven):
        values["applied_force"] = scene.applied_force(c, modes, states)
    if isinstance(scene, HasRock):
        values["rock_force"] = scene.rock_force(c, modes, states)
    return {name: force + jnp.zeros_like(states[0]) for name, force in values.items()}


@lane_function(static=1)
def impact_begins(scene: HasImpacts[Any], c: Any, modes: Values, states: Values, hits: dict[str, Array]) -> Array:
    """Return a mask of steps (`modes`, end `states`, guards `hits`) that end as an impact begins."""
    return scene.impact_begins(c, modes, states, hits)


@lane_function(static=0)
def lowest_velocity(velocity: list[Array], tau: Array) -> Array:
    """Return the minimum of each step's polynomial between 0 and `tau`."""
    return lowest(velocity, tau)


def scalars(c: Any) -> Any:
    """Return the constants of one lane as scalars, which apply to all samples; those of many lanes remain."""
    return map_leaves(lambda x: np.reshape(x, ()) if np.size(x) == 1 else x, c)


def states_shown(
    scene: Scene[Any], motion: SampledMotion, record: Record | None, step_of: Int[Array, " samples"] | None
) -> dict[str, tuple[np.ndarray, str, str]]:
    """Return values, unit and meaning of the sampled states by name.

    With rock, these are x3 (bit) and x4 (hole) instead of `compression` and `growth`.
    `growth` is reset to zero at each impact or pulse. x4 is its sum since the start, and x3 is x4 plus `compression`.
    `record` holds all steps of nonzero length, and `step_of` the step of each sample; without them, x3 and x4 are left
    out.
    """
    variables: dict[str, tuple[np.ndarray, str, str]] = {}
    x3 = x4 = None
    if isinstance(scene, HasRock) and record is not None and step_of is not None:
        growth = scene.place("growth")
        x4 = motion.states[growth] + accumulated(record, growth)[step_of]
        x3 = x4 + motion.states[scene.place("compression")]
    for state, values in zip(scene.states, motion.states, strict=True):
        if state.shown:
            variables[state.name] = np.asarray(values + state.offset), state.unit, state.long_name
        elif state.name == "compression" and x3 is not None:
            variables["x3"] = np.asarray(x3), "m", "normal position of the bit"
        elif state.name == "growth" and x4 is not None:
            variables["x4"] = np.asarray(x4), "m", "depth of the hole"
    return variables


def along_time(values: Any, unit: str, long_name: str, flags: tuple[str, ...] = ()) -> xr.Variable:
    """Return values at the sampled times as a variable of a trajectory's dataset."""
    return xr.Variable("time", np.asarray(values), Variable(unit, long_name, flags=flags).attributes())
