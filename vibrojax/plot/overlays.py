"""Families of orbits drawn over a sweep along the same parameter, and input checks for all overlays."""

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from vibrojax.errors import InputError
from vibrojax.io.attributes import parameters_of
from vibrojax.io.branches import FAMILY, along_name, branches, kind_names, numbers_of
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import edges, number, values_along
from vibrojax.plot.branches import (
    MARKS,
    Curve,
    distinguishing_coords,
    draw_families,
    ranges_text,
    special_handles,
    stability_handles,
)
from vibrojax.plot.contents import is_numeric
from vibrojax.plot.style import INK

OF_RETURNS = "impact_velocity"
"""Variable of a family that is drawn over a sweep's section crossings."""

SAME_DIGITS = 1e-4
"""Relative difference up to which two values count as equal: about as many digits as a picture prints."""

Overlays = xr.Dataset | Sequence[xr.Dataset] | None


def as_layers(over: Overlays) -> tuple[xr.Dataset, ...]:
    """Return the overlay datasets as a tuple, which is empty for None."""
    if over is None:
        return ()
    return (over,) if isinstance(over, xr.Dataset) else tuple(over)


def refuse_overlays(layers: Sequence[xr.Dataset], reason: str) -> NoReturn:
    """Raise `InputError`: say which pictures accept the layers, and the `reason` why this picture does not."""
    if any(isinstance(layer, xr.Dataset) and kind_of(layer) == "borders" for layer in layers):
        places = "borders are laid over the map of regimes of a sweep over a grid of two parameters"
    else:
        places = "families are laid over the returns of a sweep with keep_returns above 0, or over carried lanes"
    raise InputError(f"over: {places}, and {reason}")


def check_machine(ds: xr.Dataset, over: xr.Dataset, layer: str, below: str, advice: str) -> None:
    """Raise `InputError` unless the overlay `over` has the scene and the friction law of `ds`."""
    for name in ("scene", "friction"):
        if ds.attrs.get(name) != over.attrs.get(name):
            values = over.attrs.get(name), ds.attrs.get(name)
            raise InputError(
                f"over: the {layer} are of {name} {values[0]}, the {below} of {values[1]}; {advice} {values[1]}"
            )


def check_families(ds: xr.Dataset, layers: Sequence[xr.Dataset], x: str) -> None:
    """Raise `InputError` unless all `layers` are families along the axis `x` with the scene and parameters of `ds`."""
    values = _parameter_values(ds)
    for over in layers:
        if not isinstance(over, xr.Dataset) or kind_of(over) != "family":
            raise InputError("over: no families of orbits; give what vj.follow or vibrojax follow has made")
        along = along_name(over)
        if along != x:
            raise InputError(f"over: the families are along {along}, and the returns over {x}; follow along {x}")
        check_machine(ds, over, "families", "returns", "follow those of")
        for name, value in parameters_of(over).items():
            if name != x and name in values and not _is_near(values[name], value).any():
                raise InputError(
                    f"over: the families are of {name} = {number(value)}, the returns of "
                    f"{', '.join(map(number, values[name][:5]))}; follow families of the same value"
                )
        for name in _numeric_coords(over):
            if name in values and not any(_is_near(values[name], value).any() for value in over[name].values):
                raise InputError(f"over: none of the families has the {name} of the returns; follow one of that value")


def draw_over(axes: Axes, layers: Sequence[xr.Dataset], facet: xr.Dataset, x: str, name: str, factor: float) -> None:
    """Draw the variable `name` of those families that have the parameters of `facet`, within its range of `x`."""
    values = _parameter_values(facet)
    for over in layers:
        same = all(
            _is_near(values[parameter], value).any()
            for parameter, value in parameters_of(over).items()
            if parameter != x and parameter in values
        )
        if name not in over or not same:
            continue
        fits = np.ones(over.sizes.get(FAMILY, 1), bool)
        for coord in _numeric_coords(over):
            if coord in values:
                fits &= _is_near(over[coord].values, float(values[coord][0]))
        numbers = over[FAMILY].values[fits] if FAMILY in over.dims else np.unique(numbers_of(over, "point"))
        curves = [Curve(branch, INK) for branch in branches(over) if branch.family in numbers]
        ends = edges(np.sort(values_along(facet[x])))
        within = float(ends[0]), float(ends[-1])
        draw_families(axes, over, curves, name, thin=True, factor=factor, within=within, over_dots=True)


def over_handles(layers: Sequence[xr.Dataset]) -> list[Artist]:
    """Return the legend entries for families, without duplicates."""
    lines: dict[str, Artist] = {}
    marks: dict[str, Artist] = {}
    for over in layers:
        curves = [Curve(branch, INK) for branch in branches(over)]
        lines |= {str(handle.get_label()): handle for handle in stability_handles(over, curves, " orbit")}
        marks |= {str(handle.get_label()): handle for handle in special_handles(over, count=False)}
    return [*lines.values(), *(marks[kind] for kind in dict.fromkeys((*MARKS, *marks)) if kind in marks)]


def special_points(over: xr.Dataset) -> list[tuple[str, float]]:
    """Return kind and parameter value of each special point of families, except points of kind "end"."""
    points = zip(kind_names(over), over["special_value"].values.tolist(), strict=True)
    return [(kind, value) for kind, value in points if kind != "end"]


def over_text(ds: xr.Dataset, layers: Sequence[xr.Dataset]) -> str:
    """Return the note on the family lines over the section crossings in `ds`, or "" without layers."""
    if not layers:
        return ""
    several = "return_impacts" in ds and bool((ds["return_impacts"].values > 1).any())
    mean = "A dot is the mean of the blows since the return before" if several else ""
    ranges = {ranges_text(over, (OF_RETURNS,)) for over in layers}
    return ". ".join(filter(None, ("Lines: orbits that were followed", *sorted(ranges), mean)))


def _numeric_coords(over: xr.Dataset) -> list[str]:
    """Return the names of the numeric coordinates that distinguish several families."""
    return [name for name in distinguishing_coords(over) if is_numeric(over[name])]


def _parameter_values(ds: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the values of all parameters of a sweep, fixed and varied, by name."""
    along = {str(name): np.atleast_1d(data.values) for name, data in ds.coords.items() if is_numeric(data)}
    return {name: np.array([value]) for name, value in parameters_of(ds).items()} | along


def _is_near(values: np.ndarray, value: float) -> np.ndarray:
    return np.abs(values - value) <= SAME_DIGITS * np.abs(value)
