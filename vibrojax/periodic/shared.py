"""Lanes of one point that end on the same orbits: each orbit is found of one lane, and the others are held against it.

Of hundreds of starts of a point most lead to one of a few orbits. What is known of them when a lane is looked at is
what lanes of its own chunk have led to, so that it follows from the sweep alone.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int

from vibrojax.periodic.approach import NEAR, Approach, distance
from vibrojax.periodic.early import EarlyEnds, OnOrbits
from vibrojax.periodic.newton import Found
from vibrojax.sweep.engine.batch import Batch, Features
from vibrojax.sweep.engine.underway import Ended

Index = Int[np.ndarray, " _"]


class Known:
    """Orbits of points that are known, all of as many returns."""

    def __init__(self) -> None:
        self._points = np.zeros(0, int)
        self._orbits: list[Found] = []
        self._features: list[Features] = []

    def __len__(self) -> int:
        return len(self._points)

    def add(self, points: Index, found: OnOrbits) -> None:
        """Enter orbits, each of one of the `points`."""
        self._points = np.concatenate([self._points, points])
        self._orbits.append(found.orbits)
        self._features.append(found.features)

    def candidates(self, points: Index, since: int) -> Iterator[Index]:
        """An orbit that a lane of each of the `points` may be on, by number, -1: none; then the next; of those that
        are known from the number `since` on."""
        numbers = np.arange(since, len(self))
        rank = _rank(self._points[since:])
        for nth in range(int(rank.max(initial=-1)) + 1):
            of_point = np.full(max(self._points.max(), points.max(initial=0)) + 1, -1)
            of_point[self._points[numbers[rank == nth]]] = numbers[rank == nth]
            yield of_point[points]

    def orbits(self, which: Index) -> Found:
        """Orbits by their numbers."""
        return Found(*(np.concatenate(x)[which] for x in zip(*self._orbits, strict=True)))

    def features(self, which: Index) -> Features:
        """What was measured over them."""
        return {name: np.concatenate([one[name] for one in self._features])[which] for name in self._features[0]}


class SharedEnds:
    """Finds lanes of a sweep that are where they will be, by the orbits that other lanes of their point led to."""

    def __init__(self, alone: EarlyEnds) -> None:
        self._alone = alone
        self._known: dict[int, Known] = {}  # by returns of a repeat
        self._numbers: dict[bytes, int] = {}  # of points, by their parameters

    def of_chunk(self) -> "SharedEnds":
        """The same, of which nothing is known yet."""
        return SharedEnds(self._alone)

    def near(self, batch: Batch) -> Bool[np.ndarray, " lanes"]:
        """Which lanes may be within the reach of an orbit, so that they are to be looked at."""
        return self._alone.near(batch)

    def __call__(self, batch: Batch) -> list[Ended]:
        """Those lanes of the `batch` that need no more steps, by their index in it."""
        return self._alone.among(batch, self._find)

    def _find(self, near: Approach, batch: Batch) -> list[Ended]:
        """Hold lanes against what is known; then one lane of each point is looked at by itself, two, four, ...; and
        those that are left are held against what that has found."""
        known = self._known.setdefault(near.limit.shape[1], Known())
        points = self._points(batch)
        ended, left = self._held(near, batch, points, known, 0, np.arange(len(near.lanes)))
        many = 1
        while len(left):
            before = len(known)
            first = _rank(points[left]) < many
            alone, left = left[first], left[~first]
            found = self._alone.on_orbits(near.of(alone), batch.of(alone))
            lanes = alone[found.lanes]
            if len(lanes):
                known.add(points[lanes], found)
                ended.append(self._alone.ended(near.lanes[lanes], found.features, batch.of(lanes)))
            more, left = self._held(near, batch, points, known, before, left)
            ended += more
            many *= 2
        return ended

    def _held(
        self, near: Approach, batch: Batch, points: Index, known: Known, since: int, left: Index
    ) -> tuple[list[Ended], Index]:
        """Those of the lanes that are `left` which will be on orbits that are known `since`; and those not near any."""
        mine, orbits = [], []
        for number in known.candidates(points, since):
            # A lane's newest return may be any of those of the repeat.
            for late in range(near.limit.shape[1]):
                lanes = left[number[left] >= 0]
                if not len(lanes):
                    break
                orbit, those = known.orbits(number[lanes]), near.of(lanes, late)
                there = self._alone.will_be_there(those, orbit, batch.of(lanes))
                mine.append(lanes[there])
                orbits.append(number[lanes[there]])
                # Newton's method would find the same orbit of one that is near it, but not there yet.
                left = left[~np.isin(left, lanes[there | (distance(those, orbit) < NEAR)])]
        lanes = np.concatenate([np.zeros(0, int), *mine])
        if not len(lanes):
            return [], left
        features = known.features(np.concatenate(orbits))
        return [self._alone.ended(near.lanes[lanes], features, batch.of(lanes))], left

    def _points(self, batch: Batch) -> Index:
        """The point of each lane, by number; told by the values of its parameters."""
        values = np.stack([np.asarray(x, float) for x in batch.given.parameters.values()], axis=1)
        return np.array([self._numbers.setdefault(row.tobytes(), len(self._numbers)) for row in values], int)


def _rank(points: Index) -> Index:
    """How many lanes of its point stand before each."""
    order = np.argsort(points, kind="stable")
    _, first, count = np.unique(points[order], return_index=True, return_counts=True)
    rank = np.empty(len(points), int)
    rank[order] = np.arange(len(points)) - np.repeat(first, count)
    return rank
