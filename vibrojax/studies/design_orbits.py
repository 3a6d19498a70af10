"""The periodic orbits of points: their parameters and states, and predictions on their equations, without settling."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.io.variables import orbit_name
from vibrojax.maps.sweep import with_substitutes
from vibrojax.periodic.known_orbits import known_orbits
from vibrojax.periodic.lane_orbits import reason
from vibrojax.periodic.orbit_derivatives import MODULUS, orbit_features
from vibrojax.studies.design_evaluation import Assessment, Offsets, Simulator, Unit, distinct_starts
from vibrojax.studies.design_spec import Constraint, DesignSpec

COMPLEX_STEP = 1e-20
"""Imaginary step by which the algebra of substituted parameters is differentiated, without rounding errors."""

REACH = 1.0
"""Distance in half swings from a candidate's orbit beyond which an orbit counts as another one."""

Points = Float[np.ndarray, "points varied"]
Prediction = tuple[Float[np.ndarray, " points"], Float[np.ndarray, "points samples constraints"]]


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


class Motion(NamedTuple):
    """A periodic motion of a candidate: its states at the section crossings, and its number of impacts."""

    states: Float[np.ndarray, "cycles states"]
    impacts: float


def motions_at(simulator: Simulator, point: Unit, assessment: Assessment) -> list[Motion]:
    """Return the orbits at a nominal point, one for each distinct motion; none if a motion has no orbit."""
    starts = distinct_starts(assessment)
    if set(simulator.features) != set(simulator.names) or not all(is_periodic(assessment, s) for s in starts):
        return []
    parameters, _ = scene_parameters(simulator.spec, point[None])
    dataset = assessment.lanes.dataset
    cycles = [int(dataset["cycles"].values[0, start]) for start in starts]
    impacts = [float(dataset["impacts"].values[0, s]) if "impacts" in dataset else np.nan for s in starts]
    return [
        Motion(orbit_states(simulator.spec, assessment, start, number, parameters, 0), hits)
        for start, number, hits in zip(starts, cycles, impacts, strict=True)
    ]


class Request(NamedTuple):
    """Points near a candidate with the given motions and constraints, and the samples of their boxes."""

    motions: Sequence[Motion]
    constraints: Sequence[Constraint]
    points: Points
    offsets: Offsets


def predict(simulator: Simulator, requests: Sequence[Request]) -> list[Prediction]:
    """Return objective and slacks of points near candidates at samples of their boxes, worst over the motions.

    The objective is that at the first sample. Both are -inf where an orbit was not found or is not stable.
    """
    spec = simulator.spec
    features = (*simulator.features.values(), f"{MODULUS}0")
    rows = [
        (k, motion, np.repeat(points, len(offsets), axis=0), np.tile(offsets, (len(points), 1)))
        for k, (motions, _, points, offsets) in enumerate(requests)
        for motion in motions
        if len(points) * len(offsets)
    ]
    values: list[np.ndarray] = [np.zeros(0)] * len(rows)
    for cycles in {len(motion.states) for _, motion, _, _ in rows}:
        group = [i for i, (_, motion, _, _) in enumerate(rows) if len(motion.states) == cycles]
        unit, offsets = (np.concatenate([rows[i][part] for i in group]) for part in (2, 3))
        guess = np.concatenate([np.repeat(rows[i][1].states[None], len(rows[i][2]), axis=0) for i in group])
        parameters, _ = scene_parameters(spec, unit, offsets)
        orbits = orbit_features(spec.template.system, features, (), parameters, guess, REACH)
        simulator.orbits += len(unit)
        sound = np.isfinite(orbits.values).all(axis=1) & (orbits.values[:, -1] < 1)
        table = np.where(sound[:, None], orbits.values, np.nan)
        for i, part in zip(group, np.split(table, np.cumsum([len(rows[i][2]) for i in group])[:-1]), strict=True):
            values[i] = part
    column = {name: j for j, name in enumerate(simulator.features)}
    predictions: list[Prediction] = []
    for k, (_, constraints, points, offsets) in enumerate(requests):
        objective = np.full(len(points), np.inf)
        slack = np.full((len(points), len(offsets), len(constraints)), np.inf)
        for (owner, *_), table in zip(rows, values, strict=True):
            if owner == k:
                own = table.reshape(len(points), len(offsets), -1)
                nominal = np.nan_to_num(own[:, 0, column[spec.maximise]], nan=-np.inf)
                objective = np.minimum(objective, nominal)
                for j, c in enumerate(constraints):
                    slack[..., j] = np.fmin(slack[..., j], c.slack(own[..., column[c.variable]]))
        predictions.append((objective, slack))
    return predictions
