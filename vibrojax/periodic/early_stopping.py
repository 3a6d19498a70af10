"""Choice of the early-stopping method, and orbits shared by the many initial conditions of one parameter point.

Of hundreds of initial conditions at a parameter point, most lead to one of a few orbits. Newton's method is then run
for a few lanes only. The other lanes are compared with the orbits found. Orbits are shared only within a chunk of
lanes, so that results depend on the sweep alone.
"""

from collections.abc import Iterator
from copy import copy

import numpy as np
from jaxtyping import Int

from vibrojax.periodic.approach import NEAR_ORBIT, Approach, distance
from vibrojax.periodic.early import EarlyEnds, OnOrbits
from vibrojax.periodic.newton import PeriodicOrbits
from vibrojax.stepping import Located
from vibrojax.sweep.engine.batch import Batch, Features
from vibrojax.sweep.engine.underway import EarlyStopping, Ended
from vibrojax.sweep.input.definition import Sweep

EARLY_END_MIN_SECONDS = 5e6
"""Simulated seconds, summed over all lanes, below which compiling the return map takes longer than it saves.
Compilation takes 2 s of processor time. Early stopping saves 1.4 s per million simulated seconds over the parameter
region of the source. It saves only 0.4 s over the default map, where more lanes are irregular and most others settle
soon."""

SHARING_MIN_STARTS = 16
"""Smallest number of initial conditions per parameter point for which the lanes of a point share orbits."""

SHARING_MIN_SECONDS = 1.5e6
"""As `EARLY_END_MIN_SECONDS`, for shared orbits. There is no minimum for a sweep with `orbits`, which compiles the
return map anyway."""

Index = Int[np.ndarray, " _"]


def early_stopping_of(sweep: Sweep) -> EarlyStopping | None:
    """Return an object that finds lanes that can stop early, or None if this is impossible or saves no time."""
    run, scene = sweep.run, sweep.system.driving_part()
    if not isinstance(run.stepper, Located) or scene.section is None:
        return None
    seconds = sweep.lanes * (run.settle + run.observe)
    starts = 1.0
    if sweep.crosses_starts:
        starts = float(sweep.shape[-1])
    elif sweep.point_vectors is not None:  # points listed with their initial conditions: the average
        columns = [column.tolist() for column in (sweep.points or {}).values()]
        starts = sweep.lanes / max(len(set(zip(*columns, strict=True))), 1)
    if starts >= SHARING_MIN_STARTS:
        return SharedEnds(sweep) if run.orbits or seconds >= SHARING_MIN_SECONDS else None
    return EarlyEnds(sweep) if seconds >= EARLY_END_MIN_SECONDS else None


class OrbitPool:
    """Known orbits at parameter points, all with the same number of section crossings per period."""

    def __init__(self) -> None:
        self._points = np.zeros(0, int)
        self._orbits: list[PeriodicOrbits] = []
        self._features: list[Features] = []

    def __len__(self) -> int:
        return len(self._points)

    def add(self, points: Index, result: OnOrbits) -> None:
        """Add the orbits of `result`; `points`: number of each orbit's parameter point."""
        self._points = np.concatenate([self._points, points])
        self._orbits.append(result.orbits)
        self._features.append(result.features)

    def candidates(self, points: Index, since: int) -> Iterator[Index]:
        """Yield arrays with the number of one known orbit for each of `points`, until every orbit has been yielded.

        The number is -1 for a point without a further orbit. Orbits with numbers below `since` are skipped.
        """
        numbers = np.arange(since, len(self))
        rank = _rank_in_point(self._points[since:])
        for nth in range(int(rank.max(initial=-1)) + 1):
            of_point = np.full(max(self._points.max(), points.max(initial=0)) + 1, -1)
            of_point[self._points[numbers[rank == nth]]] = numbers[rank == nth]
            yield of_point[points]

    def orbits(self, numbers: Index) -> PeriodicOrbits:
        """Return the orbits with the given numbers."""
        return PeriodicOrbits(*(np.concatenate(x)[numbers] for x in zip(*self._orbits, strict=True)))

    def features(self, numbers: Index) -> Features:
        """Return the features measured on the orbits with the given numbers."""
        parts = self._features
        return {name: np.concatenate([part[name] for part in parts])[numbers] for name in parts[0]}


class SharedEnds(EarlyEnds):
    """Search for lanes of a sweep that can stop early, by comparison with orbits of other lanes at the same point."""

    def __init__(self, sweep: Sweep) -> None:
        super().__init__(sweep)
        self._pools: dict[int, OrbitPool] = {}  # keys: section crossings per period
        self._numbers: dict[bytes, int] = {}  # numbers of points; keys: their parameter values

    def of_chunk(self) -> "SharedEnds":
        """Return a copy without known orbits."""
        chunk = copy(self)
        chunk._pools, chunk._numbers = {}, {}
        return chunk

    def _find(self, near: Approach, batch: Batch) -> list[Ended]:
        """Compare lanes with known orbits, then alternate between Newton's method for a few lanes and new comparisons.

        Newton's method is run for one lane of each point at first, then for two, four, and so on.
        """
        pool = self._pools.setdefault(near.limit.shape[1], OrbitPool())
        values = np.stack([np.asarray(x, float) for x in batch.given.parameters.values()], axis=1)
        points = np.array([self._numbers.setdefault(row.tobytes(), len(self._numbers)) for row in values], int)
        ended, remaining = self._compare(near, batch, points, pool, 0, np.arange(len(near.lanes)))
        per_point = 1
        while len(remaining):
            before = len(pool)
            first = _rank_in_point(points[remaining]) < per_point
            solved, remaining = remaining[first], remaining[~first]
            result = self.on_orbits(near.of(solved), batch.of(solved))
            lanes = solved[result.lanes]
            if len(lanes):
                pool.add(points[lanes], result)
                ended.append(self.ended(near.lanes[lanes], result.features, batch.of(lanes)))
            more, remaining = self._compare(near, batch, points, pool, before, remaining)
            ended += more
            per_point *= 2
        return ended

    def _compare(
        self, near: Approach, batch: Batch, points: Index, pool: OrbitPool, since: int, remaining: Index
    ) -> tuple[list[Ended], Index]:
        """Return the `remaining` lanes that will be on orbits, and the lanes near none of these orbits.

        Only orbits with numbers from `since` on are considered.
        """
        matches, orbits = [], []
        for number in pool.candidates(points, since):
            # The newest section crossing of a lane may correspond to any state of the orbit.
            for late in range(near.limit.shape[1]):
                lanes = remaining[number[remaining] >= 0]
                if not len(lanes):
                    break
                orbit, approach = pool.orbits(number[lanes]), near.of(lanes, late)
                there = self.will_be_there(approach, orbit, batch.of(lanes))
                matches.append(lanes[there])
                orbits.append(number[lanes[there]])
                # For a lane that is near the orbit but not yet on it, Newton's method would find the same orbit.
                remaining = remaining[~np.isin(remaining, lanes[there | (distance(approach, orbit) < NEAR_ORBIT)])]
        lanes = np.concatenate([np.zeros(0, int), *matches])
        if not len(lanes):
            return [], remaining
        features = pool.features(np.concatenate(orbits))
        return [self.ended(near.lanes[lanes], features, batch.of(lanes))], remaining


def _rank_in_point(points: Index) -> Index:
    """Return, for each lane, the number of earlier lanes at the same point."""
    order = np.argsort(points, kind="stable")
    _, first, count = np.unique(points[order], return_index=True, return_counts=True)
    rank = np.empty(len(points), int)
    rank[order] = np.arange(len(points)) - np.repeat(first, count)
    return rank
