"""Search from the extreme samples of a tolerance box for points that are more extreme."""

import json
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.maps.dataset import attributes, certified
from vibrojax.maps.run import run_sweep
from vibrojax.maps.sweep import Sweep

FIRST_STEP, LEAST_STEP = 0.25, 0.01
"""First and smallest step of the search, in half-widths: at the least step a smooth extreme is exact to 1e-4 of the
change over the box."""

SHRINKAGE = 0.4
"""Factor of the step after a round that found nothing more extreme."""

MAX_ROUNDS = 12
"""Limit of the rounds, each of which is one batch of lanes."""

SAME_POINT = 1e-9
"""Distance in half-widths within which two points count as one."""

Units = Float[np.ndarray, "samples dimensions"]


@runtime_checkable
class Box(Protocol):
    """The box of tolerances: sweeps over points of it, in half-widths from the nominal point."""

    def sweep_over(self, units: Units) -> Sweep: ...
    def written_over(self, units: Units) -> Sweep: ...


def refine(box: Box, units: Units, ds: xr.Dataset, quantities: Sequence[str]) -> tuple[xr.Dataset, int, int]:
    """Return the samples and, after them, the points that are more extreme; and how many points were tried and added.

    For each start and quantity, a search begins at the least and at the greatest sample. Its points are a step along
    each parameter, and one in all parameters, in the directions that the sensitivities near the best point predict.
    Each point is simulated, so that an extreme is never only predicted. Irregular motions are left out, because their
    extremes depend on the time of observation.
    """
    names = [name for name in quantities if name in ds]
    first, parts = len(units), [ds]
    steps: dict[tuple[str, int, float], tuple[int, float]] = {}
    for _ in range(MAX_ROUNDS):
        values = {name: np.concatenate([_periodic(part, name) for part in parts]) for name in names}
        points = np.zeros((0, units.shape[1]))
        for name, x in values.items():
            for start in range(x.shape[1]):
                for sign in (1.0, -1.0):
                    y = sign * x[:, start]
                    if not np.isfinite(y).any():
                        continue
                    best = int(np.nanargmax(y))
                    before, step = steps.get((name, start, sign), (best, FIRST_STEP))
                    step *= SHRINKAGE if (name, start, sign) in steps and before == best else 1.0
                    steps[name, start, sign] = best, step
                    if step >= LEAST_STEP:
                        points = np.concatenate([points, _proposals(units, y, best, step)])
        points = np.unique(np.round(points, 12), axis=0)
        apart = np.abs(points[:, None] - units[None]).max(axis=2).min(axis=1, initial=np.inf)
        points = points[apart > SAME_POINT]
        if len(points):
            parts.append(run_sweep(box.sweep_over(points), progress=False))
            units = np.concatenate([units, points])
        elif all(step < LEAST_STEP for _, step in steps.values()):
            break
    added = sorted({best for best, _ in steps.values() if best >= first})
    if added:
        whole = xr.concat(parts, "point", data_vars="minimal", join="override", combine_attrs="override")
        kept = [*range(first), *added]
        ds = _with_attributes(box.written_over(units[kept]), whole.isel(point=kept))
    return ds, len(units) - first, len(added)


def _periodic(ds: xr.Dataset, name: str) -> Float[np.ndarray, "samples starts"]:
    """Return a quantity (samples, starts), NaN for motions that do not repeat."""
    x = ds[name].where(ds["cycles"] > 0).transpose("point", ...).values
    return np.asarray(x.reshape(len(x), -1))


def _proposals(
    units: Units, y: Float[np.ndarray, " samples"], best: int, step: float
) -> Float[np.ndarray, "points dimensions"]:
    """Return points of the box around the sample `best` at which `y` may be greater.

    The sensitivities are those of a linear fit to the nearest samples.
    """
    here, count = units[best], units.shape[1]
    known = np.flatnonzero(np.isfinite(y))
    near = known[np.argsort(np.abs(units[known] - here).max(axis=1), kind="stable")][: 2 * count + 2]
    slope = np.linalg.lstsq(units[near] - here, y[near] - y[best])[0]
    moves = np.concatenate([np.eye(count), -np.eye(count), np.sign(slope)[None]])
    return np.asarray(np.clip(here + step * moves, -1.0, 1.0))


def _with_attributes(sweep: Sweep, ds: xr.Dataset) -> xr.Dataset:
    """Return the dataset with the attributes of the sweep over all its points."""
    counts = certified(sweep, {str(name): x.values for name, x in ds.data_vars.items()})
    return ds.assign_attrs(attributes(sweep, json.loads(ds.attrs["solver"]), counts, ds.attrs["wall_time_s"]))
