"""The panels of a trajectory that are not over time: phase portraits and spectrum."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from vibrojax.plot._labels import number
from vibrojax.plot._motion import Motion
from vibrojax.plot._spectrum import amplitude_spectrum, merged, peaks
from vibrojax.plot._style import BIT, FAINT, IMPACT, STICK, STRIKER

_SPAN = 5.0  # of the spectrum, in units of the bit's dominant frequency
_QUIET = 25.0  # the span [Hz] where nothing moves
_LEAST = 1e-6  # amplitude [mm] below which there is nothing but rounding


def draw_bit(axes: Axes, motion: Motion, start: float) -> None:
    """Draw the bit's phase portrait: sliding speed against displacement, stick as a thick line."""
    _draw_portrait(axes, motion, motion.x1, motion.u, start, BIT)
    late = motion.since(start)
    stuck = np.where(motion.stuck, motion.u, np.nan)
    axes.plot(1e3 * motion.x1[late], stuck[late], color=STICK, linewidth=2.8, zorder=3)
    axes.set_title("bit", color=BIT, fontweight="bold")
    axes.set_xlabel("x₁ [mm]")
    axes.set_ylabel("sliding speed u = x₁′ + v [m/s]" if motion.v is not None else "velocity x₁′ [m/s]")


def draw_striker(axes: Axes, motion: Motion, start: float) -> None:
    """Draw the striker's phase portrait: velocity against displacement, the contact at delta as a line."""
    if motion.delta is not None:
        axes.axvline(1e3 * motion.delta, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)))
    _draw_portrait(axes, motion, motion.x2, motion.v2, start, STRIKER)
    axes.set_title("striker", color=STRIKER, fontweight="bold")
    axes.set_xlabel("x₂ [mm]")
    axes.set_ylabel("velocity x₂′ [m/s]")


def _draw_portrait(axes: Axes, motion: Motion, x: np.ndarray, speed: np.ndarray, start: float, colour: str) -> None:
    """The transient faint, what comes after `start` strong, impacts as points."""
    late = motion.since(start)
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    before = slice(None, late.start + 1)
    axes.plot(1e3 * x[before], speed[before], color=FAINT, linewidth=0.4, alpha=0.6, rasterized=True)
    axes.plot(1e3 * x[late], speed[late], color=colour, linewidth=1.1)
    times = motion.impacts[motion.impacts >= start]
    at = (1e3 * motion.at(times, x), motion.at(times, speed))
    axes.plot(*at, linestyle="none", marker="o", markersize=4.0, color=IMPACT, zorder=4)


def draw_spectrum(axes: Axes, motion: Motion) -> None:
    """Draw the amplitude spectra of both displacements, and name their peaks in Hz."""
    named: list[tuple[float, float]] = []
    end, width = 0.0, 0.0
    for name, x, colour in (("bit x₁", motion.x1, BIT), ("striker x₂", motion.x2, STRIKER)):
        frequencies, amplitudes = amplitude_spectrum(motion.time, 1e3 * x)
        found = peaks(frequencies, amplitudes) if amplitudes.max() > _LEAST else []
        end = end or (_SPAN * found[0][0] if found else 0.0)
        width = 4.0 * float(frequencies[1])
        axes.plot(frequencies, amplitudes, color=colour, linewidth=1.0, label=name)
        # At the same frequency the higher line hides the lower one; not its top.
        axes.plot(*zip(*found, strict=True) if found else ([], []), "o", color=colour, markersize=3.2, zorder=4)
        named += found
    end = end or _QUIET
    axes.set_xlim(0.0, end)
    axes.set_ylim(0.0, 1.12 * max(float(axes.dataLim.y1), _LEAST))  # room for the name of the highest peak
    _name_peaks(axes, [peak for peak in merged(named, width) if peak[0] < end])
    axes.set_title("spectrum, second half of the run")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    axes.grid(True)
    axes.legend(loc="upper right", handlelength=1.2)


def _name_peaks(axes: Axes, found: list[tuple[float, float]]) -> None:
    for frequency, amplitude in found:
        text = f"{number(round(frequency, 2))} Hz"
        name = axes.annotate(text, (frequency, amplitude), (4, 2), textcoords="offset points", fontsize=8, zorder=5)
        name.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
