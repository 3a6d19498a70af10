"""What is read off a motion: peaks of its spectrum, returns, swings, lobes of a phase portrait."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

Samples = Float[np.ndarray, " samples"]
Times = Float[np.ndarray, " times"]

ABSCISSA = 0.4
"""Lobes below this share of the greatest velocity are those by the abscissa, which the source does not count (R18)."""


def part(motion: xr.Dataset, name: str, since: float, until: float = np.inf) -> Samples:
    """A variable between two times [s]."""
    time = motion["time"].values
    return motion[name].values[(time >= since) & (time < until)]


class Peak(NamedTuple):
    """A peak of a power spectrum; `frequency` in Hz."""

    frequency: float
    power: float


def peak(motion: xr.Dataset, name: str, lowest: float, highest: float, since: float, until: float = np.inf) -> Peak:
    """The highest peak between two frequencies [Hz] (Hann window, padded 16 times)."""
    frequencies, power = power_spectrum(motion, name, since, until, padding=16)
    among = np.flatnonzero((frequencies > lowest) & (frequencies < highest))
    best = among[np.argmax(power[among])]
    return Peak(float(frequencies[best]), float(power[best]))


class Spectrum(NamedTuple):
    """Frequencies [Hz] and the power at each."""

    frequencies: Float[np.ndarray, " frequencies"]
    power: Float[np.ndarray, " frequencies"]


def power_spectrum(motion: xr.Dataset, name: str, since: float, until: float = np.inf, padding: int = 16) -> Spectrum:
    """The power spectrum of a variable between two times [s] (Hann window, padded to `padding` times)."""
    x = part(motion, name, since, until)
    power = np.abs(np.fft.rfft(np.hanning(len(x)) * (x - x.mean()), padding * len(x))) ** 2
    return Spectrum(np.fft.rfftfreq(padding * len(x), float(motion["time"][1] - motion["time"][0])), power)


def events(motion: xr.Dataset, kind: str, since: float = 0.0) -> Times:
    """Times [s] at which events of a kind happened."""
    flag = motion["event_kind"].attrs["flag_meanings"].split().index(kind)
    times = motion["event_time"].values[motion["event_kind"].values == flag]
    return times[times >= since]


def at(motion: xr.Dataset, name: str, times: Times) -> Times:
    """A variable at some times [s], by interpolation."""
    return np.interp(times, motion["time"].values, motion[name].values)


def restitution(motion: xr.Dataset) -> float:
    """The striker's velocity after its first blow over that before it."""
    after, before = at(motion, "v2", np.array([events(motion, kind)[0] for kind in ("release", "impact")]))
    return float(-after / before)


def grown(motion: xr.Dataset, some: Bool[np.ndarray, " steps"]) -> float:
    """The share of the hole that grows in `some` of the steps from sample to sample.

    **Raises:** `ValueError` where it does not grow at all.
    """
    growth = np.diff(motion["x4"].values)
    if not growth.any():
        raise ValueError("the hole does not grow")
    return float(growth[some].sum() / growth.sum())


def amplitude(motion: xr.Dataset, name: str, since: float, until: float = np.inf) -> float:
    """Half the swing."""
    return float(np.ptp(part(motion, name, since, until)) / 2)


def last_cycle(motion: xr.Dataset) -> tuple[float, float]:
    """The last whole return to the section: when it begins and ends [s]."""
    times = events(motion, "section")
    return float(times[-2]), float(times[-1])


def lobes(motion: xr.Dataset, abscissa: float = ABSCISSA) -> int:
    """Lobes of the striker's phase portrait in the last cycle: farthest from the centre, and not slow (R18).

    Velocities are in units of position times the cycle's frequency.
    """
    begin, end = last_cycle(motion)
    position, velocity = part(motion, "x2", begin, end), part(motion, "v2", begin, end)
    centre = (position.max() + position.min()) / 2
    radius = np.hypot(position - centre, velocity * (end - begin) / (2 * np.pi))
    far = (radius > np.roll(radius, 1)) & (radius >= np.roll(radius, -1))
    return int((far & (np.abs(velocity) > abscissa * np.abs(velocity).max())).sum())


class Envelope(NamedTuple):
    """Half the swing of a variable in successive windows, and the middles [s] of the windows."""

    middles: Float[np.ndarray, " windows"]
    swings: Float[np.ndarray, " windows"]


def envelope(motion: xr.Dataset, name: str, window: float) -> Envelope:
    """Half the swing in successive windows of `window` [s]."""
    duration = float(motion["time"][-1])
    edges = np.arange(0.0, duration - window / 2, window)
    swings = np.array([amplitude(motion, name, edge, edge + window) for edge in edges])
    return Envelope(edges + window / 2, swings)
