"""The analysis `fit`: pictures, residuals and summary of the fits of the rate-of-penetration law."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from vibrojax.analyses.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.analyses.rop_law.forms import FORMS
from vibrojax.analyses.rop_law.picture import form_mark, groups_to_show, law_lines, law_map, use_masks
from vibrojax.analyses.rop_law.results import verdict
from vibrojax.io.riglog import log_lines
from vibrojax.plot.axes import scale, with_unit
from vibrojax.plot.contents import FORM, law_in
from vibrojax.plot.style import FAINT, Mark, new_figure, styled

RELIEF, RATE = "data_relief", "data_rate_of_penetration"


@styled
def residuals(fit: xr.Dataset) -> Figure:
    """Draw the residuals of every form over the relief, with a panel for each group; no panels without the data."""
    figure, rates, groups = new_figure(8.0, 2.6), {form.name: form.rate for form in FORMS}, groups_to_show(law_in(fit))
    if not len(groups):
        return figure
    for axes, title, group in zip(
        figure.subplots(1, len(groups), squeeze=False)[0], groups.titles, groups.data, strict=True
    ):
        factor, unit = scale(group[RATE])
        relief, rate = (group[name].values[use_masks(group).get("fitted", slice(0))] for name in (RELIEF, RATE))
        axes.axhline(0.0, color=FAINT, linewidth=0.8)
        for name in (name for name in [str(name) for name in group[FORM].values] if name in rates):
            form = group.sel({FORM: name})
            law = rates[name](relief, *(float(form[x]) if x in form else np.nan for x in ("C", "eta0", "exponent")))
            axes.plot(relief, factor * (rate - law), **form_mark(name) | Mark(linestyle="none", markersize=3.5))
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
