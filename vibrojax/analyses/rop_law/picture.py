"""The fitted law: its coefficient with error bars, and how far each form is from the best; as curves or as maps."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.typing import MarkerType

from vibrojax.analyses.rop_law.fit_curves import data_handles, data_text, draw_fits, groups_to_show, height_of
from vibrojax.analyses.sweep.maps import fill_cells, write_labels
from vibrojax.plot.axes import point_text, scale, with_unit
from vibrojax.plot.colours import (
    ROBUST,
    Coloured,
    Value,
    coloured,
    form_colour,
    form_colours,
    form_handles,
    value_handles,
    value_of,
)
from vibrojax.plot.contents import FORM, POINT, law_in, long_axes
from vibrojax.plot.curves import MOST_ROWS, Across, Row, across, label_axes, rows
from vibrojax.plot.margins import LEGEND_WIDTH, legend_at_right, write_margins
from vibrojax.plot.sheet import facets, sheet
from vibrojax.plot.style import FAINT, Mark, styled

_READINGS = ("onset", "literal", "percent")  # of the logarithmic law; their C are speeds that can be compared
_MARKS: dict[str, MarkerType] = {"onset": "o", "literal": "s", "percent": "^", "line": "D", "power": "v"}
_EQUAL = 2.0  # difference of AIC up to which a form is as good as the best
_WIDE = 30.0  # difference of AIC from which the scale is logarithmic, above _LINEAR
_LINEAR = 10.0
_TICKS = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_DODGE = 0.012  # of the axis, between error bars at one place

_MOST_FACETS = 3  # of maps
_SAME_ERROR = 0.1  # of the greatest error, within which it is worth a word rather than a map
_BEST, _ERROR = "best_form", "C_relative_error"


@styled
def law_lines(fit: xr.Dataset) -> Figure:
    """C in its readings and the AIC of every form, over the longest axis of the groups; see `fitted_law`."""
    fit = law_in(fit)
    x = across(fit)
    fit = fit.sortby(x.name) if x.is_number else fit
    panels, groups = facets(fit, (POINT, x.name), MOST_ROWS), groups_to_show(fit)
    has_aic = "aic" in fit
    figure, drawn, above = rows(panels, 1 + has_aic, height_of(groups))
    if above is not None and groups is not None:
        draw_fits(figure, above, groups)
    factor, unit = scale(fit["C"])
    for row in drawn:
        _draw_coefficients(row, x, factor)
        label_axes(row, 0, x.label, with_unit("C", unit))
        if has_aic:
            _draw_excess(row, x)
            label_axes(row, 1, x.label, "AIC above the best form")
    if has_aic:
        _scale_excess(drawn)
    _shape(drawn[0], x)
    _limit(drawn[0].axes[0], fit, factor)
    legend_at_right(figure, _line_handles(fit), _equal_handle() if has_aic else [], data_handles(groups))
    title = str(fit.attrs.get("title", ""))
    write_margins(figure, title, point_text(fit), panels.note, data_text(groups, fit), *_about(fit))
    return figure


def _draw_coefficients(row: Row, x: Across, factor: float) -> None:
    axes = row.axes[0]
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    for at, name in enumerate(_readings(row.facet)):
        one = row.facet.sel({FORM: name})
        values = np.atleast_1d(one["C"].values) * factor
        errors = np.atleast_1d(one["C_stderr"].values) * factor if "C_stderr" in one else np.full(values.shape, np.nan)
        bars = np.where(np.isfinite(errors), errors, 0.0)
        mark = _mark(name) | Mark(linestyle=_joined(x))
        axes.errorbar(_places(x, one, at, at), values, bars, label=name, capsize=2.5, elinewidth=0.9, **mark)


def _draw_excess(row: Row, x: Across) -> None:
    axes, excess = row.axes[1], _above_best(row.facet)
    axes.axhspan(0.0, _EQUAL, color=FAINT, alpha=0.25, linewidth=0)
    for at, name in enumerate(_forms(row.facet)):
        values = np.atleast_1d(excess.sel({FORM: name}).values)
        mark = _mark(name) | Mark(linestyle=_joined(x))
        axes.plot(_places(x, row.facet, at), values, label=name, **mark)


def _scale_excess(drawn: Sequence[Row]) -> None:
    """From zero, and logarithmic above a bound where some form is far off."""
    greatest = max(float(np.nanmax(_above_best(row.facet).values, initial=0.0)) for row in drawn)
    axes = drawn[0].axes[1]
    if greatest <= _WIDE:
        axes.set_ylim(-0.5, max(1.1 * greatest, 2.0 * _EQUAL))
        return
    axes.set_yscale("symlog", linthresh=_LINEAR)
    axes.set_ylim(-1.0, 1.6 * greatest)
    ticks = [tick for tick in _TICKS if tick <= 1.6 * greatest]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.set_yticks([], minor=True)


def _shape(row: Row, x: Across) -> None:
    """The scales of the panels that all others share."""
    for axes, names in zip(row.axes, (_readings(row.facet), _forms(row.facet)), strict=False):
        if x.name:
            x.shape(axes)
        else:
            axes.set_xticks(range(len(names)), names)
            axes.set_xlim(-0.5, len(names) - 0.5)


def _limit(axes: Axes, fit: xr.Dataset, factor: float) -> None:
    """Limits that the bars of a fit gone wrong do not stretch."""
    values = fit["C"].sel({FORM: _readings(fit)}).values * factor
    if not np.isfinite(values).any():
        return
    low, high = min(float(np.nanmin(values)), 0.0), max(float(np.nanmax(values)), 0.0)
    span = (high - low) or 1.0
    axes.set_ylim(low - 0.15 * span, high + 0.15 * span)


def _places(x: Across, groups: xr.Dataset, form: int, dodged: int = 0) -> Float[np.ndarray, " groups"]:
    """Where the groups lie; the forms themselves where there are none. Bars at one place stand beside each other."""
    if not x.name:
        return np.array([float(form)])
    places = x.of(groups)
    return places + _DODGE * (float(np.ptp(places)) if x.is_number else 4.0) * dodged


def _joined(x: Across) -> Literal["-", "none"]:
    return "-" if x.is_number else "none"


def _equal_handle() -> list[Artist]:
    return [Patch(facecolor=FAINT, alpha=0.25, label="as good as the best")]


def _about(fit: xr.Dataset) -> list[str]:
    """Along what was fitted, and for how many groups a reading has no C."""
    along = f"Fitted along {fit.attrs['along']}; bars of one standard error" if "along" in fit.attrs else ""
    lacking = {name: int(np.isnan(fit["C"].sel({FORM: name}).values).sum()) for name in _readings(fit)}
    groups = fit["C"].size // fit.sizes[FORM]
    parts = [f"{name}: {count}" for name, count in lacking.items() if count]
    if len(set(lacking.values())) == 1:
        parts = [str(count) for count in set(lacking.values()) if count]
    return [along, f"Groups without a C, of {groups}: {', '.join(parts)}" if parts else ""]


@styled
def law_map(fit: xr.Dataset) -> Figure:
    """The first form as good as the best, C of the logarithmic law and its relative error, over two long axes."""
    fit = law_in(fit)
    x, y = long_axes(fit)[:2]
    fit = fit.sortby([x, y])
    name = _readings(fit)[0]
    shown = _shown(fit, name)
    panels, groups = facets(shown, (x, y), _MOST_FACETS), groups_to_show(fit)
    values = _values(shown)
    drawn = sheet(panels, ((None,) if _BEST in shown else ()) + values, height_of(groups))
    if drawn.above is not None and groups is not None:
        draw_fits(drawn.figure, drawn.above, groups)
        drawn.figure.set_figwidth(drawn.figure.get_figwidth() + LEGEND_WIDTH)
        legend_at_right(drawn.figure, _line_handles(fit), data_handles(groups))
    for panel in drawn:
        if panel.value is None:
            best = panel.facet[_BEST].transpose(y, x).values
            fill_cells(panel, x, y, Coloured(best, *form_colours(_forms(fit))))
        else:
            fill_cells(panel, x, y, coloured(panel.facet, panel.value, y, x))
        write_labels(panel, shown[x], shown[y])
    handles = form_handles(_forms(fit), [facet[_BEST] for facet in panels.data]) if _BEST in shown else []
    drawn.finish(handles + value_handles(panels.data, values))
    along = f"fitted along {fit.attrs['along']}, " if "along" in fit.attrs else ""
    error = _error_text(shown) if _ERROR in shown and len(values) == 1 else ""
    about = f"The law {along}C of the form {name}" + (
        "; at the left the first form within 2 of the least AIC" * (_BEST in shown)
    )
    notes = point_text(fit), panels.note, data_text(groups, fit), about, error
    write_margins(drawn.figure, str(fit.attrs.get("title", "")), *notes)
    return drawn.figure


def _shown(fit: xr.Dataset, name: str) -> xr.Dataset:
    """C of the form `name`, its relative error in percent, and the number of the best form, over the groups."""
    one = fit.sel({FORM: name}, drop=True)
    shown = one[["C"]].assign_attrs(fit.attrs)
    if "C_stderr" in one:
        error = 100.0 * one["C_stderr"] / np.abs(one["C"])
        shown[_ERROR] = error.where(np.isfinite(error)).assign_attrs(units="%")
    if "aic" in fit:
        shown[_BEST] = _best(fit)
    return shown


def _values(shown: xr.Dataset) -> tuple[Value, ...]:
    low, high = _range_of_error(shown)
    named = ["C"] + [_ERROR] * bool(high - low > _SAME_ERROR * high)
    return tuple(value_of(shown[name]) for name in named)


def _range_of_error(shown: xr.Dataset) -> tuple[float, float]:
    """The least and the greatest relative error but for outliers; NaN where there is none."""
    errors = shown[_ERROR].values if _ERROR in shown else np.empty(0)
    errors = errors[np.isfinite(errors)]
    low, high = np.percentile(errors, ROBUST) if errors.size else (np.nan, np.nan)
    return float(low), float(high)


def _error_text(shown: xr.Dataset) -> str:
    low, high = (f"{end:.2g}" for end in _range_of_error(shown))
    if "nan" in (low, high):
        return ""
    return f"Standard error of C: {low} %" if low == high else f"Standard error of C: {low} to {high} %"


# Forms.


def _forms(fit: xr.Dataset) -> list[str]:
    """The names of the forms, in the order of the dataset."""
    return [str(name) for name in fit[FORM].values]


def _readings(fit: xr.Dataset) -> list[str]:
    """The readings of the logarithmic law among the forms; all forms where there are none of these."""
    names = _forms(fit)
    return [name for name in _READINGS if name in names] or names


def _mark(name: str) -> Mark:
    """How the form `name` looks."""
    return Mark(color=form_colour(name), marker=_MARKS.get(name, "P"), markersize=4.0, linewidth=1.2)


def _line_handles(fit: xr.Dataset) -> list[Artist]:
    """The legend's entries for marks: the forms with their formulas, where the dataset gives these."""
    formulas = dict(part.split(": ", 1) for part in str(fit.attrs.get("formulas", "")).split("; ") if ": " in part)
    texts = {name: f"{name}\n{_pretty(formulas[name])}" if name in formulas else name for name in _forms(fit)}
    return [Line2D([], [], label=text, **_mark(name)) for name, text in texts.items()]


def _above_best(fit: xr.Dataset) -> xr.DataArray:
    """The AIC of every form less that of the best of its group; NaN where a form has none."""
    aic = fit["aic"].where(np.isfinite(fit["aic"]))
    return aic - aic.min(FORM)


def _best(fit: xr.Dataset) -> xr.DataArray:
    """The number of the first form in each group that is as good as the best; NaN where none has an AIC."""
    good = _above_best(fit) <= _EQUAL
    return good.argmax(FORM).where(good.any(FORM))


def _pretty(formula: str) -> str:
    return formula.replace("eta0", "η₀").replace("eta", "η").replace(" - ", " − ").replace("^exponent", "ⁿ")
