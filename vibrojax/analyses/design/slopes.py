"""Derivatives of objective and constraints with respect to the varied parameters, at the periodic orbits."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.design.evaluation import Assessment, Simulator, Unit, distinct_starts
from vibrojax.analyses.design.spec import DesignSpec
from vibrojax.io.variables import orbit_name
from vibrojax.periodic.known_orbits import known_orbits
from vibrojax.periodic.lane_orbits import reason
from vibrojax.periodic.orbit_derivatives import orbit_features
from vibrojax.sweep.input.definition import with_substitutes

STEP = 1e-5
"""Step of central differences in the unit box; the values of orbits are exact to about 1e-10."""

COMPLEX_STEP = 1e-20
"""Imaginary step by which the algebra of substituted parameters is differentiated, without rounding errors."""

Slopes = dict[str, Float[np.ndarray, "starts varied"]]
"""Derivatives at the nominal point by variable (starts, varied), in the unit box; NaN where unknown."""


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


def is_periodic(assessment: Assessment, start: int) -> bool:
    """Return whether the orbit of the nominal point was found from this start."""
    lanes = assessment.lanes.dataset
    return "orbit_reason" in lanes and int(lanes["orbit_reason"].values[0, start]) == reason("found")


def scene_parameters(
    spec: DesignSpec, unit: Float[np.ndarray, "lanes varied"], offsets: np.ndarray | None = None
) -> tuple[dict[str, np.ndarray], dict[str, Float[np.ndarray, "lanes varied"]]]:
    """Return the scene's parameters of points, and the derivatives of those that depend on the unit box.

    `offsets` (lanes, tolerances): offsets from the nominal points, in half-widths; by default none.
    """
    scene, lanes = spec.template.system, len(unit)
    none = np.zeros((lanes, len(spec.tolerances))) if offsets is None else offsets

    def resolved(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        values = with_substitutes(scene, spec.template.parameters | dict(columns))
        return {name: np.broadcast_to(values[name], lanes) for name in scene.parameters()}

    values = resolved(spec.columns(unit, none))
    chain = {name: np.zeros(unit.shape) for name in values}
    for k, name in enumerate(spec.varied):
        columns: dict[str, np.ndarray] = dict(spec.columns(unit, none))
        columns[name] = columns[name] + 1j * COMPLEX_STEP * (spec.high[k] - spec.low[k])
        for parameter, x in resolved(columns).items():
            chain[parameter][:, k] = np.imag(x) / COMPLEX_STEP
    values = {name: np.array(x, float) for name, x in values.items()}
    return values, {name: slope for name, slope in chain.items() if slope.any()}


def orbit_states(
    spec: DesignSpec, assessment: Assessment, start: int, cycles: int, parameters: Mapping[str, np.ndarray], lane: int
) -> Float[np.ndarray, "cycles states"]:
    """Return the states of a lane's orbit at the section crossings."""
    scene = spec.template.system.driving_part()
    row = assessment.lanes.dataset.isel(point=slice(0, 1), start=slice(start, start + 1))
    if cycles == 1:
        return np.array([[float(row[orbit_name(name)].values[0, 0]) for name in scene.return_states]])
    values = {name: parameters[name][lane : lane + 1] for name in scene.parameters()}
    return known_orbits(scene, row, values).states[0]


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
