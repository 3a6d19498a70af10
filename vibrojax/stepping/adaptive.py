"""The adaptive backend: any diffrax solver on the smoothed equations."""

from typing import Any

import diffrax

from vibrojax.errors import InputError
from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array
from vibrojax.scenes.declared import Values
from vibrojax.scenes.scene import Scene

MOST_STEPS = 10_000_000
"""Greatest number of steps of one trajectory, so that a stalled solver stops."""


def solver_named(solver: object) -> diffrax.AbstractSolver:
    """Return the diffrax solver with this name, such as "Tsit5"; a solver object is returned unchanged.

    Raises `InputError` if the name is unknown.
    """
    if isinstance(solver, diffrax.AbstractSolver):
        return solver
    kind = getattr(diffrax, str(solver), None)
    if isinstance(kind, type) and issubclass(kind, diffrax.AbstractSolver):
        try:
            return kind()
        except TypeError:
            pass
    raise InputError(f'solver: {solver!r} is no diffrax solver; give one, or its name, like "Tsit5" or "Kvaerno5"')


def adaptive_trajectory(
    scene: Scene[Any],
    constants: Any,
    state: Values,
    times: Array,
    width: Any,
    solver: diffrax.AbstractSolver,
    tolerance: Any,
    step: Any = None,
) -> tuple[Values, Any]:
    """Return the states at `times`, computed by a diffrax solver.

    **Arguments:**

    - `constants`: the scene's constants, scalars; `state`: tuple of scalars, the state at t = 0.
    - `times`: increasing sample times (samples,) [s].
    - `width`: width of the friction switch [m/s]. The contact is not smoothed: it is one-sided at every evaluation.
    - `solver`: a diffrax solver. The steps are fixed if it is not an adaptive solver.
    - `tolerance`: relative tolerance, also used as absolute tolerance in m and m/s; `step`: length of fixed steps [s].

    **Returns:** tuple of arrays (samples,), one per state, and the number of steps taken.
    """
    saved = diffrax.SaveAt(ts=jnp.asarray(times))
    tolerance = tolerance if isinstance(solver, diffrax.AbstractAdaptiveSolver) else None
    solution = smoothed_solution(scene, constants, state, times[-1], width, solver, tolerance, step, saved, MOST_STEPS)
    if solution.result != diffrax.RESULTS.successful:
        advice = "give a shorter duration, a wider smoothing, or another solver"
        raise InputError(f"solver: {type(solver).__name__} did not reach the end in {MOST_STEPS} steps; {advice}")
    states: Any = solution.ys
    return states, solution.stats["num_steps"]


def smoothed_solution(
    scene: Scene[Any],
    constants: Any,
    state: Values,
    end: Any,
    width: Any,
    solver: diffrax.AbstractSolver,
    tolerance: Any,
    step: Any,
    saved: diffrax.SaveAt,
    most_steps: int,
) -> diffrax.Solution:
    """Return the diffrax solution of a smoothed motion from t = 0 to `end` [s]; works under `jit` and `vmap`.

    The arguments not listed are those of [vibrojax.stepping.adaptive.adaptive_trajectory][].

    **Arguments:**

    - `tolerance`: relative and absolute tolerance of adaptive steps; None for fixed steps of `step` [s].
    - `saved`: the times and states to save; `most_steps`: greatest number of steps (static).
    """

    def rates(t: Any, y: Values, args: Any) -> Values:
        return scene.smoothed_field(constants, scene.mode_at(constants, y), y, width)

    fixed = tolerance is None
    return diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        solver,
        t0=jnp.zeros_like(end),
        t1=end,
        dt0=step if fixed else None,
        y0=state,
        saveat=saved,
        stepsize_controller=diffrax.ConstantStepSize() if fixed else diffrax.PIDController(tolerance, tolerance),
        max_steps=most_steps,
        throw=False,
    )
