"""The analysis `design`: the best drill under constraints and within tolerances; its dataset, picture and summary."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError, counted
from vibrojax.io.variables import VARIABLES, Variable
from vibrojax.maps.dataset import coordinates, parameter_attributes, shared_attributes
from vibrojax.maps.read import read_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.measures.labels import REGIMES, UNBOUNDED
from vibrojax.pictures.axes import axis, label, margins, quantity_text, scale, value_text, values_along
from vibrojax.pictures.colours import value_of
from vibrojax.pictures.contents import POINT
from vibrojax.pictures.plots import FAINT, Axis, Layer, Line, Plot, Points, Sheet, colours_of, dots
from vibrojax.pictures.style import BIT, IMPACT
from vibrojax.progress import Progress
from vibrojax.studies.analysis import PictureRule, SummaryPart, analyse
from vibrojax.studies.design_requirements import Assessment, DesignSpec, extreme, infeasibility, read_design
from vibrojax.studies.design_search import Search
from vibrojax.studies.subjects import FileAnalysis

_MAX_PANELS = 6

_YES_NO = ("no", "yes")

DESIGN_VARIABLES = {
    "share": Variable("1", "share of the starts whose motion meets all requirements at the nominal point"),
    "share_worst": Variable(
        "1", "share of the starts whose motion meets all requirements, at the worst sample of the tolerance box"
    ),
    "feasible": Variable("1", "whether all samples of the tolerance box meet all requirements", np.int8, _YES_NO),
    "irregular_share": Variable("1", "share of lanes in the tolerance box that are irregular, undecided or failed"),
    "gradient": Variable("", "derivative of the objective at the nominal orbit, per unit of the parameter"),
    "map_feasible": Variable("1", "whether the point of the coarse map meets all requirements", np.int8, _YES_NO),
    "front_feasible": Variable("1", "whether a design within the limit was found", np.int8, _YES_NO),
}
"""Variables whose units do not depend on the design, unlike objective, subject, map and front."""


_LEAST_BOX = 0.01
"""Half-width of the tolerance box, in units of the map's, above which it is larger than the mark of the best."""


def design_picture(ds: xr.Dataset) -> Sheet:
    """Draw the map with the candidates, over two parameters or over each of several, and the front if there is one."""
    names = [str(name) for name in ds["parameter"].values][:_MAX_PANELS]
    plots = [_plane(ds, names)] if len(names) == 2 else [_plot_along(ds, name) for name in names]
    plots += [_front_plot(ds)] if "front" in ds.dims else []
    columns = min(len(plots), 3)
    rows = -(-len(plots) // columns)
    plots = [replace(plot, place=divmod(k, columns)) for k, plot in enumerate(plots)]
    required = str(ds.attrs.get("requirements", "")).replace(" ± ", "\u00a0±\u00a0")
    about = margins(ds, point=f"Best: {_best_text(ds, names, 4)}. Requirements: {required}")
    return Sheet(plots, (1.9 + 3.6 * columns, 0.9 + 3.1 * rows), **about)


def _plane(ds: xr.Dataset, names: list[str]) -> Plot:
    across, up = names[1], names[0]
    x, y = values_along(ds[f"map_{across}"]), values_along(ds[f"map_{up}"])
    fit = ds["map_feasible"].values == 1
    value = replace(value_of(ds["map_objective"]), label=_objective_label(ds))
    values = value.of(ds).values[fit]
    colours = colours_of(values, value.colour_map, value.norm)
    squares = Points(x[fit], y[fit], colours, 4.7, "s", label="map: feasible, without tolerances", values=values)
    layers = [squares, *_marks(x[~fit], y[~fit], values_along(ds[across]), values_along(ds[up]))]
    widths = [float(ds.attrs.get(f"tolerance_{name}", 0.0)) * scale(ds[name])[0] for name in (across, up)]
    if max(widths[0] / np.ptp(x), widths[1] / np.ptp(y)) > _LEAST_BOX and all(widths):
        centre = values_along(ds[across])[0], values_along(ds[up])[0]
        corners = [-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]
        right, top = (c + w * np.array(k) for c, w, k in zip(centre, widths, corners, strict=True))
        layers.append(Line(right, top, IMPACT, 1.1, label="its tolerances", order=2.9))
    return Plot(layers, axis(ds[across]), axis(ds[up]), scale=value)


def _plot_along(ds: xr.Dataset, name: str) -> Plot:
    x, fit = values_along(ds[f"map_{name}"]), ds["map_feasible"].values == 1
    factor = scale(ds["map_objective"])[0]
    z = ds["map_objective"].values * factor
    lowest = float(np.nanmin(np.concatenate([z[fit], ds["objective"].values * factor])))
    feasible = dots(x[fit], z[fit], colour=BIT, size=2.0, label="map: feasible, without tolerances")
    below = np.full((~fit).sum(), lowest)
    layers = [feasible, *_marks(x[~fit], below, values_along(ds[name]), ds["objective"].values * factor)]
    return Plot(layers, axis(ds[name]), Axis(_objective_label(ds)))


def _front_plot(ds: xr.Dataset) -> Plot:
    against = str(ds.attrs.get("against", ""))
    limit = ds[f"front_{against}"] if f"front_{against}" in ds else ds["front_limit"]
    factor = scale(ds["front_objective"])[0]
    x = values_along(limit)
    best, worst = (factor * ds[name].values for name in ("front_objective", "front_objective_worst"))
    layers: list[Layer] = [Line(x, best, BIT, 1.0, marker="o", size=3.5, label="front")]
    if (worst != best).any():
        layers.append(Line(x, worst, BIT, 1.0, ":", label="front, worst of the samples of the tolerances"))
    return Plot(layers, axis(limit), Axis(_objective_label(ds)))


def _marks(no_x: np.ndarray, no_y: np.ndarray, x: np.ndarray, y: np.ndarray) -> list[Layer]:
    """Return the marks of points of the map that are not feasible, and of the candidates, the best one first."""
    crosses: Layer = dots(no_x, no_y, marker="x", colour=FAINT, size=3.2, edge_width=0.8, label="map: not feasible")
    others: Layer = dots(x[1:], y[1:], face="none", label="other candidates")
    star = {"marker": "*", "size": 9.0, "colour": IMPACT, "edge": "white", "edge_width": 0.6, "order": 3.0}
    best: Layer = dots(x[:1], y[:1], label="best candidate", **star)
    return [crosses] * bool(no_x.size) + [others] * (x.size > 1) + [best]


def _best_text(ds: xr.Dataset, names: Sequence[str], digits: int = 5) -> str:
    """Return the objective of the best candidate, the worst within the tolerances, and where the candidate is."""
    values = ds["objective"][0], ds["objective_worst"][0]
    value, worst = (quantity_text(float(x), ds["objective"], digits) for x in values)
    if any(str(key).startswith("tolerance_") for key in ds.attrs):
        value = f"{value} (worst within the tolerances {worst})"
    return f"{value} at {', '.join(value_text(ds[name], ds[name][0].item()) for name in names)}"


def _objective_label(ds: xr.Dataset) -> str:
    long_name = str(ds["map_objective"].attrs["long_name"]).partition(" on the")[0]
    return label(ds["map_objective"].assign_attrs(long_name=long_name))


class Designs(FileAnalysis[DesignSpec]):
    """Find the best drill under constraints that hold from every start and at samples of the tolerances."""

    kind = "design"
    variables = DESIGN_VARIABLES
    pictures = (PictureRule("candidates over the map of a design", lambda held: True, design_picture),)
    view = "plots"
    about = (
        "a design: the path of a TOML file with scene, maximise, [vary] and, as needed, robust, [subject], "
        "[tolerance], [parameters], starts, [run], [front]; or a bundled name: energy, rate-in-sandstone, "
        "power-at-120-kn"
    )

    def asked(self, file: Any, columns: Mapping[str, str] | None = None) -> DesignSpec:
        return read_design(file)

    def identity(self, spec: DesignSpec) -> dict[str, object]:
        own: dict[str, object] = {f"tolerance.{name}": width for name, width in spec.tolerances.items()}
        own |= {f"subject.{c.variable}.{c.end}": c.limit for c in spec.constraints}
        own |= {"robust": True} if spec.robust else {}
        front = spec.front and [spec.front.against, spec.front.end, spec.front.points, spec.front.span]
        own |= {"maximise": spec.maximise, "regime": spec.regime, "share": spec.share, "front": front}
        return spec.template.identity() | {f"design.{name}": value for name, value in own.items()}

    def compute(self, spec: DesignSpec, progress: bool = True) -> xr.Dataset:
        search, front = Search(spec), list[tuple[float, Assessment]]()
        with Progress(2 + (spec.front is not None), "stages", progress, pace=False) as bar:
            points = search.map()
            count = sum(a.feasible for a in points)
            bar.add(1, f"map: {count} of {len(points)} points feasible without tolerances")
            checked = search.best(search.seeds(points), search.spacing(points) / 2)
            results = [a for a in checked if a.feasible]
            if not results:
                raise infeasibility(spec, points, checked)
            if not any(a.objective for a in (*results, *points) if a.feasible):  # as where no blow breaks the rock
                fault = f"{spec.maximise} is 0 wherever the requirements hold; change these, or the bounds"
                raise spec.place.at("maximise").error(fault)
            bar.add(1, f"search: {counted(len(results), 'candidate')}, {search.counts['lanes']} lanes so far")
            if spec.front:
                front = search.front(points, results)
                bar.add(1, f"front: {counted(len(front), 'point')}")
        return self._dataset(search, points, results, front)

    def _dataset(
        self, search: Search, points: list[Assessment], results: list[Assessment], front: list[tuple[float, Assessment]]
    ) -> xr.Dataset:
        spec, sweep, of = search.spec, search.spec.template, search.spec.column
        best, box, worst = spec.maximise, "samples of the tolerances", [a.worst for a in results]
        nominal = "at the nominal point, worst over the starts"
        data: dict[str, Any] = {
            "objective": of("candidate", best, f"{{}} {nominal}", [a.objective for a in results]),
            "objective_worst": of("candidate", best, f"least {{}} of the {box}, from all starts", worst),
        }
        for name, end in {c.variable: c.end for c in spec.constraints}.items():
            for key, rows, words in ((name, slice(1), nominal), (f"{name}_worst", slice(None), f"worst of the {box}")):
                data[key] = of("candidate", name, f"{{}}, {words}", [extreme(a.held(name, rows), end) for a in results])
        if spec.regime is not None:
            required = REGIMES.index(spec.regime)
            words = f"first regime other than the required one at the {box}, else the required one"
            for key, rows, about_regime in (
                ("regime", slice(1), VARIABLES["regime"]),
                ("regime_worst", slice(None), replace(VARIABLES["regime"], long_name=words)),
            ):
                regimes = [a.lanes["regime"][rows] for a in results]
                data[key] = about_regime.entry("candidate", [[*x[x != required], required][0] for x in regimes])
        unbounded = [np.isin(a.lanes["regime"], UNBOUNDED) if "regime" in a.lanes else np.zeros(1) for a in results]
        over_map = [a.objective if a.feasible else np.nan for a in points]
        data |= {
            "share": ("candidate", [a.share[0] for a in results]),
            "share_worst": ("candidate", [a.share.min() for a in results]),
            "feasible": ("candidate", [a.feasible for a in results]),
            "irregular_share": ("candidate", [x.mean() for x in unbounded]),
            "gradient": (("candidate", "parameter"), [search.gradient(a) for a in results]),
            "map_feasible": ("map", [a.feasible for a in points]),
            "map_objective": of("map", best, "{} on the map, worst over the starts; NaN: not feasible", over_map),
        }
        about: dict[str, Any] = {"maximise": best, "requirements": spec.requirements()}
        about |= {f"tolerance_{name}": width for name, width in spec.tolerances.items()}
        about |= {"robust": 1} if spec.robust else {}
        if spec.front is not None:
            about["against"] = against = spec.front.against
            limits, found = zip(*front, strict=True)
            factor = Variable("1", "factor of the tolerances").entry("front", limits)
            data["front_limit"] = factor if against == "tolerance" else of("front", against, "limit of {}", limits)
            feasible = [a.feasible for a in found]
            reached = {"objective": [a.objective for a in found], "objective_worst": [a.worst for a in found]}
            if against != "tolerance":
                reached[against] = [extreme(a.held(against, slice(1)), spec.front.end) for a in found]
            for key, x in reached.items():
                name = against if key == against else best
                data[f"front_{key}"] = of("front", name, "{}", np.where(feasible, x, np.nan))
            data["front_feasible"] = "front", feasible
        coords: dict[str, Any] = {"parameter": ("parameter", list(spec.bounds), {"long_name": "varied parameter"})}
        for prefix, dim, own in (
            ("", "candidate", [a.unit for a in results]),
            ("map_", "map", [a.unit for a in points]),
            ("front_", "front", [np.where(a.feasible, a.unit, np.nan) for _, a in front]),
        ):
            for k, name in enumerate(spec.bounds if own else ()):
                column = spec.low[k] + np.array(own)[:, k] * spec.width[k]
                entry = dim, column, parameter_attributes(sweep, name)
                (data if prefix == "front_" else coords)[prefix + name] = entry
        title = str(sweep.title or f"Design of {sweep.scene}: greatest {spec.variables[spec.maximise].long_name}")
        about |= {"scene": sweep.scene, "design": spec.text}
        about |= {"lanes": search.counts["lanes"], "orbit_solves": search.counts["orbits"]}
        return self.dataset(data, coords, title=title, **about)

    def page_cells(self, ds: xr.Dataset) -> tuple[xr.Dataset, Sweep] | None:
        tables = tomllib.loads(str(ds.attrs.get("design", "")))
        if "scene" not in tables:
            return None
        points = {str(name): ds[str(name)].values.tolist() for name in ds["parameter"].values}
        own: dict[str, Any] = {"points": points, "unusual": True}
        own |= {name: tables[name] for name in ("scene", "parameters", "starts", "run") if name in tables}
        try:
            sweep = read_sweep(own)
        except InputError:  # a system without a name
            return None
        names = [name for name in ds.data_vars if ds[name].dims == ("candidate",)]
        lanes = ds[names].rename(candidate=POINT).assign_coords(coordinates(sweep, {}))
        return lanes.assign_attrs(shared_attributes(sweep, self.kind, str(ds.attrs.get("title", "")), self.kind)), sweep

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        best = ds.isel(candidate=0)
        names = [str(name) for name in ds["parameter"].values]
        what = str(ds.attrs.get("maximise", "objective")).replace("_", " ")
        share = float(best["irregular_share"]) if "irregular_share" in best else 0.0
        irregular = f"irregular motions within the tolerances ({100 * share:.3g} % of the lanes)"
        lines = [f"{irregular}: worst values depend on the time of observation"] * (share > 0)
        lines.append(f"{what} {_best_text(ds, names)}")
        lines.append(f"  requirements: {ds.attrs.get('requirements', '')}")
        known = [str(name) for name in ds.data_vars if ds[name].dims == ("candidate",) and f"{name}_worst" in ds]
        of_subject = [name for name in known if name not in ("objective", "regime", "share")]
        subject = {name: {"nominal": float(best[name]), "worst": float(best[f"{name}_worst"])} for name in of_subject}
        for name, ends in subject.items():
            nominal, worst = (quantity_text(x, ds[name]) for x in ends.values())
            lines.append(f"  {name.replace('_', ' ')} {nominal}, worst {worst}")
        if np.isfinite(on_map := float(ds["map_objective"].max())):
            lines.append(f"  best point of the map: {quantity_text(on_map, ds['objective'])}, without tolerances")
        if ds.sizes["candidate"] > 1:
            others = ", ".join(quantity_text(float(x), ds["objective"]) for x in ds["objective"][1:])
            lines.append(f"  {counted(ds.sizes['candidate'] - 1, 'other candidate')}: {others}")
        facts = {
            "maximise": ds.attrs.get("maximise"),
            "objective": float(best["objective"]),
            "objective_worst": float(best["objective_worst"]),
            "at": {name: float(best[name]) for name in names},
            "subject": subject,
        }
        if "front" in ds.dims:
            points = f"{int((ds['front_feasible'] == 1).sum())} of {ds.sizes['front']} points feasible"
            lines.append(f"  front against {ds.attrs.get('against', '')}: {points}")
        return [SummaryPart("design", lines, {"design": facts})]


def design(source: str | PathLike[str] | Mapping[str, object], *, progress: bool = True) -> xr.Dataset:
    """Find the parameter values that maximise a variable, under constraints at samples of the tolerance box.

        best = vj.design("design.toml")
        best.isel(candidate=0)

    All candidates are simulated from every start, at all corners of the tolerance box and at 256 random points inside
    it. Worst values are computed over the simulated samples, not over the whole tolerance box.

    **Arguments:**

    - `source`: path of a TOML file, a bundled name such as "energy", or a dict with the same structure: `scene`,
      `maximise`, `vary`, and optionally `robust`, `subject`, `tolerance`, `parameters`, `starts`, `run`, `front`,
      `title`.

    **Returns:** a dataset along `candidate`, in which the best candidate comes first:

    - For each candidate: the parameters; `objective`, the maximised variable at the nominal point, worst over the
      starts; `objective_worst`, by which robust designs are ranked; each variable NAME in `subject`, with its worst
      value over the samples in `NAME_worst`; and `gradient`, the derivative of the objective by each `parameter`.
    - Along `front`, if the design has that entry: `front_limit` (the limit that is varied), `front_objective` (the best
      value within this limit) and the varied parameters. Along `map`: the coarse map, where the search begins.

    **Raises:** `InputError` if the design is invalid, if no point is feasible, or if the objective is 0 at all feasible
    points.

    **Example:**

    >>> spec = {"scene": "vibro-impact", "maximise": "impact_velocity", "starts": ["stuck"]}
    >>> spec |= {"vary": {"gamma": [0.6, 0.9]}, "subject": {"regime": "single-impact"}}
    >>> best = vj.design(spec, progress=False).isel(candidate=0)
    >>> bool(best.feasible == 1), round(float(best.gamma), 2)
    (True, 0.6)
    """
    return analyse(source, Designs(), progress)
