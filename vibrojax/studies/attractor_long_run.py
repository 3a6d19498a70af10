"""Statistics of irregular lanes, which are observed until their statistics have converged.

A lane is observed in consecutive windows, each as long as the sweep's `observe`. Standard errors follow from batches of
windows (batch means: Law, *Simulation Modeling and Analysis*, section 9.5.3). Batches grow with the observation until
they exceed the correlation time, because a bursting motion may rest for several windows.
"""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.lanes.inputs import Features, Index
from vibrojax.maps.sweep import Sweep
from vibrojax.periodic.lane_stages import lane_run
from vibrojax.progress import Progress, quiet
from vibrojax.studies.attractor_grouping import IRREGULAR_WITHIN, RESOLUTION_STDERRS, STATISTICS, stderr_name

BATCHES = 8
"""Number of batches for a standard error, which is then accurate to about a quarter."""

FEWEST_WINDOWS, MOST_WINDOWS = BATCHES, 16 * BATCHES
"""Number of windows of the shortest and of the longest observation. The number doubles in between."""

SPLIT_MIN_WINDOWS = 8 * FEWEST_WINDOWS
"""Least number of windows if irregular lanes of a point differ: one may have rested during the shortest observation."""

CONVERGED_STDERR = float(np.log1p(IRREGULAR_WITHIN)) / RESOLUTION_STDERRS
"""Greatest relative standard error of a converged statistic: `RESOLUTION_STDERRS` of it equal the resolution."""

ORBIT_WINDOWS_FRACTION = 4
"""A lane has reached an orbit if it is periodic in every window of the last quarter; this is the divisor."""

LANES_TOGETHER = 4096
"""Greatest number of lanes that are stepped together, which bounds memory use."""

Windows = Float[np.ndarray, "windows fields lanes"]
"""Fields per window: total of each statistic, count of each, the lane's cycles, and 1 if it is finite and finished."""


class Statistics(NamedTuple):
    """Statistics of lanes, their relative standard errors, and which lanes have converged."""

    values: Float[np.ndarray, "statistics lanes"]
    errors: Float[np.ndarray, "statistics lanes"]
    converged: Bool[np.ndarray, " lanes"]


def with_long_statistics(
    sweep: Sweep, dataset: xr.Dataset, lanes: Index, fewest: int = FEWEST_WINDOWS, progress: bool = True
) -> xr.Dataset:
    """Return the dataset of `sweep` with statistics of `lanes` (indices) over at least `fewest` windows.

    The relative standard errors of the statistics and `converged` are added. `converged` is False if an error exceeds
    `CONVERGED_STDERR` after `MOST_WINDOWS` windows, or if the lane has reached an orbit.
    """
    names = [name for name in STATISTICS if name in dataset]
    shape = len(names), len(lanes)
    long = Statistics(np.full(shape, np.nan), np.zeros(shape), np.zeros(len(lanes), bool))
    with quiet(), Progress(len(lanes), "irregular lanes", progress and len(lanes) > 0) as bar:
        for first in range(0, len(lanes), LANES_TOGETHER):
            part = slice(first, first + LANES_TOGETHER)
            _observe(sweep, lanes[part], Statistics(*(x[..., part] for x in long)), names, fewest, bar)
    regime = dataset["regime"]

    def updated(name: str, values: np.ndarray, fill: object) -> xr.DataArray:
        before = dataset[name] if name in dataset else xr.full_like(regime, fill, values.dtype)
        column = before.values.ravel().copy()
        column[lanes] = values
        return before.copy(data=column.reshape(regime.shape))

    variables = {"converged": updated("converged", long.converged, True)}
    for name, values, errors in zip(names, long.values, long.errors, strict=True):
        variables |= {name: updated(name, values, np.nan), stderr_name(name): updated(stderr_name(name), errors, 0.0)}
    return dataset.assign(variables)


def _observe(sweep: Sweep, lanes: Index, result: Statistics, names: list[str], fewest: int, bar: Progress) -> None:
    """Enter the statistics of `lanes` in `result`; each is observed until they converge or cannot converge."""
    now, length = sweep.run.settle, sweep.run.observe
    inputs = sweep.inputs_of(lanes)
    run = lane_run(inputs, sweep.plan)
    batch = run.before_observation(inputs)
    active, count = np.arange(len(lanes)), fewest
    windows: list[np.ndarray] = []
    while len(active):
        while len(windows) < count:
            [batch] = run.engine.settle([batch.observed(now, np.full(len(active), length))])
            windows.append(_window(run.engine.observe([batch])[0], names))
            now += length
        stacked = np.stack(windows)
        found = statistics(stacked)
        done = found.converged | on_orbits(stacked) | ~_sound(stacked) | (count >= MOST_WINDOWS)
        for whole, part in zip(result, found, strict=True):
            whole[..., active[done]] = part[..., done]
        bar.add(int(done.sum()))
        batch, active, count = batch.of(np.flatnonzero(~done)), active[~done], 2 * count
        windows = [window[:, ~done] for window in windows]


def _window(features: Features, names: list[str]) -> Float[np.ndarray, "fields lanes"]:
    """Return the fields (see `Windows`) of one window from its features."""
    returns = np.maximum(features["returns"] - 1, 0.0)
    impacts = features.get("impacts", np.zeros_like(returns)) * returns / np.maximum(features["cycles"], 1)
    weight = {"period": returns, "impact_velocity": impacts}
    counts = [np.nan_to_num(weight.get(name, np.ones_like(returns))) for name in names]
    totals = [np.nan_to_num(features[name]) * count for name, count in zip(names, counts, strict=True)]
    return np.stack([*totals, *counts, features["cycles"], features["finite"] & features["finished"]]).astype(float)


def statistics(windows: Windows) -> Statistics:
    """Return the statistics over all windows, with standard errors from batches of windows."""
    each = windows.reshape(BATCHES, -1, *windows.shape[1:]).sum(axis=1)
    totals, counts = np.split(each[:, :-2], 2, axis=1)
    total = totals.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = total / counts.sum(axis=0)
        residual = totals - values * counts
        errors = np.sqrt(np.sum(residual**2, axis=0) * BATCHES / (BATCHES - 1)) / np.abs(total)
    errors = np.where(total == 0, 0.0, errors)
    precise = np.all(errors <= CONVERGED_STDERR, axis=0)
    return Statistics(values, errors, precise & _sound(windows) & ~on_orbits(windows))


def on_orbits(windows: Windows) -> Bool[np.ndarray, " lanes"]:
    """Return which lanes have reached an orbit, so that they had not settled when the sweep labelled them."""
    return np.all(windows[-(len(windows) // ORBIT_WINDOWS_FRACTION) :, -2] > 0, axis=0)


def _sound(windows: Windows) -> Bool[np.ndarray, " lanes"]:
    return np.all(windows[:, -1] > 0, axis=0)
