"""The located stepper: Taylor steps within a mode that end on the switching surface, found on the step's polynomial.

Each lane has its own clock and step. The solution of a mode's equations is expanded in a Taylor series
([vibrojax.stepping.series][]); the first surface that the polynomial crosses ends the step exactly there, the state is
put on the surface and the mode changes. Steps are fixed fractions of the mode's own time scale, shortened where the
last coefficients say that the series has not converged (Jorba and Zou 2005, section 3).
"""

from dataclasses import dataclass
from functools import reduce

import jax.numpy as jnp
from jax import lax

from vibrojax.stepping._keep import keep
from vibrojax.stepping._landing import land
from vibrojax.stepping._rough_root import rough_root
from vibrojax.stepping._step import Lane, Step, taken, trial_step
from vibrojax.stepping.series import expand


@dataclass(frozen=True)
class Located:
    """Settings of the located stepper (static).

    - `order`: order of the Taylor series.
    """

    order: int = 10

    def step(self, scene, p, lane: Lane, settings, end, moving, marked=True) -> tuple[Lane, Step]:
        """One step of every lane.

        **Arguments:**

        - `settings`: `stride`, the step in units of 1/rate of the mode; `tolerance`, the relative size of the last
          term that shortens it; `step`, the longest step [s]. Arrays or floats: changing them compiles nothing.
        - `end`: time [s] at which lanes stop.
        - `moving`: booleans (lanes,); the others stand still.
        - `marked`: whether it also ends on markers (static).

        **Returns:** the lane after it, and the step.
        """
        h = trial_step(lane, settings["stride"] / scene.rate(p, lane.mode), settings["step"], end, moving)
        series = expand(lambda y: scene.field(p, lane.mode, y), lane.state, h, self.order)
        orders = range(self.order + 1)
        polynomials = tuple([one.array(k, h) for k in orders] for one in series)

        def functions_at(state):
            return (*scene.surfaces(p, lane.mode, state), *(scene.markers(p, state) if marked else ()))

        functions = [[one.array(k, h) for k in orders] for one in functions_at(series)]
        velocities = [polynomials[i] for i in scene.velocities]
        speed = p["speed_scale"]
        rest = keep(_at_rest(velocities, speed)) if scene.autonomous else jnp.zeros_like(moving)
        reach = jnp.where(rest, 1.0, _converged(velocities, speed, settings["tolerance"]))
        in_sight = scene.in_sight(p, lane.mode, polynomials)
        reach = keep(lax.stop_gradient(reach if in_sight is None else jnp.minimum(reach, in_sight)))
        landing = land(functions_at, scene, p, lane.mode, polynomials, functions, h, reach, moving & ~rest)
        h = jnp.where(moving & rest, lane.clock.until(end), h)
        return taken(scene, p, lane, polynomials, h, landing)


def _converged(velocities, scale, tolerance):
    """The part of the step, at most 1, over which the last two terms of the series stay under tolerance scale."""
    order = len(velocities[0]) - 1
    last = reduce(jnp.maximum, [jnp.abs(c) for series in velocities for c in series[-2:]])
    return jnp.minimum(rough_root(tolerance * scale / last, order - 1), 1.0)


def _at_rest(velocities, scale):
    """Where nothing moves but by rounding: the rest of the run is one step, however stiff the contact it rests on."""
    noise = 512 * jnp.finfo(scale.dtype).eps
    return reduce(jnp.maximum, [jnp.abs(c) for series in velocities for c in series]) <= noise * scale
