"""The branch of orbits on which a function of parameters is evaluated, continued from its first orbit to each point."""

from collections.abc import Mapping, Sequence
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.errors import Place, shown
from vibrojax.lanes.inputs import Features
from vibrojax.maps.read import Point
from vibrojax.maps.starts import list_of
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.derivatives import MARGIN, STABILITY
from vibrojax.periodic.lane_stages import run_lanes
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.settings.run_settings import RunSettings, read_settings

MAX_CACHED = 1024
"""Largest number of results that are kept for points that are evaluated again."""

SAME_BRANCH = 0.05
"""Largest distance, in half swings, between an orbit and its linear prediction. Otherwise the step is halved."""

LEAST_FRACTION = 1 / 64
"""Smallest step of the continuation, as a fraction of the way from the first orbit."""

SEARCHED = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Relative changes of the parameters at which the first orbit is searched, if there is none at the first point."""

Points = Float[np.ndarray, "lanes by"]


class Evaluated(NamedTuple):
    """Features of orbits, and their derivatives, which are NaN where unknown.

    - `valid`: mask of the points that have a stable orbit of their own.
    - `reached`: parameters of the orbit; the point's own if the branch reaches it.
    """

    values: Float[np.ndarray, "*lanes of"]
    derivatives: Float[np.ndarray, "*lanes of by"]
    valid: Bool[np.ndarray, "*lanes"]
    reached: Float[np.ndarray, "*lanes by"]


class Branch:
    """Orbits of one scene with the same numbers of section crossings and impacts, as functions of the parameters `by`.

    The first orbit is the one on which the motion from `start` settles at the point `at`, by default the first point
    that is evaluated. It is continued to each other point on the straight line, whatever was evaluated before: the
    states are predicted linearly, and corrected by Newton's method. An orbit is accepted if it is close to the
    prediction; otherwise the continuation takes smaller steps.
    """

    def __init__(
        self, point: Point, of: Sequence[str], by: Sequence[str], at: Float[np.ndarray, " by"] | None = None
    ) -> None:
        self.point, self.by, self.at = point, tuple(by), at
        self.of = tuple(dict.fromkeys((*of, STABILITY, MARGIN)))
        self._scale = np.array([abs(point.parameters[name]) or 1.0 for name in by])
        self._first: Orbits | None = None
        self._slopes = np.zeros(0)
        self._begun = False
        self._cached: dict[bytes, Evaluated] = {}
        self._lock = Lock()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_cached": {}, "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state | {"_lock": Lock()}

    def evaluate(self, x: Points) -> Evaluated:
        """Return the features at the points `x`; without an orbit there, of the last orbit on the way from the first.

        The features of a point are the same bit for bit, whatever the other points are.
        """
        with self._lock, np.errstate(all="ignore"):
            keys = [row.tobytes() for row in x]
            new = {key: row for key, row in zip(keys, x, strict=True) if np.isfinite(row).all()}
            new = {key: row for key, row in new.items() if key not in self._cached}
            if new:
                fresh = zip(*self._evaluate(np.stack([*new.values()])), strict=True)
                self._cached |= {key: Evaluated(*row) for key, row in zip(new, fresh, strict=True)}
            [none] = zip(*self.unknown(1), strict=True)
            rows = [self._cached.get(key, none) for key in keys]
            self._cached = dict([*self._cached.items()][-MAX_CACHED:])
            return Evaluated(*map(np.stack, zip(*rows, strict=True)))

    def reason(self, x: Float[np.ndarray, " by"]) -> str:
        """Return why the features at the point `x` are not valid, or "none"."""
        values, derivatives, valid, reached = (part[0] for part in self.evaluate(x[None]))
        if valid:
            return "none"
        if not np.isfinite(x).all():
            return f"undefined: {self.described(x)}"
        if self._first is None:
            start = "" if self.point.start is None else f" from {shown(self.point.start)}"
            where = "" if self.at is None else f" at {self.described(self.at)} or near it"
            return f"no-orbit: no motion{start} settles on a stable periodic orbit{where}"
        table = dict(zip(self.of, values, strict=True))
        if (reached != x).any():
            return (
                f"beyond-branch: from {self.described(self._reached(self._first)[0])}, the orbit continues to "
                f"{self.described(reached)}, with margin = {table[STABILITY]:.3g}, {MARGIN} = {table[MARGIN]:.3g}"
            )
        if table[STABILITY] >= 0:
            return f"unstable: a multiplier of the orbit has the modulus {np.exp(table[STABILITY]):.6g}"
        names = [name for name, row in zip(self.of, derivatives, strict=True) if not np.isfinite(row).all()]
        return f"undefined: the orbit has no derivative of {', '.join(names)}"

    def described(self, x: Float[np.ndarray, " by"]) -> str:
        """Return the parameters of a point as text."""
        return ", ".join(f"{name} = {value:g}" for name, value in zip(self.by, x, strict=True))

    def unknown(self, size: int) -> Evaluated:
        """Return the features of points without an orbit."""
        shape = (size, len(self.of), len(self.by))
        return Evaluated(
            np.full(shape[:2], np.nan), np.full(shape, np.nan), np.zeros(size, bool), np.full(shape[::2], np.nan)
        )

    def _evaluate(self, x: Points) -> Evaluated:
        if not self._begun:
            self.at = x[0].copy() if self.at is None else self.at
            self._begin(self.at)
            self._begun = True
        if self._first is None:
            return self.unknown(len(x))
        first, each = self._first, np.zeros(len(x), int)
        orbits, _ = first.of(each).carry_to(
            self._parameters(x),
            within=SAME_BRANCH,
            least=LEAST_FRACTION,
            by=self.by,
            slopes=self._slopes[each],
            accept=lambda orbits: (orbits.impacts == first.impacts) & ~orbits.neutral,
        )
        values, derivatives, *_ = orbits.derivatives(self.of, self.by)
        reached = self._reached(orbits)
        valid = (reached == x).all(axis=1) & (values[:, self.of.index(STABILITY)] < 0)
        return Evaluated(values, derivatives, valid & np.isfinite(derivatives).all(axis=(1, 2)), reached)

    def _parameters(self, x: Points) -> dict[str, np.ndarray]:
        fixed = {name: np.full(len(x), value) for name, value in self.point.parameters.items()}
        return fixed | {name: x[:, k] for k, name in enumerate(self.by)}

    def _reached(self, orbits: Orbits) -> Points:
        return np.stack([orbits.parameters[name] for name in self.by], axis=1)

    def _begin(self, x: Float[np.ndarray, " by"]) -> None:
        """Find the first orbit: at `x`, or else the nearest of the stable orbits at points around it."""
        corners = np.concatenate([np.eye(len(x)), -np.eye(len(x)), np.ones((1, len(x))), -np.ones((1, len(x)))])
        around = [x + share * corners * self._scale for share in SEARCHED]
        defaults = np.array([[self.point.parameters[name] for name in self.by]])
        table = [self.point.system.parameters()[name] for name in self.by]
        for points in (x[None], np.concatenate([*around, defaults])):
            admissible = [not any(p.problem(y) for p, y in zip(table, row, strict=True)) for row in points.tolist()]
            if any(admissible) and self._settle(points[admissible], x):
                return

    def _settle(self, rows: Points, x: Float[np.ndarray, " by"]) -> bool:
        """Settle from the start at the points `rows`; remember the stable orbit nearest to `x`; return success."""
        scene, lanes = self.point.system, settled_at(self.point, self.by, rows)
        distance = np.abs((rows - x) / self._scale).max(axis=1)
        known = {
            lane: batch.of([k])
            for batch in orbits_of(scene, lanes, self._parameters(rows))
            for k, lane in enumerate(batch.lane.tolist())
            if lanes["stable"][lane] == 1
        }
        for lane in sorted(known, key=lambda lane: (distance[lane], lane)):
            orbit = Orbits.find(scene, known[lane].parameters, known[lane].states).refined()
            slopes = orbit.derivatives((), self.by).state_derivatives
            if np.isfinite(slopes).all():
                self._first, self._slopes = orbit, slopes
                return True
        return False


def sweep_at(point: Point, columns: Mapping[str, np.ndarray], run: RunSettings) -> Sweep:
    """Return the sweep of a point over `columns`, which hold values of some of its parameters."""
    starts = None if point.start is None else list_of((point.start,), point.system.start_states)
    return Sweep(
        name=point.scene,
        text="",
        title="",
        scene=point.scene,
        options=point.options,
        system=point.system,
        starts=starts,
        parameters={name: x for name, x in point.parameters.items() if name not in columns},
        given={"bit_radius": point.hole_radius},
        points=dict(columns),
        run=run,
    )


def settled_at(point: Point, by: Sequence[str], rows: Points) -> Features:
    """Return the variables of lanes, with orbits, from the start of `point`, with the parameters `by` in `rows`."""
    run = read_settings(Place("run"), {"orbits": True}, point.system)
    sweep = sweep_at(point, {name: rows[:, k] for k, name in enumerate(by)}, run)
    return run_lanes(sweep.inputs(), sweep.plan).variables
