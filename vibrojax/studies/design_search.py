"""The search of a design: seeds from a map, optima of their orbits, a zoom by lanes, verification, and the front.

The periodic orbits of a point over its tolerance box have derivatives, by which SLSQP finds an optimum.
"""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.io.variables import ORBIT_REASONS
from vibrojax.lazy import optimize, qmc
from vibrojax.maps.bounds import corners, draws
from vibrojax.maps.run import run_sweep
from vibrojax.periodic.derivatives import MODULUS, OrbitFeatures, orbit_variables
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.studies.design_requirements import DRAWN_BOX, Assessment, DesignSpec, Lanes, Offsets, Unit, extreme

# The map: points per axis of a grid for one and two varied parameters; for more, Sobol points, doubled until enough of
# them are feasible.
MAP_AXIS = {1: 33, 2: 16}
FIRST_SAMPLE, LARGEST_SAMPLE, ENOUGH_FEASIBLE = 64, 2048, 8

TRIED_SEEDS, SEEDS, RESULTS = 24, 8, 3  # points compared over their boxes, those where SLSQP begins, candidates kept
APART, SAME_POINT = 0.12, 0.01  # distances in the unit box (greatest coordinate): least of seeds; of equal candidates

# Verification, and its repairs: failing samples that each round adds to the box of the search, and radius of the zoom.
MAX_CORNERS = 16  # in the search; verification has all
DRAWS, NEAR_WIDTHS, NEAR_DRAWS = 256, (0.25, 0.06), 16  # half-widths of regions around the worst samples, and draws
MAX_REPAIRS, ADDED_SAMPLES, REPAIR_RADIUS = 4, 4, 0.01

# The zoom: proposals with up to two and with more parameters, and points that shape the next ones. It ends below a
# spread in the unit box, or after some rounds without a relative gain.
ZOOM_ROUNDS, ZOOM_PROPOSALS, ZOOM_ELITE = 24, (32, 64), 8
ZOOM_LEAST_SPREAD, ZOOM_GAIN, ZOOM_PATIENCE = 1e-5, 1e-6, 3
CHECK_RADIUS, WARM_RADIUS = 0.0025, 0.02  # in the unit box, of a check of SLSQP's optimum, and of a point of a front

DIFFERENCE_STEP = 1e-5  # of central differences of lanes in the unit box
TOLERANCE_SPAN = (0.0, 2.0)  # default range of the factor of the tolerances

# SLSQP maximises in a box around the best point so far; the next box begins at the best point of all.
SLSQP_MAX_ITERATIONS, SLSQP_MAX_ROUNDS = 12, 20
FIRST_RADIUS, LARGEST_RADIUS, LEAST_RADIUS = 0.1, 0.2, 1e-3  # half-widths of the boxes in the unit box
INSIDE = 1e-6  # slack that it keeps, which covers its own tolerance
LEAST_STEP = 1 / 16  # of the way to another point: beyond it, SLSQP tries a nearer point
ORBIT_REACH = 1.0  # distance in half swings from the prediction beyond which no orbit is searched
LARGEST_MODULUS = 0.98  # of a multiplier: nearer to 1, an orbit is about to lose its stability


by_rank = attrgetter("rank")


def distinct(candidates: Sequence[Assessment], distance: float, most: int) -> list[Assessment]:
    """Return the best candidates that are apart from one another, best first."""
    kept: list[Assessment] = []
    for a in sorted(candidates, key=by_rank):
        if len(kept) < most and all(np.abs(a.unit - other.unit).max() >= distance for other in kept):
            kept.append(a)
    return kept


class Search:
    """The search of one design, with counts of its lanes and of the orbits that it solved."""

    def __init__(self, spec: DesignSpec, counts: Counter[str] | None = None) -> None:
        self.spec, self.counts = spec, Counter[str]() if counts is None else counts
        count = len(spec.tolerances)
        self.centre = np.zeros((1, count))
        self.corners = corners(count) if count else self.centre[:0]
        few = self.corners
        if len(few) > MAX_CORNERS:
            few = np.unique(np.sign(draws(count, MAX_CORNERS, seed=1)), axis=0)
        self.box = np.concatenate([self.centre, DRAWN_BOX * few])
        self.optima: list[Unit] = []

    def lanes(self, unit: Float[np.ndarray, "points varied"], offsets: Float[np.ndarray, "points tolerances"]) -> Lanes:
        """Return the variables of points with offsets, one row each, from every start."""
        sweep = replace(self.spec.template, points=self.spec.columns(unit, offsets))
        self.counts["lanes"] += sweep.lanes
        ds = run_sweep(sweep, progress=False)
        ds = ds if "start" in ds.dims else ds.expand_dims("start")
        return {str(name): x.transpose("point", "start", ...).values for name, x in ds.items() if "point" in x.dims}

    def assess(self, points: Sequence[Unit] | Float[np.ndarray, "points varied"], offsets: Offsets) -> list[Assessment]:
        """Assess points over samples of their boxes, in one batch of lanes."""
        if not len(points):
            return []
        number = len(offsets)
        lanes = self.lanes(np.repeat(points, number, axis=0), np.tile(offsets, (len(points), 1)))
        parts = (slice(number * k, number * (k + 1)) for k in range(len(points)))
        return [
            Assessment(self.spec, unit, offsets, {name: x[part] for name, x in lanes.items()})
            for unit, part in zip(points, parts, strict=True)
        ]

    def map(self) -> list[Assessment]:
        count = len(self.spec.bounds)
        if count in MAP_AXIS:
            return self.assess(np.array([*product(np.linspace(0, 1, MAP_AXIS[count]), repeat=count)]), self.centre)
        sampler = qmc.Sobol(count, seed=0)
        points = self.assess(sampler.random(FIRST_SAMPLE), self.centre)
        while sum(a.feasible for a in points) < ENOUGH_FEASIBLE and len(points) < LARGEST_SAMPLE:
            points += self.assess(sampler.random(len(points)), self.centre)
        return points

    def seeds(self, points: Sequence[Assessment]) -> list[Assessment]:
        """Return the best points of the map that are apart from one another, assessed over the box."""
        tried = distinct(points, min(APART, 0.99 * self.spacing(points)), TRIED_SEEDS)
        return distinct(self.assess([a.unit for a in tried], self.box), APART, SEEDS)

    def spacing(self, points: Sequence[Assessment]) -> float:
        """Return the typical distance between neighbouring points of the map."""
        return 1 / (len(points) ** (1 / len(self.spec.bounds)) - 1)

    def best(self, seeds: Sequence[Assessment], radius: float) -> list[Assessment]:
        """Return verified candidates, best first: the optima of the seeds' orbits, improved by lanes.

        A candidate that fails in verification adds its failing samples to the box of the search, and goes on.
        """
        points: list[Unit] = []
        for seed in seeds:
            orbits = BoxOrbits(self.spec, seed) if has_derivatives(seed) else None
            if orbits is not None and orbits.visits:
                points += orbits.climb(points)
                self.optima += orbits.optima
                self.counts["orbits"] += sum(len(batch) for visit in orbits.visits for batch in visit.orbits)
        candidates = distinct([*seeds, *self.assess(points, self.box)], APART / 2, RESULTS)
        verified: list[Assessment] = []
        for _ in range(MAX_REPAIRS):
            candidates = self.zoom(candidates, radius)
            checked = self.verify(candidates)
            verified += checked
            if len(self.box) == 1 or not checked or any(a.feasible for a in checked):
                break
            for a in checked:
                failing = np.flatnonzero(a.missed > 0)
                some = failing[:: max(1, len(failing) // ADDED_SAMPLES)][:ADDED_SAMPLES]
                self.box = np.concatenate([self.box, a.offsets[some]])
            candidates, radius = self.assess([a.unit for a in candidates], self.box), REPAIR_RADIUS
        return distinct(verified, SAME_POINT, RESULTS)

    def verify(self, candidates: Sequence[Assessment]) -> list[Assessment]:
        """Assess candidates at the centre, all corners, draws of a slightly larger box, and near the worst samples."""
        count = len(self.spec.tolerances)
        if not count:
            return list(candidates)
        offsets = np.concatenate([self.centre, self.corners, DRAWN_BOX * draws(count, DRAWS, seed=2)])
        checked = self.assess([a.unit for a in candidates], offsets)
        for width in NEAR_WIDTHS:  # the worst sample of a ridge that crosses the box lies between those before
            cube = DRAWN_BOX * width * draws(count, NEAR_DRAWS, seed=3)
            for index, a in enumerate(checked):
                if a.feasible:
                    rows = [a.values[self.spec.maximise], *a.slack]
                    worst = {int(np.nanmin(np.where(a.good, x, np.inf), axis=1).argmin()) for x in rows}
                    near = np.concatenate([np.clip(a.offsets[k] + cube, -DRAWN_BOX, DRAWN_BOX) for k in sorted(worst)])
                    [b] = self.assess([a.unit], near)
                    lanes = {name: np.concatenate([x, b.lanes[name]]) for name, x in a.lanes.items()}
                    checked[index] = Assessment(self.spec, a.unit, np.concatenate([a.offsets, near]), lanes)
        return checked

    def zoom(self, candidates: Sequence[Assessment], radius: float) -> list[Assessment]:
        """Improve candidates by lanes alone, on ridges where a stick appears, at borders, and without derivatives.

        Each round draws points from a box around the best one, whose shape is the covariance of the best few so far.
        An optimum of SLSQP ends after one round nearby without a gain.
        """
        count = len(self.spec.bounds)
        sampler = qmc.Sobol(count, seed=4)
        pools = [[a] for a in candidates]
        smooth = [any(np.array_equal(a.unit, unit) for unit in self.optima) for a in candidates]
        shapes = [(CHECK_RADIUS if done else radius) * np.eye(count) for done in smooth]
        patience = [1 if done else ZOOM_PATIENCE for done in smooth]
        for _ in range(ZOOM_ROUNDS):
            active = [k for k, tries in enumerate(patience) if tries > 0]
            cubes = [2 * sampler.random(ZOOM_PROPOSALS[count > 2]) - 1 for _ in active]
            points = [np.clip(pools[k][0].unit + x @ shapes[k].T, 0.0, 1.0) for k, x in zip(active, cubes, strict=True)]
            assessments = iter(self.assess([unit for own in points for unit in own], self.box))
            for k, own in zip(active, points, strict=True):
                best = pools[k][0]
                pool = sorted([*pools[k], *(next(assessments) for _ in own)], key=by_rank)[:ZOOM_ELITE]
                moves = np.array([a.unit for a in pool]) - best.unit  # from the last best: steady progress widens it
                shapes[k] = np.linalg.cholesky(3 * moves.T @ moves / len(moves) + 1e-14 * np.eye(count))
                pools[k] = pool
                gain = best.rank[0] > pool[0].rank[0] or -pool[0].rank[1] > -best.rank[1] * (1 + ZOOM_GAIN)
                patience[k] = ZOOM_PATIENCE if gain else patience[k] - 1
                near = (pools[j][0] for j in range(len(pools)) if j != k and patience[j] > 0)
                beaten = any(np.abs(a.unit - pool[0].unit).max() < SAME_POINT and a.rank <= pool[0].rank for a in near)
                if beaten or np.abs(shapes[k]).max() < ZOOM_LEAST_SPREAD:
                    patience[k] = 0
        return distinct([pool[0] for pool in pools], SAME_POINT, RESULTS)

    def gradient(self, a: Assessment) -> Unit:
        """Return the derivatives of the objective at a nominal point, of the motion with the least objective.

        They follow from the periodic orbit or, without one, from central differences of lanes. NaN: unknown.
        """
        spec, count = self.spec, len(self.spec.bounds)
        slope = np.full(count, np.nan)
        if has_derivatives(a):
            _, chain = spec.parameters(a.unit[None], 0.0 * a.offsets[:1])
            orbit = orbits_at(a, a.motions[0], [0]).derivatives((orbit_features(spec)[spec.maximise],), tuple(chain))
            slope = orbit.derivatives[0, 0] @ np.concatenate([*chain.values()])
        if not np.isfinite(slope).all() and a.motions:
            moves = DIFFERENCE_STEP * np.concatenate([np.eye(count), -np.eye(count)])
            x = [b.values[spec.maximise][0, a.motions[0]] for b in self.assess(a.unit + moves, self.centre)]
            repeats = a.lanes["cycles"][0, a.motions[0]] > 0 if "cycles" in a.lanes else True
            slope = np.where(repeats, np.subtract(x[:count], x[count:]) / (2 * DIFFERENCE_STEP), np.nan)
        return np.asarray(slope / spec.width)

    def front(self, points: Sequence[Assessment], results: Sequence[Assessment]) -> list[tuple[float, Assessment]]:
        """Return limits and best points of the design's front, each from the last optimum and the map.

        The search goes from the tightest limit to the loosest: by default from the least that the map reaches to that
        of the free optimum.
        """
        spec, front = self.spec, self.spec.front
        assert front is not None
        span = front.span or (TOLERANCE_SPAN if front.against == "tolerance" else None)
        if span is None:
            free = spec.within(None)
            known = [Assessment(free, a.unit, a.offsets[:1], a.nominal) for a in points]
            fit = [extreme(a.values[front.against], front.end) for a in known if a.fit.all()]
            top = [extreme(a.values[front.against], front.end) for a in (min(known, key=by_rank), results[0])]
            low, high = (min(fit), max(top)) if front.end == "most" else (max(fit), min(top))
            span = low + 0.02 * (high - low), high
        limits = np.linspace(*span, front.points).tolist()
        optima: dict[float, Assessment] = {}
        last: list[Assessment] = []
        for limit in sorted(limits, reverse=front.against == "tolerance" or front.end == "least"):
            changed = spec.within(limit)
            own = Search(changed, self.counts)
            known = [Assessment(changed, a.unit, own.centre, a.nominal) for a in (*points, *results)]
            seeds = own.assess([a.unit for a in last], own.box) + own.seeds(known)[:1]
            checked = own.best(seeds, WARM_RADIUS)
            if last and min(checked, key=by_rank).rank > last[0].rank:  # what held under a tighter limit
                checked += own.verify(own.assess([a.unit for a in last], own.box))
            optima[limit] = min(checked, key=by_rank)
            last = [optima[limit]] if optima[limit].feasible else last
        return [(limit, optima[limit]) for limit in limits]


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
        self.optima: list[Unit] = []
        self.visits: list[Visit] = []
        with suppress(LostOrbit):
            self._visit(seed.unit, [orbits_at(seed, start, sound) for start in seed.motions])

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
        if not all(arrived.all() for _, arrived in carried):
            raise LostOrbit
        return self._visit(unit, [orbits for orbits, _ in carried])

    def _visit(self, unit: Unit, orbits: list[Orbits]) -> Visit:
        """Return the rows of a point from its orbits, which must have all values and be of the same kind."""
        spec = self.spec
        _, chain = spec.parameters(np.repeat(unit[None], len(self.box), axis=0), self.box)
        jacobian = np.stack([*chain.values()], axis=1)
        objectives, limits, orbit_slopes = [], [], []
        for batch in orbits:
            features = batch.derivatives(self.of, tuple(chain))
            values, gradients = features.values, features.derivatives @ jacobian
            if not (np.isfinite(values).all() and np.isfinite(gradients).all() and np.ptp(batch.impacts) == 0):
                raise LostOrbit
            orbit_slopes.append(features)
            table = dict(zip(spec.names, zip(values.T, gradients.transpose(1, 0, 2), strict=True), strict=False))
            value, slope = table[spec.maximise]
            counted = slice(None) if spec.robust else slice(1)
            objectives.append((value[counted] / self.scale, slope[counted] / self.scale))
            limits.append((LARGEST_MODULUS - values[:, -1], -gradients[:, -1]))
            for c in spec.constraints:
                value, slope = table[c.variable]
                limits.append((c.slack(value) - INSIDE, c.sign * slope / c.scale))
        first = self.visits[0].orbits if self.visits else orbits
        if any(batch.impacts[0] != other.impacts[0] for batch, other in zip(orbits, first, strict=True)):
            raise LostOrbit
        rows, slopes = (np.concatenate([pair[k] for pair in (*objectives, *limits)]) for k in range(2))
        self.visits.append(Visit(unit.copy(), rows, slopes, orbits, tuple(chain), orbit_slopes))
        return self.visits[-1]

    def climb(self, known: Sequence[Unit]) -> list[Unit]:
        """Return points on the way to the optimum of the orbits, by SLSQP; it ends near points that are `known`.

        SLSQP maximises t under f >= t for each motion of the starts and, for a robust design, each sample of the box.
        The limits hold for each motion and sample. No motion has to settle here.
        """
        count, objectives = len(self.spec.bounds), self.objectives

        def merit(visit: Visit) -> tuple[float, float]:  # smaller violations, then a greater least objective
            excess = float(visit.rows[objectives:].min(initial=0.0)) + INSIDE / 2
            return min(excess, 0.0), float(visit.rows[:objectives].min())

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
            best = max(self.visits, key=merit)
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
