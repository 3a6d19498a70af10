"""The analysis `design`: summary and picture of the best drill, and of a front."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import counted
from vibrojax.maps.dataset import coordinates, shared_attributes
from vibrojax.maps.read import read_sweep
from vibrojax.maps.sweep import Sweep
from vibrojax.pictures.axes import axis, label, margins, quantity_text, scale, symbols_of, value_text, values_along
from vibrojax.pictures.colours import value_of
from vibrojax.pictures.contents import POINT
from vibrojax.pictures.plots import FAINT, Axis, Layer, Line, Plot, Points, Sheet, colours_of, dots
from vibrojax.pictures.style import BIT, IMPACT
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.design import DESIGN_VARIABLES, find_design, read_design
from vibrojax.studies.design_points import DesignSpec
from vibrojax.studies.subjects import FileAnalysis

_MAX_PANELS = 6


def design_picture(ds: xr.Dataset) -> Sheet:
    """Draw the map with the candidates, over two parameters or over each of several, and the front if there is one."""
    names = [str(name) for name in ds["parameter"].values][:_MAX_PANELS]
    plots = [_plane(ds, names)] if len(names) == 2 else [_plot_along(ds, name) for name in names]
    plots += [_front_plot(ds)] if "front" in ds.dims else []
    columns = min(len(plots), 3)
    rows = -(-len(plots) // columns)
    plots = [replace(plot, place=divmod(k, columns)) for k, plot in enumerate(plots)]
    best = ds.isel(candidate=0)
    what = f"Best: {_best_text(ds)} at {_place_text(best, names)}"
    about = margins(ds, point=f"{what}. Requirements: {ds.attrs.get('requirements', '')}")
    return Sheet(plots, (1.9 + 3.6 * columns, 0.9 + 3.1 * rows), (1.0,) * columns, (1.0,) * rows, **about)


def _plane(ds: xr.Dataset, names: list[str]) -> Plot:
    across, up = names[1], names[0]
    x, y = values_along(ds[f"map_{across}"]), values_along(ds[f"map_{up}"])
    fit = ds["map_feasible"].values == 1
    value = replace(value_of(ds["map_objective"]), label=_objective_label(ds))
    colours = colours_of(value.of(ds).values[fit], value.colour_map, value.norm)
    layers: list[Layer] = [Points(x[fit], y[fit], colours, 4.7, "s"), *_infeasible(x[~fit], y[~fit])]
    layers += _marks(values_along(ds[across]), values_along(ds[up]))
    widths = [float(ds.attrs.get(f"tolerance_{name}", 0.0)) * scale(ds[name])[0] for name in (across, up)]
    if all(widths):
        centre = values_along(ds[across])[0], values_along(ds[up])[0]
        corners = [-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]
        right, top = (c + w * np.array(k) for c, w, k in zip(centre, widths, corners, strict=True))
        layers.append(Line(right, top, IMPACT, 0.9))
    return Plot(layers, axis(_named(ds, across)), axis(_named(ds, up)), grid="", scale=value)


def _plot_along(ds: xr.Dataset, name: str) -> Plot:
    x, fit = values_along(ds[f"map_{name}"]), ds["map_feasible"].values == 1
    factor = scale(ds["map_objective"])[0]
    z = ds["map_objective"].values * factor
    lowest = float(np.nanmin(np.concatenate([z[fit], ds["objective"].values * factor])))
    layers = [dots(x[fit], z[fit], colour=BIT, size=2.0), *_infeasible(x[~fit], np.full((~fit).sum(), lowest))]
    layers += _marks(values_along(ds[name]), ds["objective"].values * factor)
    return Plot(layers, axis(_named(ds, name)), Axis(_objective_label(ds)))


def _front_plot(ds: xr.Dataset) -> Plot:
    against = str(ds.attrs.get("against", ""))
    limit = ds[f"front_{against}"] if f"front_{against}" in ds else ds["front_limit"]
    factor = scale(ds["front_objective"])[0]
    x = values_along(limit)
    layers: list[Layer] = [Line(x, ds["front_objective"].values * factor, BIT, 1.0, marker="o", size=3.5)]
    title = "front"
    if (ds["front_objective_worst"].values != ds["front_objective"].values).any():
        layers.append(Line(x, ds["front_objective_worst"].values * factor, BIT, 1.0, ":"))
        title += " (dotted: worst of the samples of the tolerances)" if "tolerance" not in against else ""
    return Plot(layers, axis(limit), Axis(_objective_label(ds)), title)


def _infeasible(x: np.ndarray, y: np.ndarray) -> list[Layer]:
    return [dots(x, y, marker="x", colour=FAINT, size=3.0, edge_width=0.7, label="map: not feasible")] if x.size else []


def _marks(x: np.ndarray, y: np.ndarray) -> list[Layer]:
    others: list[Layer] = [dots(x[1:], y[1:], face="none", label="other candidates")] if x.size > 1 else []
    star = {"marker": "*", "size": 11.0, "colour": IMPACT, "edge": "white", "edge_width": 0.6, "order": 3.0}
    return [*others, dots(x[:1], y[:1], label="best candidate", **star)]


def _place_text(candidate: xr.Dataset, names: Sequence[str]) -> str:
    return ", ".join(value_text(_named(candidate, name), candidate[name].item()) for name in names)


def _named(ds: xr.Dataset, name: str) -> xr.DataArray:
    return ds[name].assign_attrs(symbol=symbols_of(ds).get(name, name))


def _best_text(ds: xr.Dataset) -> str:
    """Return the objective of the best candidate, and the worst within the tolerances."""
    value = quantity_text(float(ds["objective"][0]), ds["objective"])
    if not any(str(key).startswith("tolerance_") for key in ds.attrs):
        return value
    return f"{value} (worst within the tolerances {quantity_text(float(ds['objective_worst'][0]), ds['objective'])})"


def _objective_label(ds: xr.Dataset) -> str:
    about = ds["map_objective"].assign_attrs(
        long_name=str(ds["map_objective"].attrs["long_name"]).partition(" on the")[0]
    )
    return label(about)


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

    def identity(self, asked: DesignSpec) -> dict[str, object]:
        """Return all settings on which the result depends, as flat JSON values."""
        own: dict[str, object] = {f"tolerance.{name}": width for name, width in asked.tolerances.items()}
        own |= {f"subject.{c.variable}.{c.end}": c.limit for c in asked.constraints}
        own |= {"robust": True} if asked.robust else {}
        front = asked.front and [asked.front.against, asked.front.end, asked.front.points, asked.front.span]
        own |= {"maximise": asked.maximise, "regime": asked.regime, "share": asked.share, "front": front}
        return asked.template.identity() | {f"design.{name}": value for name, value in own.items()}

    def compute(self, asked: DesignSpec, progress: bool = True) -> xr.Dataset:
        return find_design(asked, progress)

    def page_lanes(self, ds: xr.Dataset) -> tuple[xr.Dataset, Sweep] | None:
        """Return the candidates as points of a sweep, with their variables."""
        tables = tomllib.loads(str(ds.attrs.get("design", "")))
        if "scene" not in tables:
            return None
        points = {str(name): ds[str(name)].values.tolist() for name in ds["parameter"].values}
        own: dict[str, Any] = {
            name: tables[name] for name in ("scene", "parameters", "starts", "run") if name in tables
        }
        sweep = read_sweep({**own, "points": points, "unusual": True})
        names = [name for name in ds.data_vars if ds[name].dims == ("candidate",)]
        lanes = ds[names].rename(candidate=POINT).assign_coords(coordinates(sweep, {}))
        return lanes.assign_attrs(shared_attributes(sweep, self.kind, str(ds.attrs.get("title", "")), self.kind)), sweep

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the best candidate, its worst values within the tolerances, the other candidates, and the front."""
        best = ds.isel(candidate=0)
        names = [str(name) for name in ds["parameter"].values]
        what = str(ds.attrs.get("maximise", "objective")).replace("_", " ")
        share = float(best["irregular_share"]) if "irregular_share" in best else 0.0
        lines = [
            f"irregular motions within the tolerances ({100 * share:.2g} % of the lanes): worst values depend on the "
            "time of observation"
        ] * (share > 0)
        lines.append(f"{what} {_best_text(ds)} at {_place_text(best, names)}")
        lines.append(f"  requirements: {ds.attrs.get('requirements', '')}")
        for name in _subject(ds):
            worst = quantity_text(float(best[f"{name}_worst"]), ds[name])
            lines.append(f"  {name.replace('_', ' ')} {quantity_text(float(best[name]), ds[name])}, worst {worst}")
        on_map = float(ds["map_objective"].max()) if ds["map_objective"].notnull().any() else np.nan
        if np.isfinite(on_map):
            lines.append(f"  best point of the map: {quantity_text(on_map, ds['objective'])}, without tolerances")
        if ds.sizes["candidate"] > 1:
            others = ", ".join(quantity_text(float(x), ds["objective"]) for x in ds["objective"][1:])
            lines.append(f"  {counted(ds.sizes['candidate'] - 1, 'other candidate')}: {others}")
        facts = {
            "maximise": ds.attrs.get("maximise"),
            "objective": float(best["objective"]),
            "objective_worst": float(best["objective_worst"]),
            "at": {name: float(best[name]) for name in names},
            "subject": {
                name: {"nominal": float(best[name]), "worst": float(best[f"{name}_worst"])} for name in _subject(ds)
            },
        }
        if "front" in ds.dims:
            known = int((ds["front_feasible"] == 1).sum())
            lines.append(
                f"  front against {ds.attrs.get('against', '')}: {known} of {ds.sizes['front']} points feasible"
            )
        return [SummaryPart("design", lines, {"design": facts})]


def _subject(ds: xr.Dataset) -> list[str]:
    own = (str(name) for name in ds.data_vars if ds[name].dims == ("candidate",))
    return [name for name in own if f"{name}_worst" in ds and name not in ("objective", "regime", "share")]
