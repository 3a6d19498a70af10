"""Continuation of families of periodic orbits along one parameter: `follow`."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.analyses.continuation.families import FamilyContinuation
from vibrojax.analyses.continuation.indicators import KINDS
from vibrojax.analyses.continuation.points import FamilyPoint, columns, in_order, measured
from vibrojax.analyses.continuation.problem import CORRECTOR_RESIDUAL, FAMILY_ACCURACY, Problem
from vibrojax.analyses.continuation.spec import FamilySpec, read_asked
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import Place
from vibrojax.io.kinds import OF_FAMILIES, dataset_attributes
from vibrojax.io.variables import ORBIT_REASONS, REASONS, VARIABLES
from vibrojax.measures.labels import REGIMES
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.models.physics.parameters import ROTATION, Parameter, differing
from vibrojax.models.scenes import HasContact, Scene
from vibrojax.periodic.lane_orbits import known_orbits
from vibrojax.periodic.margin import HOW
from vibrojax.sweep.engine.labelled import measured_besides, of_orbits
from vibrojax.sweep.input.definition import Sweep

UNITS_PER_SPAN = 8
"""Number of units of the scaled parameter between its bounds, which weights parameter steps against state steps."""


def follow(
    scene: str | Scene[Any],
    *,
    along: str,
    at: float,
    span: tuple[float, float],
    start: str | Sequence[float] | None = None,
    settle: float = 40.0,
    observe: float = 8.0,
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
    - `cycles`: largest number of section crossings per period of doubled branches, 1 to 8; 1 excludes such branches.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset.

    - Along `point`: the parameter, `branch` (0 is the first branch), `stable`, `multiplier_abs` and `multiplier_arg`
      [rad] along `multiplier`, and `grazing_margin`. `cycles` is the number of section crossings per period of the
      motion, `period` [s] the mean time between crossings, and `impacts` the number of impacts per period of the
      motion. Further variables are the state at the section (`orbit_x1` and so on) and the scene's measures.
    - Along `special`: `special_kind` (fold, period-doubling, torus, grazing, stick, section, end), `special_value` (the
      parameter's value), `special_branch`, and `special_note`.

    At a *grazing* point, an impact or another event that is not a stick begins or vanishes. For other events than
    impacts, the note contains the name of the mode that changes, for example where rock begins to yield. Multipliers at
    a special point are those on the side from which the point was reached; next to a grazing impact they are valid over
    a very small distance only. A doubled branch that connects two period doublings is listed once.

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
    return follow_asked(read_asked(scene, along, at, span, start, settle, observe, cycles, parameters), progress)


def follow_asked(spec: FamilySpec, progress: bool = True) -> xr.Dataset:
    """Return the families of a specification, as `follow` does; raise `InputError` if there is no initial orbit."""
    dataset = run_sweep(spec.sweep, progress=progress)
    problem, families, first = problem_of(spec, dataset)
    points, special = in_order(FamilyContinuation(problem, cycles=spec.cycles)(families, first))
    return _dataset(spec.sweep, problem, points, special)


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
    known = known_orbits(system, dataset, parameters)
    families = known.lanes
    if not len(families):
        lane = dataset.isel(point=0)
        raise Place("follow").at("at").error(_no_orbit(lane, f"{along} = {float(lane[along]):g}"))
    scale = np.ones((sweep.lanes, len(system.return_states)))
    scale[families] = known.scales
    bounds = ((spec.high - spec.low) / UNITS_PER_SPAN, spec.low, spec.high)
    unit, first, last = (np.full(sweep.lanes, x) for x in bounds)
    problem = Problem(system, along, parameters, scale, unit, first, last, known.most_steps)
    unknowns = [
        problem.unknowns(families[[k]], states[None], parameters[along][families[[k]]])[0]
        for k, states in enumerate(known.states)
    ]
    return problem, families, unknowns


def _no_orbit(lane: xr.Dataset, where: str) -> str:
    """Return a message with the reason why there is no initial orbit, and a remedy."""
    reason = ORBIT_REASONS[int(lane["orbit_reason"])]
    if reason == "not-repeating":
        regime, settle = REGIMES[int(lane["regime"])], json.loads(str(lane.attrs["run"]))["settle"]
        return f"the motion at {where} does not repeat ({regime} after {settle:g} s); begin where it does"
    if reason == "refused":
        words = REASONS[int(lane["reason"])].replace("-", " ")
        return f"the motion at {where} cannot be run ({words}); begin elsewhere"
    words = reason.replace("-", " ")
    return f"the motion at {where} repeats, but its orbit is not known ({words}); begin elsewhere"


def _dataset(sweep: Sweep, problem: Problem, points: list[FamilyPoint], special: list[FamilyPoint]) -> xr.Dataset:
    """Return the dataset of families."""
    table, at_special = columns(problem, points), columns(problem, special)
    along, system = problem.along, problem.scene
    schema = VARIABLES | OF_FAMILIES | measured_besides(sweep.system) | of_orbits(sweep.system)
    measures = {name: x for name, x in measured(sweep, problem, points, table).items() if name in schema}
    multipliers = {name: table.pop(name) for name in ("multiplier_abs", "multiplier_arg")}
    family, value = table.pop("family"), table.pop(along)
    values = table | measures | multipliers
    if not isinstance(system, HasContact):
        del values["impacts"]
    described = _described(sweep.system.parameters()[along])
    special_value = described | {"long_name": f"{described['long_name']} at the special point"}
    kinds = np.array([KINDS.index(point.kind) for point in special], np.int8)
    branch = at_special["branch"].astype(np.int32)
    notes = np.array([point.note for point in special], str)
    variables: dict[str, Any] = {along: ("point", value, described)}
    for name, x in values.items():
        dims = ("point", "multiplier")[: x.ndim]
        variables[name] = (dims, np.asarray(x, schema[name].dtype), schema[name].attributes())
    variables |= {
        "special_kind": ("special", kinds, schema["special_kind"].attributes()),
        "special_value": ("special", at_special[along], special_value),
        "special_branch": ("special", branch, schema["special_branch"].attributes()),
        "special_note": ("special", notes, {"long_name": schema["special_note"].long_name}),
    }
    several = {name: x for name, x in (sweep.points or {}).items() if name != along}
    coordinates: dict[str, Any] = {}
    if several:
        of_family = schema["point_family"].attributes()
        variables["point_family"] = ("point", family.astype(np.int32), of_family)
        variables["special_family"] = ("special", at_special["family"].astype(np.int32), of_family)
        coordinates["family"] = ("family", np.arange(sweep.lanes), of_family)
        parameters = dict(sweep.system.parameters()) | ROTATION
        for name, x in several.items():
            coordinates[name] = ("family", x, {"long_name": "rock"} if name == "rock" else _described(parameters[name]))
    return xr.Dataset(variables, coordinates, _attributes(sweep, problem))


def _attributes(sweep: Sweep, problem: Problem) -> dict[str, Any]:
    start = None if sweep.starts is None else sweep.starts[0]
    orbits = {
        "states": list(problem.scene.return_states),
        "tolerance": FAMILY_ACCURACY.tolerance,
        "accepted_residual": CORRECTOR_RESIDUAL,
        "grazing_margin": HOW,
    }
    return {
        **dataset_attributes(
            "family", f"Families of periodic orbits of {sweep.scene} over {problem.along}", "follow", scene=sweep.scene
        ),
        **sweep.options,
        **({} if start is None else {"start": start if isinstance(start, str) else json.dumps(start)}),
        "along": problem.along,
        "span": [float(problem.first[0]), float(problem.last[0])],
        "parameters": json.dumps({name: x for name, x in sweep.parameters.items() if name != problem.along}),
        "differing": json.dumps(differing(sweep.system.parameters(), sweep.parameters)),
        "orbits": json.dumps(orbits),
    }


def _described(parameter: Parameter) -> dict[str, str]:
    return {"units": parameter.unit, "long_name": parameter.long_name, "symbol": parameter.symbol}
