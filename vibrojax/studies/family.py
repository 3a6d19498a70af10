"""Continuation of families of periodic orbits and equilibria along one parameter: `follow`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.compile.xla import precision
from vibrojax.errors import Place
from vibrojax.io.variables import REGIMES
from vibrojax.maps.run import run_sweep
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.equilibria import Equilibrium, equilibrium_near, scales_at
from vibrojax.periodic.equilibrium_families import EquilibriumContinuation, EquilibriumProblem
from vibrojax.periodic.families import FamilyContinuation, in_order
from vibrojax.periodic.flow_map import flowed
from vibrojax.periodic.hopf import orbit_at_hopf
from vibrojax.periodic.orbit_stages import why_no_orbit
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.periodic.problem import UNITS_PER_SPAN, Points, Problem, refusals, towards
from vibrojax.periodic.return_map import Segments
from vibrojax.periodic.segments import Mark
from vibrojax.periodic.timed_families import TimedContinuation, at_section, free_problem, returning_orbit, through
from vibrojax.periodic.timed_problem import TimedProblem, has_free_phase
from vibrojax.scenes import Scene
from vibrojax.studies.family_data import SAME_HOPF, FamilySpec, families_dataset, family_spec

SAME_CENTRE = 1e-3
"""Difference of the states, relative to their scales, up to which two Hopf points at one value are the same."""

ROUNDED = 1e-9
"""Size of an equilibrium's states that is a rounding error, relative to a displacement that changes its eigenvalues."""

GIVEN_DISTANCE = 0.3
"""Largest scaled distance of the orbit that is found from the one that is given."""

REPEATS = 1e-6
"""Distance of states, relative to their swing, within which an orbit repeats; it converged to 1e-9."""

PROBES = 33
"""Values of the parameter among which the first one is sought at which `simulate` refuses the motion."""

ANOTHER = "the next orbit that Newton's method finds is another one, of period {:.6g} s"


def follow(
    scene: str | Scene[Any],
    *,
    along: str | None = None,
    at: float | None = None,
    span: tuple[float, float] | None = None,
    start: str | Sequence[float] | None = None,
    orbit: Mapping[str, Any] | None = None,
    from_hopf: xr.Dataset | str | PathLike[str] | None = None,
    settle: float | None = None,
    observe: float | None = None,
    cycles: int = MOST_CYCLES,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Continue a family of stable and unstable periodic orbits along one parameter, and locate its special points.

        fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.6), start="stuck", beta=0.4)

    By default, a family begins at the orbit on which the motion settles when the parameter named by `along` has the
    value `at`. A family can also begin at a given `orbit`, or at the Hopf points of a family of equilibria. If the
    motion settles at an equilibrium, `follow` continues the family of equilibria. Pseudo-arclength continuation follows
    the family in both directions, through folds and changes in the order of events, and onto period-doubled branches.

    **Arguments:**

    - `scene`: name of a scene, or a scene; `parameters`: parameters of the scene (SI), as in `simulate`. If parameters
      are sequences of equal length, each element gives one family; the dimension `family` numbers the families.
    - `along`: name of the continuation parameter; `at`: value of this parameter at the first orbit; `span`: lower and
      upper bound of this parameter, which enclose `at`.
    - `start`: initial condition of the motion that settles on the first orbit, by default the first start of the scene.
    - `orbit`: a stable or unstable orbit for the parameter value `at`, as `{"states": [...], "period": ...}`. The
      states are ordered as in `start`; if the system is forced, they are the states at the beginning of a forcing
      period. `period` is the period of the orbit [s]. Newton's method corrects the states and the period.
    - `from_hopf`: a family of equilibria, or its file. A branch begins at each Hopf point of the family of equilibria,
      unless another branch has led to the point. With `from_hopf`, the defaults of `along`, `span` and the parameters
      are the values in the family of equilibria, and `at` is not needed.
    - `settle` [s]: settling time; `observe` [s]: duration of the observation, which must cover nine section crossings.
      By default, `settle` and `observe` are the default times of the scene.
    - `cycles`: greatest number of section crossings per period of the period-doubled branches, at most 8; with
      `cycles=1`, no such branches are followed. With `cycles=0`, `follow` continues equilibria; Newton's method finds
      the first equilibrium, stable or not, near the initial condition.

    **Returns:** a dataset.

    - Variables along `point`: the parameter, `branch` (0 is the first branch), `stable`, `grazing_margin`, and the
      multipliers `multiplier_abs` and `multiplier_arg` [rad]. The variable `cycles` counts section crossings per period
      of the motion, `period` [s] is the mean time between crossings, and `impacts` counts impacts per period of the
      motion. The dataset also has the state at the section (`orbit_x1` and so on) and the measures of the scene.
    - Variables along `special`: `special_kind` (fold, period-doubling, torus, grazing, stick, section, hopf,
      branch-point, end, or the name of a system's switch), `special_value` (value of the parameter), `special_branch`
      (number of the branch), and `special_note`.

    At a *grazing* point, an impact or another event appears or vanishes, or two events exchange their order and the
    multipliers jump; at a *stick* point, a stick phase appears or vanishes. If the event at a grazing point is not an
    impact, `special_note` names the affected discrete states. An exchange of order at which neither the stability nor
    the direction of the branch changes is no special point. Multipliers at a
    special point are computed on the side from which the point was reached, unless orbits exist only on the other side.
    Where multipliers grow without limit towards a grazing point, the parameter and the state are extrapolated to this
    point, but multipliers and `impacts` belong to the last orbit before it.

    The mirror image of an orbit counts as another orbit.

    A family of equilibria has `cycles` 0 and `period` NaN; its variables `orbit_NAME` are the states of the
    equilibrium. The eigenvalues of the vector field's Jacobian replace the multipliers: `eigenvalue_re` and
    `eigenvalue_im` [1/s] along `eigenvalue`, by decreasing real part. Special points of equilibria are *fold*,
    *branch-point*, *hopf* and *end*. If an equilibrium reaches a surface on which the vector field changes,
    `special_kind` is *grazing* or the name of the switch.

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


def continue_families(spec: FamilySpec, progress: bool = True) -> xr.Dataset:
    """Return the families of a specification, as `follow` does; raise `InputError` if there is no initial orbit."""
    sweep, scene = spec.sweep, spec.sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    bounds = (spec.high - spec.low) / UNITS_PER_SPAN, spec.low, spec.high
    unit, low, high = (np.full((sweep.lanes, 1), x) for x in bounds)
    section = Problem(  # the equations of orbits by their states at the section, with scales of 1
        scene=scene,
        along=(spec.along,),
        parameters={name: values[name].astype(float) for name in scene.parameters()},
        scales=np.ones((sweep.lanes, len(scene.return_states))),
        unit=unit,
        first=low,
        last=high,
    )
    section = _permitted(section)
    if spec.cycles == 0:
        return _equilibria(spec, section, None)
    if spec.hopf:
        return _from_hopf(spec, section)
    if spec.orbit is not None and has_free_phase(scene):
        return families_dataset(sweep, section, *_free_marks(spec, section, *_given_orbit(spec, section)))
    if not scene.return_states:
        why = "a motion of one state has no orbits"
        if scene.section is None:
            why = f"{scene.name} declares no section, so it has no orbits; give section= or period="
        raise Place("follow").at("cycles").error(f"{why}; for its equilibria give cycles=0")
    if spec.orbit is not None:
        known = [_traced_orbit(spec, section, *spec.orbit)]
    else:
        dataset = run_sweep(sweep, progress=progress)
        if scene.autonomous and (dataset["regime"] == REGIMES.index("equilibrium")).all():
            return _equilibria(spec, section, sweep.run.settle)
        known = _first_orbits(spec, section, dataset)
    if has_free_phase(scene):
        return families_dataset(sweep, section, *_free_marks(spec, section, *free_problem(section, known)))
    problem, unknowns = _with_scales(section, known), dict[int, np.ndarray]()
    for orbits in known:
        own = problem.unknowns(orbits.lane, orbits.states, orbits.parameters[spec.along][:, None])
        unknowns |= dict(zip(orbits.lane.tolist(), own, strict=True))
    families = sorted(unknowns)
    continuation = FamilyContinuation(problem, cycles=spec.cycles)
    segments = continuation(np.array(families), [unknowns[family] for family in families])
    return families_dataset(sweep, problem, *in_order(segments))


def _permitted(section: Problem) -> Problem:
    """Return the equations with their bounds moved to where `simulate` begins to refuse the parameters, if it does.

    **Raises:** `InputError` if it refuses all of the first ones.
    """
    [along], scene, first, last = section.along, section.scene, section.first.copy(), section.last.copy()
    refused: dict[tuple[int, bool], str] = {}
    begin = refusals(scene, section.parameters)
    if all(begin):
        fault = f"the motion at {along} = {section.parameters[along][0]:g} is refused: {begin[0]}"
        raise Place("follow").at("at").error(fault)
    for family in (k for k, why in enumerate(begin) if not why):
        own = {name: x[[family]] for name, x in section.parameters.items()}
        for is_last, bounds in ((False, first), (True, last)):
            good, end, why = float(own[along][0]), float(bounds[family, 0]), ""
            while True:
                values = np.linspace(good, end, PROBES)
                every = {name: np.repeat(x, PROBES) for name, x in own.items()} | {along: values}
                whys = refusals(scene, every)
                index = next((k for k, x in enumerate(whys) if x), 0)
                if not index or (good, end) == (values[index - 1], values[index]):
                    break
                good, end, why = float(values[index - 1]), float(values[index]), whys[index]
            if why:
                bounds[family, 0] = good
                refused[family, is_last] = f"motions beyond are refused: {why}"
    return replace(section, first=first, last=last, refused=refused)


def _equilibria(spec: FamilySpec, section: Problem, settle: float | None) -> xr.Dataset:
    """Return the families of equilibria; `settle`: time [s] of motion before Newton's method, None: it begins at once.

    **Raises:** `InputError` if a scene has no equilibria, or Newton's method finds none.
    """
    place, scene, sweep, [along] = Place("follow"), section.scene, spec.sweep, section.along
    if not scene.autonomous or not section.moving:
        raise place.at("cycles").error(f"{scene.name} is forced, it has no equilibria; give cycles of 1 and more")
    guesses, known = [], dict[int, Equilibrium]()
    for number in range(sweep.lanes):
        own = {name: x[[number]] for name, x in section.parameters.items()}
        guess = np.zeros((len(section.moving), 1)) if sweep.starts is None else _states_at_start(spec, section, own)
        if settle:
            guess = np.asarray(Segments(scene, program=flowed)(own, guess, np.array([settle])).state)
        guesses.append(guess[:, 0])
        equilibrium = equilibrium_near(scene, {name: float(x[0]) for name, x in own.items()}, guess[:, 0])
        known |= {} if equilibrium is None else {number: equilibrium}
    if not known:
        raise place.at("start").error(
            f"Newton's method finds no isolated equilibrium from {guesses[0].tolist()} at {along} = "
            f"{section.parameters[along][0]:g}; "
            "give states nearer to one (where friction holds a body, none is isolated)"
        )
    problem, first = EquilibriumProblem.through(section, known)
    segments = EquilibriumContinuation(problem, cycles=1)(np.array([*known]), first)
    return families_dataset(sweep, problem, *in_order(segments))


def _states_at_start(spec: FamilySpec, section: Problem, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the moving states (states, 1) at the start, of which the section's state is relative to its level."""
    scene, starts = section.scene, spec.sweep.starts
    assert starts is not None
    with precision("float64"):
        states = scene.start(scene.constants(parameters), starts[0], (1,))
    whole = dict(zip(scene.state_names, states, strict=True))
    return np.array([np.broadcast_to(whole[name], 1) for name in section.moving], float)


def _free_marks(
    spec: FamilySpec, section: Problem, timed: TimedProblem, families: np.ndarray, first: list[np.ndarray]
) -> tuple[list[Mark], list[Mark]]:
    """Return the points of families without a section, and their special points, by their states at the section."""
    points, special = in_order(TimedContinuation(timed, cycles=spec.cycles)(families, first))
    return at_section(timed, section, points), at_section(timed, section, special)


def _from_hopf(spec: FamilySpec, section: Problem) -> xr.Dataset:
    """Return the families from all Hopf points to which no branch from an earlier one has led.

    **Raises:** `InputError` if no orbit is found next to a Hopf point.
    """
    points: list[Mark] = []
    special: list[Mark] = []
    branches, reached, family = 0, list[tuple[float, np.ndarray]](), np.zeros(1, int)
    place = Place("follow").at("from_hopf")
    for point in spec.hopf:
        near = (centre for value, centre in reached if abs(value - point.value) < SAME_HOPF * (spec.high - spec.low))
        states = np.array(point.states)
        parameters = {name: float(x[0]) for name, x in section.parameters.items()} | {spec.along: point.value}
        # An equilibrium that stays at zero has rounding errors for a size.
        typical = scales_at(section.scene, spec.along, parameters, states, (spec.low, spec.high))
        size = np.where(np.array(point.scales) > ROUNDED * typical, point.scales, typical)
        states, scales = states[section.places], size[section.places]
        if any((np.abs(centre - states) < SAME_CENTRE * scales).all() for centre in near):
            continue
        known = equilibrium_near(section.scene, parameters, np.array(point.states))
        begun = known and orbit_at_hopf(section, known, size, point.value)
        if not begun:
            raise place.error(f"no small orbit is found around the equilibrium at {spec.along} = {point.value:.9g}")
        timed, u = begun
        if has_free_phase(section.scene):
            marks = _free_marks(spec, section, timed, family, [u])
        else:
            orbit = returning_orbit(section, timed, u)
            if orbit is None:
                raise place.error("no orbit near the hopf point returns to the section; give start or orbit")
            # The dataset has the scales of one problem.
            problem = _with_scales(section, [orbit])
            section = problem if not points else replace(problem, scales=section.scales)
            u = section.unknowns(family, orbit.states, orbit.parameters[spec.along][:, None])[0]
            marks = in_order(FamilyContinuation(section, cycles=spec.cycles)(family, [u]))
        for end in (mark.orbit for mark in marks[1] if mark.kind == "hopf"):
            value, centre = section.values(end.family, end.u)[0, 0], section.states(end.family, end.u)[0, 0]
            reached.append((float(value), centre))
        for found, own in zip((points, special), marks, strict=True):
            found += [mark._replace(branch=mark.branch + branches) for mark in own]
        branches = 1 + max(mark.branch for mark in points)
    return families_dataset(spec.sweep, section, points, special)


def _first_orbits(spec: FamilySpec, section: Problem, dataset: xr.Dataset) -> list[Orbits]:
    """Return the orbits on which the motions settle, whose `lane` is the number of the family.

    **Raises:** `InputError` if no family has an initial orbit.
    """
    dataset = dataset.isel(start=0) if "start" in dataset.dims else dataset
    lane = dataset.isel(point=0)
    known = orbits_of(section.scene, dataset, section.parameters)
    if not known:
        why, where = why_no_orbit(lane), f"{spec.along} = {float(lane[spec.along]):g}"
        instead = "begin where it does" if why.startswith("does not repeat") else "begin elsewhere"
        raise Place("follow").at("at").error(f"the motion at {where} {why}; {instead}")
    return known


def _with_scales(section: Problem, known: list[Orbits]) -> Problem:
    """Return the equations with the scales of the first orbits of families.

    Orbits may gain impacts along a family, so the first one says nothing about the steps of the others.
    """
    scales = section.scales.copy()
    for orbits in known:
        scales[orbits.lane] = orbits.scales
    return replace(section, scales=scales)


@np.errstate(all="ignore")
def _given_orbit(spec: FamilySpec, section: Problem) -> tuple[TimedProblem, np.ndarray, list[np.ndarray]]:
    """Return the equations without a section, the number of the family, and the unknowns of the orbit near a given one.

    **Raises:** `InputError` if Newton's method finds none.
    """
    assert spec.orbit is not None
    place, [along], family, (_, period) = Place("follow").at("orbit"), section.along, np.zeros(1, int), spec.orbit
    value = section.parameters[along][:1]
    begin = _states_at_start(spec, section, section.parameters).T
    while True:
        timed, [u] = through(section, family, begin, np.array([period]), value)
        point, converged = timed.correct(family, u[None], towards(u[None], 1.0), u[None, -1])
        if not converged[0]:
            raise place.error(
                f"Newton's method finds no periodic orbit near these states at {along} = {value[0]:g} "
                f"(residual {point.residual[0]:.1e}); give states on an orbit, and its period"
            )
        if np.abs(point.u[0] - u).max() > GIVEN_DISTANCE * np.abs(u).max():
            raise place.error(ANOTHER.format(float(point.period[0])))
        begin = timed.states(family, point.u)[:, 0]
        parts = _repeats(timed, point)
        if parts == 1:
            return timed, family, [point.u[0]]
        period = float(point.period[0]) / parts


def _repeats(timed: TimedProblem, point: Points) -> int:
    """Return how often an orbit repeats within the period that belongs to it, if that is a multiple of its own.

    With a multiple, multipliers are powers, and a period doubling looks like a branch point.
    """
    states = timed.states(point.family, point.u)[0]
    parts = np.arange(2, MOST_CYCLES + 1)
    parameters = {name: np.repeat(x, parts.size) for name, x in timed.parameters_at(point.family, point.u).items()}
    ends = np.asarray(timed.flow(parameters, np.tile(states[:1].T, parts.size), point.period[0] / parts).state)
    same = np.abs(ends.T - states[0]).max(axis=1) < REPEATS * np.ptp(states, axis=0).max()
    return int(parts[same].max(initial=1))


def _traced_orbit(spec: FamilySpec, section: Problem, states: list[float], period: float) -> Orbits:
    """Return the orbit near a given one, by its states at the section.

    The states of a forced system are those at the section. On a stop, they may be beyond it by rounding errors.

    **Raises:** `InputError` if Newton's method finds none.
    """
    place, scene = Place("follow").at("orbit"), section.scene
    if scene.section is not None and scene.section.velocity in scene.clocks:
        given = dict(zip(scene.start_states, states, strict=True))
        begin = np.array([[given[name] for name in scene.return_states]])
        time = float(Segments(scene)(section.parameters, begin.T).time[0])
    else:
        lane = run_sweep(spec.sweep, progress=False).squeeze()
        times = lane["return_time"].values
        known = np.isfinite(times)
        if known.sum() < 2:
            raise place.error("the motion from these states does not return to the section; give states on the orbit")
        begin = np.array([[lane[f"return_{name}"].values[known][0] for name in scene.return_states]])
        time = np.diff(times[known]).mean()
    cycles = int(np.clip(round(period / time), 1, MOST_CYCLES))
    guess = Orbits.trace(scene, section.parameters, begin, cycles)
    orbit = Orbits.find(scene, section.parameters, guess.states, scales=guess.scales)
    if not orbit.converged[0]:
        residual = f"residual {orbit.residual[0]:.1e}"
        raise place.error(f"Newton's method finds no periodic orbit near these states ({residual})")
    if abs(orbit.times.sum() - period) > GIVEN_DISTANCE * period:
        raise place.error(ANOTHER.format(float(orbit.times.sum())))
    apart = np.abs(orbit.states[0] - orbit.states[0, :1]).max(axis=1) / orbit.scales.max()
    shorter = next((k for k in range(1, cycles) if cycles % k == 0 and apart[k] < REPEATS), cycles)
    return orbit if shorter == cycles else Orbits.trace(scene, section.parameters, orbit.states[:, 0], shorter)
