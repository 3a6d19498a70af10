"""The adaptive backend: any diffrax solver on the smoothed equations."""

import diffrax
import jax.numpy as jnp

from vibrojax.errors import InputError

MOST_STEPS = 10_000_000


def solver_named(solver) -> diffrax.AbstractSolver:
    """A diffrax solver, or the one of that name, such as "Tsit5"; raises `InputError` where there is none."""
    if isinstance(solver, diffrax.AbstractSolver):
        return solver
    kind = getattr(diffrax, str(solver), None)
    if isinstance(kind, type) and issubclass(kind, diffrax.AbstractSolver):
        try:
            return kind()
        except TypeError:
            pass
    raise InputError(f'solver: {solver!r} is no diffrax solver; give one, or its name, like "Tsit5" or "Kvaerno5"')


def adaptive_trajectory(scene, p, state, times, width, solver, tolerance, step=None):
    """States at `times` by a diffrax solver: with adaptive steps, or with fixed ones where it has no error estimate.

    **Arguments:**

    - `p`: the scene's constants, scalars; `state`: tuple of scalars at t = 0; `times` (samples,) [s], rising.
    - `width` [m/s]: of the friction switch; the contact is one-sided at every evaluation.
    - `solver`: a diffrax solver; `tolerance`: relative, and absolute in m and m/s; `step` [s]: of fixed steps.

    **Returns:** tuple of arrays (samples,), and the number of steps taken.
    """

    def rates(t, y, args):
        return scene.smoothed_field(p, scene.mode_at(p, y), y, width)

    adapts = isinstance(solver, diffrax.AbstractAdaptiveSolver)
    controller = diffrax.PIDController(rtol=tolerance, atol=tolerance) if adapts else diffrax.ConstantStepSize()
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        solver,
        t0=jnp.zeros_like(times[-1]),
        t1=times[-1],
        dt0=None if adapts else step,
        y0=state,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=controller,
        max_steps=MOST_STEPS,
        throw=False,
    )
    if solution.result != diffrax.RESULTS.successful:
        advice = "give a shorter duration, a wider smoothing, or another solver"
        raise InputError(f"solver: {type(solver).__name__} did not reach the end in {MOST_STEPS} steps; {advice}")
    return solution.ys, solution.stats["num_steps"]
