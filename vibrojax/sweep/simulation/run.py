"""Simulate one point: its trajectory, and what was found along it."""

import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.compile.devices import precision
from vibrojax.errors import Place
from vibrojax.models.arrays import Array
from vibrojax.models.physics.parameters import positive
from vibrojax.models.scenes import HasContact, HasRock, Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.progress import LOG, Progress
from vibrojax.stepping import STEPPERS, Accuracy, Smoothed, Stepper, Wanted, stepper_named
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.input.point import read_point
from vibrojax.sweep.input.values import quantity
from vibrojax.sweep.simulation.dense_output import check_size, sample
from vibrojax.sweep.simulation.features import window
from vibrojax.sweep.simulation.recording import constants_at, recorded
from vibrojax.sweep.simulation.trajectory import Motion, events, forces, states_shown, trajectory_dataset

if TYPE_CHECKING:
    from diffrax import AbstractSolver

MOST_SAMPLES = 2_000_000


def simulate(
    scene: str | Scene[Any],
    *,
    start: str | Sequence[float] | None = None,
    duration: float = 20.0,
    method: str | Stepper | None = None,
    solver: "str | AbstractSolver | None" = None,
    step: float | None = None,
    smoothing: float | None = None,
    error: float = 1e-4,
    sampling: float | None = None,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Simulate one point of a scene.

    **Arguments:**

    - `scene`: "rotary", "vibro-impact", "penetration", "drilling" or "coupled-drilling"; `parameters`: any of the
      scene's (SI), `friction`, a law's name, `pulse_shape`, `rock`.
    - `start`: "drive", "stuck", "touching", or a vector [x1, x1', x2, x2'] [m, m/s]; by default "drive".
    - `duration` [s].
    - `method`: "located" (the default), "smoothed", or "diffrax" (the default where a `solver` is given: a diffrax
      solver or its name; "Tsit5" if none is).
    - `error`: accepted relative error, from which steps and tolerances follow; `step` [s] (the longest, or of the
      smoothed method) and `smoothing` [m/s] (width of the friction switch) for who wants to choose them.
    - `sampling` [s]: interval of the samples; by default a twentieth of the contact's duration, 1 ms without contact.

    **Returns:** a dataset along `time`: x1, v1, x2, v2, friction_force, impact_force [N], stuck; with rock also x3, x4,
    v3, rock_force and applied_force [N]; and along `event` the times and kinds of what happened; and as numbers what
    was found in the last part of it, named and measured as in a sweep: the regime, the period and so on, of a scene
    with rock the rate of penetration. The attribute `run` says how long it settled and was observed, a sixth of the
    duration, of a short one half. A solver of diffrax gives neither events nor what was found.

    **Raises:** `InputError` where a name or value is not right, or, before any work, the steps or samples are too many.

    **Example:**

    >>> motion = vj.simulate("vibro-impact", beta=0.4, gamma=0.75, delta=0.005, start="stuck", progress=False)
    >>> f"{float(motion.period):.4f} s, {float(motion.impact_velocity):.3f} m/s"
    '0.2296 s, 2.238 m/s'
    >>> sorted(motion[["x1", "v1", "x2", "v2", "impact_force"]].data_vars)
    ['impact_force', 'v1', 'v2', 'x1', 'x2']
    """
    place = Place("simulate")
    point = read_point(place, scene, parameters, start)
    method = method or ("diffrax" if solver is not None else "located")
    methods = (*STEPPERS, "diffrax")
    if not isinstance(method, Stepper) and method not in methods:
        raise place.at("method").error(f'"{method}" is not one; choose from {", ".join(methods)}')
    if solver is not None and method != "diffrax":
        raise place.at("solver").error(f'has no use with method "{method}"; leave one of them out')
    stepper = None if method == "diffrax" else stepper_named(method)
    if smoothing is not None and stepper is not None and not stepper.smooths:
        raise place.at("smoothing").error(
            f'has no use with method "{stepper.name}"; leave it out, or set method = "smoothed"'
        )
    duration, error = _positive(place, "duration", duration, "s"), _positive(place, "error", error, "1")
    step, smoothing = _given(place, "step", step, "s"), _given(place, "smoothing", smoothing, "m s-1")
    sampling = _given(place, "sampling", sampling, "s")
    if duration < np.finfo(float).tiny:  # the clock takes it for zero
        raise place.at("duration").error(f"{duration:g} s is no time; give a longer one")
    system = point.system
    if stepper is None and isinstance(system, HasRock):
        raise place.at("method").error('"diffrax" knows no rock that yields; choose from located, smoothed')
    shown = Progress(duration, "s simulated", progress and sys.stderr.isatty(), pace=False)
    with precision("float64"):
        constants = constants_at(place, point, stepper)
        times = _times(place, system, constants, duration, sampling)
        accuracy = (stepper or Smoothed()).accuracy(Wanted(error, step, smoothing), system)
        most_steps = check_size(place, system, constants, duration, accuracy, stepper, len(times))
        happened = taken = step_of = None
        found: dict[str, Any] = {}
        if stepper is None:
            from vibrojax.stepping.adaptive import solver_named  # diffrax takes a second to import

            kind = solver_named(solver or "Tsit5")
            state = system.start(constants, point.start, (1,))
            motion, steps = _adaptive(system, constants, state, times, accuracy, kind, 1e-3 * error)
        else:
            taken, found = recorded(point, stepper, constants, accuracy, duration, shown.reach, most_steps, progress)
            states, modes, step_of = sample(taken, times)
            motion, steps = Motion(times, states, modes), len(taken.dt)
            happened = events(system, constants, taken)
        smooth = stepper is None or stepper.smooths
        along_time = states_shown(system, motion, taken, step_of)
        along_time |= forces(system, constants, motion, accuracy.smoothing if smooth else None)
    solver_text = {"method": stepper.name if stepper else "diffrax", "steps": int(steps), **accuracy.described()}
    if stepper is None:
        solver_text["solver"] = type(kind).__name__
    LOG.info("chosen: %s, %d samples", json.dumps(solver_text), len(times))
    dataset = trajectory_dataset(point, system, motion, along_time, happened, solver_text)
    if not found:
        return dataset
    begin, observe = window(duration)
    return dataset.assign(found).assign_attrs(run=json.dumps({"settle": begin, "observe": observe}))


@lane_function(static=1)
def _usual_sampling(scene: Scene[Any], constants: Any) -> Array:
    """The interval of samples [s] where none is asked for."""
    shortest: Any = jnp.asarray(1e-3)
    if isinstance(scene, HasContact):
        shortest = jnp.minimum(shortest, scene.contact_time(constants) / 20)
    if isinstance(scene, HasRock):
        shortest = jnp.minimum(shortest, 0.2 * scene.rock_period(constants))
    return shortest


def _positive(place: Place, name: str, value: float, unit: str) -> float:
    """A setting as a float above zero."""
    return quantity(place.at(name), value, positive(name, 1.0, unit, name, name))


def _given(place: Place, name: str, value: float | None, unit: str) -> float | None:
    """The same, or None where it is not given."""
    return None if value is None else _positive(place, name, value, unit)


def _times(
    place: Place, scene: Scene[Any], constants: Any, duration: float, sampling: float | None
) -> Float[np.ndarray, " samples"]:
    """Times [s] of the samples, evenly from 0 to the end."""
    if sampling is None:
        sampling = float(np.ravel(_usual_sampling(scene, constants))[0])
        sampling = min(max(sampling, duration / MOST_SAMPLES), duration)
    intervals = duration / sampling
    if not 0.5 < intervals <= MOST_SAMPLES:
        raise place.at("sampling").error(
            f"{sampling:g} s gives {intervals:.7g} samples in {duration:g} s; between 1 and {MOST_SAMPLES} are needed, "
            f"so {duration / MOST_SAMPLES:.3g} to {duration:g} s"
        )
    count = round(intervals)
    return np.arange(count + 1) * (duration / count)


def _adaptive(
    scene: Scene[Any],
    constants: Any,
    state: Values,
    times: Float[np.ndarray, " samples"],
    accuracy: Accuracy,
    solver: "AbstractSolver",
    tolerance: float,
) -> tuple[Motion, int]:
    """The motion by a solver of diffrax, and how many steps it took."""
    scalars, start = jax.tree.map(lambda value: value[0], (constants, state))
    width = accuracy.smoothing
    from vibrojax.stepping.adaptive import adaptive_trajectory

    states, steps = adaptive_trajectory(
        scene, scalars, start, jnp.asarray(times), width, solver, tolerance, accuracy.step
    )
    modes = scene.smoothed_mode(scalars, scene.mode_at(scalars, states), states, 3 * width)
    columns = (np.stack([np.asarray(one) for one in many]) for many in (states, modes))
    return Motion(times, *columns), int(steps)
