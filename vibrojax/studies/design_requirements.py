"""Requirements of a design: its file, the assessment of a point by its lanes, and why no point is feasible."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, Place, counted, shown, suggestion
from vibrojax.io.variables import Variable
from vibrojax.lanes.labels import sweep_variables
from vibrojax.maps.bounds import MAX_TOLERANCES, VariedFile, read_bounds, read_file
from vibrojax.maps.dataset import parameter_attributes
from vibrojax.maps.read import read_parameters
from vibrojax.maps.sweep import Sweep, with_substitutes
from vibrojax.measures.labels import REGIMES
from vibrojax.physics.parameters import Parameter
from vibrojax.pictures.axes import quantity_text
from vibrojax.scenes import SCENES
from vibrojax.settings.fields import Settings, given, setting
from vibrojax.settings.names import Names
from vibrojax.settings.toml import read_source
from vibrojax.settings.values import STATE, as_table, choice, count, known_keys, quantity, warn_if_far

Unit = Float[np.ndarray, " varied"]
Points = Float[np.ndarray, "points varied"]
Offsets = Float[np.ndarray, "samples tolerances"]
Bounds = dict[str, tuple[float, float]]
Lanes = dict[str, np.ndarray]
"""Variables of lanes by name, arrays (points or samples, starts, ...)."""

MARGIN = 2.0  # of a limit, in units of the accepted relative error of a lane: other runs of the point meet it, too
DRAWN_BOX = 1.04  # from which verification draws, relative to the tolerances: what holds there holds in the box
COMPLEX_STEP = 1e-20  # imaginary, by which substitutions of parameters are differentiated without rounding errors
HALF_WIDTH = Parameter("half-width", 1.0, "1", "half-width of a tolerance", "w", lowest=0.0, open_below=True)
_COUNTS = {"impacts", "striker_turns"}  # whole numbers that are stored as floats, whose limits are not tightened


@dataclass(frozen=True, kw_only=True)
class DesignFile(VariedFile):
    """The file of a design."""

    maximise: Any = setting(MISSING, 'name a variable, like maximise = "impact_energy"', read=given)
    robust: bool = setting(False, "whether to maximise the worst value over the tolerances")
    subject: dict[str, Any] = setting(dict, "regime, share of the starts and limits of variables", read=as_table)
    tolerance: dict[str, Any] = setting(dict, "half-widths of the tolerances", read=as_table)
    front: dict[str, Any] | None = setting(None, "limit over which the best objective is drawn", read=as_table)


@dataclass(frozen=True, kw_only=True)
class Limits(Settings):
    """Limits of a variable, or of the share of the starts."""

    advice: ClassVar[Mapping[str, str]] = {"min": "write least", "max": "write most"}

    least: float | None = setting(None, "least value")
    most: float | None = setting(None, "greatest value")

    def check(self, place: Place) -> None:
        if self.least is not None and self.most is not None and self.least > self.most:
            raise place.error(f"contradictory: least {self.least:g} is above most {self.most:g}")


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
        return abs(self.limit) or 1.0

    @property
    def sign(self) -> float:
        return -1.0 if self.end == "most" else 1.0


def tightened(variables: Mapping[str, Variable], name: str, end: str, limit: float, error: float) -> Constraint:
    """Return a limit of a variable, which is tightened unless the variable counts; `error`: accepted one of a lane."""
    is_smooth = variables[name].dtype == np.float64 and name not in _COUNTS
    return Constraint(name, end, limit, MARGIN * error * is_smooth * abs(limit))


@dataclass(frozen=True)
class Front:
    """A front: the best objective over values of `against`, a limited variable, or "tolerance" (a factor)."""

    against: str
    end: str
    points: int
    span: tuple[float, float] | None


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignSpec:
    """A checked design.

    - `robust`: True to maximise the worst value over the tolerances.
    - `bounds`: least and greatest value of the varied parameters, which the search scales to the unit box.
    - `tolerances`: half-widths by name; `fixed`: nominal values of those parameters that are not varied.
    - `share`: least and greatest share of good starts, or None if all starts must be good.
    - `template`: a sweep at the bounds; `variables`: all variables of its lanes that the design may name.
    - `place`: place of the design in messages; `text`: the design as TOML.
    """

    place: Place
    text: str
    template: Sweep
    maximise: str
    robust: bool
    bounds: Bounds
    tolerances: dict[str, float]
    fixed: dict[str, float]
    regime: str | None
    share: tuple[float, float] | None
    constraints: tuple[Constraint, ...]
    front: Front | None
    variables: dict[str, Variable]

    @cached_property
    def low(self) -> Unit:
        return np.array([low for low, _ in self.bounds.values()])

    @cached_property
    def width(self) -> Unit:
        return np.array([high - low for low, high in self.bounds.values()])

    @property
    def names(self) -> tuple[str, ...]:
        """The variables that the search needs: what is maximised, limited, or the axis of a front."""
        against = (self.front.against,) if self.front is not None and self.front.against != "tolerance" else ()
        return tuple(dict.fromkeys((self.maximise, *(c.variable for c in self.constraints), *against)))

    def within(self, limit: float | None) -> "DesignSpec":
        """Return the design with another limit, or none, of the variable against which the front is drawn."""
        front = self.front
        assert front is not None
        if front.against == "tolerance":
            return replace(self, tolerances={name: (limit or 0) * x for name, x in self.tolerances.items() if limit})
        kept = [c for c in self.constraints if (c.variable, c.end) != (front.against, front.end)]
        if limit is not None:
            kept.append(tightened(self.variables, front.against, front.end, limit, self.template.run.error))
        return replace(self, constraints=(*kept,))

    def columns(self, unit: Points, offsets: Float[np.ndarray, "points tolerances"]) -> dict[str, np.ndarray]:
        """Return the parameters of points: nominal values in the unit box, and offsets in half-widths."""
        values = dict(zip(self.bounds, (self.low + unit * self.width).T, strict=True))
        values |= {name: np.full(len(unit), value) for name, value in self.fixed.items()}
        for k, (name, width) in enumerate(self.tolerances.items()):
            values[name] = values[name] + offsets[:, k] * width
        return values

    def parameters(self, unit: Points, offsets: Offsets) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return the scene's parameters of points, and the derivatives of those that depend on the unit box.

        The derivatives are arrays (points, varied).
        """
        scene, columns = self.template.system, self.columns(unit, offsets)

        def resolved(changed: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            values = with_substitutes(scene, self.template.parameters | columns | changed)
            return {name: np.broadcast_to(values[name], len(unit)) for name in scene.parameters()}

        values = {name: np.array(x, float) for name, x in resolved({}).items()}
        chain = {name: np.zeros(unit.shape) for name in values}
        for k, name in enumerate(self.bounds):
            step = 1j * COMPLEX_STEP * self.width[k]
            for parameter, x in resolved({name: columns[name] + step}).items():
                chain[parameter][:, k] = np.imag(x) / COMPLEX_STEP
        return values, {name: slope for name, slope in chain.items() if slope.any()}

    def column(self, dim: str, name: str, words: str, values: Any) -> tuple[Any, ...]:
        """Return values of a variable of the lanes as a variable of the dataset; `words`: its meaning, with {}."""
        about = self.variables[name]
        return Variable(about.units, words.format(about.long_name)).entry(dim, values)

    def amount(self, name: str, value: float) -> str:
        return f"{value:.6g} {self.variables[name].units}".removesuffix(" 1")

    def requirements(self) -> str:
        words = [f"regime {self.regime}"] if self.regime else []
        for c in self.constraints:
            limit = xr.DataArray(c.limit, attrs={"units": self.variables[c.variable].units})
            words.append(f"{c.variable.replace('_', ' ')} at {c.end} {quantity_text(c.limit, limit)}")
        if self.share is not None:
            words.append(f"share of starts {self.share[0]:g} to {self.share[1]:g}")
        for name, width in self.tolerances.items():
            about = parameter_attributes(self.template, name)
            words.append(f"{about['symbol']} ± {quantity_text(width, xr.DataArray(width, attrs=about))}")
        return "; ".join(words) or "none"


def _unknown_variable(name: str, scene: str, known: Sequence[str]) -> str:
    """Return a message on a variable that the scene lacks: scenes that have it, or else variables whose name has it."""
    if owners := [other for other, kind in SCENES.items() if name in sweep_variables(kind())]:
        return f"scene {shown(scene)} has no {name}; scenes with one: {', '.join(owners)}"
    parts = [other for other in known if name in other.split("_")]
    hint = f"did you mean {' or '.join(parts)}?" if parts else suggestion(name, known)
    return f"no such variable as {shown(name)}; {hint}"


def read_design(source: str | PathLike[str] | Mapping[str, object]) -> DesignSpec:
    """Read and check a design; raise `InputError` with a one-line message at the first problem."""
    origin = read_source(source, "design")
    file, place, names = read_file(DesignFile, origin)
    bounds = read_bounds(place.at("vary"), file.vary, names, file.parameters)
    options = {name: x for name, x in file.parameters.items() if name in names.options}
    numbers = {name: x for name, x in file.parameters.items() if name not in options}
    parameters: dict[str, Any] = read_parameters(place.at("parameters"), numbers, names)
    tolerances, fixed = _read_tolerances(place.at("tolerance"), file, names, parameters, bounds)
    along = ("", "multiplier")  # one value per lane, or along multipliers
    known = {name: about for name, about in sweep_variables(names.system).items() if about.along in along}
    smooth = [name for name in known if known[name].dtype == np.float64]
    if isinstance(file.maximise, str) and file.maximise not in known:
        raise place.at("maximise").error(_unknown_variable(file.maximise, names.scene, smooth))
    maximise = choice(place.at("maximise"), file.maximise, smooth)
    if file.robust and not tolerances:
        raise place.at("robust").error("there is no [tolerance] to be robust to; add one")
    # Orbits give each lane the exact values of its periodic motion, so that objective and limits are smooth.
    run = ({"orbits": True} if file.run.get("method", "located") == "located" else {}) | file.run
    if {maximise, *file.subject} & {"lyapunov", "lyapunov_stderr", "nature", "zero_one"}:
        run["lyapunov"] = True
    points = {name: [*ends] for name, ends in bounds.items()} | {name: [x, x] for name, x in fixed.items()}
    rest = options | {name: x for name, x in parameters.items() if name not in fixed}
    template = file.sweep(origin.file, points, parameters=rest, run=run)
    here, share, constraints, regime = place.at("subject"), None, list[Constraint](), None
    for name, entry in file.subject.items():
        if name == "regime":
            regime = choice(here.at(name), entry, REGIMES)
            continue
        if name != "share" and name not in known:
            raise here.at(name).error(_unknown_variable(name, names.scene, ("share", *known)))
        if not isinstance(entry, dict) or not entry:
            fault = f"{shown(entry)} is not a limit; write {{ least = ... }}, {{ most = ... }} or both"
            raise here.at(name).error(fault)
        limits = Limits.read(here.at(name), entry)
        ends = {end: x for end, x in (("least", limits.least), ("most", limits.most)) if x is not None}
        if name != "share":
            constraints += [tightened(known, name, end, x, template.run.error) for end, x in ends.items()]
            continue
        share = ends.get("least", 0.0), ends.get("most", 1.0)
        if not 0 <= share[0] <= share[1] <= 1:
            raise here.at(name).error(f"{share[0]:g} to {share[1]:g} is not a range of shares between 0 and 1")
    if share is not None and not names.has_starts:
        raise here.at("share").error(f"scene {shown(names.scene)} has no starts; leave it out")
    if regime is not None and template.system.section is None:
        raise here.at("regime").error(f"motions of scene {shown(names.scene)} have no regimes")
    front = None if file.front is None else _read_front(place.at("front"), file.front, known, constraints)
    if front is not None and front.against == "tolerance" and not tolerances:
        raise place.at("front.against").error("there is no [tolerance] to scale; add one")
    if front is not None and front.against == maximise:
        raise place.at("front.against").error(f"{shown(maximise)} is what is maximised; name another variable")
    return DesignSpec(
        place=place, text=origin.text, template=template, maximise=maximise, robust=file.robust, bounds=bounds,
        tolerances=tolerances, fixed=fixed, regime=regime, share=share, constraints=(*constraints,), front=front,
        variables=known,
    )  # fmt: skip


def _read_tolerances(
    place: Place, file: DesignFile, names: Names, parameters: Mapping[str, float], bounds: Bounds
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the half-widths by name, and the nominal values of the parameters that are not varied."""
    if len(file.tolerance) > MAX_TOLERANCES:
        raise place.error(f"{len(file.tolerance)} parameters have a tolerance; give at most {MAX_TOLERANCES}")
    widths, fixed = {}, {}
    followed = names.substituted({*bounds, *parameters})
    for name, given_width in file.tolerance.items():
        here, about = place.at(name), names.parameter(place.at(name), name)
        width = widths[name] = quantity(here, given_width, HALF_WIDTH)
        if name not in bounds:
            if name not in parameters and (name in followed or name not in names.parameters):
                raise here.error("follows from other parameters; give the tolerance of one of these")
            fixed[name] = parameters.get(name, about.default)
        low, high = bounds.get(name) or (fixed[name], fixed[name])
        for end in (low - DRAWN_BOX * width, high + DRAWN_BOX * width):
            if problem := about.problem(end):
                raise here.error(f"{width:g} is too wide at {name} = {low:g}: {problem}")
        if not file.unusual:
            warn_if_far(here, about, high + width, meant="; unusual = true says that it is meant")
    return widths, fixed


def _read_front(
    place: Place, table: dict[str, Any], variables: Mapping[str, Variable], constraints: Sequence[Constraint]
) -> Front:
    """Return the variable against which the front is drawn, its points, and its limits if they are given."""
    known_keys(place, table, ("against", "points", "from", "to"))
    if "against" not in table:
        raise place.at("against").error('missing; name a variable, like "peak_impact_force", or "tolerance"')
    against = choice(place.at("against"), table["against"], ("tolerance", *variables))
    if ("from" in table) != ("to" in table):
        raise place.error("from and to belong together; give both or neither")
    span = None
    if "from" in table:
        span = quantity(place.at("from"), table["from"], STATE), quantity(place.at("to"), table["to"], STATE)
        if span[0] == span[1]:
            raise place.at("from").error(f"{span[0]:g} to {span[1]:g} is no interval")
    end = next((c.end for c in constraints if c.variable == against), "most")
    return Front(against, end, count(place.at("points"), table.get("points", 20), 2, 200), span)


class Assessment:
    """A nominal point, its lanes at samples of the tolerance box, and how well these meet the requirements.

    - `unit`: the point, scaled to the bounds. `offsets`: the samples in half-widths; the first is the centre.
    - `lanes`: all variables; `values`: those that the design names, of arrays the greatest.
    - `fit`, `good` (samples, starts): lanes in the regime, and those that meet the limits as well.
    - `slack` (constraints, samples, starts): distance to the tightened limit, relative to the limit.
    - `share` (samples): share of good starts, and `missed`: by how much it is outside the required range.
    - `objective`, `worst`: of the good lanes at the nominal point, and at all samples; NaN if there are none.
    - `badness`: 0 if all requirements hold, else a measure of the violations. `rank`: order from best to worst.
    """

    def __init__(self, spec: DesignSpec, unit: Unit, offsets: Offsets, lanes: Lanes) -> None:
        self.spec, self.unit, self.offsets, self.lanes = spec, unit, offsets, lanes
        named = {name: lanes[name] for name in spec.names}
        self.values = {name: x if x.ndim == 2 else np.fmax.reduce(x, axis=2) for name, x in named.items()}
        objective = self.values[spec.maximise]
        fit = np.isfinite(objective)
        if spec.regime is not None:
            fit = fit & (lanes["regime"] == REGIMES.index(spec.regime))
        elif "status" in lanes:
            fit = fit & (lanes["status"] == 0)
        slack = np.array([c.slack(self.values[c.variable]) for c in spec.constraints]).reshape(-1, *fit.shape)
        self.fit, self.slack = fit, np.where(np.isnan(slack) & fit, -1.0, slack)
        self.good = fit & (self.slack >= 0).all(axis=0)
        least, most = spec.share or (1.0, 1.0)
        self.share = self.good.mean(axis=1)
        self.missed = np.maximum(np.maximum(least - self.share, self.share - most), 0.0)
        if spec.share is None:
            # Of two points that fail, one in the regime is better than one outside, whatever its violations.
            violation = np.where(fit, np.maximum(-self.slack, 0.0), 0.0).max(axis=(1, 2), initial=0.0)
            badness = (len(slack) + 1) * float((~fit).mean()) + float((violation / (1 + violation)).sum())
        else:
            badness = float(self.missed.max())
            badness = badness if self.good[0].any() or badness > 0 else 1.0
        used = self.good if self.good[0].any() else fit
        self.objective = extreme(objective[:1][used[:1]], "least")
        self.worst = extreme(objective[used], "least")
        merit = self.worst if spec.robust else self.objective
        self.badness, self.rank = badness, (badness, np.inf if np.isnan(merit) else -merit)

    @property
    def feasible(self) -> bool:
        return self.badness == 0

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

    @property
    def nominal(self) -> Lanes:
        return {name: x[:1] for name, x in self.lanes.items()}

    def held(self, name: str, rows: slice = slice(None)) -> np.ndarray:
        """Return a variable's values in the lanes of the regime, or in all lanes if none is in it."""
        values, fit = self.values[name][rows], self.fit[rows]
        return np.asarray(values[fit] if fit.any() else values)


def extreme(values: np.ndarray, end: str) -> float:
    """Return the worst of some values for a limit of this kind: the greatest for "most"; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float("nan") if not known.size else float(known.max() if end == "most" else known.min())


def infeasibility(spec: DesignSpec, points: Sequence[Assessment], checked: Sequence[Assessment]) -> InputError:
    """Return the error for a design without a feasible point: the requirement, and how near the search came."""
    nominal = [*points, *(Assessment(spec, a.unit, a.offsets[:1], a.nominal) for a in checked)]
    without = any(a.feasible for a in nominal)  # then, the tolerances alone are in the way
    nearest = min(checked if without else nominal, key=lambda a: a.badness)
    fit, others, sample = nearest.fit, "", 0
    if spec.share is not None:
        name, required = "share", f"least {spec.share[0]:g}, most {spec.share[1]:g}"
        sample = int(nearest.missed.argmax())
        reached = f"{nearest.share[sample]:.3g}"
    elif fit.any() and (slack := np.where(fit, nearest.slack, np.inf)).min(initial=np.inf) < 0:
        worst, sample, start = map(int, np.unravel_index(slack.argmin(), slack.shape))
        limit = spec.constraints[worst]
        name, required = limit.variable, f"{limit.end} {spec.amount(limit.variable, limit.limit)}"
        reached = spec.amount(name, float(nearest.values[name][sample, start]))
    else:
        sample = int(fit.all(axis=1).argmin())
        name = "regime" if spec.regime else spec.maximise
        required = f"{spec.regime or f'a value of {spec.maximise}'} from every start"
        reached = f"{fit.sum()} of {counted(fit.size, 'lane')}"
        if "regime" in nearest.lanes:
            others = f" ({', '.join(REGIMES[k] for k in np.unique(nearest.lanes['regime'][~fit]))})"

    offsets = np.array([nearest.offsets[sample], 0.0 * nearest.offsets[0]])
    columns = spec.columns(np.array([nearest.unit] * 2), offsets).items()
    where, centre = (", ".join(f"{name} = {x[k]:.4g}" for name, x in columns) for k in range(2))
    where += f" in the tolerance box of {centre}" * without
    how = "at any nominal point, even without the tolerances" * bool(spec.tolerances)
    how = "within the tolerances, although it can be without them" if without else how
    starts = [str(start) for start in spec.template.starts or ()]
    ever = np.any([a.good.any(axis=0) for a in nominal], axis=0)
    if spec.share is None and ever.any() and not ever.all() and len(starts) == ever.size:
        never = [shown(start) for start, good in zip(starts, ever, strict=True) if not good]
        others += f"; no nominal point is good from start {', '.join(never[:4])}{', ...' * (len(never) > 4)}"
    problem = f"{required} cannot be met {how}".rstrip()
    return spec.place.at("subject").at(name).error(f"{problem}; nearest: {reached} at {where}{others}")
