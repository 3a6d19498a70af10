"""Quantities derived from a simulated motion: spectral peaks, events, amplitudes, lobes of a phase portrait, the hole.

`since` and `until` [s] delimit the part of the motion that is evaluated. "R18" and the like name readings of the
source: documented interpretations of ambiguous passages.
"""

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

Samples = Float[np.ndarray, " samples"]
Times = Float[np.ndarray, " times"]
Curve = tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]
Real = float | int
Band = Sequence[Real]
"""A frequency band: its lower and upper limit [Hz]."""

MIN_LOBE_SPEED = 0.4
"""Velocity of a lobe, relative to the greatest, below which the source ignores it as close to the abscissa (R18)."""
DRIVE_SPEED = 1.5
"""Usual driving velocity [m/s] in the source."""


def each(function: Callable[..., Any], subjects: Sequence[Any], *arguments: Any) -> Float[np.ndarray, " subjects"]:
    """Return the numbers `function(subject, *arguments)` for several motions, maps or masses (`subjects`)."""
    return np.array([float(function(subject, *arguments)) for subject in subjects])


def within(motion: xr.Dataset, since: Real, until: Real = np.inf) -> Bool[np.ndarray, " samples"]:
    """Return a mask of the samples from the time `since` to `until` [s], both inclusive."""
    time = motion["time"].values
    return (time >= since) & (time <= until)


def part(motion: xr.Dataset, name: str, since: Real, until: Real = np.inf) -> Samples:
    """Return the samples of a variable from `since` (inclusive) to `until` (exclusive) [s]."""
    time = motion["time"].values
    return motion[name].values[(time >= since) & (time < until)]


def amplitude(motion: xr.Dataset, name: str, since: Real, until: Real = np.inf) -> float:
    """Return half the peak-to-peak range of a variable between two times [s]."""
    return float(np.ptp(part(motion, name, since, until)) / 2)


def last_value(motion: xr.Dataset, name: str) -> float:
    """Return the last sample of a variable."""
    return float(motion[name][-1])


class Peak(NamedTuple):
    """A peak of a power spectrum: its frequency [Hz] and its power."""

    frequency: float
    power: float


class TwoPeaks(NamedTuple):
    """The highest peak in each of two frequency bands; `ratio` is the power of `low` divided by that of `high`."""

    low: Peak
    high: Peak
    ratio: float


def power_spectrum(motion: xr.Dataset, name: str, since: Real, until: Real = np.inf, padding: int = 16) -> Curve:
    """Return the frequencies [Hz] and the power spectrum of a variable between two times [s].

    The signal gets a Hann window, and zeros extend it to `padding` times its length.
    """
    x = part(motion, name, since, until)
    power = np.abs(np.fft.rfft(np.hanning(len(x)) * (x - x.mean()), padding * len(x))) ** 2
    return np.fft.rfftfreq(padding * len(x), float(motion["time"][1] - motion["time"][0])), power


def peak(motion: xr.Dataset, name: str, band: Band, since: Real, until: Real = np.inf) -> Peak:
    """Return the highest spectral peak of a variable in a frequency band."""
    frequencies, power = power_spectrum(motion, name, since, until)
    inside = np.flatnonzero((frequencies > band[0]) & (frequencies < band[1]))
    highest = inside[np.argmax(power[inside])]
    return Peak(float(frequencies[highest]), float(power[highest]))


def two_peaks(motion: xr.Dataset, name: str, lower: Band, upper: Band, since: Real, until: Real = np.inf) -> TwoPeaks:
    """Return the highest spectral peak of a variable in each of two frequency bands."""
    low, high = (peak(motion, name, band, since, until) for band in (lower, upper))
    return TwoPeaks(low, high, low.power / high.power)


def events(motion: xr.Dataset, kind: str, since: Real = 0.0) -> Times:
    """Return the times [s], from `since` on, of the events of one kind, such as "impact" or "section"."""
    flag = motion["event_kind"].attrs["flag_meanings"].split().index(kind)
    times = motion["event_time"].values[motion["event_kind"].values == flag]
    return times[times >= since]


def mean_period(motion: xr.Dataset) -> float:
    """Return the mean time [s] between impacts."""
    return float(np.diff(events(motion, "impact")).mean())


def last_cycle(motion: xr.Dataset) -> tuple[float, float]:
    """Return the times [s] of the last two section crossings, the beginning and the end of the last cycle."""
    times = events(motion, "section")
    return float(times[-2]), float(times[-1])


def envelope(motion: xr.Dataset, name: str, window: Real) -> Curve:
    """Return the midpoints [s] of successive windows of length `window` [s], and a variable's amplitude in each."""
    edges = np.arange(0.0, float(motion["time"][-1]) - window / 2, window)
    return edges + window / 2, np.array([amplitude(motion, name, edge, edge + window) for edge in edges])


def growth(motion: xr.Dataset) -> dict[str, Any]:
    """Describe the growth of the amplitude of the bit's velocity from zero, in windows of half a second.

    **Returns:** a dictionary: `steady`, the final amplitude [m/s]; `time` [s] until 95 % of it are reached; `change`,
    the relative variation afterwards; `rising`, whether the amplitude only increased before.
    """
    _, swings = envelope(motion, "v1", 0.5)
    steady = float(swings[-1])
    first = int(np.argmax(swings > 0.95 * steady))
    change = float(np.ptp(swings[first + 4 :]) / steady)
    rising = np.all(np.diff(swings[2:first]) > 0)
    return {"steady": steady, "time": 0.5 * first + 0.25, "change": change, "rising": rising}


def lobes(motion: xr.Dataset, slowest: float = MIN_LOBE_SPEED) -> int:
    """Return the number of lobes of the striker's phase portrait in the last cycle (R18).

    A lobe is a local maximum of the distance from the centre, at a velocity above `slowest` times the greatest. For the
    distance, the velocity is divided by the cycle's angular frequency.
    """
    begin, end = last_cycle(motion)
    position, velocity = part(motion, "x2", begin, end), part(motion, "v2", begin, end)
    centre = (position.max() + position.min()) / 2
    radius = np.hypot(position - centre, velocity * (end - begin) / (2 * np.pi))
    far = (radius > np.roll(radius, 1)) & (radius >= np.roll(radius, -1))
    return int((far & (np.abs(velocity) > slowest * np.abs(velocity).max())).sum())


def acceleration_before_impacts(motion: xr.Dataset, since: Real) -> Times:
    """Return the bit's mean acceleration [m/s²] during the two milliseconds before each impact."""
    times = events(motion, "impact", since)
    time, velocity = motion["time"].values, motion["v1"].values
    return (np.interp(times - 1e-4, time, velocity) - np.interp(times - 2.1e-3, time, velocity)) / 2e-3


def friction_slope(motion: xr.Dataset) -> float:
    """Return the slope of the friction force over the impact force (N/N) while the bit slides forward."""
    impact = motion["impact_force"].values
    forward = (motion["v1"].values + DRIVE_SPEED > 0.05) & (impact > 1e3)
    return float(np.polyfit(impact[forward], motion["friction_force"].values[forward], 1)[0])


def rest_times(motion: xr.Dataset) -> tuple[float, float]:
    """Return the longest times [ms] in the last cycle during which the striker in flight hardly accelerates.

    Its acceleration is below 10 % of the greatest in flight (first time), or 2 % of the greatest overall (second time).
    """
    time, inside = motion["time"].values, within(motion, *last_cycle(motion))
    acceleration = np.abs(np.gradient(motion["v2"].values[inside], time[inside]))
    flight = motion["impact_force"].values[inside] == 0
    limits = 0.1 * acceleration[flight][5:-5].max(), 0.02 * acceleration.max()
    runs = [groupby(flight & (acceleration < limit)) for limit in limits]
    short, long = (max((len(list(run)) for still, run in part if still), default=0) for part in runs)
    return 1e3 * float(time[1] - time[0]) * short, 1e3 * float(time[1] - time[0]) * long


def blow_restitution(motion: xr.Dataset) -> float:
    """Return the restitution of the first blow: minus the striker's velocity after it over the velocity before it."""
    times = [events(motion, kind)[0] for kind in ("release", "impact")]
    after, before = np.interp(times, motion["time"].values, motion["v2"].values)
    return float(-after / before)


def blow_duration(motion: xr.Dataset) -> float:
    """Return the duration [s] of the first blow."""
    return float(events(motion, "release")[0] - events(motion, "impact")[0])


def blow_of(motion: xr.Dataset) -> xr.Dataset:
    """Return the motion up to 9 ms after the beginning of its last blow, when the blow has ended."""
    return motion.isel(time=within(motion, 0.0, events(motion, "impact", 10.0)[-1] + 9e-3))


def growth_share(motion: xr.Dataset, steps: Bool[np.ndarray, " steps"]) -> float:
    """Return the fraction of the hole's growth in the masked `steps` from one sample to the next.

    **Raises:** `ValueError` if the hole does not grow at all.
    """
    grown = np.diff(motion["x4"].values)
    if not grown.any():
        raise ValueError("the hole does not grow")
    return float(grown[steps].sum() / grown.sum())


def growth_away_from_impacts(motion: xr.Dataset, contact: float) -> float:
    """Return the fraction of the hole's growth that occurs away from impacts.

    Times near an impact are the contact, which lasts `contact` [s], and the 5 ms after it.
    """
    away = np.ones(motion.sizes["time"], bool)
    for begin in events(motion, "impact"):
        away &= ~within(motion, begin - 1e-4, begin + contact + 5e-3)
    return growth_share(motion, away[:-1])


def swept_frequency(time: Any) -> Any:
    """Return the frequency [Hz] of the swept sine at a time [s]: 10 Hz initially, rising by 20 Hz per second (R22)."""
    return 10 + 20 * time


def fastest_frequency(motion: xr.Dataset) -> float:
    """Return the frequency [Hz] of the swept sine at which the bit's velocity amplitude is greatest.

    The amplitude is evaluated in windows of a quarter second.
    """
    middles, swings = envelope(motion, "v3", 0.25)
    return float(swept_frequency(middles[np.argmax(swings)]))


def last_slip_frequency(motion: xr.Dataset) -> float:
    """Return the frequency [Hz] of the swept sine at the last time when the hole grows."""
    return float(swept_frequency(motion["time"].values[np.flatnonzero(np.diff(motion["x4"].values) > 0)[-1]]))
