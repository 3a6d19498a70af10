"""Families of periodic orbits over one parameter: `follow`."""

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.analyses.continuation.measures import measured
from vibrojax.analyses.continuation.points import Point, SpecialPoint, columns, in_order, states
from vibrojax.analyses.continuation.problem import STEPS, Problem
from vibrojax.analyses.continuation.spec import Asked, read_asked
from vibrojax.analyses.continuation.trace import Tracer
from vibrojax.analyses.continuation.walk import CONVERGED
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.errors import Place
from vibrojax.io.derived import OF_FAMILIES
from vibrojax.io.provenance import provenance
from vibrojax.io.variables import ORBIT_REASONS, REASONS, VARIABLES, orbit_name
from vibrojax.measures.labels import REGIMES
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.models.physics.parameters import ROTATION, Parameter, differing
from vibrojax.models.scenes import HasContact, Scene
from vibrojax.periodic.margin import HOW
from vibrojax.periodic.of_dataset import known_orbits
from vibrojax.sweep.engine.labelled import measured_besides, of_orbits
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.starts import Start

UNITS = 8
"""Of the parameter, between its bounds: what a step over the scales is along it."""


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
    """The family of periodic orbits over one parameter, stable and unstable, with its special points.

        fam = vj.follow("vibro-impact", along="gamma", at=0.75, span=(0.3, 1.6), start="stuck", beta=0.4)

    The family begins with the orbit on which the motion at `along` = `at` settles, and is followed both ways by
    pseudo-arclength continuation, through folds, around the corners that it has where an impact or a stick begins or
    vanishes, and onto the branches of twice the period at period doublings. Where the order of events changes it does
    so by itself.

    **Arguments:**

    - `scene`: a name or a scene; `parameters`: any of its (SI), as `simulate` takes them. One or several may be
      sequences of one length: then as many families are followed, all at once, numbered along `family`.
    - `along`: the name of the parameter; `at`: its value where the family begins; `span`: its bounds, `at` between.
    - `start`: of the motion that settles, by default the scene's first; `settle` [s]: for how long it does, and
      `observe` [s]: how long it is then watched, nine returns at least.
    - `cycles`: the most returns of doubled branches that are followed, 1 to 8; 1 for no such branch.
    - `progress`: whether to say on stderr how far it is.

    **Returns:** a dataset. Along `point`: `branch` (0 is the one begun with), the parameter, `stable`,
    `multiplier_abs`, `multiplier_arg` [rad] along `multiplier`, `period` [s] (per return), `cycles`, `impacts` (per
    repeat), `grazing_margin`, the state at the section (`orbit_x1` and so on), and what a sweep measures of the scene,
    over the repeat. Along `special`: `special_kind` (fold, period-doubling, torus, grazing, stick, section, end),
    `special_value` of the parameter, `special_branch`, and `special_note`. *Grazing* is where an impact begins or
    vanishes, or another event that is no stick: then the note names what it is of, as where rock begins to yield.
    Multipliers at a special point are those on the side from which it was reached; beside a grazing impact they hold
    over a very small distance. A doubled branch that joins another orbit at its end too is listed once.

    **Raises:** `InputError` where a name or value is not right, or the motion does not settle on a periodic orbit.

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


def follow_asked(asked: Asked, progress: bool = True) -> xr.Dataset:
    """The families, as `follow` gives them; raises `InputError` where there is no orbit to begin with."""
    sweep, along = asked.sweep, asked.along
    dataset = run_sweep(sweep, progress=progress)
    problem, families, first = problem_of(asked, dataset)
    legs = Tracer(problem, cycles=asked.cycles)(families, first)
    points, special = in_order(legs)
    found = measured(sweep, problem, points, columns(problem, points))
    return _dataset(sweep, problem, points, special, found, along)


def problem_of(asked: Asked, dataset: xr.Dataset) -> tuple[Problem, np.ndarray, list[np.ndarray]]:
    """The equations of the families; which of them have an orbit to begin with, and the unknowns there.

    **Arguments:** `dataset`: of the sweep that is asked for.

    **Raises:** `InputError` where none has.
    """
    sweep, along = asked.sweep, asked.along
    dataset = dataset.isel(start=0) if "start" in dataset.dims else dataset
    system = sweep.system.driving_part()
    values, _ = sweep.lane_values(0, sweep.lanes)
    parameters = {name: values[name].astype(float) for name in system.parameters()}
    known = known_orbits(system, dataset, parameters)
    families = known.lanes
    if not len(families):
        lane = dataset.isel(point=0)
        raise Place("follow").at("at").error(_what_instead(lane, f"{along} = {float(lane[along]):g}"))
    scale = np.ones((sweep.lanes, len(system.return_states)))
    scale[families] = known.scales
    unit, first, last = (np.full(sweep.lanes, x) for x in ((asked.high - asked.low) / UNITS, asked.low, asked.high))
    problem = Problem(system, along, parameters, scale, unit, first, last, known.most_steps)
    at = parameters[along]
    begin = [
        problem.unknowns(np.array([one]), x[None], at[[one]])[0]
        for one, x in zip(families.tolist(), known.states, strict=True)
    ]
    return problem, families, begin


def _what_instead(lane: xr.Dataset, at: str) -> str:
    """Why there is no orbit to begin with."""
    reason = ORBIT_REASONS[int(lane["orbit_reason"])]
    settled = json.loads(str(lane.attrs["run"]))["settle"]
    if reason == "not-repeating":
        regime = REGIMES[int(lane["regime"])]
        return f"the motion at {at} does not repeat ({regime} after {settled:g} s); begin where it does"
    if reason == "refused":
        return f"the motion at {at} cannot be run ({REASONS[int(lane['reason'])].replace('-', ' ')}); begin elsewhere"
    return f"the motion at {at} repeats, but its orbit is not known ({reason.replace('-', ' ')}); begin elsewhere"


def _dataset(
    sweep: Sweep,
    problem: Problem,
    points: list[Point],
    special: list[SpecialPoint],
    measures: Mapping[str, np.ndarray],
    along: str,
) -> xr.Dataset:
    """The dataset of families."""
    found, at_special = columns(problem, points), columns(problem, [one.point for one in special])
    system, known = problem.scene, sweep.system.parameters()[along]
    about = _described(known)
    table = VARIABLES | OF_FAMILIES | measured_besides(sweep.system) | of_orbits(sweep.system)
    stable = np.where(np.isfinite(found.multiplier_abs).all(axis=1), found.multiplier_abs[:, 0] < 1, -1)
    section_states = zip(map(orbit_name, system.return_states), states(problem, points).T, strict=True)
    values = {
        "branch": found.branch,
        "stable": stable,
        "period": found.period,
        "cycles": found.cycles,
        "impacts": found.impacts,
        "grazing_margin": found.margin,
        **dict(section_states),
        **{name: x for name, x in measures.items() if name in table},
    }
    if not isinstance(system, HasContact):
        del values["impacts"]
    variables: dict[str, Any] = {along: ("point", found.value, about)}
    for name, x in values.items():
        one = table[name]
        variables[name] = ("point", np.asarray(x, one.dtype), one.attributes())
    for name in ("multiplier_abs", "multiplier_arg"):
        variables[name] = (("point", "multiplier"), getattr(found, name), table[name].attributes())
    kinds = np.array([one.kind for one in special], np.int8)
    variables |= {
        "special_kind": ("special", kinds, table["special_kind"].attributes()),
        "special_value": (
            "special",
            at_special.value,
            about | {"long_name": f"{known.long_name} at the special point"},
        ),
        "special_branch": ("special", at_special.branch.astype(np.int32), table["special_branch"].attributes()),
        "special_note": (
            "special",
            np.array([one.note for one in special], str),
            {"long_name": table["special_note"].long_name},
        ),
    }
    several = {name: x for name, x in (sweep.points or {}).items() if name != along}
    coordinates: dict[str, Any] = {}
    if several:
        of_family = table["point_family"].attributes()
        variables["point_family"] = ("point", found.family.astype(np.int32), of_family)
        variables["special_family"] = ("special", at_special.family.astype(np.int32), of_family)
        coordinates["family"] = ("family", np.arange(sweep.lanes), of_family)
        parameters = dict(sweep.system.parameters()) | ROTATION
        for name, x in several.items():
            coordinates[name] = ("family", x, _described(parameters[name]) if name != "rock" else {"long_name": "rock"})
    attributes = {
        "title": f"Families of periodic orbits of {sweep.scene} over {along}",
        "scene": sweep.scene,
        **provenance(),
        "history": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} follow",
        **sweep.options,
        **({} if sweep.starts is None else {"start": _start_text(sweep.starts[0])}),
        "along": along,
        "span": [float(problem.first[0]), float(problem.last[0])],
        "parameters": json.dumps({name: x for name, x in sweep.parameters.items() if name != along}),
        "differing": json.dumps(differing(sweep.system.parameters(), sweep.parameters)),
        "orbits": json.dumps(
            {
                "states": list(system.return_states),
                "tolerance": STEPS.tolerance,
                "accepted_residual": CONVERGED,
                "grazing_margin": HOW,
            }
        ),
        "Conventions": "CF-1.11",
    }
    return xr.Dataset(variables, coordinates, attributes)


def _described(parameter: Parameter) -> dict[str, str]:
    return {"units": parameter.unit, "long_name": parameter.long_name, "symbol": parameter.symbol}


def _start_text(start: Start) -> str:
    return start if isinstance(start, str) else json.dumps(start)
