"""The analysis `attractors`: coexisting attractors of a sweep, and the fraction of initial conditions of each."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from vibrojax.analyses.analysis import PictureRule, Source, SummaryPart
from vibrojax.analyses.attractors.run import attractors_of, sweep_of
from vibrojax.analyses.attractors.shares import attractor_shares, share_map
from vibrojax.analyses.orbits.analysis import SweepAnalysis
from vibrojax.io.attributes import flags
from vibrojax.io.kinds import OF_ATTRACTORS
from vibrojax.sweep.input.definition import Sweep

_SHOWN = 12
"""Greatest number of attractors that are listed one by one."""


@dataclass(frozen=True)
class Attractors(SweepAnalysis):
    """Attractors that a sweep's initial conditions lead to, and the fraction of initial conditions of each."""

    kind = "attractors"
    counted = "attractor"
    variables = OF_ATTRACTORS
    pictures = (
        PictureRule("attractors", lambda held: held.wide, share_map),
        PictureRule("attractors", lambda held: True, attractor_shares),
    )

    def sweep(self, source: Source) -> Sweep:
        """Return the validated sweep; raise `InputError` if the analysis does not apply to it."""
        return sweep_of(source)

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the attractors of a sweep, from the dataset `lanes` with orbits."""
        return attractors_of(sweep, lanes, progress)

    def summary(self, ds: xr.Dataset) -> list[SummaryPart]:
        """Summarise how many attractors coexist at how many points, and fraction, points and regimes of each."""
        grid = [name for name in ds["share"].dims if name != "attractor"]
        unassigned, lanes = int(ds["unassigned"].sum()), ds["lane_attractor"].size
        share = ds["share"].values.reshape(ds["unassigned"].size, ds.sizes["attractor"])
        numbers, counts = np.unique((share > 0).sum(axis=1), return_counts=True)
        points = ", ".join(f"{number} at {count}" for number, count in zip(numbers, counts, strict=True))
        lines = [
            f"at a point: {points} (attractors at points)",
            f"{unassigned} of {lanes} lanes unassigned ({100 * unassigned / max(lanes, 1):.1f} %)",
        ]
        regime, meanings = ds["regime"].values.reshape(share.shape), flags(ds["regime"])
        for number in range(min(share.shape[1], _SHOWN)):
            mask = share[:, number] > 0
            kinds, sizes = np.unique(regime[mask, number], return_counts=True)
            names = ", ".join(meanings[int(kinds[k])] for k in np.argsort(-sizes, kind="stable"))
            percent = 100 * share[:, number].mean()
            lines.append(f"{number:>4}{percent:>7.1f} % of starts{int(mask.sum()):>7} points  {names}")
        if share.shape[1] > _SHOWN:
            lines.append(f"and {share.shape[1] - _SHOWN} more of smaller shares")
        facts = {"shares": ds["share"].mean(grid).values, "unassigned": unassigned}
        return [SummaryPart("shares", lines, {"attractors": facts})]
