"""What a trajectory's dataset holds of bit and rock, read once: arrays in SI, and when blows begin."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.plot._about import parameters_of

_FEWEST = 16
_LONGEST = 0.1  # [s] of what is shown of a blow
_AT_REST = 0.01  # of its greatest speed
_LEAD = 0.15  # of a blow's time, shown before it


@dataclass(frozen=True)
class Blows:
    """A run of the bit on the rock, in SI units; a force is None where the dataset lacks it, as is `threshold`."""

    time: np.ndarray
    x3: np.ndarray
    x4: np.ndarray
    v3: np.ndarray
    applied_force: np.ndarray | None
    rock_force: np.ndarray | None
    threshold: float | None

    def between(self, start: float, end: float) -> slice:
        """The samples from `start` to `end` [s], and the last one before."""
        return slice(max(int(np.searchsorted(self.time, start)) - 1, 0), int(np.searchsorted(self.time, end)) + 1)

    @property
    def begun(self) -> np.ndarray:
        """When the force on the bit rises through half of its range [s]; that of the rock where none is given."""
        force = self.applied_force if self.applied_force is not None else self.rock_force
        if force is None or not np.ptp(force) > 0:
            return np.empty(0)
        above = force > (force.max() + force.min()) / 2
        return self.time[1:][above[1:] & ~above[:-1]]

    @property
    def depth(self) -> float:
        """How much the hole has grown [m]."""
        return float(self.x4[-1] - self.x4[0])


def read_blows(ds: xr.Dataset) -> Blows:
    """The run in `ds`; raises `InputError` where it lacks bit or hole, or is no more than a few samples."""
    missing = [name for name in ("x3", "x4") if name not in ds]
    if missing or "time" not in ds.dims:
        raise InputError(f"no trajectory to draw: the dataset lacks {', '.join(missing) or 'dimension time'}")
    ds = ds.isel(time=np.flatnonzero(np.isfinite(ds["x3"].values + ds["x4"].values)))
    if ds.sizes["time"] < _FEWEST:
        raise InputError(f"no trajectory to draw: {ds.sizes['time']} finite samples, {_FEWEST} or more are needed")
    time, x3, x4 = (np.asarray(ds[name].values, float) for name in ("time", "x3", "x4"))
    v3 = np.asarray(ds["v3"].values, float) if "v3" in ds else np.gradient(x3, time)
    forces = (np.asarray(ds[name].values, float) if name in ds else None for name in ("applied_force", "rock_force"))
    return Blows(time, x3, x4, v3, *forces, parameters_of(ds).get("threshold"))


def last_blow(blows: Blows, impacts: np.ndarray) -> tuple[float, float] | None:
    """From a little before the last of the times `impacts` [s] in which the bit moved, to when it is at rest again."""
    end = float(blows.time[-1])
    for begun in impacts[::-1]:
        after = blows.between(float(begun), min(float(begun) + _LONGEST, end))
        speed = np.abs(blows.v3[after])
        moving = np.flatnonzero(speed > _AT_REST * speed.max(initial=0.0))
        if moving.size and moving[-1] < speed.size - 1:
            rest = float(blows.time[after][moving[-1]])
            return float(begun) - _LEAD * (rest - float(begun)), rest + 2 * _LEAD * (rest - float(begun))
    return None
