"""Borders, curves and families of orbits drawn over a sweep, and input checks for all overlays."""

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.io.attributes import flags, parameters_of
from vibrojax.io.kinds import kind_of
from vibrojax.pictures import branches
from vibrojax.pictures.axes import edges, number, scale, short, values_along
from vibrojax.pictures.branches import FAMILY, MARKS
from vibrojax.pictures.contents import IMPACTS_OF_RETURNS, START, is_numeric
from vibrojax.pictures.plots import FAINT, Dash, Layer, Line, Look, dots
from vibrojax.pictures.style import DASHED

SAME_DIGITS = 1e-4  # relative difference of equal values: about as many digits as a picture prints

ON_MAPS = ("borders", "curves")
"""Kinds of datasets that are drawn over a map of regimes."""

ANY = "any"

# Distinguishable in greyscale and for colour-blind readers, in the colours of the special points of families.
_DASHES: dict[str, Dash] = {
    "fold": "-",
    "period-doubling": "-",
    "torus": (0.0, (7.0, 1.5)),
    "branch-point": "-.",
    "grazing": (0.0, (5.0, 1.2, 1.2, 1.2)),
    "stick": "-",
    "section": (0.0, (1.2, 1.2)),
    "hopf": (0.0, (9.0, 1.5, 1.2, 1.5)),
    "end": ":",
}
LINES: dict[str, Look] = {kind: {"colour": MARKS[kind]["colour"], "dash": dash} for kind, dash in _DASHES.items()}
LINES |= {"basin": {"colour": "#6E6E6E", "dash": DASHED}, "not-settled": {"colour": FAINT, "dash": (0.0, (1.2, 1.6))}}
_CODIM2 = "osD^v<>phP*X"  # one marker per name of points of codimension two, in the order of their first occurrence

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


def _check_machine(ds: xr.Dataset, over: xr.Dataset, layer: str, below: str, advice: str) -> None:
    """Raise `InputError` unless the overlay `over` has the scene and the friction law of `ds`."""
    for name in ("scene", "friction"):
        if ds.attrs.get(name) != over.attrs.get(name):
            values = over.attrs.get(name), ds.attrs.get(name)
            raise InputError(
                f"over: the {layer} are of {name} {values[0]}, the {below} of {values[1]}; {advice} {values[1]}"
            )


def _parameter_values(ds: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the values of all parameters of a dataset, fixed and varied, by name."""
    along = {str(name): np.atleast_1d(data.values) for name, data in ds.coords.items() if is_numeric(data)}
    return {name: np.array([value]) for name, value in parameters_of(ds).items()} | along


def _occurring(over: xr.Dataset, lanes: xr.Dataset, size: int, axes: Sequence[str]) -> np.ndarray:
    """Return a mask of the `size` curves or families of `over` whose parameters, except `axes`, some `lanes` have."""
    mask, known = np.ones(size, bool), _parameter_values(lanes)
    for name, values in _parameter_values(over).items():
        if name in known and name not in axes and len(values) in (1, size):
            mask &= np.isclose(values[:, None], known[name], rtol=SAME_DIGITS, atol=0.0).any(axis=1)
    return mask


# Families over section crossings.


def check_families(ds: xr.Dataset, layers: Sequence[xr.Dataset], x: str) -> None:
    """Raise `InputError` unless all `layers` are families along the axis `x` with the scene and parameters of `ds`."""
    for over in layers:
        if not isinstance(over, xr.Dataset) or kind_of(over) != "family":
            raise InputError("over: no families of orbits; give what vj.follow or vibrojax follow has made")
        along = branches.along_name(over)
        if along != x:
            raise InputError(f"over: the families are along {along}, and the returns over {x}; follow along {x}")
        _check_machine(ds, over, "families", "returns", "follow those of")
        known = _parameter_values(ds)
        for name, values in _parameter_values(over).items():
            if name in known and name != x and not np.isclose(values[:, None], known[name], rtol=SAME_DIGITS).any():
                given, expected = (", ".join(map(number, part[:5])) for part in (values, known[name]))
                advice = "follow families of the same value"
                raise InputError(f"over: the families are of {name} = {given}, the returns of {expected}; {advice}")


def variable_over(returns: str) -> str:
    """Return the variable of families that lies over the section crossings of the variable `returns`."""
    return "impact_velocity" if returns == IMPACTS_OF_RETURNS else returns.replace("return_", "orbit_", 1)


def over_layers(layers: Sequence[xr.Dataset], facet: xr.Dataset, x: str, name: str, factor: float) -> list[Layer]:
    """Return the lines of `name` of those families that have the parameters of `facet`, within its range of `x`."""
    ends = edges(np.sort(values_along(facet[x])))
    within, shown = (float(ends[0]), float(ends[-1])), []
    for over in layers:
        if name in over:
            numbers = branches.family_numbers(over)
            fitting = numbers[_occurring(over, facet, len(numbers), (x, FAMILY))]
            lines = [branch for branch in branches.branches(over) if branch.family in fitting]
            shown += branches.family_layers(over, lines, name, factor=factor, within=within)
    return shown


def over_text(ds: xr.Dataset, layers: Sequence[xr.Dataset], shown: str) -> str:
    """Return the note on the family lines over the section crossings `shown` in `ds`, or "" without layers."""
    if not layers:
        return ""
    if shown != IMPACTS_OF_RETURNS:
        longer = any(int(over["cycles"].max()) > 1 for over in layers)
        return "Lines: orbits that were followed" + ", each at one of its returns" * longer
    several = "return_impacts" in ds and bool((ds["return_impacts"].values > 1).any())
    mean = "A dot is the mean of the blows since the return before" if several else ""
    ranges = {branches.ranges_text(over, (variable_over(shown),)) for over in layers}
    return ". ".join(filter(None, ("Lines: orbits that were followed", *sorted(ranges), mean)))


# Borders and curves over maps.


def axes_of(ds: xr.Dataset) -> tuple[str, str]:
    """Return the parameters on the horizontal and on the vertical axis."""
    first, second = (str(name) for name in np.atleast_1d(ds.attrs["axes"]))
    return first, second


def beyond(ds: xr.Dataset) -> list[str]:
    """Return the further parameters: constant within a plane of the two axes, different between planes."""
    names = (str(name) for name, data in ds.coords.items() if data.dims == ("curve",))
    return [name for name in names if name not in (START, "curve")]


def check_borders(ds: xr.Dataset, over: xr.Dataset, x: str, y: str) -> None:
    """Raise `InputError` unless the borders or curves `over` have the map's axes, and scene and friction of `ds`."""
    name = "curves" if kind_of(over) == "curves" else "borders"
    if set(axes_of(over)) != {x, y}:
        raise InputError(f"over: the {name} are over {' and '.join(axes_of(over))}, the map over {x} and {y}")
    _check_machine(ds, over, name, "map", "find those of")


def over_panel(over: xr.Dataset, facet: xr.Dataset, x: str, y: str) -> list[Layer]:
    """Return the borders that hold for any initial condition, or the curves, over a map panel."""
    mask = curves_on_map(over, facet, x, y)
    if kind_of(over) != "curves" and START in over.coords:
        mask &= over[START].values == ANY
    return curve_layers(over, mask, x, y)


def curves_on_map(over: xr.Dataset, lanes: xr.Dataset, x: str, y: str) -> np.ndarray:
    """Return a mask of the curves `over` with the parameters of some `lanes`, except for the axes x and y."""
    return _occurring(over, lanes, over.sizes["curve"], (x, y, "curve"))


def border_layers(ds: xr.Dataset, plane: dict[str, float], start: str, x: str, y: str) -> list[Layer]:
    """Return the borders of one plane (parameter values) and one initial condition."""
    mask = ds[START].values == start if START in ds.coords else np.ones(ds.sizes["curve"], bool)
    for name, value in plane.items():
        mask &= np.isclose(ds[name].values, value, rtol=SAME_DIGITS, atol=0.0)
    return curve_layers(ds, mask, x, y)


def curve_layers(ds: xr.Dataset, mask: np.ndarray, x: str, y: str) -> list[Layer]:
    """Return the borders, or curves of special points, in the mask over two parameters, labelled by their kinds."""
    number = ds["point_curve" if "point_curve" in ds else "curve"].values
    names, factors = flags(ds["kind"]), [scale(ds[name])[0] for name in (x, y)]
    layers: list[Layer] = []
    for curve in np.flatnonzero(mask & np.isin(np.arange(len(mask)), number)):
        kind = names[int(ds["kind"][curve])]
        across, up = (f * ds[name].values[number == curve] for name, f in zip((x, y), factors, strict=True))
        layers.append(Line(across, up, width=1.6, halo=0.6, label=branches.kind_label(ds, kind), **LINES.get(kind, {})))
    return layers


def codim2_layers(layers: Sequence[xr.Dataset], x: str, y: str) -> list[Layer]:
    """Return marks of the points of codimension two of curves, labelled by their kinds."""
    if not layers:
        return []
    kinds = np.concatenate([ds["codim2_kind"].values.astype(str) for ds in layers])
    values = [np.concatenate([scale(ds[name])[0] * ds[f"codim2_{name}"].values for ds in layers]) for name in (x, y)]
    marks: list[Layer] = []
    for k, kind in enumerate(dict.fromkeys(kinds.tolist())):
        places = [value[kinds == kind] for value in values]
        look: Look = {"marker": _CODIM2[k % len(_CODIM2)], "size": 5.0, "face": "white", "order": 4.0}
        marks.append(dots(*places, label=short(kind), **look))
    return marks


def over_map_text(over: xr.Dataset, drawn: bool) -> str:
    """Return the note on the borders or curves over a map; `drawn`: whether any lies in the map."""
    if kind_of(over) == "curves":
        return "Lines: special points of orbits, stable or not" if drawn else "No curve is of the map's parameters"
    if drawn:
        return "Lines: where stable single impacts end, whichever start leads to them"
    return "No border of stable single impacts lies in these maps"
