"""Statistics of irregular lanes, observed until they have converged.

A lane is observed in windows as long as the sweep's `observe`, one after the other. The standard error of a statistic
follows from batches of windows. The batches grow with the observation, so that they exceed the correlation time of the
motion in the end: a bursting motion may rest for several windows (batch means: Law, *Simulation Modeling and Analysis*,
section 9.5.3).
"""

from itertools import chain
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from vibrojax.analyses.attractors.grouping import ERRORS, IRREGULAR_WITHIN, STATISTICS, stderr_name
from vibrojax.analyses.sweep.workers.work import Work, quiet
from vibrojax.progress import Progress
from vibrojax.sweep.engine.batch import Batch, Features
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.engine.underway import looks
from vibrojax.sweep.input.definition import Sweep

BATCHES = 8
"""Batches of a standard error, which is then good to a quarter."""

FEWEST_WINDOWS, MOST_WINDOWS = BATCHES, 16 * BATCHES
"""Windows of the shortest and of the longest observation. The number doubles in between."""

WINDOWS_AT_A_SPLIT = 8 * FEWEST_WINDOWS
"""The fewest windows where irregular lanes of a point differ: one of them may have rested for all of the shortest."""

LEAST_PRECISION = float(np.log1p(IRREGULAR_WITHIN)) / ERRORS
"""Relative standard error up to which a statistic has converged: `ERRORS` of them do not exceed the resolution."""

LATE = 4
"""A lane that repeats in all windows of the last quarter has come to an orbit."""

TOGETHER = 4096
"""Lanes that are stepped together, to bound memory."""

Index = Int[np.ndarray, " lanes"]
Window = Float[np.ndarray, "fields lanes"]
"""For each statistic a total, then for each what it counts over, then the lane's cycles and whether it is sound."""


class Statistics(NamedTuple):
    """Statistics of lanes: their values and relative standard errors, and which lanes have converged."""

    values: Float[np.ndarray, "statistics lanes"]
    errors: Float[np.ndarray, "statistics lanes"]
    converged: Bool[np.ndarray, " lanes"]


def with_long_statistics(
    sweep: Sweep, dataset: xr.Dataset, lanes: Index, fewest: int = FEWEST_WINDOWS, progress: bool = True
) -> xr.Dataset:
    """Return the dataset of `sweep` with the statistics of `lanes`, by index, over at least `fewest` windows.

    Relative standard errors stand beside the statistics. `converged` is False where an error exceeds `LEAST_PRECISION`
    after `MOST_WINDOWS` windows, and where a lane has come to an orbit.
    """
    names = [name for name in STATISTICS if name in dataset]
    none = np.zeros((len(names), 0))
    parts = [Statistics(none, none, np.zeros(0, bool))]
    with quiet(), Progress(len(lanes), "irregular lanes", progress and len(lanes) > 0) as shown:
        for first in range(0, len(lanes), TOGETHER):
            parts.append(_observed(Work(sweep).chunks, names, lanes[first : first + TOGETHER], fewest, shown))
    found = _joined(parts)
    regime = dataset["regime"]

    def entered(name: str, values: np.ndarray, fill: object) -> xr.DataArray:
        before = dataset[name] if name in dataset else xr.full_like(regime, fill, values.dtype)
        column = before.values.ravel().copy()
        column[lanes] = values
        return before.copy(data=column.reshape(regime.shape))

    variables = {"converged": entered("converged", found.converged, True)}
    for name, values, errors in zip(names, found.values, found.errors, strict=True):
        variables |= {name: entered(name, values, np.nan), stderr_name(name): entered(stderr_name(name), errors, 0.0)}
    return dataset.assign(variables)


def _observed(chunks: Chunks, names: list[str], lanes: Index, fewest: int, shown: Progress) -> Statistics:
    """Return the statistics of the `lanes`, each observed until it has converged or cannot converge."""
    now, length = chunks.sweep.run.settle, chunks.sweep.run.observe
    batch = _settled(chunks, lanes)
    active, wanted = np.arange(len(lanes)), fewest
    windows: list[Window] = []
    order: list[Index] = []
    parts: list[Statistics] = []
    while len(active):
        while len(windows) < wanted:
            [batch] = chunks.engine.settle([batch.observed(now, np.full(len(active), length))])
            windows.append(_window(chunks.engine.observe([batch])[0], names))
            now += length
        held = np.stack(windows)
        found = statistics(held)
        over = found.converged | on_orbits(held) | ~_sound(held) | (wanted >= MOST_WINDOWS)
        order.append(active[over])
        parts.append(Statistics(*(x[..., over] for x in found)))
        shown.add(int(over.sum()))
        batch, active, wanted = batch.of(np.flatnonzero(~over)), active[~over], 2 * wanted
        windows = [window[:, ~over] for window in windows]
    return Statistics(*(x[..., np.argsort(np.concatenate(order))] for x in _joined(parts)))


def _settled(chunks: Chunks, lanes: Index) -> Batch:
    """Return the `lanes` at the time from which the sweep observes them, stepped as the sweep steps them."""
    chunks.compile()
    batches = []
    for index in np.unique(lanes // chunks.size):
        first, end = chunks.lanes(int(index))
        own = lanes[(first <= lanes) & (lanes < end)] - first
        batches.append(chunks.engine.start(first, end, chunks.accuracy).of(own))
    batch = batches[0].joined(batches[1:])
    for now in chain(*looks(chunks.sweep.run, chunks.ends_on_orbits)):
        [batch] = chunks.engine.settle([batch], now)
    return batch


def _window(features: Features, names: list[str]) -> Window:
    """Return the totals of a window, what they count over, cycles, and soundness."""
    returns = np.maximum(features["returns"] - 1, 0.0)
    impacts = features.get("impacts", np.zeros_like(returns)) * returns / np.maximum(features["cycles"], 1)
    weight = {"period": returns, "impact_velocity": impacts}
    counts = [np.nan_to_num(weight.get(name, np.ones_like(returns))) for name in names]
    totals = [np.nan_to_num(features[name]) * count for name, count in zip(names, counts, strict=True)]
    return np.stack([*totals, *counts, features["cycles"], features["finite"] & features["finished"]]).astype(float)


def statistics(windows: Float[np.ndarray, "windows fields lanes"]) -> Statistics:
    """Return the statistics over all windows, with their standard errors by batches of windows."""
    each = windows.reshape(BATCHES, -1, *windows.shape[1:]).sum(axis=1)
    totals, counts = np.split(each[:, :-2], 2, axis=1)
    total = totals.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = total / counts.sum(axis=0)
        residual = totals - values * counts
        errors = np.sqrt(np.sum(residual**2, axis=0) * BATCHES / (BATCHES - 1)) / np.abs(total)
    errors = np.where(total == 0, 0.0, errors)
    precise = np.all(errors <= LEAST_PRECISION, axis=0)
    return Statistics(values, errors, precise & _sound(windows) & ~on_orbits(windows))


def on_orbits(windows: Float[np.ndarray, "windows fields lanes"]) -> Bool[np.ndarray, " lanes"]:
    """Return which lanes have come to an orbit: they had not settled when the sweep labelled them."""
    return np.all(windows[-(len(windows) // LATE) :, -2] > 0, axis=0)


def _sound(windows: Float[np.ndarray, "windows fields lanes"]) -> Bool[np.ndarray, " lanes"]:
    return np.all(windows[:, -1] > 0, axis=0)


def _joined(parts: list[Statistics]) -> Statistics:
    return Statistics(*(np.concatenate(x, axis=-1) for x in zip(*parts, strict=True)))
