"""The specification of a design, which is read and checked: what varies, what is maximised, and what must hold."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrojax.errors import Place, shown, suggestion
from vibrojax.io.variables import Variable
from vibrojax.lanes.scene_variables import sweep_variables
from vibrojax.maps.bounds import MAX_TOLERANCES, read_bounds, read_points_of, read_specification
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import REGIMES
from vibrojax.settings.names import Names
from vibrojax.settings.toml import read_source
from vibrojax.settings.values import as_table, choice, count, flag, known_keys, require_number

DRAWN_BOX = 1.04
"""Size of the box from which verification draws, relative to the tolerances: what holds there holds in the box."""


MARGIN = 2.0
"""Tightening of a limit, in units of the accepted relative error of a lane: other runs of the point meet it, too."""

FRONT_POINTS = 20
"""Default number of points of a front."""

_KEYS = (
    *("scene", "title", "starts", "maximise", "robust", "vary", "subject", "parameters", "tolerance", "run", "front"),
    "unusual",
)
_ENDS = ("least", "most")
_COUNTS = {"impacts", "striker_turns"}
"""Variables that are stored as floats but are whole numbers, whose limits are not tightened."""


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
    - `tables`: the tables of every sweep of the search. `template`: a sweep at the bounds.
    """

    name: str
    file: str
    text: str
    tables: dict[str, Any]
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
    def place(self) -> Place:
        """The place of the design in messages."""
        return Place(self.file)

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

    def sweep(self, columns: Mapping[str, np.ndarray]) -> Sweep:
        """Return the sweep of points, from every start."""
        return replace(self.template, points=dict(columns))

    def identity(self) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        own = {f"tolerance.{name}": width for name, width in self.tolerances.items()}
        own |= {f"subject.{c.variable}.{c.end}": c.limit for c in self.constraints}
        front = None if self.front is None else [self.front.against, self.front.end, self.front.points, self.front.span]
        own |= {"robust": True} if self.robust else {}
        subject = {"maximise": self.maximise, "regime": self.regime, "share": self.share, "front": front}
        return self.template.identity() | {f"design.{name}": value for name, value in (own | subject).items()}


def read_design(source: str | PathLike[str] | Mapping[str, object]) -> DesignSpec:
    """Read and check a design; raise `InputError` with a one-line message at the first problem."""
    origin = read_source(source, "design")
    place, tables, parameters, names = read_specification(origin, _KEYS)
    parameters = _without_presets(place.at("parameters"), names, parameters)
    unusual = flag(place.at("unusual"), tables.get("unusual", False))
    bounds = read_bounds(place.at("vary"), tables.get("vary"), names, parameters, unusual)
    low, high = ({name: ends[k] for name, ends in bounds.items()} for k in range(2))
    tolerances, fixed = _read_tolerances(
        place.at("tolerance"), tables.get("tolerance", {}), names, parameters, low, high
    )
    run = dict(as_table(place.at("run"), tables.get("run", {})))
    numbers = ("", "multiplier")  # one per lane or along multipliers
    known = {name: about for name, about in sweep_variables(names.system).items() if about.along in numbers}
    maximise = tables.get("maximise")
    if maximise is None:
        raise place.at("maximise").error('missing; name a variable, like maximise = "impact_energy"')
    choice(place.at("maximise"), maximise, [name for name in known if known[name].dtype == np.float64])
    robust = flag(place.at("robust"), tables.get("robust", False))
    if robust and not tolerances:
        raise place.at("robust").error("there is no [tolerance] to be robust to; add one")
    regime, share, constraints = _read_subject(place.at("subject"), tables.get("subject", {}), known)
    if share is not None and names.has_starts is False:
        raise place.at("subject").at("share").error(f"scene {shown(names.scene)} has no starts; leave it out")
    used = {str(maximise), *(constraint.variable for constraint in constraints)}
    # Orbits give each lane the exact values of its periodic motion, so that objective and limits are smooth.
    if run.get("method", "located") == "located":
        run.setdefault("orbits", True)
    if used & {"lyapunov", "lyapunov_stderr", "nature", "zero_one"}:
        run["lyapunov"] = True
    base: dict[str, Any] = {key: tables[key] for key in ("scene", "starts") if key in tables}
    base |= {"title": tables.get("title", ""), "unusual": True, "run": run}
    base["parameters"] = {key: x for key, x in parameters.items() if key not in fixed}
    ends = {key: [low[key], high[key]] for key in low} | {key: [x, x] for key, x in fixed.items()}
    template = read_points_of(origin.file, base | {"points": ends})
    if regime is not None and template.system.section is None:
        raise place.at("subject").at("regime").error(f"motions of scene {shown(names.scene)} have no regimes")
    error = template.run.error
    smooth = [name for name, about in known.items() if about.dtype == np.float64 and name not in _COUNTS]
    constraints = tuple(
        replace(c, margin=MARGIN * error * abs(c.limit)) if c.variable in smooth else c for c in constraints
    )
    return DesignSpec(
        origin.name, origin.file, origin.text, base, template, str(maximise), robust, tuple(low),
        np.array([*low.values()]), np.array([*high.values()]), tolerances, fixed, regime, share, constraints,
        _read_front(place.at("front"), tables.get("front"), known, constraints, tolerances, str(maximise)), known,
    )  # fmt: skip


def _without_presets(place: Place, names: Names, parameters: dict[str, object]) -> dict[str, object]:
    """Return the parameters with each preset, such as a rock, replaced by the values that it sets."""
    plain = {name: value for name, value in parameters.items() if name not in names.presets}
    for name in names.presets:
        if name not in parameters:
            continue
        for key, value in names.presets[name][names.preset(place.at(name), name, parameters[name])].items():
            if key in plain:
                raise place.at(name).error(f"{key} is given as well; give one of the two")
            plain[key] = value
    return plain


def _read_tolerances(
    place: Place, value: object, names: Names, parameters: dict[str, Any], low: dict[str, float], high: dict[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the half-widths by name, and the nominal values of the parameters that are not varied."""
    table = as_table(place, value)
    if len(table) > MAX_TOLERANCES:
        raise place.error(f"{len(table)} parameters have a tolerance; give at most {MAX_TOLERANCES}")
    widths, fixed = {}, {}
    for name, given in table.items():
        about = names.parameter(place.at(name), name)
        width = require_number(place.at(name), given)
        if not (np.isfinite(width) and width > 0):
            raise place.at(name).error(f"{shown(given)} is not a half-width above zero")
        if name in low:
            ends = low[name], high[name]
        elif name in names.parameters and name not in names.substituted({*low, *parameters}):
            fixed[name] = names.quantity(place.at(name), name, parameters.get(name, about.default))
            ends = fixed[name], fixed[name]
        elif name in parameters:
            fixed[name] = names.quantity(place.at(name), name, parameters[name])
            ends = fixed[name], fixed[name]
        else:
            raise place.at(name).error("follows from other parameters; give the tolerance of one of these")
        widths[name] = width
        for end in (ends[0] - DRAWN_BOX * width, ends[1] + DRAWN_BOX * width):
            if problem := about.problem(end):
                raise place.at(name).error(f"{width:g} is too wide at {name} = {ends[0]:g}: {problem}")
    return widths, fixed


def _read_subject(
    place: Place, value: object, known: Mapping[str, Variable]
) -> tuple[str | None, tuple[float, float] | None, tuple[Constraint, ...]]:
    """Return the regime, the bounds of the share, and the constraints."""
    table = as_table(place, value)
    regime = choice(place.at("regime"), table["regime"], REGIMES) if "regime" in table else None
    share, constraints = None, []
    for name, entry in table.items():
        if name == "regime":
            continue
        if name != "share" and name not in known:
            hint = suggestion(name, ("share", *known))
            raise place.at(name).error(f"no such variable; {hint}")
        ends = _read_ends(place.at(name), entry)
        if name == "share":
            share = ends.get("least", 0.0), ends.get("most", 1.0)
            if not 0 <= share[0] <= share[1] <= 1:
                raise place.at(name).error(f"{share[0]:g} to {share[1]:g} is not a range of shares between 0 and 1")
        constraints += [Constraint(name, end, limit) for end, limit in ends.items() if name != "share"]
    return regime, share, tuple(constraints)


def _read_ends(place: Place, entry: object) -> dict[str, float]:
    if not isinstance(entry, dict) or not entry:
        raise place.error(f"{shown(entry)} is not a limit; write {{ least = ... }}, {{ most = ... }} or both")
    known_keys(place, entry, _ENDS, {"min": "write least", "max": "write most"})
    ends = {end: require_number(place.at(end), entry[end]) for end in _ENDS if end in entry}
    for end, limit in ends.items():
        if not np.isfinite(limit):
            raise place.at(end).error(f"{limit:g} is not a finite limit; leave it out")
    if len(ends) == 2 and ends["least"] > ends["most"]:
        raise place.error(f"contradictory: least {ends['least']:g} is above most {ends['most']:g}")
    return ends


def _read_front(
    place: Place,
    value: object,
    known: Mapping[str, Variable],
    constraints: tuple[Constraint, ...],
    tolerances: Mapping[str, float],
    maximise: str,
) -> Front | None:
    if value is None:
        return None
    table = as_table(place, value)
    known_keys(place, table, ("against", "points", "from", "to"))
    if "against" not in table:
        raise place.at("against").error('missing; name a variable, like "peak_impact_force", or "tolerance"')
    against = choice(place.at("against"), table["against"], ("tolerance", *known))
    if against == "tolerance" and not tolerances:
        raise place.at("against").error("there is no [tolerance] to scale; add one")
    if against == maximise:
        raise place.at("against").error(f"{shown(against)} is what is maximised; name another variable")
    if ("from" in table) != ("to" in table):
        raise place.error("from and to belong together; give both or neither")
    span = None
    if "from" in table:
        span = require_number(place.at("from"), table["from"]), require_number(place.at("to"), table["to"])
        if not (np.all(np.isfinite(span)) and span[0] != span[1]):
            raise place.at("from").error(f"{span[0]:g} to {span[1]:g} is no interval")
    end = next((c.end for c in constraints if c.variable == against), "most")
    return Front(against, end, count(place.at("points"), table.get("points", FRONT_POINTS), 2, 200), span)
