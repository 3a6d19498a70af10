"""Stable orbits amid chaotic motion, which reveal a chaotic transient: sooner or later it settles on such an orbit.

A chaotic motion returns again and again close to earlier states, and so to the periodic orbits amid it. Newton's method
begins at its closest returns (Lathrop and Kostelich, Physical Review A 40 (1989) 4028).
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.models.scenes import Scene
from vibrojax.periodic.nearby import MOST_STEPS, REACH
from vibrojax.periodic.newton import ACCEPTED, orbits, repeats_after
from vibrojax.periodic.segments import STEPS, Segments

LONGEST_AMID = 4
"""Returns of the longest orbit that is searched for: over the default map hardly any is longer."""

TRIALS_PER_LENGTH = 8
"""Newton starts per length of orbit: the closest return of each equal part of the time."""

TRIAL_WITHIN = 0.5
"""Distance over the scales up to which a return is worth a trial."""


def has_stable_orbit(
    scene: Scene,
    parameters: Mapping[str, Float[np.ndarray, " lanes"]],
    states: Float[np.ndarray, "returns states lanes"],
    scale: Float[np.ndarray, "states lanes"],
) -> Bool[np.ndarray, " lanes"]:
    """Return for which lanes a stable orbit was found amid their returns.

    **Arguments:** `states` at the returns, and the `scale` of each.
    """
    segments = Segments(scene, steps=STEPS._replace(tolerance=1e-9), most=MOST_STEPS)
    stable = np.zeros(states.shape[2], bool)
    for repeat in range(1, LONGEST_AMID + 1):
        remaining = np.flatnonzero(~stable)
        own = states[..., remaining]
        distance = np.max(np.abs(own[repeat:] - own[:-repeat]) / scale[:, remaining], axis=1)
        part = len(distance) // TRIALS_PER_LENGTH
        parts = distance[: part * TRIALS_PER_LENGTH].reshape(TRIALS_PER_LENGTH, part, len(remaining))
        trial, column = np.nonzero(parts.min(axis=1) < TRIAL_WITHIN)
        lanes = remaining[column]
        if not len(lanes):
            continue
        first = parts.argmin(axis=1)[trial, column] + part * trial
        begin = np.stack([own[first + k, :, column] for k in range(repeat)], axis=1)
        values = {name: x[lanes] for name, x in parameters.items()}
        with np.errstate(all="ignore"):
            orbit = orbits(begin, scale.T[lanes], np.full(len(lanes), REACH), segments.of(values), ACCEPTED)
            accepted = (orbit.residual <= ACCEPTED) & (repeats_after(orbit) == repeat)
            accepted[accepted] = np.abs(np.linalg.eigvals(orbit.product[accepted])).max(axis=1) < 1
        stable[lanes[accepted]] = True
    return stable
