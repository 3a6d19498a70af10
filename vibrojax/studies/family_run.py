"""Continuation of families of periodic orbits along one parameter: `follow`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import Place, shown
from vibrojax.maps.machines import read_machines, several_and_single
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep, resolved
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.families import FamilyContinuation, in_order
from vibrojax.periodic.orbit_stages import why_no_orbit
from vibrojax.periodic.orbits import orbits_of
from vibrojax.periodic.problem import UNITS_PER_SPAN, Problem
from vibrojax.periodic.timed_families import TimedContinuation
from vibrojax.periodic.timed_problem import free_problem, has_free_phase
from vibrojax.periodic.timed_sections import at_section
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.physics.parameters import FREQUENCIES, REPLACED, ROTATION
from vibrojax.scenes import Scene
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.values import count, warn_if_far
from vibrojax.studies.family_dataset import families_dataset


def follow(
    scene: str | Scene[Any],
    *,
    along: str,
    at: float,
    span: tuple[float, float],
    start: str | Sequence[float] | None = None,
    settle: float | None = None,
    observe: float | None = None,
    cycles: int = MOST_CYCLES,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Continue a family of stable and unstable periodic orbits along one parameter, and locate its special points.

        fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.6), start="stuck", beta=0.4)

    The family begins with the orbit on which the motion at `along` = `at` settles. Pseudo-arclength continuation
    follows the family in both directions. It passes folds, and corners where an impact or a stick phase begins or
    vanishes. At period doublings it also follows the branches with twice the period. Changes in the order of events are
    handled automatically.

    **Arguments:**

    - `scene`: name of a scene, or a scene; `parameters`: any of its parameters (SI), as in `simulate`. One or several
      may be sequences of the same length; then one family per element is continued, along the dimension `family`.
    - `along`: name of the continuation parameter; `at`: its value at the first orbit; `span`: its lower and upper
      bound, which enclose `at`.
    - `start`: initial condition of the motion that settles on the first orbit, by default the scene's first.
    - `settle` [s]: settling time; `observe` [s]: duration of the observation, which must cover nine section crossings.
      The defaults are the scene's, as in a sweep.
    - `cycles`: largest number of section crossings per period of doubled branches, 1 to 8; 1 excludes such branches.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `point`: the parameter, `branch` (0 is the first branch), `stable`, `multiplier_abs` and `multiplier_arg`
      [rad] along `multiplier`, and `grazing_margin`. `cycles` is the number of section crossings per period of the
      motion, `period` [s] the mean time between crossings, and `impacts` the number of impacts per period of the
      motion. Further variables are the state at the section (`orbit_x1` and so on) and the scene's measures.
    - Along `special`: `special_kind` (fold, period-doubling, torus, grazing, stick, section, hopf,
      branch-point, end), `special_value` (the parameter's value), `special_branch`, and `special_note`.

    At a *grazing* point, an impact or another event that is not a stick begins or vanishes. For other events than
    impacts, the note contains the name of the mode that changes, for example where rock begins to yield. Multipliers at
    a special point are those on the side from which the point was reached, or of the side without the impact where only
    that side has orbits next to it; next to a grazing impact they are valid over a very small distance only. At a
    *hopf* point the amplitude is zero: the branch ends at an equilibrium, whose linear stability locates the point. A
    doubled branch that connects two period doublings is listed once.

    Families of autonomous systems without events do not depend on the section: they are solved over parts of the period
    (multiple shooting), with a phase condition that moves along. At a *branch-point* two families cross; the other one
    is followed in both directions, as the next `branch`. Mirror images of orbits are orbits of their own. An orbit that
    does not cross the section has NaN for its state there.

    **Raises:** `InputError` for invalid names or values, or if the motion does not settle on a periodic orbit.

    **Example:**

    >>> point = {"beta": 0.4, "delta": 0.005, "start": "stuck"}
    >>> fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.7, 0.9), **point, progress=False)
    >>> kinds = fam.special_kind.attrs["flag_meanings"].split()
    >>> [(kinds[int(kind)], round(float(value), 3)) for kind, value in zip(fam.special_kind, fam.special_value)]
    [('end', 0.7), ('end', 0.9)]
    >>> bool((fam.stable == 1).all())
    True
    """
    return continue_families(family_spec(scene, along, at, span, start, settle, observe, cycles, parameters), progress)


@dataclass(frozen=True, eq=False)
class FamilySpec:
    """Families of one scene.

    - `sweep`: sweep with one initial parameter point for each family.
    - `along`: name of the continuation parameter; `low`, `high`: its bounds.
    - `cycles`: largest number of section crossings per period of doubled branches.
    """

    sweep: Sweep
    along: str
    low: float
    high: float
    cycles: int

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds = {"along": self.along, "from": self.low, "to": self.high, "cycles": self.cycles}
        return self.sweep.identity() | bounds


def family_spec(
    scene: object,
    along: object,
    at: object,
    span: object,
    start: object,
    settle: object,
    observe: object,
    cycles: object,
    parameters: Mapping[str, object],
) -> FamilySpec:
    """Check the arguments of `follow` and return the specification.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place = Place("follow")
    fixed = several_and_single(parameters)[1]
    names = read_names(place.at("scene"), scene, dict(fixed), place)
    if not isinstance(along, str) or along not in names.parameters:
        instead = suggest_parameter(str(along), names.parameters)
        if along in names.writable:  # rpm, bit_radius or a frequency
            given, replaced = "rpm and bit_radius" if along in ROTATION else along, REPLACED[along]
            instead = f"{replaced} follows from {given}: give {replaced}, and follow along {replaced}"
            if along in FREQUENCIES and isinstance(at, (int, float)):
                values = {name: parameter.default for name, parameter in names.parameters.items()}
                values |= {name: x for name, x in fixed.items() if isinstance(x, (int, float))}
                values = resolved(resolved(values) | {along: at})
                instead += f"; {at:g} Hz is {replaced}={values[replaced]:.6g}"
        raise place.at("along").error(f"{shown(along)} is not a parameter of the scene; {instead}")
    if along in parameters:
        hint = f"say where it begins by at={shown(fixed.get(along, 'VALUE'))}"
        raise place.at(along).error(f"is the parameter of the continuation; {hint}")
    for name in (name for name in FREQUENCIES if name in parameters and name not in names.parameters):
        if along in ("m1", "k1"):
            fault = f"fixes {REPLACED[name]} only at one {along}, and {along} varies along the family"
            raise place.at(name).error(f"{fault}; give {REPLACED[name]}")
    low, high = read_span(place, names, along, span)
    begin = names.quantity(place.at("at"), along, at)
    if not low <= begin <= high:
        raise place.at("at").error(f"{begin:g} is not between from = {low:g} and to = {high:g}")
    warn_if_far(place.at("at"), names.writable[along], begin)
    run = {"orbits": True, "settle": settle, "observe": observe}
    machines = read_machines(place, scene, parameters, start, run, {along: begin})
    return FamilySpec(machines.sweep, along, low, high, count(place.at("cycles"), cycles, 1, MOST_CYCLES))


def read_span(place: Place, names: Names, name: str, span: object) -> tuple[float, float]:
    """Return the lower and the upper bound of a parameter, in order."""
    if not isinstance(span, Sequence | np.ndarray) or isinstance(span, str) or len(span) != 2:
        raise place.at("span").error(f"{shown(span)} is not a pair of numbers; give the bounds of {name}")
    low, high = sorted(names.quantity(place.at(end), name, x) for end, x in zip(("from", "to"), span, strict=True))
    if not low < high:
        raise place.at("to").error(f"{high:g} is the same as from; give the two bounds of {name}")
    return low, high


def continue_families(spec: FamilySpec, progress: bool = True) -> xr.Dataset:
    """Return the families of a specification, as `follow` does; raise `InputError` if there is no initial orbit."""
    dataset = run_sweep(spec.sweep, progress=progress)
    problem, families, first = problem_of(spec, dataset)
    if has_free_phase(problem.scene):
        timed, first = free_problem(problem, families, first)
        marks = in_order(TimedContinuation(timed, cycles=spec.cycles)(families, first))
        return families_dataset(spec.sweep, problem, *(at_section(timed, problem, part) for part in marks))
    segments = FamilyContinuation(problem, cycles=spec.cycles)(families, first)
    return families_dataset(spec.sweep, problem, *in_order(segments))


def problem_of(spec: FamilySpec, dataset: xr.Dataset) -> tuple[Problem, np.ndarray, list[np.ndarray]]:
    """Return the equations, the indices of families with an initial orbit, and the unknowns of these orbits.

    **Arguments:** `dataset`: result of the specified sweep.

    **Raises:** `InputError` if no family has an initial orbit.
    """
    sweep, along = spec.sweep, spec.along
    dataset = dataset.isel(start=0) if "start" in dataset.dims else dataset
    system = sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    parameters = {name: values[name].astype(float) for name in system.parameters()}
    known = orbits_of(system, dataset, parameters)
    families = np.sort(np.concatenate([orbits.lane for orbits in known] or [np.zeros(0, int)]))
    if not len(families):
        lane = dataset.isel(point=0)
        why = why_no_orbit(lane)
        instead = "begin where it does" if why.startswith("does not repeat") else "begin elsewhere"
        raise Place("follow").at("at").error(f"the motion at {along} = {float(lane[along]):g} {why}; {instead}")
    scale = np.ones((sweep.lanes, len(system.return_states)))
    for orbits in known:
        scale[orbits.lane] = orbits.scales
    bounds = ((spec.high - spec.low) / UNITS_PER_SPAN, spec.low, spec.high)
    unit, first, last = (np.full((sweep.lanes, 1), x) for x in bounds)
    problem = Problem(
        scene=system,
        along=(along,),
        parameters=parameters,
        scales=scale,
        unit=unit,
        first=first,
        last=last,
        most_steps=max(orbits.most_steps for orbits in known),
    )
    unknowns: dict[int, np.ndarray] = {}
    for orbits in known:
        own = problem.unknowns(orbits.lane, orbits.states, orbits.parameters[along][:, None])
        unknowns |= dict(zip(orbits.lane.tolist(), own, strict=True))
    return problem, families, [unknowns[family] for family in families.tolist()]
