"""Stable orbits amid chaotic motion: it is a transient then, that comes to such an orbit sooner or later.

A chaotic motion comes again and again to about where it was, and so does every periodic orbit amid it. Newton's method
begins where it came back the closest (Lathrop and Kostelich, Physical Review A 40 (1989) 4028).
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.models.scenes import Scene
from vibrojax.periodic.nearby import MOST_STEPS, REACH
from vibrojax.periodic.newton import ACCEPTED, orbits, repeats_after
from vibrojax.periodic.segments import STEPS, Segments

LONGEST = 4
"""Returns of the longest orbit that is looked for: over the default map next to none is longer."""

TRIALS = 8
"""From how many returns, of each length of orbit; each the closest of an equal part of the time."""

BACK = 0.5
"""Distance over the scales within which a return is worth a trial."""


def stable_amid(
    scene: Scene,
    parameters: Mapping[str, Float[np.ndarray, " lanes"]],
    states: Float[np.ndarray, "returns states lanes"],
    scale: Float[np.ndarray, "states lanes"],
) -> Bool[np.ndarray, " lanes"]:
    """Whether a stable orbit was found amid the returns of each lane.

    **Arguments:** `states` at the returns, and the `scale` of each.
    """
    go = Segments(scene, steps=STEPS._replace(tolerance=1e-9), most=MOST_STEPS)
    found = np.zeros(states.shape[2], bool)
    for repeat in range(1, LONGEST + 1):
        lanes = np.flatnonzero(~found)
        few = states[..., lanes]
        back = np.max(np.abs(few[repeat:] - few[:-repeat]) / scale[:, lanes], axis=1)
        part = len(back) // TRIALS
        parts = back[: part * TRIALS].reshape(TRIALS, part, len(lanes))
        trial, lane = np.nonzero(parts.min(axis=1) < BACK)
        first = parts.argmin(axis=1)[trial, lane] + part * trial
        begin = np.stack([few[first + k, :, lane] for k in range(repeat)], axis=1)
        some = lanes[lane]
        if not len(some):
            continue
        given = {name: x[some] for name, x in parameters.items()}
        with np.errstate(all="ignore"):
            orbit = orbits(begin, scale.T[some], np.full(len(some), REACH), go.of(given), ACCEPTED)
            right = (orbit.residual <= ACCEPTED) & (repeats_after(orbit) == repeat)
            right[right] = np.abs(np.linalg.eigvals(orbit.product[right])).max(axis=1) < 1
        found[some[right]] = True
    return found
