"""The analysis `design`: summary and picture of the best drill, and of a front."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vibrojax.errors import counted
from vibrojax.pictures.axes import label, pretty_unit, scale, values_along
from vibrojax.pictures.sheet import legend_at_right, write_margins
from vibrojax.pictures.style import BIT, FAINT, IMPACT, INK, colour_map, new_figure, styled
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.design_run import DESIGN_VARIABLES, find_design
from vibrojax.studies.design_spec import DesignSpec, read_design
from vibrojax.studies.subjects import FileAnalysis

_MAX_PANELS = 6


@styled
def design_picture(ds: xr.Dataset) -> Figure:
    """Draw the map with the candidates, over two parameters or over each of several, and the front if there is one."""
    names = [str(name) for name in ds["parameter"].values][:_MAX_PANELS]
    front = "front" in ds.dims
    panels = (1 if len(names) <= 2 else len(names)) + front
    columns = min(panels, 3)
    rows = -(-panels // columns)
    figure = new_figure(1.9 + 3.6 * columns, 0.9 + 3.1 * rows)
    grid = [figure.add_subplot(rows, columns, k + 1) for k in range(panels)]
    if len(names) == 2:
        _draw_plane(figure, grid[0], ds, names)
    else:
        for axes, name in zip(grid, names, strict=False):
            _draw_along(axes, ds, name)
    if front:
        _draw_front(grid[-1], ds)
    looks = {"best candidate": ("*", 11, IMPACT, IMPACT), "others": ("o", 4, INK, "none")}
    looks |= {"map: not feasible": ("x", 4, FAINT, FAINT)}
    if ds.sizes["candidate"] == 1:
        del looks["others"]
    handles = [
        Line2D([], [], color=colour, marker=mark, markersize=size, markerfacecolor=face, linestyle="none", label=words)
        for words, (mark, size, colour, face) in looks.items()
    ]
    legend_at_right(figure, handles)
    best = ds.isel(candidate=0)
    point = ", ".join(f"{name} = {quantity_text(float(best[name]), ds[name])}" for name in names)
    what = f"Best: {quantity_text(float(best['objective']), ds['objective'])} at {point}"
    write_margins(figure, ds, point=f"{what}. Requirements: {ds.attrs.get('requirements', '')}")
    return figure


def _draw_plane(figure: Figure, axes: Axes, ds: xr.Dataset, names: list[str]) -> None:
    x_name, y_name = names[1], names[0]
    x, y = values_along(ds[f"map_{x_name}"]), values_along(ds[f"map_{y_name}"])
    fit = ds["map_feasible"].values == 1
    z = ds["map_objective"].values * scale(ds["map_objective"])[0]
    shown = axes.scatter(x[fit], y[fit], c=z[fit], s=22, marker="s", cmap=colour_map())
    axes.scatter(x[~fit], y[~fit], c=FAINT, s=10, marker="x", linewidths=0.7)
    _mark(axes, values_along(ds[x_name]), values_along(ds[y_name]))
    factors = [scale(ds[name])[0] for name in (x_name, y_name)]
    widths = [
        float(ds.attrs.get(f"tolerance_{name}", 0.0)) * f for name, f in zip((x_name, y_name), factors, strict=True)
    ]
    if all(widths):
        centre = values_along(ds[x_name])[0], values_along(ds[y_name])[0]
        corner = [-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]
        axes.plot(*(c + w * np.array(k) for c, w, k in zip(centre, widths, corner, strict=True)), color=IMPACT, lw=0.9)
    figure.colorbar(shown, ax=axes, label=_objective_label(ds))
    axes.set_xlabel(label(_named(ds, x_name)))
    axes.set_ylabel(label(_named(ds, y_name)))


def _draw_along(axes: Axes, ds: xr.Dataset, name: str) -> None:
    x, fit = values_along(ds[f"map_{name}"]), ds["map_feasible"].values == 1
    factor = scale(ds["map_objective"])[0]
    z = ds["map_objective"].values * factor
    axes.plot(x[fit], z[fit], ".", color=BIT, markersize=4)
    axes.plot(x[~fit], np.full((~fit).sum(), axes.get_ylim()[0]), "x", color=FAINT, markersize=3)
    _mark(axes, values_along(ds[name]), ds["objective"].values * factor)
    axes.set_xlabel(label(_named(ds, name)))
    axes.set_ylabel(_objective_label(ds))
    axes.grid(True)


def _draw_front(axes: Axes, ds: xr.Dataset) -> None:
    against = str(ds.attrs.get("against", ""))
    limit = ds[f"front_{against}"] if f"front_{against}" in ds else ds["front_limit"]
    factor = scale(ds["front_objective"])[0]
    axes.plot(values_along(limit), ds["front_objective"].values * factor, "o-", color=BIT, markersize=3.5, lw=1.0)
    if (ds["front_objective_worst"].values != ds["front_objective"].values).any():
        worst = ds["front_objective_worst"].values * factor
        axes.plot(values_along(limit), worst, ":", color=BIT, lw=1.0)
    axes.set_xlabel(label(limit))
    axes.set_ylabel(_objective_label(ds))
    axes.set_title("front (dotted: worst of the samples of the tolerances)" if "tolerance" not in against else "front")
    axes.grid(True)


def _mark(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    axes.plot(x[1:], y[1:], "o", color=INK, markerfacecolor="none", markersize=4)
    axes.plot(x[:1], y[:1], "*", color=IMPACT, markersize=11, markeredgecolor="white", markeredgewidth=0.6)


def _named(ds: xr.Dataset, name: str) -> xr.DataArray:
    return ds[name].assign_attrs(symbol=name)


def _objective_label(ds: xr.Dataset) -> str:
    about = ds["map_objective"].assign_attrs(
        long_name=str(ds["map_objective"].attrs["long_name"]).partition(" on the")[0]
    )
    return label(about)


def quantity_text(value: float, data: xr.DataArray) -> str:
    """Format a value in the unit in which the variable is printed."""
    factor, unit = scale(data)
    return f"{value * factor:.4g} {pretty_unit(unit)}".rstrip()


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
        return asked.identity()

    def compute(self, asked: DesignSpec, progress: bool = True) -> xr.Dataset:
        return find_design(asked, progress)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the best candidate, its worst values within the tolerances, the other candidates, and the front."""
        best = ds.isel(candidate=0)
        names = [str(name) for name in ds["parameter"].values]
        where = ", ".join(f"{name} = {float(best[name]):.6g}" for name in names)
        objective = quantity_text(float(best["objective"]), ds["objective"])
        what = str(ds.attrs.get("maximise", "objective")).replace("_", " ")
        share = float(best["irregular_share"]) if "irregular_share" in best else 0.0
        lines = [
            f"irregular motions within the tolerances ({100 * share:.2g} % of the lanes): worst values depend on the "
            "time of observation"
        ] * (share > 0)
        lines += [f"{what} {objective} at {where}", f"  requirements: {ds.attrs.get('requirements', '')}"]
        if any(str(key).startswith("tolerance_") for key in ds.attrs):
            worst = quantity_text(float(best["objective_worst"]), ds["objective"])
            lines.append(f"  worst of the samples of the tolerances: {worst}")
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
