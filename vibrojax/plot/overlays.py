"""Families of orbits laid over what a sweep found along the same parameter."""

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
from vibrojax.plot.branches import MARKS, Curve, draw_families, ranges_text, special_handles, stability_handles
from vibrojax.plot.contents import is_numeric
from vibrojax.plot.style import INK

OF_RETURNS = "impact_velocity"
"""The variable of a family that the returns of a sweep are those of."""

_SAME = 1e-4  # relative: as many digits as a picture prints


def several(over: xr.Dataset | Sequence[xr.Dataset] | None) -> tuple[xr.Dataset, ...]:
    """The datasets that were given to be laid over another: one, several or none."""
    if over is None:
        return ()
    return (over,) if isinstance(over, xr.Dataset) else tuple(over)


def refuse_overlays(layers: Sequence[xr.Dataset], reason: str) -> NoReturn:
    """Raise `InputError`: it names what the layers may be laid over, and the reason why not here."""
    if any(isinstance(layer, xr.Dataset) and kind_of(layer) == "borders" for layer in layers):
        below = "borders are laid over the map of regimes of a sweep over a grid of two parameters"
    else:
        below = "families are laid over the returns of a sweep with keep_returns above 0, or over carried lanes"
    raise InputError(f"over: {below}, and {reason}")


def check_over(ds: xr.Dataset, over: xr.Dataset, x: str) -> None:
    """Raise `InputError` unless `over` has families along the axis `x` of the machine of `ds`."""
    if not isinstance(over, xr.Dataset) or kind_of(over) != "family":
        raise InputError("over: no families of orbits; give what vj.follow or vibrojax follow has made")
    if along_name(over) != x:
        raise InputError(f"over: the families are along {along_name(over)}, and the returns over {x}; follow along {x}")
    for name in ("scene", "friction"):
        mine, theirs = ds.attrs.get(name), over.attrs.get(name)
        if mine != theirs:
            raise InputError(
                f"over: the families are of {name} {theirs}, the returns of {mine}; follow those of {mine}"
            )
    values = _values(ds)
    for name, value in parameters_of(over).items():
        if name != x and name in values and not _near(values[name], value).any():
            raise InputError(
                f"over: the families are of {name} = {number(value)}, the returns of "
                f"{', '.join(map(number, values[name][:5]))}; follow those of the same value"
            )
    for name in _telling(over):
        if name in values and not any(_near(values[name], value).any() for value in over[name].values):
            raise InputError(f"over: none of the families has the {name} of the returns; follow those of that value")


def draw_over(axes: Axes, over: xr.Dataset, facet: xr.Dataset, x: str, name: str, factor: float) -> None:
    """Draw the variable `name` of the families in `over` that are of the parameters of `facet`, as far as its axis `x`
    goes."""
    if name not in over:
        return
    fits = np.ones(over.sizes.get(FAMILY, 1), bool)
    values = _values(facet)
    for one in _telling(over):
        if one in values:
            fits &= _near(over[one].values, float(values[one][0]))
    for one, value in parameters_of(over).items():
        if one != x and one in values and not _near(values[one], value).any():
            return
    there = over[FAMILY].values[fits] if FAMILY in over.dims else np.unique(numbers_of(over, "point"))
    curves = [Curve(branch, INK) for branch in branches(over) if branch.family in there]
    ends = edges(np.sort(values_along(facet[x])))
    within = float(ends[0]), float(ends[-1])
    draw_families(axes, over, curves, name, thin=True, factor=factor, within=within, over_dots=True)


def over_handles(every: Sequence[xr.Dataset]) -> list[Artist]:
    """The legend's entries for families, each once."""
    lines: dict[str, Artist] = {}
    marks: dict[str, Artist] = {}
    for over in every:
        curves = [Curve(branch, INK) for branch in branches(over)]
        lines |= {str(one.get_label()): one for one in stability_handles(over, curves, " orbit")}
        marks |= {str(one.get_label()): one for one in special_handles(over, count=False)}
    order = [*MARKS, *marks]
    return [*lines.values(), *(marks[kind] for kind in sorted(marks, key=order.index))]


def special_points(over: xr.Dataset) -> list[tuple[str, float]]:
    """The kind and the value of the parameter of each special point of families but their ends."""
    points = zip(kind_names(over), over["special_value"].values.tolist(), strict=True)
    return [(kind, value) for kind, value in points if kind != "end"]


def over_text(ds: xr.Dataset, every: Sequence[xr.Dataset], name: str) -> str:
    """What the lines over the returns in `ds` are, in words."""
    if not every:
        return ""
    several = "return_impacts" in ds and bool((ds["return_impacts"].values > 1).any())
    mean = "A dot is the mean of the blows since the return before" if several else ""
    ranges = {ranges_text(over, (name,)) for over in every}
    return ". ".join(text for text in ("Lines: orbits that were followed", *sorted(ranges), mean) if text)


def _telling(over: xr.Dataset) -> list[str]:
    """The numbers that tell several families apart."""
    along = [str(name) for name, data in over.coords.items() if data.dims == (FAMILY,) and name != FAMILY]
    return [name for name in along if is_numeric(over[name])]


def _values(ds: xr.Dataset) -> dict[str, np.ndarray]:
    """The values of all parameters of a sweep, fixed or not, by name."""
    along = {str(name): np.atleast_1d(data.values) for name, data in ds.coords.items() if is_numeric(data)}
    return {name: np.array([value]) for name, value in parameters_of(ds).items()} | along


def _near(values: np.ndarray, value: float) -> np.ndarray:
    return np.abs(values - value) <= _SAME * np.abs(value)
