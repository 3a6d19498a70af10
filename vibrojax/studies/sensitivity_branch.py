"""The branch of orbits on which a function of parameters is evaluated, continued from its first orbit to each point."""

from collections import OrderedDict
from collections.abc import Sequence
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import shown
from vibrojax.maps.read import Point, read_sweep
from vibrojax.maps.run import run_sweep
from vibrojax.periodic.known_orbits import known_orbits
from vibrojax.periodic.orbit_derivatives import DERIVATIVE_REASONS, MARGIN, STABILITY, OrbitFeatures, orbit_features

MAX_CACHED = 1024
"""Largest number of results that are kept for points that are evaluated again."""

SAME_BRANCH = 0.05
"""Largest distance, in half swings, between an orbit and its linear prediction. Otherwise the step is halved."""

LEAST_FRACTION = 1 / 64
"""Smallest step of the continuation, as a fraction of the way from the first orbit."""

MAX_STEPS = 200
"""Limit of steps of one continuation."""

SEARCHED = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Relative changes of the parameters at which the first orbit is searched, if there is none at the first point."""

Points = Float[np.ndarray, "lanes by"]
Flags = Bool[np.ndarray, " lanes"]


class Evaluated(NamedTuple):
    """Features of orbits, and their derivatives, which are NaN where unknown.

    - `valid`: mask of the points that have a stable orbit of their own.
    - `reached`: parameters of the orbit; the point's own if the branch reaches it.
    """

    values: Float[np.ndarray, "*lanes of"]
    derivatives: Float[np.ndarray, "*lanes of by"]
    valid: Bool[np.ndarray, "*lanes"]
    reached: Float[np.ndarray, "*lanes by"]


class _Place(NamedTuple):
    """Points on the branch: parameters, states (lanes, cycles, states), and the states' derivatives."""

    x: Points
    states: Float[np.ndarray, "lanes cycles states"]
    slopes: Float[np.ndarray, "lanes cycles states by"]

    def of(self, lanes: Any) -> "_Place":
        return _Place(*(x[lanes] for x in self))


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
        self._first: _Place | None = None
        self._begun = False
        self._impacts = np.nan
        self._cached: OrderedDict[bytes, Evaluated] = OrderedDict()
        self._lock = Lock()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_cached": OrderedDict(), "_lock": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state | {"_lock": Lock()}

    def evaluate(self, x: Points) -> Evaluated:
        """Return the features at the points `x`; without an orbit there, of the last orbit on the way from the first.

        The features of a point are the same bit for bit, whatever the other points are.
        """
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
            none = Evaluated(*(part[0] for part in self.unknown(1)))
            return Evaluated(*(np.stack(parts) for parts in zip(*(known.get(key, none) for key in keys), strict=True)))

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
                f"beyond-branch: from {self.described(self._first.x[0])}, the orbit continues to "
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
        orbit, on_branch = self._correct(x, self._first.of(np.zeros(len(x), int)), self.of)
        values, derivatives, reached = orbit.values, orbit.derivatives, x.copy()
        far = np.flatnonzero(~on_branch)
        if len(far):
            end = self._continue(x[far])
            orbit = self._correct(end.x, end, self.of)[0]
            values[far], derivatives[far], reached[far] = orbit.values, orbit.derivatives, end.x
        valid = (reached == x).all(axis=1) & (values[:, self.of.index(STABILITY)] < 0)
        return Evaluated(values, derivatives, valid & np.isfinite(derivatives).all(axis=(1, 2)), reached)

    def _begin(self, x: Float[np.ndarray, " by"]) -> None:
        """Find the first orbit: at `x`, or else the nearest of the stable orbits at points around it."""
        places = [x[None]]
        corners = np.concatenate([np.eye(len(x)), -np.eye(len(x)), np.ones((1, len(x))), -np.ones((1, len(x)))])
        around = [x + share * corners * self._scale for share in SEARCHED]
        defaults = np.array([[self.point.parameters[name] for name in self.by]])
        table = self.point.system.parameters()
        for points in (*places, np.concatenate([*around, defaults])):
            rows = np.atleast_2d(points)
            for place, name in enumerate(self.by):
                low = table[name].lowest
                if low is not None:
                    rows = rows[rows[:, place] > low] if table[name].open_below else rows[rows[:, place] >= low]
            if len(rows) and self._settle(rows, x):
                return

    def _settle(self, rows: Points, x: Float[np.ndarray, " by"]) -> bool:
        """Settle from the start at the points `rows`; remember the stable orbit nearest to `x`; return success."""
        point = self.point
        ds = settled_at(point, self.by, rows)
        driving = point.system.driving_part()
        values = {name: np.full(len(rows), value) for name, value in point.parameters.items()}
        values |= {name: rows[:, k] for k, name in enumerate(self.by)}
        known = known_orbits(driving, ds, {name: values[name] for name in driving.parameters()})
        distance = np.abs((rows[known.lanes] - x) / self._scale).max(axis=1)
        for k in np.argsort(distance, kind="stable"):
            lane = known.lanes[k]
            if ds["stable"].values.ravel()[lane] != 1:
                continue
            orbit = self._solve(rows[[lane]], known.states[k][None], ())
            if np.isfinite(orbit.state_derivatives).all():
                self._impacts = float(orbit.impacts[0])
                self._first = _place(rows[[lane]], orbit)
                return True
        return False

    def _solve(self, x: Points, guess: np.ndarray, of: Sequence[str], reach: float = np.inf) -> OrbitFeatures:
        parameters = {name: np.full(len(x), value) for name, value in self.point.parameters.items()}
        parameters |= {name: x[:, k] for k, name in enumerate(self.by)}
        return orbit_features(self.point.system, of, self.by, parameters, guess, reach)

    def _correct(self, x: Points, begin: _Place, of: Sequence[str]) -> tuple[OrbitFeatures, Flags]:
        """Return the orbits at `x` that are predicted from `begin`, and a mask of those that are on the branch."""
        guess = begin.states + np.einsum("lksj,lj->lks", begin.slopes, x - begin.x)
        orbit = self._solve(x, guess, of, SAME_BRANCH)
        sound = np.isfinite(orbit.state_derivatives).all(axis=(1, 2, 3)) & (orbit.impacts == self._impacts)
        bad = [DERIVATIVE_REASONS.index(name) for name in ("no-orbit", "neutral-orbit", "failed")]
        return orbit, sound & (orbit.moved <= SAME_BRANCH) & ~np.isin(orbit.reason, bad).any(axis=1)

    def _continue(self, x: Points) -> _Place:
        """Return the places on the branch that are nearest to `x` on the straight lines from the first orbit.

        The whole way in one step has been tried before.
        """
        assert self._first is not None
        begin, here = (self._first.of(np.zeros(len(x), int)) for _ in range(2))
        done, step = np.zeros(len(x)), np.full(len(x), 0.5)
        active = np.arange(len(x))
        for _ in range(MAX_STEPS):
            active = active[(done[active] < 1) & (step[active] >= LEAST_FRACTION)]
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


def settled_at(point: Point, by: Sequence[str], rows: Points) -> xr.Dataset:
    """Return the lanes, with their orbits, that begin at the start of `point`, with the parameters `by` in `rows`."""
    tables: dict[str, Any] = {
        "scene": point.system,
        "parameters": {name: value for name, value in point.parameters.items() if name not in by},
        "points": {name: rows[:, k].tolist() for k, name in enumerate(by)},
        "run": {"orbits": True},
        "unusual": True,
    }
    begin = {} if point.start is None else {"starts": [point.start]}
    return run_sweep(read_sweep(tables | begin), progress=False)


def _place(x: Points, orbit: OrbitFeatures) -> _Place:
    return _Place(x.copy(), orbit.states.copy(), orbit.state_derivatives.copy())
