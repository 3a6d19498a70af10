"""Analyses of the lanes of a sweep and their periodic orbits."""

import xarray as xr

from vibrojax.analyses.analysis import Analysis, Source
from vibrojax.analyses.orbits.rerun import orbits
from vibrojax.sweep.input.definition import Sweep


class SweepAnalysis(Analysis):
    """An analysis of the lanes of a sweep and their periodic orbits, whose finished chunks survive an interrupt."""

    def sweep(self, source: Source) -> Sweep:
        """Return the sweep of `source`, checked; raise `InputError` where it cannot be analysed."""
        raise NotImplementedError

    def identity(self, sweep: Sweep) -> dict[str, object]:
        """Return what the result depends on besides the sweep, as flat JSON values."""
        return {self.kind: True}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the result, from the dataset of the sweep with orbits."""
        raise NotImplementedError

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the analysis; a source without orbits is run (again) first."""
        sweep = self.sweep(source)
        return self.of_lanes(sweep, orbits(source if isinstance(source, xr.Dataset) else sweep, progress), progress)
