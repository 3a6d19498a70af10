"""One lane, step by step: the polynomial of every step is kept, so that the motion can be evaluated at any time."""

from collections.abc import Callable
from math import ceil
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.errors import InputError, Place
from vibrojax.io.formatting import size_text
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import HasFriction, Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import Accuracy, Goal, Lane, Stepper, lane_at
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.resources import memory

BATCH = 512
"""Steps per call of the compiled program: enough for the call itself to cost little."""

RECORD_MAX_STEPS = 20_000 * BATCH
"""Ten million steps are some gigabytes; a longer motion is a slip."""

_COPIES = 3
"""Copies of the polynomials in memory at once: in batches, concatenated, and as evaluated."""


class Record(NamedTuple):
    """The steps of one lane, along the first axis.

    - `start`, `h`, `dt` [s]; `polynomials` in (t - start)/h.
    - `mode` at the start of a step; `after`: the state in which the next one starts.
    - `hits`: the guards and markers, in the scene's order, that a step ended on.
    - `falling`: markers that fell through zero.
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
    duration: Array,
    report: Callable[[float], None] | None = None,
    most_steps: int = RECORD_MAX_STEPS,
    pause: Array | None = None,
) -> Record:
    """Step one lane, of shape (1,), from t = 0 to `duration` [s]; call `report(t)` after each batch of steps.

    A step ends at the time `pause` [s], if there is one. Raises `InputError` if this takes over `most_steps`.
    """
    constants, lane = begun(scene, constants, state)
    parts = []
    goal = duration if pause is None else pause
    for _ in range(ceil(most_steps / BATCH)):
        lane, part = record_batch(scene, stepper, BATCH, constants, lane, accuracy, goal)
        parts.append(jax.tree.map(lambda x: np.asarray(x)[..., 0], part))
        if report:
            report(float(lane.clock.high[0]))
        if not float(lane.clock.until(goal)[0]) > 0:
            goal = duration
        if not float(lane.clock.until(duration)[0]) > 0:
            whole = Record(**{name: np.concatenate([part[name] for part in parts]) for name in Record._fields})
            return Record(*(x[(whole.dt > 0) | whole.hits.any(axis=1)] for x in whole))
    reached = float(lane.clock.high[0])
    raise InputError(
        f"simulate: duration: {most_steps} steps, all there is room for, led to {reached:.3g} s of "
        f"{float(duration):g} s; give a shorter duration, or a softer contact"
    )


@lane_function(static=1)
def begun(scene: Scene[Any], constants: Any, state: Values) -> tuple[Any, Lane]:
    """Return the constants scaled for a motion from `state`, and the lane that starts there."""
    constants = scene.scaled(constants, state)
    return constants, lane_at(scene, constants, state)


@lane_function(static=3)
def record_batch(
    scene: Scene[Any], stepper: Stepper, count: int, constants: Any, lane: Lane, accuracy: Accuracy, duration: Array
) -> tuple[Lane, Any]:
    """Return lanes after `count` steps, fewer if they reach the time `duration` [s], and their record by name.

    Its columns have shape (steps, ..., lanes).
    """

    def flags(names: tuple[str, ...], flags_of: Any, like: Array) -> Array:
        return jnp.stack([flags_of[name] for name in names]) if names else jnp.zeros((0, *like.shape), bool)

    def advance(lane: Lane, _: None) -> tuple[Lane, Any]:
        moving = lane.clock.until(duration) > 0
        new, step = stepper.step(scene, constants, lane, accuracy, Goal(duration, moving))
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
        return new, columns

    steps: tuple[Lane, Any] = jax.lax.scan(advance, lane, length=count)
    return steps


def sample(
    record: Record, times: Float[np.ndarray, " samples"]
) -> tuple[Float[Array, "states samples"], Float[Array, "modes samples"], Int[Array, " samples"]]:
    """Return states and modes at `times` [s], and the moving step that each sample is in."""
    moving = record.dt > 0
    start, h = record.start[moving], record.h[moving]
    step = np.clip(np.searchsorted(start, times, side="right") - 1, 0, len(start) - 1)
    tau = np.minimum(times - start[step], record.dt[moving][step]) / h[step]
    states = _evaluate(record.polynomials[moving][step], tau)
    return states.T, record.mode[moving][step].T, step


def accumulated(record: Record, state: int) -> Float[np.ndarray, " moving"]:
    """Return the offset in each moving step that makes a state continuous which is reset to zero now and then."""
    moving = record.dt > 0
    polynomials = record.polynomials[moving][:, state : state + 1]
    start = polynomials[:, 0, 0]
    growth = _evaluate(polynomials, record.dt[moving] / record.h[moving])[:, 0] - start
    return np.concatenate([[0.0], np.cumsum(growth)[:-1]]) - start


def _evaluate(
    coefficients: Float[Array, "steps states orders"], tau: Float[Array, " steps"]
) -> Float[Array, "steps states"]:
    """Return the values of polynomials by Horner's scheme."""
    values = coefficients[:, :, -1]
    for order in range(coefficients.shape[2] - 2, -1, -1):
        values = values * tau[:, None] + coefficients[:, :, order]
    return values


def check_size(
    place: Place,
    scene: Scene[Any],
    constants: Any,
    duration: float,
    accuracy: Accuracy,
    stepper: Stepper | None,
    samples: int,
) -> int:
    """Return the greatest number of steps that fit in memory.

    Raises `InputError` if the motion takes more, even without events.

    **Arguments:** `constants`: the scene's, each of shape (1,); `stepper`: None for a diffrax solver, whose steps are
    not kept; `samples`: their number.
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
    # A diffrax solver chooses its own steps, but it must follow the main spring.
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
