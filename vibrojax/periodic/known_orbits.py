"""Orbits that a dataset of lanes holds, as initial solutions for families, borders and other analyses."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Float, Int

from vibrojax.io.variables import ORBIT_REASONS, REASONS, orbit_name
from vibrojax.lanes.inputs import Index
from vibrojax.measures.labels import REGIMES
from vibrojax.measures.since_start import half_names, scale_names, stored_scales
from vibrojax.periodic.return_map import Segments
from vibrojax.scenes import Scene

STEP_ALLOWANCE = 8
"""Step limit between two crossings of motions close to orbits, as a multiple of the steps that the orbits take."""


class KnownOrbits(NamedTuple):
    """Orbits of lanes.

    - `lanes`: indices of the lanes; `scales` (orbits, states): scales of the states.
    - `states`: for each orbit, the states at all section crossings of one period, (cycles, states).
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

    `scene`: scene of the return map; `parameters`: values of all lanes by name, in the dataset's order.
    """

    def column(name: str) -> np.ndarray:
        return dataset[name].values.ravel()

    if lanes is None:
        lanes = np.flatnonzero(column("orbit_reason") == ORBIT_REASONS.index("found"))
    cycles = column("orbit_cycles")[lanes].astype(int)
    begin = np.stack([column(orbit_name(name))[lanes] for name in scene.return_states])
    if not len(lanes):
        return KnownOrbits(lanes, [], begin.T, 0.0)
    traced = trace_orbits(Segments(scene), {name: x[lanes] for name, x in parameters.items()}, begin, cycles)
    swings = (traced.greatest - traced.least) / 2
    size = np.where(swings > 0, swings, 1.0).T
    if scene.section is not None:
        names = list(map(orbit_name, scale_names(scene.section))) or half_names(scene.section)
        halves = [column(name)[lanes] for name in names]
        compared = begin[: len(scene.section.compared)]
        for k, scale in enumerate(stored_scales(scene.section, halves, column("period")[lanes], [*compared])):
            size[:, k] = scale
    return KnownOrbits(lanes, traced.states, size, STEP_ALLOWANCE * traced.steps)


class TracedOrbits(NamedTuple):
    """States of orbits at all section crossings of a period, their ranges (states, orbits), and the most steps."""

    states: list[Float[np.ndarray, "cycles states"]]
    least: Float[np.ndarray, "states orbits"]
    greatest: Float[np.ndarray, "states orbits"]
    steps: float


def trace_orbits(
    go: Segments, parameters: Mapping[str, np.ndarray], begin: Float[np.ndarray, "states orbits"], cycles: Index
) -> TracedOrbits:
    """Follow orbits with `cycles` crossings per period once round, from one state of each at the section."""
    returns, least, greatest, steps = [np.asarray(begin)], begin.copy(), begin.copy(), 0.0
    for number in range(int(cycles.max(initial=0))):
        mapped, active = go(parameters, returns[-1]), cycles > number
        least[:, active] = np.fmin(least, mapped.seen.least)[:, active]
        greatest[:, active] = np.fmax(greatest, mapped.seen.greatest)[:, active]
        steps = max(steps, float(mapped.seen.steps[active].max()))
        returns.append(np.asarray(mapped.state))
    states = [np.stack([state[:, k] for state in returns[:count]]) for k, count in enumerate(cycles)]
    return TracedOrbits(states, least, greatest, steps)


def why_no_orbit(lane: xr.Dataset) -> str:
    """Return the end of a sentence about the motion of one lane: why the dataset holds no orbit of it."""
    reason = ORBIT_REASONS[int(lane["orbit_reason"])]
    if reason == "refused":
        return f"cannot be run ({REASONS[int(lane['reason'])].replace('-', ' ')})"
    if reason == "not-repeating":
        settle = json.loads(str(lane.attrs["run"]))["settle"]
        return f"does not repeat ({REGIMES[int(lane['regime'])]} after {settle:g} s)"
    return f"repeats, but its orbit is not known ({reason.replace('-', ' ')})"
