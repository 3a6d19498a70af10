"""The designer's chart: the stable single impact over two parameters, with lines of what a machine does there."""

from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion, minimum_filter

from vibrojax.errors import InputError
from vibrojax.lazy import colors, ticker
from vibrojax.measures.labels import REGIMES
from vibrojax.pictures import axes
from vibrojax.pictures.contents import POINT, REGIME, START, axes_of_map, lane_dims, without_single
from vibrojax.pictures.layout import is_narrow
from vibrojax.pictures.maps import contours, region
from vibrojax.pictures.plots import INK, Cells, Dash, Key, Layer, Plot, Sheet, dots, patch
from vibrojax.pictures.style import IMPACT

SAME_MOTION = 0.02
"""Relative spread of the impact energy over the starts, up to which their motions count as one."""

_BOX = np.ones((3, 3), bool)  # a tolerance of one cell in both parameters
_ROBUST, _SINGLE, _OTHER = "#FFFFFF", "#FFD97A", "#D9D9D9"
_PANELS = ("impact_energy", "peak_impact_force"), ("rate_of_penetration", "impact_power", "blow_frequency")
_LINES = {
    "impact_energy": ("impact energy", "#9A3B00"),
    "peak_impact_force": ("peak force", "#004488"),
    "rate_of_penetration": ("rate of penetration", "#1B7837"),
    "impact_power": ("impact power", "#1B7837"),
    "blow_frequency": ("blows", "#6A1B5D"),
}
_AIMS = ("rate_of_penetration", "impact_power", "impact_energy")
_WORST_IS_GREATEST = {"peak_impact_force"}
_DASHES: tuple[Dash, ...] = ("-", "--")
_LEVELS = 7  # approximate number of lines of a quantity
_BEYOND = 1  # cells around the single impacts


def chart(ds: xr.Dataset) -> Sheet:
    """Draw the designer's chart of a sweep over two parameters: values are the worst over the starts.

    White cells are robust: in the cell, and in the eight cells around it, all starts lead to one stable single impact.
    At the edge of the map, that is not known. The impact may differ from cell to cell, so the star is the robust cell
    whose worst value among these nine cells is best: of the rate of penetration, else of the power, else of the energy.
    Lines are the impact energy, the peak force, the rate of penetration or the impact power, and the blows per minute.
    The chart ends one cell beyond the single impacts.

    **Raises:** `InputError` if the dataset has no single impacts over two axes.
    """
    ds = without_single(ds)
    if REGIME not in ds or not {"impact_energy", "blow_frequency"} <= set(ds) or POINT in lane_dims(ds):
        raise InputError("chart: the dataset holds no impacts over a grid; give a sweep of a drill over two parameters")
    x, y = axes_of_map(ds)
    if others := [name for name in lane_dims(ds) if name not in (x, y, START)]:
        raise InputError(f"chart: {', '.join(others)} varies as well; fix it, as in --where {others[0]}=VALUE")
    ds = ds.transpose(y, x, ...).sortby([x, y])
    single = _single(ds)
    robust = binary_erosion(single, _BOX)
    if single.any():
        around = tuple(slice(max(at.min() - _BEYOND, 0), at.max() + _BEYOND + 1) for at in np.nonzero(single))
        ds, single, robust = ds.isel({y: around[0], x: around[1]}), single[around], robust[around]
    names = [[name for name in group if name in ds and bool((ds[name] > 0).any())] for group in _PANELS]
    names[1] = list(dict.fromkeys((*names[1][:1], *names[1][-1:])))  # of rate and power only the first
    aim, best = _best(ds, robust)
    marks = region(ds[x], ds[y])
    place: tuple[float, ...] = ()
    if best is not None:
        place = tuple(float(axes.values_along(ds[name])[k]) for name, k in zip((x, y), best[::-1], strict=True))
        look = {"marker": "*", "size": 14.0, "colour": IMPACT, "edge": "white", "clip": False, "order": 5.0}
        marks.append(dots(*([along] for along in place), label="best robust cell", **look))
    tolerance = ", ".join(f"{axes.symbol(ds[name])} ± {_step(ds[name])}" for name in (x, y))
    regions = {_ROBUST: f"robust: also within\n{tolerance}", _SINGLE: "the same single impact\nfrom every start"}
    regions[_OTHER] = "other motions"
    keys: list[Key] = [patch(colour, words, edge=INK) for colour, words in regions.items()]
    keys += [replace(mark, x=(), y=()) for mark in marks]
    extra = [replace(mark, label="") for mark in marks]
    plots = [_panel(ds, (x, y), single.astype(int) + robust, group, place) for group in names]
    step = -1 if is_narrow() else 1  # below each other
    plots = [replace(plot, layers=[*plot.layers, *extra], place=(0, k)[::step]) for k, plot in enumerate(plots)]
    note = "No cell is robust" if best is None else _best_text(ds, (x, y), aim, best, names)
    about = axes.margins(ds, "Values are the worst over the starts" if START in ds.dims else "", note)
    about["title"] = f"Designer's chart: {about['title']}"
    size = (14.2, 5.2) if step > 0 else (5.0, 7.6)
    return Sheet(plots, size, keys=[keys], beside=False, **about)


def _step(data: xr.DataArray) -> str:
    """Return the least distance of neighbouring cells along an axis, with its unit."""
    return axes.quantity_text(float(np.diff(data.values).min(initial=np.inf)), data, 2)


def _single(ds: xr.Dataset) -> Bool[np.ndarray, "y x"]:
    """Return the cells in which every start leads to the same stable single impact."""
    single, energy = ds[REGIME] == REGIMES.index("single-impact"), ds["impact_energy"]
    if "stable" in ds:
        single = single & (ds["stable"] == 1)
    if START not in single.dims:
        return np.asarray(single.values)
    same = energy.max(START) <= (1 + SAME_MOTION) * energy.min(START)
    return np.asarray((single.all(START) & same).values)


def _worst(ds: xr.Dataset, name: str) -> Float[np.ndarray, "y x"]:
    if START not in ds[name].dims:
        return np.asarray(ds[name].values, float)
    return np.asarray((ds[name].max(START) if name in _WORST_IS_GREATEST else ds[name].min(START)).values, float)


def _best(ds: xr.Dataset, robust: np.ndarray) -> tuple[str, tuple[int, int] | None]:
    """Return the first of rate, power and energy that is not 0 around all robust cells, and the best cell.

    The cell is None if no cell is robust.
    """
    if not robust.any():
        return "", None
    for name in (name for name in _AIMS if name in ds):
        around = np.where(robust, minimum_filter(np.nan_to_num(_worst(ds, name)), footprint=_BOX), -np.inf)
        if around.max() > 0:
            break
    row, column = np.unravel_index(around.argmax(), around.shape)
    return name, (int(row), int(column))


def _best_text(ds: xr.Dataset, over: tuple[str, str], aim: str, best: tuple[int, int], names: list[list[str]]) -> str:
    place = ", ".join(axes.value_text(ds[name], float(ds[name][k])) for name, k in zip(over, best[::-1], strict=True))
    words = []
    for name in dict.fromkeys((*names[0], aim, *names[1])):
        factor, unit = axes.scale(ds[name])
        value = float(f"{factor * _worst(ds, name)[best]:.3g}")
        words.append(f"{_LINES[name][0]} {axes.number(value)} {axes.pretty_unit(unit)}")
    return f"Best robust cell, by {_LINES[aim][0]} at worst within the tolerance: {place}; {', '.join(words)}"


def _panel(ds: xr.Dataset, over: tuple[str, str], kinds: np.ndarray, names: list[str], star: tuple[float, ...]) -> Plot:
    x, y = (axes.values_along(ds[name]) for name in over)
    colours = colors.ListedColormap([_OTHER, _SINGLE, _ROBUST])
    layers: list[Layer] = [
        Cells(axes.edges(x), axes.edges(y), kinds.astype(float), colours, colors.Normalize(0.0, 2.0))
    ]
    within = binary_erosion(kinds > 0, _BOX, border_value=1)  # without the jumps to other motions
    taken = [(np.asarray(star) - (x[0], y[0])) / (np.ptp(x), np.ptp(y))] if star else []
    for name, dash in zip(names, _DASHES, strict=False):
        z = np.where(within, axes.scale(ds[name])[0] * _worst(ds, name), np.nan)
        known = z[np.isfinite(z)]
        if known.size > 1 and np.ptp(known) and min(z.shape) > 1:
            levels = list(ticker.MaxNLocator(_LEVELS).tick_values(known.min(), known.max()))
            words, colour = _LINES[name]
            label = axes.with_unit(words, axes.scale(ds[name])[1])
            layers += contours(x, y, z, levels, taken, True, colour=colour, dash=dash, width=1.1, label=label)
    across, up = axes.axis(ds[over[0]]), axes.axis(ds[over[1]], group="y")
    return Plot(layers, across, up, keys="above", key_columns=2, grid="")
