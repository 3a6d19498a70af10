"""The fitted law: its coefficient in the readings of R9 with error bars, and how far each form is from the best."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vibrojax.errors import InputError
from vibrojax.plot._about import point_text
from vibrojax.plot._facets import facets
from vibrojax.plot._forms import EQUAL, above_best, forms, line_handles, look, readings
from vibrojax.plot._grid import FORM, POINT, to_map, without_single
from vibrojax.plot._labels import scale, with_unit
from vibrojax.plot._law_map import law_map
from vibrojax.plot._rows import MOST_ROWS, Row, label_axes, rows
from vibrojax.plot._series import Across, across
from vibrojax.plot._sheet import write_margins
from vibrojax.plot._stacks import LEGEND_WIDTH, legend_at_right
from vibrojax.plot._style import FAINT, styled

_WIDE = 30.0  # difference of AIC from which the scale is logarithmic, above _LINEAR
_LINEAR = 10.0
_TICKS = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_DODGE = 0.012  # of the axis, between error bars at one place


@styled
def fitted_law(fit: xr.Dataset) -> Figure:
    """C of ROP = C ln(eta) in its three readings, and the AIC of every form above that of the best of its group.

    Both over the longest axis of the groups; further ones become rows. Over two axes of nine values and more, maps of C
    and of the best form. Without groups, over the forms.

    **Arguments:**

    - `fit`: a fit's dataset: `C`, `C_stderr` [m/s] and `aic` along the groups and `form`.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there is no C along `form`.
    """
    if "C" not in fit or FORM not in fit["C"].dims or fit["C"].size == 0:
        raise InputError("no law to draw: the dataset holds no variable C along form")
    fit = without_single(fit)
    return law_map(fit, *to_map(fit)[:2]) if len(to_map(fit)) > 1 else _law_lines(fit)


def _law_lines(fit: xr.Dataset) -> Figure:
    x = across(fit)
    fit = fit.sortby(x.name) if x.is_number else fit
    panels = facets(fit, (POINT, x.name), MOST_ROWS)
    has_aic = "aic" in fit
    figure, drawn = rows(panels, 1 + has_aic)
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
    legend_at_right(figure, line_handles(fit), _equal_handle() if has_aic else [])
    title = str(fit.attrs.get("title", ""))
    write_margins(figure, title, point_text(fit), panels.note, *_about(fit), legend=LEGEND_WIDTH)
    return figure


def _draw_coefficients(row: Row, x: Across, factor: float) -> None:
    axes = row.axes[0]
    axes.axhline(0.0, color=FAINT, linewidth=0.8)
    for at, name in enumerate(readings(row.facet)):
        one = row.facet.sel({FORM: name})
        values = np.atleast_1d(one["C"].values) * factor
        errors = np.atleast_1d(one["C_stderr"].values) * factor if "C_stderr" in one else np.full(values.shape, np.nan)
        bars = np.where(np.isfinite(errors), errors, 0.0)
        bar = {"capsize": 2.5, "elinewidth": 0.9, "linestyle": _joined(x)}
        axes.errorbar(_places(x, one, at, at), values, bars, label=name, **bar, **look(name))


def _draw_excess(row: Row, x: Across) -> None:
    axes, excess = row.axes[1], above_best(row.facet)
    axes.axhspan(0.0, EQUAL, color=FAINT, alpha=0.25, linewidth=0)
    for at, name in enumerate(forms(row.facet)):
        values = np.atleast_1d(excess.sel({FORM: name}).values)
        axes.plot(_places(x, row.facet, at), values, label=name, linestyle=_joined(x), **look(name))


def _scale_excess(drawn: tuple[Row, ...]) -> None:
    """From zero, and logarithmic above a bound where some form is far off."""
    greatest = max(float(np.nanmax(above_best(row.facet).values, initial=0.0)) for row in drawn)
    axes = drawn[0].axes[1]
    if greatest <= _WIDE:
        axes.set_ylim(-0.5, max(1.1 * greatest, 2.0 * EQUAL))
        return
    axes.set_yscale("symlog", linthresh=_LINEAR)
    axes.set_ylim(-1.0, 1.6 * greatest)
    ticks = [tick for tick in _TICKS if tick <= 1.6 * greatest]
    axes.set_yticks(ticks, [str(tick) for tick in ticks])
    axes.set_yticks([], minor=True)


def _shape(row: Row, x: Across) -> None:
    """The scales of the panels that all others share."""
    for axes, names in zip(row.axes, (readings(row.facet), forms(row.facet)), strict=False):
        if x.name:
            x.shape(axes)
        else:
            axes.set_xticks(range(len(names)), names)
            axes.set_xlim(-0.5, len(names) - 0.5)


def _limit(axes: Axes, fit: xr.Dataset, factor: float) -> None:
    """Limits that the bars of a fit gone wrong do not stretch."""
    held = fit["C"].sel({FORM: readings(fit)}).values * factor
    if not np.isfinite(held).any():
        return
    low, high = min(float(np.nanmin(held)), 0.0), max(float(np.nanmax(held)), 0.0)
    span = (high - low) or 1.0
    axes.set_ylim(low - 0.15 * span, high + 0.15 * span)


def _places(x: Across, groups: xr.Dataset, form: int, dodged: int = 0) -> np.ndarray:
    """Where the groups lie; the forms themselves where there are none. Bars at one place stand a little apart."""
    if not x.name:
        return np.array([float(form)])
    places = x.of(groups).astype(float)
    return places + _DODGE * (float(np.ptp(places)) if x.is_number else 4.0) * dodged


def _joined(x: Across) -> str:
    return "-" if x.is_number else "none"


def _equal_handle() -> list[Artist]:
    return [Patch(facecolor=FAINT, alpha=0.25, label="as good as the best")]


def _about(fit: xr.Dataset) -> list[str]:
    """Along what was fitted, and for how many groups a reading has no C."""
    along = f"Fitted along {fit.attrs['along']}; bars of one standard error" if "along" in fit.attrs else ""
    lacking = {name: int(np.isnan(fit["C"].sel({FORM: name}).values).sum()) for name in readings(fit)}
    groups = fit["C"].size // fit.sizes[FORM]
    parts = [f"{name}: {count}" for name, count in lacking.items() if count]
    if len(set(lacking.values())) == 1:
        parts = [str(count) for count in set(lacking.values()) if count]
    return [along, f"Groups without a C, of {groups}: {', '.join(parts)}" if parts else ""]
