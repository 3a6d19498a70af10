"""Stable periodic orbits near lanes that do not repeat, and have not reached them: where a long transient leads.

Each length of a repeat is tried after which the last returns all come back to about where they were, the later ones
closer than the earlier; Newton's method begins at those that come back the closest. What it finds counts if it is
stable, if all of the last returns are near it, and if a simulation that is begun on it goes round as it should.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.engine.batch import Features, Index
from vibrojax.engine.programs import Given
from vibrojax.label import FEWEST_RETURNS
from vibrojax.measure.kept_returns import state_name
from vibrojax.measure.ledger import MOST_CYCLES
from vibrojax.measure.section import scales
from vibrojax.periodic.margin import GRAZING
from vibrojax.periodic.measured import Measuring, begun
from vibrojax.periodic.newton import ACCEPTED, Found, States, orbits, repeats_after
from vibrojax.periodic.segments import STEPS, Segments

REACH = 0.5
"""Distance, over half the swings, within which all last returns are of a nearby orbit. Of 208 lanes (beta 0.1 to 1.2,
gamma 0.3 to 1.2) that had one after 40 s, 203 were on it after 300 s; half of that reach finds fewer, no surer."""

MOST_ITERATIONS = 4

MOST_STEPS = 300.0
"""Of one return: a hundred are many, and where Newton's method goes astray there may be no return at all."""

PerLane = Float[np.ndarray, " all"]
Scales = Float[np.ndarray, "_ _"]
Returns = Float[np.ndarray, "lanes returns states"]

NONE = {"nearby_cycles": 0.0, "nearby_impacts": np.nan, "nearby_distance": np.nan}
"""Of a lane without one."""


class Nearby:
    """Finds stable orbits near lanes that have not settled."""

    def __init__(self, scene: Any, measure: Measuring) -> None:
        self._scene, self._map, self._measure = (
            scene,
            Segments(scene, steps=STEPS._replace(tolerance=1e-9), most=MOST_STEPS),
            measure,
        )

    def __call__(self, lanes: Index, parameters: dict[str, PerLane], given: Given, features: Features) -> Features:
        """`nearby_cycles`, `nearby_impacts` and `nearby_distance` of some `lanes`, by index; arrays of all lanes.

        **Arguments:** `parameters` by name, what is `given` of all lanes, and their `features`, among them the last
        returns (lanes, returns).
        """
        found = {name: np.full(len(features["cycles"]), none) for name, none in NONE.items()}
        returns, scale = self._last_returns(lanes, features)
        for repeat in range(1, MOST_CYCLES + 1):
            compared = scale.shape[1]
            again = np.abs(returns[:, :-repeat, :compared] - returns[:, repeat:, :compared]) / scale[:, None]
            back = np.max(again, axis=2)
            seen = np.isfinite(back)
            enough = seen.sum(axis=1) >= max(FEWEST_RETURNS - 1, 2 * repeat)
            half = back.shape[1] // 2
            closer = np.nanmax(back[:, half:], axis=1) < np.nanmax(back[:, :half], axis=1)
            tried = enough & closer & (np.nanmax(back, axis=1) < REACH) & (found["nearby_cycles"][lanes] == 0)
            some = np.flatnonzero(tried)
            if len(some):
                closest = np.nanargmin(back[some], axis=1)
                begin = np.stack([returns[some, closest + k] for k in range(repeat)], axis=1)
                self._enter(lanes[some], begin, returns[some], scale[some], parameters, given, found)
        return found

    def _enter(
        self,
        lanes: Index,
        begin: States,
        returns: Returns,
        scale: Scales,
        parameters: dict[str, PerLane],
        given: Given,
        found: Features,
    ) -> None:
        """Enter in `found` the orbits that are stable and near, and that a simulation bears out."""
        some = {name: x[lanes] for name, x in parameters.items()}
        unknown = np.full((len(lanes), begin.shape[2] - scale.shape[1]), np.nan)
        orbit = orbits(
            begin,
            np.concatenate([scale, unknown], axis=1),
            np.full(len(lanes), REACH),
            lambda which, states: self._map({name: x[which] for name, x in some.items()}, states),
            most=MOST_ITERATIONS,
        )
        distance = _distance(returns, orbit, scale)
        right = (orbit.residual <= ACCEPTED) & (orbit.margin >= GRAZING) & (distance < REACH)
        right &= repeats_after(orbit, orbit.scales) == begin.shape[1]
        right[right] = np.max(np.abs(np.linalg.eigvals(orbit.product[right])), axis=1) < 1
        sure = np.flatnonzero(right)
        if not len(sure):
            return
        one = begun(lanes[sure], orbit.states[sure], orbit.times[sure], orbit.steps[sure])
        again, whole = self._measure.of(given, one)
        if "impacts" in again:
            whole &= np.abs(again["impacts"] * one.cycles - orbit.impacts[sure]) < 0.5
        kept = sure[whole]
        found["nearby_cycles"][lanes[kept]] = begin.shape[1]
        found["nearby_impacts"][lanes[kept]] = orbit.impacts[kept]
        found["nearby_distance"][lanes[kept]] = distance[kept]

    def _last_returns(self, lanes: Index, features: Features) -> tuple[Returns, Scales]:
        """States at the last returns (lanes, returns, states), NaN where there were fewer, and what labels compare them
        with, (lanes, compared)."""
        rows = [features[state_name(name)][lanes].astype(float) for name in self._scene.return_states]
        swings = tuple(features[swing.amplitude][lanes] for swing in self._scene.section.swings)
        return np.stack(rows, axis=-1), np.stack(scales(swings, features["period"][lanes]), axis=-1).astype(float)


def _distance(returns: Returns, orbit: Found, scale: Scales) -> Float[np.ndarray, " _"]:
    """The greatest distance of the last returns from an orbit, each from that of its states which is the nearest."""
    compared = scale.shape[1]
    apart = np.abs(returns[:, :, None, :compared] - orbit.states[:, None, :, :compared]) / scale[:, None, None]
    return np.nanmax(np.min(np.max(apart, axis=3), axis=2), axis=1)
