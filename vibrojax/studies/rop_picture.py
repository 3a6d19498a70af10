"""Pictures of the fitted law over one axis: data and curves, C with error bars, and the comparison of the forms."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import MarkerType

from vibrojax.io.riglog import LIMITS_OF_LOGS, is_log
from vibrojax.pictures.axes import scale, shape_zero, with_unit
from vibrojax.pictures.colours import form_colour
from vibrojax.pictures.contents import FORM, POINT, law_in
from vibrojax.pictures.curves import MOST_ROWS, Across, Row, longest_axis, new_rows
from vibrojax.pictures.sheet import Facets, facets, legend_at_right, write_margins
from vibrojax.pictures.style import FAINT, INK, Mark, new_figure, styled
from vibrojax.studies.rop_blocks import Standing
from vibrojax.studies.rop_dataset import formulas_of
from vibrojax.studies.rop_forms import FORMS, SAME_AS_ONSET

EQUAL_AIC = 2.0
"""Difference of AIC up to which a form counts as equal to the best form."""

_READINGS = ("onset", "literal", "percent")  # of the logarithmic law: their C are comparable, since all are speeds
_MARKS: dict[str, MarkerType] = {
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
_DASHES = {"power": (0.0, (2.5, 2.0)), "literal": (0.0, (1.5, 2.5))}
_RELIEF, _RATE, _USE = "data_relief", "data_rate_of_penetration", "data_use"
_RATES = {form.name: form.rate for form in FORMS}

_USES = {
    "fitted": ("data", Mark(marker="o", color=INK, markeredgewidth=0.0)),
    "censored": (
        "no penetration (censored)",
        Mark(marker="o", color=INK, markerfacecolor="white", markeredgewidth=0.9),
    ),
    "left-out": ("left out of the fit", Mark(marker="x", color=FAINT, markeredgewidth=1.2)),
}


@styled
def law_lines(fit: xr.Dataset) -> Figure:
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
    figure, rows, above = new_rows(panels, 2, height_of(groups))
    uses = draw_fits(figure, above, groups)
    factor, unit = scale(fit["C"])
    for row in rows:
        _draw_coefficients(row, x, factor, with_c)
        row.label(0, x.label, with_unit("C", unit))
        if by_blocks:
            _draw_errors(row, x, factor)
            row.label(1, x.label, with_unit("error of predicted rates", unit))
        else:
            _draw_excess(row, x)
            row.label(1, x.label, "AIC above the best form")
    if by_blocks:
        rows[0].axes[1].set_ylim(bottom=0.0)
    else:
        _scale_excess(rows)
    for axes, names in zip(rows[0].axes, (with_c, form_names(fit)), strict=True):
        if x.name:
            x.shape(axes)
        else:
            axes.set_xticks(range(len(names)), names)
            axes.set_xlim(-0.5, len(names) - 0.5)
    values = fit["C"].sel({FORM: with_c}).values * factor
    if np.isfinite(values).any():  # the limits ignore error bars, which are huge for a failed fit
        low, high = min(float(np.nanmin(values)), 0.0), max(float(np.nanmax(values)), 0.0)
        room = 0.15 * ((high - low) or 1.0)
        rows[0].axes[0].set_ylim(low - room * (low < 0), high + room)
    else:
        axes = rows[0].axes[0]
        axes.set(xticks=[], yticks=[])
        axes.text(0.5, 0.6, "no group has a C", transform=axes.transAxes, ha="center", color="0.3")
    equal: list[Artist] = [Patch(facecolor=FAINT, alpha=0.25, label="as good as the best")]
    if by_blocks:
        dot = Mark(linestyle="none", marker="o", color=INK)
        equal = [
            Line2D([], [], label="chosen form", **dot | Mark(markersize=_CHOSEN_SIZE)),
            Line2D([], [], label="may be the truth too", **dot | Mark(markersize=4.0, markerfacecolor="white")),
        ]
    legend_at_right(figure, line_handles(fit), equal, uses)
    over = "over the rows of the table" if fit.attrs.get("along") == POINT else f"along {fit.attrs.get('along')}"
    along = f"Fitted {over}; bars of one standard error, bands of that of C" if "along" in fit.attrs else ""
    limits = LIMITS_OF_LOGS if is_log(fit) else ""
    lacking = "" if by_blocks else _groups_without_c(fit)
    write_margins(figure, fit, panels.note, data_text(groups, fit), along, lacking, limits)
    return figure


@styled
def residuals(fit: xr.Dataset) -> Figure:
    """Draw the residuals of every form over the relief, with a panel for each group; no panels without the data."""
    figure, groups = new_figure(8.0, 2.6), groups_to_show(law_in(fit))
    if not len(groups):
        return figure
    for axes, title, group in zip(
        figure.subplots(1, len(groups), squeeze=False)[0], groups.titles, groups.data, strict=True
    ):
        factor, unit = scale(group[_RATE])
        relief, rate = (group[name].values[_use_masks(group).get("fitted", slice(0))] for name in (_RELIEF, _RATE))
        axes.axhline(0.0, color=FAINT, linewidth=0.8)
        for name in (name for name in form_names(group) if name in _RATES):
            left = factor * (rate - _RATES[name](relief, *_coefficients(group.sel({FORM: name}))))
            axes.plot(relief, left, **form_mark(name) | Mark(linestyle="none", markersize=3.5))
        axes.set_title(f"residuals{f', {title}' if title else ''}", loc="left")
        axes.set(xlabel="relief P/D", ylabel=with_unit("measured less the form", unit))
    return figure


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


def _draw_coefficients(row: Row, x: Across, factor: float, names: Sequence[str]) -> None:
    """Draw C of the named forms with error bars; forms are slightly offset along the abscissa."""
    axes = row.axes[0]
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    for k, name in enumerate(names):
        form = row.facet.sel({FORM: name})
        values = np.atleast_1d(form["C"].values) * factor
        bars = np.nan_to_num(np.atleast_1d(form["C_stderr"].values) * factor, posinf=0.0)
        places = _places(form, x, k)
        if x.name:
            places = places + _DODGE * (float(np.ptp(places)) if x.is_number else 4.0) * k
        axes.errorbar(places, values, bars, label=name, capsize=2.5, elinewidth=0.9, **form_mark(name, x))


def _draw_errors(row: Row, x: Across, factor: float) -> None:
    """Draw the error of rates predicted from other blocks of rows: the chosen form large, undecided ones hollow."""
    for k, name in enumerate(form_names(row.facet)):
        form = row.facet.sel({FORM: name})
        errors, standing = (np.atleast_1d(form[variable].values) for variable in ("cv_error", "standing"))
        places = _places(form, x, k)
        row.axes[1].plot(places, factor * errors, label=name, **form_mark(name, x))
        rings = np.isin(standing, (Standing.UNDECIDED, Standing.CONTAINS_CHOSEN))
        looks = (rings, Mark(markerfacecolor="white")), (standing == Standing.CHOSEN, Mark(markersize=_CHOSEN_SIZE))
        for mask, look in looks:
            mark = form_mark(name, x) | Mark(linestyle="none") | look
            row.axes[1].plot(places[mask], factor * errors[mask], label=f"_{name}", **mark)


def _draw_excess(row: Row, x: Across) -> None:
    """Draw the AIC of every form relative to the best form of each group."""
    row.axes[1].axhspan(0.0, EQUAL_AIC, color=FAINT, alpha=0.25, linewidth=0)
    for k, name in enumerate(form_names(row.facet)):
        excess = np.atleast_1d(above_best(row.facet).sel({FORM: name}).values)
        row.axes[1].plot(_places(row.facet, x, k), excess, label=name, **form_mark(name, x))


def _scale_excess(rows: Sequence[Row]) -> None:
    """Scale the AIC axis from zero upwards; for large differences it is logarithmic above a bound."""
    greatest = max(float(np.nanmax(above_best(row.facet).values, initial=0.0)) for row in rows)
    axes = rows[0].axes[1]
    if greatest <= _LOG_AIC_FROM:
        axes.set_ylim(-0.5, max(1.1 * greatest, 2.0 * EQUAL_AIC))
        return
    axes.set_yscale("symlog", linthresh=_LINEAR_AIC)
    axes.set_ylim(-1.0, 1.6 * greatest)
    ticks = [tick for tick in _TICKS if tick <= 1.6 * greatest]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.set_yticks([], minor=True)


def form_names(fit: xr.Dataset) -> list[str]:
    """Return the names of the forms in a fit."""
    return [str(name) for name in fit[FORM].values]


def readings(fit: xr.Dataset) -> list[str]:
    """Return the forms that are readings of the logarithmic law, or all forms if none is."""
    return [name for name in _READINGS if name in form_names(fit)] or form_names(fit)


def form_mark(name: str, x: Across | None = None) -> Mark:
    """Return the marker and line style of a form; if `x` has string labels, points are not joined by lines."""
    mark = Mark(color=form_colour(name), marker=_MARKS.get(name, "P"), markersize=4.0, linewidth=1.2)
    return mark if x is None else mark | Mark(linestyle="-" if x.is_number else "none")


def line_handles(fit: xr.Dataset) -> list[Artist]:
    """Return the legend entries of the forms, with their formulas."""
    formulas = formulas_of(fit)
    signs = {"eta0": "η₀", "eta": "η", " - ": " − ", "^exponent": "ⁿ"}
    handles: list[Artist] = []
    for name in form_names(fit):
        formula = formulas.get(name, "")
        for text, sign in signs.items():
            formula = formula.replace(text, sign)
        mark = form_mark(name) | Mark(linestyle=_DASHES.get(name, "-"))
        handles.append(Line2D([], [], label=f"{name}\n{formula}" if formula else name, **mark))
    return handles


def above_best(fit: xr.Dataset) -> xr.DataArray:
    """Return the difference between each form's AIC and the lowest AIC in the group; NaN for a form without AIC."""
    aic = fit["aic"].where(np.isfinite(fit["aic"]))
    return aic - aic.min(FORM)


def _coefficients(form: xr.Dataset) -> list[float]:
    """Return C, eta0 and the exponent of a form in one group; NaN for those that it does not have."""
    return [float(form[name]) if name in form else np.nan for name in ("C", "eta0", "exponent")]


def height_of(groups: Facets) -> float:
    """Return the height [inch] of the panels of `draw_fits`."""
    return _ROW_HEIGHT * -(-len(groups) // _MOST_COLUMNS)


def groups_to_show(fit: xr.Dataset) -> Facets:
    """Return one facet per group, of at most six groups; no facets if the fit does not contain its data."""
    return facets(fit, (), _MOST_GROUPS) if {_RELIEF, _RATE, _USE} <= set(fit.data_vars) else Facets((), ())


def draw_fits(figure: Figure, place: SubplotSpec | None, groups: Facets) -> list[Artist]:
    """Draw a panel per group into `place`: the data and the fitted curve of each form. Return entries of the legend.

    Without a place, nothing is drawn. Each use of lanes that occurs has an entry: fitted, censored, left out.
    """
    if place is None:
        return []
    wide = min(len(groups), _MOST_COLUMNS)
    grid = place.subgridspec(-(-len(groups) // wide), wide)
    for k, (title, group) in enumerate(zip(groups.titles, groups.data, strict=True)):
        axes = figure.add_subplot(grid[divmod(k, wide)])
        factor, unit = scale(group[_RATE])
        _draw_group(axes, group, factor)
        axes.set_title(title, loc="left")
        relief = "force over its median" if "reference_force" in group.attrs else "relief P/D"
        axes.set_xlabel(relief if k + wide >= len(groups) else "")
        axes.set_ylabel(with_unit("rate of penetration", unit) if k % wide == 0 else "")
    shown = {use for group in groups.data for use in _use_masks(group)}
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
    for name in form_names(group):
        form = group.sel({FORM: name})
        coefficients = _coefficients(form)
        if name in _RATES and np.isfinite(coefficients[0]):
            line = Mark(color=form_colour(name), linewidth=1.4, linestyle=_DASHES.get(name, "-"))
            line |= Mark(zorder=2.5 if name in _DASHES else 2.0)
            curve = factor * _RATES[name](eta, *coefficients)
            axes.plot(eta, curve, label=name, **line)
            error = float(form["C_stderr"]) / coefficients[0] if coefficients[0] else np.nan
            is_rejected = _by_blocks(group) and int(form["standing"]) == Standing.REJECTED
            if np.isfinite(error) and not is_rejected:  # every form is proportional to its C
                band = curve * (1 - error), curve * (1 + error)
                axes.fill_between(eta, *band, color=form_colour(name), alpha=0.15, linewidth=0)
    is_cloud = seen.sum() >= _CLOUD
    size = 4.2 if seen.sum() < _MANY_LANES else 1.6 if is_cloud else 2.2
    for use, mask in _use_masks(group).items():
        look = Mark(linestyle="none", markersize=size, zorder=1.5 if is_cloud else 3) | _USES[use][1]
        look |= Mark(color=FAINT) if is_cloud and use == "fitted" else Mark()
        axes.plot(relief[mask], rate[mask], label=f"_{use}", **look)
    top = float(np.max(rate[seen]))
    if top > 0:
        axes.set_ylim(-0.06 * top, 1.1 * top)  # clips the curve of a form far from the data
    else:
        shape_zero([axes], "no penetration")


def _use_masks(group: xr.Dataset) -> dict[str, np.ndarray]:
    """Return a mask of the drawable lanes (finite relief and rate) for each use that occurs."""
    meanings = str(group[_USE].attrs["flag_meanings"]).split()
    known = np.isfinite(group[_RELIEF].values) & np.isfinite(group[_RATE].values)
    masks = {name: known & (group[_USE].values == meanings.index(name)) for name in _USES}
    return {name: mask for name, mask in masks.items() if mask.any()}
