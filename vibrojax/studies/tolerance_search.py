"""The search of `tolerance` for points of the box that are more extreme than its samples."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from jaxtyping import Float

QUANTITIES = (
    "impact_velocity",
    "impact_energy",
    "impact_power",
    "period",
    "peak_impact_force",
    "rate_of_penetration",
    "specific_energy",
)
"""Variables whose least and greatest value of the samples is stored."""

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


def refine(
    units: Units, ds: xr.Dataset, simulate: Callable[[Units], xr.Dataset]
) -> tuple[xr.Dataset, Float[np.ndarray, "kept dimensions"], int]:
    """Return the samples and, after them, the points that are more extreme; their places; and how many were tried.

    For each start and quantity, a search begins at the least and at the greatest sample. Its points are a step along
    each parameter, and one in all parameters, in the directions that the sensitivities near the best point predict.
    Each point is simulated, so that an extreme is never only predicted. Irregular motions are left out, because their
    extremes depend on the time of observation.
    """
    first, parts = len(units), [ds]
    best, steps = np.array(-1), np.array(FIRST_STEP)
    for _ in range(MAX_ROUNDS):
        goals = np.concatenate([_goals(part) for part in parts], axis=1)
        known = ~np.isnan(goals).all(axis=1)
        greatest = np.where(known, np.where(np.isnan(goals), -np.inf, goals).argmax(axis=1), -1)
        steps = np.where(known & (greatest == best), SHRINKAGE * steps, steps)
        best = greatest
        active = np.flatnonzero(known & (steps >= LEAST_STEP))
        proposals = [_proposals(units, goals[k], int(best[k]), float(steps[k])) for k in active]
        points = np.unique(np.round(np.concatenate([units[:0], *proposals]), 12), axis=0)
        apart = np.abs(points[:, None] - units[None]).max(axis=2).min(axis=1, initial=np.inf)
        points = points[apart > SAME_POINT]
        if len(points):
            parts.append(simulate(points))
            units = np.concatenate([units, points])
        elif not len(active):
            break
    added, tried = np.unique(best[best >= first]), len(units) - first
    if not len(added):
        return ds, units[:first], tried
    kept = [*range(first), *added.tolist()]
    whole = xr.concat(parts, "point", data_vars="minimal", join="override", combine_attrs="override")
    numbered = {"point": np.arange(len(kept))} if "point" in whole.coords else {}  # each part has its own numbers
    return whole.isel(point=kept).assign_coords(numbered), units[kept], tried


def _goals(ds: xr.Dataset) -> Float[np.ndarray, "searches samples"]:
    """Return what each search maximises: each quantity from each start, and its negative; NaN unless periodic."""
    periodic = [ds[name].where(ds["cycles"] > 0).transpose("point", ...) for name in QUANTITIES if name in ds]
    columns = np.concatenate([x.values.reshape(ds.sizes["point"], -1) for x in periodic], axis=1)
    return np.concatenate([columns, -columns], axis=1).T


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
