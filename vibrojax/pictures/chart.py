"""The designer's chart: the stable single impact over two parameters, with maps of what a machine does there."""

from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.ndimage import binary_erosion, minimum_filter

from vibrojax.errors import InputError
from vibrojax.measures.labels import REGIMES
from vibrojax.pictures import axes
from vibrojax.pictures.colours import Value, value_of, words_for
from vibrojax.pictures.contents import POINT, REGIME, START, axes_of_map, lane_dims, without_single
from vibrojax.pictures.layout import Facets
from vibrojax.pictures.maps import cell_layers, maps_of, outline
from vibrojax.pictures.plots import Layer, Sheet, dots, one_colour, patch
from vibrojax.pictures.style import IMPACT, NOTHING

SAME_MOTION = 0.02  # relative spread of the impact energy over the starts, up to which their motions count as one
_BOX = np.ones((3, 3), bool)  # a tolerance of one cell in both parameters
_OTHER = "#D9D9D9"
_AIMS = ("rate_of_penetration", "impact_power", "impact_energy")
_SHOWN = ("impact_energy", "peak_impact_force", "rate_of_penetration", "impact_power", "blow_frequency")
_WORST_IS_GREATEST = ("peak_impact_force",)
_BEYOND = 1  # cells around the single impacts


def chart(ds: xr.Dataset) -> Sheet:
    """Draw the designer's chart of a sweep over two parameters: values are the worst over the starts.

    Maps of the impact energy, the peak force, the rate of penetration or the impact power, and the blows per minute
    show the cells in which all starts lead to one stable single impact. A line surrounds the robust cells, of which the
    eight cells around them are single impacts too. At the edge of the map, that is not known. The impact may differ
    from cell to cell, so the star is the robust cell whose worst value among these nine cells is best. The value is the
    rate of penetration, else the power, else the energy. The chart ends one cell beyond the single impacts.

    **Raises:** `InputError` if the dataset has no single impacts over two axes.
    """
    ds = without_single(ds)
    if REGIME not in ds or not {"impact_energy", "blow_frequency"} <= set(ds) or POINT in lane_dims(ds):
        raise InputError("chart: the dataset holds no impacts over a grid; give a sweep of a drill over two parameters")
    x, y = axes_of_map(ds)
    if others := [name for name in lane_dims(ds) if name not in (x, y, START)]:
        raise InputError(f"chart: {', '.join(others)} varies as well; fix it, as in --where {others[0]}=VALUE")
    ds = ds.transpose(y, x, ...).sortby([x, y])
    # The cells in which every start leads to the same stable single impact.
    cells, energy = ds[REGIME] == REGIMES.index("single-impact"), ds["impact_energy"]
    cells = cells & (ds["stable"] == 1) if "stable" in ds else cells
    if START in cells.dims:
        cells = cells.all(START) & (energy.max(START) <= (1 + SAME_MOTION) * energy.min(START))
    single = np.asarray(cells.values)
    robust = binary_erosion(single, _BOX)
    if single.any():
        around = tuple(slice(max(at.min() - _BEYOND, 0), at.max() + _BEYOND + 1) for at in np.nonzero(single))
        ds, single, robust = ds.isel({y: around[0], x: around[1]}), single[around], robust[around]
    names = [name for name in _SHOWN if name in ds and bool((ds[name] > 0).any())]
    if set(_AIMS[:2]) <= set(names):  # of rate and power only the first
        names.remove("impact_power")
    worst = ds[names].map(_worst, keep_attrs=True).where(xr.DataArray(single, dims=(y, x)))
    aim, best = _best(ds, robust)
    marks: list[Layer] = []
    if best is not None:
        place = [axes.values_along(ds[name])[[k]] for name, k in zip((x, y), best[::-1], strict=True)]
        look = {"marker": "*", "size": 12.0, "colour": IMPACT, "edge": "white", "clip": False, "order": 5.0}
        marks.append(dots(*place, label="best robust cell", **look))
    right, top = (axes.edges(axes.values_along(ds[name])) for name in (x, y))
    steps = {name: float(np.diff(ds[name].values).min(initial=np.inf)) for name in (x, y)}
    texts = [f"{axes.symbol(ds[name])} ± {axes.quantity_text(step, ds[name], 2)}" for name, step in steps.items()]
    marks += outline(robust, right, top, colour=IMPACT, width=1.4, label=f"robust: also within\n{', '.join(texts)}")
    other = one_colour(right, top, ~single, _OTHER)

    def layers_of(facet: xr.Dataset, value: Value) -> list[Layer]:
        return [*cell_layers(facet, value, x, y), other, *marks]

    values = [value_of(worst[name]) for name in names]
    note = "No cell is robust" if best is None else _best_text(ds, (x, y), aim, best, names)
    about = axes.margins(ds, "Values are the worst over the starts" if START in ds.dims else "", note)
    about["title"] = f"Designer's chart: {about['title']}"
    keys = [patch(_OTHER, "other motions")]
    if any((worst[value.name] == 0).any() for value in values if value.of_rate):
        keys.append(patch(NOTHING, "no penetration"))
    return replace(
        maps_of(Facets(("",), (worst,)), values, ds[x], ds[y], layers_of), keys=[keys], beside=False, **about
    )


def _worst(data: xr.DataArray) -> xr.DataArray:
    """Return the worst value over the starts, which is the greatest of a force and the least of what drills."""
    if START not in data.dims:
        return data
    of = data.max if data.name in _WORST_IS_GREATEST else data.min
    return of(START, keep_attrs=True)


def _best(ds: xr.Dataset, robust: np.ndarray) -> tuple[str, tuple[int, int] | None]:
    """Return the first of rate, power and energy that is not 0 around all robust cells, and the best cell.

    The cell is None if no cell is robust.
    """
    if not robust.any():
        return "", None
    for name in (name for name in _AIMS if name in ds):
        values = np.nan_to_num(_worst(ds[name]).values)
        around = np.where(robust, minimum_filter(values, footprint=_BOX), -np.inf)
        if around.max() > 0:
            break
    row, column = np.unravel_index(around.argmax(), around.shape)
    return name, (int(row), int(column))


def _best_text(ds: xr.Dataset, over: tuple[str, str], aim: str, best: tuple[int, int], names: list[str]) -> str:
    place = ", ".join(axes.value_text(ds[name], float(ds[name][k])) for name, k in zip(over, best[::-1], strict=True))
    values = {name: _worst(ds[name]) for name in dict.fromkeys((*names, aim))}
    words = [f"{words_for(name)} {axes.quantity_text(float(f'{float(x[best]):.3g}'), x)}" for name, x in values.items()]
    return f"Best robust cell, by {words_for(aim)} at worst within the tolerance: {place}; {', '.join(words)}"
