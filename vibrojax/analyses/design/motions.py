"""Predictions on the equations of periodic orbits: objective and slacks near a candidate, without settling."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.design.evaluation import Assessment, Offsets, Simulator, Unit, distinct_starts
from vibrojax.analyses.design.slopes import is_periodic, orbit_states, scene_parameters
from vibrojax.periodic.orbit_derivatives import MODULUS, orbit_features

if TYPE_CHECKING:
    from vibrojax.analyses.design.search import Candidate

REACH = 1.0
"""Distance in half swings from a candidate's orbit beyond which an orbit counts as another one."""

Points = Float[np.ndarray, "points varied"]
Prediction = tuple[Float[np.ndarray, " points"], Float[np.ndarray, "points samples constraints"]]


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


def predict(simulator: Simulator, requests: Sequence[tuple["Candidate", Points, Offsets]]) -> list[Prediction]:
    """Return objective and slacks of points near candidates at samples of their boxes, worst over the motions.

    The objective is that at the first sample. Both are -inf where an orbit was not found or is not stable.
    """
    spec = simulator.spec
    features = (*simulator.features.values(), f"{MODULUS}0")
    rows = [
        (k, motion, np.repeat(points, len(offsets), axis=0), np.tile(offsets, (len(points), 1)))
        for k, (candidate, points, offsets) in enumerate(requests)
        for motion in candidate.motions or ()
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
    for k, (candidate, points, offsets) in enumerate(requests):
        objective = np.full(len(points), np.inf)
        slack = np.full((len(points), len(offsets), len(candidate.constraints)), np.inf)
        for (owner, *_), table in zip(rows, values, strict=True):
            if owner == k:
                own = table.reshape(len(points), len(offsets), -1)
                nominal = np.nan_to_num(own[:, 0, column[spec.maximise]], nan=-np.inf)
                objective = np.minimum(objective, nominal)
                for j, c in enumerate(candidate.constraints):
                    slack[..., j] = np.fmin(slack[..., j], c.slack(own[..., column[c.variable]]))
        predictions.append((objective, slack))
    return predictions
