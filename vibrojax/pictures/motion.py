"""Time series of a run in SI units (bit and striker, bit and hole), and the amplitude spectrum of a run."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Float, Num

from vibrojax.errors import InputError
from vibrojax.io.attributes import flags, parameters_of
from vibrojax.pictures.contents import TIME

_FEWEST_SAMPLES = 16
_IMPACT_WINDOW = 0.1  # time [s] within which the bit must come to rest after an impact, if the impact is enlarged
_REST_SPEED = 0.01  # fraction of the greatest speed up to which the bit counts as resting
_LEAD = 0.15  # fraction of an impact's duration that is shown before the impact
_MOST_PEAKS, _LEAST_PEAK = 3, 0.1  # number of peaks, and least height relative to the highest
_LOBE_BINS = 4.0  # width of the Hann window's main lobe in frequency bins

Samples = Float[np.ndarray, " samples"]
Times = Float[np.ndarray, " times"]
Frequencies = Float[np.ndarray, " frequencies"]
Peak = tuple[float, float]
"""The frequency [Hz] and the amplitude of a peak."""


@dataclass(frozen=True)
class Run:
    """Time series of a run in SI units.

    - `series`: the variables along time by name.
    - `impacts`: times [s] at which impacts begin.
    - `parameters`: the parameters of the scene by name.
    """

    time: Samples
    series: Mapping[str, Samples]
    impacts: Times
    parameters: Mapping[str, float]

    def __getitem__(self, name: str) -> Samples:
        return self.series[name]

    def has(self, *names: str) -> bool:
        """Return whether the run has any of the variables."""
        return any(name in self.series for name in names)

    def since(self, start: float) -> slice:
        """Return the slice of samples from the time `start` [s] on."""
        return slice(int(np.searchsorted(self.time, start)), None)

    def between(self, start: float, end: float) -> slice:
        """Return the slice of samples from `start` to `end` [s], with one more sample at both ends."""
        return slice(max(int(np.searchsorted(self.time, start)) - 1, 0), int(np.searchsorted(self.time, end)) + 1)


def read_run(ds: xr.Dataset, *states: str) -> Run:
    """Return the time series at the times at which all `states` are finite.

    Added are the bit's sliding speed `u`, relative to the drive if the dataset lacks the drive's speed `v`; `stuck`;
    and the speed `v3` of the bit on rock.

    **Raises:** `InputError` if a state is missing or samples are too few.
    """
    missing = [name for name in states if name not in ds]
    if missing or TIME not in ds.dims:
        raise InputError(f"no trajectory to draw: the dataset lacks {', '.join(missing) or 'dimension time'}")
    ds = ds.isel({TIME: np.flatnonzero(np.isfinite(sum(ds[name].values for name in states)))})
    if ds.sizes[TIME] < _FEWEST_SAMPLES:
        reason = f"{ds.sizes[TIME]} finite samples, {_FEWEST_SAMPLES} or more are needed"
        raise InputError(f"no trajectory to draw: {reason}")
    along = {str(name): data for name, data in ds.data_vars.items() if data.dims == (TIME,)}
    series = {name: np.asarray(data.values, float) for name, data in along.items() if data.dtype.kind in "fiub"}
    time, parameters = np.asarray(ds[TIME].values, float), parameters_of(ds)
    series["stuck"] = (series.get("stuck", np.zeros(time.size)) == 1).astype(float)
    if "v1" in series:
        series["u"] = series["v1"] + parameters.get("v", 0.0)
    if "x3" in series and "v3" not in series:
        series["v3"] = np.gradient(series["x3"], time)
    return Run(time, series, _impact_times(ds, time, series.get("impact_force")), parameters)


def _impact_times(ds: xr.Dataset, time: Samples, force: Samples | None) -> Times:
    """Return the times [s] at which impacts begin: from recorded events, else where the force rises from zero."""
    if "event_time" in ds and "event_kind" in ds:
        impacts = [flag for flag, meaning in flags(ds["event_kind"]).items() if meaning == "impact"]
        return np.asarray(ds["event_time"].values, float)[np.isin(ds["event_kind"].values, impacts)]
    if force is None:
        return np.empty(0)
    return time[1 + np.flatnonzero((force[1:] > 0) & (force[:-1] <= 0))]


def blow_times(hole: Run) -> Times:
    """Return the times [s] at which the applied, or else the rock's, force rises through the middle of its range."""
    force = hole.series.get("applied_force", hole.series.get("rock_force"))
    if force is None or not np.ptp(force) > 0:
        return np.empty(0)
    above = force > (force.max() + force.min()) / 2
    return hole.time[1:][above[1:] & ~above[:-1]]


def last_impact(hole: Run, impacts: Times) -> tuple[float, float] | None:
    """Return the time interval [s] around the last impact after which the bit comes to rest, or None."""
    end = float(hole.time[-1])
    for begins in impacts[::-1].tolist():
        after = hole.between(begins, min(begins + _IMPACT_WINDOW, end))
        speed = np.abs(hole["v3"][after])
        moving = np.flatnonzero(speed > _REST_SPEED * speed.max(initial=0.0))
        if moving.size and moving[-1] < speed.size - 1:
            rest = float(hole.time[after][moving[-1]])
            return begins - _LEAD * (rest - begins), rest + 2 * _LEAD * (rest - begins)
    return None


# The spectrum.


def amplitude_spectrum(time: Samples, signal: Samples) -> tuple[Frequencies, Frequencies]:
    """Return frequencies [Hz] and amplitudes of the second half of a signal, under a Hann window.

    A sine of amplitude A gives a peak of height A. The signal is interpolated to equidistant times.
    """
    late = np.linspace((time[0] + time[-1]) / 2, time[-1], max(time.size // 2, 8))
    values = np.interp(late, time, signal)
    window = np.hanning(late.size)
    values = values - np.average(values, weights=window)
    amplitudes = 2.0 * np.abs(np.fft.rfft(values * window)) / window.sum()
    return np.fft.rfftfreq(late.size, late[1] - late[0]), amplitudes


def peaks(frequencies: Frequencies, amplitudes: Frequencies) -> list[Peak]:
    """Return up to three highest local maxima above a tenth of the global maximum, highest first.

    Each frequency is the vertex of the parabola through the logarithms of the three amplitudes at the peak.
    """
    from scipy.signal import find_peaks  # slow to import, and no other picture needs it

    maxima, _ = find_peaks(amplitudes, height=_LEAST_PEAK * amplitudes.max())
    highest: list[Peak] = []
    for index in maxima[separate_peaks(maxima, amplitudes[maxima], _LOBE_BINS)[:_MOST_PEAKS]].tolist():
        below, here, above = np.log(np.maximum(amplitudes[index - 1 : index + 2], 1e-300))
        bend = below - 2.0 * here + above  # 0 on a plateau
        shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
        frequency = float(frequencies[index] + shift * (frequencies[1] - frequencies[0]))
        highest.append((frequency, float(amplitudes[index])))
    return highest


def separate_peaks(places: Num[np.ndarray, " n"], heights: Float[np.ndarray, " n"], width: float) -> list[int]:
    """Return the indices of the peaks, highest first, without peaks within `width` of a higher peak."""
    chosen: list[int] = []
    for index in np.argsort(-heights, kind="stable").tolist():
        if all(abs(places[index] - places[other]) > width for other in chosen):
            chosen.append(index)
    return chosen
