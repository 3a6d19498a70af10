"""Continuation of families of periodic orbits along one parameter: `follow`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import Place, shown
from vibrojax.io.variables import REGIMES
from vibrojax.maps.machines import read_machines, several_and_single
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.equilibria import EquilibriumContinuation
from vibrojax.periodic.families import FamilyContinuation, in_order
from vibrojax.periodic.flow_map import moving_names
from vibrojax.periodic.orbit_stages import why_no_orbit
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.periodic.problem import Problem
from vibrojax.periodic.segments import Mark
from vibrojax.periodic.timed_families import TimedContinuation
from vibrojax.periodic.timed_problem import TimedProblem, has_free_phase
from vibrojax.periodic.timed_sections import at_section
from vibrojax.periodic.timed_starts import free_problem
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.physics.parameters import FREQUENCIES, REPLACED, ROTATION, resolved
from vibrojax.scenes import Scene
from vibrojax.settings.names import Names, read_names
from vibrojax.settings.values import count, warn_if_far
from vibrojax.studies.family_begin import (
    GivenOrbit,
    HopfPoint,
    around_hopf,
    equilibria,
    family_arguments,
    given_orbit,
    read_hopf,
    read_orbit,
    returning_orbit,
    section_problem,
    traced_orbit,
)
from vibrojax.studies.family_dataset import families_dataset

TRACED_PERIODS = 2.5
"""Duration of the motion in which an orbit that is given is traced to the section, in its periods."""

SAME_HOPF, SAME_CENTRE = 1e-6, 1e-3
"""Differences of the parameter, relative to its span, and of the states, relative to their scales, up to which two Hopf
points are the same."""


def follow(
    scene: str | Scene[Any],
    *,
    along: str | None = None,
    at: float | None = None,
    span: tuple[float, float] | None = None,
    start: str | Sequence[float] | None = None,
    orbit: Mapping[str, Any] | None = None,
    from_hopf: xr.Dataset | str | None = None,
    settle: float | None = None,
    observe: float | None = None,
    cycles: int = MOST_CYCLES,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Continue a family of stable and unstable periodic orbits along one parameter, and locate its special points.

        fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.6), start="stuck", beta=0.4)

    The family begins with the orbit on which the motion at `along` = `at` settles, with an `orbit` that is given, or at
    the hopf points of a family of equilibria. If the motion settles at an equilibrium, the family is one of equilibria.
    Pseudo-arclength continuation follows the family in both directions. It passes folds, and corners where an impact or
    a stick phase begins or vanishes. At period doublings it also follows the branches with twice the period.
    Changes in the order of events are handled automatically.

    **Arguments:**

    - `scene`: name of a scene, or a scene; `parameters`: any of its parameters (SI), as in `simulate`. One or several
      may be sequences of the same length; then one family per element is continued, along the dimension `family`.
    - `along`: name of the continuation parameter; `at`: its value at the first orbit; `span`: its lower and upper
      bound, which enclose `at`.
    - `start`: initial condition of the motion that settles on the first orbit, by default the scene's first.
    - `orbit`: `{"states": [...], "period": ...}`, an orbit at `at`, stable or not: states on it, ordered as in `start`
      (of a forced system at the beginning of a forcing period), and its period [s]. Newton's method corrects them.
    - `from_hopf`: a family of equilibria, or its file. One branch begins at each of its hopf points, if no other branch
      has led there. The parameters are those of the family, `along` and `span` as well, unless they are given; `at` is
      not needed.
    - `settle` [s]: settling time; `observe` [s]: duration of the observation, which must cover nine section crossings.
      The defaults are the scene's, as in a sweep.
    - `cycles`: largest number of section crossings per period of doubled branches, 1 to 8; 1 excludes such branches. 0:
      follow equilibria; Newton's method finds the first, stable or not, from the states of `start`.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `point`: the parameter, `branch` (0 is the first branch), `stable`, `multiplier_abs` and `multiplier_arg`
      [rad] along `multiplier`, and `grazing_margin`. `cycles` is the number of section crossings per period of the
      motion, `period` [s] the mean time between crossings, and `impacts` the number of impacts per period of the
      motion. Further variables are the state at the section (`orbit_x1` and so on) and the scene's measures.
    - Along `special`: `special_kind` (fold, period-doubling, torus, grazing, stick, section, hopf, branch-point, end,
      or the name of a system's switch), `special_value` (the parameter's value), `special_branch`, and `special_note`.

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

    A family of equilibria has `cycles` 0, NaN as `period`, the states of the equilibrium in place of those at the
    section, and instead of multipliers the eigenvalues of the field's derivative, `eigenvalue_re` and `eigenvalue_im`
    [1/s] along `eigenvalue`, by falling real part. Its special points are fold, branch-point, hopf and end.

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
    begin = {"start": start, "orbit": orbit, "from_hopf": from_hopf}
    return continue_families(family_spec(scene, along, at, span, begin, settle, observe, cycles, parameters), progress)


@dataclass(frozen=True, eq=False)
class FamilySpec:
    """Families of one scene.

    - `sweep`: sweep with one initial parameter point for each family.
    - `along`: name of the continuation parameter; `low`, `high`: its bounds.
    - `cycles`: largest number of section crossings per period of doubled branches; 0 for equilibria.
    - `orbit`: first orbit, if it is given; `hopf`: points at which branches begin, if they are given.
    """

    sweep: Sweep
    along: str
    low: float
    high: float
    cycles: int
    orbit: GivenOrbit | None = None
    hopf: tuple[HopfPoint, ...] = ()

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        bounds: dict[str, object] = {"along": self.along, "from": self.low, "to": self.high, "cycles": self.cycles}
        if self.orbit is not None:
            bounds |= {"orbit": list(self.orbit.states), "orbit_period": self.orbit.period}
        if self.hopf:
            bounds["from_hopf"] = [x for point in self.hopf for x in (point.value, *point.states)]
        return self.sweep.identity() | bounds


def family_spec(
    scene: object,
    along: object,
    at: object,
    span: object,
    begin: Mapping[str, object],
    settle: object,
    observe: object,
    cycles: object,
    parameters: Mapping[str, object],
) -> FamilySpec:
    """Check the arguments of `follow` and return the specification; `begin`: `start`, `orbit` and `from_hopf`.

    **Raises:** `InputError` with a one-line message at the first invalid argument.
    """
    place, start = Place("follow"), begin.get("start")
    hopf: tuple[HopfPoint, ...] = ()
    ways = [name for name in ("start", "orbit", "from_hopf") if begin.get(name) is not None]
    if len(ways) > 1:
        raise place.at(ways[1]).error(f"and {ways[0]} both say where the family begins; give one of them")
    if ways == ["from_hopf"]:
        family, points = read_hopf(place.at("from_hopf"), begin["from_hopf"])
        hopf, own = tuple(points), family_arguments(place.at("from_hopf"), family, scene, parameters)
        parameters, along = own | dict(parameters), family.attrs["along"] if along is None else along
        if along != family.attrs["along"]:
            raise place.at("along").error(f"{shown(along)} is not {family.attrs['along']}, along which the family is")
        span = family.attrs["span"] if span is None else span
    for name, value in (("along", along), ("at", at), ("span", span)):
        if value is None and not (hopf and name == "at"):
            raise place.error(f"{name} is missing")
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
    if hopf:
        near = SAME_HOPF * (high - low)
        inside = tuple(point for point in hopf if low - near <= point.value <= high + near)
        if not inside:
            known = ", ".join(f"{point.value:.9g}" for point in hopf)
            raise place.at("from_hopf").error(f"the hopf points, at {along} = {known}, are outside the span")
        hopf, at = inside, float(np.clip(inside[0].value, low, high))
    first = names.quantity(place.at("at"), along, at)
    if not low <= first <= high:
        raise place.at("at").error(f"{first:g} is not between from = {low:g} and to = {high:g}")
    warn_if_far(place.at("at"), names.writable[along], first)
    most = count(place.at("cycles"), cycles, 0, MOST_CYCLES)
    has_orbits = most > 0 and bool(names.system.driving_part().return_states)
    run: dict[str, object] = {"orbits": has_orbits, "settle": settle, "observe": observe}
    orbit = read_orbit(place.at("orbit"), names, begin["orbit"]) if ways == ["orbit"] else None
    if orbit is not None:
        start = list(orbit.states)
        run |= {"settle": 0.0, "observe": TRACED_PERIODS * orbit.period, "keep_returns": MOST_CYCLES}
    if ways in (["orbit"], ["from_hopf"]):
        if most == 0:
            raise place.at("cycles").error(f"0 stands for equilibria, which {ways[0]} does not begin; give start")
        if several_and_single(parameters)[0]:
            raise place.at(ways[0]).error("begins one family; give single values")
    machines = read_machines(place, scene, parameters, start, run, {along: first})
    return FamilySpec(machines.sweep, along, low, high, most, orbit, hopf)


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
    section = section_problem(spec.sweep, spec.along, spec.low, spec.high)
    if spec.cycles == 0:
        return _equilibria(spec, section, None)
    if spec.hopf:
        return _from_hopf(spec, section)
    if spec.orbit is not None and has_free_phase(section.scene):
        return _free(spec, section, np.zeros(1, int), *given_orbit(section, spec.orbit))
    if not section.scene.return_states:
        place = Place("follow").at("cycles")
        raise place.error("a motion of one state has no orbits; for its equilibria give cycles=0")
    dataset = run_sweep(spec.sweep, progress=progress)
    if spec.orbit is None and _stands(section.scene, dataset):
        return _equilibria(spec, section, spec.sweep.run.settle)
    problem, families, first = problem_of(spec, dataset)
    if has_free_phase(problem.scene):
        return _free(spec, problem, families, *free_problem(problem, families, first))
    segments = FamilyContinuation(problem, cycles=spec.cycles)(families, first)
    return families_dataset(spec.sweep, problem, *in_order(segments))


def _stands(scene: Scene[Any], dataset: xr.Dataset) -> bool:
    """Return whether all motions have settled at equilibria, from which families of equilibria are followed."""
    return bool(scene.autonomous) and bool((dataset["regime"] == REGIMES.index("equilibrium")).all())


def _equilibria(spec: FamilySpec, section: Problem, settle: float | None) -> xr.Dataset:
    problem, families, first = equilibria(section, spec.sweep, settle)
    return families_dataset(spec.sweep, problem, *in_order(EquilibriumContinuation(problem)(families, first)))


def _free(
    spec: FamilySpec, section: Problem, families: np.ndarray, timed: TimedProblem, first: list[np.ndarray]
) -> xr.Dataset:
    marks = in_order(TimedContinuation(timed, cycles=spec.cycles)(families, first))
    return families_dataset(spec.sweep, section, *(at_section(timed, section, part) for part in marks))


def _from_hopf(spec: FamilySpec, section: Problem) -> xr.Dataset:
    """Return the families from all Hopf points to which no branch from an earlier one has led."""
    points: list[Mark] = []
    special: list[Mark] = []
    branches, reached = 0, list[tuple[float, np.ndarray]]()
    names = moving_names(section.scene)
    rows = [names.index(name) for name in section.scene.return_states]
    for point in spec.hopf:
        near = (centre for value, centre in reached if abs(value - point.value) < SAME_HOPF * (spec.high - spec.low))
        states, scales = np.array(point.states)[rows], np.array(point.scales)[rows]
        if any((np.abs(centre - states) < SAME_CENTRE * scales).all() for centre in near):
            continue
        timed, first = around_hopf(section, point)
        family = np.zeros(1, int)
        if has_free_phase(section.scene):
            marks = in_order(TimedContinuation(timed, cycles=spec.cycles)(family, first))
            marks = at_section(timed, section, marks[0]), at_section(timed, section, marks[1])
        else:
            problem, _, [u] = _through(spec, section, [returning_orbit(section, timed, first[0])])
            # The dataset has the scales of one problem.
            section = problem if not points else replace(problem, scales=section.scales)
            u = section.unknowns(family, problem.states(family, u[None]), problem.values(family, u[None]))[0]
            marks = in_order(FamilyContinuation(section, cycles=spec.cycles)(family, [u]))
        for orbit in (mark.orbit for mark in marks[1] if mark.kind == "hopf"):
            value, centre = section.values(orbit.family, orbit.u)[0, 0], section.states(orbit.family, orbit.u)[0, 0]
            reached.append((float(value), centre))
        for found, own in zip((points, special), marks, strict=True):
            found += [mark._replace(branch=mark.branch + branches) for mark in own]
        branches = 1 + max(mark.branch for mark in points)
    return families_dataset(spec.sweep, section, points, special)


def problem_of(spec: FamilySpec, dataset: xr.Dataset) -> tuple[Problem, np.ndarray, list[np.ndarray]]:
    """Return the equations, the indices of families with an initial orbit, and the unknowns of these orbits.

    **Arguments:** `dataset`: result of the specified sweep.

    **Raises:** `InputError` if no family has an initial orbit.
    """
    sweep, along = spec.sweep, spec.along
    dataset = dataset.isel(start=0) if "start" in dataset.dims else dataset
    section = section_problem(sweep, along, spec.low, spec.high)
    if spec.orbit is not None:
        known = [traced_orbit(section, spec.orbit, dataset.isel(point=0))]
    else:
        known = orbits_of(section.scene, dataset, section.parameters)
    families = np.sort(np.concatenate([orbits.lane for orbits in known] or [np.zeros(0, int)]))
    if not len(families):
        lane = dataset.isel(point=0)
        why = why_no_orbit(lane)
        instead = "begin where it does" if why.startswith("does not repeat") else "begin elsewhere"
        raise Place("follow").at("at").error(f"the motion at {along} = {float(lane[along]):g} {why}; {instead}")
    return _through(spec, section, known)


def _through(spec: FamilySpec, section: Problem, known: list[Orbits]) -> tuple[Problem, np.ndarray, list[np.ndarray]]:
    """Return the equations, the indices of the families of orbits, and the unknowns of these orbits."""
    along = spec.along
    families = np.sort(np.concatenate([orbits.lane for orbits in known]))
    scales = section.scales.copy()
    for orbits in known:
        scales[orbits.lane] = orbits.scales
    problem = replace(section, scales=scales, most_steps=max(orbits.most_steps for orbits in known))
    unknowns: dict[int, np.ndarray] = {}
    for orbits in known:
        own = problem.unknowns(orbits.lane, orbits.states, orbits.parameters[along][:, None])
        unknowns |= dict(zip(orbits.lane.tolist(), own, strict=True))
    return problem, families, [unknowns[family] for family in families.tolist()]
