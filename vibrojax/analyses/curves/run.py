"""Two-parameter continuation of special points: `curves`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.analyses.continuation.problem import FAMILY_ACCURACY
from vibrojax.analyses.curves.branching import condition_at, with_branches, without_duplicates
from vibrojax.analyses.curves.dataset import curves_dataset
from vibrojax.analyses.curves.event_map import conditions_of
from vibrojax.analyses.curves.extended import EVENTS, CurveProblem
from vibrojax.analyses.curves.following import follow_curves
from vibrojax.analyses.curves.spec import CurvesSpec, read_curves
from vibrojax.io.branches import branches, kind_names, places
from vibrojax.io.variables import orbit_name
from vibrojax.models.scenes import Scene
from vibrojax.periodic.newton import MIN_RELATIVE_SWING
from vibrojax.periodic.return_map import MOST_STEPS, Segments
from vibrojax.progress import Progress

UNITS_PER_SPAN = 8
"""Number of units of a scaled parameter between its bounds."""


def curves(
    family: xr.Dataset,
    *,
    by: str,
    span: tuple[float, float],
    special: int | Sequence[int] | None = None,
    at: Mapping[str, float] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Continue the special points of families of orbits in a second parameter, as curves in the plane of both.

    Each fold, period doubling, torus, grazing, stick and Hopf point is continued both ways, until a parameter reaches a
    bound. The family's parameter keeps the bounds that it has in the family. Points of codimension two on the curves
    are located and named.

    **Arguments:**

    - `family`: result of `follow`.
    - `by`: second parameter; `span`: its lower and upper bound, which enclose its value in the family.
    - `special`: index of one special point of the family, or several; by default all that can be continued.
    - `at`: either parameter with a value, such as `{"beta": 0.5}`. The points at which curves pass this value are
      located like special points.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `point`, in order along each curve: `point_curve`, the two parameters, `period` [s] (the mean time between
      section crossings), `cycles`, the state at the section (`orbit_x1` and so on), and the multipliers.
    - Along `curve`: `kind`, `special` (the index in the family), and `curve_note` on the ends of the curve.
    - Along `codim2`: `codim2_kind`, such as cusp or grazing-fold, `codim2_curve`, and `codim2_NAME` for both
      parameters.
    - With `at`, along `crossing`: `crossing_curve`, and `crossing_NAME` for both parameters.

    **Raises:** `InputError` for an invalid name or value.

    **Example:**

    >>> point = dict(start="stuck", beta=0.4, delta=0.005, cycles=2)
    >>> fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.3), **point, progress=False)
    >>> ds = vj.curves(fam, by="beta", span=(0.38, 0.42), special=0, at={"beta": 0.41}, progress=False)
    >>> ds.crossing_gamma.values.round(8).tolist()
    [1.16457112]
    """
    return continue_curves(read_curves(family, by, span, special, at), progress)


def continue_curves(spec: CurvesSpec, progress: bool = True) -> xr.Dataset:
    """Return the curves of a specification, as `curves` does."""
    problem, unknowns = problem_of(spec)
    with Progress(2 * len(unknowns), "ends of curves", progress, pace=False) as bar:
        continued = follow_curves(problem, unknowns, bar.reach)
        bar.reach(2 * len(unknowns))
    for curve, special in zip(continued, spec.special, strict=True):
        curve.special = special
    problem, continued = with_branches(problem, without_duplicates(problem, continued))
    return curves_dataset(spec, problem, continued)


def problem_of(spec: CurvesSpec) -> tuple[CurveProblem, list[np.ndarray]]:
    """Return the equations of the curves, and the unknowns at the special points."""
    bounds = {spec.along: spec.first_span, spec.by: spec.span}
    kinds = np.array(kind_names(spec.family))[spec.special]
    return problem_through(spec.scene, bounds, spec.parameters, kinds, [_orbit_at(spec, k) for k in spec.special])


def problem_through(
    scene: Scene[Any],
    bounds: Mapping[str, tuple[float, float]],
    parameters: Mapping[str, np.ndarray],
    kinds: np.ndarray,
    orbits: list[tuple[int, Float[np.ndarray, " states"]]],
) -> tuple[CurveProblem, list[np.ndarray]]:
    """Return the equations of curves through orbits, and the unknowns at these orbits.

    **Arguments:** `bounds`: lower and upper bounds of the first and of the second parameter, by name; `parameters`: all
    parameters of each orbit, by name; `kinds`: kind of each curve; `orbits`: for each curve the number of section
    crossings and the state at the section.
    """
    scene, count = scene.driving_part(), len(orbits)
    (first, (low, high)), (second, (bottom, top)) = bounds.items()
    parameters = {name: parameters[name] for name in scene.parameters()}
    # The program of the curves serves here, too: another one would have to be compiled.
    go = Segments(scene, (first, second), FAMILY_ACCURACY)
    states, scales, most_steps = _states(go, parameters, orbits, kinds != "hopf")
    none = np.zeros((count, len(conditions_of(scene))))
    problem = CurveProblem(
        scene=scene,
        along=second,
        parameters=parameters,
        scales=scales,
        unit=np.full(count, (top - bottom) / UNITS_PER_SPAN),
        first=np.full(count, bottom),
        last=np.full(count, top),
        most_steps=most_steps,
        other=first,
        other_unit=np.full(count, (high - low) / UNITS_PER_SPAN),
        other_first=np.full(count, low),
        other_last=np.full(count, high),
        kinds=kinds,
        chosen=none,
    )
    unknowns = []
    for k in range(count):
        values = np.array([[parameters[first][k], parameters[second][k]]])
        unknowns.append(problem.point(np.array([k]), states[k][None], values)[0])
        if kinds[k] in EVENTS:
            none[k] = condition_at(problem, k, unknowns[k])
    return problem, unknowns


def _orbit_at(spec: CurvesSpec, index: int) -> tuple[int, Float[np.ndarray, " states"]]:
    """Return the number of section crossings, and the state at the section, at a special point of the family."""
    family = spec.family
    for branch in branches(family):
        if index in branch.special:
            point = int(places(family, branch)[list(branch.special).index(index)])
            names = map(orbit_name, spec.scene.driving_part().return_states)
            return int(family["cycles"].values[point]), np.array([float(family[name].values[point]) for name in names])
    raise AssertionError(index)


def _states(
    go: Segments, parameters: Mapping[str, np.ndarray], orbits: list[tuple[int, np.ndarray]], moves: np.ndarray
) -> tuple[list[Float[np.ndarray, "cycles states"]], Float[np.ndarray, "curves states"], float]:
    """Return the states at all section crossings of orbits, the scales of states, and a limit of steps.

    `moves`: mask of the orbits with an amplitude; the others do not return to the section.
    """
    state = np.array([begin for _, begin in orbits]).T
    cycles, lanes = np.array([count for count, _ in orbits]), np.flatnonzero(moves)
    own = {name: x[lanes] for name, x in parameters.items()}
    returns, least, greatest, steps = [state], state.copy(), state.copy(), 0.0
    for k in range(int(cycles[lanes].max(initial=0))):
        mapped, active = go(own, returns[-1][:, lanes]), cycles[lanes] > k
        least[:, lanes[active]] = np.fmin(least[:, lanes], mapped.seen.least)[:, active]
        greatest[:, lanes[active]] = np.fmax(greatest[:, lanes], mapped.seen.greatest)[:, active]
        steps = max(steps, float(mapped.seen.steps[active].max()))
        returns.append(state.copy())
        returns[-1][:, lanes] = mapped.state
    swing = np.maximum((greatest - least) / 2, MIN_RELATIVE_SWING * np.maximum(greatest, -least))
    scales = np.where((swing > 0) & moves, swing, 1.0).T
    states = [np.stack([state[:, k] for state in returns[: cycles[k]]]) for k in range(len(orbits))]
    return states, scales, 8 * steps or float(MOST_STEPS)
