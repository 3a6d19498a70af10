"""Pictures of the fitted law, as curves or maps: the coefficient C with error bars, and the AIC of each form.

AIC is drawn relative to the best form, the one with the lowest AIC in a group.
"""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import MarkerType

from vibrojax.analyses.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.analyses.rop_law.blocks import Standing
from vibrojax.analyses.rop_law.results import formulas_of, verdict
from vibrojax.analyses.rop_law.rop import FORMS, SAME_AS_ONSET
from vibrojax.analyses.sweep.maps import fill_cells, write_labels
from vibrojax.io.riglog import log_lines
from vibrojax.plot.axes import scale, shape_zero, share_text, with_unit
from vibrojax.plot.colours import ROBUST, Coloured, Value, cell_handles, coloured, form_colour, patch, value_of
from vibrojax.plot.contents import FORM, POINT, law_in, long_axes
from vibrojax.plot.curves import MOST_ROWS, Across, Row, longest_axis, new_rows
from vibrojax.plot.sheet import LEGEND_WIDTH, Facets, facets, legend_at_right, sheet, write_margins
from vibrojax.plot.style import FAINT, INK, Mark, new_figure, styled

_READINGS = ("onset", "literal", "percent")  # of the logarithmic law: their C are comparable, since all are speeds
_MARKS: dict[str, MarkerType] = {
    "onset": "o",
    "literal": "s",
    "percent": "^",
    "line": "D",
    "power": "v",
    "constant": "P",
}
_EQUAL_AIC = 2.0  # difference of AIC up to which a form counts as equal to the best form
# If a difference of AIC exceeds the first value, the scale is logarithmic above the second.
_LOG_AIC_FROM, _LINEAR_AIC = 30.0, 10.0
_TICKS = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_DODGE = 0.012  # offset between error bars at the same abscissa, as a fraction of the axis
_MOST_MAP_FACETS = 3
_SAME_ERROR = 0.1  # range of errors, relative to the greatest, up to which a note replaces their map
_BEST, _ERROR = "best_form", "C_relative_error"
_MOST_GROUPS, _MOST_COLUMNS = 6, 3
_ROW_HEIGHT = 2.4  # height of a row of panels [inch]
_MANY_LANES = 60  # number of drawn lanes in a group from which on the markers are small
_CLOUD = 300  # number of drawn lanes in a group from which on they are a faint cloud below the curves
_CURVE_POINTS = 200
# The power law often coincides with the straight line, the literal form with the onset form: dashed and on top, they
# leave the colour of the other form visible.
_DASHES = {"power": (0.0, (2.5, 2.0)), "literal": (0.0, (1.5, 2.5))}
_RELIEF, _RATE, _USE = "data_relief", "data_rate_of_penetration", "data_use"

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
    """Draw C in each reading of the law, and the AIC of every form, over the longest axis of the groups.

    At the top are the data of each group with the curve of every form, for six groups at most. For a log whose forms
    were compared over blocks of rows, the error of predicted rates takes the place of AIC.
    """
    fit = _with_short_titles(law_in(fit))
    if "reference_force" in fit.attrs:  # the threshold is unknown: some forms are the same curve as another one
        fit = fit.sel({FORM: [name for name in _forms(fit) if name not in SAME_AS_ONSET]})
    x = longest_axis(fit)
    fit = fit.sortby(x.name) if x.is_number else fit
    has_aic, by_blocks = "aic" in fit, "cv_error" in fit and bool(fit["cv_error"].notnull().any())
    groups = groups_to_show(fit)
    if by_blocks:  # the C of a form that the data reject means nothing
        fit = fit.assign(C=fit["C"].where(fit["standing"] != Standing.REJECTED))
    panels = facets(fit, (POINT, x.name), MOST_ROWS)
    figure, rows, above = new_rows(panels, 1 + has_aic, _ROW_HEIGHT * -(-len(groups) // _MOST_COLUMNS))
    uses = draw_fits(figure, above, groups)
    factor, unit = scale(fit["C"])
    for row in rows:
        _draw_coefficients(row, x, factor)
        row.label(0, x.label, with_unit("C", unit))
        if by_blocks:
            _draw_errors(row, x, factor)
            row.label(1, x.label, with_unit("error of predicted rates", unit))
        elif has_aic:
            row.axes[1].axhspan(0.0, _EQUAL_AIC, color=FAINT, alpha=0.25, linewidth=0)
            for k, name in enumerate(_forms(fit)):
                excess = np.atleast_1d(_above_best(row.facet).sel({FORM: name}).values)
                places = x.of(row.facet) if x.name else [float(k)]
                row.axes[1].plot(places, excess, label=name, **_mark(name, x))
            row.label(1, x.label, "AIC above the best form")
    if by_blocks:
        rows[0].axes[1].set_ylim(bottom=0.0)
    elif has_aic:
        _scale_excess(rows)
    for axes, names in zip(rows[0].axes, (_readings(fit), _forms(fit)), strict=False):
        if x.name:
            x.shape(axes)
        else:
            axes.set_xticks(range(len(names)), names)
            axes.set_xlim(-0.5, len(names) - 0.5)
    values = fit["C"].sel({FORM: _readings(fit)}).values * factor
    if np.isfinite(values).any():  # the limits ignore error bars, which are huge for a failed fit
        low, high = min(float(np.nanmin(values)), 0.0), max(float(np.nanmax(values)), 0.0)
        room = 0.15 * ((high - low) or 1.0)
        rows[0].axes[0].set_ylim(low - room, high + room)
    else:
        for axes in (axes for row in rows for axes in row.axes):
            for artist in (*axes.lines, *axes.patches):
                artist.remove()
            axes.set(xticks=[], yticks=[])
            axes.text(0.5, 0.6, "no group has a C", transform=axes.transAxes, ha="center", color="0.3")
    equal: list[Artist] = [Patch(facecolor=FAINT, alpha=0.25, label="as good as the best")]
    if by_blocks:
        ring = Mark(linestyle="none", marker="o", color=INK, markersize=4.0, markerfacecolor="white")
        equal = [Line2D([], [], label="may be the truth too", **ring)]
    has_any = bool(np.isfinite(values).any())
    legend_at_right(figure, _line_handles(fit), equal if has_aic and has_any else [], uses)
    over = "over the rows of the table" if fit.attrs.get("along") == POINT else f"along {fit.attrs.get('along')}"
    along = f"Fitted {over}; bars of one standard error, bands of that of C" if "along" in fit.attrs else ""
    # Groups without a C: their number per reading if the numbers differ.
    lacking = {name: int(np.isnan(fit["C"].sel({FORM: name}).values).sum()) for name in _readings(fit)}
    counts = [f"{name}: {count}" for name, count in lacking.items() if count]
    counts = counts if len(set(lacking.values())) > 1 else [str(count) for count in lacking.values() if count][:1]
    counts = [] if by_blocks else counts
    note = f"Groups without a C, of {fit['C'].size // fit.sizes[FORM]}: {', '.join(counts)}" if counts else ""
    write_margins(figure, fit, panels.note, data_text(groups, fit), along, note)
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


def _draw_coefficients(row: Row, x: Across, factor: float) -> None:
    """Draw C of each reading with error bars; readings are slightly offset along the abscissa."""
    axes = row.axes[0]
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    for k, name in enumerate(_readings(row.facet)):
        form = row.facet.sel({FORM: name})
        values = np.atleast_1d(form["C"].values) * factor
        errors = np.atleast_1d(form["C_stderr"].values) * factor if "C_stderr" in form else np.zeros(values.shape)
        bars = np.where(np.isfinite(errors), errors, 0.0)
        places = x.of(form) if x.name else np.array([float(k)])
        if x.name:
            places = places + _DODGE * (float(np.ptp(places)) if x.is_number else 4.0) * k
        axes.errorbar(places, values, bars, label=name, capsize=2.5, elinewidth=0.9, **_mark(name, x))


def _draw_errors(row: Row, x: Across, factor: float) -> None:
    """Draw the error of rates predicted from other blocks of rows; forms that cannot be told apart are hollow."""
    for k, name in enumerate(_forms(row.facet)):
        form = row.facet.sel({FORM: name})
        errors, standing = (np.atleast_1d(form[variable].values) for variable in ("cv_error", "standing"))
        places = x.of(form) if x.name else np.array([float(k)])
        row.axes[1].plot(places, factor * errors, label=name, **_mark(name, x))
        rings = np.isin(standing, (Standing.UNDECIDED, Standing.CONTAINS_CHOSEN))
        hollow = _mark(name, x) | Mark(linestyle="none", markerfacecolor="white")
        row.axes[1].plot(np.asarray(places)[rings], factor * errors[rings], label=f"_{name}", **hollow)


def _scale_excess(rows: Sequence[Row]) -> None:
    """Scale the AIC axis from zero upwards; for large differences it is logarithmic above a bound."""
    greatest = max(float(np.nanmax(_above_best(row.facet).values, initial=0.0)) for row in rows)
    axes = rows[0].axes[1]
    if greatest <= _LOG_AIC_FROM:
        axes.set_ylim(-0.5, max(1.1 * greatest, 2.0 * _EQUAL_AIC))
        return
    axes.set_yscale("symlog", linthresh=_LINEAR_AIC)
    axes.set_ylim(-1.0, 1.6 * greatest)
    ticks = [tick for tick in _TICKS if tick <= 1.6 * greatest]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.set_yticks([], minor=True)


@styled
def law_map(fit: xr.Dataset) -> Figure:
    """Draw maps over the two longest axes: the form that describes the data, C, and the relative error of C.

    The first form in the dataset's order whose AIC is as good as the best is drawn. C is that of the first reading of
    the logarithmic law.
    """
    fit = law_in(fit)
    x, y = long_axes(fit)[:2]
    fit = fit.sortby([x, y])
    forms, name = _forms(fit), _readings(fit)[0]
    form = fit.sel({FORM: name}, drop=True)
    shown = form[["C"]].assign_attrs(fit.attrs)
    values: tuple[Value, ...] = (value_of(shown["C"]),)
    error_note = ""
    if "C_stderr" in form:
        error = 100.0 * form["C_stderr"] / np.abs(form["C"])
        shown[_ERROR] = error.where(np.isfinite(error)).assign_attrs(units="%")
        if shown[_ERROR].notnull().any():
            low, high = np.nanpercentile(shown[_ERROR].values, ROBUST).tolist()  # without outliers
            if high - low > _SAME_ERROR * high:
                values += (value_of(shown[_ERROR]),)
            else:
                error_note = f"Standard error of C: {' to '.join(dict.fromkeys((f'{low:.2g}', f'{high:.2g}')))} %"
    if "aic" in fit:
        good = _above_best(fit) <= _EQUAL_AIC
        shown[_BEST] = good.argmax(FORM).where(good.any(FORM))  # index of the first form as good as the best
    panels, groups = facets(shown, (x, y), _MOST_MAP_FACETS), groups_to_show(fit)
    drawn = sheet(panels, ((None,) if _BEST in shown else ()) + values, _ROW_HEIGHT * -(-len(groups) // _MOST_COLUMNS))
    uses = draw_fits(drawn.figure, drawn.above, groups)
    if len(groups):
        drawn.figure.set_figwidth(drawn.figure.get_figwidth() + LEGEND_WIDTH)
        legend_at_right(drawn.figure, _line_handles(fit), uses)
    colours = ListedColormap([form_colour(name) for name in forms], name="forms").with_extremes(
        bad=(1.0, 1.0, 1.0, 0.0)
    )
    norm = BoundaryNorm(np.arange(-0.5, len(forms)), len(forms))
    for panel in drawn.panels:
        if panel.value is None:
            fill_cells(panel, x, y, Coloured(panel.facet[_BEST].transpose(y, x).values, colours, norm))
        else:
            fill_cells(panel, x, y, coloured(panel.facet, panel.value, y, x))
        write_labels(panel, shown[x], shown[y])
    best = [number for facet in panels.data if _BEST in facet for number in facet[_BEST].values.ravel().tolist()]
    shares = {name: best.count(k) / max(len(best), 1) for k, name in enumerate(forms)}
    handles = [
        patch(form_colour(name), f"{name}  {share_text(share)} of groups")
        for name, share in shares.items()
        if share > 0
    ]
    drawn.finish([*handles, *cell_handles(panels.data, values)])
    along = f"fitted along {fit.attrs['along']}, " if "along" in fit.attrs else ""
    left = "; at the left the first form within 2 of the least AIC" * (_BEST in shown)
    about = f"The law {along}C of the form {name}{left}"
    write_margins(drawn.figure, fit, panels.note, data_text(groups, fit), about, error_note)
    return drawn.figure


def _forms(fit: xr.Dataset) -> list[str]:
    return [str(name) for name in fit[FORM].values]


def _readings(fit: xr.Dataset) -> list[str]:
    """Return the forms that are readings of the logarithmic law, or all forms if none is."""
    return [name for name in _READINGS if name in _forms(fit)] or _forms(fit)


def _mark(name: str, x: Across | None = None) -> Mark:
    """Return the marker and line style of a form; if `x` has string labels, points are not joined by lines."""
    mark = Mark(color=form_colour(name), marker=_MARKS.get(name, "P"), markersize=4.0, linewidth=1.2)
    return mark if x is None else mark | Mark(linestyle="-" if x.is_number else "none")


def _line_handles(fit: xr.Dataset) -> list[Artist]:
    formulas = formulas_of(fit)
    signs = {"eta0": "η₀", "eta": "η", " - ": " − ", "^exponent": "ⁿ"}
    handles: list[Artist] = []
    for name in _forms(fit):
        formula = formulas.get(name, "")
        for text, sign in signs.items():
            formula = formula.replace(text, sign)
        mark = _mark(name) | Mark(linestyle=_DASHES.get(name, "-"))
        handles.append(Line2D([], [], label=f"{name}\n{formula}" if formula else name, **mark))
    return handles


def _above_best(fit: xr.Dataset) -> xr.DataArray:
    """Return the difference between each form's AIC and the lowest AIC in the group; NaN for a form without AIC."""
    aic = fit["aic"].where(np.isfinite(fit["aic"]))
    return aic - aic.min(FORM)


def groups_to_show(fit: xr.Dataset) -> Facets:
    """Return one facet per group, of at most six groups; no facets if the fit does not contain its data."""
    return facets(fit, (), _MOST_GROUPS) if {_RELIEF, _RATE, _USE} <= set(fit.data_vars) else Facets((), ())


def draw_fits(figure: Figure, place: SubplotSpec | None, groups: Facets) -> list[Artist]:
    """Draw a panel per group into `place`: the data and the fitted curve of each form. Return entries of the legend.

    Without a place, nothing is drawn. The entries are those of the occurring uses of lanes: fitted, censored, left out.
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
    rates = {form.name: form.rate for form in FORMS}
    eta = np.linspace(relief[seen].min(), relief[seen].max(), _CURVE_POINTS)
    for name in (str(name) for name in group[FORM].values):
        form = group.sel({FORM: name})
        coefficients = [float(form[x]) if x in form else np.nan for x in ("C", "eta0", "exponent")]
        if name in rates and np.isfinite(coefficients[0]):
            line = Mark(color=form_colour(name), linewidth=1.4, linestyle=_DASHES.get(name, "-"))
            line |= Mark(zorder=2.5 if name in _DASHES else 2.0)
            curve = factor * rates[name](eta, *coefficients)
            axes.plot(eta, curve, label=name, **line)
            error = float(form["C_stderr"]) / coefficients[0] if "C_stderr" in form and coefficients[0] else np.nan
            if np.isfinite(error):  # every form is proportional to its C
                band = curve * (1 - error), curve * (1 + error)
                axes.fill_between(eta, *band, color=form_colour(name), alpha=0.15, linewidth=0)
    is_cloud = seen.sum() >= _CLOUD
    size = 4.2 if seen.sum() < _MANY_LANES else 1.6 if is_cloud else 2.2
    for use, mask in _masks(group).items():
        look = Mark(linestyle="none", markersize=size, zorder=1.5 if is_cloud else 3) | _USES[use][1]
        look |= Mark(color=FAINT) if is_cloud and use == "fitted" else Mark()
        axes.plot(relief[mask], rate[mask], label=f"_{use}", **look)
    top = float(np.max(rate[seen]))
    if top > 0:
        axes.set_ylim(-0.06 * top, 1.1 * top)  # clips the curve of a form far from the data
    else:
        shape_zero([axes], "no penetration")


def _masks(group: xr.Dataset) -> dict[str, np.ndarray]:
    """Return a mask of the drawable lanes (finite relief and rate) for each use that occurs."""
    meanings = str(group[_USE].attrs["flag_meanings"]).split()
    known = np.isfinite(group[_RELIEF].values) & np.isfinite(group[_RATE].values)
    masks = {name: known & (group[_USE].values == meanings.index(name)) for name in _USES}
    return {name: mask for name, mask in masks.items() if mask.any()}


@styled
def residuals(fit: xr.Dataset) -> Figure:
    """Draw the residuals of every form over the relief, with a panel for each group; no panels without the data."""
    figure, rates, groups = new_figure(8.0, 2.6), {form.name: form.rate for form in FORMS}, groups_to_show(law_in(fit))
    if not len(groups):
        return figure
    for axes, title, group in zip(
        figure.subplots(1, len(groups), squeeze=False)[0], groups.titles, groups.data, strict=True
    ):
        factor, unit = scale(group[_RATE])
        relief, rate = (group[name].values[_masks(group).get("fitted", slice(0))] for name in (_RELIEF, _RATE))
        axes.axhline(0.0, color=FAINT, linewidth=0.8)
        for name in (name for name in _forms(group) if name in rates):
            form = group.sel({FORM: name})
            law = rates[name](relief, *(float(form[x]) if x in form else np.nan for x in ("C", "eta0", "exponent")))
            axes.plot(relief, factor * (rate - law), **_mark(name) | Mark(linestyle="none", markersize=3.5))
        axes.set_title(f"residuals{f', {title}' if title else ''}", loc="left")
        axes.set(xlabel="relief P/D", ylabel=with_unit("measured less the form", unit))
    return figure


class Fits(Analysis):
    """The fit of the rate-of-penetration law to a sweep's dataset or to rig data."""

    kind = "fit"
    pictures = (
        PictureRule("law", lambda held: held.law and len(held.long) > 1, law_map),
        PictureRule("law", lambda held: held.law, law_lines),
    )

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("columns", log_lines(ds))]

    def page_figures(self, ds: xr.Dataset) -> list[Figure]:
        return [self.picture(ds), residuals(ds)]

    def page_text(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("forms of the law", verdict(ds)), *self.summary(ds)]
