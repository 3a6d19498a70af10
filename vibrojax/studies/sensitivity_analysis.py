"""The analysis `sensitivity`: derivatives at the orbits of a sweep, their picture and their summary."""

from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import Normalize

from vibrojax.errors import counted
from vibrojax.io.attributes import flags
from vibrojax.maps.sweep import Sweep
from vibrojax.pictures.plots import Axis, Cells, Layer, Plot, Sheet, Text
from vibrojax.studies.analysis import PictureRule, SummaryPart
from vibrojax.studies.sensitivity_maps import KIND, at_orbits
from vibrojax.studies.sweep_analysis import SweepAnalysis

SMALLEST_DRAWN = 5e-3
"""Elasticity below which a cell shows no number."""


def elasticities(ds: xr.Dataset) -> Sheet:
    """Draw the median elasticity of each variable with respect to each parameter, over the valid lanes.

    The elasticity is the relative change of the variable per relative change of the parameter.
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
    norm = Normalize(-3.0, 3.0)
    layers: list[Layer] = [Cells(across, up, np.clip(table, -1.5, 1.5), colormaps["RdBu_r"], norm, hatched=False)]
    for (i, j), value in np.ndenumerate(table):
        if abs(value) >= SMALLEST_DRAWN:
            layers.append(Text(float(j), float(i), f"{value:.2f}".replace("-", "−"), colour="#000000", size=7.0))
    ticks = [[(float(k), name) for k, name in enumerate(names)] for names in (by, list(rows))]
    plot = Plot(layers, Axis(ticks=ticks[0]), Axis(ticks=ticks[1], reversed=True))
    size = 1.8 + 0.62 * len(by), 1.2 + 0.27 * max(len(rows), 1)
    return Sheet([plot], size, title=f"Median elasticity at {counted(int(valid.sum()), 'orbit')}")


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
        reason, meanings = ds["reason"].values.ravel(), flags(ds["reason"])
        counts = {meanings[flag]: int((reason == flag).sum()) for flag in np.unique(reason).tolist()}
        valid = counts.pop("none", 0)
        others = ", ".join(f"{count} {name}" for name, count in counts.items())
        lines = [f"derivatives hold in {valid} of {counted(reason.size, 'lane')}" + (f" ({others})" if others else "")]
        return [SummaryPart(KIND, lines, {KIND: {"valid": valid, **counts}})]
