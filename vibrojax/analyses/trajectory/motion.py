"""Time series of a run in SI units (bit and striker, bit and hole), and the amplitude spectrum of a run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import InputError
from vibrojax.io.attributes import parameters_of
from vibrojax.plot.contents import TIME, contents

_FEWEST_SAMPLES = 16
_IMPACT_WINDOW = 0.1  # time [s] within which the bit must come to rest after an impact, if the impact is enlarged
_REST_SPEED = 0.01  # fraction of the greatest speed up to which the bit counts as resting
_LEAD = 0.15  # fraction of an impact's duration that is shown before the impact
_MOST_PEAKS, _LEAST_PEAK = 3, 0.1  # number of peaks, and least height relative to the highest
_LOBE_BINS = 4  # width of the Hann window's main lobe in frequency bins

Samples = Float[np.ndarray, " samples"]
Times = Float[np.ndarray, " times"]
Frequencies = Float[np.ndarray, " frequencies"]
Peak = tuple[float, float]
"""The frequency [Hz] and the amplitude of a peak."""


@dataclass(frozen=True)
class Motion:
    """Time series of bit and striker in SI units.

    The drive's speed `v` [m/s], the gap `delta` [m] and the forces are None if the dataset lacks them. `impacts`: times
    [s] at which impacts begin.
    """

    time: Samples
    x1: Samples
    v1: Samples
    x2: Samples
    v2: Samples
    friction_force: Samples | None
    impact_force: Samples | None
    stuck: Bool[np.ndarray, " samples"]
    impacts: Times
    v: float | None
    delta: float | None

    @property
    def u(self) -> Samples:
        """The bit's sliding speed on the rock [m/s], or its speed relative to the drive if `v` is None."""
        return self.v1 + (self.v or 0.0)

    def since(self, start: float) -> slice:
        """Return the slice of samples from the time `start` [s] on."""
        return slice(int(np.searchsorted(self.time, start)), None)


@dataclass(frozen=True)
class Hole:
    """Time series of bit and hole in SI units; forces and `threshold` are None if the dataset lacks them."""

    time: Samples
    x3: Samples
    x4: Samples
    v3: Samples
    applied_force: Samples | None
    rock_force: Samples | None
    threshold: float | None

    def between(self, start: float, end: float) -> slice:
        """Return the slice of samples from `start` to `end` [s], with one more sample at both ends."""
        return slice(max(int(np.searchsorted(self.time, start)) - 1, 0), int(np.searchsorted(self.time, end)) + 1)

    @property
    def blows(self) -> Times:
        """Times [s] at which the applied force, or else the rock's force, rises through the middle of its range."""
        force = self.applied_force if self.applied_force is not None else self.rock_force
        if force is None or not np.ptp(force) > 0:
            return np.empty(0)
        above = force > (force.max() + force.min()) / 2
        return self.time[1:][above[1:] & ~above[:-1]]


def read_motion(ds: xr.Dataset) -> Motion:
    """Return the time series of bit and striker; raise `InputError` if a state is missing or samples are too few."""
    ds = _finite_part(ds, ("x1", "v1", "x2", "v2"))
    parameters = parameters_of(ds)
    impact_force, stuck = _optional(ds, "impact_force"), _optional(ds, "stuck")
    return Motion(
        time=_samples(ds, TIME),
        x1=_samples(ds, "x1"),
        v1=_samples(ds, "v1"),
        x2=_samples(ds, "x2"),
        v2=_samples(ds, "v2"),
        friction_force=_optional(ds, "friction_force"),
        impact_force=impact_force,
        stuck=np.zeros(ds.sizes[TIME], bool) if stuck is None else stuck == 1,
        impacts=_impact_times(ds, impact_force),
        v=parameters.get("v"),
        delta=None if impact_force is None else parameters.get("delta"),
    )


def read_hole(ds: xr.Dataset) -> Hole:
    """Return the time series of bit and hole; raise `InputError` if a state is missing or samples are too few."""
    ds = _finite_part(ds, ("x3", "x4"))
    time, x3, v3 = _samples(ds, TIME), _samples(ds, "x3"), _optional(ds, "v3")
    return Hole(
        time=time,
        x3=x3,
        x4=_samples(ds, "x4"),
        v3=np.gradient(x3, time) if v3 is None else v3,
        applied_force=_optional(ds, "applied_force"),
        rock_force=_optional(ds, "rock_force"),
        threshold=parameters_of(ds).get("threshold"),
    )


def last_impact(hole: Hole, impacts: Times) -> tuple[float, float] | None:
    """Return the time interval [s] around the last impact after which the bit comes to rest, or None."""
    end = float(hole.time[-1])
    for begins in impacts[::-1].tolist():
        after = hole.between(begins, min(begins + _IMPACT_WINDOW, end))
        speed = np.abs(hole.v3[after])
        moving = np.flatnonzero(speed > _REST_SPEED * speed.max(initial=0.0))
        if moving.size and moving[-1] < speed.size - 1:
            rest = float(hole.time[after][moving[-1]])
            return begins - _LEAD * (rest - begins), rest + 2 * _LEAD * (rest - begins)
    return None


def _finite_part(ds: xr.Dataset, states: Sequence[str]) -> xr.Dataset:
    """Return the dataset at the times at which all `states` are finite."""
    missing = [name for name in states if name not in ds]
    if missing or not contents(ds).run:
        raise InputError(f"no trajectory to draw: the dataset lacks {', '.join(missing) or 'dimension time'}")
    ds = ds.isel({TIME: np.flatnonzero(np.isfinite(sum(ds[name].values for name in states)))})
    if ds.sizes[TIME] < _FEWEST_SAMPLES:
        reason = f"{ds.sizes[TIME]} finite samples, {_FEWEST_SAMPLES} or more are needed"
        raise InputError(f"no trajectory to draw: {reason}")
    return ds


def _samples(ds: xr.Dataset, name: str) -> Samples:
    return np.asarray(ds[name].values, float)


def _optional(ds: xr.Dataset, name: str) -> Samples | None:
    return _samples(ds, name) if name in ds else None


def _impact_times(ds: xr.Dataset, force: Samples | None) -> Times:
    """Return the times [s] at which impacts begin: from recorded events, else where the force rises from zero."""
    if "event_time" in ds and "event_kind" in ds:
        meanings = str(ds["event_kind"].attrs.get("flag_meanings", "stick slip impact release section")).split()
        flags = np.atleast_1d(ds["event_kind"].attrs.get("flag_values", range(1, 1 + len(meanings)))).tolist()
        impacts = [flag for flag, meaning in zip(flags, meanings, strict=False) if meaning == "impact"]
        return _samples(ds, "event_time")[np.isin(ds["event_kind"].values, impacts)]
    if force is None:
        return np.empty(0)
    return _samples(ds, TIME)[1 + np.flatnonzero((force[1:] > 0) & (force[:-1] <= 0))]


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
    inner, least = amplitudes[1:-1], _LEAST_PEAK * amplitudes.max()
    maxima = 1 + np.flatnonzero((inner > amplitudes[:-2]) & (inner >= amplitudes[2:]) & (inner > least))
    chosen: list[int] = []
    for index in maxima[np.argsort(-amplitudes[maxima], kind="stable")].tolist():
        if all(abs(index - other) > _LOBE_BINS for other in chosen):
            chosen.append(index)
    highest: list[Peak] = []
    for index in chosen[:_MOST_PEAKS]:
        below, here, above = np.log(np.maximum(amplitudes[index - 1 : index + 2], 1e-300))
        bend = below - 2.0 * here + above
        shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
        frequency = float(frequencies[index] + shift * (frequencies[1] - frequencies[0]))
        highest.append((frequency, float(amplitudes[index])))
    return highest


def merge_peaks(several: Sequence[Peak], width: float) -> list[Peak]:
    """Return the peaks, highest first, without peaks within `width` [Hz] of a higher peak."""
    chosen: list[Peak] = []
    for frequency, amplitude in sorted(several, key=lambda peak: -peak[1]):
        if all(abs(frequency - other) > width for other, _ in chosen):
            chosen.append((frequency, amplitude))
    return chosen
