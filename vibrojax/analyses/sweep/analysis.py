"""The analysis `sweep`: pictures and summary of datasets over a parameter space."""

from collections.abc import Sequence

import xarray as xr
from matplotlib.figure import Figure

from vibrojax.analyses.analysis import Analysis, PictureRule, Source
from vibrojax.analyses.sweep.basins import many_starts
from vibrojax.analyses.sweep.maps import rate_grid, regime_grid
from vibrojax.analyses.sweep.rates import rates
from vibrojax.analyses.sweep.returns import bifurcation, hysteresis
from vibrojax.analyses.sweep.run import run_sweep
from vibrojax.analyses.sweep.scatter import rate_scatter, regime_bars, regime_scatter
from vibrojax.analyses.sweep.strips import regime_lines
from vibrojax.errors import InputError
from vibrojax.io.kinds import kind_of
from vibrojax.plot.contents import contents
from vibrojax.plot.overlays import refuse_overlays


class Sweeps(Analysis):
    """Run a sweep file: a dataset with the regime of each lane, and a picture of it."""

    kind = "sweep"
    pictures = (
        PictureRule("returns", lambda held: held.carried, hysteresis),
        PictureRule("returns", lambda held: held.returns, bifurcation),
        PictureRule("starts", lambda held: held.regimes and held.many_starts, many_starts),
        PictureRule("rates", lambda held: held.rates and not held.worth_a_map, rates),
        PictureRule("regimes", lambda held: held.regimes and held.points_over_two, regime_scatter),
        PictureRule("regimes", lambda held: held.regimes and len(held.axes) > 1, regime_grid),
        PictureRule("regimes", lambda held: held.regimes and held.quantities_over_one, regime_lines),
        PictureRule("regimes", lambda held: held.regimes, regime_bars),
        PictureRule("rate map", lambda held: held.rates and held.points, rate_scatter),
        PictureRule("rate map", lambda held: held.rates, rate_grid),
    )

    def run(self, source: Source, progress: bool = True) -> xr.Dataset:
        """Run a sweep and return its dataset, as [vibrojax.analyses.sweep.run.run_sweep][] does."""
        return run_sweep(source, progress=progress)

    def picture(self, ds: xr.Dataset, over: Sequence[xr.Dataset] = ()) -> Figure:
        """Return the picture of a sweep; `over`: borders on its regime map, or families on its section crossings."""
        if not over:
            return super().picture(ds)
        held = contents(ds)
        if any(isinstance(layer, xr.Dataset) and kind_of(layer) == "borders" for layer in over):
            if len(over) > 1:
                raise InputError("over: borders are laid over a map one dataset at a time; give one")
            if not held.regimes or held.points or len(held.axes) < 2:
                refuse_overlays(over, "the dataset holds none")
            return regime_grid(ds, over=over[0])
        if held.carried:
            return hysteresis(ds, tuple(over))
        return bifurcation(ds, tuple(over)) if held.returns else super().picture(ds, over)
