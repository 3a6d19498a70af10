"""The picture of a study: Sobol indices and interactions of pairs."""

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import Normalize

from vibrojax.errors import counted
from vibrojax.pictures.axes import margins, pretty_unit, scale
from vibrojax.pictures.plots import FAINT, INK, Axis, Bars, Cells, Layer, Line, Plot, Sheet, Text, bars, upright
from vibrojax.pictures.style import BIT
from vibrojax.studies.effects_sampling import REASONS, SHARE

MIN_SHARE = 0.05
"""Share of the variance below which a parameter or a pair counts as unimportant."""

_MAX_ROWS = 4
_BAR = 0.38  # height of a bar; two stand at each parameter


def bars_and_interactions(ds: xr.Dataset) -> Sheet:
    """Draw first-order and total indices with confidence intervals, and a heat map of the interactions of pairs.

    There is one row per variable, four at most.
    """
    of = [str(name) for name in ds["of"].values][:_MAX_ROWS]
    size = 9.0, len(of) * max(1.9, 0.8 + 0.26 * ds.sizes["parameter"]) + 0.8
    greatest = float(np.nanmax(ds["second_order"].values, initial=MIN_SHARE))
    plots = []
    for k, name in enumerate(of):
        row = ds.sel(of=name)
        plots.append(_share_plot(row, k, "share of the variance" if name == of[-1] else ""))
        plots.append(_pair_plot(row, k, greatest))
    rest = ds.sizes["of"] - len(of)
    further = counted(rest, "further variable is", "further variables are") + " not drawn" if rest else ""
    level = f"{100 * float(ds.attrs.get('confidence', 0.95)):.0f} %"
    about = f"Lines: intervals of {level} confidence; pairs within theirs of 0 have no number"
    return Sheet(plots, size, (1.5, 1.0), (1.0,) * len(of), **margins(ds, about, further))


def _share_plot(row: xr.Dataset, k: int, label: str) -> Plot:
    names = [str(name) for name in row["parameter"].values]
    places = np.arange(len(names), dtype=float)
    layers: list[Layer] = [upright(0.0, width=0.6)]
    looks = (-_BAR / 2, "first_order", BIT, "alone"), (_BAR / 2, "total_order", FAINT, "with all its\ninteractions")
    for shift, key, colour, text in looks:
        values, errors = row[key].values, np.nan_to_num(row[f"{key}_conf"].values)
        bottom = places + shift - _BAR / 2
        layers.append(Bars(np.zeros(len(names)), bottom, values, np.full(len(names), _BAR), colour, label=text))
        layers.append(Line(*bars(places + shift, values - errors, values + errors)[::-1], width=0.8))
    if int(row["sobol_reason"]) != REASONS.index("known"):
        layers.append(Text(0.5, 0.5, _why(row), relative=True))
    up = Axis(ticks=[*zip(places.tolist(), names, strict=True)], reversed=True)
    return Plot(layers, Axis(label), up, _title(row), (k, 0), grid="x")


def _pair_plot(row: xr.Dataset, k: int, greatest: float) -> Plot:
    """Draw the lower triangle of second-order indices; pairs within their confidence interval of 0 have no number."""
    names = [str(name) for name in row["parameter"].values]
    values, errors = (row[key].values for key in ("second_order", "second_order_conf"))
    lower = np.where(np.tri(len(names), k=-1, dtype=bool), np.maximum(values, 0.0), np.nan)
    ends = np.arange(len(names) + 1) - 0.5
    layers: list[Layer] = [Cells(ends, ends, lower, colormaps["Blues"], Normalize(0.0, greatest), hatched=False)]
    for i, j in zip(*np.nonzero(values > errors), strict=True):
        if j < i:
            colour = "#FFFFFF" if lower[i, j] > 0.6 * greatest else INK
            layers.append(Text(float(j), float(i), f"{100 * values[i, j]:.0f}", colour=colour, size=7.5))
    ticks = [(float(place), name) for place, name in enumerate(names)]
    across, up = Axis(ticks=ticks, rotated=True), Axis(ticks=ticks, reversed=True)
    return Plot(layers, across, up, "interactions of pairs [%]", (k, 1))


def _title(row: xr.Dataset) -> str:
    factor, unit = _scale(row)
    mean, std = (factor * float(f"{float(row[key]):.{digits}g}") for key, digits in (("mean", 3), ("std", 2)))
    amount = f"{mean:.6g} ± {std:.6g} {pretty_unit(unit)}"
    return f"{_words(row)}: {amount.strip()}"


def _words(row: xr.Dataset) -> str:
    return "share of single impacts" if str(row["of"].item()) == SHARE else str(row["of"].item()).replace("_", " ")


def _scale(row: xr.Dataset) -> tuple[float, str]:
    """Return the factor and the unit in which a row's variable is printed."""
    values = np.array([float(row["mean"]), float(row["std"]), *np.abs(np.nan_to_num(row["effect"].values))])
    return scale(xr.DataArray(values, attrs={"units": str(row["of_unit"].item())}))


def _why(row: xr.Dataset) -> str:
    return {"constant": "it is the same everywhere", "too-few-samples": "too few samples have a value"}.get(
        REASONS[int(row["sobol_reason"])], ""
    )
