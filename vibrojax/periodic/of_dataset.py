"""Orbits read from a dataset, as initial solutions for families, borders and other analyses."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.io.variables import ORBIT_REASONS, orbit_name
from vibrojax.measures.repeats import scales
from vibrojax.models.scenes import Scene
from vibrojax.periodic.return_map import Segments

STEPS_FACTOR = 8
"""Step limit between two section crossings, relative to the largest number of steps that the orbits themselves take."""


class KnownOrbits(NamedTuple):
    """Orbits of lanes.

    - `lanes`: indices of the lanes.
    - `states`: for each orbit, the states at all section crossings of one period, (cycles, states).
    - `scales` (orbits, states): scales of the states.
    - `most_steps`: step limit between two crossings, for motions close to these orbits.
    """

    lanes: Int[np.ndarray, " orbits"]
    states: list[Float[np.ndarray, "cycles states"]]
    scales: Float[np.ndarray, "orbits states"]
    most_steps: float


def known_orbits(
    scene: Scene[Any],
    dataset: xr.Dataset,
    parameters: Mapping[str, np.ndarray],
    lanes: Int[np.ndarray, " orbits"] | None = None,
) -> KnownOrbits:
    """Return the orbits of the given `lanes` of a dataset, by default of all lanes with a found orbit.

    **Arguments:** `scene`: scene of the return map; `parameters`: values of all lanes by name, in the dataset's order.
    """

    def column(name: str) -> np.ndarray:
        return dataset[name].values.ravel()

    if lanes is None:
        lanes = np.flatnonzero(column("orbit_reason") == ORBIT_REASONS.index("found"))
    cycles = column("orbit_cycles")[lanes].astype(int)
    begin = np.stack([column(orbit_name(name))[lanes] for name in scene.return_states])
    if not len(lanes):
        return KnownOrbits(lanes, [], begin.T, 0.0)
    go, values = Segments(scene), {name: x[lanes] for name, x in parameters.items()}
    returns, seen = [begin], []
    for _ in range(int(cycles.max())):
        mapped = go(values, returns[-1])
        seen.append(mapped.seen)
        returns.append(np.asarray(mapped.state))
    swings = (np.max([s.greatest for s in seen], axis=0) - np.min([s.least for s in seen], axis=0)) / 2
    size = np.where(swings > 0, swings, 1.0).T
    if scene.section is not None:
        amplitudes = tuple(column(swing.amplitude)[lanes] for swing in scene.section.swings)
        for k, scale in enumerate(scales(amplitudes, column("period")[lanes])):
            size[:, k] = scale
    states = [np.stack([state[:, k] for state in returns[: cycles[k]]]) for k in range(len(lanes))]
    return KnownOrbits(lanes, states, size, STEPS_FACTOR * max(float(s.steps.max()) for s in seen))
