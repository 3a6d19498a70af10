"""Maps of the fitted law over two axes of the groups: the form that describes the data, C, and the error of C."""

import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, ListedColormap

from vibrojax.pictures.axes import edges, margins, share_text, values_along
from vibrojax.pictures.colours import ROBUST, Value, cell_keys, form_colour, value_of
from vibrojax.pictures.contents import FORM, law_in, long_axes
from vibrojax.pictures.maps import cell_layers, map_plot
from vibrojax.pictures.plots import Cells, Layer, Sheet, patch
from vibrojax.pictures.sheet import LEGEND_WIDTH, facets, layout
from vibrojax.studies.rop_picture import (
    EQUAL_AIC,
    above_best,
    data_text,
    fits_above,
    form_keys,
    form_names,
    groups_to_show,
    readings,
    use_keys,
)

_MOST_MAP_FACETS = 3
_SAME_ERROR = 0.1  # range of errors, relative to the greatest, up to which a note replaces their map
_BEST, _ERROR = "best_form", "C_relative_error"


def law_map(fit: xr.Dataset) -> Sheet:
    """Draw maps over the two longest axes: the form that describes the data, C, and the relative error of C.

    The first form in the dataset's order whose AIC is as good as the best is drawn. C is that of the first reading of
    the logarithmic law.
    """
    fit = law_in(fit)
    x, y = long_axes(fit)[:2]
    fit = fit.sortby([x, y])
    forms, name = form_names(fit), readings(fit)[0]
    form = fit.sel({FORM: name}, drop=True)
    shown = form[["C"]].assign_attrs(fit.attrs)
    values: tuple[Value, ...] = (value_of(shown["C"]),)
    error_note, error = "", 100.0 * form["C_stderr"] / np.abs(form["C"])
    shown[_ERROR] = error.where(np.isfinite(error)).assign_attrs(units="%")
    if shown[_ERROR].notnull().any():
        low, high = np.nanpercentile(shown[_ERROR].values, ROBUST).tolist()  # without outliers
        if high - low > _SAME_ERROR * high:
            values += (value_of(shown[_ERROR]),)
        else:
            error_note = f"Standard error of C: {' to '.join(dict.fromkeys((f'{low:.2g}', f'{high:.2g}')))} %"
    good = above_best(fit) <= EQUAL_AIC
    shown[_BEST] = good.argmax(FORM).where(good.any(FORM))  # index of the first form as good as the best
    panels, groups = facets(shown, (x, y), _MOST_MAP_FACETS), groups_to_show(fit)
    drawn = layout(panels, (None, *values))
    above = fits_above(groups, [form_keys(fit), use_keys(groups)])
    if above is not None:
        width, height = drawn.sheet["size"]
        drawn.sheet["size"] = width + LEGEND_WIDTH, height + above.size[1]
    clear = (1.0, 1.0, 1.0, 0.0)
    colours = ListedColormap([form_colour(name) for name in forms], name="forms").with_extremes(bad=clear)
    norm = BoundaryNorm(np.arange(-0.5, len(forms)), len(forms))
    right, top = (edges(values_along(shown[axis])) for axis in (x, y))
    plots = []
    for panel in drawn.panels:
        layers: list[Layer] = [Cells(right, top, panel.facet[_BEST].transpose(y, x).values, colours, norm)]
        layers = layers if panel.value is None else cell_layers(panel.facet, panel.value, x, y)
        plots.append(map_plot(panel, shown[x], shown[y], layers))
    best = [number for facet in panels.data for number in facet[_BEST].values.ravel().tolist()]
    shares = {name: best.count(k) / max(len(best), 1) for k, name in enumerate(forms)}
    keys: list[Layer] = [
        patch(form_colour(name), f"{name}  {share_text(share)} of groups")
        for name, share in shares.items()
        if share > 0
    ]
    keys += cell_keys(panels.data, values)
    along = f"fitted along {fit.attrs['along']}, " if "along" in fit.attrs else ""
    about = f"The law {along}C of the form {name}; at the left the first form within 2 of the least AIC"
    notes = margins(fit, panels.note, data_text(groups, fit), about, error_note)
    return Sheet(plots, keys=[keys], above=above, **drawn.sheet, **notes)
