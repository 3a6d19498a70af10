"""The search of a design: seeds from a map, SLSQP on the periodic orbits, a zoom by lanes, and verification."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.stats import qmc

from vibrojax.maps.run import run_sweep
from vibrojax.periodic.derivatives import MODULUS, orbit_variables
from vibrojax.studies.design_points import (
    Assessment,
    BoxOrbits,
    DesignSpec,
    Lanes,
    LostOrbit,
    Offsets,
    Points,
    Unit,
    has_orbit,
    orbits_at,
    scene_parameters,
)

MAP_AXIS = {1: 33, 2: 16}
"""Points per axis of the map for one and two varied parameters, which make a grid."""

FIRST_SAMPLE, LARGEST_SAMPLE, ENOUGH_FEASIBLE = 64, 2048, 8
"""Sobol points of the map for more varied parameters: doubled until enough of them are feasible."""

SEEDS, TRIED_SEEDS, RESULTS = 8, 24, 3
"""Seeds from which SLSQP begins, points compared over their boxes to choose them, and candidates that are kept."""

APART, SAME_POINT = 0.12, 0.01
"""Least distance between two seeds, and between two candidates, in the unit box (greatest coordinate)."""

DRAWN_BOX = 1.04
"""Size of the box from which verification draws, relative to the tolerances: what holds there holds in the box."""

MAX_CORNERS = 16
"""Largest number of corners in the search; verification has all."""

DRAWS, NEAR_WIDTHS, NEAR_DRAWS = 256, (0.25, 0.06), 16
"""Draws of verification; half-widths of the regions around the worst samples, and draws in each of these."""

SLSQP_MAX_ITERATIONS, SLSQP_MAX_ROUNDS = 12, 20
"""Iterations of SLSQP in a box around the best point so far, and boxes: the next begins at the best point of all."""

FIRST_RADIUS, LARGEST_RADIUS, LEAST_RADIUS = 0.1, 0.2, 1e-3
"""Half-widths of these boxes in the unit box: the first, the largest, and the one below which the search ends."""

ZOOM_ROUNDS, ZOOM_PROPOSALS, ZOOM_ELITE = 24, (32, 64), 8
"""Rounds of the zoom, proposals in each with up to two and with more parameters, and points that shape the next."""

ZOOM_LEAST_SPREAD, ZOOM_GAIN, ZOOM_PATIENCE = 1e-5, 1e-6, 3
"""The zoom ends below this spread in the unit box, or after some rounds without this relative gain."""

MAX_REPAIRS, ADDED_SAMPLES, REPAIR_RADIUS = 4, 4, 0.01
"""Rounds of verification and zoom, failing samples that each adds to the box of the search, and radius of the zoom."""

CHECK_RADIUS = 0.0025
"""Radius in the unit box within which lanes check an optimum of SLSQP."""

DIFFERENCE_STEP = 1e-5
"""Step of central differences of lanes in the unit box."""


def distinct(candidates: Sequence[Assessment], distance: float, most: int) -> list[Assessment]:
    """Return the best candidates that are apart from one another, best first."""
    kept: list[Assessment] = []
    for a in sorted(candidates, key=lambda a: a.rank):
        if len(kept) < most and all(np.abs(a.unit - other.unit).max() >= distance for other in kept):
            kept.append(a)
    return kept


class Search:
    """The search of one design, with counts of its lanes and of the orbits that it solved."""

    def __init__(self, spec: DesignSpec, counts: Counter[str] | None = None) -> None:
        self.spec, self.counts = spec, Counter[str]() if counts is None else counts
        count = len(spec.tolerances)
        self.corners = np.array([*product((-1.0, 1.0), repeat=count)] if count else np.zeros((0, 0)))
        few = self.corners
        if len(few) > MAX_CORNERS:
            few = np.unique(np.sign(qmc.Sobol(count, seed=1).random(MAX_CORNERS) - 0.5), axis=0)
        self.centre = np.zeros((1, count))
        self.optima: list[Unit] = []
        self.box = np.concatenate([self.centre, DRAWN_BOX * few])

    @cached_property
    def features(self) -> dict[str, str]:
        """The features of orbits that have the derivatives of the design's variables, by variable."""
        known = orbit_variables(self.spec.template.system)
        features = {name: f"{MODULUS}0" if name == "multiplier_abs" else name for name in self.spec.names}
        return {name: feature for name, feature in features.items() if feature in known}

    def lanes(self, unit: Points, offsets: Float[np.ndarray, "points tolerances"]) -> Lanes:
        """Return the variables of points with offsets, one row each, from every start."""
        sweep = replace(self.spec.template, points=self.spec.columns(unit, offsets))
        self.counts["lanes"] += sweep.lanes
        ds = run_sweep(sweep, progress=False)
        ds = ds if "start" in ds.dims else ds.expand_dims("start")
        return {str(name): x.transpose("point", "start", ...).values for name, x in ds.items() if "point" in x.dims}

    def assess(self, points: Points | Sequence[Unit], offsets: Offsets) -> list[Assessment]:
        """Assess points over samples of their boxes, in one batch of lanes."""
        if not len(points):
            return []
        number = len(offsets)
        lanes = self.lanes(np.repeat(points, number, axis=0), np.tile(offsets, (len(points), 1)))
        parts = (slice(number * k, number * (k + 1)) for k in range(len(points)))
        return [
            Assessment.of(self.spec, unit, offsets, {name: x[part] for name, x in lanes.items()})
            for unit, part in zip(points, parts, strict=True)
        ]

    def map(self) -> list[Assessment]:
        """Assess the points of a grid or a Sobol sample over the bounds, without tolerances."""
        count = len(self.spec.varied)
        if count in MAP_AXIS:
            return self.assess(np.array([*product(np.linspace(0, 1, MAP_AXIS[count]), repeat=count)]), self.centre)
        sampler = qmc.Sobol(count, seed=0)
        points = self.assess(sampler.random(FIRST_SAMPLE), self.centre)
        while sum(a.feasible for a in points) < ENOUGH_FEASIBLE and len(points) < LARGEST_SAMPLE:
            points += self.assess(sampler.random(len(points)), self.centre)
        return points

    def seeds(self, points: Sequence[Assessment]) -> list[Assessment]:
        """Return the best points of the map that are apart from one another, assessed over the box."""
        spacing = self.spacing(len(points))
        tried = distinct(points, min(APART, 0.99 * spacing), TRIED_SEEDS)
        return distinct(self.assess([a.unit for a in tried], self.box), APART, SEEDS)

    def spacing(self, points: int) -> float:
        """Return the typical distance between neighbouring points of the map."""
        return 1 / (points ** (1 / len(self.spec.varied)) - 1)

    def best(self, seeds: Sequence[Assessment], radius: float) -> list[Assessment]:
        """Return verified candidates, best first: the optima of the seeds' orbits, improved by lanes.

        A candidate that fails in verification adds its failing samples to the box of the search, and goes on.
        """
        points: list[Unit] = []
        for seed in seeds:
            points += self.climb(seed, points)
        candidates = distinct([*seeds, *self.assess(points, self.box)], APART / 2, RESULTS)
        verified: list[Assessment] = []
        for _ in range(MAX_REPAIRS):
            candidates = self.zoom(candidates, radius)
            checked = self.verify(candidates)
            verified += checked
            failing = [a for a in checked if not a.feasible]
            if len(self.box) == 1 or not failing or any(a.feasible for a in checked):
                break
            self.box = np.concatenate([self.box, *(a.offsets[self._failing(a)] for a in failing)])
            candidates, radius = self.assess([a.unit for a in candidates], self.box), REPAIR_RADIUS
        return distinct(verified, SAME_POINT, RESULTS)

    def verify(self, candidates: Sequence[Assessment]) -> list[Assessment]:
        """Assess candidates at the centre, all corners, draws of a slightly larger box, and near the worst samples."""
        count = len(self.spec.tolerances)
        if not count:
            return list(candidates)
        draws = DRAWN_BOX * (2 * qmc.Sobol(count, seed=2).random(DRAWS) - 1)
        offsets = np.concatenate([self.centre, self.corners, draws])
        checked = self.assess([a.unit for a in candidates], offsets)
        for width in NEAR_WIDTHS:  # the worst sample of a ridge that crosses the box lies between those before
            cube = DRAWN_BOX * width * (2 * qmc.Sobol(count, seed=3).random(NEAR_DRAWS) - 1)
            checked = [self._with_samples(a, cube) if a.feasible else a for a in checked]
        return checked

    def _with_samples(self, a: Assessment, cube: Offsets) -> Assessment:
        """Assess a candidate at further samples, around the worst ones of the objective and of each limit."""
        rows = [a.values[self.spec.maximise], *a.slack]
        worst = {int(np.nanmin(np.where(a.good, x, np.inf), axis=1).argmin()) for x in rows}
        near = np.concatenate([np.clip(a.offsets[k] + cube, -DRAWN_BOX, DRAWN_BOX) for k in sorted(worst)])
        [b] = self.assess([a.unit], near)
        lanes = {name: np.concatenate([x, b.lanes[name]]) for name, x in a.lanes.items()}
        return Assessment.of(self.spec, a.unit, np.concatenate([a.offsets, near]), lanes)

    def _failing(self, a: Assessment) -> list[int]:
        """Return some samples at which a requirement fails, by index."""
        share = self.spec.share or (1.0, 1.0)
        failing = np.flatnonzero((a.good.mean(axis=1) < share[0]) | (a.good.mean(axis=1) > share[1]))
        return failing[:: max(1, len(failing) // ADDED_SAMPLES)][:ADDED_SAMPLES].tolist()

    def zoom(self, candidates: Sequence[Assessment], radius: float) -> list[Assessment]:
        """Improve candidates by lanes alone, on ridges where a stick appears, at borders, and without derivatives.

        Each round draws points from a box around the best one, whose shape is the covariance of the best few so far.
        An optimum of SLSQP ends after one round nearby without a gain.
        """
        count = len(self.spec.varied)
        sampler = qmc.Sobol(count, seed=4)
        pools = [[a] for a in candidates]
        smooth = [any(np.array_equal(a.unit, unit) for unit in self.optima) for a in candidates]
        shapes = [(CHECK_RADIUS if done else radius) * np.eye(count) for done in smooth]
        patience = [1 if done else ZOOM_PATIENCE for done in smooth]
        for _ in range(ZOOM_ROUNDS):
            active = [k for k, left in enumerate(patience) if left > 0]
            cubes = [2 * sampler.random(ZOOM_PROPOSALS[count > 2]) - 1 for _ in active]
            points = [np.clip(pools[k][0].unit + x @ shapes[k].T, 0.0, 1.0) for k, x in zip(active, cubes, strict=True)]
            found = iter(self.assess([unit for own in points for unit in own], self.box))
            for k, own in zip(active, points, strict=True):
                best = pools[k][0]
                pool = sorted([*pools[k], *(next(found) for _ in own)], key=lambda a: a.rank)[:ZOOM_ELITE]
                moves = (
                    np.array([a.unit for a in pool]) - best.unit
                )  # from the last best one: steady progress widens the box
                shapes[k] = np.linalg.cholesky(3 * moves.T @ moves / len(moves) + 1e-14 * np.eye(count))
                pools[k] = pool
                gain = best.rank[0] > pool[0].rank[0] or -pool[0].rank[1] > -best.rank[1] * (1 + ZOOM_GAIN)
                patience[k] = ZOOM_PATIENCE if gain else patience[k] - 1
                near = (pools[j][0] for j in range(len(pools)) if j != k and patience[j] > 0)
                beaten = any(np.abs(a.unit - pool[0].unit).max() < SAME_POINT and a.rank <= pool[0].rank for a in near)
                if beaten or np.abs(shapes[k]).max() < ZOOM_LEAST_SPREAD:
                    patience[k] = 0
        return distinct([pool[0] for pool in pools], SAME_POINT, RESULTS)

    def climb(self, seed: Assessment, known: Sequence[Unit]) -> list[Unit]:
        """Return points on the way to the optimum of the seed's periodic orbits, by SLSQP; none without derivatives.

        SLSQP maximises t under f >= t for each motion of the starts and, for a robust design, each sample of the box.
        The limits hold for each motion and sample. No motion has to settle here. It ends near points that are `known`.
        """
        if not self.has_derivatives(seed):
            return []
        orbits, count = BoxOrbits(self.spec, self.features, seed), len(self.spec.varied)
        if not orbits.visits:
            return []
        objectives = orbits.objectives
        is_objective = 1.0 * (np.arange(len(orbits.visits[0].rows)) < objectives)
        limits = {
            "fun": lambda z: orbits.at(z[:count]).rows - z[-1] * is_objective,
            "jac": lambda z: np.column_stack([orbits.at(z[:count]).slopes, -is_objective]),
        }
        path, radius = [orbits.visits[0]], FIRST_RADIUS
        for _ in range(SLSQP_MAX_ROUNDS):
            now = path[-1]
            box = zip(np.maximum(0.0, now.unit - radius), np.minimum(1.0, now.unit + radius), strict=True)
            done = False
            with suppress(LostOrbit):
                end = minimize(
                    lambda z: -z[-1], [*now.unit, now.rows[:objectives].min()], jac=lambda z: -np.eye(count + 1)[-1],
                    method="SLSQP", bounds=[*box, (None, None)], constraints={"type": "ineq", **limits},
                    options={"maxiter": SLSQP_MAX_ITERATIONS, "ftol": 1e-9},
                )  # fmt: skip
                done = bool(end.success) and float(np.abs(end.x[:count] - now.unit).max()) < 0.99 * radius
            best = max(orbits.visits, key=lambda visit: visit.rank(objectives))
            moved = float(np.abs(best.unit - now.unit).max())
            if best is not now:
                path.append(best)
            if done:
                self.optima.append(best.unit)
            radius = min(2 * radius, LARGEST_RADIUS) if moved > radius / 2 else radius / 4
            met = any(np.abs(best.unit - unit).max() < SAME_POINT for unit in known)
            if done or met or radius < LEAST_RADIUS:
                break
        self.counts["orbits"] += len(orbits.visits) * len(seed.motions) * len(orbits.box)
        return [path[k].unit for k in sorted({len(path) - 1, len(path) // 2, len(path) // 4})]

    def has_derivatives(self, a: Assessment) -> bool:
        """Return whether all variables have derivatives, and the nominal orbits of all motions were found."""
        known = set(self.features) == set(self.spec.names) and "orbit_reason" in a.lanes and bool(a.motions)
        return known and all(has_orbit(a.lanes, start) for start in a.motions)

    def gradients(self, candidates: Sequence[Assessment]) -> list[Unit]:
        """Return the derivatives of the objective at nominal points, of the motion with the least objective.

        They follow from the periodic orbit or, without one, from central differences of lanes. NaN: unknown.
        """
        spec, count = self.spec, len(self.spec.varied)
        slopes = []
        for a in candidates:
            slope = np.full(count, np.nan)
            if self.has_derivatives(a):
                _, chain = scene_parameters(spec, a.unit[None], self.centre)
                of = (self.features[spec.maximise],)
                orbit = orbits_at(spec, a, a.motions[0], [0]).derivatives(of, tuple(chain))
                slope = orbit.derivatives[0, 0] @ np.concatenate([*chain.values()])
            if not np.isfinite(slope).all() and a.motions:
                moves = DIFFERENCE_STEP * np.concatenate([np.eye(count), -np.eye(count)])
                x = [b.values[spec.maximise][0, a.motions[0]] for b in self.assess(a.unit + moves, self.centre)]
                repeats = a.lanes["cycles"][0, a.motions[0]] > 0 if "cycles" in a.lanes else True
                slope = np.where(repeats, np.subtract(x[:count], x[count:]) / (2 * DIFFERENCE_STEP), np.nan)
            slopes.append(slope / (spec.high - spec.low))
        return slopes
