"""Maps of the fitted law over two axes of the groups: the form that describes the data, C, and the error of C."""

import numpy as np
import xarray as xr
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from vibrojax.pictures.axes import share_text
from vibrojax.pictures.colours import ROBUST, Coloured, Value, cell_handles, coloured, form_colour, patch, value_of
from vibrojax.pictures.contents import FORM, law_in, long_axes
from vibrojax.pictures.maps import fill_cells, write_labels
from vibrojax.pictures.sheet import LEGEND_WIDTH, facets, legend_at_right, sheet, write_margins
from vibrojax.pictures.style import styled
from vibrojax.studies.rop_picture import (
    EQUAL_AIC,
    above_best,
    data_text,
    draw_fits,
    form_names,
    groups_to_show,
    height_of,
    line_handles,
    readings,
)

_MOST_MAP_FACETS = 3
_SAME_ERROR = 0.1  # range of errors, relative to the greatest, up to which a note replaces their map
_BEST, _ERROR = "best_form", "C_relative_error"


@styled
def law_map(fit: xr.Dataset) -> Figure:
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
    drawn = sheet(panels, (None, *values), height_of(groups))
    uses = draw_fits(drawn.figure, drawn.above, groups)
    if len(groups):
        drawn.figure.set_figwidth(drawn.figure.get_figwidth() + LEGEND_WIDTH)
        legend_at_right(drawn.figure, line_handles(fit), uses)
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
    best = [number for facet in panels.data for number in facet[_BEST].values.ravel().tolist()]
    shares = {name: best.count(k) / max(len(best), 1) for k, name in enumerate(forms)}
    handles = [
        patch(form_colour(name), f"{name}  {share_text(share)} of groups")
        for name, share in shares.items()
        if share > 0
    ]
    drawn.finish([*handles, *cell_handles(panels.data, values)])
    along = f"fitted along {fit.attrs['along']}, " if "along" in fit.attrs else ""
    about = f"The law {along}C of the form {name}; at the left the first form within 2 of the least AIC"
    write_margins(drawn.figure, fit, panels.note, data_text(groups, fit), about, error_note)
    return drawn.figure
