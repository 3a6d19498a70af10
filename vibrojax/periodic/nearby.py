"""Stable periodic orbits near lanes that do not repeat, and have not reached them: where a long transient leads.

Each length of a repeat is tried after which the last returns all come back to about where they were, the later ones
closer than the earlier; Newton's method begins at those that come back the closest. What it finds counts if it is
stable, if all of the last returns are near it, and if a simulation that is begun on it goes round as it should.
"""

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.measures import RETURNS_FOR_DRIFT
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.margin import GRAZING
from vibrojax.periodic.measured import Measuring, begun
from vibrojax.periodic.newton import ACCEPTED, Found, orbits, repeats_after
from vibrojax.periodic.of_lanes import last_returns
from vibrojax.periodic.segments import STEPS, Segments
from vibrojax.sweep.engine.batch import Features, Index
from vibrojax.sweep.input.definition import Sweep

REACH = 0.5
"""Distance, over half the swings, within which all last returns are of a nearby orbit. Of 197 lanes (beta 0.1 to 1.2,
gamma 0.3 to 1.2) that had one after 40 s, 194 were on it after 300 s; half of that reach finds fewer, no surer."""

BACK = 0.3
"""The same between returns that may repeat. Over the default map 468 of 1,184 that come back to within this have an
orbit nearby; 2 of 459 that come back to within 0.5 only, and Newton's method takes as long for each of them."""

MOST_ITERATIONS = 4

MOST_STEPS = 300.0
"""Of one return: a hundred are many, and where Newton's method goes astray there may be no return at all."""

TOLERANCE = 1e-9
"""Of the return map's steps."""

PerLane = Float[np.ndarray, " lanes"]
Returns = Float[np.ndarray, "lanes returns states"]

NONE = {"nearby_cycles": 0.0, "nearby_impacts": np.nan, "nearby_distance": np.nan}
"""Of a lane without one."""


class Nearby:
    """Finds stable orbits near lanes that have not settled, chunk by chunk."""

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._scene = sweep.system.driving_part()
        self._measure = Measuring(sweep)
        self._map = Segments(self._scene, steps=STEPS._replace(tolerance=TOLERANCE), most=MOST_STEPS)

    @property
    def described(self) -> dict[str, object]:
        """What the attribute `orbits` of a dataset says of them."""
        return {"nearby_reach": REACH}

    def __call__(self, first: int, end: int, features: Features) -> Features:
        """`nearby_cycles`, `nearby_impacts` and `nearby_distance` of the lanes from `first` to before `end`.

        `features` are those of the lanes, by name, among them their last returns (lanes, returns); not changed. Under
        pulses there is no telling what has not settled, and nothing is found.
        """
        section = self._scene.section
        if section is None:
            return {}
        found = {name: np.full(end - first, none) for name, none in NONE.items()}
        settled = (np.nan_to_num(features["cycles"]) > 0) & (features["trend"] == 0)
        lanes = np.flatnonzero(features["finite"] & features["finished"] & ~settled)
        parameters, _ = self._sweep.lane_values(first, end)
        with np.errstate(all="ignore"):
            returns, scale = last_returns(self._scene, lanes, RETURNS_FOR_DRIFT, features)
            compared = returns[..., : len(section.compared)] / scale[:, None, : len(section.compared)]
            for repeat in range(1, MOST_CYCLES + 1):
                back = np.max(np.abs(compared[:, :-repeat] - compared[:, repeat:]), axis=2)
                some = np.flatnonzero(_comes_back(back, repeat) & (found["nearby_cycles"][lanes] == 0))
                if len(some):
                    closest = np.nanargmin(back[some], axis=1)
                    begin = np.stack([returns[some, closest + k] for k in range(repeat)], axis=1)
                    given = {name: parameters[name][lanes[some]] for name in self._scene.parameters()}
                    reach = np.full(len(some), REACH)
                    orbit = orbits(begin, scale[some], reach, self._map.of(given), ACCEPTED, MOST_ITERATIONS)
                    distance = _distance(compared[some], orbit)
                    self._enter(first, end, lanes[some], orbit, distance, found)
        return found

    def _enter(self, first: int, end: int, lanes: Index, orbit: Found, distance: PerLane, found: Features) -> None:
        """Enter in `found` the orbits that are stable and near, and that a simulation bears out."""
        cycles = orbit.states.shape[1]
        right = (orbit.residual <= ACCEPTED) & (orbit.margin >= GRAZING) & (distance < REACH)
        right &= repeats_after(orbit) == cycles
        right[right] = np.max(np.abs(np.linalg.eigvals(orbit.product[right])), axis=1) < 1
        sure = np.flatnonzero(right)
        if not len(sure):
            return
        one = begun(lanes[sure], orbit.states[sure], orbit.times[sure], orbit.steps[sure])
        again, whole = self._measure(first, end, one)
        if "impacts" in again:
            whole &= np.abs(again["impacts"] * cycles - orbit.impacts[sure]) < 0.5
        kept = sure[whole]
        found["nearby_cycles"][lanes[kept]] = cycles
        found["nearby_impacts"][lanes[kept]] = orbit.impacts[kept]
        found["nearby_distance"][lanes[kept]] = distance[kept]


def _comes_back(back: Float[np.ndarray, "lanes pairs"], repeat: int) -> Bool[np.ndarray, " lanes"]:
    """Which lanes all come back to about where they were so many returns ago, of late closer; `back` is how close."""
    enough = np.isfinite(back).sum(axis=1) >= max(FEWEST_RETURNS - 1, 2 * repeat)
    half = back.shape[1] // 2
    closer = np.nanmax(back[:, half:], axis=1) < np.nanmax(back[:, :half], axis=1)
    return enough & closer & (np.nanmax(back, axis=1) < BACK)


def _distance(returns: Returns, orbit: Found) -> PerLane:
    """The greatest distance of the last returns from an orbit, each from that of its states which is the nearest; of
    the states that labels compare, over their scales."""
    compared = returns.shape[2]
    on_orbit = (orbit.states / orbit.scales[:, None])[..., :compared]
    apart = np.max(np.abs(returns[:, :, None] - on_orbit[:, None]), axis=3)
    return np.nanmax(np.min(apart, axis=2), axis=1)
