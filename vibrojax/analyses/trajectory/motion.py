"""What a run holds, read once: bit and striker, bit and hole, in SI units; and the amplitude spectrum of a run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from vibrojax.errors import InputError
from vibrojax.io.attributes import parameters_of
from vibrojax.plot.contents import TIME, contents

_FEWEST = 16  # samples
_LONGEST = 0.1  # [s] of what is shown of an impact
_AT_REST = 0.01  # of its greatest speed
_LEAD = 0.15  # of an impact's time, shown before it
_MOST_PEAKS, _SHARE = 3, 0.1
_LOBE = 4  # the width of the Hann window's main lobe, in bins

Samples = Float[np.ndarray, " samples"]
Times = Float[np.ndarray, " times"]
Peak = tuple[float, float]
"""The frequency [Hz] and the amplitude of a peak."""


@dataclass(frozen=True)
class Motion:
    """A run of bit and striker in SI units.

    `v` [m/s] and `delta` [m] are None where the dataset does not say them; `impact_force` [N] is None where the scene
    has no impacts; `impacts` are the times [s] at which impacts begin.
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
        """The bit's sliding speed on the rock [m/s]; relative to the drive where the drive's speed is not known."""
        return self.v1 + (self.v or 0.0)

    def since(self, start: float) -> slice:
        """The samples from the time `start` [s] on."""
        return slice(int(np.searchsorted(self.time, start)), None)

    def at(self, times: Times, values: Samples) -> Times:
        """`values` at `times`, by linear interpolation."""
        return np.interp(times, self.time, values)


@dataclass(frozen=True)
class Hole:
    """A run of the bit in its hole, in SI units; a force is None where the dataset lacks it, as is `threshold`."""

    time: Samples
    x3: Samples
    x4: Samples
    v3: Samples
    applied_force: Samples | None
    rock_force: Samples | None
    threshold: float | None

    def between(self, start: float, end: float) -> slice:
        """The samples from `start` to `end` [s], and one more at both ends."""
        return slice(max(int(np.searchsorted(self.time, start)) - 1, 0), int(np.searchsorted(self.time, end)) + 1)

    @property
    def blows(self) -> Times:
        """When the force on the bit rises through half of its range [s]; that of the rock where none is given."""
        force = self.applied_force if self.applied_force is not None else self.rock_force
        if force is None or not np.ptp(force) > 0:
            return np.empty(0)
        above = force > (force.max() + force.min()) / 2
        return self.time[1:][above[1:] & ~above[:-1]]

    @property
    def growth(self) -> float:
        """How much the hole has grown [m]."""
        return float(self.x4[-1] - self.x4[0])


def read_motion(ds: xr.Dataset) -> Motion:
    """The motion in `ds`; raises `InputError` where it lacks bit or striker, or is no more than a few samples."""
    ds = _finite(ds, ("x1", "v1", "x2", "v2"))
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
        impacts=_impacts(ds, impact_force),
        v=parameters.get("v"),
        delta=None if impact_force is None else parameters.get("delta"),
    )


def read_hole(ds: xr.Dataset) -> Hole:
    """Bit and hole in `ds`; raises `InputError` where it lacks one of them, or is no more than a few samples."""
    ds = _finite(ds, ("x3", "x4"))
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
    """From a little before the last of the times `impacts` [s] in which the bit moved, to when it is at rest again."""
    end = float(hole.time[-1])
    for begins in impacts[::-1].tolist():
        after = hole.between(begins, min(begins + _LONGEST, end))
        speed = np.abs(hole.v3[after])
        moving = np.flatnonzero(speed > _AT_REST * speed.max(initial=0.0))
        if moving.size and moving[-1] < speed.size - 1:
            rest = float(hole.time[after][moving[-1]])
            return begins - _LEAD * (rest - begins), rest + 2 * _LEAD * (rest - begins)
    return None


def _finite(ds: xr.Dataset, states: Sequence[str]) -> xr.Dataset:
    """`ds` at the times where all `states` are finite."""
    missing = [name for name in states if name not in ds]
    if missing or not contents(ds).run:
        raise InputError(f"no trajectory to draw: the dataset lacks {', '.join(missing) or 'dimension time'}")
    ds = ds.isel({TIME: np.flatnonzero(np.isfinite(sum(ds[name].values for name in states)))})
    if ds.sizes[TIME] < _FEWEST:
        raise InputError(f"no trajectory to draw: {ds.sizes[TIME]} finite samples, {_FEWEST} or more are needed")
    return ds


def _samples(ds: xr.Dataset, name: str) -> Samples:
    return np.asarray(ds[name].values, float)


def _optional(ds: xr.Dataset, name: str) -> Samples | None:
    return _samples(ds, name) if name in ds else None


def _impacts(ds: xr.Dataset, force: Samples | None) -> Times:
    """When impacts begin: from the events, or from where the force rises from zero."""
    if "event_time" in ds and "event_kind" in ds:
        meanings = str(ds["event_kind"].attrs.get("flag_meanings", "stick slip impact release section")).split()
        flags = np.atleast_1d(ds["event_kind"].attrs.get("flag_values", range(1, 1 + len(meanings)))).tolist()
        wanted = [flag for flag, meaning in zip(flags, meanings, strict=False) if meaning == "impact"]
        return _samples(ds, "event_time")[np.isin(ds["event_kind"].values, wanted)]
    if force is None:
        return np.empty(0)
    rises = 1 + np.flatnonzero((force[1:] > 0) & (force[:-1] <= 0))
    return _samples(ds, TIME)[rises]


# The spectrum.


def amplitude_spectrum(
    time: Samples, signal: Samples
) -> tuple[Float[np.ndarray, " frequencies"], Float[np.ndarray, " frequencies"]]:
    """Frequencies [Hz] and amplitudes (in the unit of `signal`) of its second half, under a Hann window.

    A sine of amplitude A gives a peak of height A. Uneven times are brought to even ones by interpolation.
    """
    late = np.linspace((time[0] + time[-1]) / 2, time[-1], max(time.size // 2, 8))
    values = np.interp(late, time, signal)
    window = np.hanning(late.size)
    values = values - np.average(values, weights=window)
    amplitudes = 2.0 * np.abs(np.fft.rfft(values * window)) / window.sum()
    return np.fft.rfftfreq(late.size, late[1] - late[0]), amplitudes


def peaks(frequencies: Float[np.ndarray, " frequencies"], amplitudes: Float[np.ndarray, " frequencies"]) -> list[Peak]:
    """The three greatest local maxima over a tenth of the greatest, as (frequency, amplitude), greatest first.

    The frequency is that of the parabola through the logarithms of the three amplitudes at the peak.
    """
    inner, least = amplitudes[1:-1], _SHARE * amplitudes.max()
    maxima = 1 + np.flatnonzero((inner > amplitudes[:-2]) & (inner >= amplitudes[2:]) & (inner > least))
    greatest = maxima[np.argsort(-amplitudes[maxima], kind="stable")]
    chosen: list[int] = []
    for at in greatest.tolist():
        if all(abs(at - other) > _LOBE for other in chosen):
            chosen.append(at)
    return [_vertex(frequencies, amplitudes, at) for at in chosen[:_MOST_PEAKS]]


def merged(several: Sequence[Peak], width: float) -> list[Peak]:
    """`several` without the lower of two peaks within `width` [Hz] of each other, greatest first."""
    chosen: list[Peak] = []
    for frequency, amplitude in sorted(several, key=lambda peak: -peak[1]):
        if all(abs(frequency - other) > width for other, _ in chosen):
            chosen.append((frequency, amplitude))
    return chosen


def _vertex(
    frequencies: Float[np.ndarray, " frequencies"], amplitudes: Float[np.ndarray, " frequencies"], at: int
) -> Peak:
    below, here, above = np.log(np.maximum(amplitudes[at - 1 : at + 2], 1e-300))
    bend = below - 2.0 * here + above
    shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(frequencies[at] + shift * (frequencies[1] - frequencies[0])), float(amplitudes[at])
