"""What a trajectory's dataset holds, read once: arrays in SI, what stuck, and when the striker hit."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.plot._about import parameters_of

_STATES = ("x1", "v1", "x2", "v2")
_FEWEST = 16


@dataclass(frozen=True)
class Motion:
    """A trajectory in SI units.

    `v` [m/s] and `delta` [m] are None where the dataset does not say them; `impact_force` [N] is None where the scene
    has no impacts; `impacts` are the times [s] at which impacts begin.
    """

    time: np.ndarray
    x1: np.ndarray
    v1: np.ndarray
    x2: np.ndarray
    v2: np.ndarray
    friction_force: np.ndarray | None
    impact_force: np.ndarray | None
    stuck: np.ndarray
    impacts: np.ndarray
    v: float | None
    delta: float | None

    @property
    def u(self) -> np.ndarray:
        """The bit's sliding speed on the rock [m/s]; relative to the drive where the drive's speed is not known."""
        return self.v1 + (self.v or 0.0)

    def since(self, start: float) -> slice:
        """The samples from the time `start` [s] on."""
        return slice(int(np.searchsorted(self.time, start)), None)

    def at(self, times: np.ndarray, values: np.ndarray) -> np.ndarray:
        """`values` at `times`, by linear interpolation."""
        return np.interp(times, self.time, values)


def read_motion(ds: xr.Dataset) -> Motion:
    """The motion in `ds`; raises `InputError` where it lacks bit or striker, or is no more than a few samples."""
    missing = [name for name in _STATES if name not in ds]
    if missing or "time" not in ds.dims:
        lacking = ", ".join(missing) or "dimension time"
        raise InputError(f"no trajectory to draw: the dataset lacks {lacking}")
    ds = ds.isel(time=np.flatnonzero(np.isfinite(sum(ds[name].values for name in _STATES))))
    if ds.sizes["time"] < _FEWEST:
        raise InputError(f"no trajectory to draw: {ds.sizes['time']} finite samples, {_FEWEST} or more are needed")
    parameters = parameters_of(ds)
    force = _values(ds, "impact_force")
    stuck = _values(ds, "stuck")
    bit_and_striker = (np.asarray(ds[name].values, float) for name in ("time", *_STATES))
    return Motion(
        *bit_and_striker,
        friction_force=_values(ds, "friction_force"),
        impact_force=force,
        stuck=np.zeros(ds.sizes["time"], bool) if stuck is None else stuck == 1,
        impacts=_impacts(ds, force),
        v=parameters.get("v"),
        delta=None if force is None else parameters.get("delta"),
    )


def _values(ds: xr.Dataset, name: str) -> np.ndarray | None:
    return np.asarray(ds[name].values, float) if name in ds else None


def _impacts(ds: xr.Dataset, force: np.ndarray | None) -> np.ndarray:
    """When impacts begin: from the events, or from where the force rises from zero."""
    if "event_time" in ds and "event_kind" in ds:
        meanings = str(ds["event_kind"].attrs.get("flag_meanings", "stick slip impact release section")).split()
        flags = np.atleast_1d(ds["event_kind"].attrs.get("flag_values", range(1, 1 + len(meanings)))).tolist()
        wanted = [flag for flag, meaning in zip(flags, meanings, strict=False) if meaning == "impact"]
        return np.asarray(ds["event_time"].values, float)[np.isin(ds["event_kind"].values, wanted)]
    if force is None:
        return np.empty(0)
    rises = 1 + np.flatnonzero((force[1:] > 0) & (force[:-1] <= 0))
    return np.asarray(ds["time"].values, float)[rises]
