"""Beginnings of families: equilibria, orbits around a Hopf point, and orbits that the user gives."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.compile.xla import precision
from vibrojax.errors import Place, shown
from vibrojax.io.attributes import parameters_of, text_of
from vibrojax.io.dataset import open_dataset
from vibrojax.io.kinds import kind_of
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.equilibria import EquilibriumProblem, equilibrium_near, field_of, scales_at
from vibrojax.periodic.flow_map import Flow, moving_names
from vibrojax.periodic.orbits import Orbits
from vibrojax.periodic.problem import UNITS_PER_SPAN, Problem, towards
from vibrojax.periodic.return_map import MOST_STEPS
from vibrojax.periodic.timed_problem import TimedProblem
from vibrojax.periodic.timed_sections import crossings_of
from vibrojax.periodic.timed_starts import from_equilibrium, larger, through
from vibrojax.scenes import Scene
from vibrojax.settings.names import Names

RETURNING = 4
"""Number of the orbit with which a family begins, among those that grow from a Hopf point and return to the section."""

SAME_PERIOD = 1e-6
"""Largest relative difference between the period of an orbit and that of its description at the section."""

GIVEN_DISTANCE = 0.3
"""Largest scaled distance of the orbit that is found from the one that is given."""


class GivenOrbit(NamedTuple):
    """An orbit near one that begins a family: `states` in the order of a start, and the `period` [s]."""

    states: tuple[float, ...]
    period: float


class HopfPoint(NamedTuple):
    """A Hopf point of a family of equilibria: the parameter's `value`, the `states` there, and their `scales`."""

    value: float
    states: tuple[float, ...]
    scales: tuple[float, ...]


def read_orbit(place: Place, names: Names, orbit: object) -> GivenOrbit:
    """Check the argument `orbit` of `follow`."""
    if not isinstance(orbit, Mapping) or set(orbit) != {"states", "period"}:
        raise place.error(f'{shown(orbit)} is not {{"states": [...], "period": ...}}')
    order, given = list(names.system.start_states), orbit["states"]
    if isinstance(given, Mapping):
        if set(given) != set(order):
            raise place.at("states").error(f"names {', '.join(map(str, given))}; the states are {', '.join(order)}")
        given = [given[name] for name in order]
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray) or len(given) != len(order):
        raise place.at("states").error(f"{shown(given)} is not {len(order)} numbers: {', '.join(order)}")
    numbers = []
    places = [place.at("states").item(k) for k in range(len(order))] + [place.at("period")]
    for where, value in zip(places, [*given, orbit["period"]], strict=True):
        if not isinstance(value, int | float | np.number) or isinstance(value, bool) or not np.isfinite(value):
            raise where.error(f"{shown(value)} is not a finite number")
        numbers.append(float(value))
    if not numbers[-1] > 0:
        raise place.at("period").error(f"{numbers[-1]:g} is not above 0 s")
    return GivenOrbit(tuple(numbers[:-1]), numbers[-1])


def read_hopf(place: Place, family: object) -> tuple[xr.Dataset, list[HopfPoint]]:
    """Check the argument `from_hopf` of `follow`; return the family of equilibria, and its Hopf points."""
    if isinstance(family, str | Path):
        family = open_dataset(Path(family))
    if not isinstance(family, xr.Dataset) or kind_of(family) != "family" or "eigenvalue_re" not in family:
        raise place.error("is not a family of equilibria; give what follow(..., cycles=0) has made")
    if "family" in family.dims:
        raise place.error("holds several families; select one with isel(family=...)")
    along = text_of(family, "along")
    states = [str(name) for name in family.data_vars if str(name).startswith("orbit_")]
    columns = np.column_stack([family[name].values for name in states])
    size = np.maximum(np.abs(columns).max(axis=0), np.ptp(columns, axis=0))
    size = np.where(size > 1e-3 * size.max(), size, size.max() or 1.0)
    kinds = str(family["special_kind"].attrs["flag_meanings"]).split()
    hopf = family["special_kind"].values == kinds.index("hopf") if "hopf" in kinds else np.zeros(0, bool)
    eigenvalues = family["eigenvalue_re"].values + 1j * family["eigenvalue_im"].values
    growth = np.where(eigenvalues.imag > 0, np.abs(eigenvalues.real), np.inf).min(axis=1)
    points, taken = [], np.zeros(len(growth), bool)
    for value, branch in zip(family["special_value"].values[hopf], family["special_branch"].values[hopf], strict=True):
        off = np.where((family["branch"].values == branch) & ~taken, np.abs(family[along].values - value), np.inf)
        # Mirror images have hopf points at the same value.
        nearest = min(np.flatnonzero(off == off.min()).tolist(), key=growth.__getitem__)
        taken[nearest] = True
        points.append(HopfPoint(float(value), tuple(columns[nearest].tolist()), tuple(size.tolist())))
    if not points:
        raise place.error("the family has no hopf point; follow it further")
    return family, points


def family_arguments(place: Place, family: xr.Dataset, scene: object, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `follow` that a family of equilibria fixes: the parameters, `along` and `span`."""
    name = scene if isinstance(scene, str) else getattr(scene, "name", scene)
    if name != text_of(family, "scene"):
        raise place.error(f"is a family of {text_of(family, 'scene')}, not of {name}")
    fixed = dict(parameters_of(family))
    for parameter, value in given.items():
        if parameter in fixed and value != fixed[parameter]:
            raise place.at(parameter).error(f"the family is at {fixed[parameter]:g}, not {value}; leave it out")
    return fixed


def section_problem(sweep: Sweep, along: str, low: float, high: float) -> Problem:
    """Return the equations of orbits by their states at the section, with scales of 1."""
    system = sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    bounds = ((high - low) / UNITS_PER_SPAN, low, high)
    unit, first, last = (np.full((sweep.lanes, 1), x) for x in bounds)
    return Problem(
        scene=system,
        along=(along,),
        parameters={name: values[name].astype(float) for name in system.parameters()},
        scales=np.ones((sweep.lanes, len(system.return_states))),
        unit=unit,
        first=first,
        last=last,
        most_steps=float(MOST_STEPS),
    )


def start_states(scene: Scene[Any], parameters: Mapping[str, float], start: Any) -> np.ndarray:
    """Return the moving states of an initial condition; by default all states are zero."""
    names = moving_names(scene)
    if start is None:
        return np.zeros(len(names))
    with precision("float64"):
        constants = scene.constants({name: np.array([x]) for name, x in parameters.items()})
        whole = dict(zip(scene.state_names, scene.start(constants, start, (1,)), strict=True))
    return np.array([float(np.ravel(whole[name])[0]) for name in names])


def equilibria(
    section: Problem, sweep: Sweep, settle: float | None
) -> tuple[EquilibriumProblem, np.ndarray, list[np.ndarray]]:
    """Return the equations of equilibria, and the unknowns of the first of each family.

    **Arguments:** `settle`: time [s] for which the motion settles first; None: Newton's method begins at the start.

    **Raises:** `InputError` if a scene has no equilibria, or Newton's method finds none.
    """
    place, scene, [along] = Place("follow"), section.scene, section.along
    if not scene.autonomous or not moving_names(scene):
        raise place.at("cycles").error(f"{scene.name} is forced, it has no equilibria; give cycles of 1 and more")
    start = sweep.starts[0] if sweep.starts is not None else None
    flow, found = Flow(scene), []
    for number in range(sweep.lanes):
        parameters = {name: float(x[number]) for name, x in section.parameters.items()}
        guess = start_states(scene, parameters, start)
        if settle:
            own = {name: np.array([x]) for name, x in parameters.items()}
            guess = np.asarray(flow(own, guess[:, None], np.array([settle])).state)[:, 0]
        known = equilibrium_near(scene, parameters, guess)
        if known is None:
            raise place.at("start").error(
                f"Newton's method finds no isolated equilibrium from {guess.tolist()} at {along} = "
                f"{parameters[along]:g}; give states nearer to one (where friction holds a body, none is isolated)"
            )
        bounds = float(section.first[number, 0]), float(section.last[number, 0])
        found.append((parameters[along], *known, scales_at(scene, along, parameters, known[0], bounds)))
    values, states, jacobian, natural = (np.array([x[k] for x in found]) for k in range(4))
    span = section.last[:, 0] - section.first[:, 0]
    own = {**section.parameters, along: values}
    slope = field_of(scene, (along,))(np.column_stack([states, values]), own)[1][..., -1]
    size = np.maximum(np.abs(states), np.abs(np.linalg.solve(jacobian, slope[..., None])[..., 0]) * span[:, None] / 2)
    size = np.maximum(size, natural)
    largest = size.max(axis=1, keepdims=True)
    scales = np.where(size > 1e-3 * largest, size, np.where(largest > 0, largest, 1.0))
    rate = np.abs(jacobian * scales[:, None, :] / scales[:, :, None]).max(axis=(1, 2))
    problem = EquilibriumProblem(
        scene=scene, along=section.along, parameters=section.parameters, scales=scales, unit=section.unit,
        first=section.first, last=section.last, most_steps=section.most_steps, rate=rate,
    )  # fmt: skip
    families = np.arange(sweep.lanes)
    return problem, families, list(problem.unknowns(families, states[:, None], values[:, None]))


def around_hopf(section: Problem, point: HopfPoint) -> tuple[TimedProblem, list[np.ndarray]]:
    """Return the equations and the unknowns of a small orbit near a Hopf point.

    **Raises:** `InputError` if none is found.
    """
    place, [along] = Place("follow").at("from_hopf"), section.along
    parameters = {name: float(x[0]) for name, x in section.parameters.items()} | {along: point.value}
    known = equilibrium_near(section.scene, parameters, np.array(point.states))
    begun = known and from_equilibrium(section, *known, np.array(point.scales), point.value)
    if not begun:
        raise place.error(f"no small orbit is found around the equilibrium at {along} = {point.value:.9g}")
    timed, u = begun
    return timed, [u]


def returning_orbit(section: Problem, timed: TimedProblem, u: np.ndarray) -> Orbits:
    """Return an orbit near a Hopf point that returns to the section, which the smallest motions do not re-arm.

    It is not the smallest one: the Hopf point is extrapolated from those between.

    **Raises:** `InputError` if none is found.
    """
    [along] = section.along
    found: list[Orbits] = []
    for point in larger(timed, u):
        [(states, times)] = crossings_of(timed, point)
        if not len(times):
            continue
        parameters = {**section.parameters, along: timed.values(point.family, point.u)[:, 0]}
        orbit = Orbits.find(section.scene, parameters, states[None])
        if orbit.converged[0] and abs(orbit.times.sum() / point.period[0] - 1) < SAME_PERIOD:
            found.append(orbit)
        if len(found) == RETURNING:
            break
    if not found:
        place = Place("follow").at("from_hopf")
        raise place.error("no orbit near the hopf point returns to the section; give start or orbit")
    return found[-1]


def given_orbit(section: Problem, orbit: GivenOrbit) -> tuple[TimedProblem, list[np.ndarray]]:
    """Return the equations without a section, and the unknowns of the orbit near a given one.

    **Raises:** `InputError` if Newton's method finds none.
    """
    place, [along], scene = Place("follow").at("orbit"), section.along, section.scene
    names = moving_names(scene)
    begin = np.array([[x for name, x in zip(scene.start_states, orbit.states, strict=True) if name in names]])
    value, family = section.parameters[along][:1], np.zeros(1, int)
    timed, [u] = through(section, family, begin, np.array([orbit.period]), value)
    found, converged = timed.correct(family, u[None], towards(u[None], 1.0), u[None, -1])
    if not converged[0]:
        raise place.error(
            f"Newton's method finds no periodic orbit near these states at {along} = {value[0]:g} "
            f"(residual {found.residual[0]:.1e}); give states on an orbit, and its period"
        )
    if np.abs(found.u[0] - u).max() > GIVEN_DISTANCE * np.abs(u).max():
        period = float(found.period[0])
        raise place.error(f"the next orbit that Newton's method finds is another one, of period {period:.6g} s")
    return timed, [found.u[0]]


def traced_orbit(section: Problem, orbit: GivenOrbit, lane: xr.Dataset) -> Orbits:
    """Return the orbit near a given one, by its states at the section.

    **Arguments:** `lane`: the motion from the given states, with its last returns.

    **Raises:** `InputError` if Newton's method finds none.
    """
    place, scene = Place("follow").at("orbit"), section.scene
    times = lane["return_time"].values.ravel()
    known = np.isfinite(times)
    if known.sum() < 2:
        raise place.error("the motion from these states does not return to the section; give states on the orbit")
    every = np.diff(times[known])
    cycles = int(np.clip(round(orbit.period / every.mean()), 1, MOST_CYCLES))
    begin = np.array([[lane[f"return_{name}"].values.ravel()[known][0] for name in scene.return_states]])
    guess = Orbits.trace(scene, section.parameters, begin, cycles)
    found = Orbits.find(scene, section.parameters, guess.states, scales=guess.scales)
    period = float(found.times.sum())
    if not found.converged[0]:
        raise place.error(
            f"Newton's method finds no periodic orbit near these states (residual {found.residual[0]:.1e})"
        )
    if abs(period - orbit.period) > GIVEN_DISTANCE * orbit.period:
        raise place.error(f"the next orbit that Newton's method finds is another one, of period {period:.6g} s")
    return found
