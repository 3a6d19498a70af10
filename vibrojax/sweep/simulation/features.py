"""What was found along a recorded motion: its features and label, by what measures and labels the lanes of a sweep.

The recorded steps go through the scene's recorder once more, one by one, as they would go through it in a sweep whose
`settle` and `observe` are those of `window`.
"""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.compile.devices import precision
from vibrojax.errors import InputError
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.measures import recorder_for
from vibrojax.measures.recorder import Features, Records
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import Clock, Lane, Step, Stepper
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.engine.drift import drift
from vibrojax.sweep.engine.labelled import measured_besides, regimes
from vibrojax.sweep.simulation.dense_output import BATCH, Record, begun

OBSERVED, LONGEST_HALF = 1 / 6, 8.0
"""The part of a motion that is observed, that of a sweep's defaults; of a short one half, up to so many seconds."""


def window(duration: float) -> tuple[float, float]:
    """When the observation of a motion of that `duration` begins, and how long it is [s]."""
    observe = max(OBSERVED * duration, min(LONGEST_HALF, duration / 2))
    return duration - observe, observe


def recorder_of(scene: Scene[Any]) -> Records | None:
    """What measures a scene; None where it declares nothing to measure over, or what it is not (a sweep says why)."""
    try:
        return recorder_for(scene)
    except InputError:
        return None


def measured(
    scene: Scene[Any], recorder: Records, constants: Any, state: Values, taken: Record, begin: float, observe: float
) -> dict[str, np.ndarray]:
    """The features of one recorded lane by name, each (1,), or (1, returns) for the last returns.

    **Arguments:** `constants`: the scene's; `state` at t = 0, each (1,); `taken`: its steps, one of which ends at the
    time `begin` [s], from which on it is observed for `observe` [s].
    """
    constants, lane = begun(scene, constants, state)
    middle = int(np.searchsorted(taken.start + taken.dt / 2, begin))
    before, after = (Record(*(x[part] for x in taken)) for part in (slice(middle), slice(middle, None)))
    settled = recorder.settling(scene, lane)
    if middle:
        # Recorded steps end on the section already, as those of a sweep do only under observation.
        observed = _begin(scene, recorder, constants, lane, settled)
        for part in _batches(before):
            observed = _observe(scene, recorder, constants, observed, part, 0.0, begin)
        settled = recorder.settled(settled, observed)
        lane = _as_step(scene, Record(*(x[middle - 1][..., None] for x in taken)))[1]
        lane = lane._replace(mode=tuple(mode[None] for mode in after.mode[0]))
    observed = _begin(scene, recorder, constants, lane, settled)
    for part in _batches(after):
        observed = _observe(scene, recorder, constants, observed, part, begin, observe)
    features = _read(scene, recorder, constants, observed)
    return {name: np.moveaxis(np.asarray(x), -1, 0) for name, x in features.items()}


def compile_measures(scene: Scene[Any], recorder: Records, stepper: Stepper, constants: Any, state: Values) -> None:
    """Compile what `measured` runs, so that it is there when the motion is; nothing is measured."""
    events, markers = len(scene.event_names), len(scene.marker_names)
    none, flags = np.zeros(1), np.zeros((1, events), bool)
    states, modes = len(scene.states), len(scene.modes)
    polynomials, after = np.zeros((1, states, stepper.degree + 1)), np.zeros((1, states))
    still = Record(none, none, none, polynomials, np.zeros((1, modes)), after, flags, np.zeros((1, markers), bool))
    still = Record(*(np.concatenate([x, x]) for x in still))
    with precision("float64"):
        measured(scene, recorder, constants, state, still._replace(start=np.array([0.0, 1.0])), 0.5, 1.0)


def found_in(
    scene: Scene[Any], parameters: dict[str, float], features: dict[str, np.ndarray], tolerance: float
) -> dict[str, tuple[tuple[()], np.ndarray, dict[str, Any]]]:
    """The variables of a motion's dataset that say what was found: numbers, named as in a sweep's.

    **Arguments:** `parameters`: the point, complete; `features`: from `measured`; `tolerance`: of the steps.
    """
    found = dict(features)
    if scene.section is not None and "cycles" in found:
        values = {name: np.array([value]) for name, value in parameters.items()}
        swing = scene.section.swings[0].amplitude
        if {swing, "trend"} <= set(found):
            sound = {"finite": np.isfinite(found[swing]), "finished": np.array([True])}
            found["regime"] = regimes(scene, values, found | sound)
        found["drift_estimate"] = drift(found, scene.section, "float64", tolerance)
    known: dict[str, Variable] = VARIABLES | measured_besides(scene)
    return {
        name: ((), _as(known[name], found[name]), known[name].attributes())
        for name in known
        if name in found and found[name].ndim == 1
    }


def _as(variable: Variable, values: np.ndarray) -> np.ndarray:
    """One lane's value, of the variable's dtype."""
    whole = np.issubdtype(variable.dtype, np.integer)
    return np.asarray(np.nan_to_num(values[0]) if whole else values[0], variable.dtype)


def _batches(steps: Record) -> Iterator[Record]:
    """The steps in batches of one size, an axis of lanes added; in the last the lane stands still where it ended."""
    for first in range(0, len(steps.dt), BATCH):
        batch = Record(*(x[first : first + BATCH] for x in steps))
        missing = BATCH - len(batch.dt)
        if missing:
            batch = _stretched(batch, missing)
        yield Record(*(x[..., None] for x in batch))


def _stretched(steps: Record, more: int) -> Record:
    """The steps, and `more` in which the lane stands still where they end."""
    last = Record(*(x[-1] for x in steps))
    polynomials = np.zeros_like(last.polynomials)
    polynomials[:, 0] = last.after
    still = last._replace(
        start=last.start + last.dt,
        dt=np.zeros_like(last.dt),
        polynomials=polynomials,
        hits=np.zeros_like(last.hits),
        falling=np.zeros_like(last.falling),
    )
    both = zip(steps, still, strict=True)
    return Record(*(np.concatenate([x, np.broadcast_to(y, (more, *np.shape(y)))]) for x, y in both))


@lane_function(static=2)
def _begin(scene: Scene[Any], recorder: Records, c: Any, lane: Lane, settled: Any) -> Any:
    return recorder.begin(scene, c, lane, settled)


@lane_function(static=2)
def _observe(
    scene: Scene[Any], recorder: Records, c: Any, carry: Any, steps: Record, begin: float, observe: float
) -> Any:
    def one(carry: Any, recorded: Record) -> tuple[Any, None]:
        step, lane = _as_step(scene, recorded)
        carry = recorder.step(scene, c, carry, lane, step)
        share = (lane.clock.high - begin) / observe
        return recorder.take_returns(scene, c, carry, lane, share), None

    return jax.lax.scan(one, carry, steps)[0]


@lane_function(static=2)
def _read(scene: Scene[Any], recorder: Records, c: Any, carry: Any) -> Features:
    return recorder.read(scene, c, carry)


def _as_step(scene: Scene[Any], recorded: Record) -> tuple[Step, Lane]:
    """A recorded step, its last axis that of lanes, and the lane after it, in the mode in which the step began."""

    def each(x: Array) -> tuple[Array, ...]:
        return tuple(x[i] for i in range(len(x)))

    polynomials = tuple(list(each(coefficients)) for coefficients in each(recorded.polynomials))
    mode, after = each(recorded.mode), each(recorded.after)
    h, dt = recorded.h, recorded.dt
    step = Step(
        before=tuple(series[0] for series in polynomials),
        mode=mode,
        polynomials=polynomials,
        h=h,
        tau=jnp.where(dt > 0, dt / jnp.where(h > 0, h, 1), 0),
        dt=dt,
        after=after,
        hits=dict(zip(scene.event_names, each(recorded.hits), strict=True)),
        falling=dict(zip(scene.marker_names, each(recorded.falling), strict=True)),
    )
    end = recorded.start + recorded.dt
    return step, Lane(Clock(end, jnp.zeros_like(end)), after, mode, jnp.full_like(end, jnp.inf))
