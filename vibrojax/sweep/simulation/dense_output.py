"""One lane, step by step: every step's polynomial is kept, so that the motion can be read at any time.

Whether there is room for that is asked before any work.
"""

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
MOST_STEPS = 20_000 * BATCH

COPIES = 3
"""Of every step's polynomials that are held at once: in batches, put together, and those that are read."""


class Record(NamedTuple):
    """The steps of one lane, along the first axis.

    `start`, `h`, `dt` [s]; `polynomials` in (t - start)/h; `mode` where a step starts, `after` the state in which the
    next one does; `hits`: the guards and markers, in the scene's order, that a step ended on; `falling`: whether a
    marker came down through zero.
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
    tell: Callable[[float], None] | None = None,
    most_steps: int = MOST_STEPS,
    pause: Array | None = None,
) -> Record:
    """Step one lane, of shape (1,), from t = 0 to `duration` [s]; `tell(t)` hears how far it is.

    A step ends at the time `pause` [s], if there is one. Raises `InputError` where all this takes over `most_steps`,
    ten million unless there is no room for so many.
    """
    constants, lane = begun(scene, constants, state)
    parts = []
    goal = duration if pause is None else pause
    for _ in range(ceil(most_steps / BATCH)):
        lane, part = record_batch(scene, stepper, BATCH, constants, lane, accuracy, goal)
        parts.append(jax.tree.map(lambda x: np.asarray(x)[..., 0], part))
        if tell:
            tell(float(lane.clock.high[0]))
        if not float(lane.clock.until(goal)[0]) > 0:
            goal = duration
        if not float(lane.clock.until(duration)[0]) > 0:
            whole = Record(**{name: np.concatenate([part[name] for part in parts]) for name in Record._fields})
            taken = whole.dt > 0
            taken |= whole.hits.any(axis=1)
            return Record(*(x[taken] for x in whole))
    reached = float(lane.clock.high[0])
    raise InputError(
        f"simulate: duration: {most_steps} steps, all there is room for, led to {reached:.3g} s of "
        f"{float(duration):g} s; give a shorter duration, or a softer contact"
    )


@lane_function(static=1)
def begun(scene: Scene[Any], constants: Any, state: Values) -> tuple[Any, Lane]:
    """(the constants scaled for a motion from `state`, the lane that starts there)."""
    constants = scene.scaled(constants, state)
    return constants, lane_at(scene, constants, state)


@lane_function(static=3)
def record_batch(
    scene: Scene[Any], stepper: Stepper, count: int, constants: Any, lane: Lane, accuracy: Accuracy, duration: Array
) -> tuple[Lane, Any]:
    """(lanes after so many steps, or less where they come to the time `duration` [s]; the columns of their record, each
    (steps, ..., lanes))."""

    def one(lane: Lane, _: None) -> tuple[Lane, Any]:
        moving = lane.clock.until(duration) > 0
        new, step = stepper.step(scene, constants, lane, accuracy, Goal(duration, moving))
        columns = {
            "start": lane.clock.high,
            "h": step.h,
            "dt": step.dt,
            "polynomials": jnp.stack([jnp.stack(series) for series in step.polynomials]),
            "mode": jnp.stack(step.mode),
            "after": jnp.stack(step.after),
            "hits": _flags(scene.event_names, step.hits, moving),
            "falling": _flags(scene.marker_names, step.falling, moving),
        }
        return new, columns

    steps: tuple[Lane, Any] = jax.lax.scan(one, lane, length=count)
    return steps


def _flags(names: tuple[str, ...], flags: Any, like: Array) -> Bool[Array, "names lanes"]:
    return jnp.stack([flags[name] for name in names]) if names else jnp.zeros((0, *like.shape), bool)


def sample(
    record: Record, times: Float[np.ndarray, " samples"]
) -> tuple[Float[Array, "states samples"], Float[Array, "modes samples"], Int[Array, " samples"]]:
    """States and modes at `times` [s], read off the steps' polynomials; and which of the moving steps each is of."""
    moving = record.dt > 0
    start, h = record.start[moving], record.h[moving]
    step = np.clip(np.searchsorted(start, times, side="right") - 1, 0, len(start) - 1)
    tau = np.minimum(times - start[step], record.dt[moving][step]) / h[step]
    states = _value(record.polynomials[moving][step], tau)
    return states.T, record.mode[moving][step].T, step


def accumulated(record: Record, state: int) -> Float[np.ndarray, " moving"]:
    """What to add in each moving step to a state that is set back to zero now and then, so that it is not."""
    moving = record.dt > 0
    polynomials = record.polynomials[moving][:, state : state + 1]
    start = polynomials[:, 0, 0]
    growth = _value(polynomials, record.dt[moving] / record.h[moving])[:, 0] - start
    return np.concatenate([[0.0], np.cumsum(growth)[:-1]]) - start


def _value(
    coefficients: Float[Array, "steps states orders"], tau: Float[Array, " steps"]
) -> Float[Array, "steps states"]:
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
    """The most steps that there is room for; raises `InputError` where the motion takes more even without events.

    **Arguments:** `constants`: the scene's, each of shape (1,); `stepper`: None for a solver of diffrax, whose steps
    are not kept; `samples`: how many are asked for.
    """
    most, each = _room(scene, stepper, samples)
    natural = _calmest_rate(scene, constants, stepper) / accuracy.stride
    # How a solver of diffrax steps is its own affair, but it must follow the main spring.
    given = 0.0 if stepper is None else 1 / accuracy.step
    steps = duration * max(natural, given)
    if steps <= most:
        return most
    needs = f"{steps:.3g} steps" + (f" and {size_text(COPIES * steps * each)} of memory" if each else "")
    there = memory() if each else None
    allowed = f"{most:.3g} steps" + (f" and {size_text(there)} of memory" if there else "")
    advice = "give a shorter duration" + (", a longer step or a greater error" if given > natural else "")
    raise place.at("duration").error(f"{duration:g} s need some {needs}; there is room for {allowed}: {advice}")


def _calmest_rate(scene: Scene[Any], constants: Any, stepper: Stepper | None) -> float:
    """How fast the motion changes at least [1/s]."""
    if stepper is None and isinstance(scene, HasFriction):
        return float(scene.spring_rate(constants)[0])
    return float(_rate(scene, constants, tuple(np.full(1, mode.calmest) for mode in scene.modes))[0])


@lane_function(static=1)
def _rate(scene: Scene[Any], constants: Any, mode: Values) -> Array:
    return scene.rate(constants, mode)


def _room(scene: Scene[Any], stepper: Stepper | None, samples: int) -> tuple[int, float]:
    """How many steps there is room for, and the bytes that each takes."""
    if stepper is None:
        from vibrojax.stepping.adaptive import MOST_STEPS as MOST_ADAPTIVE

        return MOST_ADAPTIVE, 0.0
    numbers = 3 + len(scene.states) * (stepper.degree + 2) + len(scene.modes)
    flags = len(scene.guard_names) + 2 * len(scene.markers)
    each = 8.0 * numbers + flags
    there = memory()
    if there is None:
        return MOST_STEPS, each
    return max(min(MOST_STEPS, int((there - 2 * samples * each) / (COPIES * each))), 0), each
