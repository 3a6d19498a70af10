"""A trajectory: time history, phase portraits of bit and striker, and amplitude spectrum."""

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from vibrojax.analyses.trajectory.hole import draw_hole, force_scale, growth_text
from vibrojax.analyses.trajectory.motion import (
    Hole,
    Motion,
    Peak,
    Samples,
    amplitude_spectrum,
    last_impact,
    merged,
    peaks,
    read_hole,
    read_motion,
)
from vibrojax.errors import InputError
from vibrojax.plot.axes import number, point_text
from vibrojax.plot.contents import contents
from vibrojax.plot.envelope import band_text, draw_over_time, is_band
from vibrojax.plot.margins import write_margins
from vibrojax.plot.style import BIT, DASHED, FAINT, IMPACT, INK, STICK, STRIKER, Mark, new_figure, styled

_OVERVIEW_FROM = 1.5  # times the window, from which a run is worth an overview
_SPAN = 5.0  # of the spectrum, in units of the bit's dominant frequency
_QUIET = 25.0  # the span [Hz] where nothing moves
_LEAST = 1e-6  # amplitude [mm] below which there is nothing but rounding
_DOTS = Mark(linestyle="none", marker="o", markersize=4.0, color=IMPACT)


@styled
def trajectory(ds: xr.Dataset, last: float = 1.5) -> Figure:
    """Time history, phase portraits and spectrum of one run.

    Displacements, velocities and forces over the last `last` seconds, with stick and impacts marked, below an overview
    of the whole run; the phase portraits of bit and striker, the transient faint; the amplitude spectrum of the run's
    second half. With rock, also the bit in the hole, over the same time and at the last impact.

    **Arguments:**

    - `ds`: what `simulate` gives: `x1`, `x2` [m] and `v1`, `v2` [m/s] along `time` [s]; `impact_force` and
      `friction_force` [N], `stuck`, `event_time` and `event_kind`, `x3` and `x4` [m] where there are any.
    - `last`: how much of the end to show [s].

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where the dataset holds no trajectory, or `last` is not above 0.
    """
    if not last > 0:
        raise InputError(f"last = {last} s: give a time above 0")
    motion = read_motion(ds)
    hole = read_hole(ds) if contents(ds).hole else None
    start = max(float(motion.time[-1]) - last, float(motion.time[0]))
    overview = float(np.ptp(motion.time)) > _OVERVIEW_FROM * last
    forces = motion.impact_force is not None or motion.friction_force is not None
    heights = {"overview": 0.65} if overview else {}
    heights |= {"displacement": 1.25, "velocity": 1.25} | ({"force": 0.9} if forces else {})
    heights |= ({"rock": 1.3} if hole else {}) | {"portraits": 2.7}
    figure = new_figure(10.0, sum(heights.values()) + 0.33 * len(heights) + 1.2)
    grid = GridSpec(len(heights), 3, figure, height_ratios=list(heights.values()))
    places = {name: grid[row, :] for row, name in enumerate(heights)}
    lowest = _draw_history(figure, places, motion, start)
    if hole is not None:
        row = list(heights).index("rock")
        _draw_rock(figure, grid[row, :2], grid[row, 2], hole, motion, lowest)
    row = len(heights) - 1
    _draw_bit(figure.add_subplot(grid[row, 0]), motion, start)
    _draw_striker(figure.add_subplot(grid[row, 1]), motion, start)
    _draw_spectrum(figure.add_subplot(grid[row, 2]), motion)
    title = str(ds.attrs.get("title") or ds.attrs.get("scene", ""))
    write_margins(figure, title, point_text(ds), growth_text(hole) if hole else "", band_text(*figure.axes))
    return figure


def _draw_history(figure: Figure, places: dict[str, SubplotSpec], motion: Motion, start: float) -> Axes:
    """Draw the panels over time that are in `places`, and give the lowest."""
    if "overview" in places:
        _draw_overview(figure.add_subplot(places["overview"]), motion, start)
    displacement = figure.add_subplot(places["displacement"])
    velocity = figure.add_subplot(places["velocity"], sharex=displacement)
    _draw_displacements(displacement, motion, start)
    _draw_velocities(velocity, motion, start)
    lowest = velocity
    if "force" in places:
        lowest = figure.add_subplot(places["force"], sharex=displacement)
        _draw_forces(lowest, motion, start)
        velocity.tick_params(labelbottom=False)
    displacement.tick_params(labelbottom=False)
    displacement.set_xlim(start, motion.time[-1])
    lowest.set_xlabel("time [s]")
    figure.align_ylabels()
    return lowest


def _draw_rock(
    figure: Figure, history: SubplotSpec, enlarged: SubplotSpec, hole: Hole, motion: Motion, above: Axes
) -> None:
    """Draw the bit in the hole over the time of the panel `above`, and at the last impact in it."""
    start, end = above.get_xlim()
    axes = figure.add_subplot(history)
    draw_hole(axes, hole, start, end)
    axes.set_xlim(start, end)
    axes.set_xlabel("time [s]")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderpad=0.0, borderaxespad=0.3)
    near = last_impact(hole, motion.impacts[(motion.impacts >= start) & (motion.impacts < end)])
    if near is None:
        return
    one = figure.add_subplot(enlarged)
    draw_hole(one, hole, *near)
    one.set_xlim(*near)
    one.set_title("enlarged: the shaded impact", loc="right")
    one.set_xlabel("time [s]")
    one.locator_params(axis="x", nbins=4)
    axes.axvspan(*near, color=FAINT, alpha=0.4, linewidth=0)


def _draw_overview(axes: Axes, motion: Motion, start: float) -> None:
    for values, colour in ((motion.x1, BIT), (motion.x2, STRIKER)):
        draw_over_time(axes, motion.time, 1e3 * values, colour, 0.4).set_rasterized(True)
    axes.axvspan(start, motion.time[-1], color=FAINT, alpha=0.3, linewidth=0)
    axes.set_xlim(motion.time[0], motion.time[-1])
    axes.set_ylabel("whole run\n[mm]")
    axes.set_xlabel("time [s]", labelpad=1.0)


def _draw_displacements(axes: Axes, motion: Motion, start: float) -> None:
    late = motion.since(start)
    axes.grid(True)
    if motion.delta is not None:
        axes.axhline(1e3 * motion.delta, color=FAINT, linewidth=0.8, linestyle=DASHED)
    striker = draw_over_time(axes, motion.time[late], 1e3 * motion.x2[late], STRIKER, 1.1)
    bit = draw_over_time(axes, motion.time[late], 1e3 * motion.x1[late], BIT, 1.1)
    if not is_band(bit):
        axes.plot(motion.time[late], _where_stuck(motion, 1e3 * motion.x1)[late], color=STICK, linewidth=2.6)
    if not is_band(striker):
        _mark_impacts(axes, motion, start, 1e3 * motion.x2)
    axes.set_ylabel("displacement\n[mm]")
    axes.legend(handles=_handles(motion), loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, borderpad=0.2)


def _draw_velocities(axes: Axes, motion: Motion, start: float) -> None:
    late = motion.since(start)
    axes.grid(True)
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    striker = draw_over_time(axes, motion.time[late], motion.v2[late], STRIKER, 1.1)
    bit = draw_over_time(axes, motion.time[late], motion.u[late], BIT, 1.1)
    if not is_band(bit):
        axes.plot(motion.time[late], _where_stuck(motion, motion.u)[late], color=STICK, linewidth=2.6)
    if not is_band(striker):
        _mark_impacts(axes, motion, start, motion.v2)
    axes.set_ylabel("u and x₂′\n[m/s]" if motion.v is not None else "x₁′ and x₂′\n[m/s]")


def _draw_forces(axes: Axes, motion: Motion, start: float) -> None:
    late = motion.since(start)
    axes.grid(True)
    friction, impact = motion.friction_force, motion.impact_force
    shown = [values for values in (friction, impact) if values is not None]
    factor, unit = force_scale(shown)
    if impact is not None:
        draw_over_time(axes, motion.time[late], factor * impact[late], IMPACT, 1.0, "impact force J")
    if friction is not None:
        draw_over_time(axes, motion.time[late], factor * friction[late], INK, 0.8, "friction force F")
    axes.set_ylabel(f"force\n[{unit}]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderpad=0.0, borderaxespad=0.2)


def _mark_impacts(axes: Axes, motion: Motion, start: float, values: Samples) -> None:
    times = motion.impacts[motion.impacts >= start]
    axes.plot(times, motion.at(times, values), zorder=4, **_DOTS)


def _where_stuck(motion: Motion, values: Samples) -> Samples:
    return np.where(motion.stuck, values, np.nan)


def _handles(motion: Motion) -> list[Artist]:
    handles: list[Artist] = [Line2D([], [], color=BIT, label="bit"), Line2D([], [], color=STRIKER, label="striker")]
    if motion.stuck.any():
        handles.append(Line2D([], [], color=STICK, linewidth=2.6, label="bit sticks"))
    if motion.impacts.size:
        handles.append(Line2D([], [], label="impact begins", **_DOTS))
    if motion.delta is not None:
        gap = f"gap Δ = {number(1e3 * motion.delta)} mm"
        handles.append(Line2D([], [], color=FAINT, linewidth=0.8, linestyle=DASHED, label=gap))
    return handles


# Phase portraits and spectrum.


def _draw_bit(axes: Axes, motion: Motion, start: float) -> None:
    """Draw the bit's phase portrait: sliding speed against displacement, stick as a thick line."""
    _draw_portrait(axes, motion, motion.x1, motion.u, start, BIT)
    late = motion.since(start)
    stuck = np.where(motion.stuck, motion.u, np.nan)
    axes.plot(1e3 * motion.x1[late], stuck[late], color=STICK, linewidth=2.8, zorder=3)
    axes.set_title("bit", color=BIT, fontweight="bold")
    axes.set_xlabel("x₁ [mm]")
    axes.set_ylabel("sliding speed u = x₁′ + v [m/s]" if motion.v is not None else "velocity x₁′ [m/s]")


def _draw_striker(axes: Axes, motion: Motion, start: float) -> None:
    """Draw the striker's phase portrait: velocity against displacement, the contact at delta as a line."""
    if motion.delta is not None:
        axes.axvline(1e3 * motion.delta, color=FAINT, linewidth=0.8, linestyle=DASHED)
    _draw_portrait(axes, motion, motion.x2, motion.v2, start, STRIKER)
    axes.set_title("striker", color=STRIKER, fontweight="bold")
    axes.set_xlabel("x₂ [mm]")
    axes.set_ylabel("velocity x₂′ [m/s]")


def _draw_portrait(axes: Axes, motion: Motion, x: Samples, speed: Samples, start: float, colour: str) -> None:
    """The transient faint, what comes after `start` strong, impacts as points."""
    late = motion.since(start)
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    before = slice(None, late.start + 1)
    axes.plot(1e3 * x[before], speed[before], color=FAINT, linewidth=0.4, alpha=0.6, rasterized=True)
    axes.plot(1e3 * x[late], speed[late], color=colour, linewidth=1.1)
    times = motion.impacts[motion.impacts >= start]
    axes.plot(1e3 * motion.at(times, x), motion.at(times, speed), zorder=4, **_DOTS)


def _draw_spectrum(axes: Axes, motion: Motion) -> None:
    """Draw the amplitude spectra of both displacements, and name their peaks in Hz."""
    named: list[Peak] = []
    end, width = 0.0, 0.0
    for name, x, colour in (("bit x₁", motion.x1, BIT), ("striker x₂", motion.x2, STRIKER)):
        frequencies, amplitudes = amplitude_spectrum(motion.time, 1e3 * x)
        highest = peaks(frequencies, amplitudes) if amplitudes.max() > _LEAST else []
        end = end or (_SPAN * highest[0][0] if highest else 0.0)
        width = 4.0 * float(frequencies[1])
        axes.plot(frequencies, amplitudes, color=colour, linewidth=1.0, label=name)
        # At the same frequency the higher line hides the lower one; not its top.
        at = tuple(zip(*highest, strict=True)) or ((), ())
        axes.plot(*at, "o", color=colour, markersize=3.2, zorder=4)
        named += highest
    end = end or _QUIET
    axes.set_xlim(0.0, end)
    axes.set_ylim(0.0, 1.12 * max(float(axes.dataLim.y1), _LEAST))  # room for the name of the highest peak
    _name_peaks(axes, [peak for peak in merged(named, width) if peak[0] < end])
    axes.set_title("spectrum, second half of the run")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    axes.grid(True)
    axes.legend(loc="upper right", handlelength=1.2)


def _name_peaks(axes: Axes, named: list[Peak]) -> None:
    for frequency, amplitude in named:
        text = f"{number(round(frequency, 2))} Hz"
        name = axes.annotate(text, (frequency, amplitude), (4, 2), textcoords="offset points", fontsize=8, zorder=5)
        name.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
