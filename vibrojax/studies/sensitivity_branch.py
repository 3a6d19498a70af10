"""The branch of orbits on which a function of parameters is evaluated: known orbits, and continuation between them."""

from collections import OrderedDict
from collections.abc import Sequence
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrojax.maps.read import Point, read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.periodic.known_orbits import known_orbits
from vibrojax.periodic.orbit_derivatives import DERIVATIVE_REASONS, MARGIN, STABILITY, OrbitFeatures, orbit_features

MAX_KNOWN = 256
"""Largest number of known orbits; the first one is always kept."""

MAX_CACHED = 1024
"""Largest number of results that are kept for points that are evaluated again."""

KNOWN_SPACING = 1e-3
"""Smallest relative distance in parameters between two known orbits."""

SAME_BRANCH = 0.05
"""Largest distance, in half swings, between an orbit and its linear prediction. Otherwise the step is halved."""

LEAST_FRACTION = 1 / 64
"""Smallest step of the continuation from the first orbit, as a fraction of the way between two points."""

LEAST_AROUND = 1 / 8
"""The same for the continuation from the nearest known orbit, which may find a way around a border."""

MAX_STEPS = 200
"""Limit of steps of one continuation."""

SEARCHED = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Relative changes of the parameters at which the first orbit is searched, if there is none at the first point."""

Points = Float[np.ndarray, "lanes by"]
Flags = Bool[np.ndarray, " lanes"]


class Evaluated(NamedTuple):
    """Features of orbits, their derivatives, and a mask of the points that have a stable orbit of their own."""

    values: Float[np.ndarray, "lanes of"]
    derivatives: Float[np.ndarray, "lanes of by"]
    valid: Flags


class _Place(NamedTuple):
    """Points on the branch: parameters, states (lanes, cycles, states), and the states' derivatives."""

    x: Points
    states: Float[np.ndarray, "lanes cycles states"]
    slopes: Float[np.ndarray, "lanes cycles states by"]

    def of(self, lanes: Any) -> "_Place":
        return _Place(*(x[lanes] for x in self))


class Branch:
    """Orbits of one scene with the same numbers of section crossings and impacts, as functions of the parameters `by`.

    The first orbit is the one on which the motion from `start` settles at the first point. All others are continued
    from known orbits: the states are predicted linearly, and corrected by Newton's method. An orbit is accepted if it
    is close to the prediction; otherwise the continuation takes smaller steps.
    """

    def __init__(self, point: Point, of: Sequence[str], by: Sequence[str]) -> None:
        self._point, self._by = point, tuple(by)
        self._of = tuple(dict.fromkeys((*of, STABILITY, MARGIN)))
        self._scale = np.array([abs(point.parameters[name]) or 1.0 for name in by])
        self._known: _Place | None = None
        self._impacts = np.nan
        self._cached: OrderedDict[bytes, Evaluated] = OrderedDict()
        self._lock = Lock()

    @property
    def of(self) -> tuple[str, ...]:
        """Names of the features, in the order of the results."""
        return self._of

    def evaluate(self, x: Points) -> Evaluated:
        """Return the features at the points `x`; without an orbit there, of the nearest known orbit."""
        with self._lock, np.errstate(all="ignore"):
            keys = [row.tobytes() for row in x]
            new = [k for k, key in enumerate(keys) if key not in self._cached and np.isfinite(x[k]).all()]
            new = [*{keys[k]: k for k in new}.values()]
            known = {key: self._cached[key] for key in keys if key in self._cached}
            if new:
                fresh = self._evaluate(x[new])
                for place, k in enumerate(new):
                    known[keys[k]] = Evaluated(*(part[place] for part in fresh))
                    self._cached[keys[k]] = known[keys[k]]
            while len(self._cached) > MAX_CACHED:
                self._cached.popitem(last=False)
            count = len(self._of)
            none = Evaluated(np.full(count, np.nan), np.full((count, len(self._by)), np.nan), np.array(False))
            return Evaluated(*(np.stack(parts) for parts in zip(*(known.get(key, none) for key in keys), strict=True)))

    def _evaluate(self, x: Points) -> Evaluated:
        if self._known is None:
            self._begin(x[0])
        count, size = len(self._of), len(x)
        if self._known is None:
            nothing = np.full((size, count), np.nan)
            return Evaluated(nothing, np.full((size, count, len(self._by)), np.nan), np.zeros(size, bool))
        nearest = self._nearest(x)
        begin = self._known.of(nearest)
        orbit, reached = self._correct(x, begin, self._of)
        result = Evaluated(orbit.values, orbit.derivatives, reached.copy())
        self._remember(_place(x, orbit).of(reached))
        far = np.flatnonzero(~reached)
        if len(far):
            # The way from the first orbit does not depend on the points that were evaluated before.
            end = self._continue(x[far], self._known.of(np.zeros(len(far), int)), LEAST_FRACTION)
            short = np.flatnonzero((end.x != x[far]).any(axis=1) & (nearest[far] > 0))
            if len(short):
                around = self._continue(x[far[short]], begin.of(far[short]), LEAST_AROUND)
                there = (around.x == x[far[short]]).all(axis=1)
                for mine, new in zip(end, around, strict=True):
                    mine[short[there]] = new[there]
            orbit = self._correct(end.x, end, self._of)[0]
            result.values[far], result.derivatives[far] = orbit.values, orbit.derivatives
            result.valid[far] = (end.x == x[far]).all(axis=1)
        stable = result.values[:, self._of.index(STABILITY)] < 0
        finite = np.isfinite(result.derivatives).all(axis=(1, 2))
        derivatives = np.where(np.isfinite(result.derivatives), result.derivatives, 0.0)
        return Evaluated(result.values, derivatives, result.valid & stable & finite)

    def _begin(self, x: Float[np.ndarray, " by"]) -> None:
        """Find the first orbit: at `x`, or else the nearest of the stable orbits at points around it."""
        places = [x[None]]
        corners = np.concatenate([np.eye(len(x)), -np.eye(len(x)), np.ones((1, len(x))), -np.ones((1, len(x)))])
        around = [x + share * corners * self._scale for share in SEARCHED]
        defaults = np.array([[self._point.parameters[name] for name in self._by]])
        table = self._point.system.parameters()
        for points in (*places, np.concatenate([*around, defaults])):
            rows = np.atleast_2d(points)
            for place, name in enumerate(self._by):
                low = table[name].lowest
                if low is not None:
                    rows = rows[rows[:, place] > low] if table[name].open_below else rows[rows[:, place] >= low]
            if len(rows) and self._settle(rows, x):
                return

    def _settle(self, rows: Points, x: Float[np.ndarray, " by"]) -> bool:
        """Settle from the start at the points `rows`; remember the stable orbit nearest to `x`; return success."""
        point, scene = self._point, self._point.system
        fixed = {name: value for name, value in point.parameters.items() if name not in self._by}
        tables: dict[str, Any] = {
            "scene": scene,
            "parameters": fixed,
            "points": {name: rows[:, k].tolist() for k, name in enumerate(self._by)},
            "run": {"orbits": True},
            "unusual": True,
        }
        if point.start is not None:
            tables["starts"] = [point.start if isinstance(point.start, str) else list(point.start)]
        ds = run_sweep(read_sweep(tables), progress=False)
        driving = scene.driving_part()
        values = {name: np.full(len(rows), value) for name, value in point.parameters.items()}
        values |= {name: rows[:, k] for k, name in enumerate(self._by)}
        known = known_orbits(driving, ds, {name: values[name] for name in driving.parameters()})
        distance = np.abs((rows[known.lanes] - x) / self._scale).max(axis=1)
        for k in np.argsort(distance, kind="stable"):
            lane = known.lanes[k]
            if ds["stable"].values.ravel()[lane] != 1:
                continue
            orbit = self._solve(rows[[lane]], known.states[k][None], ())
            if np.isfinite(orbit.state_derivatives).all():
                self._impacts = float(orbit.impacts[0])
                self._known = _place(rows[[lane]], orbit)
                return True
        return False

    def _solve(self, x: Points, guess: np.ndarray, of: Sequence[str], reach: float = np.inf) -> OrbitFeatures:
        parameters = {name: np.full(len(x), value) for name, value in self._point.parameters.items()}
        parameters |= {name: x[:, k] for k, name in enumerate(self._by)}
        return orbit_features(self._point.system, of, self._by, parameters, guess, reach)

    def _correct(self, x: Points, begin: _Place, of: Sequence[str]) -> tuple[OrbitFeatures, Flags]:
        """Return the orbits at `x` that are predicted from `begin`, and a mask of those that are on the branch."""
        guess = begin.states + np.einsum("lksj,lj->lks", begin.slopes, x - begin.x)
        orbit = self._solve(x, guess, of, SAME_BRANCH)
        sound = np.isfinite(orbit.state_derivatives).all(axis=(1, 2, 3)) & (orbit.impacts == self._impacts)
        bad = [DERIVATIVE_REASONS.index(name) for name in ("no-orbit", "neutral-orbit", "failed")]
        return orbit, sound & (orbit.moved <= SAME_BRANCH) & ~np.isin(orbit.reason, bad).any(axis=1)

    def _continue(self, x: Points, begin: _Place, least: float) -> _Place:
        """Return the places on the branch that are nearest to `x` on the straight lines from `begin`.

        `least`: smallest step, as a fraction of the way.
        """
        here = _Place(*(part.copy() for part in begin))
        done, step = np.zeros(len(x)), np.ones(len(x))
        active = np.arange(len(x))
        for _ in range(MAX_STEPS):
            active = active[(done[active] < 1) & (step[active] >= least)]
            if not len(active):
                break
            goal = np.minimum(done[active] + step[active], 1.0)
            target = np.where((goal == 1)[:, None], x[active], begin.x[active] + goal[:, None] * (x - begin.x)[active])
            orbit, reached = self._correct(target, here.of(active), (STABILITY,))
            moved, place = active[reached], _place(target, orbit).of(reached)
            for mine, new in zip(here, place, strict=True):
                mine[moved] = new
            done[moved] = goal[reached]
            step[active] *= np.where(reached, 2.0, 0.5)
        return here

    def _nearest(self, x: Points) -> Int[np.ndarray, " lanes"]:
        assert self._known is not None
        apart = np.abs((x[:, None] - self._known.x[None]) / self._scale).max(axis=2)
        return np.asarray(apart.argmin(axis=1))

    def _remember(self, places: _Place) -> None:
        """Add places that are not close to a known one."""
        for k in range(len(places.x)):
            assert self._known is not None
            x = places.x[k : k + 1]
            near = np.abs((self._known.x[self._nearest(x)] - x) / self._scale).max()
            if near < KNOWN_SPACING:
                continue
            kept = np.arange(len(self._known.x))
            if len(kept) >= MAX_KNOWN:
                kept = np.delete(kept, 1)
            new = (np.concatenate([old[kept], part[k : k + 1]]) for old, part in zip(self._known, places, strict=True))
            self._known = _Place(*new)


def _place(x: Points, orbit: OrbitFeatures) -> _Place:
    return _Place(x.copy(), orbit.states.copy(), orbit.state_derivatives.copy())
