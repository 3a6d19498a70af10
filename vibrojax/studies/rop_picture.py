"""Pictures of the fitted law over one axis: data and curves, C with error bars, and the comparison of the forms."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log
from vibrojax.pictures.axes import margins, scale, with_unit
from vibrojax.pictures.colours import form_colour
from vibrojax.pictures.contents import FORM, POINT, law_in
from vibrojax.pictures.curves import MOST_ROWS, Across, longest_axis, rows_of
from vibrojax.pictures.plots import (
    FAINT,
    Area,
    Axis,
    Dash,
    Layer,
    Line,
    Look,
    Plot,
    Sheet,
    Text,
    bars,
    dots,
    key,
    level,
    patch,
)
from vibrojax.pictures.sheet import Facets, at, facets
from vibrojax.studies.rop_blocks import Standing
from vibrojax.studies.rop_dataset import formulas_of
from vibrojax.studies.rop_forms import FORMS, SAME_AS_ONSET

EQUAL_AIC = 2.0
"""Difference of AIC up to which a form counts as equal to the best form."""

_READINGS = ("onset", "literal", "percent")  # of the logarithmic law: their C are comparable, since all are speeds
_MARKS = {
    "onset": "o",
    "literal": "s",
    "percent": "^",
    "line": "D",
    "power": "v",
    "constant": "P",
}
# If a difference of AIC exceeds the first value, the scale is logarithmic above the second.
_LOG_AIC_FROM, _LINEAR_AIC = 30.0, 10.0
_TICKS = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_DODGE = 0.012  # offset between error bars at the same abscissa, as a fraction of the axis
_MOST_GROUPS, _MOST_COLUMNS = 6, 3
_ROW_HEIGHT = 2.4  # height of a row of panels [inch]
_MANY_LANES = 60  # number of drawn lanes in a group from which on the markers are small
_CLOUD = 300  # number of drawn lanes in a group from which on they are a faint cloud below the curves
_CURVE_POINTS = 200
_CHOSEN_SIZE = 7.0  # of the marker of the chosen form
# The power law often coincides with the straight line, the literal form with the onset form: dashed and on top, they
# leave the colour of the other form visible.
_DASHES: dict[str, Dash] = {"power": (0.0, (2.5, 2.0)), "literal": (0.0, (1.5, 2.5))}
_RELIEF, _RATE, _USE = "data_relief", "data_rate_of_penetration", "data_use"
_RATES = {form.name: form.rate for form in FORMS}

_USES: dict[str, tuple[str, Look]] = {
    "fitted": ("data", {"edge_width": 0.0}),
    "censored": ("no penetration (censored)", {"face": "white", "edge_width": 0.9}),
    "left-out": ("left out of the fit", {"marker": "x", "colour": FAINT, "edge_width": 1.2}),
}


def law_lines(fit: xr.Dataset) -> Sheet:
    """Draw C and a comparison of the forms over the longest axis of the groups, below the data and their curves.

    C is that of each reading of the law, and the comparison is by AIC. For a log whose forms were compared over blocks
    of rows, C is that of the forms that the data do not reject, and the comparison is the error of predicted rates.
    """
    fit = _with_short_titles(law_in(fit))
    if "reference_force" in fit.attrs:  # the threshold is unknown: some forms are the same curve as another one
        fit = fit.sel({FORM: [name for name in form_names(fit) if name not in SAME_AS_ONSET]})
    x = longest_axis(fit)
    fit = fit.sortby(x.name) if x.is_number else fit
    by_blocks, with_c, groups = _by_blocks(fit), readings(fit), groups_to_show(fit)
    if by_blocks:  # the C of a form that the data reject means nothing
        kept = fit["standing"] != Standing.REJECTED
        fit = fit.assign(C=fit["C"].where(kept))
        with_c = [name for name in form_names(fit) if bool((kept & fit["C"].notnull()).sel({FORM: name}).any())]
    panels = facets(fit, (POINT, x.name), MOST_ROWS)
    (factor, unit), names = scale(fit["C"]), form_names(fit)
    across = [x.axis(fit, group=f"across{column}") for column in (0, 1)]
    if not x.name:
        across = [
            replace(axis, ticks=[*zip(map(float, range(len(of))), of, strict=True)], limits=(-0.5, len(of) - 0.5))
            for axis, of in zip(across, (with_c, names), strict=True)
        ]
    values = fit["C"].sel({FORM: with_c}).values * factor
    up = Axis(with_unit("C", unit), "C", ticks=[], group="C")
    if np.isfinite(values).any():  # the limits ignore error bars, which are huge for a failed fit
        low, high = min(float(np.nanmin(values)), 0.0), max(float(np.nanmax(values)), 0.0)
        room = 0.15 * ((high - low) or 1.0)
        up = replace(up, ticks=None, limits=(low - room * (low < 0), high + room))
    compared = Axis(with_unit("error of predicted rates", unit), "cv_error", (0.0, None), group="error")
    if not by_blocks:
        compared = _excess_axis(panels)
    plots = []
    for row, (title, facet) in enumerate(zip(panels.titles, panels.data, strict=True)):
        layers = _coefficient_layers(facet, x, factor, with_c)
        layers += [] if up.ticks is None else [Text(0.5, 0.6, "no group has a C", relative=True)]
        other = _error_layers(facet, x, factor) if by_blocks else _excess_layers(facet, x, compared)
        plots.append(Plot(layers, across[0], up, title, (row, 0), at(facet)))
        plots.append(Plot(other, across[1], compared, "", (row, 1), at(facet)))
    equal: list[Layer] = [patch(FAINT, "as good as the best", alpha=0.25, edge="")]
    if by_blocks:
        equal = [
            dots(label="chosen form", size=_CHOSEN_SIZE),
            dots(label="may be the truth too", face="white"),
        ]
    over = "over the rows of the table" if fit.attrs.get("along") == POINT else f"along {fit.attrs.get('along')}"
    along = f"Fitted {over}; bars of one standard error, bands of that of C" if "along" in fit.attrs else ""
    limits = LIMITS_OF_LOGS if is_log(fit) else ""
    lacking = "" if by_blocks else _groups_without_c(fit)
    about = margins(fit, panels.note, data_text(groups, fit), along, lacking, limits)
    above, rows = fits_above(groups), rows_of(panels, 2)
    if above is not None:
        width, height = rows["size"]
        rows["size"] = width, height + above.size[1]
    return Sheet(plots, keys=[form_keys(fit), equal, use_keys(groups)], above=above, **rows, **about)


def residuals(fit: xr.Dataset) -> Sheet:
    """Draw the residuals of every form over the relief, with a panel for each group; no panels without the data."""
    groups, plots = groups_to_show(law_in(fit)), []
    for k, (title, group) in enumerate(zip(groups.titles, groups.data, strict=True)):
        factor, unit = scale(group[_RATE])
        relief, rate = (group[name].values[_use_masks(group).get("fitted", slice(0))] for name in (_RELIEF, _RATE))
        layers: list[Layer] = [level(0.0, colour=FAINT, width=0.8)]
        for name in (name for name in form_names(group) if name in _RATES):
            left = factor * (rate - _RATES[name](relief, *_coefficients(group.sel({FORM: name}))))
            layers.append(Line(relief, left, label=name, **form_mark(name) | {"dash": "", "size": 3.5}))
        up = Axis(with_unit("measured less the form", unit), group="residuals")
        words = f"residuals{f', {title}' if title else ''}"
        plots.append(Plot(layers, Axis("relief P/D"), up, words, (0, k), at(group)))
    return Sheet(plots, (8.0, 2.6), (1.0,) * max(len(plots), 1))


def _with_short_titles(fit: xr.Dataset) -> xr.Dataset:
    """Return the fit with the depths of segments as their names, and without those of other groups."""
    if "depth_from" not in fit.coords:
        return fit
    fit, ends = fit.drop_vars(["depth_from", "depth_to"]), (fit["depth_from"].values, fit["depth_to"].values)
    if "segment" in fit.coords:
        names = [f"{low:.0f} to {high:.0f} m" for low, high in zip(*ends, strict=True)]
        fit = fit.drop_vars("segment").assign_coords(depth=("group", names))
    return fit


def _by_blocks(fit: xr.Dataset) -> bool:
    """Return whether the forms were compared over blocks of rows."""
    return "cv_error" in fit and bool(fit["cv_error"].notnull().any())


def _groups_without_c(fit: xr.Dataset) -> str:
    """Return the note on groups without a C: their number per reading if the numbers differ."""
    lacking = {name: int(np.isnan(fit["C"].sel({FORM: name}).values).sum()) for name in readings(fit)}
    counts = [f"{name}: {count}" for name, count in lacking.items() if count]
    if len(set(lacking.values())) == 1:
        counts = [str(count) for count in lacking.values() if count][:1]
    return f"Groups without a C, of {fit['C'].size // fit.sizes[FORM]}: {', '.join(counts)}" if counts else ""


def _places(form: xr.Dataset, x: Across, k: int) -> np.ndarray:
    """Return the abscissae of the values of a form, the k-th of its panel."""
    return x.of(form) if x.name else np.array([float(k)])


def _coefficient_layers(facet: xr.Dataset, x: Across, factor: float, names: Sequence[str]) -> list[Layer]:
    """Return C of the named forms with error bars; forms are slightly offset along the abscissa."""
    layers: list[Layer] = [level(0.0, colour=FAINT, width=0.8)]
    for k, name in enumerate(names):
        form = facet.sel({FORM: name})
        values = np.atleast_1d(form["C"].values) * factor
        errors = np.nan_to_num(np.atleast_1d(form["C_stderr"].values) * factor, posinf=0.0)
        places = _places(form, x, k)
        if x.name:
            places = places + _DODGE * (float(np.ptp(places)) if x.is_number else 4.0) * k
        ends = bars(places, values - errors, values + errors)
        layers.append(Line(*ends, form_colour(name), 0.9, marker="_"))
        layers.append(Line(places, values, **form_mark(name, x)))
    return layers


def _error_layers(facet: xr.Dataset, x: Across, factor: float) -> list[Layer]:
    """Return the error of rates predicted from other blocks: the chosen form large, undecided ones hollow."""
    layers: list[Layer] = []
    for k, name in enumerate(form_names(facet)):
        form = facet.sel({FORM: name})
        errors, standing = (np.atleast_1d(form[variable].values) for variable in ("cv_error", "standing"))
        places = _places(form, x, k)
        layers.append(Line(places, factor * errors, **form_mark(name, x)))
        rings = np.isin(standing, (Standing.UNDECIDED, Standing.CONTAINS_CHOSEN))
        for mask, look in ((rings, {"face": "white"}), (standing == Standing.CHOSEN, {"size": _CHOSEN_SIZE})):
            layers.append(Line(places[mask], factor * errors[mask], **form_mark(name, x) | {"dash": ""} | look))
    return layers


def _excess_axis(panels: Facets) -> Axis:
    """Return the axis of differences of AIC from zero upwards; large ones are logarithmic above a bound."""
    greatest = max(float(np.nanmax(above_best(facet).values, initial=0.0)) for facet in panels.data)
    axis = Axis("AIC above the best form", "aic", (-0.5, max(1.1 * greatest, 2.0 * EQUAL_AIC)), group="aic")
    if greatest <= _LOG_AIC_FROM:
        return axis
    ticks = [(float(_compressed(tick)), str(tick)) for tick in _TICKS if tick <= 1.6 * greatest]
    return replace(axis, limits=(-0.1, float(_compressed(1.6 * greatest))), ticks=ticks)


def _compressed(values: Any) -> Any:
    """Return differences of AIC as they are drawn on a logarithmic axis: linear up to a bound, which is 1."""
    return np.where(values <= _LINEAR_AIC, values / _LINEAR_AIC, 1 + np.log10(np.maximum(values, 1e-9) / _LINEAR_AIC))


def _excess_layers(facet: xr.Dataset, x: Across, axis: Axis) -> list[Layer]:
    """Return the AIC of every form relative to the best form of each group."""
    drawn = _compressed if axis.ticks else np.asarray
    equal = float(drawn(EQUAL_AIC))
    layers: list[Layer] = [Area([-np.inf, np.inf], [0.0] * 2, [equal] * 2, FAINT, 0.25)]
    for k, name in enumerate(form_names(facet)):
        excess = drawn(np.atleast_1d(above_best(facet).sel({FORM: name}).values))
        layers.append(Line(_places(facet, x, k), excess, **form_mark(name, x)))
    return layers


def form_names(fit: xr.Dataset) -> list[str]:
    """Return the names of the forms in a fit."""
    return [str(name) for name in fit[FORM].values]


def readings(fit: xr.Dataset) -> list[str]:
    """Return the forms that are readings of the logarithmic law, or all forms if none is."""
    return [name for name in _READINGS if name in form_names(fit)] or form_names(fit)


def form_mark(name: str, x: Across | None = None) -> Look:
    """Return the marker and line style of a form; if `x` has string labels, points are not joined by lines."""
    mark: Look = {"colour": form_colour(name), "marker": _MARKS.get(name, "P")}
    return mark if x is None or x.is_number else mark | {"dash": ""}


def form_keys(fit: xr.Dataset) -> list[Layer]:
    """Return the legend entries of the forms, with their formulas."""
    formulas = formulas_of(fit)
    signs = {"eta0": "η₀", "eta": "η", " - ": " − ", "^exponent": "ⁿ"}
    keys: list[Layer] = []
    for name in form_names(fit):
        formula = formulas.get(name, "")
        for text, sign in signs.items():
            formula = formula.replace(text, sign)
        keys.append(
            key(f"{name}\n{formula}" if formula else name, **form_mark(name) | {"dash": _DASHES.get(name, "-")})
        )
    return keys


def above_best(fit: xr.Dataset) -> xr.DataArray:
    """Return the difference between each form's AIC and the lowest AIC in the group; NaN for a form without AIC."""
    aic = fit["aic"].where(np.isfinite(fit["aic"]))
    return aic - aic.min(FORM)


def _coefficients(form: xr.Dataset) -> list[float]:
    """Return C, eta0 and the exponent of a form in one group; NaN for those that it does not have."""
    return [float(form[name]) if name in form else np.nan for name in ("C", "eta0", "exponent")]


def groups_to_show(fit: xr.Dataset) -> Facets:
    """Return one facet per group, of at most six groups; no facets if the fit does not contain its data."""
    return facets(fit, (), _MOST_GROUPS) if {_RELIEF, _RATE, _USE} <= set(fit.data_vars) else Facets((), ())


def fits_above(groups: Facets, keys: Sequence[Sequence[Layer]] = ()) -> Sheet | None:
    """Return a panel per group, with the data and the fitted curve of each form; None without groups."""
    if not len(groups):
        return None
    wide = min(len(groups), _MOST_COLUMNS)
    deep = -(-len(groups) // wide)
    plots = []
    for k, (title, group) in enumerate(zip(groups.titles, groups.data, strict=True)):
        factor, unit = scale(group[_RATE])
        relief = "force over its median" if "reference_force" in group.attrs else "relief P/D"
        across = Axis(relief if k + wide >= len(groups) else "")
        layers, limits = _group_layers(group, factor)
        label = with_unit("rate of penetration", unit) if k % wide == 0 else ""
        up = Axis(label, limits=limits, zero="no penetration")
        plots.append(Plot(layers, across, up, title, divmod(k, wide), at(group)))
    return Sheet(plots, (6.4, _ROW_HEIGHT * deep), (1.0,) * wide, (1.0,) * deep, keys)


def use_keys(groups: Facets) -> list[Layer]:
    """Return the legend entries of the uses of lanes that occur: fitted, censored, left out."""
    shown = {use for group in groups.data for use in _use_masks(group)}
    return [dots(label=text, **{"size": 4.5} | mark) for use, (text, mark) in _USES.items() if use in shown]


def data_text(groups: Facets, fit: xr.Dataset) -> str:
    """Return the note on how many groups are drawn, or an empty string if none or all of them are."""
    count = fit["C"].size // fit.sizes[FORM]
    return f"Data and curves of {len(groups)} of {count} groups" if 0 < len(groups) < count else ""


def _group_layers(group: xr.Dataset, factor: float) -> tuple[list[Layer], tuple[float | None, float | None]]:
    """Return data and curves of one group, and the limits of the rate."""
    relief, rate = group[_RELIEF].values, factor * group[_RATE].values
    seen = np.isfinite(relief) & np.isfinite(rate) & (relief > 0)
    layers: list[Layer] = []
    if not seen.any():
        return layers, (None, None)
    eta = np.linspace(relief[seen].min(), relief[seen].max(), _CURVE_POINTS)
    top = float(np.max(rate[seen]))
    for name in form_names(group):
        form = group.sel({FORM: name})
        coefficients = _coefficients(form)
        if name in _RATES and np.isfinite(coefficients[0]) and top > 0:
            colour, dash = form_colour(name), _DASHES.get(name, "-")
            curve = factor * _RATES[name](eta, *coefficients)
            layers.append(Line(eta, curve, colour, 1.4, dash, order=2.5 if name in _DASHES else 2.0))
            error = float(form["C_stderr"]) / coefficients[0] if coefficients[0] else np.nan
            is_rejected = _by_blocks(group) and int(form["standing"]) == Standing.REJECTED
            if np.isfinite(error) and not is_rejected:  # every form is proportional to its C
                layers.append(Area(eta, curve * (1 - error), curve * (1 + error), colour, 0.15))
    is_cloud = seen.sum() >= _CLOUD
    size = 4.2 if seen.sum() < _MANY_LANES else 1.6 if is_cloud else 2.2
    for use, mask in _use_masks(group).items():
        look: Look = {"size": size, "order": 1.5 if is_cloud else 3.0} | _USES[use][1]
        look |= {"colour": FAINT} if is_cloud and use == "fitted" else {}
        layers.append(dots(relief[mask], rate[mask], **look))
    # The limits clip the curve of a form far from the data.
    return layers, (-0.06 * top, 1.1 * top) if top > 0 else (None, None)


def _use_masks(group: xr.Dataset) -> dict[str, np.ndarray]:
    """Return a mask of the drawable lanes (finite relief and rate) for each use that occurs."""
    meanings = str(group[_USE].attrs["flag_meanings"]).split()
    known = np.isfinite(group[_RELIEF].values) & np.isfinite(group[_RATE].values)
    masks = {name: known & (group[_USE].values == meanings.index(name)) for name in _USES}
    return {name: mask for name, mask in masks.items() if mask.any()}
