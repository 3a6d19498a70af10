"""Maps of the fitted law: which form is best, its coefficient C, and how sure that is."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from vibrojax.plot._about import point_text
from vibrojax.plot._cells import fill_cells, write_labels
from vibrojax.plot._facets import Facets, facets
from vibrojax.plot._forms import best, colour_map, patch_handles, readings
from vibrojax.plot._grid import FORM
from vibrojax.plot._sheet import sheet, write_margins
from vibrojax.plot._values import ROBUST, Value, value_handles, value_of

_MOST = 3  # facets
_SAME = 0.1  # of the greatest error, within which it is worth a word rather than a map
_BEST, _ERROR = "best_form", "C_relative_error"


def law_map(fit: xr.Dataset, x: str, y: str) -> Figure:
    """The first form as good as the best, C of the logarithmic law and its relative error, over `x` and `y`."""
    fit = fit.sortby([x, y])
    name = readings(fit)[0]
    shown = _shown(fit, name)
    panels = facets(shown, (x, y), _MOST)
    values = _values(shown)
    drawn = sheet(panels, ((None,) if _BEST in shown else ()) + values)
    colours, norm = colour_map(fit)
    for panel in drawn:
        if panel.value is None:
            fill_cells(panel, x, y, panel.facet[_BEST].transpose(y, x).values, colours, norm)
        else:
            value = panel.value
            fill_cells(panel, x, y, value.of(panel.facet).transpose(y, x).values, value.colour_map, value.norm)
        write_labels(panel, shown[x], shown[y])
    drawn.finish(_handles(fit, panels, values))
    along = f"fitted along {fit.attrs['along']}, " if "along" in fit.attrs else ""
    error = _error_text(shown) if _ERROR in shown and len(values) == 1 else ""
    about = f"The law {along}C of the form {name}" + (
        "; at the left the first form within 2 of the least AIC" * (_BEST in shown)
    )
    write_margins(drawn.figure, str(fit.attrs.get("title", "")), point_text(fit), panels.note, about, error)
    return drawn.figure


def _shown(fit: xr.Dataset, name: str) -> xr.Dataset:
    """C of the form `name`, its relative error in percent, and the number of the best form, over the groups."""
    one = fit.sel({FORM: name}, drop=True)
    shown = one[["C"]].assign_attrs(fit.attrs)
    if "C_stderr" in one:
        error = 100.0 * one["C_stderr"] / np.abs(one["C"])
        shown[_ERROR] = error.where(np.isfinite(error)).assign_attrs(units="%")
    if "aic" in fit:
        shown[_BEST] = best(fit)
    return shown


def _values(shown: xr.Dataset) -> tuple[Value, ...]:
    low, high = _range(shown)
    named = ["C"] + [_ERROR] * bool(high - low > _SAME * high)
    return tuple(value_of(shown[name]) for name in named)


def _range(shown: xr.Dataset) -> tuple[float, float]:
    """The least and the greatest relative error but for outliers; NaN where there is none."""
    errors = shown[_ERROR].values if _ERROR in shown else np.empty(0)
    errors = errors[np.isfinite(errors)]
    low, high = np.percentile(errors, ROBUST) if errors.size else (np.nan, np.nan)
    return float(low), float(high)


def _error_text(shown: xr.Dataset) -> str:
    low, high = (f"{end:.2g}" for end in _range(shown))
    if "nan" in (low, high):
        return ""
    return f"Standard error of C: {low} %" if low == high else f"Standard error of C: {low} to {high} %"


def _handles(fit: xr.Dataset, panels: Facets, values: tuple[Value, ...]) -> list[Artist]:
    found = patch_handles(fit, [facet[_BEST] for facet in panels.data]) if "aic" in fit else []
    return found + value_handles(panels.data, values)
