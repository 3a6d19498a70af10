"""The interface of an analysis of the lanes of a sweep and their periodic orbits."""

import xarray as xr

from vibrojax.maps.rerun import orbits, sweep_with_orbits
from vibrojax.maps.sweep import Sweep
from vibrojax.studies.analysis import Analysis, Source


class SweepAnalysis(Analysis):
    """An analysis of the lanes of a sweep and their periodic orbits.

    A subclass provides `kind` and `of_lanes`. It overrides `sweep` to restrict the accepted sweeps, and `identity` if
    the result depends on settings. If the analysis is run as a command, the finished chunks of the sweep are kept until
    the result is written.

    **Example:** the fraction of lanes that settle on a stable orbit

    >>> class StableShare(vj.SweepAnalysis):
    ...     kind = "stable-share"
    ...     def of_lanes(self, sweep, lanes, progress=True):
    ...         return self.dataset({"share": ((), float((lanes.stable == 1).mean()))}, {}, title=sweep.title)
    >>> point = {"beta": 0.4, "gamma": 0.75, "delta": 0.005}
    >>> sweep = {"scene": "vibro-impact", "parameters": point, "starts": ["stuck"]}
    >>> vj.analyse(sweep, StableShare(), progress=False).share.item()
    1.0
    """

    def sweep(self, source: Source) -> Sweep:
        """Return the sweep of `source` with `orbits = true`; raise `InputError` if it cannot be analysed."""
        return sweep_with_orbits(source)

    def identity(self, sweep: Sweep) -> dict[str, object]:
        """Return the settings on which the result depends in addition to the sweep, as flat JSON values."""
        return {self.kind: True}

    def of_lanes(self, sweep: Sweep, lanes: xr.Dataset, progress: bool = True) -> xr.Dataset:
        """Return the result; `lanes`: dataset of the sweep with orbits."""
        raise NotImplementedError(f"{type(self).__name__}.of_lanes")

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Return the dataset of the analysis; unless `source` is a dataset with orbits, its sweep is run first."""
        sweep = self.sweep(source)
        return self.of_lanes(sweep, orbits(source if isinstance(source, xr.Dataset) else sweep, progress), progress)
