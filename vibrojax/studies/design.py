"""The function `design`: its file, map, search, front and dataset, and the line that says why it has no result."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, replace
from os import PathLike
from typing import Any, ClassVar, NamedTuple

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, Place, counted, shown, suggestion
from vibrojax.io.kinds import dataset_attributes
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.lanes.labels import sweep_variables
from vibrojax.maps.bounds import MAX_TOLERANCES, VariedFile, read_bounds, read_file
from vibrojax.maps.read import read_parameters
from vibrojax.measures.labels import REGIMES, UNBOUNDED
from vibrojax.physics.parameters import Parameter
from vibrojax.pictures.axes import quantity_text
from vibrojax.progress import Progress
from vibrojax.settings.fields import Settings, given, setting
from vibrojax.settings.names import Names
from vibrojax.settings.toml import read_source
from vibrojax.settings.values import STATE, as_table, choice, count, known_keys, quantity
from vibrojax.studies.design_points import Assessment, Constraint, DesignSpec, Front, extreme
from vibrojax.studies.design_search import DRAWN_BOX, Search

MARGIN = 2.0
"""Tightening of a limit, in units of the accepted relative error of a lane: other runs of the point meet it, too."""

FRONT_POINTS = 20
"""Default number of points of a front."""

HALF_WIDTH = Parameter("half-width", 1.0, "1", "half-width of a tolerance", "w", lowest=0.0, open_below=True)

_COUNTS = {"impacts", "striker_turns"}
"""Variables that are stored as floats but are whole numbers, whose limits are not tightened."""

TOLERANCE_SPAN = (0.0, 2.0)
"""Default range of the factor of the tolerances."""

WARM_RADIUS = 0.02
"""Radius of the zoom for a point of a front, in the unit box."""

_YES_NO = ("no", "yes")

DESIGN_VARIABLES = {
    "share": Variable("1", "share of the starts from which all requirements hold at the nominal point"),
    "share_worst": Variable("1", "least such share at the samples of the tolerances"),
    "feasible": Variable("1", "whether all requirements hold at the samples of the tolerances", np.int8, _YES_NO),
    "irregular_share": Variable("1", "share of the lanes of the samples that are irregular, undecided or failed"),
    "gradient": Variable("", "derivative of the objective at the nominal orbit, in its unit per the parameter's"),
    "map_feasible": Variable("1", "whether all requirements hold at the nominal point", np.int8, _YES_NO),
    "front_feasible": Variable("1", "whether a feasible point was found", np.int8, _YES_NO),
}
"""Variables whose units do not depend on the design, unlike objective, subject, map and front."""


class FrontPoint(NamedTuple):
    """A point of a front: its limit, and its verification."""

    limit: float
    checked: Assessment


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


def read_design(source: str | PathLike[str] | Mapping[str, object]) -> DesignSpec:
    """Read and check a design; raise `InputError` with a one-line message at the first problem."""
    origin = read_source(source, "design")
    file, place, names = read_file(DesignFile, origin)
    bounds = read_bounds(place.at("vary"), file.vary, names, file.parameters, file.unusual)
    options = {name: x for name, x in file.parameters.items() if name in names.options}
    numbers = {name: x for name, x in file.parameters.items() if name not in options}
    parameters: dict[str, Any] = read_parameters(place.at("parameters"), numbers, names)
    tolerances, fixed = _read_tolerances(place.at("tolerance"), file.tolerance, names, parameters, bounds)
    along = ("", "multiplier")  # one value per lane, or along multipliers
    known = {name: about for name, about in sweep_variables(names.system).items() if about.along in along}
    smooth = [name for name in known if known[name].dtype == np.float64]
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
    here, regime, share, constraints = place.at("subject"), None, None, []
    for name, entry in file.subject.items():
        if name == "regime":
            regime = choice(here.at(name), entry, REGIMES)
            continue
        if name != "share" and name not in known:
            raise here.at(name).error(f"no such variable; {suggestion(name, ('share', *known))}")
        if not isinstance(entry, dict) or not entry:
            fault = f"{shown(entry)} is not a limit; write {{ least = ... }}, {{ most = ... }} or both"
            raise here.at(name).error(fault)
        limits = Limits.read(here.at(name), entry)
        ends = {end: x for end, x in (("least", limits.least), ("most", limits.most)) if x is not None}
        if name == "share":
            share = ends.get("least", 0.0), ends.get("most", 1.0)
            if not 0 <= share[0] <= share[1] <= 1:
                raise here.at(name).error(f"{share[0]:g} to {share[1]:g} is not a range of shares between 0 and 1")
            continue
        margin = MARGIN * template.run.error * (name in smooth and name not in _COUNTS)
        constraints += [Constraint(name, end, limit, margin * abs(limit)) for end, limit in ends.items()]
    if share is not None and not names.has_starts:
        raise here.at("share").error(f"scene {shown(names.scene)} has no starts; leave it out")
    if regime is not None and template.system.section is None:
        raise here.at("regime").error(f"motions of scene {shown(names.scene)} have no regimes")
    front = None
    if file.front is not None:
        front = _read_front(place.at("front"), file.front, ("tolerance", *known), constraints)
        if front.against == "tolerance" and not tolerances:
            raise place.at("front").at("against").error("there is no [tolerance] to scale; add one")
        if front.against == maximise:
            fault = f"{shown(maximise)} is what is maximised; name another variable"
            raise place.at("front").at("against").error(fault)
    low, high = np.array([*bounds.values()]).T
    return DesignSpec(
        place, origin.text, template, maximise, file.robust, (*bounds,), low, high, tolerances, fixed, regime, share,
        (*constraints,), front, known,
    )  # fmt: skip


def _read_tolerances(
    place: Place,
    table: Mapping[str, Any],
    names: Names,
    parameters: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the half-widths by name, and the nominal values of the parameters that are not varied."""
    if len(table) > MAX_TOLERANCES:
        raise place.error(f"{len(table)} parameters have a tolerance; give at most {MAX_TOLERANCES}")
    widths, fixed = {}, {}
    followed = names.substituted({*bounds, *parameters})
    for name, given_width in table.items():
        here, about = place.at(name), names.parameter(place.at(name), name)
        width = widths[name] = quantity(here, given_width, HALF_WIDTH)
        if name not in bounds:
            if name not in parameters and (name in followed or name not in names.parameters):
                raise here.error("follows from other parameters; give the tolerance of one of these")
            fixed[name] = parameters.get(name, about.default)
        low, high = bounds[name] if name in bounds else (fixed[name], fixed[name])
        for end in (low - DRAWN_BOX * width, high + DRAWN_BOX * width):
            if problem := about.problem(end):
                raise here.error(f"{width:g} is too wide at {name} = {low:g}: {problem}")
    return widths, fixed


def _read_front(
    place: Place, table: dict[str, Any], variables: Sequence[str], constraints: Sequence[Constraint]
) -> Front:
    """Return the variable against which the front is drawn, its points, and its limits if they are given."""
    known_keys(place, table, ("against", "points", "from", "to"))
    if "against" not in table:
        raise place.at("against").error('missing; name a variable, like "peak_impact_force", or "tolerance"')
    against = choice(place.at("against"), table["against"], variables)
    if ("from" in table) != ("to" in table):
        raise place.error("from and to belong together; give both or neither")
    span = None
    if "from" in table:
        span = quantity(place.at("from"), table["from"], STATE), quantity(place.at("to"), table["to"], STATE)
        if span[0] == span[1]:
            raise place.at("from").error(f"{span[0]:g} to {span[1]:g} is no interval")
    end = next((c.end for c in constraints if c.variable == against), "most")
    return Front(against, end, count(place.at("points"), table.get("points", FRONT_POINTS), 2, 200), span)


def design(source: str | PathLike[str] | Mapping[str, object], *, progress: bool = True) -> xr.Dataset:
    """Find the values of varied parameters that maximise a variable, under constraints at samples of the tolerances.

        best = vj.design("design.toml")
        best.isel(candidate=0)

    A coarse map over the varied parameters, from every start, gives the points from which SLSQP begins, with the
    derivatives of the periodic orbits. Lanes then improve what they find, where a stick phase appears, or where a
    border of the regime ends the search. Candidates are simulated again from every start, at all corners of the
    tolerance box and at 256 draws; those that fail are repaired, or left out. Worst values are those of these samples,
    no bounds of the tolerance box: where `irregular_share` is above 0, they depend on the time of observation as well.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "energy", or a dict with the same structure: `scene`,
      `maximise`, `vary`, and optionally `robust`, `subject`, `tolerance`, `parameters`, `starts`, `run`, `front`,
      `title`.
    - `progress`: True to report progress on stderr.

    **Returns:** a dataset along `candidate`, best first:

    - the varied parameters; `objective` at the nominal point, worst over the starts; `objective_worst` of the samples
      of the tolerances, by which a robust design is ranked; the variables of the subject, each at the nominal point
      and as `NAME_worst`; `feasible`.
    - `gradient` along `parameter`.
    - with a front: along `front`, `front_objective`, the varied parameters, and what the front is drawn against.
    - along `map`: the coarse map.

    **Raises:** `InputError` for an invalid design, if there is no feasible point, or if the objective is 0 at all of
    them: the message says which requirement cannot be met, and how near the search came.

    **Example:**

    >>> asked = {"scene": "vibro-impact", "maximise": "impact_velocity", "starts": ["stuck"]}
    >>> asked |= {"vary": {"gamma": [0.6, 0.9]}, "subject": {"regime": "single-impact"}}
    >>> best = vj.design(asked, progress=False).isel(candidate=0)
    >>> bool(best.feasible == 1), round(float(best.gamma), 2)
    (True, 0.6)
    """
    return find_design(read_design(source), progress)


def find_design(spec: DesignSpec, progress: bool = True) -> xr.Dataset:
    """Return the dataset of a checked design, see [vibrojax.studies.design.design][]."""
    search = Search(spec)
    with Progress(2 + (spec.front is not None), "stages", progress, pace=False) as bar:
        points = search.map()
        count = sum(a.feasible for a in points)
        bar.add(1, f"map: {count} of {len(points)} points feasible without tolerances")
        checked = search.best(search.seeds(points), search.spacing(len(points)) / 2)
        results = [a for a in checked if a.feasible]
        if not results:
            raise infeasibility(spec, points, checked)
        check_objective(spec, points, results)
        bar.add(1, f"search: {counted(len(results), 'candidate')}, {search.counts['lanes']} lanes so far")
        front = _front(search, points, results) if spec.front else []
        if spec.front:
            bar.add(1, f"front: {counted(len(front), 'point')}")
    return _dataset(search, points, results, front)


def _front(search: Search, points: Sequence[Assessment], results: Sequence[Assessment]) -> list[FrontPoint]:
    """Return the points of the design's front, each from the last optimum and the map, the tightest limit first."""
    spec, front = search.spec, search.spec.front
    assert front is not None
    limits = _front_limits(spec, points, results)
    found: list[FrontPoint] = []
    last: list[Assessment] = []
    for limit in sorted(limits, reverse=front.against == "tolerance" or front.end == "least"):
        if front.against == "tolerance":
            widths = {name: limit * width for name, width in spec.tolerances.items() if limit}
            own = Search(replace(spec, tolerances=widths), search.counts)
        else:
            margin = MARGIN * spec.template.run.error * abs(limit)
            limited = (*_without_limit(spec), Constraint(front.against, front.end, float(limit), margin))
            own = Search(replace(spec, constraints=limited), search.counts)
        known = [Assessment.of(own.spec, a.unit, own.centre, a.nominal) for a in (*points, *results)]
        seeds = own.assess([a.unit for a in last], own.box) + own.seeds(known)[:1]
        checked = own.best(seeds, WARM_RADIUS)
        if last and min(checked, key=lambda a: a.rank).rank > last[0].rank:  # what held under a tighter limit
            checked += own.verify(own.assess([a.unit for a in last], own.box))
        best = min(checked, key=lambda a: a.rank)
        last = [best] if best.feasible else last
        found.append(FrontPoint(float(limit), best))
    return sorted(found, key=lambda point: [*limits].index(point.limit))


def _front_limits(spec: DesignSpec, points: Sequence[Assessment], results: Sequence[Assessment]) -> np.ndarray:
    """Return the limits of a front, by default from the least that the map reaches to that of the free optimum."""
    front = spec.front
    assert front is not None
    if front.span is not None or front.against == "tolerance":
        return np.linspace(*(front.span or TOLERANCE_SPAN), front.points)
    free = replace(spec, constraints=_without_limit(spec))
    known = [Assessment.of(free, a.unit, a.offsets[:1], a.nominal) for a in points]
    fit = [extreme(a.values[front.against], front.end) for a in known if a.fit.all()]
    top = [extreme(a.values[front.against], front.end) for a in (min(known, key=lambda a: a.rank), results[0])]
    low, high = (min(fit), max(top)) if front.end == "most" else (max(fit), min(top))
    return np.linspace(low + 0.02 * (high - low), high, front.points)


def _without_limit(spec: DesignSpec) -> tuple[Constraint, ...]:
    """Return the constraints without that of the variable against which the front is drawn."""
    assert spec.front is not None
    own = spec.front.against, spec.front.end
    return tuple(c for c in spec.constraints if (c.variable, c.end) != own)


def infeasibility(spec: DesignSpec, points: Sequence[Assessment], checked: Sequence[Assessment]) -> InputError:
    """Return the error for a design without a feasible point."""
    nearest = min([*checked, *([] if spec.tolerances else points)], key=lambda a: a.badness)
    where, place, fit = _place_text(spec, nearest), spec.place.at("subject"), nearest.fit
    whole = " within the tolerances" if spec.tolerances else ""
    violated = _violated(nearest) if fit.any() else []
    if spec.share is not None:
        share = float(nearest.good.mean(axis=1).min())
        ends = f"least {spec.share[0]:g}, most {spec.share[1]:g}"
        there = "".join(f"; there {_limit_text(spec, nearest, c)}" for c in violated[:1])
        return place.at("share").error(f"{ends} cannot be met{whole}; nearest: {share:.3g} {where}{there}")
    if not violated:
        others = [REGIMES[k] for k in np.unique(nearest.lanes["regime"][~fit])] if "regime" in nearest.lanes else []
        lanes = f"nearest: {fit.sum()} of {counted(fit.size, 'lane')} {where}"
        lanes += f" ({', '.join(others)})" * bool(others)
        what = f"{spec.regime} from every start" if spec.regime else f"a value of {spec.maximise} from every start"
        if any(a.feasible for a in points):
            return spec.place.at("tolerance").error(f"{what} cannot be held within the tolerances; {lanes}")
        return place.at("regime" if spec.regime else spec.maximise).error(f"{what} cannot be reached{whole}; {lanes}")
    limit = violated[0]
    alone = np.array([extreme(a.held(limit.variable), limit.end) for a in points if a.fit.all()])
    reached = extreme(alone, "most" if limit.end == "least" else "least")
    others = ["the tolerances"] * bool(spec.tolerances) + ["the other limits"] * (len(spec.constraints) > 1)
    free = f"; without {' and '.join(others)}, the map reaches {_amount(spec, limit, reached)}"
    return place.at(limit.variable).error(
        f"{limit.end} {_amount(spec, limit, limit.limit)} cannot be met{whole}"
        + " with the other limits" * (len(spec.constraints) > 1)
        + f"; nearest: {_amount(spec, limit, extreme(nearest.held(limit.variable), limit.end))} {where}"
        + (free if others and np.isfinite(reached) else "")
    )


def check_objective(spec: DesignSpec, points: Sequence[Assessment], results: Sequence[Assessment]) -> None:
    """Raise `InputError` if the objective is 0 at every feasible point, as where no blow breaks the rock."""
    if any(a.objective for a in (*results, *points) if a.feasible):
        return
    hint = "; it is 0 on the whole map"
    if positive := [a for a in points if a.objective > 0]:
        nearest = min(positive, key=lambda a: a.badness)
        limits = ", ".join(_limit_text(spec, nearest, c) for c in _violated(nearest)) or "from other starts"
        amount = f"{nearest.objective:.3g} {spec.variables[spec.maximise].units}"
        hint = f"; nearest above 0: {amount} {_place_text(spec, nearest)}, {limits}"
    raise spec.place.at("maximise").error(f"{spec.maximise} is 0 wherever the requirements hold{hint}")


def _violated(a: Assessment) -> list[Constraint]:
    """Return the violated constraints, the worst first."""
    slack = np.where(a.fit, a.slack, np.inf).min(axis=(1, 2))
    return [a.constraints[j] for j in np.argsort(slack) if slack[j] < 0]


def _limit_text(spec: DesignSpec, a: Assessment, limit: Constraint) -> str:
    value = extreme(a.held(limit.variable), limit.end)
    return f"{limit.variable} is {_amount(spec, limit, value)}, {limit.end} {_amount(spec, limit, limit.limit)}"


def _amount(spec: DesignSpec, limit: Constraint, value: float) -> str:
    unit = spec.variables[limit.variable].units
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _place_text(spec: DesignSpec, a: Assessment) -> str:
    columns = spec.columns(a.unit[None], np.zeros((1, len(spec.tolerances))))
    return "at " + ", ".join(f"{name} = {x[0]:.4g}" for name, x in columns.items())


def _dataset(
    search: Search, points: Sequence[Assessment], results: Sequence[Assessment], front: Sequence[FrontPoint]
) -> xr.Dataset:
    """Return the dataset of the candidates, best first, with the map and the front."""
    spec = search.spec
    about = spec.variables[spec.maximise]
    data: dict[str, Any] = {}

    def add(name: str, dims: str | tuple[str, ...], values: Any, variable: Variable) -> None:
        attributes = {key: x for key, x in variable.attributes().items() if key != "units" or variable.units}
        data[name] = dims, np.asarray(values, variable.dtype), attributes

    def of(name: str, words: str) -> Variable:
        return Variable(spec.variables[name].units, words.format(spec.variables[name].long_name))

    add("objective", "candidate", [a.objective for a in results],
        of(spec.maximise, "{} at the nominal point, worst over the starts"))  # fmt: skip
    add("objective_worst", "candidate", [a.worst for a in results],
        of(spec.maximise, "least {} of the samples of the tolerances, from all starts"))  # fmt: skip
    for name, end in {c.variable: c.end for c in spec.constraints}.items():
        add(name, "candidate", [extreme(a.held(name, slice(1)), end) for a in results],
            of(name, "{}, at the nominal point, worst over the starts"))  # fmt: skip
        add(f"{name}_worst", "candidate", [extreme(a.held(name), end) for a in results],
            of(name, "{}, worst of the samples of the tolerances"))  # fmt: skip
    if spec.regime is not None:
        required = REGIMES.index(spec.regime)
        words = "first other regime at the samples of the tolerances, else that asked for"
        worst = Variable("1", words, np.int8, REGIMES)
        for name, samples, variable in (("regime", 1, VARIABLES["regime"]), ("regime_worst", None, worst)):
            regimes = [a.lanes["regime"][:samples] for a in results]
            add(name, "candidate", [[*x[x != required], required][0] for x in regimes], variable)
    irregular = [float(np.isin(a.lanes["regime"], UNBOUNDED).mean()) if "regime" in a.lanes else 0.0 for a in results]
    columns: dict[str, tuple[Any, Any]] = {
        "share": ("candidate", [a.good[0].mean() for a in results]),
        "share_worst": ("candidate", [a.good.mean(axis=1).min() for a in results]),
        "feasible": ("candidate", [a.feasible for a in results]),
        "irregular_share": ("candidate", irregular),
        "gradient": (("candidate", "parameter"), search.gradients(results)),
        "map_feasible": ("map", [a.feasible for a in points]),
    }
    for name, (dims, values) in columns.items():
        add(name, dims, values, DESIGN_VARIABLES[name])
    add("map_objective", "map", [a.objective if a.feasible else np.nan for a in points],
        of(spec.maximise, "{} on the map, worst over the starts; NaN: not feasible"))  # fmt: skip
    if spec.front is not None:
        against, end = spec.front.against, spec.front.end

        def known(value: Callable[[Assessment], Any]) -> list[Any]:
            return [value(p.checked) if p.checked.feasible else np.nan for p in front]

        factor = Variable("1", "factor of the tolerances")
        limit = factor if against == "tolerance" else of(against, "limit of {}")
        add("front_limit", "front", [p.limit for p in front], limit)
        add("front_objective", "front", known(lambda a: a.objective), about)
        add("front_objective_worst", "front", known(lambda a: a.worst), about)
        add("front_feasible", "front", [p.checked.feasible for p in front], DESIGN_VARIABLES["front_feasible"])
        if against != "tolerance":
            reached = known(lambda a: extreme(a.held(against, slice(1)), end))
            add(f"front_{against}", "front", reached, of(against, "{}"))
    coordinates = ["parameter"]
    parameters = spec.template.system.parameters()
    sets: dict[str, tuple[str, list[Any]]] = {
        "": ("candidate", [a.unit for a in results]),
        "map_": ("map", [a.unit for a in points]),
        "front_": ("front", [np.where(p.checked.feasible, p.checked.unit, np.nan) for p in front]),
    }
    for prefix, (dim, unit) in sets.items():
        for k, name in enumerate(spec.varied if unit else ()):
            known_as = parameters.get(name)
            variable = Variable("1", name) if known_as is None else Variable(known_as.unit, known_as.long_name)
            add(prefix + name, dim, spec.low[k] + np.array(unit)[:, k] * (spec.high[k] - spec.low[k]), variable)
            coordinates += [prefix + name] if prefix != "front_" else []
    data["parameter"] = "parameter", list(spec.varied), {"long_name": "varied parameter"}
    title = str(spec.template.title or f"Design of {spec.template.scene}: most {about.long_name}")
    attributes = dataset_attributes(
        "design", title, "design", scene=spec.template.scene, design=spec.text, lanes=search.counts["lanes"],
        orbit_solves=search.counts["orbits"], maximise=spec.maximise, requirements=requirements(spec),
    )  # fmt: skip
    attributes |= {f"tolerance_{name}": width for name, width in spec.tolerances.items()}
    attributes |= {"against": spec.front.against} if spec.front is not None else {}
    attributes |= {"robust": 1} if spec.robust else {}
    return xr.Dataset(data, attrs=attributes).set_coords(coordinates)


def requirements(spec: DesignSpec) -> str:
    """Return the subject of a design in one line of text."""
    words = [f"regime {spec.regime}"] if spec.regime else []
    for c in spec.constraints:
        limit = xr.DataArray(c.limit, attrs={"units": spec.variables[c.variable].units})
        words.append(f"{c.variable.replace('_', ' ')} at {c.end} {quantity_text(c.limit, limit)}")
    if spec.share is not None:
        words.append(f"share of starts {spec.share[0]:g} to {spec.share[1]:g}")
    parameters = spec.template.system.parameters()
    for name, width in spec.tolerances.items():
        about = parameters.get(name)
        half = quantity_text(width, xr.DataArray(width, attrs={"units": about.unit if about else "1"}))
        words.append(f"{about.symbol if about else name} ± {half}")
    return "; ".join(words) or "none"
