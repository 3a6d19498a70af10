"""The analysis `borders`: curves around the stable single impact in a plane of two parameters."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from vibrojax.analyses.analysis import PictureRule, Source, SummaryPart
from vibrojax.analyses.borders.picture import border_curves
from vibrojax.analyses.borders.run import borders_of, checked
from vibrojax.analyses.orbits.analysis import SweepAnalysis, sweep_with_orbits
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import OF_BORDERS
from vibrojax.sweep.input.definition import Sweep


@dataclass(frozen=True)
class Borders(SweepAnalysis):
    """Compute the borders of the stable single impact in a sweep's plane, as curves with the kind of each border."""

    axes: tuple[str, str] | None = field(
        default=None,
        metadata={
            "metavar": "X,Y",
            "help": "the two axes of the plane (gamma and beta, else the two with most values)",
        },
    )

    kind = "borders"
    counted = "curve"
    view = "curves"
    variables = OF_BORDERS
    pictures = (PictureRule("borders", lambda held: True, border_curves),)

    def sweep(self, source: Source) -> Sweep:
        """Return the checked sweep; raise `InputError` if it has no suitable plane."""
        sweep = sweep_with_orbits(source)
        checked(sweep, self.axes)
        return sweep

    def identity(self, sweep: Sweep) -> dict[str, object]:
        """Return the axes of the plane, on which the result depends."""
        return {self.kind: list(checked(sweep, self.axes))}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the borders; `lanes`: dataset of the sweep with orbits."""
        return borders_of(sweep, lanes, checked(sweep, self.axes))

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Return the area fraction and the kinds of the borders of each region (plane and initial condition)."""
        fixed = [str(name) for name in ds.coords if ds[name].dims == ("region",) and name != "region_start"]
        meanings = flags(ds["kind"])
        lines, facts = [], []
        for k in range(ds.sizes["region"]):
            values = {name.removeprefix("region_"): float(ds[name][k]) for name in fixed}
            start = str(ds["region_start"].values[k]) if "region_start" in ds.coords else ""
            mask = np.ones(ds.sizes["curve"], bool)
            for name, value in values.items():
                mask &= ds[name].values == value
            if start:
                mask &= ds["start"].values.astype(str) == start
            counter: Counter[str] = Counter()
            for curve in np.flatnonzero(mask):
                counter[meanings[int(ds["kind"][curve])]] += int((ds["curve"].values == curve).sum())
            sizes = dict(counter.most_common())
            area = float(ds["region_area"][k])
            plane = [f"{name} = {value:g}" for name, value in values.items()]
            plane.append("any start" if start in ("", "any") else f"start {start}")
            ends = ", ".join(f"{kind} ({size})" for kind, size in sizes.items()) or "nothing"
            lines.append(f"{', '.join(plane)}: {100 * area:.1f} % of the plane; ends by {ends}")
            facts.append({**values, "start": start or "any", "area": area, "vertices": sizes})
        return [SummaryPart("borders", lines, {"borders": facts})]
