"""Pictures of trajectories: time history, phase portraits, and of bit and striker also the amplitude spectrum."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from vibrojax.errors import InputError
from vibrojax.pictures.axes import label, number
from vibrojax.pictures.contents import TIME, Contents
from vibrojax.pictures.curves import band_text, draw_over_time, is_band
from vibrojax.pictures.hole import draw_forces, draw_hole, growth_text
from vibrojax.pictures.motion import (
    Peak,
    Run,
    Samples,
    amplitude_spectrum,
    last_impact,
    peaks,
    read_run,
    separate_peaks,
)
from vibrojax.pictures.sheet import write_margins
from vibrojax.pictures.style import BIT, DASHED, FAINT, IMPACT, STICK, STRIKER, Mark, new_figure, styled

_WINDOW = 1.5  # duration of the end of the run that is shown [s]
_OVERVIEW_FROM = 1.5  # ratio of the run's length to the window from which there is an overview
_SPECTRUM_SPAN = 5.0  # in units of the bit's dominant frequency
_SPECTRUM_AT_REST = 25.0  # span [Hz] if nothing moves
_LEAST_AMPLITUDE = 1e-6  # [mm]: less is rounding error
_DOTS = Mark(linestyle="none", marker="o", markersize=4.0, color=IMPACT)
_MOST_STATES = 6  # of a system; more would not be legible on one page


@styled
def trajectory(ds: xr.Dataset) -> Figure:
    """Draw the time history, phase portraits and spectrum of one run.

    Displacements, velocities and forces are drawn over the last 1.5 s, below an overview of the whole run.
    Sticking and impacts are marked. The transient is faint in the phase portraits of bit and striker. The amplitude
    spectrum is computed from the run's second half. In scenes with rock, bit and hole are drawn over the same time, and
    enlarged at the last impact.

    **Raises:** `InputError` if the dataset holds no trajectory.
    """
    motion = read_run(ds, "x1", "v1", "x2", "v2")
    hole = read_run(ds, "x3", "x4") if Contents(ds).hole else None
    start, end = max(float(motion.time[-1]) - _WINDOW, float(motion.time[0])), float(motion.time[-1])
    overview = float(np.ptp(motion.time)) > _OVERVIEW_FROM * _WINDOW
    forces = motion.has("impact_force", "friction_force")
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
        axes = panels["overview"]
        for name, colour in (("x1", BIT), ("x2", STRIKER)):
            draw_over_time(axes, motion.time, 1e3 * motion[name], colour, 0.4).set_rasterized(True)
        axes.axvspan(start, end, color=FAINT, alpha=0.3, linewidth=0)
        axes.set(xlim=(motion.time[0], end), ylabel="whole run\n[mm]")
        axes.set_xlabel("time [s]", labelpad=1.0)
    history = [panels[name] for name in ("displacement", "velocity", "force") if name in panels]
    for axes in history[1:]:
        axes.sharex(history[0])
    _draw_displacements(history[0], motion, start)
    history[1].axhline(0.0, color=FAINT, linewidth=0.7)
    _draw_both(history[1], motion, start, motion["u"], motion["v2"])
    history[1].set_ylabel("u and x₂′\n[m/s]" if "v" in motion.parameters else "x₁′ and x₂′\n[m/s]")
    if forces:
        draw_forces(history[2], motion, motion.since(start), "impact_force", "friction_force")
        history[2].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderpad=0.0, borderaxespad=0.2)
    for axes in history[:-1]:
        axes.tick_params(labelbottom=False)
    history[0].set_xlim(start, end)
    history[-1].set_xlabel("time [s]")
    figure.align_ylabels(history + ([panels["overview"]] if overview else []))
    if hole:
        axes = panels["rock"]
        draw_hole(axes, hole, start, end)
        axes.set_xlabel("time [s]")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderpad=0.0, borderaxespad=0.3)
    if hole and near:
        axes.axvspan(*near, color=FAINT, alpha=0.4, linewidth=0)
        impact = panels["impact"]
        draw_hole(impact, hole, *near)
        impact.set_title("enlarged: the shaded impact", loc="right")
        impact.set_xlabel("time [s]")
        impact.locator_params(axis="x", nbins=4)
    speed = "sliding speed u = x₁′ + v [m/s]" if "v" in motion.parameters else "velocity x₁′ [m/s]"
    _draw_portrait(panels["bit"], motion, "x1", motion["u"], start, speed)
    _draw_portrait(panels["striker"], motion, "x2", motion["v2"], start, "velocity x₂′ [m/s]")
    _draw_spectrum(panels["spectrum"], motion)
    write_margins(figure, ds, growth_text(hole) if hole else "", band_text(*figure.axes))
    return figure


def _contact(motion: Run) -> float | None:
    """Return the place [mm] of the contact between striker and bit, or None for a scene without impacts."""
    return 1e3 * motion.parameters["delta"] if motion.has("impact_force") and "delta" in motion.parameters else None


def _draw_displacements(axes: Axes, motion: Run, start: float) -> None:
    handles: list[Artist] = [Line2D([], [], color=BIT, label="bit"), Line2D([], [], color=STRIKER, label="striker")]
    if motion["stuck"].any():
        handles.append(Line2D([], [], color=STICK, linewidth=2.6, label="bit sticks"))
    if motion.impacts.size:
        handles.append(Line2D([], [], label="impact begins", **_DOTS))
    gap = _contact(motion)
    if gap is not None:
        look = Mark(color=FAINT, linewidth=0.8, linestyle=DASHED)
        axes.axhline(gap, **look)
        handles.append(Line2D([], [], label=f"gap Δ = {number(gap)} mm", **look))
    _draw_both(axes, motion, start, 1e3 * motion["x1"], 1e3 * motion["x2"])
    axes.set_ylabel("displacement\n[mm]")
    axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, borderpad=0.2)


def _draw_both(axes: Axes, motion: Run, start: float, of_bit: Samples, of_striker: Samples) -> None:
    """Draw a quantity of striker and bit over time; mark sticking and impacts on lines, but not on bands."""
    axes.grid(True)
    late = motion.since(start)
    striker = draw_over_time(axes, motion.time[late], of_striker[late], STRIKER, 1.1)
    bit = draw_over_time(axes, motion.time[late], of_bit[late], BIT, 1.1)
    if not is_band(bit):
        stuck = np.where(motion["stuck"] == 1, of_bit, np.nan)
        axes.plot(motion.time[late], stuck[late], color=STICK, linewidth=2.6)
    if not is_band(striker):
        times = motion.impacts[motion.impacts >= start]
        look = _DOTS | Mark(
            clip_on=not times.size
        )  # whole at the ends of the window; layout needs a clipped empty line
        axes.plot(times, np.interp(times, motion.time, of_striker), zorder=4, **look)


def _draw_portrait(axes: Axes, motion: Run, x: str, speed: Samples, start: float, speed_label: str) -> None:
    """Draw the phase portrait of bit (`x` is x1) or striker (x2), with impacts as dots.

    The transient is faint, the motion after time `start` [s] strong. Sticking is a thick line on the bit's portrait,
    the contact a vertical line on the striker's.
    """
    name, symbol, colour = ("bit", "x₁", BIT) if x == "x1" else ("striker", "x₂", STRIKER)
    axes.set(xlabel=f"{symbol} [mm]", ylabel=speed_label)
    axes.set_title(name, color=colour, fontweight="bold")
    gap = _contact(motion)
    if x == "x2" and gap is not None:
        axes.axvline(gap, color=FAINT, linewidth=0.8, linestyle=DASHED)
    late, displacement = motion.since(start), 1e3 * motion[x]
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    before = slice(None, late.start + 1)
    axes.plot(displacement[before], speed[before], color=FAINT, linewidth=0.4, alpha=0.6, rasterized=True)
    axes.plot(displacement[late], speed[late], color=colour, linewidth=1.1)
    times = motion.impacts[motion.impacts >= start]
    axes.plot(*(np.interp(times, motion.time, values) for values in (displacement, speed)), zorder=4, **_DOTS)
    if x == "x1":
        stuck = np.where(motion["stuck"] == 1, speed, np.nan)
        axes.plot(displacement[late], stuck[late], color=STICK, linewidth=2.8, zorder=3)


def _draw_spectrum(axes: Axes, motion: Run) -> None:
    """Draw the amplitude spectra of both displacements, and label the peaks with their frequencies."""
    named: list[Peak] = []
    end, width = 0.0, 0.0
    for name, x, colour in (("bit x₁", "x1", BIT), ("striker x₂", "x2", STRIKER)):
        frequencies, amplitudes = amplitude_spectrum(motion.time, 1e3 * motion[x])
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
    places, heights = np.reshape(named, (-1, 2)).T
    for index in separate_peaks(places, heights, width):
        frequency, amplitude = named[index]
        if frequency < end:
            text = f"{number(round(frequency, 2))} Hz"
            note = axes.annotate(text, (frequency, amplitude), (4, 2), textcoords="offset points", fontsize=8, zorder=5)
            note.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    axes.set_title("spectrum, second half of the run")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    axes.grid(True)
    axes.legend(loc="upper right", handlelength=1.2)


# Systems.


@styled
def states_over_time(ds: xr.Dataset) -> Figure:
    """Draw the states over the last ten periods of a motion, and a phase portrait of its first two states.

    The transient is faint in the portrait. Dots are impacts.

    **Raises:** `InputError` if the dataset holds no state.
    """
    along = [str(name) for name, data in ds.data_vars.items() if data.dims == (TIME,) and data.dtype.kind == "f"]
    names = [name for name in along if not name.endswith("_force")][:_MOST_STATES]
    if not names:
        raise InputError("no trajectory to draw: the dataset has no state along time")
    motion, end = read_run(ds, *names), float(ds[TIME].values[-1])
    length, part = _observed(ds, end)
    start = end - length
    late, impacts = motion.since(start), motion.impacts[motion.impacts >= start]
    portrait = len(names) > 1
    rows: list[Any] = [[f"{name}-over-time"] * 2 + (["portrait"] if portrait else []) for name in names]
    figure = new_figure(10.0, max(1.5 * len(names) + 1.0, 3.6))
    panels = figure.subplot_mosaic(rows)
    history = [panels[f"{name}-over-time"] for name in names]
    for name, axes in zip(names, history, strict=True):
        draw_over_time(axes, motion.time[late], motion[name][late], BIT, 0.9)
        axes.set(xlim=(start, end), ylabel=label(ds[name]))
    # Only the first state is continuous in an impact; elsewhere a dot would lie within the jump.
    history[0].plot(impacts, np.interp(impacts, motion.time, motion[names[0]]), **_DOTS | Mark(markersize=3.0))
    for axes in history[:-1]:
        axes.tick_params(labelbottom=False)
    history[-1].set_xlabel("time [s]")
    figure.align_ylabels(history)
    if portrait:
        x, y = names[:2]
        panels["portrait"].plot(motion[x], motion[y], color=FAINT, linewidth=0.5).pop().set_rasterized(True)
        panels["portrait"].plot(motion[x][late], motion[y][late], color=BIT, linewidth=1.0)
        panels["portrait"].set(xlabel=label(ds[x]), ylabel=label(ds[y]))
    about = f"Drawn: {part}" + (", grey: the whole motion" if portrait and start > 0 else "")
    write_margins(figure, ds, about, "Dots: impacts" if impacts.size else "", band_text(*figure.axes))
    return figure


def _observed(ds: xr.Dataset, end: float) -> tuple[float, str]:
    """Return the length of the part of the motion that is drawn [s] and its name: ten periods, or a tenth of it."""
    period = float(ds["period"]) if "period" in ds and ds["period"].ndim == 0 else np.nan
    if not np.isfinite(period):
        return end / 10, "the last tenth"
    return (10 * period, "the last ten periods") if 10 * period < end else (end, "the whole motion")
