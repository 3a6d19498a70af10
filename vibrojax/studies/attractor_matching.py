"""Attractors from motions of neighbouring grid points: links between motions, then numbering by union-find."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.measures.labels import EQUILIBRIUM
from vibrojax.periodic.newton import ACCEPTED, orbits, spectral_radius
from vibrojax.periodic.return_map import Segments
from vibrojax.scenes import Scene
from vibrojax.studies.attractor_grouping import SIMILAR_FACTOR, PointMotion, PointMotions, is_on_orbit

MATCHING_FIRST_STEP, MATCHING_MIN_STEP = 1 / 4, 1 / 256
"""First and least continuation step, as fractions of the distance to the neighbour. Orbits that need less are lost."""

PREDICTION_WITHIN = 0.05
"""Scaled distance from the prediction beyond which an orbit counts as another orbit."""

States = Float[np.ndarray, "edges cycles states"]


Links = dict[tuple[int, int], float]
"""Distance between two motions of one attractor, by the indices of the motions, the lower index first."""


def find_links(
    scene: Scene[Any],
    parameters: Mapping[str, Float[np.ndarray, " points"]],
    shape: tuple[int, ...],
    motions: PointMotions,
) -> Links:
    """Return the links between motions of neighbouring grid points; they do not depend on the direction of axes.

    A stable orbit is continued by Newton's method to the neighbour's parameters, and linked to the orbit there that it
    becomes, if any. Continued backwards through its period doubling, an orbit becomes the orbit from which it
    bifurcated. Neighbouring equilibria are linked, and so are irregular motions of similar statistics.

    **Arguments:** `parameters`: values at the points by name, in row-major order over the grid's `shape`.
    """
    in_cell: dict[int, list[int]] = {}
    for index, motion in enumerate(motions.items):
        in_cell.setdefault(motion.cell, []).append(index)
    links: Links = {}
    edges: dict[int, list[tuple[int, int]]] = {}  # by cycles: pairs of an orbit and the cell to which it is continued
    for here, there in _neighbours(shape):
        for index in in_cell.get(here, ()):
            motion, others = motions.items[index], in_cell.get(there, ())
            if motion.cycles:
                if any(motions.items[other].cycles for other in others):
                    edges.setdefault(motion.cycles, []).append((index, there))
                continue
            for other in others:
                distance = _distance(motion, motions.items[other])
                if distance is not None:
                    links[min(index, other), max(index, other)] = distance
    for same_cycles in edges.values():
        begin = [motions.items[index] for index, _ in same_cycles]
        cells = [motion.cell for motion in begin], [cell for _, cell in same_cycles]
        first, last = ({name: x[np.array(ends)] for name, x in parameters.items()} for ends in cells)
        states = np.stack([np.asarray(motion.states) for motion in begin])
        scales = np.stack([np.asarray(motion.scales) for motion in begin])
        arrived, final = _continue_orbits(scene, first, last, states, scales, motions.max_steps)
        for k in np.flatnonzero(arrived).tolist():
            for other in in_cell[cells[1][k]]:
                motion = motions.items[other]
                if motion.states is None or motion.scales is None:
                    continue
                if is_on_orbit(final[k, :1], motion.states, motion.scales)[0]:
                    # Distance between the two orbits: that between their nearest states.
                    apart = np.abs(states[k][:, None] - motion.states[None]) / ((scales[k] + motion.scales) / 2)
                    pair = min(same_cycles[k][0], other), max(same_cycles[k][0], other)
                    links[pair] = float(apart.max(axis=2).min())
    return links


def _neighbours(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return all pairs of neighbouring points along an axis, in both directions."""
    cells = np.arange(int(np.prod(shape, dtype=int))).reshape(shape)
    pairs: list[tuple[int, int]] = []
    for axis in range(len(shape)):
        along = np.moveaxis(cells, axis, 0)
        ends = along[:-1].ravel().tolist(), along[1:].ravel().tolist()
        pairs += [*zip(*ends, strict=True), *zip(*ends[::-1], strict=True)]
    return pairs


def _distance(motion: PointMotion, other: PointMotion) -> float | None:
    """Return the distance between two motions without orbits, or None if they are not linked."""
    if motion.regime == EQUILIBRIUM and other.regime == EQUILIBRIUM:
        return 0.0
    if motion.statistics is None or other.statistics is None:
        return None
    distance = float(np.abs(motion.statistics - other.statistics).max())
    return distance if distance <= np.log(SIMILAR_FACTOR) else None


def _continue_orbits(
    scene: Scene[Any],
    begin: Mapping[str, Float[np.ndarray, " edges"]],
    end: Mapping[str, Float[np.ndarray, " edges"]],
    states: States,
    scales: Float[np.ndarray, "edges states"],
    max_steps: float,
) -> tuple[Bool[np.ndarray, " edges"], States]:
    """Continue orbits from parameters `begin` to `end`; return which arrive as stable orbits, and the final states."""
    return_map = Segments(scene, most=max_steps)
    states, slope = states.copy(), np.zeros_like(states)
    done, step = np.zeros(len(states)), np.full(len(states), MATCHING_FIRST_STEP)
    active = np.arange(len(states))
    while len(active):
        advance = np.minimum(step[active], 1 - done[active])
        share = done[active] + advance
        values = {name: (1 - share) * begin[name][active] + share * end[name][active] for name in begin}
        predicted = states[active] + slope[active] * advance[:, None, None]
        with np.errstate(all="ignore"):
            orbit = orbits(predicted, scales[active], np.full(len(active), PREDICTION_WITHIN), return_map.of(values))
            good = (orbit.residual <= ACCEPTED) & (orbit.moved <= PREDICTION_WITHIN)
            good &= spectral_radius(orbit.product) < 1
        accepted, rejected = active[good], active[~good]
        slope[accepted] = (orbit.states[good] - states[accepted]) / advance[good, None, None]
        states[accepted], done[accepted] = orbit.states[good], share[good]
        step[accepted], step[rejected] = 2 * advance[good], advance[~good] / 2
        active = active[(done[active] < 1) & (step[active] >= MATCHING_MIN_STEP)]
    return done >= 1, states


def number_attractors(
    cells: Sequence[int], lanes: Sequence[int], links: Links, order: Sequence[tuple[float, ...]]
) -> Int[np.ndarray, " motions"]:
    """Return the attractor number of each motion. Attractors are numbered from 0 by decreasing number of lanes.

    Linked motions have the same number, but no two motions of one point do. Links are processed in order of increasing
    distance. A link that would give two motions of one point the same number is dropped: near a cusp, two attractors
    are connected through other motions. Numbers therefore do not depend on the direction of the axes.

    **Arguments:** `cells`, `lanes`: grid point and number of lanes of each motion; `order`: sort key of each motion.
    The least key of an attractor breaks ties between attractors with equally many lanes.
    """
    from scipy.cluster.hierarchy import DisjointSet  # slow to import

    groups, points = DisjointSet(range(len(cells))), [{cell} for cell in cells]
    for pair in sorted(links, key=lambda pair: (links[pair], sorted(order[motion] for motion in pair))):
        small, large = sorted((groups[motion] for motion in pair), key=lambda root: len(points[root]))
        if points[small].isdisjoint(points[large]):
            points[large] |= points[small]
            groups.merge(small, large)
            points[groups[large]] = points[large]
    ranked = sorted(groups.subsets(), key=lambda own: (-sum(lanes[m] for m in own), min(order[m] for m in own)))
    number = np.zeros(len(cells), int)
    for place, own in enumerate(ranked):
        number[list(own)] = place
    return number
