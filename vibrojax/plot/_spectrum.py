"""Amplitude spectra of a trajectory, and their peaks."""

from collections.abc import Sequence

import numpy as np

_MOST, _SHARE = 3, 0.1
_LOBE = 4  # the width of the Hann window's main lobe, in bins


def amplitude_spectrum(time: np.ndarray, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and amplitudes (in the unit of `signal`) of its second half, under a Hann window.

    A sine of amplitude A gives a peak of height A. Uneven times are brought to even ones by interpolation.
    """
    late = np.linspace((time[0] + time[-1]) / 2, time[-1], max(time.size // 2, 8))
    values = np.interp(late, time, signal)
    window = np.hanning(late.size)
    values = values - np.average(values, weights=window)
    amplitudes = 2.0 * np.abs(np.fft.rfft(values * window)) / window.sum()
    return np.fft.rfftfreq(late.size, late[1] - late[0]), amplitudes


def peaks(frequencies: np.ndarray, amplitudes: np.ndarray) -> list[tuple[float, float]]:
    """The three greatest local maxima over a tenth of the greatest, as (frequency, amplitude), greatest first.

    The frequency is that of the parabola through the logarithms of the three amplitudes at the peak.
    """
    inner, least = amplitudes[1:-1], _SHARE * amplitudes.max()
    found = 1 + np.flatnonzero((inner > amplitudes[:-2]) & (inner >= amplitudes[2:]) & (inner > least))
    greatest = found[np.argsort(-amplitudes[found], kind="stable")]
    chosen: list[int] = []
    for at in greatest:
        if all(abs(int(at) - other) > _LOBE for other in chosen):
            chosen.append(int(at))
    return [_vertex(frequencies, amplitudes, at) for at in chosen[:_MOST]]


def _vertex(frequencies: np.ndarray, amplitudes: np.ndarray, at: int) -> tuple[float, float]:
    below, here, above = np.log(np.maximum(amplitudes[at - 1 : at + 2], 1e-300))
    bend = below - 2.0 * here + above
    shift = 0.5 * (below - above) / bend if bend < 0 else 0.0
    return float(frequencies[at] + shift * (frequencies[1] - frequencies[0])), float(amplitudes[at])


def merged(found: Sequence[tuple[float, float]], width: float) -> list[tuple[float, float]]:
    """`found` without the lower of two peaks within `width` [Hz] of each other, greatest first."""
    kept: list[tuple[float, float]] = []
    for frequency, amplitude in sorted(found, key=lambda peak: -peak[1]):
        if all(abs(frequency - other) > width for other, _ in kept):
            kept.append((frequency, amplitude))
    return kept
