"""Final motions of the lanes of a grid point, and attractors: motions of neighbouring points that are linked.

Lanes are grouped by orbit, or by statistics if they are not periodic. Links are numbered by union-find.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.io.variables import NATURES, orbit_name
from vibrojax.lanes.inputs import Index
from vibrojax.measures.labels import EQUILIBRIUM, FAILED, IRREGULAR, UNDECIDED
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.periodic.return_map import Segments
from vibrojax.scenes import Scene

IRREGULAR_WITHIN = 0.25
"""Resolution of irregular motions: two are the same if no statistic differs by more than this relative amount."""

RESOLUTION_STDERRS = 4.5
"""Margin of the resolution, in standard errors of the difference of two lanes: 99.7 % with 7 degrees of freedom."""

SIMILAR_FACTOR = 2.0
"""Two irregular motions are similar if no statistic differs by more than this factor. Similar motions of neighbouring
points may be one attractor. At one point, a motion of few lanes may be outliers of a similar motion."""

IRREGULAR_MIN_LANES = 3
"""Least number of lanes for an irregular motion to count in addition to another irregular motion at its point."""

EXPONENT_STDERRS = 4.0
"""Resolution of Lyapunov exponents, in standard errors."""

EXPONENT_MIN_STDERR = 1e-3
"""Lower bound for the standard error [1/s] of an exponent, which is nearly zero for orbits of long period."""

STATISTICS = ("period", "impact_velocity", "bit_amplitude", "striker_amplitude")
"""Statistics in which irregular lanes are compared, if the scene has them."""

_FAR_APART = 1e3  # exceeds the difference of any two logarithms

MATCHING_FIRST_STEP, MATCHING_MIN_STEP = 1 / 4, 1 / 256
"""First and least continuation step, as fractions of the distance to the neighbour. Orbits that need less are lost."""

PREDICTION_WITHIN = 0.05
"""Scaled distance from the prediction beyond which an orbit counts as another orbit."""

Links = dict[tuple[int, int], float]
"""Distance between two motions of one attractor, by the indices of the motions, the lower index first."""

PerStatistic = Float[np.ndarray, "_ statistics"]


def stderr_name(statistic: str) -> str:
    """Return the name of the relative standard error of a statistic."""
    return f"{statistic}_stderr"


@dataclass(frozen=True, eq=False)
class PointMotion:
    """Final motion of some lanes of one grid point.

    - `cell`: index of the grid point; `regime`: most frequent regime of the lanes.
    - `orbit`: the single orbit of a periodic motion; else None.
    - `statistics`: natural logarithms of the statistics of an irregular motion; else None.
    """

    cell: int
    regime: int
    orbit: Orbits | None = None
    statistics: np.ndarray | None = None

    @property
    def cycles(self) -> int:
        """Period of the orbit in returns to the section; 0 for other motions."""
        return 0 if self.orbit is None else self.orbit.states.shape[1]


@dataclass
class PointMotions:
    """The motions of all points.

    - `of_lane` (lanes,): index into `items` of each lane's final motion; -1 if unassigned.
    - `max_steps`: number of steps after which a motion near any of the orbits counts as not returning to the section.
    """

    of_lane: Index
    items: list[PointMotion] = field(default_factory=list)
    max_steps: float = 0.0

    def add(self, lanes: Index, motion: PointMotion) -> None:
        """Append a motion, and assign `lanes` to it."""
        self.of_lane[lanes] = len(self.items)
        self.items.append(motion)

    def remove(self, mask: Bool[np.ndarray, " motions"]) -> None:
        """Remove motions; their lanes become unassigned."""
        new_index = np.append(np.where(mask, -1, np.cumsum(~mask) - 1), -1)
        self.of_lane = new_index[self.of_lane]
        self.items = [motion for motion, removed in zip(self.items, mask, strict=True) if not removed]


def classify_motions(
    scene: Scene[Any], dataset: xr.Dataset, parameters: Mapping[str, np.ndarray], starts: int
) -> PointMotions:
    """Return the final motions of the lanes, point by point.

    **Arguments:** `scene`: scene of the return map; `dataset`: lanes with orbits, whose last dimension is `start`;
    `parameters`: parameter values of the lanes by name; `starts`: number of lanes per point, which are adjacent.
    """
    motions = PointMotions(np.full(dataset["regime"].size, -1))
    states = np.stack([dataset[orbit_name(name)].values.ravel() for name in scene.return_states], axis=1)
    cycles, regime = dataset["orbit_cycles"].values.ravel(), dataset["regime"].values.ravel()
    # An orbit next to a graze counts although it has no multipliers; on an unstable orbit no lane stays.
    has_orbit = np.isfinite(states).all(axis=1) & (cycles > 0) & (dataset["stable"].values.ravel() != 0)
    remaining = np.flatnonzero(has_orbit & ~np.isin(regime, (EQUILIBRIUM, FAILED, UNDECIDED)))
    while len(remaining):  # the orbit of each point's first lane, then that of its first lane on another orbit, ...
        cells = {int(lanes[0]): lanes for lanes in _split_by_cell(remaining, starts)}
        orbits: dict[int, Orbits] = {}
        for batch in orbits_of(scene, dataset, parameters, np.array([*cells])):
            motions.max_steps = max(motions.max_steps, batch.most_steps)
            orbits |= {lane: batch.of([k]) for k, lane in enumerate(batch.lane.tolist())}
        for first, lanes in cells.items():
            orbit = orbits[first]
            same = orbit.contain(states[lanes]) & (cycles[lanes] == cycles[first])
            same[0] = True  # the lane whose orbit this is, whatever the scales
            label = int(np.argmax(np.bincount(regime[lanes[same]])))
            motions.add(lanes[same], PointMotion(first // starts, label, orbit))
        remaining = remaining[motions.of_lane[remaining] < 0]
    for lanes in _split_by_cell(np.flatnonzero(regime == EQUILIBRIUM), starts):
        motions.add(lanes, PointMotion(int(lanes[0]) // starts, EQUILIBRIUM))
    # Without Lyapunov exponents, a few irregular lanes similar to a larger group may belong to it or not; they stay
    # unassigned.
    values = _log_statistics(dataset)
    for groups in irregular_groups(dataset, starts):
        centres = [np.median(values[lanes], axis=0) for lanes in groups]
        large = [centre for lanes, centre in zip(groups, centres, strict=True) if len(lanes) >= IRREGULAR_MIN_LANES]
        for lanes, centre in zip(groups, centres, strict=True):
            tail = any(np.abs(centre - other).max() <= np.log(SIMILAR_FACTOR) for other in large)
            if len(lanes) >= IRREGULAR_MIN_LANES or not tail or "nature" in dataset:
                motions.add(lanes, PointMotion(int(lanes[0]) // starts, IRREGULAR, statistics=centre))
    return motions


def irregular_groups(dataset: xr.Dataset, starts: int) -> list[list[Index]]:
    """Return the irregular lanes of each point, grouped by motion; chains of similar lanes connect a group.

    Lyapunov exponents, if known, are compared instead of statistics, because they cover thousands of returns to the
    section. Quasi-periodic lanes all have exponent 0, so their statistics are compared. Lanes whose statistics have not
    converged are in no group.
    """
    irregular = dataset["regime"].values.ravel() == IRREGULAR
    if "converged" in dataset:
        irregular &= dataset["converged"].values.ravel()
    resolution = np.log1p(IRREGULAR_WITHIN)
    values = _log_statistics(dataset)
    names = [stderr_name(name) for name in STATISTICS if name in dataset]
    errors = [dataset[name].values.ravel() if name in dataset else np.zeros(len(values)) for name in names]
    values, margins = values / resolution, RESOLUTION_STDERRS * np.stack(errors, axis=1) / resolution
    if "nature" in dataset:
        nature, exponent, error = (dataset[name].values.ravel() for name in ("nature", "lyapunov", "lyapunov_stderr"))
        irregular &= nature != NATURES.index("not-settled")
        known = irregular & np.isin(nature, [NATURES.index("chaotic"), NATURES.index("periodic")])
        for lanes in _split_by_cell(np.flatnonzero(known), starts):
            typical = max(float(np.median(error[lanes])), EXPONENT_MIN_STDERR)
            values[lanes] = margins[lanes] = 0.0
            values[lanes, 0] = exponent[lanes] / (EXPONENT_STDERRS * typical)
        values = np.column_stack([values, _FAR_APART * nature.astype(float)])
        margins = np.column_stack([margins, np.zeros(len(margins))])
    cells = []
    for lanes in _split_by_cell(np.flatnonzero(irregular), starts):
        group = join_chains(values[lanes], margins[lanes])
        cells.append([lanes[group == number] for number in range(int(group.max()) + 1)])
    return cells


def is_ambiguous(motions: PointMotions, number: Int[np.ndarray, " motions"]) -> Bool[np.ndarray, " motions"]:
    """Return which irregular motions may be remnants of transients, or outliers of another motion at their point.

    Such a motion has fewer lanes than another irregular motion at its point, and its attractor has fewer than
    `IRREGULAR_MIN_LANES` lanes at every point.

    **Arguments:** `number`: attractor number of each motion.
    """
    lanes = np.bincount(motions.of_lane[motions.of_lane >= 0], minlength=len(number))
    irregular = np.array([motion.regime for motion in motions.items], int) == IRREGULAR
    cell = np.array([motion.cell for motion in motions.items], int)
    most_of_attractor = np.zeros(int(number.max(initial=-1)) + 1, int)
    np.maximum.at(most_of_attractor, number, lanes)
    most_of_cell = np.zeros(cell.max(initial=-1) + 1, int)
    np.maximum.at(most_of_cell, cell[irregular], lanes[irregular])
    return irregular & (most_of_attractor[number] < IRREGULAR_MIN_LANES) & (lanes < most_of_cell[cell])


def _log_statistics(dataset: xr.Dataset) -> PerStatistic:
    """Return the logarithms of the lanes' statistics; undefined statistics become values far from all defined ones."""
    values = np.stack([dataset[name].values.ravel() for name in STATISTICS if name in dataset], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(values > 0, np.log(values), -_FAR_APART)


def join_chains(
    x: Float[np.ndarray, "lanes values"], margins: Float[np.ndarray, "lanes values"] | None = None
) -> Index:
    """Return the group number of each lane. Lanes are in the same group if a chain of lanes connects them.

    Neighbours in a chain differ by at most about 1 in every value.

    **Arguments:** `x`: values of the lanes; `margins`: additional difference allowed for each lane. The margins of two
    lanes add in quadrature.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Values rounded to quarters make many lanes equal, which keeps the number of pairs small.
    wider = np.zeros_like(x) if margins is None else np.ceil(4 * margins)
    cells, index = np.unique(np.hstack([np.round(4 * x), wider]), axis=0, return_inverse=True)
    cells, wider = np.hsplit(cells, 2)
    reach = 4.0 + 2**0.5 * wider.max(initial=0.0)
    pairs = cKDTree(cells).query_pairs(reach, p=np.inf, output_type="ndarray")
    first, second = pairs.T
    near = np.abs(cells[first] - cells[second]) <= 4.0 + np.hypot(wider[first], wider[second])
    pairs = pairs[near.all(axis=1)]
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return np.asarray(connected_components(links, directed=False)[1])[index.ravel()]


def _split_by_cell(lanes: Index, starts: int) -> list[Index]:
    """Split lanes into one array per grid point, in order."""
    return np.split(lanes, np.flatnonzero(np.diff(lanes // starts)) + 1) if len(lanes) else []


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
        begin = [motions.items[index].orbit for index, _ in same_cycles]
        own = Orbits.joined(orbit for orbit in begin if orbit is not None)
        cells = np.array([cell for _, cell in same_cycles])
        carried, arrived = own.carry_to(
            {name: x[cells] for name, x in parameters.items()},
            within=PREDICTION_WITHIN,
            first=MATCHING_FIRST_STEP,
            least=MATCHING_MIN_STEP,
            accept=lambda orbits: orbits.stable,
            scales=own.scales,
            go=Segments(scene, most=motions.max_steps),
        )
        for k in np.flatnonzero(arrived).tolist():
            index, cell = same_cycles[k]
            final = carried.of([k])
            for other in in_cell[cell]:
                orbit = motions.items[other].orbit
                if orbit is not None and final.same_as(orbit)[0]:
                    # Distance between the two orbits: that between their nearest states.
                    apart = np.abs(own.states[k][:, None] - orbit.states) / ((own.scales[k] + orbit.scales) / 2)
                    links[min(index, other), max(index, other)] = float(apart.max(axis=2).min())
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
