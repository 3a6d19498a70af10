"""The periodic orbits of a point of a design over its tolerance box, and their optimum by SLSQP."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.io.variables import ORBIT_REASONS
from vibrojax.lazy import optimize
from vibrojax.periodic.derivatives import MODULUS, OrbitFeatures, orbit_variables
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.studies.design_requirements import Assessment, DesignSpec, Unit

LARGEST_MODULUS = 0.98
"""Largest modulus of a multiplier on orbits: nearer to 1, an orbit is about to lose its stability."""

INSIDE = 1e-6
"""Slack that SLSQP keeps, which covers its own tolerance."""

ORBIT_REACH = 1.0
"""Distance in half swings from the prediction beyond which no orbit is searched."""

LEAST_STEP = 1 / 16
"""Smallest step to another point, as a fraction of the way: beyond it, SLSQP tries a nearer point."""

SLSQP_MAX_ITERATIONS, SLSQP_MAX_ROUNDS = 12, 20
"""Iterations of SLSQP in a box around the best point so far, and boxes: the next begins at the best point of all."""

FIRST_RADIUS, LARGEST_RADIUS, LEAST_RADIUS = 0.1, 0.2, 1e-3
"""Half-widths of these boxes in the unit box: the first, the largest, and the one below which the search ends."""

SAME_POINT = 0.01
"""Distance in the unit box (greatest coordinate) within which two candidates count as one."""


class LostOrbit(Exception):
    """The orbits of a point are not of the same kind as those before."""


@dataclass(frozen=True, eq=False)
class Visit:
    """Orbits over the box of a point: rows of objectives, limits and stability, and their slopes.

    `orbits` has one batch of samples for each motion, `orbit_slopes` their derivatives with respect to the parameters
    `by`.
    """

    unit: Unit
    rows: Float[np.ndarray, " rows"]
    slopes: Float[np.ndarray, "rows varied"]
    orbits: list[Orbits]
    by: tuple[str, ...]
    orbit_slopes: list[OrbitFeatures]

    def rank(self, objectives: int) -> tuple[float, float]:
        """Return the key of the order from worst to best: smaller violations, then a greater least objective."""
        excess = float(self.rows[objectives:].min(initial=0.0)) + INSIDE / 2
        return min(excess, 0.0), float(self.rows[:objectives].min())


class BoxOrbits:
    """The periodic orbits of a point's motions over the box, as functions of the point.

    `visits` is empty if the seed's orbits lack a value; `optima` holds the point at which `climb` has converged.
    """

    def __init__(self, spec: DesignSpec, seed: Assessment) -> None:
        self.spec = spec
        self.scale = abs(seed.objective) or 1.0
        features = orbit_features(spec)
        self.of = (*(features[name] for name in spec.names), f"{MODULUS}0")
        sound = [
            k for k in range(len(seed.offsets))
            if spec.robust or spec.constraints or not k
            if all(has_orbit(seed, start, k) for start in seed.motions)
        ]  # fmt: skip
        self.box = seed.offsets[sound]
        self.objectives = len(seed.motions) * (len(sound) if spec.robust else 1)
        self.impacts: list[float] | None = None
        self.optima: list[Unit] = []
        first = self._visit(seed.unit, [orbits_at(seed, start, sound) for start in seed.motions])
        self.visits = [] if first is None else [first]

    @property
    def solved(self) -> int:
        """Number of orbits that were solved."""
        return sum(len(orbits) for visit in self.visits for orbits in visit.orbits)

    def at(self, unit: Unit) -> Visit:
        """Return the orbits at a point, carried from the nearest point visited; raise `LostOrbit` without them."""
        near = min(self.visits, key=lambda visit: float(np.abs(visit.unit - unit).max()))
        if np.array_equal(near.unit, unit):
            return near
        parameters, _ = self.spec.parameters(np.repeat(unit[None], len(self.box), axis=0), self.box)
        carried = [
            orbits.carry_to(parameters, within=ORBIT_REACH, least=LEAST_STEP, by=near.by, slopes=slopes)
            for orbits, slopes in zip(near.orbits, near.orbit_slopes, strict=True)
        ]
        arrived = all(arrived.all() for _, arrived in carried)
        visit = self._visit(unit, [orbits for orbits, _ in carried]) if arrived else None
        if visit is None:
            raise LostOrbit
        self.visits.append(visit)
        return visit

    def _visit(self, unit: Unit, orbits: list[Orbits]) -> Visit | None:
        """Return the rows of a point from its orbits; None if these lack a value or are not of the same kind."""
        spec = self.spec
        _, chain = spec.parameters(np.repeat(unit[None], len(self.box), axis=0), self.box)
        jacobian = np.stack([*chain.values()], axis=1)
        objectives, limits, orbit_slopes = [], [], []
        for batch in orbits:
            features = batch.derivatives(self.of, tuple(chain))
            values, gradients = features.values, features.derivatives @ jacobian
            if not (np.isfinite(values).all() and np.isfinite(gradients).all() and np.ptp(batch.impacts) == 0):
                return None
            orbit_slopes.append(features)
            table = dict(zip(spec.names, zip(values.T, gradients.transpose(1, 0, 2), strict=True), strict=False))
            value, slope = table[spec.maximise]
            counted = slice(None) if spec.robust else slice(1)
            objectives.append((value[counted] / self.scale, slope[counted] / self.scale))
            limits.append((LARGEST_MODULUS - values[:, -1], -gradients[:, -1]))
            for c in spec.constraints:
                value, slope = table[c.variable]
                limits.append((c.slack(value) - INSIDE, c.sign * slope / c.scale))
        impacts = [float(batch.impacts[0]) for batch in orbits]
        if self.impacts is not None and impacts != self.impacts:
            return None
        self.impacts = impacts
        rows, slopes = (np.concatenate([pair[k] for pair in (*objectives, *limits)]) for k in range(2))
        return Visit(unit.copy(), rows, slopes, orbits, tuple(chain), orbit_slopes)

    def climb(self, known: Sequence[Unit]) -> list[Unit]:
        """Return points on the way to the optimum of the orbits, by SLSQP; it ends near points that are `known`.

        SLSQP maximises t under f >= t for each motion of the starts and, for a robust design, each sample of the box.
        The limits hold for each motion and sample. No motion has to settle here.
        """
        count, objectives = len(self.spec.bounds), self.objectives
        is_objective = 1.0 * (np.arange(len(self.visits[0].rows)) < objectives)
        limits: dict[str, Any] = {
            "type": "ineq",
            "fun": lambda z: self.at(z[:count]).rows - z[-1] * is_objective,
            "jac": lambda z: np.column_stack([self.at(z[:count]).slopes, -is_objective]),
        }
        path, radius = [self.visits[0]], FIRST_RADIUS
        for _ in range(SLSQP_MAX_ROUNDS):
            now = path[-1]
            box = zip(np.maximum(0.0, now.unit - radius), np.minimum(1.0, now.unit + radius), strict=True)
            done = False
            with suppress(LostOrbit):
                end = optimize.minimize(
                    lambda z: -z[-1], [*now.unit, now.rows[:objectives].min()], jac=lambda z: -np.eye(count + 1)[-1],
                    method="SLSQP", bounds=[*box, (None, None)], constraints=limits,
                    options={"maxiter": SLSQP_MAX_ITERATIONS, "ftol": 1e-9},
                )  # fmt: skip
                done = bool(end.success) and float(np.abs(end.x[:count] - now.unit).max()) < 0.99 * radius
            best = max(self.visits, key=lambda visit: visit.rank(objectives))
            moved = float(np.abs(best.unit - now.unit).max())
            path += [best] * (best is not now)
            self.optima += [best.unit] * done
            radius = min(2 * radius, LARGEST_RADIUS) if moved > radius / 2 else radius / 4
            met = any(np.abs(best.unit - unit).max() < SAME_POINT for unit in known)
            if done or met or radius < LEAST_RADIUS:
                break
        return [path[k].unit for k in sorted({len(path) - 1, len(path) // 2, len(path) // 4})]


def orbit_features(spec: DesignSpec) -> dict[str, str]:
    """Return the features of orbits that have the derivatives of the design's variables, by variable."""
    known = orbit_variables(spec.template.system)
    features = {name: f"{MODULUS}0" if name == "multiplier_abs" else name for name in spec.names}
    return {name: feature for name, feature in features.items() if feature in known}


def has_derivatives(a: Assessment) -> bool:
    """Return whether all variables have derivatives, and the nominal orbits of all motions were found."""
    known = set(orbit_features(a.spec)) == set(a.spec.names) and "orbit_reason" in a.lanes and bool(a.motions)
    return known and all(has_orbit(a, start) for start in a.motions)


def has_orbit(a: Assessment, start: int, sample: int = 0) -> bool:
    """Return whether the orbit of a lane was found, with as many section crossings as that of the nominal point."""
    same = a.lanes["orbit_cycles"][sample, start] == a.lanes["orbit_cycles"][0, start]
    return bool(same and a.lanes["orbit_reason"][sample, start] == ORBIT_REASONS.index("found"))


def orbits_at(a: Assessment, start: int, samples: Sequence[int]) -> Orbits:
    """Return the orbits of the lanes from a start, at samples of the box."""
    scene = a.spec.template.system
    values, _ = a.spec.parameters(np.repeat(a.unit[None], len(samples), axis=0), a.offsets[samples])
    found = {name: x[samples, start] for name, x in a.lanes.items() if x.ndim == 2}
    [lanes] = orbits_of(scene, found, values, np.arange(len(samples)))
    return Orbits.find(scene, values, lanes.states, within=ORBIT_REACH).refined()


def orbit_gradient(a: Assessment) -> Unit:
    """Return the derivative of the objective at the nominal orbit of the motion with the least objective."""
    spec = a.spec
    _, chain = spec.parameters(a.unit[None], 0.0 * a.offsets[:1])
    orbit = orbits_at(a, a.motions[0], [0]).derivatives((orbit_features(spec)[spec.maximise],), tuple(chain))
    return np.asarray(orbit.derivatives[0, 0] @ np.concatenate([*chain.values()]))
