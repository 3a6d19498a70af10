"""Points of a design: what it asks for, the assessment of their lanes, and their periodic orbits over the box."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrojax.errors import Place
from vibrojax.io.variables import ORBIT_REASONS, Variable
from vibrojax.maps.sweep import Sweep, with_substitutes
from vibrojax.measures.labels import REGIMES
from vibrojax.periodic.derivatives import MODULUS
from vibrojax.periodic.orbits import Orbits, orbits_of

Unit = Float[np.ndarray, " varied"]
Points = Float[np.ndarray, "points varied"]
Offsets = Float[np.ndarray, "samples tolerances"]
Lanes = dict[str, np.ndarray]
"""Variables of lanes by name, arrays (points or samples, starts, ...)."""

LARGEST_MODULUS = 0.98
"""Largest modulus of a multiplier on orbits: nearer to 1, an orbit is about to lose its stability."""

INSIDE = 1e-6
"""Slack that SLSQP keeps, which covers its own tolerance."""

ORBIT_REACH = 1.0
"""Distance in half swings from the prediction beyond which an orbit counts as another one."""

COMPLEX_STEP = 1e-20
"""Imaginary step by which substitutions of parameters are differentiated, without rounding errors."""


@dataclass(frozen=True)
class Constraint:
    """A limit of a variable; `end`: "least" or "most". `margin`: amount by which the search tightens the limit."""

    variable: str
    end: str
    limit: float
    margin: float = 0.0

    def slack(self, values: Any) -> Any:
        """Return the distance from the tightened limit, negative where it is violated, relative to the limit."""
        distance = self.limit - values if self.end == "most" else values - self.limit
        return (distance - self.margin) / self.scale

    @property
    def scale(self) -> float:
        """Unit of the slack."""
        return abs(self.limit) or 1.0

    @property
    def sign(self) -> float:
        """Sign of the slack's derivative with respect to the variable."""
        return -1.0 if self.end == "most" else 1.0


@dataclass(frozen=True)
class Front:
    """A front: the best objective over values of `against`, a limited variable, or "tolerance" (a factor)."""

    against: str
    end: str
    points: int
    span: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class DesignSpec:
    """A checked design.

    - `robust`: True to maximise the worst value over the tolerances. `names`: all variables that the design limits.
    - `varied`: names, with bounds `low` and `high`; the search scales these to the unit box.
    - `tolerances`: half-widths by name; `fixed`: nominal values of those parameters that are not varied.
    - `share`: least and greatest share of good starts, or None if all starts must be good.
    - `template`: a sweep at the bounds; `place`: place of the design in messages; `text`: the design as TOML.
    """

    place: Place
    text: str
    template: Sweep
    maximise: str
    robust: bool
    varied: tuple[str, ...]
    low: Float[np.ndarray, " varied"]
    high: Float[np.ndarray, " varied"]
    tolerances: dict[str, float]
    fixed: dict[str, float]
    regime: str | None
    share: tuple[float, float] | None
    constraints: tuple[Constraint, ...]
    front: Front | None
    variables: dict[str, Variable]

    @property
    def names(self) -> tuple[str, ...]:
        """The variables that the search needs: what is maximised, limited, or the axis of a front."""
        against = (self.front.against,) if self.front is not None and self.front.against != "tolerance" else ()
        return tuple(dict.fromkeys((self.maximise, *(c.variable for c in self.constraints), *against)))

    def columns(
        self, unit: Float[np.ndarray, "points varied"], offsets: Float[np.ndarray, "points tolerances"]
    ) -> dict[str, np.ndarray]:
        """Return the parameters of points: nominal values in the unit box, and offsets in half-widths."""
        values = dict(zip(self.varied, (self.low + unit * (self.high - self.low)).T, strict=True))
        for name, value in self.fixed.items():
            values[name] = np.full(len(unit), value)
        for k, (name, width) in enumerate(self.tolerances.items()):
            values[name] = values[name] + offsets[:, k] * width
        return values


@dataclass(frozen=True, eq=False)
class Assessment:
    """A nominal point, its lanes at samples of the tolerance box, and how well these meet the requirements.

    - `unit`: the point, scaled to the bounds. `offsets`: the samples in half-widths; the first is the centre.
    - `lanes`: all variables; `values`: those that the design names, of arrays the greatest.
    - `fit`, `good` (samples, starts): lanes in the regime, and those that meet the limits as well.
    - `slack` (constraints, samples, starts): distance to the tightened limit, relative to the limit.
    - `objective`, `worst`: of the good lanes at the nominal point, and at all samples; NaN if there are none.
    - `badness`: 0 if all requirements hold, else a measure of the violations. `rank`: order from best to worst.
    """

    unit: Unit
    offsets: Offsets
    constraints: Sequence[Constraint]
    lanes: Lanes
    values: Lanes
    fit: Bool[np.ndarray, "samples starts"]
    good: Bool[np.ndarray, "samples starts"]
    slack: Float[np.ndarray, "constraints samples starts"]
    objective: float
    worst: float
    badness: float
    rank: tuple[float, float]

    @classmethod
    def of(cls, spec: DesignSpec, unit: Unit, offsets: Offsets, lanes: Lanes) -> "Assessment":
        """Assess the lanes of a nominal point."""
        values = {name: x if x.ndim == 2 else np.fmax.reduce(x, axis=2) for name in spec.names for x in [lanes[name]]}
        objective = values[spec.maximise]
        fit = np.isfinite(objective)
        if spec.regime is not None:
            fit = fit & (lanes["regime"] == REGIMES.index(spec.regime))
        elif "status" in lanes:
            fit = fit & (lanes["status"] == 0)
        slack = np.array([c.slack(values[c.variable]) for c in spec.constraints]).reshape(-1, *fit.shape)
        slack = np.where(np.isnan(slack) & fit, -1.0, slack)
        good = fit & (slack >= 0).all(axis=0)
        if spec.share is None:
            # Of two points that fail, one in the regime is better than one outside, whatever its violations.
            violation = np.where(fit, np.maximum(-slack, 0.0), 0.0).max(axis=(1, 2), initial=0.0)
            badness = (len(slack) + 1) * float((~fit).mean()) + float((violation / (1 + violation)).sum())
        else:
            share = good.mean(axis=1)
            badness = float(np.maximum(np.maximum(spec.share[0] - share, share - spec.share[1]), 0.0).max())
            badness = badness if good[0].any() or badness > 0 else 1.0
        counted = good if good[0].any() else fit
        centre = extreme(objective[:1][counted[:1]], "least")
        worst = extreme(objective[counted], "least")
        merit = worst if spec.robust else centre
        rank = badness, np.inf if np.isnan(merit) else -merit
        return cls(unit, offsets, spec.constraints, lanes, values, fit, good, slack, centre, worst, badness, rank)

    @property
    def feasible(self) -> bool:
        """True if every requirement holds in every sample."""
        return self.badness == 0

    @property
    def nominal(self) -> Lanes:
        """The lanes of the nominal point."""
        return {name: x[:1] for name, x in self.lanes.items()}

    @property
    def motions(self) -> list[int]:
        """Good starts of the nominal point that lead to different motions, the least objective first."""
        rows = np.array([x[0] for x in self.values.values()]).T
        starts = np.flatnonzero(self.good[0] if self.good[0].any() else self.fit[0])
        chosen: list[int] = []
        for start in sorted(starts, key=lambda s: rows[s, 0]):
            if not any(np.allclose(rows[start], rows[k], rtol=1e-6, atol=0, equal_nan=True) for k in chosen):
                chosen.append(int(start))
        return chosen

    def held(self, name: str, rows: slice = slice(None)) -> np.ndarray:
        """Return a variable's values in the lanes of the regime, or in all lanes if none is in it."""
        values, fit = self.values[name][rows], self.fit[rows]
        return np.asarray(values[fit] if fit.any() else values)


def extreme(values: np.ndarray, end: str) -> float:
    """Return the worst of some values for a limit of this kind: the greatest for "most"; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float("nan") if not known.size else float(known.max() if end == "most" else known.min())


class Visit(NamedTuple):
    """Orbits over the box of a point: rows of objectives, limits and stability, and their slopes.

    `orbits` has one batch of samples for each motion, `orbit_slopes` the derivatives of their states with respect to
    the parameters `by`.
    """

    unit: Unit
    rows: Float[np.ndarray, " rows"]
    slopes: Float[np.ndarray, "rows varied"]
    orbits: list[Orbits]
    by: tuple[str, ...]
    orbit_slopes: list[np.ndarray]

    def rank(self, objectives: int) -> tuple[float, float]:
        """Return the key of the order from worst to best: smaller violations, then a greater least objective."""
        excess = float(self.rows[objectives:].min(initial=0.0)) + INSIDE / 2
        return min(excess, 0.0), float(self.rows[:objectives].min())


class LostOrbit(Exception):
    """The orbits of a point are not of the same kind as those before."""


class BoxOrbits:
    """The periodic orbits of a point's motions over the box, as functions of the point."""

    def __init__(self, spec: DesignSpec, features: dict[str, str], seed: Assessment) -> None:
        self.spec = spec
        self.scale = abs(seed.objective) or 1.0
        self.of = (*(features[name] for name in spec.names), f"{MODULUS}0")
        self.visits: list[Visit] = []
        sound = [
            k for k in range(len(seed.offsets))
            if spec.robust or spec.constraints or not k
            if all(has_orbit(seed.lanes, start, k) for start in seed.motions)
        ]  # fmt: skip
        self.box = seed.offsets[sound]
        self.objectives = len(seed.motions) * (len(sound) if spec.robust else 1)
        self.impacts: list[float] | None = None
        first = self._visit(seed.unit, [orbits_at(spec, seed, start, sound) for start in seed.motions])
        if first is not None:
            self.visits.append(first)

    def at(self, unit: Unit) -> Visit:
        """Return the orbits at a point, carried from the nearest point visited; raise `LostOrbit` without them."""
        near = min(self.visits, key=lambda visit: float(np.abs(visit.unit - unit).max()))
        if np.array_equal(near.unit, unit):
            return near
        parameters, _ = self._parameters(unit)
        carried = [
            orbits.carry_to(parameters, within=ORBIT_REACH, least=1.0, by=near.by, slopes=slopes)
            for orbits, slopes in zip(near.orbits, near.orbit_slopes, strict=True)
        ]
        arrived = all(arrived.all() for _, arrived in carried)
        visit = self._visit(unit, [orbits for orbits, _ in carried]) if arrived else None
        if visit is None:
            raise LostOrbit
        self.visits.append(visit)
        return visit

    def _parameters(self, unit: Unit) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        return scene_parameters(self.spec, np.repeat(unit[None], len(self.box), axis=0), self.box)

    def _visit(self, unit: Unit, orbits: list[Orbits]) -> Visit | None:
        """Return the rows of a point from its orbits; None if these lack a value or are not of the same kind."""
        spec, (_, chain) = self.spec, self._parameters(unit)
        jacobian = np.stack([*chain.values()], axis=1)
        objectives, limits, orbit_slopes = [], [], []
        for batch in orbits:
            features = batch.derivatives(self.of, tuple(chain))
            values, gradients = features.values, features.derivatives @ jacobian
            if not (np.isfinite(values).all() and np.isfinite(gradients).all() and np.ptp(batch.impacts) == 0):
                return None
            orbit_slopes.append(features.state_derivatives)
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


def has_orbit(lanes: Lanes, start: int, sample: int = 0) -> bool:
    """Return whether the orbit of a lane was found, with as many section crossings as that of the nominal point."""
    same = lanes["orbit_cycles"][sample, start] == lanes["orbit_cycles"][0, start]
    return bool(same and lanes["orbit_reason"][sample, start] == ORBIT_REASONS.index("found"))


def orbits_at(spec: DesignSpec, a: Assessment, start: int, samples: Sequence[int]) -> Orbits:
    """Return the orbits of the lanes from a start, at samples of the box."""
    scene = spec.template.system
    values, _ = scene_parameters(spec, np.repeat(a.unit[None], len(samples), axis=0), a.offsets[samples])
    [lanes] = orbits_of(
        scene, {name: x[samples, start] for name, x in a.lanes.items() if x.ndim == 2}, values, np.arange(len(samples))
    )
    return Orbits.find(scene, values, lanes.states, within=ORBIT_REACH).refined()


def scene_parameters(
    spec: DesignSpec, unit: Points, offsets: Offsets
) -> tuple[dict[str, np.ndarray], dict[str, Float[np.ndarray, "lanes varied"]]]:
    """Return the scene's parameters of points, and the derivatives of those that depend on the unit box."""
    scene, columns = spec.template.system, spec.columns(unit, offsets)

    def resolved(changed: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        values = with_substitutes(scene, spec.template.parameters | columns | changed)
        return {name: np.broadcast_to(values[name], len(unit)) for name in scene.parameters()}

    values = {name: np.array(x, float) for name, x in resolved({}).items()}
    chain = {name: np.zeros(unit.shape) for name in values}
    for k, name in enumerate(spec.varied):
        step = 1j * COMPLEX_STEP * (spec.high[k] - spec.low[k])
        for parameter, x in resolved({name: columns[name] + step}).items():
            chain[parameter][:, k] = np.imag(x) / COMPLEX_STEP
    return values, {name: slope for name, slope in chain.items() if slope.any()}
