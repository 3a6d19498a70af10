"""The analysis `fit`: pictures and summary of the fits of the rate-of-penetration law."""

from typing import Any

import xarray as xr

from vibrojax.io.riglog import log_lines
from vibrojax.pictures.contents import Contents
from vibrojax.studies.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.studies.rop_map import law_map
from vibrojax.studies.rop_picture import law_lines, residuals
from vibrojax.studies.rop_results import verdict


def _is_law(held: Contents) -> bool:
    return held.law and {"aic", "C_stderr"} <= held.variables


class Fits(Analysis):
    """The fit of the rate-of-penetration law to a sweep's dataset or to rig data."""

    kind = "fit"
    pictures = (
        PictureRule("law", lambda held: _is_law(held) and len(held.long) > 1, law_map),
        PictureRule("law", _is_law, law_lines),
    )

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("columns", log_lines(ds))]

    def page_figures(self, ds: xr.Dataset) -> list[Any]:
        return [self.plots(ds), residuals(ds)]

    def page_text(self, ds: xr.Dataset) -> list[SummaryPart]:
        return [SummaryPart("forms of the law", verdict(ds)), *self.summary(ds)]
