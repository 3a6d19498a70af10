"""Lanes of a point that end in the same motion: by their orbit, or by statistics where they do not repeat."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.io.variables import NATURES, orbit_name
from vibrojax.measures.labels import EQUILIBRIUM, FAILED, IRREGULAR, UNDECIDED
from vibrojax.models.scenes import Scene
from vibrojax.periodic.of_dataset import known_orbits

SAME = 1e-4
"""Distance over the scales within which two orbits of a point are the same; they are found to 1e-10."""

IRREGULAR_WITHIN = 0.25
"""Resolution of irregular motions: two that differ by no more than this part in every statistic are one."""

ERRORS = 4.5
"""Standard errors, of the difference of two lanes, by which the resolution widens: 99.7 % with 7 degrees of freedom."""

IRREGULAR_FACTOR = 2.0
"""Factor within which the statistics of two irregular motions are near each other: of neighbouring points, so that they
may be one attractor; of a point, so that one of few lanes may be the tail of the other's scatter."""

FEWEST = 3
"""Lanes from which an irregular motion is told beside another one of its point."""

EXPONENT_WITHIN = 4.0
"""The same of their exponents, where they are known, over the standard error; at least `LEAST_ERROR`."""

LEAST_ERROR = 1e-3
"""Standard error [1/s] that an exponent has at least: of lanes that come to a long repeat it is next to none."""

STATISTICS = ("period", "impact_velocity", "bit_amplitude", "striker_amplitude")
"""What irregular lanes are compared by, where there is any."""

_APART = 1e3  # farther than any two values


def stderr_name(statistic: str) -> str:
    """Return the name of the relative standard error of a statistic."""
    return f"{statistic}_stderr"


Index = Int[np.ndarray, " _"]


@dataclass
class Motions:
    """The motions of all points, and which of them each lane ends in.

    - `of_lane` (lanes,): by number; -1 where it could not be told.
    - `cell`: the point of each motion; `regime`: of most of its lanes; `cycles`: of an orbit, 0 of others.
    - `states` (cycles, states) at the section and `scales` (states,) of orbits; `statistics` of irregular motions, as
      logarithms; None for others.
    - `most_steps`: after which a return of a neighbour of the orbits is taken not to come.
    """

    of_lane: Index
    cell: list[int] = field(default_factory=list)
    cycles: list[int] = field(default_factory=list)
    regime: list[int] = field(default_factory=list)
    states: list[np.ndarray | None] = field(default_factory=list)
    scales: list[np.ndarray | None] = field(default_factory=list)
    statistics: list[np.ndarray | None] = field(default_factory=list)
    most_steps: float = 0.0

    def leave_out(self, which: Bool[np.ndarray, " motions"]) -> None:
        """Take motions away; their lanes are in none that could be told."""
        kept = np.flatnonzero(~which)
        place = np.append(np.where(which, -1, np.cumsum(~which) - 1), -1)
        self.of_lane = place[self.of_lane]
        for name in ("cell", "cycles", "regime", "states", "scales", "statistics"):
            setattr(self, name, [getattr(self, name)[one] for one in kept.tolist()])

    def add(
        self,
        lanes: Index,
        cell: int,
        regime: int,
        states: np.ndarray | None = None,
        scales: np.ndarray | None = None,
        statistics: np.ndarray | None = None,
    ) -> None:
        """Enter a motion of a point and the lanes that end in it."""
        self.of_lane[lanes] = len(self.cell)
        self.cell.append(cell)
        self.cycles.append(0 if states is None else len(states))
        self.regime.append(regime)
        self.states.append(states)
        self.scales.append(scales)
        self.statistics.append(statistics)


def told_apart(scene: Scene[Any], dataset: xr.Dataset, parameters: Mapping[str, np.ndarray], starts: int) -> Motions:
    """The motions that lanes end in, point by point.

    **Arguments:** `scene`: what the return map is of; `dataset`: with orbits, the start its last dimension;
    `parameters` of the lanes by name; `starts`: lanes of a point, which stand one after the other.
    """
    regime = dataset["regime"].values.ravel()
    motions = Motions(np.full(regime.size, -1))
    _by_orbit(scene, dataset, parameters, starts, motions)
    for some in _by_cell(np.flatnonzero(regime == EQUILIBRIUM), starts):
        motions.add(some, int(some[0]) // starts, EQUILIBRIUM)
    _by_statistics(dataset, starts, motions)
    return motions


def _by_orbit(
    scene: Scene[Any], dataset: xr.Dataset, parameters: Mapping[str, np.ndarray], starts: int, motions: Motions
) -> None:
    """Enter the orbits: of each point the first lane's, then that of the first lane that is on none of them yet."""
    states = np.stack([dataset[orbit_name(name)].values.ravel() for name in scene.return_states], axis=1)
    cycles, regime = dataset["orbit_cycles"].values.ravel(), dataset["regime"].values.ravel()
    # An orbit beside a graze has no multipliers, and is one all the same; on an unstable one no lane stays.
    there = np.isfinite(states).all(axis=1) & (cycles > 0) & (dataset["stable"].values.ravel() != 0)
    left = np.flatnonzero(there & ~np.isin(regime, (EQUILIBRIUM, FAILED, UNDECIDED)))
    while len(left):
        cells = _by_cell(left, starts)
        known = known_orbits(scene, dataset, parameters, np.array([some[0] for some in cells]))
        motions.most_steps = max(motions.most_steps, known.most_steps)
        for some, orbit, scale in zip(cells, known.states, known.scales, strict=True):
            apart = np.abs(states[some, None] - orbit[None]) / scale
            mine = (apart.max(axis=2).min(axis=1) < SAME) & (cycles[some] == len(orbit))
            mine[0] = True  # itself, whatever its scales
            label = int(np.argmax(np.bincount(regime[some[mine]])))
            motions.add(some[mine], int(some[0]) // starts, label, orbit, scale)
        left = left[motions.of_lane[left] < 0]


def _by_statistics(dataset: xr.Dataset, starts: int, motions: Motions) -> None:
    """Enter the irregular motions.

    By statistics alone, few lanes beside many that are near them may be another motion or a part of the same, so they
    are left out.
    """
    for groups in irregular_groups(dataset, starts):
        middles = [np.median(_statistics(dataset, lanes), axis=0) for lanes in groups]
        many = [middle for lanes, middle in zip(groups, middles, strict=True) if len(lanes) >= FEWEST]
        for lanes, middle in zip(groups, middles, strict=True):
            tail = any(np.abs(middle - other).max() <= np.log(IRREGULAR_FACTOR) for other in many)
            if len(lanes) >= FEWEST or not tail or "nature" in dataset:
                motions.add(lanes, int(lanes[0]) // starts, IRREGULAR, statistics=middle)


def irregular_groups(dataset: xr.Dataset, starts: int) -> list[list[Index]]:
    """Return the irregular lanes of each point in groups of one motion each, joined by chains of near lanes.

    Exponents are compared where they are known, because they are over thousands of returns. Otherwise statistics are,
    as for quasi-periodic lanes, whose exponent is 0. Lanes whose statistics have not converged are in no group.
    """
    irregular = dataset["regime"].values.ravel() == IRREGULAR
    if "converged" in dataset:
        irregular &= dataset["converged"].values.ravel()
    values, margins = _scaled_statistics(dataset)
    if "nature" in dataset:
        nature, exponent, error = (dataset[name].values.ravel() for name in ("nature", "lyapunov", "lyapunov_stderr"))
        irregular &= nature != NATURES.index("not-settled")
        known = irregular & np.isin(nature, [NATURES.index("chaotic"), NATURES.index("periodic")])
        for lanes in _by_cell(np.flatnonzero(known), starts):
            typical = max(float(np.median(error[lanes])), LEAST_ERROR)
            values[lanes] = margins[lanes] = 0.0
            values[lanes, 0] = exponent[lanes] / (EXPONENT_WITHIN * typical)
        values = np.column_stack([values, _APART * nature.astype(float)])
        margins = np.column_stack([margins, np.zeros(len(margins))])
    found = []
    for lanes in _by_cell(np.flatnonzero(irregular), starts):
        group = joined_within(values[lanes], margins[lanes])
        found.append([lanes[group == number] for number in range(int(group.max()) + 1)])
    return found


def doubtful(motions: Motions, number: Int[np.ndarray, " motions"]) -> Bool[np.ndarray, " motions"]:
    """Which irregular motions cannot be told: another one of their point has more lanes, and nowhere over the grid does
    their attractor, by `number`, have `FEWEST`: they may be what is left of transients, or tails of the other."""
    lanes = np.bincount(motions.of_lane[motions.of_lane >= 0], minlength=len(number))
    irregular = np.array(motions.regime, int) == IRREGULAR
    most = np.zeros(int(number.max(initial=-1)) + 1, int)
    np.maximum.at(most, number, lanes)
    at_point = np.zeros(max(motions.cell, default=-1) + 1, int)
    np.maximum.at(at_point, np.array(motions.cell, int)[irregular], lanes[irregular])
    return irregular & (most[number] < FEWEST) & (lanes < at_point[np.array(motions.cell, int)])


def _statistics(dataset: xr.Dataset, lanes: Index | slice = slice(None)) -> Float[np.ndarray, "_ statistics"]:
    """The logarithms of what irregular lanes are compared by; of motions without it, far from all that have it."""
    values = np.stack([dataset[name].values.ravel()[lanes] for name in STATISTICS if name in dataset], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(values > 0, np.log(values), -_APART)


def _scaled_statistics(
    dataset: xr.Dataset,
) -> tuple[Float[np.ndarray, "_ statistics"], Float[np.ndarray, "_ statistics"]]:
    """Return the logarithms of the lanes' statistics and `ERRORS` standard errors of them, over the resolution."""
    values = _statistics(dataset)
    names = [stderr_name(name) for name in STATISTICS if name in dataset]
    errors = [dataset[name].values.ravel() if name in dataset else np.zeros(len(values)) for name in names]
    resolution = np.log1p(IRREGULAR_WITHIN)
    return values / resolution, ERRORS * np.stack(errors, axis=1) / resolution


def joined_within(
    x: Float[np.ndarray, "lanes values"], margins: Float[np.ndarray, "lanes values"] | None = None
) -> Index:
    """Return the group of each lane. Chains of steps join a group, each no longer than about 1 in any value.

    `margins`: by how much the step to or from a lane may be longer; those of two lanes add as the root of squares.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # To a quarter of a step, so that pairs of thousands of lanes stay few.
    wider = np.zeros_like(x) if margins is None else np.ceil(4 * margins)
    cells, index = np.unique(np.hstack([np.round(4 * x), wider]), axis=0, return_inverse=True)
    cells, wider = np.hsplit(cells, 2)
    reach = 4.0 + 2**0.5 * wider.max(initial=0.0)
    pairs = cKDTree(cells).query_pairs(reach, p=np.inf, output_type="ndarray")
    one, other = pairs.T
    near = np.abs(cells[one] - cells[other]) <= 4.0 + np.hypot(wider[one], wider[other])
    pairs = pairs[near.all(axis=1)]
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return np.asarray(connected_components(links, directed=False)[1])[index.ravel()]


def _by_cell(lanes: Index, starts: int) -> list[Index]:
    """The lanes of each point, in order."""
    if not len(lanes):
        return []
    return np.split(lanes, np.flatnonzero(np.diff(lanes // starts)) + 1)
