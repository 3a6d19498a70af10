"""Lanes of one point that end on the same orbits: each orbit is found of one lane, and the others are held against it.

Of hundreds of starts of a point most lead to one of a few orbits. What is known of them when a lane is looked at is
what lanes of its own chunk have led to, so that it follows from the sweep alone.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool

from vibrojax.engine.batch import Batch, Features, Index
from vibrojax.engine.underway import Ended
from vibrojax.periodic.approach import Approach
from vibrojax.periodic.early import EarlyEnds, OnOrbits
from vibrojax.periodic.newton import Found


class Known:
    """Orbits of points that are known, all of as many returns."""

    def __init__(self) -> None:
        self._of_point: dict[bytes, list[int]] = {}
        self._orbits: list[Found] = []
        self._features: list[Features] = []

    def __len__(self) -> int:
        return sum(map(len, self._of_point.values()))

    def add(self, points: Sequence[bytes], found: OnOrbits) -> None:
        """Enter orbits, each of one of the `points`."""
        for number, point in enumerate(points, start=len(self)):
            self._of_point.setdefault(point, []).append(number)
        self._orbits.append(found.orbits)
        self._features.append(found.features)

    def candidates(self, points: Sequence[bytes], lanes: Index, since: int) -> Iterator[tuple[Index, Index]]:
        """The `lanes`, and an orbit that each may be on, by number; then the next; of those from the number `since` on.

        `points`: of all lanes.
        """
        of_lane = [[number for number in self._of_point.get(points[lane], ()) if number >= since] for lane in lanes]
        for rank in range(max(map(len, of_lane), default=0)):
            some = [(lane, own[rank]) for lane, own in zip(lanes.tolist(), of_lane, strict=True) if len(own) > rank]
            yield tuple(np.array(one, int) for one in zip(*some, strict=True))

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
        points = _points(batch)
        ended, left = self._held(near, batch, points, known, 0, np.arange(len(near.lanes)))
        many = 1
        while len(left):
            before = len(known)
            alone = _first(points, left, many)
            found = self._alone.on_orbits(near.of(alone), batch.of(alone))
            lanes = alone[found.lanes]
            if len(lanes):
                known.add([points[lane] for lane in lanes], found)
                ended.append(self._alone.ended(near.lanes[lanes], found.features, batch.of(lanes)))
            left = np.setdiff1d(left, alone)
            more, left = self._held(near, batch, points, known, before, left)
            ended += more
            many *= 2
        return ended

    def _held(
        self, near: Approach, batch: Batch, points: Sequence[bytes], known: "Known", since: int, left: Index
    ) -> tuple[list[Ended], Index]:
        """Those of the lanes that are `left` which will be on orbits that are known `since`; and the others."""
        ended = []
        for lanes, which in known.candidates(points, left, since):
            lanes, which = lanes[np.isin(lanes, left)], which[np.isin(lanes, left)]
            for late in range(near.limit.shape[1]):
                if not len(lanes):
                    break
                orbit = known.orbits(which)
                there = self._alone.will_be_there(near.of(lanes, late), orbit, batch.of(lanes))
                if there.any():
                    mine, features = lanes[there], known.features(which[there])
                    ended.append(self._alone.ended(near.lanes[mine], features, batch.of(mine)))
                    left = np.setdiff1d(left, mine)
                    lanes, which = lanes[~there], which[~there]
        return ended, left


def _points(batch: Batch) -> list[bytes]:
    """The point of each lane, by the values of its parameters."""
    values = np.stack([np.asarray(x, float) for x in batch.given.parameters.values()], axis=1)
    return [row.tobytes() for row in values]


def _first(points: Sequence[bytes], lanes: Index, many: int) -> Index:
    """The first lanes of each point, so `many` at most."""
    seen: Counter[bytes] = Counter()
    chosen = []
    for lane in lanes.tolist():
        seen[points[lane]] += 1
        if seen[points[lane]] <= many:
            chosen.append(lane)
    return np.array(chosen, int)
