"""A map of few short lanes for tests of display. It is computed once."""

from functools import cache

import xarray as xr

import vibrojax as vj

SWEEP = {
    "scene": "vibro-impact",
    "grid": {"beta": [0.3, 0.35, 0.4], "gamma": [0.65, 0.7, 0.75, 0.8]},
    "run": {"settle": 6.0, "observe": 4.0},
}


@cache
def small_map() -> xr.Dataset:
    return vj.run_sweep(SWEEP, progress=False)
