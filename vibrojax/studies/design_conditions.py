"""The conditions at an optimum: gradients, which limits bind, and what relaxing each brings (Lagrange multipliers)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

from vibrojax.io.variables import orbit_name
from vibrojax.periodic.lane_orbits import reason
from vibrojax.periodic.orbit_derivatives import orbit_features
from vibrojax.studies.design_evaluation import Assessment, Simulator, Unit, distinct_starts
from vibrojax.studies.design_orbits import is_periodic, orbit_states, scene_parameters
from vibrojax.studies.design_spec import DesignSpec

BINDING_SLACK = 3e-3
"""Slack, relative to the limit, up to which a constraint binds."""

BINDING_BOUND = 1e-3
"""Distance from a bound of a varied parameter, relative to its range, up to which the bound binds."""

STEP = 1e-5
"""Step of central differences in the unit box; the values of orbits are exact to about 1e-10."""

Slopes = dict[str, Float[np.ndarray, "starts varied"]]
"""Derivatives at the nominal point by variable (starts, varied), in the unit box; NaN where unknown."""


class Conditions(NamedTuple):
    """The first-order conditions at a candidate, along the limits of `limit_names`.

    - `slack`: distance to the limit in its own unit; `binds`: whether the limit binds.
    - `relaxation`: gain of the objective per unit by which the limit is relaxed.
    - `unexplained`: share of the objective's gradient that no limit balances: there, the border of a regime or of a
      basin binds. NaN without derivatives.
    """

    slack: Float[np.ndarray, " limits"]
    binds: Bool[np.ndarray, " limits"]
    relaxation: Float[np.ndarray, " limits"]
    unexplained: float


def limit_names(spec: DesignSpec) -> list[str]:
    """Return the names of all limits: constraints, then the bounds of the varied parameters."""
    bounds = [f"{name} {end}" for name in spec.varied for end in ("least", "most")]
    return [f"{c.variable} {c.end}" for c in spec.constraints] + bounds


def limit_values(spec: DesignSpec) -> list[float]:
    """Return the values of all limits, in the order of their names."""
    bounds = [float(end) for pair in zip(spec.low, spec.high, strict=True) for end in pair]
    return [c.limit for c in spec.constraints] + bounds


def conditions(spec: DesignSpec, point: Unit, checked: Assessment, slopes: Slopes) -> Conditions:
    """Return the conditions at a nominal point, by non-negative least squares of the stationarity equations."""
    number, count = len(spec.constraints), len(point)
    ranges = spec.high - spec.low
    least = np.where(np.isfinite(checked.slack), checked.slack, np.inf).min(axis=1, initial=np.inf)
    slack = [float(x) * c.scale + c.margin for x, c in zip(least, spec.constraints, strict=True)]
    slack += [float(d) for pair in zip(point * ranges, (1 - point) * ranges, strict=True) for d in pair]
    binds, relaxation = np.zeros(len(slack), bool), np.zeros(len(slack))
    starts = distinct_starts(checked)
    gradient = slopes[spec.maximise][starts[0]] if starts else np.full(count, np.nan)
    if not np.isfinite(gradient).all():
        return Conditions(np.array(slack), binds, np.full(len(slack), np.nan), np.nan)
    columns, limits, units = [], [], []
    for j, c in enumerate(spec.constraints):
        for start in starts:
            slope = c.sign * slopes.get(f"{c.variable} {c.end}", slopes[c.variable])[start] / c.scale
            if checked.slack[j, start] <= BINDING_SLACK and np.isfinite(slope).all():
                columns.append(-slope)
                limits.append(j)
                units.append(c.scale)
    for k in range(count):
        for end, distance, sign in ((0, point[k], -1.0), (1, 1 - point[k], 1.0)):
            if distance <= BINDING_BOUND:
                columns.append(sign * np.eye(count)[k])
                limits.append(number + 2 * k + end)
                units.append(float(ranges[k]))
    size = float(np.linalg.norm(gradient))
    weights, rest = nnls(np.array(columns).T, gradient) if columns else (np.zeros(0), size)
    for weight, limit, unit in zip(weights, limits, units, strict=True):
        relaxation[limit] += weight / unit
        binds[limit] |= weight > 0
    return Conditions(np.array(slack), binds, relaxation, rest / size if size else 0.0)


def slopes_at(simulator: Simulator, points: Sequence[Unit], assessments: Sequence[Assessment]) -> list[Slopes]:
    """Return the derivatives at each nominal point, for each start that leads to a motion of its own.

    They follow from the periodic orbit (implicit function theorem). Variables that an orbit does not have are
    differentiated by central differences of simulated lanes. Limited variables are differentiated at the worst samples
    of the tolerance box as well, as the Lagrange multipliers need it.
    """
    spec, scene = simulator.spec, simulator.spec.template.system
    count = len(spec.varied)
    starts = max((a.lanes.in_regime.shape[1] for a in assessments), default=0)
    slopes: list[Slopes] = [{name: np.full((starts, count), np.nan) for name in simulator.names} for _ in points]
    known = simulator.features
    lanes = [(k, start) for k, a in enumerate(assessments) for start in distinct_starts(a) if is_periodic(a, start)]
    groups: dict[int, list[tuple[int, int]]] = {}
    for k, start in lanes:
        groups.setdefault(int(assessments[k].lanes.dataset["orbit_cycles"].values[0, start]), []).append((k, start))
    for cycles, group in groups.items():
        parameters, chain = scene_parameters(spec, np.array([points[k] for k, _ in group]))
        guess = np.stack(
            [orbit_states(spec, assessments[k], start, cycles, parameters, i) for i, (k, start) in enumerate(group)]
        )
        by = tuple(chain)
        features = orbit_features(scene, tuple(known.values()), by, parameters, guess)
        simulator.orbits += len(group)
        jacobian = np.stack([*chain.values()], axis=1)
        derivatives = features.derivatives @ jacobian
        for i, (k, start) in enumerate(group):
            for place, name in enumerate(known):
                slopes[k][name][start] = derivatives[i, place]
    missing = [
        k
        for k, assessment in enumerate(assessments)
        if any(
            np.isnan(slopes[k][name][start]).any() for name in simulator.names for start in distinct_starts(assessment)
        )
    ]
    _by_differences(simulator, points, missing, slopes)
    _at_worst(simulator, points, assessments, lanes, slopes)
    return slopes


def _at_worst(
    simulator: Simulator,
    points: Sequence[Unit],
    assessments: Sequence[Assessment],
    lanes: Sequence[tuple[int, int]],
    slopes: Sequence[Slopes],
) -> None:
    """Add the derivatives of limited variables at the worst samples of the tolerance box, as `VARIABLE END`."""
    spec, scene = simulator.spec, simulator.spec.template.system
    limits = {(c.variable, c.end) for c in spec.constraints}
    limits |= {(spec.front.against, spec.front.end)} if spec.front is not None else set()
    requests: list[tuple[int, int, int, str, str]] = []
    for k, start in lanes:
        simulated = assessments[k].lanes
        once = is_periodic(assessments[k], start) and simulated.dataset["orbit_cycles"].values[0, start] == 1
        for variable, end in limits if once else ():
            if variable not in simulator.features:
                continue
            x = np.where(simulated.in_regime[:, start], simulated.values[variable][:, start], np.nan)
            sample = int(np.nanargmax(x) if end == "most" else np.nanargmin(x)) if np.isfinite(x).any() else 0
            known = simulated.dataset["orbit_reason"].values[sample, start] == reason("found")
            if sample and known and simulated.dataset["orbit_cycles"].values[sample, start] == 1:
                requests.append((k, start, sample, variable, end))
    if not requests:
        return
    rows = [assessments[k].lanes.dataset.isel(point=sample, start=start) for k, start, sample, *_ in requests]
    begin = [assessments[k].lanes.dataset.isel(point=0, start=start) for k, start, *_ in requests]
    offsets = np.array([
        [float(row[name] - first[name]) / width for name, width in spec.tolerances.items()]
        for row, first in zip(rows, begin, strict=True)
    ])  # fmt: skip
    parameters, chain = scene_parameters(spec, np.array([points[k] for k, *_ in requests]), offsets)
    states = [orbit_name(name) for name in scene.driving_part().return_states]
    guess = np.array([[[float(row[name]) for name in states]] for row in rows])
    of = tuple(dict.fromkeys(simulator.features[variable] for *_, variable, _ in requests))
    features = orbit_features(scene, of, tuple(chain), parameters, guess)
    simulator.orbits += len(requests)
    derivatives = features.derivatives @ np.stack([*chain.values()], axis=1)
    for i, (k, start, _, variable, end) in enumerate(requests):
        table = slopes[k].setdefault(f"{variable} {end}", slopes[k][variable].copy())
        slope = derivatives[i, of.index(simulator.features[variable])]
        table[start] = slope if np.isfinite(slope).all() else table[start]


def _by_differences(
    simulator: Simulator, points: Sequence[Unit], missing: Sequence[int], slopes: Sequence[Slopes]
) -> None:
    """Fill in derivatives that are not known, by central differences of simulated lanes."""
    if not missing:
        return
    spec = simulator.spec
    count = len(spec.varied)
    moves = np.concatenate([STEP * np.eye(count), -STEP * np.eye(count)])
    rows = np.concatenate([points[k] + moves for k in missing])
    lanes = simulator(rows, np.zeros((len(rows), len(spec.tolerances))))
    for place, k in enumerate(missing):
        part = lanes.part(slice(2 * count * place, 2 * count * (place + 1)))
        for name, x in part.values.items():
            periodic = part.in_regime & (part.dataset["cycles"].values > 0 if "cycles" in part.dataset else True)
            x = np.where(periodic, x, np.nan)
            differences = ((x[:count] - x[count:]) / (2 * STEP)).T
            slopes[k][name] = np.where(np.isnan(slopes[k][name]), differences, slopes[k][name])
