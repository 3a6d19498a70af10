"""Derivatives of objective and constraints with respect to the varied parameters, at the periodic orbits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.design.evaluation import Simulator, Unit

STEP = 1e-5
"""Step of central differences in the unit box; the values of orbits are exact to about 1e-10."""


class Slopes(NamedTuple):
    """Derivatives at the orbits of one point: `of` by variable name (starts, varied), in the unit box; NaN: unknown."""

    of: dict[str, Float[np.ndarray, "starts varied"]]


def slopes_at(simulator: Simulator, points: Sequence[Unit]) -> list[Slopes]:
    """Return the derivatives at each nominal point, for every start, by central differences."""
    spec = simulator.spec
    count = len(spec.varied)
    moves = np.concatenate([STEP * np.eye(count), -STEP * np.eye(count)])
    rows = np.concatenate([point + moves for point in points])
    lanes = simulator(rows, np.zeros((len(rows), len(spec.tolerances))))
    result = []
    for k in range(len(points)):
        part = lanes.part(slice(2 * count * k, 2 * count * (k + 1)))
        of = {}
        for name, x in part.values.items():
            x = np.where(part.in_regime, x, np.nan)
            of[name] = ((x[:count] - x[count:]) / (2 * STEP)).T
        result.append(Slopes(of))
    return result
