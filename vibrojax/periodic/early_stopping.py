"""Choice of the early end of lanes on orbits, and orbits shared by the many starts of a point.

Of hundreds of starts of a point most lead to one of a few orbits. Newton's method is then run for a few lanes only, and
the others are compared with the orbits found. Orbits are shared within a chunk only, so that they depend on the sweep
alone.
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
"""Simulated seconds of all lanes below which compiling the return map takes longer than it saves. Compilation takes 2 s
of processor time. A million simulated seconds save 1.4 s over the source's region, but only 0.4 s over the default map,
where more lanes are irregular and most others settle soon."""

SHARING_MIN_STARTS = 16
"""Starts of a point from which on its lanes share orbits."""

SHARING_MIN_SECONDS = 1.5e6
"""As `EARLY_END_MIN_SECONDS`, for shared orbits. A sweep with `orbits` compiles the return map anyway: no minimum."""

Index = Int[np.ndarray, " _"]


def early_stopping_of(sweep: Sweep) -> EarlyStopping | None:
    """Return an object that finds lanes that need no more steps; None where that is impossible or does not pay."""
    run, scene = sweep.run, sweep.system.driving_part()
    if not isinstance(run.stepper, Located) or scene.section is None:
        return None
    seconds = sweep.lanes * (run.settle + run.observe)
    starts = 1.0
    if sweep.crosses_starts:
        starts = float(sweep.shape[-1])
    elif sweep.point_vectors is not None:  # a list of points with their starts: the average
        columns = [column.tolist() for column in (sweep.points or {}).values()]
        starts = sweep.lanes / max(len(set(zip(*columns, strict=True))), 1)
    if starts >= SHARING_MIN_STARTS:
        return SharedEnds(sweep) if run.orbits or seconds >= SHARING_MIN_SECONDS else None
    return EarlyEnds(sweep) if seconds >= EARLY_END_MIN_SECONDS else None


class OrbitPool:
    """Known orbits of points, all with the same number of returns."""

    def __init__(self) -> None:
        self._points = np.zeros(0, int)
        self._orbits: list[PeriodicOrbits] = []
        self._features: list[Features] = []

    def __len__(self) -> int:
        return len(self._points)

    def add(self, points: Index, result: OnOrbits) -> None:
        """Add orbits, each of one of the `points`."""
        self._points = np.concatenate([self._points, points])
        self._orbits.append(result.orbits)
        self._features.append(result.features)

    def candidates(self, points: Index, since: int) -> Iterator[Index]:
        """Yield arrays with the number of a known orbit for each point, or -1, until all are yielded.

        Only orbits from the number `since` on are considered.
        """
        numbers = np.arange(since, len(self))
        rank = _rank_in_point(self._points[since:])
        for nth in range(int(rank.max(initial=-1)) + 1):
            of_point = np.full(max(self._points.max(), points.max(initial=0)) + 1, -1)
            of_point[self._points[numbers[rank == nth]]] = numbers[rank == nth]
            yield of_point[points]

    def orbits(self, numbers: Index) -> PeriodicOrbits:
        """Return orbits by number."""
        return PeriodicOrbits(*(np.concatenate(x)[numbers] for x in zip(*self._orbits, strict=True)))

    def features(self, numbers: Index) -> Features:
        """Return the features measured on orbits, by number."""
        parts = self._features
        return {name: np.concatenate([part[name] for part in parts])[numbers] for name in parts[0]}


class SharedEnds(EarlyEnds):
    """Finds lanes of a sweep that need no more steps, by the orbits that other lanes of their point led to."""

    def __init__(self, sweep: Sweep) -> None:
        super().__init__(sweep)
        self._pools: dict[int, OrbitPool] = {}  # by returns of a repeat
        self._numbers: dict[bytes, int] = {}  # of points, by their parameters

    def of_chunk(self) -> "SharedEnds":
        """Return a copy without known orbits."""
        chunk = copy(self)
        chunk._pools, chunk._numbers = {}, {}
        return chunk

    def _find(self, near: Approach, batch: Batch) -> list[Ended]:
        """Compare lanes with known orbits; then solve for one lane of each point, two, four, ..., and compare again."""
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
        """Return the `remaining` lanes that will be on orbits added after `since`, and the lanes near none of them."""
        matches, orbits = [], []
        for number in pool.candidates(points, since):
            # A lane's newest return may be any state of the orbit.
            for late in range(near.limit.shape[1]):
                lanes = remaining[number[remaining] >= 0]
                if not len(lanes):
                    break
                orbit, approach = pool.orbits(number[lanes]), near.of(lanes, late)
                there = self.will_be_there(approach, orbit, batch.of(lanes))
                matches.append(lanes[there])
                orbits.append(number[lanes[there]])
                # For a lane near the orbit, but not there yet, Newton's method would find the same orbit.
                remaining = remaining[~np.isin(remaining, lanes[there | (distance(approach, orbit) < NEAR_ORBIT)])]
        lanes = np.concatenate([np.zeros(0, int), *matches])
        if not len(lanes):
            return [], remaining
        features = pool.features(np.concatenate(orbits))
        return [self.ended(near.lanes[lanes], features, batch.of(lanes))], remaining


def _rank_in_point(points: Index) -> Index:
    """Return the number of earlier lanes of the same point, for each lane."""
    order = np.argsort(points, kind="stable")
    _, first, count = np.unique(points[order], return_index=True, return_counts=True)
    rank = np.empty(len(points), int)
    rank[order] = np.arange(len(points)) - np.repeat(first, count)
    return rank
