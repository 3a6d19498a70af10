"""The analysis `fit`: pictures and summaries of fitted laws."""

import xarray as xr

from vibrojax.analyses.analysis import Analysis, PictureRule, SummaryPart
from vibrojax.analyses.rop_law.columns import columns_lines
from vibrojax.analyses.rop_law.picture import law_lines, law_map


class Fits(Analysis):
    """The fit of the rate-of-penetration law to a sweep's dataset or to rig data."""

    kind = "fit"
    pictures = (
        PictureRule("law", lambda held: held.law and len(held.long) > 1, law_map),
        PictureRule("law", lambda held: held.law, law_lines),
    )

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return a summary part that lists the CSV column used for each quantity."""
        return [SummaryPart("columns", columns_lines(ds))]
