"""Picture of a trajectory: time history, phase portraits of bit and striker, and amplitude spectrum."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from vibrojax.analyses.trajectory.hole import draw_hole, force_scale, growth_text
from vibrojax.analyses.trajectory.motion import (
    Motion,
    Peak,
    Samples,
    amplitude_spectrum,
    last_impact,
    merge_peaks,
    peaks,
    read_hole,
    read_motion,
)
from vibrojax.errors import InputError
from vibrojax.plot.axes import number
from vibrojax.plot.contents import contents
from vibrojax.plot.curves import band_text, draw_over_time, is_band
from vibrojax.plot.sheet import write_margins
from vibrojax.plot.style import BIT, DASHED, FAINT, IMPACT, INK, STICK, STRIKER, Mark, new_figure, styled

_OVERVIEW_FROM = 1.5  # ratio of the run's length to the window from which there is an overview
_SPECTRUM_SPAN = 5.0  # in units of the bit's dominant frequency
_SPECTRUM_AT_REST = 25.0  # span [Hz] if nothing moves
_LEAST_AMPLITUDE = 1e-6  # [mm]: less is rounding error
_DOTS = Mark(linestyle="none", marker="o", markersize=4.0, color=IMPACT)


@styled
def trajectory(ds: xr.Dataset, last: float = 1.5) -> Figure:
    """Draw the time history, phase portraits and spectrum of one run.

    Displacements, velocities and forces are drawn over the last `last` seconds, below an overview of the whole run.
    Sticking and impacts are marked. The transient is faint in the phase portraits of bit and striker. The amplitude
    spectrum is computed from the run's second half. In scenes with rock, bit and hole are drawn over the same time, and
    enlarged at the last impact.

    **Arguments:** `last`: duration of the end of the run that is shown [s].

    **Raises:** `InputError` if the dataset holds no trajectory, or `last` is not above 0.
    """
    if not last > 0:
        raise InputError(f"last = {last} s: give a time above 0")
    motion = read_motion(ds)
    hole = read_hole(ds) if contents(ds).hole else None
    start, end = max(float(motion.time[-1]) - last, float(motion.time[0])), float(motion.time[-1])
    overview = float(np.ptp(motion.time)) > _OVERVIEW_FROM * last
    forces = motion.impact_force is not None or motion.friction_force is not None
    near = hole and last_impact(hole, motion.impacts[(motion.impacts >= start) & (motion.impacts < end)])
    rows: dict[str, tuple[list[Any], float]] = {
        "overview": (["overview"] * 3, 0.65 if overview else 0.0),
        "displacement": (["displacement"] * 3, 1.25),
        "velocity": (["velocity"] * 3, 1.25),
        "force": (["force"] * 3, 0.9 if forces else 0.0),
        "rock": (["rock", "rock", "impact" if near else "."], 1.3 if hole else 0.0),
        "portraits": (["bit", "striker", "spectrum"], 2.7),
    }
    shown = {name: row for name, row in rows.items() if row[1]}
    heights = [height for _, height in shown.values()]
    figure = new_figure(10.0, sum(heights) + 0.33 * len(heights) + 1.2)
    panels = figure.subplot_mosaic([row for row, _ in shown.values()], height_ratios=heights)
    if overview:
        _draw_overview(panels["overview"], motion, start)
    history = [panels[name] for name in ("displacement", "velocity", "force") if name in panels]
    for axes in history[1:]:
        axes.sharex(history[0])
    _draw_displacements(history[0], motion, start)
    _draw_velocities(history[1], motion, start)
    if forces:
        _draw_forces(history[2], motion, start)
    for axes in history[:-1]:
        axes.tick_params(labelbottom=False)
    history[0].set_xlim(start, end)
    history[-1].set_xlabel("time [s]")
    figure.align_ylabels(history + ([panels["overview"]] if overview else []))
    if hole:
        axes = panels["rock"]
        draw_hole(axes, hole, start, end)
        axes.set_xlim(start, end)
        axes.set_xlabel("time [s]")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderpad=0.0, borderaxespad=0.3)
    if hole and near:
        axes.axvspan(*near, color=FAINT, alpha=0.4, linewidth=0)
        impact = panels["impact"]
        draw_hole(impact, hole, *near)
        impact.set_xlim(*near)
        impact.set_title("enlarged: the shaded impact", loc="right")
        impact.set_xlabel("time [s]")
        impact.locator_params(axis="x", nbins=4)
    _draw_bit(panels["bit"], motion, start)
    _draw_striker(panels["striker"], motion, start)
    _draw_spectrum(panels["spectrum"], motion)
    write_margins(figure, ds, growth_text(hole) if hole else "", band_text(*figure.axes))
    return figure


def _draw_overview(axes: Axes, motion: Motion, start: float) -> None:
    for values, colour in ((motion.x1, BIT), (motion.x2, STRIKER)):
        draw_over_time(axes, motion.time, 1e3 * values, colour, 0.4).set_rasterized(True)
    axes.axvspan(start, motion.time[-1], color=FAINT, alpha=0.3, linewidth=0)
    axes.set_xlim(motion.time[0], motion.time[-1])
    axes.set_ylabel("whole run\n[mm]")
    axes.set_xlabel("time [s]", labelpad=1.0)


def _draw_displacements(axes: Axes, motion: Motion, start: float) -> None:
    axes.grid(True)
    handles: list[Artist] = [Line2D([], [], color=BIT, label="bit"), Line2D([], [], color=STRIKER, label="striker")]
    if motion.stuck.any():
        handles.append(Line2D([], [], color=STICK, linewidth=2.6, label="bit sticks"))
    if motion.impacts.size:
        handles.append(Line2D([], [], label="impact begins", **_DOTS))
    if motion.delta is not None:
        gap = Mark(color=FAINT, linewidth=0.8, linestyle=DASHED)
        axes.axhline(1e3 * motion.delta, **gap)
        handles.append(Line2D([], [], label=f"gap Δ = {number(1e3 * motion.delta)} mm", **gap))
    _draw_both(axes, motion, start, 1e3 * motion.x1, 1e3 * motion.x2)
    axes.set_ylabel("displacement\n[mm]")
    axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, borderpad=0.2)


def _draw_velocities(axes: Axes, motion: Motion, start: float) -> None:
    axes.grid(True)
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    _draw_both(axes, motion, start, motion.u, motion.v2)
    axes.set_ylabel("u and x₂′\n[m/s]" if motion.v is not None else "x₁′ and x₂′\n[m/s]")


def _draw_both(axes: Axes, motion: Motion, start: float, of_bit: Samples, of_striker: Samples) -> None:
    """Draw a quantity of striker and bit over time; mark sticking and impacts on lines, but not on bands."""
    late = motion.since(start)
    striker = draw_over_time(axes, motion.time[late], of_striker[late], STRIKER, 1.1)
    bit = draw_over_time(axes, motion.time[late], of_bit[late], BIT, 1.1)
    if not is_band(bit):
        axes.plot(motion.time[late], np.where(motion.stuck, of_bit, np.nan)[late], color=STICK, linewidth=2.6)
    if not is_band(striker):
        times = motion.impacts[motion.impacts >= start]
        axes.plot(times, np.interp(times, motion.time, of_striker), zorder=4, **_DOTS)


def _draw_forces(axes: Axes, motion: Motion, start: float) -> None:
    late = motion.since(start)
    axes.grid(True)
    friction, impact = motion.friction_force, motion.impact_force
    factor, unit = force_scale([values for values in (friction, impact) if values is not None])
    if impact is not None:
        draw_over_time(axes, motion.time[late], factor * impact[late], IMPACT, 1.0, "impact force J")
    if friction is not None:
        draw_over_time(axes, motion.time[late], factor * friction[late], INK, 0.8, "friction force F")
    axes.set_ylabel(f"force\n[{unit}]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderpad=0.0, borderaxespad=0.2)


# Phase portraits and spectrum.


def _draw_bit(axes: Axes, motion: Motion, start: float) -> None:
    """Draw the bit's phase portrait: sliding speed against displacement, with sticking as a thick line."""
    speed = "sliding speed u = x₁′ + v [m/s]" if motion.v is not None else "velocity x₁′ [m/s]"
    axes.set(xlabel="x₁ [mm]", ylabel=speed)
    axes.set_title("bit", color=BIT, fontweight="bold")
    _draw_portrait(axes, motion, motion.x1, motion.u, start, BIT)
    late = motion.since(start)
    stuck = np.where(motion.stuck, motion.u, np.nan)
    axes.plot(1e3 * motion.x1[late], stuck[late], color=STICK, linewidth=2.8, zorder=3)


def _draw_striker(axes: Axes, motion: Motion, start: float) -> None:
    """Draw the striker's phase portrait: velocity against displacement, with the contact at `delta` as a line."""
    axes.set(xlabel="x₂ [mm]", ylabel="velocity x₂′ [m/s]")
    axes.set_title("striker", color=STRIKER, fontweight="bold")
    if motion.delta is not None:
        axes.axvline(1e3 * motion.delta, color=FAINT, linewidth=0.8, linestyle=DASHED)
    _draw_portrait(axes, motion, motion.x2, motion.v2, start, STRIKER)


def _draw_portrait(axes: Axes, motion: Motion, x: Samples, speed: Samples, start: float, colour: str) -> None:
    """Draw a phase portrait: the transient faint, the motion after time `start` [s] strong, impacts as dots."""
    late = motion.since(start)
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    before = slice(None, late.start + 1)
    axes.plot(1e3 * x[before], speed[before], color=FAINT, linewidth=0.4, alpha=0.6, rasterized=True)
    axes.plot(1e3 * x[late], speed[late], color=colour, linewidth=1.1)
    times = motion.impacts[motion.impacts >= start]
    places = (np.interp(times, motion.time, values) for values in (1e3 * x, speed))
    axes.plot(*places, zorder=4, **_DOTS)


def _draw_spectrum(axes: Axes, motion: Motion) -> None:
    """Draw the amplitude spectra of both displacements, and label the peaks with their frequencies."""
    named: list[Peak] = []
    end, width = 0.0, 0.0
    for name, x, colour in (("bit x₁", motion.x1, BIT), ("striker x₂", motion.x2, STRIKER)):
        frequencies, amplitudes = amplitude_spectrum(motion.time, 1e3 * x)
        highest = peaks(frequencies, amplitudes) if amplitudes.max() > _LEAST_AMPLITUDE else []
        end = end or (_SPECTRUM_SPAN * highest[0][0] if highest else 0.0)
        width = 4.0 * float(frequencies[1])
        axes.plot(frequencies, amplitudes, color=colour, linewidth=1.0, label=name)
        # Where both lines have a peak, the higher line hides the lower line, but not the marker at its top.
        tops = tuple(zip(*highest, strict=True)) or ((), ())
        axes.plot(*tops, "o", color=colour, markersize=3.2, zorder=4)
        named += highest
    end = end or _SPECTRUM_AT_REST
    axes.set_xlim(0.0, end)
    top = max(float(axes.dataLim.y1), _LEAST_AMPLITUDE)
    axes.set_ylim(0.0, 1.12 * top)  # room for the text at the highest peak
    for frequency, amplitude in [peak for peak in merge_peaks(named, width) if peak[0] < end]:
        text = f"{number(round(frequency, 2))} Hz"
        note = axes.annotate(text, (frequency, amplitude), (4, 2), textcoords="offset points", fontsize=8, zorder=5)
        note.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    axes.set_title("spectrum, second half of the run")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    axes.grid(True)
    axes.legend(loc="upper right", handlelength=1.2)
