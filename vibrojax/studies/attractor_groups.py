"""Final motions of the lanes of a grid point, and links between those of neighbouring points: the same attractor.

Lanes are grouped by orbit. Irregular lanes are grouped by statistics, and are observed until these have converged: in
consecutive windows, each as long as the sweep's `observe`. Standard errors follow from batches of windows (batch means:
Law, *Simulation Modeling and Analysis*, section 9.5.3). Batches grow with the observation until they exceed the
correlation time, because a bursting motion may rest for several windows.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.io.variables import NATURES, orbit_name
from vibrojax.lanes.inputs import Features, Index
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import EQUILIBRIUM, FAILED, IRREGULAR, UNDECIDED
from vibrojax.periodic.lane_stages import lane_run
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.periodic.return_map import Segments
from vibrojax.progress import Progress, quiet
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

EXPONENT_STDERRS, EXPONENT_MIN_STDERR = 4.0, 1e-3
"""Resolution of Lyapunov exponents in standard errors, and lower bound for the standard error [1/s] of an exponent,
which is nearly zero for orbits of long period."""

STATISTICS = ("period", "impact_velocity", "bit_amplitude", "striker_amplitude")
"""Statistics in which irregular lanes are compared, if the scene has them."""

_FAR_APART = 1e3  # exceeds the difference of any two logarithms

MATCHING_FIRST_STEP, MATCHING_MIN_STEP = 1 / 4, 1 / 256
"""First and least continuation step, as fractions of the distance to the neighbour. Orbits that need less are lost."""

PREDICTION_WITHIN = 0.05
"""Scaled distance from the prediction beyond which an orbit counts as another orbit."""

BATCHES = 8
"""Number of batches for a standard error, which is then accurate to about a quarter."""

FEWEST_WINDOWS, MOST_WINDOWS = BATCHES, 16 * BATCHES
"""Number of windows of the shortest and of the longest observation. The number doubles in between."""

SPLIT_MIN_WINDOWS = 8 * FEWEST_WINDOWS
"""Least number of windows if irregular lanes of a point differ: one may have rested during the shortest observation."""

CONVERGED_STDERR = float(np.log1p(IRREGULAR_WITHIN)) / RESOLUTION_STDERRS
"""Greatest relative standard error of a converged statistic: `RESOLUTION_STDERRS` of it equal the resolution."""

ORBIT_WINDOWS_FRACTION = 4
"""A lane has reached an orbit if it is periodic in every window of the last quarter; this is the divisor."""

LANES_TOGETHER = 4096
"""Greatest number of lanes that are stepped together, which bounds memory use."""

Windows = Float[np.ndarray, "windows fields lanes"]
"""Fields per window: total of each statistic, count of each, the lane's cycles, and 1 if it is finite and finished."""

Links = dict[tuple[int, int], float]
"""Distance between two motions of one attractor, by the indices of the motions, the lower index first."""


class Statistics(NamedTuple):
    """Statistics of lanes, their relative standard errors, and which lanes have converged.

    `lost`: lanes that cannot converge, because they have reached an orbit or are not sound. A lane on an orbit had not
    settled when the sweep labelled it.
    """

    values: Float[np.ndarray, "statistics lanes"]
    errors: Float[np.ndarray, "statistics lanes"]
    converged: Bool[np.ndarray, " lanes"]
    lost: Bool[np.ndarray, " lanes"]


@dataclass(frozen=True, eq=False)
class Motion:
    """Final motion of some lanes of one grid point.

    - `cell`: index of the grid point; `lanes`: indices of the lanes; `regime`: their most frequent regime.
    - `orbit`: the single orbit of a periodic motion; else None.
    - `statistics`: natural logarithms of the statistics of an irregular motion; else None.
    """

    cell: int
    lanes: Index
    regime: int
    orbit: Orbits | None = None
    statistics: np.ndarray | None = None

    @property
    def cycles(self) -> int:
        """Period of the orbit in returns to the section; 0 for other motions."""
        return 0 if self.orbit is None else self.orbit.states.shape[1]


def with_long_statistics(
    sweep: Sweep, dataset: xr.Dataset, lanes: Index, fewest: int = FEWEST_WINDOWS, progress: bool = True
) -> xr.Dataset:
    """Return the dataset of `sweep` with statistics of `lanes` (indices) over at least `fewest` windows.

    The relative standard errors of the statistics and `converged` are added. `converged` is False if an error exceeds
    `CONVERGED_STDERR` after `MOST_WINDOWS` windows, or if the lane has reached an orbit.
    """
    names = [name for name in STATISTICS if name in dataset]
    length, (values, errors) = sweep.run.observe, np.full((2, len(names), len(lanes)), np.nan)
    converged = np.zeros(len(lanes), bool)
    with quiet(), Progress(len(lanes), "irregular lanes", progress and len(lanes) > 0) as bar:
        for first in range(0, len(lanes), LANES_TOGETHER):
            active = np.arange(first, min(first + LANES_TOGETHER, len(lanes)))
            inputs = sweep.inputs_of(lanes[active])
            run = lane_run(inputs, sweep.plan)
            batch, windows, count, now = run.before_observation(inputs), list[np.ndarray](), fewest, sweep.run.settle
            while len(active):
                while len(windows) < count:
                    [batch] = run.engine.settle([batch.observed(now, np.full(len(active), length))])
                    windows.append(_window(run.engine.observe([batch])[0], names))
                    now += length
                found = statistics(np.stack(windows))
                done = found.converged | found.lost | (count >= MOST_WINDOWS)
                for whole, part in zip((values, errors, converged), found[:3], strict=True):
                    whole[..., active[done]] = part[..., done]
                bar.add(int(done.sum()))
                batch, active, count = batch.of(np.flatnonzero(~done)), active[~done], 2 * count
                windows = [window[:, ~done] for window in windows]
    columns = {"converged": converged, **dict(zip(names, values, strict=True))}
    columns |= {f"{name}_stderr": error for name, error in zip(names, errors, strict=True)}
    for name, of_lanes in columns.items():
        fill = name == "converged"  # until now, no lane was observed for longer
        before = dataset[name] if name in dataset else xr.full_like(dataset["regime"], fill, of_lanes.dtype)
        column = before.values.copy()
        column.flat[lanes] = of_lanes
        dataset = dataset.assign({name: before.copy(data=column)})
    return dataset


def observe_irregular(runs: list[tuple[Sweep, xr.Dataset]], progress: bool) -> xr.Dataset:
    """Return the lanes of all runs, joined along `start`; irregular lanes have statistics of a longer observation.

    If the irregular lanes of a point differ, they are observed even longer.
    """
    shape, split = runs[0][0].shape[:-1], None
    for fewest in (FEWEST_WINDOWS, SPLIT_MIN_WINDOWS):
        mask = np.ones(shape, bool) if split is None else np.isin(np.arange(np.prod(shape)), split).reshape(shape)
        for k, (sweep, dataset) in enumerate(runs):
            lanes = np.flatnonzero((dataset["regime"].values == IRREGULAR) & mask[..., None])
            runs[k] = sweep, with_long_statistics(sweep, dataset, lanes, fewest, progress)
        names = [name for name in runs[0][1].data_vars if all(name in dataset for _, dataset in runs)]
        plain = [dataset[names].reset_coords(drop=True).drop_vars("start", errors="ignore") for _, dataset in runs]
        joined = xr.concat(plain, "start", data_vars="minimal")
        starts = joined.sizes["start"]
        split = [int(groups[0][0]) // starts for groups in irregular_groups(joined, starts) if len(groups) > 1]
    return joined


def _window(features: Features, names: list[str]) -> Float[np.ndarray, "fields lanes"]:
    """Return the fields of `Windows` of one window."""
    returns = np.maximum(features["returns"] - 1, 0.0)
    impacts = features.get("impacts", np.zeros_like(returns)) * returns / np.maximum(features["cycles"], 1)
    weight = {"period": returns, "impact_velocity": impacts}
    counts = [np.nan_to_num(weight.get(name, np.ones_like(returns))) for name in names]
    totals = [np.nan_to_num(features[name]) * count for name, count in zip(names, counts, strict=True)]
    return np.stack([*totals, *counts, features["cycles"], features["finite"] & features["finished"]]).astype(float)


def statistics(windows: Windows) -> Statistics:
    """Return the statistics over all windows, with standard errors from batches of windows."""
    each = windows.reshape(BATCHES, -1, *windows.shape[1:]).sum(axis=1)
    totals, counts = np.split(each[:, :-2], 2, axis=1)
    total = totals.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = total / counts.sum(axis=0)
        residual = totals - values * counts
        errors = np.sqrt(np.sum(residual**2, axis=0) * BATCHES / (BATCHES - 1)) / np.abs(total)
    errors = np.where(total == 0, 0.0, errors)
    on_orbit = np.all(windows[-(len(windows) // ORBIT_WINDOWS_FRACTION) :, -2] > 0, axis=0)
    lost = on_orbit | ~np.all(windows[:, -1] > 0, axis=0)
    return Statistics(values, errors, np.all(errors <= CONVERGED_STDERR, axis=0) & ~lost, lost)


def classify_motions(
    scene: Scene[Any], dataset: xr.Dataset, parameters: Mapping[str, np.ndarray], starts: int
) -> list[Motion]:
    """Return the final motions of the lanes, point by point.

    **Arguments:** `scene`: scene of the return map; `dataset`: lanes with orbits, whose last dimension is `start`;
    `parameters`: parameter values of the lanes by name; `starts`: number of lanes per point, which are adjacent.
    """
    motions: list[Motion] = []
    states = np.stack([dataset[orbit_name(name)].values.ravel() for name in scene.return_states], axis=1)
    cycles, regime = dataset["orbit_cycles"].values.ravel(), dataset["regime"].values.ravel()
    # An orbit next to a graze counts although it has no multipliers; on an unstable orbit no lane stays.
    has_orbit = np.isfinite(states).all(axis=1) & (cycles > 0) & (dataset["stable"].values.ravel() != 0)
    remaining = has_orbit & ~np.isin(regime, (EQUILIBRIUM, FAILED, UNDECIDED))
    while remaining.any():  # the orbit of each point's first lane, then that of its first lane on another orbit, ...
        cells = {int(lanes[0]): lanes for lanes in _split_by_cell(np.flatnonzero(remaining), starts)}
        orbits: dict[int, Orbits] = {}
        for batch in orbits_of(scene, dataset, parameters, np.array([*cells])):
            orbits |= {lane: batch.of([k]) for k, lane in enumerate(batch.lane.tolist())}
        for first, lanes in cells.items():
            same = orbits[first].contain(states[lanes]) & (cycles[lanes] == cycles[first])
            same[0] = True  # the lane whose orbit this is, whatever the scales
            label = int(np.argmax(np.bincount(regime[lanes[same]])))
            motions.append(Motion(first // starts, lanes[same], label, orbits[first]))
            remaining[lanes[same]] = False
    for lanes in _split_by_cell(np.flatnonzero(regime == EQUILIBRIUM), starts):
        motions.append(Motion(int(lanes[0]) // starts, lanes, EQUILIBRIUM))
    # Without Lyapunov exponents, a few irregular lanes similar to a larger group may belong to it or not; they stay
    # unassigned.
    values = _log_statistics(dataset)
    for groups in irregular_groups(dataset, starts):
        centres = [np.median(values[lanes], axis=0) for lanes in groups]
        large = [centre for lanes, centre in zip(groups, centres, strict=True) if len(lanes) >= IRREGULAR_MIN_LANES]
        for lanes, centre in zip(groups, centres, strict=True):
            tail = any(np.abs(centre - other).max() <= np.log(SIMILAR_FACTOR) for other in large)
            if len(lanes) >= IRREGULAR_MIN_LANES or not tail or "nature" in dataset:
                motions.append(Motion(int(lanes[0]) // starts, lanes, IRREGULAR, statistics=centre))
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
    names = [f"{name}_stderr" for name in STATISTICS if name in dataset]
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


def _log_statistics(dataset: xr.Dataset) -> Float[np.ndarray, "lanes statistics"]:
    """Return the logarithms of the lanes' statistics; undefined statistics become values far from all defined ones."""
    values = np.stack([dataset[name].values.ravel() for name in STATISTICS if name in dataset], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(values > 0, np.log(values), -_FAR_APART)


def join_chains(x: Float[np.ndarray, "lanes values"], margins: Float[np.ndarray, "lanes values"]) -> Index:
    """Return the group number of each lane. Lanes are in the same group if a chain of lanes connects them.

    Neighbours in a chain differ by at most about 1 in every value.

    **Arguments:** `x`: values of the lanes; `margins`: additional difference allowed for each lane. The margins of two
    lanes add in quadrature.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Values rounded to quarters make many lanes equal, which keeps the number of pairs small.
    cells, index = np.unique(np.hstack([np.round(4 * x), np.ceil(4 * margins)]), axis=0, return_inverse=True)
    cells, wider = np.hsplit(cells, 2)
    reach = 4.0 + 2**0.5 * wider.max(initial=0.0)
    pairs = cKDTree(cells).query_pairs(reach, p=np.inf, output_type="ndarray")
    first, second = pairs.T
    near = np.all(np.abs(cells[first] - cells[second]) <= 4.0 + np.hypot(wider[first], wider[second]), axis=1)
    links = coo_array((near[near], (first[near], second[near])), shape=(len(cells), len(cells)))
    return np.asarray(connected_components(links, directed=False)[1])[index.ravel()]


def _split_by_cell(lanes: Index, starts: int) -> list[Index]:
    """Split lanes into one array per grid point, in order."""
    return np.split(lanes, np.flatnonzero(np.diff(lanes // starts)) + 1) if len(lanes) else []


def find_links(
    scene: Scene[Any],
    parameters: Mapping[str, Float[np.ndarray, " points"]],
    shape: tuple[int, ...],
    motions: Sequence[Motion],
) -> Links:
    """Return the links between motions of neighbouring grid points; they do not depend on the direction of axes.

    A stable orbit is continued by Newton's method to the neighbour's parameters, and linked to the orbit there that it
    becomes, if any. Continued backwards through its period doubling, an orbit becomes the orbit from which it
    bifurcated, and so do twins beyond their pitchfork. Neighbouring equilibria are linked, and so are irregular motions
    of similar statistics.

    **Arguments:** `parameters`: values at the points by name, in row-major order over the grid's `shape`.
    """
    in_cell: dict[int, list[int]] = defaultdict(list)
    for index, motion in enumerate(motions):
        in_cell[motion.cell].append(index)
    numbers = np.arange(int(np.prod(shape, dtype=int))).reshape(shape)
    neighbours: list[tuple[int, int]] = []
    for axis in range(len(shape)):
        rows = np.moveaxis(numbers, axis, 0)
        ends = rows[:-1].ravel().tolist(), rows[1:].ravel().tolist()
        neighbours += [*zip(*ends, strict=True), *zip(*ends[::-1], strict=True)]
    links: Links = {}
    carried: dict[int, dict[tuple[int, int], Orbits]] = defaultdict(dict)  # by cycles: orbit, and cell that it goes to
    for here, there in neighbours:
        for index, other in product(in_cell[here], in_cell[there]):
            own, beside = motions[index], motions[other]
            if own.orbit is not None and beside.orbit is not None:
                carried[own.cycles][index, there] = own.orbit
            elif own.regime == beside.regime == EQUILIBRIUM:
                links[min(index, other), max(index, other)] = 0.0
            elif own.statistics is not None and beside.statistics is not None:
                distance = float(np.abs(own.statistics - beside.statistics).max())
                if distance <= np.log(SIMILAR_FACTOR):
                    links[min(index, other), max(index, other)] = distance
    for same_cycles in carried.values():
        orbits, cells = Orbits.joined(same_cycles.values()), np.array([cell for _, cell in same_cycles])
        final, arrived = orbits.carry_to(
            {name: x[cells] for name, x in parameters.items()},
            within=PREDICTION_WITHIN,
            first=MATCHING_FIRST_STEP,
            least=MATCHING_MIN_STEP,
            accept=lambda orbits: orbits.stable,
            scales=orbits.scales,
            go=Segments(scene),
        )
        for k, (index, cell) in enumerate(same_cycles):
            for other in in_cell[cell] if arrived[k] else ():
                orbit = motions[other].orbit
                if orbit is not None and final.of([k]).same_as(orbit)[0]:
                    # Distance between the two orbits: that between their nearest states.
                    apart = np.abs(orbits.states[k][:, None] - orbit.states) / ((orbits.scales[k] + orbit.scales) / 2)
                    links[min(index, other), max(index, other)] = float(apart.max(axis=2).min())
    return links


def numbered_motions(
    runs: list[tuple[Sweep, xr.Dataset]], progress: bool
) -> tuple[xr.Dataset, list[Motion], Int[np.ndarray, " motions"]]:
    """Return the lanes of all runs, joined along `start`, their motions, and the attractor number of each motion.

    Attractors are numbered from 0 by decreasing number of lanes of the first run; further runs do not count. Equal
    numbers are ordered by increasing values of the axes, so that numbers do not depend on the direction of the axes.
    """
    sweep, _ = runs[0]
    *shape, starts = sweep.shape
    scene, observed = sweep.system.driving_part(), observe_irregular(runs, progress)
    values, _ = sweep.lane_values(0, sweep.lanes)
    points = {name: values[name][::starts] for name in scene.parameters()}
    each = observed.sizes["start"]
    ranks = [*product(*(np.argsort(np.argsort(axis)).tolist() for axis in sweep.axes.values()))]  # of each point

    def count(motion: Motion) -> int:
        return int((motion.lanes % each < starts).sum())

    motions = classify_motions(scene, observed, {name: np.repeat(x, each) for name, x in points.items()}, each)
    motions.sort(key=lambda motion: (*ranks[motion.cell], -count(motion)))
    links = find_links(scene, points, tuple(shape), motions)
    number = number_attractors([motion.cell for motion in motions], [*map(count, motions)], links)
    kept = ~is_ambiguous(motions, number)
    motions = [motion for motion, counts_too in zip(motions, kept, strict=True) if counts_too]
    return observed, motions, np.unique(number[kept], return_inverse=True)[1]


def number_attractors(cells: Sequence[int], lanes: Sequence[int], links: Links) -> Int[np.ndarray, " motions"]:
    """Return the attractor number of each motion. Attractors are numbered from 0 by decreasing number of lanes.

    Linked motions have the same number, but no two motions of one point do. Links are processed in order of increasing
    distance. A link that would give two motions of one point the same number is dropped: near a cusp, two attractors
    are connected through other motions. Numbers therefore do not depend on the direction of the axes.

    **Arguments:** `cells`, `lanes`: grid point and number of lanes of each motion. Of attractors with equally many
    lanes, the one with the first motion has the lower number.
    """
    from scipy.cluster.hierarchy import DisjointSet  # slow to import

    groups, points = DisjointSet(range(len(cells))), [{cell} for cell in cells]
    for pair in sorted(links, key=lambda pair: (links[pair], pair)):
        small, large = sorted((groups[motion] for motion in pair), key=lambda root: len(points[root]))
        if points[small].isdisjoint(points[large]):
            points[large] |= points[small]
            groups.merge(small, large)
            points[groups[large]] = points[large]
    ranked = sorted(groups.subsets(), key=lambda own: (-sum(lanes[motion] for motion in own), min(own)))
    number = np.zeros(len(cells), int)
    for place, own in enumerate(ranked):
        number[list(own)] = place
    return number


def is_ambiguous(motions: Sequence[Motion], number: Int[np.ndarray, " motions"]) -> Bool[np.ndarray, " motions"]:
    """Return which irregular motions may be remnants of transients, or outliers of another motion at their point.

    Such a motion has fewer lanes than another irregular motion at its point, and its attractor (`number`) has fewer
    than `IRREGULAR_MIN_LANES` lanes at every point.
    """
    lanes = pd.Series([len(motion.lanes) for motion in motions], dtype=int)
    cell = np.array([motion.cell for motion in motions], int)
    irregular = np.array([motion.regime for motion in motions], int) == IRREGULAR
    most_of_attractor = lanes.groupby(number).transform("max")
    most_of_cell = lanes.where(irregular, 0).groupby(cell).transform("max")
    return np.asarray(irregular & (most_of_attractor < IRREGULAR_MIN_LANES) & (lanes < most_of_cell))
