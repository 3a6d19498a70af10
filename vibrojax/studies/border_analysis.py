"""The analysis `borders`: curves around the stable single impact in a plane of two parameters."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from textwrap import fill

import numpy as np
import xarray as xr

from vibrojax.errors import counted, printable
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import OF_BORDERS
from vibrojax.maps.rerun import sweep_with_orbits
from vibrojax.maps.sweep import Sweep
from vibrojax.pictures.axes import axis, margins, share_text, value_text
from vibrojax.pictures.overlays import ANY, axes_of, beyond, border_layers
from vibrojax.pictures.plots import Plot, Sheet, Text
from vibrojax.studies.analysis import PictureRule, Source, SummaryPart
from vibrojax.studies.border_run import Regions, line_of, plane_axes
from vibrojax.studies.sweep_analysis import SweepAnalysis

_PANEL = (3.3, 3.0)  # inches
_MOST_SHOWN = 4  # largest numbers of rows and of columns


def border_curves(ds: xr.Dataset) -> Sheet:
    """Draw the borders of stable single impacts over two parameters.

    The figure has a row for each plane and a column for each initial condition.
    """
    x, y = axes_of(ds)
    others = beyond(ds)
    planes = [tuple(float(ds[f"region_{name}"][k]) for name in others) for k in range(ds.sizes["region"])]
    starts = ds["region_start"].values.tolist() if "region_start" in ds.coords else [ANY] * len(planes)
    areas = dict(reversed(list(zip(zip(planes, starts, strict=True), ds["region_area"].values.tolist(), strict=True))))
    rows, columns = list(dict.fromkeys(planes)), list(dict.fromkeys(starts))
    shown_rows, shown_columns = rows[:_MOST_SHOWN], [*columns[:-1][: _MOST_SHOWN - 1], columns[-1]]
    plots = []
    for k, (plane, start) in enumerate(product(shown_rows, shown_columns)):
        values = dict(zip(others, plane, strict=True))
        layers = border_layers(ds, values, start, x, y)
        words = [value_text(ds[name], value) for name, value in values.items()]
        words.append("any start" if start == ANY else f"start {start}")
        title = f"{', '.join(words)}: {share_text(areas[plane, start])} of the plane"
        if not layers:
            text = "no border" + (": a single impact is stable everywhere" if areas[plane, start] > 0.5 else "")
            layers = [Text(0.5, 0.5, fill(text, 24), relative=True)]
        across, up = axis(ds[x], group="x", intervals=6), axis(ds[y], group="y")
        plots.append(Plot(layers, across, up, title, divmod(k, len(shown_columns)), values))
    hidden = len(rows) - len(shown_rows), len(columns) - len(shown_columns)
    about = "Share of the plane: where a single impact is stable; any start: however its orbit is reached"
    missing = f"Not shown: {counted(hidden[0], 'plane')}, {counted(hidden[1], 'start')}" if any(hidden) else ""
    widths, heights = (1.0,) * len(shown_columns), (1.0,) * len(shown_rows)
    size = _PANEL[0] * len(widths) + 1.6, _PANEL[1] * len(heights) + 0.6
    return Sheet(plots, size, widths, heights, **margins(ds, about, missing))


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
    at: str | None = field(
        default=None,
        metadata={
            "metavar": "NAME=VALUE",
            "help": "locate where continued borders pass this value of one of the two parameters",
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
        self._line(sweep)
        return sweep

    def _line(self, sweep: Sweep) -> tuple[str, float] | None:
        at: dict[str, object] | None = None
        if self.at is not None:
            name, _, text = self.at.partition("=")
            at = {name.strip(): text}
            with suppress(ValueError):  # `line_of` reports the text
                at[name.strip()] = float(text)
        return line_of(sweep, plane_axes(sweep, self.axes), at)

    def identity(self, sweep: Sweep) -> dict[str, object]:
        """Return the axes of the plane, on which the result depends."""
        line = self._line(sweep)
        return {self.kind: [*plane_axes(sweep, self.axes), *(line or ())]}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the borders; `lanes`: dataset of the sweep with orbits."""
        return Regions(sweep, lanes, plane_axes(sweep, self.axes)).borders(self._line(sweep), progress)

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
        names = axes_of(ds)
        crossings: list[dict[str, object]] = []
        for k in range(ds.sizes.get("crossing", 0)):
            kind = meanings[int(ds["kind"][int(ds["crossing_curve"][k])])]
            place = {name: float(ds[f"crossing_{name}"][k]) for name in names}
            crossings.append({"kind": kind, **place})
            lines.append(f"crossing of a {kind} at {', '.join(f'{name} = {x:.9g}' for name, x in place.items())}")
        about = {"begun_from": printable(ds.attrs["begun_from"], 300)} if "begun_from" in ds.attrs else {}
        lines += about.values()
        return [SummaryPart("borders", lines, {"borders": facts, "crossings": crossings, **about})]
