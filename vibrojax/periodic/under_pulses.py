"""Whether lanes that pulses drive repeat, found by the return map itself, from the state at their last pulse."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from vibrojax.measures.kept_returns import state_name
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import REPEATS_WITHIN
from vibrojax.models.scenes.scene import Scene
from vibrojax.periodic.newton import LEAST_SWING
from vibrojax.periodic.return_map import Mapped
from vibrojax.sweep.engine.batch import Features, Index

Return = Callable[[Index, Float[np.ndarray, "states segments"]], Mapped]


def repeats(scene: Scene, features: Features, go: Return) -> Features:
    """What is measured of lanes that return to a section, by the same names: `cycles`, and the last returns
    (lanes, returns), the newest last.

    A lane repeats after the fewest pulses, up to 8, that bring it back to within 1e-3 of its swing.

    **Arguments:** `features`: of the lanes, among them the states where the last pulse begins; `go`: the return map.
    """
    names = [state_name(name) for name in scene.return_states]
    begin = np.stack([features[name] for name in names]).astype(float)
    rows, count = begin.shape
    passed = np.full((rows, count, MOST_CYCLES), np.nan)
    cycles = np.zeros(count)
    least, greatest, state = begin.copy(), begin.copy(), begin.copy()
    active = np.flatnonzero(np.isfinite(begin).all(axis=0))
    for pulses in range(1, MOST_CYCLES + 1):
        if not len(active):
            break
        passed[:, active] = np.roll(passed[:, active], -1, axis=-1)
        passed[:, active, -1] = state[:, active]
        mapped = go(active, state[:, active])
        state[:, active] = mapped.state
        least[:, active] = np.minimum(least[:, active], mapped.seen.least)
        greatest[:, active] = np.maximum(greatest[:, active], mapped.seen.greatest)
        size = np.maximum(greatest[:, active], -least[:, active])
        swing = np.maximum((greatest[:, active] - least[:, active]) / 2, LEAST_SWING * size)
        back = np.all(np.abs(mapped.state - begin[:, active]) <= REPEATS_WITHIN * swing, axis=0)
        cycles[active[back & mapped.seen.returned]] = pulses
        active = active[~back & mapped.seen.returned]
    unknown = np.full(count, np.nan)
    return {"cycles": cycles, "drift_estimate": unknown, **dict(zip(names, passed, strict=True))}
