"""Borders, curves and families of orbits drawn over a sweep, and input checks for all overlays."""

from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from vibrojax.errors import InputError
from vibrojax.io.attributes import flags, parameters_of
from vibrojax.io.kinds import kind_of
from vibrojax.pictures.axes import edges, number, scale, short, values_along
from vibrojax.pictures.branch_data import FAMILY, along_name, branches, kind_names, numbers_of
from vibrojax.pictures.branches import (
    MARKS,
    Curve,
    distinguishing_coords,
    draw_families,
    ranges_text,
    special_handles,
    stability_handles,
)
from vibrojax.pictures.contents import IMPACTS_OF_RETURNS, START, is_numeric
from vibrojax.pictures.style import DASHED, FAINT, INK, Mark

OF_RETURNS = "impact_velocity"
"""Variable of a family that is drawn over a sweep's section crossings."""

SAME_DIGITS = 1e-4
"""Relative difference up to which two values count as equal: about as many digits as a picture prints."""

ON_MAPS = ("borders", "curves")
"""Kinds of datasets that are drawn over a map of regimes."""

Overlays = xr.Dataset | Sequence[xr.Dataset] | None


def as_layers(over: Overlays) -> tuple[xr.Dataset, ...]:
    """Return the overlay datasets as a tuple, which is empty for None."""
    if over is None:
        return ()
    return (over,) if isinstance(over, xr.Dataset) else tuple(over)


def refuse_overlays(layers: Sequence[xr.Dataset], reason: str) -> NoReturn:
    """Raise `InputError`: say which pictures accept the layers, and the `reason` why this picture does not."""
    if any(isinstance(layer, xr.Dataset) and kind_of(layer) in ON_MAPS for layer in layers):
        places = "borders and curves are laid over the map of regimes of a sweep over a grid of two parameters"
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
    ends = edges(np.sort(values_along(facet[x])))
    for over in layers:
        if name not in over:
            continue
        fixed, coords = parameters_of(over), _numeric_coords(over)
        numbers = over[FAMILY].values if FAMILY in over.dims else np.unique(numbers_of(over, "point"))
        fitting = []
        for position, family in enumerate(numbers.tolist()):
            parameters = fixed | {coord: float(over[coord].values[position]) for coord in coords}
            known = {key: value for key, value in parameters.items() if key != x and key in values}
            if all(_is_near(values[key], value).any() for key, value in known.items()):
                fitting.append(family)
        curves = [Curve(branch, INK) for branch in branches(over) if branch.family in fitting]
        draw_families(axes, over, curves, name, thin=True, factor=factor, within=(float(ends[0]), float(ends[-1])))


def over_handles(layers: Sequence[xr.Dataset]) -> list[Artist]:
    """Return the legend entries for families, without duplicates."""
    handles: dict[str, Artist] = {}
    for over in layers:
        curves = [Curve(branch, INK) for branch in branches(over)]
        entries = [*stability_handles(over, curves, " orbit"), *special_handles(over, count=False)]
        handles |= {str(handle.get_label()): handle for handle in entries}
    return [*(handles[name] for name in handles if name not in MARKS), *(handles[k] for k in MARKS if k in handles)]


def special_points(over: xr.Dataset) -> list[tuple[str, float]]:
    """Return kind and parameter value of each special point of families, except points of kind "end"."""
    points = zip(kind_names(over), over["special_value"].values.tolist(), strict=True)
    return [point for point in points if point[0] != "end"]


def over_text(ds: xr.Dataset, layers: Sequence[xr.Dataset], shown: str) -> str:
    """Return the note on the family lines over the section crossings `shown` in `ds`, or "" without layers."""
    if not layers:
        return ""
    if shown != IMPACTS_OF_RETURNS:
        longer = any(int(over["cycles"].max()) > 1 for over in layers)
        return "Lines: orbits that were followed" + ", each at one of its returns" * longer
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


ANY = "any"

# Distinguishable in greyscale and for colour-blind readers. Special points of families have the same or similar
# colours.
LINES: dict[str, dict[str, Any]] = {
    "fold": {"color": "#222222", "linestyle": "-"},
    "period-doubling": {"color": "#D55E00", "linestyle": "-"},
    "torus": {"color": "#B5468B", "linestyle": (0.0, (7.0, 1.5))},
    "grazing": {"color": "#009E73", "linestyle": (0.0, (5.0, 1.2, 1.2, 1.2))},
    "stick": {"color": "#E69F00", "linestyle": "-"},
    "section": {"color": "#0072B2", "linestyle": (0.0, (1.2, 1.2))},
    "hopf": {"color": "#882255", "linestyle": (0.0, (9.0, 1.5, 1.2, 1.5))},
    "end": {"color": INK, "linestyle": ":"},
    "basin": {"color": "#6E6E6E", "linestyle": DASHED},
    "not-settled": {"color": FAINT, "linestyle": (0.0, (1.2, 1.6))},
}
_OTHER_LINE = {"color": INK, "linestyle": "-"}


def over_map_text(over: xr.Dataset, drawn: bool) -> str:
    """Return the note on the borders or curves over a map; `drawn`: whether any lies in the map."""
    if kind_of(over) == "curves":
        return "Lines: special points of orbits, stable or not" if drawn else "No curve is of the map's parameters"
    if drawn:
        return "Lines: where stable single impacts end, whichever start leads to them"
    return "No border of stable single impacts lies in these maps"


def axes_of(ds: xr.Dataset) -> tuple[str, str]:
    """Return the parameters on the horizontal and on the vertical axis."""
    first, second = (str(name) for name in np.atleast_1d(ds.attrs["axes"]))
    return first, second


def beyond(ds: xr.Dataset) -> list[str]:
    """Return the further parameters: constant within a plane of the two axes, different between planes."""
    names = (str(name) for name, data in ds.coords.items() if data.dims == ("curve",))
    return [name for name in names if name not in (START, "curve")]


def draw_borders(axes: Axes, ds: xr.Dataset, plane: dict[str, float], start: str, x: str, y: str) -> list[str]:
    """Draw the borders of one plane (parameter values) and one initial condition; return their kinds."""
    mask = ds[START].values == start if START in ds.coords else np.ones(ds.sizes["curve"], bool)
    for name, value in plane.items():
        mask &= np.isclose(ds[name].values, value, rtol=SAME_DIGITS, atol=0.0)
    return draw_curves(axes, ds, mask, x, y)


def draw_curves(axes: Axes, ds: xr.Dataset, mask: np.ndarray, x: str, y: str) -> list[str]:
    """Draw the borders, or curves of special points, in the mask over two parameters; return their kinds."""
    number = ds["point_curve" if "point_curve" in ds else "curve"].values
    names, factors = flags(ds["kind"]), [scale(ds[name])[0] for name in (x, y)]
    stroke = [withStroke(linewidth=2.8, foreground="white", alpha=0.85)]
    kinds = []
    for curve in np.flatnonzero(mask & np.isin(np.arange(len(mask)), number)):
        kinds.append(names[int(ds["kind"][curve])])
        path = (factor * ds[name].values[number == curve] for name, factor in zip((x, y), factors, strict=True))
        axes.plot(*path, linewidth=1.6, path_effects=stroke, **LINES.get(kinds[-1], _OTHER_LINE))
    return kinds


def border_handles(kinds: Iterable[str]) -> list[Artist]:
    """Return the legend entries for kinds of borders."""
    occurring = set(kinds)
    return [
        Line2D([], [], label=kind, linewidth=1.8, **LINES.get(kind, _OTHER_LINE))
        for kind in (*LINES, *sorted(occurring - set(LINES)))
        if kind in occurring
    ]


def check_borders(ds: xr.Dataset, over: xr.Dataset, x: str, y: str) -> None:
    """Raise `InputError` unless the borders or curves `over` have the map's axes, and scene and friction of `ds`."""
    name = "curves" if kind_of(over) == "curves" else "borders"
    if set(axes_of(over)) != {x, y}:
        raise InputError(f"over: the {name} are over {' and '.join(axes_of(over))}, the map over {x} and {y}")
    check_machine(ds, over, name, "map", "find those of")


def draw_over_panel(axes: Axes, over: xr.Dataset, facet: xr.Dataset, x: str, y: str) -> list[str]:
    """Draw the borders that hold for any initial condition, or curves, over a map panel; return the kinds drawn."""
    plane = {name: float(facet[name]) for name in beyond(over) if name in facet.coords and facet[name].ndim == 0}
    if kind_of(over) != "curves":
        return draw_borders(axes, over, plane, ANY, x, y)
    return draw_curves(axes, over, curves_on_map(over, facet, x, y), x, y)


def curves_on_map(over: xr.Dataset, lanes: xr.Dataset, x: str, y: str) -> np.ndarray:
    """Return a mask of the curves `over` with the parameters of some `lanes`, except for the axes x and y."""
    mask = np.ones(over.sizes["curve"], bool)
    for name, values in _parameter_values(lanes).items():
        if name in beyond(over):
            mask &= np.array([_is_near(values, value).any() for value in over[name].values])
        elif name in parameters_of(over) and name not in (x, y):
            mask &= bool(_is_near(values, parameters_of(over)[name]).any())
    return mask


_CODIM2 = "osD^v<>phP*X"  # one marker per name of points of codimension two, in the order of their first occurrence


def draw_codim2(axes: Axes, layers: Sequence[xr.Dataset], x: str, y: str) -> list[Artist]:
    """Mark the points of codimension two of curves; return the legend entries."""
    if not layers:
        return []
    kinds = np.concatenate([ds["codim2_kind"].values.astype(str) for ds in layers])
    values = [np.concatenate([scale(ds[name])[0] * ds[f"codim2_{name}"].values for ds in layers]) for name in (x, y)]
    handles: list[Artist] = []
    for k, kind in enumerate(dict.fromkeys(kinds.tolist())):
        places = [value[kinds == kind] for value in values]
        mark = Mark(marker=_CODIM2[k % len(_CODIM2)], markersize=5.0, markerfacecolor="white", linestyle="none")
        handles += axes.plot(places[0], places[1], color=INK, label=short(kind), zorder=4, **mark)
    return handles
