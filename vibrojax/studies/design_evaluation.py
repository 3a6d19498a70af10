"""Simulation of points from every start, their assessment against the subject of a design, and the coarse map."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy.stats import qmc

from vibrojax.maps.run import run_sweep
from vibrojax.measures.labels import REGIMES
from vibrojax.periodic.orbit_derivatives import MODULUS, orbit_variables
from vibrojax.studies.design_spec import Constraint, DesignSpec

Unit = Float[np.ndarray, " varied"]
Offsets = Float[np.ndarray, "samples tolerances"]

AXIS_POINTS = {1: 33, 2: 16}
"""Points per axis of the map for one and two varied parameters, which make a grid."""

FIRST_SAMPLE, LARGEST_SAMPLE = 16, 2048
"""Sobol points of the map for more varied parameters: doubled until enough of them are feasible."""

ENOUGH_FEASIBLE = 4
"""Feasible points of the map with which a sample is not doubled."""

SAME_ORBIT = 1e-6
"""Relative difference within which the motions from two starts count as one."""


class Lanes(NamedTuple):
    """Simulated points: `values` by variable (points, starts), `in_regime` (points, starts), and the `dataset`."""

    values: dict[str, np.ndarray]
    in_regime: Bool[np.ndarray, "points starts"]
    dataset: xr.Dataset

    def part(self, points: slice) -> "Lanes":
        """Return consecutive points."""
        values = {name: x[points] for name, x in self.values.items()}
        return Lanes(values, self.in_regime[points], self.dataset.isel(point=points))

    def joined(self, other: "Lanes") -> "Lanes":
        """Return these points and others of the same sweep."""
        values = {name: np.concatenate([x, other.values[name]]) for name, x in self.values.items()}
        dataset = xr.concat([self.dataset, other.dataset], "point", data_vars="minimal", join="override")
        return Lanes(values, np.concatenate([self.in_regime, other.in_regime]), dataset)


@dataclass
class Simulator:
    """Simulation of a design's points, with counts of the lanes, and of the orbits that were differentiated."""

    spec: DesignSpec
    lanes: int = 0
    orbits: int = 0
    names: tuple[str, ...] = field(init=False)
    history: list[tuple[Float[np.ndarray, "points varied"], "Lanes"]] = field(default_factory=list)

    def __post_init__(self) -> None:
        spec = self.spec
        against = (spec.front.against,) if spec.front is not None and spec.front.against != "tolerance" else ()
        variables = (spec.maximise, *(c.variable for c in spec.constraints), *against)
        self.names = tuple(dict.fromkeys(variables))

    @cached_property
    def features(self) -> dict[str, str]:
        """The features of orbits that have the derivatives of the variables, by variable."""
        known = orbit_variables(self.spec.template.system)
        features = {name: f"{MODULUS}0" if name == "multiplier_abs" else name for name in self.names}
        return {name: feature for name, feature in features.items() if feature in known}

    def __call__(self, unit: Float[np.ndarray, "points varied"], offsets: Offsets) -> Lanes:
        """Simulate points of the unit box with offsets (in half-widths), one row each, from every start."""
        spec = self.spec
        sweep = spec.sweep(spec.columns(unit, offsets))
        self.lanes += sweep.lanes
        ds = run_sweep(sweep, progress=False)
        rows = ds if "start" in ds.dims else ds.expand_dims("start")
        rows = rows.transpose("point", "start", ...)
        values = {}
        for name in self.names:
            x = rows[name].values.astype(float)
            values[name] = x if x.ndim == 2 else np.fmax.reduce(x, axis=2)
        in_regime = np.isfinite(values[self.spec.maximise])
        if self.spec.regime is not None:
            in_regime &= rows["regime"].values == REGIMES.index(self.spec.regime)
        elif "status" in rows:
            in_regime &= rows["status"].values == 0
        lanes = Lanes(values, in_regime, rows)
        if spec.share is None and set(spec.varied) == set(spec.tolerances):
            widths = np.array([spec.tolerances[name] for name in spec.varied]) / (spec.high - spec.low)
            places = [list(spec.tolerances).index(name) for name in spec.varied]
            self.history.append((unit + offsets[:, places] * widths, lanes))
        return lanes

    def failures(self, constraints: Sequence[Constraint]) -> Float[np.ndarray, "points varied"]:
        """Return the points of the unit box at which a simulated lane failed; every tolerance box excludes them.

        They are known where the varied parameters have the tolerances, and all starts must be good.
        """
        failed = [np.zeros((0, len(self.spec.varied)))]
        for unit, lanes in self.history:
            good = lanes.in_regime.all(axis=1)
            for c in constraints:
                good &= (c.slack(lanes.values[c.variable]) >= 0).all(axis=1)
            failed.append(unit[~good])
        return np.concatenate(failed)


class Assessment(NamedTuple):
    """Assessment of one nominal point over its samples; the first sample is the nominal point.

    - `objective`: at the nominal point, worst over the good starts; NaN if there are none.
    - `badness`: 0 for a feasible point, else a measure of the violations.
    - `slack` (constraints, starts): least slack over the samples.
    - `good` (samples, starts): lanes in which all requirements hold.
    - `lost`: share of (sample, start) lanes in another regime.
    - `lanes`: the simulated lanes.
    """

    objective: float
    badness: float
    slack: Float[np.ndarray, "constraints starts"]
    good: Bool[np.ndarray, "samples starts"]
    lost: float
    lanes: Lanes

    @property
    def feasible(self) -> bool:
        """True if every requirement holds in every sample."""
        return self.badness == 0

    @property
    def rank(self) -> tuple[float, float]:
        """Key of the order from best to worst."""
        return self.badness, -float(np.nan_to_num(self.objective, nan=-np.inf))

    def better(self, other: "Assessment", gain: float = 1e-9) -> bool:
        """Return whether this point is better: less bad, or feasible with an objective greater by a share `gain`."""
        if self.badness != other.badness:
            return self.badness < other.badness
        if not np.isfinite(other.objective):
            return bool(np.isfinite(self.objective))
        return bool(self.objective > other.objective + gain * abs(other.objective))


def assess(lanes: Lanes, spec: DesignSpec, constraints: Sequence[Constraint]) -> Assessment:
    """Assess a nominal point, whose samples are the points of `lanes`."""
    fit = lanes.in_regime
    slack = np.array([c.slack(lanes.values[c.variable]) for c in constraints]).reshape(-1, *fit.shape)
    slack = np.where(np.isnan(slack) & fit, -1.0, slack)
    objective = lanes.values[spec.maximise][0]
    violation = np.maximum(np.where(fit, -slack, 0.0), 0.0)
    good = fit & (slack >= 0).all(axis=0)
    lost = float((~fit).mean())
    if spec.share is None:
        # Of two points that fail, one in the regime is better than one outside, whatever its violations.
        worst_of = violation.max(axis=(1, 2), initial=0.0)
        badness = (len(slack) + 1) * lost + float((worst_of / (1 + worst_of)).sum())
    else:
        share = good.mean(axis=1)
        short = np.maximum(np.maximum(spec.share[0] - share, share - spec.share[1]), 0.0).max()
        badness = float(short) if good[0].any() or short > 0 else 1.0
    counted = good[0] if good[0].any() else fit[0]
    worst = float(objective[counted].min()) if counted.any() else np.nan
    least = np.where(fit, slack, np.inf).min(axis=1)
    return Assessment(worst, badness, least, good, lost, lanes)


def extreme(values: np.ndarray, end: str) -> float:
    """Return the worst of some values for a limit of this kind: the greatest for "most"; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float("nan") if not known.size else float(known.max() if end == "most" else known.min())


def distinct_starts(assessment: Assessment) -> list[int]:
    """Return the good starts of the nominal point that lead to different motions, the worst objective first."""
    lanes = assessment.lanes
    chosen: list[int] = []
    starts = np.flatnonzero(assessment.good[0] if assessment.good[0].any() else lanes.in_regime[0])
    first = next(iter(lanes.values))
    for start in sorted(starts, key=lambda s: lanes.values[first][0, s]):
        motion = [x[0, start] for x in lanes.values.values()]
        known = ([x[0, other] for x in lanes.values.values()] for other in chosen)
        if not any(np.allclose(motion, other, rtol=SAME_ORBIT, atol=0, equal_nan=True) for other in known):
            chosen.append(int(start))
    return chosen


class CoarseMap(NamedTuple):
    """The points of the map in the unit box, their assessments without tolerances, and the points' typical spacing."""

    unit: Float[np.ndarray, "points varied"]
    assessments: list[Assessment]
    spacing: float


def coarse_map(simulator: Simulator) -> CoarseMap:
    """Simulate the map from every start."""
    spec = simulator.spec
    count = len(spec.varied)
    if count in AXIS_POINTS:
        axis = np.linspace(0, 1, AXIS_POINTS[count])
        unit = np.stack(np.meshgrid(*[axis] * count, indexing="ij"), axis=-1).reshape(-1, count)
        return CoarseMap(unit, _assessed(simulator, unit), 1 / (AXIS_POINTS[count] - 1))
    sampler = qmc.Sobol(count, seed=0)
    unit = sampler.random(FIRST_SAMPLE)
    assessments = _assessed(simulator, unit)
    while sum(a.feasible for a in assessments) < ENOUGH_FEASIBLE and len(unit) < LARGEST_SAMPLE:
        more = sampler.random(len(unit))
        unit = np.concatenate([unit, more])
        assessments += _assessed(simulator, more)
    return CoarseMap(unit, assessments, len(unit) ** (-1 / count))


def _assessed(simulator: Simulator, unit: Float[np.ndarray, "points varied"]) -> list[Assessment]:
    lanes = simulator(unit, np.zeros((len(unit), len(simulator.spec.tolerances))))
    return [assess(lanes.part(slice(k, k + 1)), simulator.spec, simulator.spec.constraints) for k in range(len(unit))]


def ranked(spec: DesignSpec, coarse: CoarseMap, constraints: Sequence[Constraint]) -> list[int]:
    """Return the points of the map under these constraints, best first."""
    own = constraints is spec.constraints
    ranks = [(a if own else assess(a.lanes, spec, constraints)).rank for a in coarse.assessments]
    return sorted(range(len(ranks)), key=ranks.__getitem__)
