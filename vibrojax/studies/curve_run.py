"""Two-parameter continuation of special points: `curves`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.io.variables import orbit_name
from vibrojax.periodic.curve_branching import condition_at, with_branches, without_duplicates
from vibrojax.periodic.curve_equations import EVENTS, CurveProblem
from vibrojax.periodic.curve_following import follow_curves
from vibrojax.periodic.event_map import conditions_of
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.problem import FAMILY_ACCURACY, UNITS_PER_SPAN
from vibrojax.periodic.return_map import MOST_STEPS, Segments
from vibrojax.pictures.branches import branches, places
from vibrojax.progress import Progress
from vibrojax.scenes import Scene
from vibrojax.studies.curve_dataset import curves_dataset
from vibrojax.studies.curve_spec import SAME_VALUE, CurvesSpec, continued_kinds, read_curves


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
    are located and named. The other curves that begin there are followed, too, up to a limit that notes mention.

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
    - Along `curve`: `kind`, `special` (the index in the family, -1 if the curve begins at a point of codimension two),
      and `curve_note` on that point, on the ends of the curve, and on other special points that it passes.
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
    kinds = np.array(continued_kinds(spec.family))[spec.special]
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
    (first, second), limits = bounds, np.array([*bounds.values()], float)
    parameters = {name: parameters[name] for name in scene.parameters()}
    # The program of the curves serves here, too: another one would have to be compiled.
    go = Segments(scene, (first, second), FAMILY_ACCURACY)
    cycles = np.array([number for number, _ in orbits])
    states, scales, most_steps = [state[None] for _, state in orbits], np.ones((count, len(scene.return_states))), 0.0
    moving = kinds != "hopf"  # an equilibrium does not return to the section
    for repeat in np.unique(cycles[moving]).tolist():
        index = np.flatnonzero(moving & (cycles == repeat))
        own = {name: x[index] for name, x in parameters.items()}
        traced = Orbits.trace(scene, own, np.array([orbits[k][1] for k in index]), repeat, go)
        scales[index], most_steps = traced.scales, max(most_steps, traced.most_steps)
        for k, whole in zip(index.tolist(), traced.states, strict=True):
            states[k] = whole
    none = np.zeros((count, len(conditions_of(scene))))
    problem = CurveProblem(
        scene=scene,
        along=(first, second),
        parameters=parameters,
        scales=scales,
        unit=np.tile(np.diff(limits).T / UNITS_PER_SPAN, (count, 1)),
        first=np.tile(limits[:, 0], (count, 1)),
        last=np.tile(limits[:, 1], (count, 1)),
        most_steps=most_steps or float(MOST_STEPS),
        kinds=kinds,
        chosen=none,
    )
    unknowns = []
    for k in range(count):
        values = np.array([[parameters[first][k], parameters[second][k]]])
        unknowns.append(problem.unknowns(np.array([k]), states[k][None], values)[0])
        if kinds[k] in EVENTS:
            none[k] = condition_at(problem, k, unknowns[k])
    return problem, unknowns


def _orbit_at(spec: CurvesSpec, index: int) -> tuple[int, Float[np.ndarray, " states"]]:
    """Return the number of section crossings, and the state at the section, at a special point of the family."""
    family = spec.family
    for branch in branches(family):
        if index in branch.special:
            point = int(places(family, branch)[list(branch.special).index(index)])
            apart = abs(family[spec.along].values[point] - family["special_value"].values[index])
            if apart > SAME_VALUE * (spec.first_span[1] - spec.first_span[0]):
                raise InputError(f"curves: special: the point of {index} is not in the family; give the whole family")
            names = map(orbit_name, spec.scene.driving_part().return_states)
            return int(family["cycles"].values[point]), np.array([float(family[name].values[point]) for name in names])
    raise AssertionError(index)
