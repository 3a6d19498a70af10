"""The analysis `sensitivity`: derivatives at the periodic orbits of a sweep, or of one point of a scene."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import ListedColormap, Normalize

from vibrojax.errors import Place, counted, shown, suggestion
from vibrojax.io.attributes import flag_counts
from vibrojax.io.variables import VARIABLES, Variable, described
from vibrojax.lanes.inputs import Features
from vibrojax.lanes.labels import measured_besides
from vibrojax.maps.dataset import coordinates, shared_attributes
from vibrojax.maps.read import Point, read_point
from vibrojax.maps.rerun import orbits, sweep_with_orbits
from vibrojax.maps.starts import list_of
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.derivatives import DERIVATIVE_REASONS, MODULUS, NO_ORBIT, STABILITY, orbit_variables
from vibrojax.periodic.lane_stages import run_lanes
from vibrojax.periodic.orbits import Orbits, orbits_of
from vibrojax.physics.meanings import suggest_parameter
from vibrojax.pictures.axes import margins, symbols_of
from vibrojax.pictures.colours import Value
from vibrojax.pictures.layout import is_narrow
from vibrojax.pictures.plots import Axis, Cells, Layer, Plot, Sheet, Text
from vibrojax.progress import Progress
from vibrojax.scenes import SCENES, Scene
from vibrojax.settings.names import enter_offered
from vibrojax.settings.run_settings import RunSettings, read_settings
from vibrojax.settings.toml import bundled_names
from vibrojax.settings.values import check_distinct
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.subjects import SweepAnalysis
from vibrojax.systems.system import DEFINED

KIND = "sensitivity"

LANES_PER_CALL = 256
"""Lanes between two reports of progress."""

_MULTIPLIERS = "multiplier_abs"

_HOLDS = {
    "valid": Variable("1", "whether the derivatives of the lane hold", np.int8, ("not-valid", "valid")),
    "reason": Variable("1", "why the derivatives of the lane do not hold", np.int8, DERIVATIVE_REASONS),
    "parameter_value": Variable("", "value of the parameter, in its own unit"),
}

OWN_ORBIT = 1e-3
"""Largest distance from the orbit in the dataset, in half swings, of the orbit whose derivatives are computed."""


def at_orbits(
    sweep: Sweep, lanes: xr.Dataset | Features, by: Sequence[str], progress: bool, variables: Sequence[str] = ()
) -> xr.Dataset:
    """Return the dataset of [vibrojax.sensitivity][]; `lanes`: dataset or variables of the sweep's lanes with orbits.

    If `variables` are given, the dataset has no others, and a lane without one of them is not valid.
    """
    scene, table = sweep.system, sweep.system.parameters()
    by = read_names(Place(KIND).at("by"), by, table) if by else [*table]
    of = [name for name in orbit_variables(scene) if not variables or _variable(name) in variables]
    values = sweep.lane_values(0, sweep.lanes)[0]
    lanes = lanes.transpose(*sweep.dims, ...) if isinstance(lanes, xr.Dataset) else lanes
    shape = (sweep.lanes, len(of))
    features, slopes = np.full(shape, np.nan), np.full((*shape, len(by)), np.nan)
    reason = np.full(shape, NO_ORBIT)
    reason[np.asarray(lanes["status"]).ravel() != 0] = DERIVATIVE_REASONS.index("failed")
    known = orbits_of(scene, lanes, values)
    with Progress(sum(map(len, known)), "orbits", progress, pace=False) as report:
        for batch in known:
            for part in np.split(np.arange(len(batch)), range(LANES_PER_CALL, len(batch), LANES_PER_CALL)):
                orbit, lane = batch.of(part), batch.lane[part]
                orbit = Orbits.find(scene, orbit.parameters, orbit.states, within=OWN_ORBIT).refined()
                features[lane], slopes[lane], reason[lane], *_ = orbit.derivatives(of, by)
                report.add(len(part))
    # The reason of a lane is the first in order.
    none = (reason == 0) | ((reason == DERIVATIVE_REASONS.index("undefined")) & (not variables))
    why = np.where(none, len(DERIVATIVE_REASONS), reason).min(axis=1) % len(DERIVATIVE_REASONS)

    dims, sizes = sweep.dims, sweep.shape
    points = np.stack([values[name] for name in by], axis=-1).reshape(*sizes, len(by))
    data: dict[str, Any] = {"valid": (dims, (why == 0).reshape(sizes)), "reason": (dims, why.reshape(sizes))}
    data = described(data | {"parameter_value": ((*dims, "parameter"), points)}, _HOLDS)
    further = {}  # sizes of dimensions that sweeps do not have
    for name in dict.fromkeys(map(_variable, of)):
        places = [place for place, feature in enumerate(of) if _variable(feature) == name]
        if name == _MULTIPLIERS:
            further["multiplier"] = len(places)
        own = ("multiplier",) * (name == _MULTIPLIERS)
        size, about = (*sizes, *(further[x] for x in own)), _meaning(scene, name)
        data[name] = ((*dims, *own), features[:, places].reshape(size), about.attributes())
        meaning = {"units": about.units, "long_name": f"derivative, per unit of the parameter, of: {about.long_name}"}
        data[f"d_{name}"] = ((*dims, *own, "parameter"), slopes[:, places].reshape(*size, len(by)), meaning)
    coords = {
        **coordinates(sweep, further),
        "parameter": ("parameter", list(by), {"long_name": "parameter of the derivative"}),
        "parameter_unit": ("parameter", [table[name].unit for name in by], {"long_name": "unit of the parameter"}),
    }
    attributes = shared_attributes(sweep, KIND, f"Sensitivities of the orbits: {sweep.title or sweep.name}", KIND)
    return xr.Dataset(data, coords, attributes | ({"sweep": sweep.text} if sweep.text else {}))


def _variable(feature: str) -> str:
    """Return the variable of a dataset that holds a feature of orbits."""
    return _MULTIPLIERS if feature.startswith(MODULUS) else feature


def _meaning(scene: Scene[Any], name: str) -> Variable:
    """Return unit and meaning of a variable of a scene's orbits."""
    modulus = Variable("1", "natural logarithm of the largest modulus of the orbit's multipliers")
    return (VARIABLES | {STABILITY: modulus} | measured_besides(scene))[name]


def sensitivity(
    source: xr.Dataset | str | PathLike[str] | Mapping[str, object] | Sweep | Scene[Any],
    *,
    of: str | Sequence[str] = (),
    by: str | Sequence[str] = (),
    start: str | Sequence[float] | None = None,
    settle: float | None = None,
    observe: float | None = None,
    progress: bool = True,
    **parameters: Any,
) -> xr.Dataset:
    """Differentiate the features of periodic orbits with respect to the parameters of the scene.

        s = vj.sensitivity(ds)
        s.d_impact_velocity.sel(parameter="beta")  # m/s per unit of beta, in every lane
        vj.sensitivity("vibro-impact", of=["period"], by=["beta"], start="stuck", delta=0.005)  # at one point

    The implicit function theorem gives the derivative of the state s at the section, a fixed point of the return map P:
    ds/dp = (1 - P_s)^-1 P_p. The features are measured over one period of the orbit, together with their derivatives
    along ds/dp, which are propagated through all events. Unstable orbits have derivatives, too.

    **Arguments:**

    - `source`: the dataset of a sweep, or a sweep as in `run_sweep`. If the dataset has no orbits, its sweep is run
      again.
    - If `source` is a scene or its name, the function differentiates the orbit on which the motion settles for the
      given `start` and `parameters` (SI, as in `simulate`).
    - `by`: parameters of the scene, by default all.
    - `of`: variables to differentiate at a single point, by default all variables that vary smoothly. `settle`,
      `observe` [s]: as in a sweep.

    **Returns:** a dataset over the dimensions of the sweep, or without these dimensions for a single point.

    - The dataset contains all variables of the orbits that vary smoothly: measures such as `period`, `impact_energy`
      and `rate_of_penetration`, `grazing_margin`, `multiplier_abs` (with the dimension `multiplier`), and
      `log_multiplier` (the natural logarithm of the largest modulus).
    - `d_VARIABLE` along `parameter`: derivative of each variable, in the unit of the variable per unit of the parameter
      (`parameter_unit`). A derivative is NaN where the variable is undefined, as is the impact velocity of a motion
      without impacts. For a single point, `elasticity_VARIABLE` is the relative change of the variable per relative
      change of the parameter.
    - `valid` (0 or 1) and `reason`. *no-orbit*: the lane is not periodic, or no orbit was found. *neutral-orbit*: a
      multiplier is 1, so that the orbit does not depend smoothly on the parameters. *near-grazing*, *near-stick*: an
      impact, or a stick phase, is about to appear or vanish; derivatives hold only very close to the point.
      *equal-multipliers*: two multipliers, or their moduli, are almost equal; only the derivatives of multipliers do
      not hold. *undefined*: the orbit lacks a variable named in `of`. *failed*: the lane failed, or the derivative
      cannot be computed.

    **Raises:** `InputError` if the source is neither a sweep, the dataset of a sweep, nor a scene, or if a name is
    unknown.

    **Example:**

    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005, "start": "stuck"}
    >>> s = vj.sensitivity("vibro-impact", of=["impact_velocity"], by=["v", "delta"], **point, progress=False)
    >>> s.d_impact_velocity.values.round(2).tolist()  # per m/s, and per m of the gap
    [1.3, 27.28]
    """
    place, of, by = Place(KIND), *([names] if isinstance(names, str) else list(names) for names in (of, by))
    times = {name: x for name, x in (("settle", settle), ("observe", observe)) if x is not None}
    given = {"of": of or None, "start": start, **times, **parameters}
    given = {name: x for name, x in given.items() if x is not None}
    enter_offered()
    scenes = {*SCENES, *DEFINED} - {*bundled_names()}
    if not isinstance(source, Scene) and not (isinstance(source, str) and (given or source in scenes)):
        for name in given:
            raise place.at(name).error("belongs to one point of a scene, and this is a sweep; leave it out")
        sweep = sweep_with_orbits(source)
        return at_orbits(sweep, orbits(source if isinstance(source, xr.Dataset) else sweep, progress), by, progress)
    point = read_orbit_point(place, source, parameters, start)
    variables = [*dict.fromkeys(map(_variable, orbit_variables(point.system)))]
    of = read_names(place.at("of"), of, variables) if of else []
    by = read_names(place.at("by"), by, point.system.parameters()) if by else [*point.system.parameters()]
    run = read_settings(place, {"orbits": True, **times}, point.system)
    sweep = sweep_at(point, {by[0]: np.array([point.parameters[by[0]]])}, run)
    with Progress(1, "lanes", progress) as bar:
        lanes = run_lanes(sweep.inputs(), sweep.plan, bar.add).variables
    ds = at_orbits(sweep, lanes, by, progress, of).squeeze(sweep.dims).drop_vars("point")
    for name in [name for name in variables if name in ds and name not in (_MULTIPLIERS, STABILITY)]:
        elasticity = ds[f"d_{name}"] * ds["parameter_value"] / ds[name].where(ds[name] != 0)
        meaning = f"relative change per relative change of the parameter, of: {_meaning(point.system, name).long_name}"
        ds[f"elasticity_{name}"] = elasticity.assign_attrs(units="1", long_name=meaning)
    return ds


def sweep_at(point: Point, columns: Mapping[str, np.ndarray], run: RunSettings) -> Sweep:
    """Return the sweep of a point over `columns`, which hold values of some of its parameters."""
    return Sweep(
        name=point.scene,
        text="",
        title="",
        scene=point.scene,
        options=point.options,
        system=point.system,
        starts=None if point.start is None else list_of((point.start,), point.system.start_states),
        parameters={name: x for name, x in point.parameters.items() if name not in columns},
        given={"bit_radius": point.hole_radius},
        points=dict(columns),
        run=run,
    )


def read_orbit_point(place: Place, scene: object, parameters: Mapping[str, object], start: object) -> Point:
    """Return a checked point of a scene whose motions may have orbits."""
    point = read_point(place, scene, parameters, start)
    if not point.system.driving_part().return_states:
        raise place.at("scene").error(f"{shown(point.scene)} has neither a section nor pulses, so it has no orbits")
    return point


def read_names(place: Place, value: str | Sequence[str], known: Collection[str]) -> list[str]:
    """Return the validated list of names, which must be in `known`."""
    names = [value] if isinstance(value, str) else list(value)
    if not names:
        raise place.error(f"is empty; choose from {', '.join(known)}")
    for name in names:
        if name not in known:
            hint = suggest_parameter(str(name), known) if isinstance(known, Mapping) else suggestion(str(name), known)
            raise place.error(f"the scene has no {shown(name)} to differentiate; {hint}")
    check_distinct(place, names, "name")
    return names


GREATEST_COLOURED = 1.5
"""Elasticity above which the colour of a cell does not change."""

_MOST_NUMBERS = 8  # parameters of a narrow picture whose cells hold numbers


def elasticities(ds: xr.Dataset) -> Sheet:
    """Draw the median elasticity of each variable with respect to each parameter, over the valid lanes.

    The elasticity is the relative change of the variable per relative change of the parameter. A narrow picture of many
    parameters shows colours without numbers.
    """
    valid = ds["valid"].values.ravel() == 1
    by = [str(name) for name in ds["parameter"].values]
    names = [str(name).removeprefix("d_") for name in ds.data_vars if str(name).startswith("d_")]
    names = [name for name in names if "multiplier" not in ds[name].dims and name != "log_multiplier"]
    point = ds["parameter_value"].values.reshape(-1, len(by))
    rows = {}
    for name in names:
        value, slope = ds[name].values.reshape(-1), ds[f"d_{name}"].values.reshape(-1, len(by))
        with np.errstate(all="ignore"):
            elasticity = (slope * point / value[:, None])[valid]
        columns = (x[np.isfinite(x)] for x in elasticity.T)
        row = [np.median(x) if len(x) else np.nan for x in columns]
        if np.isfinite(row).any():
            rows[name.replace("_", " ")] = row
    table = np.array(list(rows.values())).reshape(len(rows), len(by))
    across, up = np.arange(len(by) + 1) - 0.5, np.arange(len(rows) + 1) - 0.5
    pale = ListedColormap(colormaps["RdBu_r"](np.linspace(0.25, 0.75, 256)))  # on which numbers can be read
    norm = Normalize(-GREATEST_COLOURED, GREATEST_COLOURED)
    coding = Value("elasticity", "elasticity", 1.0, norm, "both", pale)
    layers: list[Layer] = [Cells(across, up, table, pale, norm, hatched=False)]
    fits = not is_narrow() or len(by) <= _MOST_NUMBERS
    for (i, j), x in np.ndenumerate(table):
        if fits and np.isfinite(x):
            layers.append(
                Text(float(j), float(i), f"{round(x, 1) + 0.0:.1f}".replace("-", "−"), colour="#000000", size=7.0)
            )
    signs = symbols_of(ds)
    ticks = [[(float(k), signs.get(x, x)) for k, x in enumerate(texts)] for texts in (by, list(rows))]
    plot = Plot(layers, Axis("parameter", ticks=ticks[0]), Axis(ticks=ticks[1], reversed=True), scale=coding)
    size = 1.8 + 0.62 * len(by), 1.9 + 0.27 * max(len(rows), 1)
    about = margins(ds, "Elasticity: relative change of the variable per relative change of the parameter")
    about["title"] = f"Median elasticity at {counted(int(valid.sum()), 'orbit')}"
    return Sheet([plot], size, **about)


@dataclass(frozen=True)
class Sensitivity(SweepAnalysis):
    """Derivatives of the features of a sweep's orbits with respect to the parameters `by`, by default all."""

    by: tuple[str, ...] = field(default=(), metadata={"help": "parameters, separated by commas (default: all)"})

    kind = KIND
    pictures = (PictureRule("elasticities of the orbits", lambda held: "parameter" in held.dimensions, elasticities),)
    view = "plots"

    def identity(self, sweep: Sweep) -> dict[str, object]:
        return {KIND: ",".join(self.by) or "all"}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        return at_orbits(sweep, lanes, self.by, progress)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        counts, size = flag_counts(ds, "reason"), ds["reason"].size
        valid = counts.pop("none", 0)
        others = ", ".join(f"{count} {name}" for name, count in counts.items())
        lines = [f"derivatives hold in {valid} of {counted(size, 'lane')}" + (f" ({others})" if others else "")]
        return [SummaryPart(KIND, lines, {KIND: {"valid": valid, **counts}})]
