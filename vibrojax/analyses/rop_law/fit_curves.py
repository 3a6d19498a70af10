"""Fitted data together with the fitted curves: one panel per group of lanes, one colour per form of the law."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D

from vibrojax.plot.axes import scale, with_unit
from vibrojax.plot.colours import form_colour
from vibrojax.plot.contents import FORM
from vibrojax.plot.sheet import Facets, facets
from vibrojax.plot.style import FAINT, INK, Mark

_MOST_GROUPS, _MOST_COLUMNS = 6, 3
_ROW_HEIGHT = 2.4  # height of a row of panels [inch]
_MANY_LANES = 60  # number of drawn lanes in a group from which on the markers are small
_CURVE_POINTS = 200
# The power law often coincides with the straight line: dashed, it leaves the line's colour visible.
_DASHES = {"power": (0.0, (2.5, 2.0))}
_RELIEF, _RATE, _USE = "data_relief", "data_rate_of_penetration", "data_use"

Values = Float[np.ndarray, "*values"]

# The forms of vibrojax/analyses/rop_law/forms.py as functions of eta and the coefficients C, eta0 and exponent.
FORMULAS: dict[str, Callable[[Values, float, float, float], Values]] = {
    "literal": lambda eta, C, eta0, exponent: C * np.log(eta),
    "percent": lambda eta, C, eta0, exponent: C * np.log(100.0 * eta),
    "onset": lambda eta, C, eta0, exponent: C * np.log(eta / eta0),
    "line": lambda eta, C, eta0, exponent: C * (eta - eta0),
    "power": lambda eta, C, eta0, exponent: C * eta**exponent,
}

_USES = {
    "fitted": ("data", Mark(marker="o", color=INK, markeredgewidth=0.0)),
    "censored": (
        "no penetration (censored)",
        Mark(marker="o", color=INK, markerfacecolor="white", markeredgewidth=0.9),
    ),
    "left-out": ("left out of the fit", Mark(marker="x", color=FAINT, markeredgewidth=1.2)),
}


def groups_to_show(fit: xr.Dataset) -> Facets:
    """Return one facet per group, of at most six groups; no facets if the fit does not contain its data."""
    has_data = {_RELIEF, _RATE, _USE} <= set(fit.data_vars)
    return facets(fit, (), _MOST_GROUPS) if has_data else Facets((), ())


def height_of(groups: Facets) -> float:
    """Return the total height of the groups' panels [inch]."""
    return _ROW_HEIGHT * -(-len(groups) // _MOST_COLUMNS)


def draw_fits(figure: Figure, place: SubplotSpec | None, groups: Facets) -> None:
    """Draw a panel per group into `place`: the data and the fitted curve of each form. Draw nothing without a place."""
    if place is None:
        return
    wide = min(len(groups), _MOST_COLUMNS)
    grid = place.subgridspec(-(-len(groups) // wide), wide)
    for k, (title, group) in enumerate(zip(groups.titles, groups.data, strict=True)):
        axes = figure.add_subplot(grid[divmod(k, wide)])
        factor, unit = scale(group[_RATE])
        _draw_group(axes, group, factor)
        axes.set_title(title, loc="left")
        axes.set_xlabel("relief P/D" if k + wide >= len(groups) else "")
        axes.set_ylabel(with_unit("rate of penetration", unit) if k % wide == 0 else "")


def data_handles(groups: Facets) -> list[Artist]:
    """Return legend entries for the occurring uses of lanes: fitted, censored, left out."""
    shown = {use for group in groups.data for use in _masks(group)}
    look = Mark(linestyle="none", markersize=4.5)
    return [Line2D([], [], label=text, **look | mark) for use, (text, mark) in _USES.items() if use in shown]


def data_text(groups: Facets, fit: xr.Dataset) -> str:
    """Return the note on how many groups are drawn, or an empty string if none or all of them are."""
    count = fit["C"].size // fit.sizes[FORM]
    return f"Data and curves of {len(groups)} of {count} groups" if 0 < len(groups) < count else ""


def _draw_group(axes: Axes, group: xr.Dataset, factor: float) -> None:
    relief, rate = group[_RELIEF].values, factor * group[_RATE].values
    seen = np.isfinite(relief) & np.isfinite(rate) & (relief > 0)
    axes.grid(True)
    if not seen.any():
        return
    eta = np.linspace(relief[seen].min(), relief[seen].max(), _CURVE_POINTS)
    for name in (str(name) for name in group[FORM].values):
        form = group.sel({FORM: name})
        coefficients = [float(form[x]) if x in form else np.nan for x in ("C", "eta0", "exponent")]
        if name in FORMULAS and np.isfinite(coefficients[0]):
            line = Mark(color=form_colour(name), linewidth=1.4, linestyle=_DASHES.get(name, "-"))
            axes.plot(eta, factor * FORMULAS[name](eta, *coefficients), label=name, **line)
    size = 4.2 if seen.sum() < _MANY_LANES else 2.2
    for use, mask in _masks(group).items():
        look = Mark(linestyle="none", markersize=size, zorder=3) | _USES[use][1]
        axes.plot(relief[mask], rate[mask], label=f"_{use}", **look)
    top = float(np.max(rate[seen])) or 1.0
    axes.set_ylim(-0.06 * top, 1.1 * top)  # clips the curve of a form far from the data


def _masks(group: xr.Dataset) -> dict[str, np.ndarray]:
    """Return a mask of the drawable lanes (finite relief and rate) for each use that occurs."""
    meanings = str(group[_USE].attrs["flag_meanings"]).split()
    known = np.isfinite(group[_RELIEF].values) & np.isfinite(group[_RATE].values)
    masks = {name: known & (group[_USE].values == meanings.index(name)) for name in _USES}
    return {name: mask for name, mask in masks.items() if mask.any()}
