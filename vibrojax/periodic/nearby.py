"""Stable periodic orbits near lanes that have not settled: the probable limits of long transients.

Each number of section crossings up to eight is tried as the period of the motion. A number qualifies if all recorded
crossings nearly repeat after it, the later crossings more closely than the earlier ones. Newton's method begins at the
crossings that repeat most closely. An orbit is accepted if it is stable, if all recorded crossings are near it, and if
a simulation confirms its number of impacts.
"""

from typing import Any

import numpy as np
from jaxtyping import Int

from vibrojax.lanes.inputs import Features, Index, LaneInputs, PerLane
from vibrojax.measures import RETURNS_FOR_DRIFT
from vibrojax.measures.labels import FEWEST_RETURNS
from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.periodic.lane_orbits import last_returns
from vibrojax.periodic.margin import GRAZING, Measuring, begun
from vibrojax.periodic.newton import ACCEPTED, PeriodicOrbits, orbits, repeats_after, spectral_radius
from vibrojax.periodic.return_map import STEPS, Segments
from vibrojax.scenes import Scene
from vibrojax.settings.run_settings import RunSettings

REACH = 0.5
"""Largest distance of the recorded section crossings from a nearby orbit, in units of the states' scales. Of 197 lanes
(beta 0.1 to 1.2, gamma 0.3 to 1.2) with such an orbit after 40 s, 194 were on it after 300 s. Half this distance finds
fewer orbits, none of them more reliable."""

RETURN_DISTANCE = 0.3
"""Largest distance between section crossings that may repeat, in the same units. Over the default map 468 of 1,184
lanes within this distance have a nearby orbit, but only 2 of 459 lanes at distances between this one and 0.5. Newton's
method takes equally long for every lane."""

NEARBY_MAX_ITERATIONS = 4

MOST_STEPS = 300.0
"""Step limit between two section crossings. A hundred steps are already many, and a diverging Newton iterate may never
return to the section."""

NEARBY_TOLERANCE = 1e-9
"""Tolerance of the step-size control in the return map."""


class Nearby:
    """Search for stable orbits near lanes that have not settled, one chunk of lanes at a time: a stage of a run."""

    attribute = "orbits"

    def __init__(self, scene: Scene[Any], run: RunSettings, start_names: tuple[str, ...]) -> None:
        self._scene = scene.driving_part()
        self._measure = Measuring(scene, run, start_names)
        self._map = Segments(self._scene, steps=STEPS._replace(tolerance=NEARBY_TOLERANCE), most=MOST_STEPS)

    @property
    def described(self) -> dict[str, object]:
        """Entries for the dataset's attribute `orbits`."""
        return {"nearby_reach": REACH}

    def __call__(self, inputs: LaneInputs, features: Features) -> Features:
        """Return `nearby_cycles`, `nearby_impacts` and `nearby_distance` of lanes.

        `features`: features of these lanes, including their last section crossings (lanes, returns). The result is
        empty for scenes driven by pulses, because no criterion shows that such a lane has not settled.
        """
        section = self._scene.section
        if section is None:
            return {}
        without = {"nearby_cycles": 0.0, "nearby_impacts": np.nan, "nearby_distance": np.nan}
        result = {name: np.full(len(inputs), none) for name, none in without.items()}
        settled = (np.nan_to_num(features["cycles"]) > 0) & (features["trend"] == 0)
        lanes = np.flatnonzero(features["finite"] & features["finished"] & ~settled)
        parameters = inputs.driving_parameters
        with np.errstate(all="ignore"):
            returns, scale = last_returns(self._scene, lanes, RETURNS_FOR_DRIFT, features)
            compared = returns[..., : len(section.compared)] / scale[:, None, : len(section.compared)]
            for repeat in range(1, MOST_CYCLES + 1):
                back = np.max(np.abs(compared[:, :-repeat] - compared[:, repeat:]), axis=2)
                enough = np.isfinite(back).sum(axis=1) >= max(FEWEST_RETURNS - 1, 2 * repeat)
                half = back.shape[1] // 2
                closer = np.nanmax(back[:, half:], axis=1) < np.nanmax(back[:, :half], axis=1)
                comes_back = enough & closer & (np.nanmax(back, axis=1) < RETURN_DISTANCE)
                subset = np.flatnonzero(comes_back & (result["nearby_cycles"][lanes] == 0))
                if not len(subset):
                    continue
                closest = np.nanargmin(back[subset], axis=1)
                guess = np.stack([returns[subset, closest + k] for k in range(repeat)], axis=1)
                go = self._map.of({name: x[lanes[subset]] for name, x in parameters.items()})
                reach = np.full(len(subset), REACH)
                orbit = orbits(guess, scale[subset], reach, go, ACCEPTED, NEARBY_MAX_ITERATIONS)
                # The greatest scaled distance of a section crossing from the nearest state of the orbit.
                on_orbit = (orbit.states / orbit.scales[:, None])[..., : compared.shape[2]]
                apart = np.max(np.abs(compared[subset][:, :, None] - on_orbit[:, None]), axis=3)
                distance = np.nanmax(np.min(apart, axis=2), axis=1)
                kept = self._confirmed(inputs, lanes[subset], orbit, distance)
                result["nearby_cycles"][lanes[subset[kept]]] = repeat
                result["nearby_impacts"][lanes[subset[kept]]] = orbit.impacts[kept]
                result["nearby_distance"][lanes[subset[kept]]] = distance[kept]
        return result

    def _confirmed(
        self, inputs: LaneInputs, lanes: Index, orbit: PeriodicOrbits, distance: PerLane
    ) -> Int[np.ndarray, " kept"]:
        """Return the indices of the orbits that are stable, near their lane, and confirmed by a simulation."""
        cycles = orbit.states.shape[1]
        right = (orbit.residual <= ACCEPTED) & (orbit.margin >= GRAZING) & (distance < REACH)
        right &= (repeats_after(orbit) == cycles) & (spectral_radius(orbit.product) < 1)
        sure = np.flatnonzero(right)
        if not len(sure):
            return sure
        begin = begun(lanes[sure], orbit.states[sure], orbit.times[sure], orbit.steps[sure])
        measures, whole = self._measure(inputs, begin)
        if "impacts" in measures:
            whole &= np.abs(measures["impacts"] * cycles - orbit.impacts[sure]) < 0.5
        return sure[whole]
