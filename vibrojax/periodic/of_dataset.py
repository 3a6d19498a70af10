"""The orbits of a dataset's lanes, as families and borders begin with them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.io.variables import ORBIT_REASONS, orbit_name
from vibrojax.measures.repeats import scales
from vibrojax.models.scenes import Scene
from vibrojax.periodic.segments import Segments

STRAYING = 8
"""Steps, over the most that a return of these orbits takes, after which an orbit is taken not to return."""

FOUND = ORBIT_REASONS.index("found")


class KnownOrbits(NamedTuple):
    """Orbits of some lanes: `lanes`, by index; the states at all returns of each, (cycles, states); the `scales`
    (orbits, states); and the steps after which neighbours of theirs are taken not to return."""

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
    """The orbits that were found of a dataset's lanes, or of some `lanes`, by index.

    **Arguments:** `scene`: what the return map is of; `parameters`: of all lanes by name, in the dataset's order.
    """

    def column(name: str) -> np.ndarray:
        return dataset[name].values.ravel()

    if lanes is None:
        lanes = np.flatnonzero(column("orbit_reason") == FOUND)
    cycles = column("orbit_cycles")[lanes].astype(int)
    here = np.stack([column(orbit_name(name))[lanes] for name in scene.return_states])
    if not len(lanes):
        return KnownOrbits(lanes, [], here.T, 0.0)
    go, given = Segments(scene), {name: x[lanes] for name, x in parameters.items()}
    found, seen = [here], []
    for _ in range(int(cycles.max())):
        mapped = go(given, found[-1])
        seen.append(mapped.seen)
        found.append(np.asarray(mapped.state))
    swings = (np.max([one.greatest for one in seen], axis=0) - np.min([one.least for one in seen], axis=0)) / 2
    size = np.where(swings > 0, swings, 1.0).T
    if scene.section is not None:
        amplitudes = tuple(column(swing.amplitude)[lanes] for swing in scene.section.swings)
        for k, one in enumerate(scales(amplitudes, column("period")[lanes])):
            size[:, k] = one
    states = [np.stack([one[:, k] for one in found[: cycles[k]]]) for k in range(len(lanes))]
    return KnownOrbits(lanes, states, size, STRAYING * max(float(one.steps.max()) for one in seen))
