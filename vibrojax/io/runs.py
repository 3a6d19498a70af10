"""Runs: the time series of a trajectory, with the values before and after its events."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import InputError
from vibrojax.io.attributes import flags, parameters_of

_TIME, _FEWEST_SAMPLES = "time", 16

Samples = Float[np.ndarray, " samples"]


@dataclass(frozen=True)
class Run:
    """Time series of a run in SI units.

    - `series`: the variables along time by name.
    - `impacts`: times [s] at which impacts begin.
    - `parameters`: the parameters of the scene by name.
    """

    time: Samples
    series: Mapping[str, Samples]
    impacts: Float[np.ndarray, " times"]
    parameters: Mapping[str, float]

    def __getitem__(self, name: str) -> Samples:
        return self.series[name]

    def between(self, start: float, end: float) -> "Run":
        """Return the run from `start` to `end` [s], with one more sample at both ends."""
        part = slice(max(int(np.searchsorted(self.time, start)) - 1, 0), int(np.searchsorted(self.time, end)) + 1)
        impacts = self.impacts[(self.impacts >= start) & (self.impacts < end)]
        return Run(self.time[part], {name: x[part] for name, x in self.series.items()}, impacts, self.parameters)


def read_run(ds: xr.Dataset, *states: str) -> Run:
    """Return the time series where all `states` are finite, with the values before and after each event.

    Added are the bit's sliding speed `u`, relative to the drive if the dataset lacks the drive's speed `v`; `stuck`;
    and the speed `v3` of the bit on rock.

    **Raises:** `InputError` if a state is missing or samples are too few.
    """
    missing = [name for name in states if name not in ds]
    if missing or _TIME not in ds.dims:
        raise InputError(f"no trajectory to draw: the dataset lacks {', '.join(missing) or 'dimension time'}")
    ds = ds.isel({_TIME: np.flatnonzero(np.isfinite(sum(ds[name].values for name in states)))})
    if ds.sizes[_TIME] < _FEWEST_SAMPLES:
        reason = f"{ds.sizes[_TIME]} finite samples, {_FEWEST_SAMPLES} or more are needed"
        raise InputError(f"no trajectory to draw: {reason}")
    along = {str(name): data for name, data in ds.data_vars.items() if data.dims == (_TIME,)}
    time, parameters = np.asarray(ds[_TIME].values, float), parameters_of(ds)
    along["stuck"] = (along["stuck"] == 1 if "stuck" in along else xr.zeros_like(ds[_TIME])).astype(float)
    if "x3" in along and "v3" not in along:
        along["v3"] = along["x3"].copy(data=np.gradient(along["x3"].values, time))
    time, data = with_events(ds.assign(along))
    series = {name: np.asarray(x.values, float) for name, x in data.items()}
    series["stuck"] = np.round(series["stuck"])
    if "v1" in series:
        series["u"] = series["v1"] + parameters.get("v", 0.0)
    impacts = np.empty(0)  # from recorded events, else where the force rises from zero
    if "event_time" in ds and "event_kind" in ds:
        impacts = np.asarray(ds["event_time"].values, float)[_are(ds, "impact")]
    elif (force := series.get("impact_force")) is not None:
        impacts = time[1:][(force[1:] > 0) & (force[:-1] <= 0)]
    return Run(time, series, impacts, parameters)


def with_events(motion: xr.Dataset) -> tuple[Samples, dict[str, xr.DataArray]]:
    """Return the times of a trajectory and its variables along them, with two more samples at each event.

    These are the values before and after the event, each extrapolated from up to three samples on its side. At a
    section crossing, they are interpolated from up to two samples on each side. If events lie between the same two
    samples, the values are those before the first and after the last of them.
    """
    time = np.asarray(motion[_TIME].values, float)
    data = {str(n): x for n, x in motion.data_vars.items() if x.dims == (_TIME,)}
    data = {name: x for name, x in data.items() if x.dtype.kind == "f"}
    moments = motion["event_time"].values if "event_time" in motion else np.zeros(0)
    jumps = moments[~_are(motion, "section")]
    moments = np.unique(moments[(moments > time[0]) & (moments <= time[-1])])
    after, first = np.unique(np.searchsorted(time, moments), return_index=True)
    if not len(after) or not data:
        return time, data
    last = np.append(first[1:], len(moments)) - 1
    values = np.stack([x.values for x in data.values()])
    bounds = np.unique([0, *np.searchsorted(time, jumps), len(time)])
    low, high = bounds[np.searchsorted(bounds, after) - 1], bounds[np.searchsorted(bounds, after, side="right")]
    parts = [
        (slice(max(low[k], n - 3), n), slice(n, min(high[k], n + 3)))
        if n in bounds
        else 2 * (slice(max(low[k], n - 2), min(high[k], n + 2)),)
        for k, n in enumerate(after)
    ]
    sides = [
        _extrapolated(time[part], values[:, part], moments[event])
        for k, both in enumerate(parts)
        for part, event in zip(both, (first[k], last[k]), strict=True)
    ]
    places = np.repeat(after, 2)
    whole = np.insert(values, places, np.stack(sides, axis=1), axis=1)
    times = np.insert(time, places, moments[np.stack([first, last], axis=1).ravel()])
    return times, {n: xr.DataArray(x, dims=_TIME, attrs=data[n].attrs) for n, x in zip(data, whole, strict=True)}


def _are(motion: xr.Dataset, kind: str) -> Bool[np.ndarray, " events"]:
    """Return which events of a trajectory are of a kind."""
    if "event_kind" not in motion:
        return np.zeros(motion["event_time"].shape if "event_time" in motion else 0, bool)
    wanted = [flag for flag, meaning in flags(motion["event_kind"]).items() if meaning == kind]
    return np.asarray(np.isin(motion["event_kind"].values, wanted))


def _extrapolated(times: Samples, values: np.ndarray, at: float) -> np.ndarray:
    """Return the polynomial through values (states, samples) at a time."""
    away = times[:, None] - times + np.eye(len(times))
    weights = np.prod(np.where(np.eye(len(times)) == 1, 1.0, (at - times) / away), axis=1)
    return values @ weights
