"""Simulate one point and give its trajectory."""

import sys

import jax.numpy as jnp
import numpy as np
import xarray as xr

from vibrojax.devices import precision
from vibrojax.errors import Place
from vibrojax.physics.parameters import positive
from vibrojax.simulation._events import events
from vibrojax.simulation._record import record, sample
from vibrojax.simulation._size import check_size
from vibrojax.simulation._trajectory import forces, holes, trajectory_dataset
from vibrojax.stepping import Located, Smoothed
from vibrojax.stepping.adaptive import adaptive_trajectory, solver_named
from vibrojax.sweep import RunSettings, accuracy_for, quantity, read_point, unresolved

METHODS = ("located", "smoothed", "diffrax")
MOST_SAMPLES = 2_000_000


def simulate(
    scene: str,
    *,
    start=None,
    duration: float = 20.0,
    method: str | None = None,
    solver=None,
    step: float | None = None,
    smoothing: float | None = None,
    error: float = 1e-4,
    sampling: float | None = None,
    progress: bool = True,
    **parameters,
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
    v3, rock_force and applied_force [N]; and along `event` the times and kinds of what happened (not with diffrax).

    **Raises:** `InputError` where a name or value is not right, or, before any work, the steps or samples are too many.
    """
    place = Place("simulate")
    point = read_point(place, scene, parameters, start)
    method = method or ("diffrax" if solver is not None else "located")
    if method not in METHODS:
        raise place.at("method").error(f'"{method}" is not one; choose from {", ".join(METHODS)}')
    if solver is not None and method != "diffrax":
        raise place.at("solver").error(f'has no use with method "{method}"; leave one of them out')
    if smoothing is not None and method == "located":
        raise place.at("smoothing").error('has no use with method "located"; leave it out, or set method = "smoothed"')
    duration, error = _positive(place, "duration", duration, "s"), _positive(place, "error", error, "1")
    step, smoothing = _positive(place, "step", step, "s"), _positive(place, "smoothing", smoothing, "m s-1")
    sampling = _positive(place, "sampling", sampling, "s")
    if duration < np.finfo(float).tiny:  # the clock takes it for zero
        raise place.at("duration").error(f"{duration:g} s is no time; give a longer one")
    if method == "diffrax" and "rock" in point.machine.modes:
        raise place.at("method").error('"diffrax" knows no rock that yields; choose from located, smoothed')
    told = _teller(duration) if progress and sys.stderr.isatty() else None
    with precision("float64"):
        machine = point.machine
        p = {name: jnp.full(1, value) for name, value in point.parameters.items()}
        refusal = machine.refused(p)
        if refusal is not None and bool(refusal[1][0]):
            raise place.error(f"the point cannot be run: {refusal[0].replace('-', ' ')}")
        if method == "located" and "gamma" in p and bool(unresolved(point.parameters, "float64")):
            advice = "give a smaller k0, c0, c2 or gamma, or a greater beta"
            raise place.error(f"the point cannot be run: too stiff, so that nothing moves in a step; {advice}")
        p = dict(machine.constants(p))
        times = _times(place, machine, p, duration, sampling)
        state = machine.start(p, point.start, (1,))
        run = RunSettings(
            method="located" if method == "located" else "smoothed", error=error, step=step, smoothing=smoothing
        )
        accuracy = accuracy_for(run, machine)
        most_steps = check_size(place, machine, p, duration, accuracy, method, len(times))
        happened, hole = {}, {}
        if method == "diffrax":
            states, modes, steps = _adaptive(
                machine, p, state, times, accuracy.smoothing, solver or "Tsit5", error, accuracy.step
            )
        else:
            stepper = Located() if method == "located" else Smoothed()
            taken = record(machine, stepper, p, state, accuracy.settings(), jnp.asarray(duration), told, most_steps)
            states, modes, step_of = sample(taken, times)
            steps = len(taken.dt)
            hole = holes(machine, p, taken, states, modes, step_of)
            when, kinds = events(machine, p, taken)
            happened = {"event_time": when, "event_kind": kinds}
        found = forces(machine, p, states, modes, None if method == "located" else accuracy.smoothing)
    solver_text = {"method": method, "steps": int(steps), **accuracy.described()}
    if method == "diffrax":
        solver_text["solver"] = type(solver_named(solver or "Tsit5")).__name__
    return trajectory_dataset(point, times, states, modes, found | hole, happened, solver_text)


def _positive(place: Place, name: str, value, unit: str):
    """A setting as a float above zero; None where it is not given."""
    return None if value is None else quantity(place.at(name), value, positive(name, 1.0, unit, name, name))


def _times(place: Place, machine, p, duration: float, sampling: float | None) -> np.ndarray:
    """Times [s] of the samples, evenly from 0 to the end."""
    if sampling is None:
        sampling = 1e-3
        if hasattr(machine, "contact_time"):
            sampling = min(sampling, float(machine.contact_time(p)[0]) / 20)
        if "rock" in machine.modes:
            sampling = min(sampling, 0.2 * float(jnp.sqrt(p["m1"] / p["k3"])[0]))
        sampling = min(max(sampling, duration / MOST_SAMPLES), duration)
    intervals = duration / sampling
    if not 0.5 < intervals <= MOST_SAMPLES:
        raise place.at("sampling").error(
            f"{sampling:g} s gives {intervals:.7g} samples in {duration:g} s; between 1 and {MOST_SAMPLES} are needed, "
            f"so {duration / MOST_SAMPLES:.3g} to {duration:g} s"
        )
    count = round(intervals)
    return np.arange(count + 1) * (duration / count)


def _adaptive(machine, p, state, times, width, solver, error, step):
    scalars = {name: value[0] for name, value in p.items()}
    start = tuple(y[0] for y in state)
    states, steps = adaptive_trajectory(
        machine, scalars, start, jnp.asarray(times), width, solver_named(solver), 1e-3 * error, step
    )
    modes = machine.smoothed_mode(scalars, machine.mode_at(scalars, states), states, 3 * width)
    return np.stack([np.asarray(y) for y in states]), np.stack([np.asarray(m) for m in modes]), int(steps)


def _teller(duration: float):
    def told(t: float) -> None:
        print(
            f"\r{min(t, duration):.1f} of {duration:g} s",
            end="\n" if t >= duration else "",
            file=sys.stderr,
            flush=True,
        )

    return told
