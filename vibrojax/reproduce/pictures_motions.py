"""Pictures of motions with the same axes as the source's figures; `source.toml` calls these functions.

"Fig." and "eq." refer to the source.
"""

from collections.abc import Sequence
from itertools import repeat

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.models.physics.contact import restitution
from vibrojax.plot.style import BIT, FAINT, IMPACT, INK, ROCK, STICK, STRIKER, new_figure
from vibrojax.reproduce.closed_forms import LOSS_FACTORS
from vibrojax.reproduce.motions import (
    DRIVE_SPEED,
    envelope,
    events,
    last_cycle,
    power_spectrum,
    swept_frequency,
    within,
)
from vibrojax.reproduce.struck_mass import Blows

FIGURE_WIDTH = 6.4
"""Width of a figure [inch]: half the width of the text on the reproduction page."""
LINE_COLOURS = ("#004488", "#CC6677", "#8C6D1F", "#2E8B57", "#7A5195", "#56B4E9")
"""Line colours that are distinct in greyscale, too."""
_AXIS_LABELS = {"x1": "x₁ [mm]", "x2": "x₂ [mm]", "v1": "x₁′ [m/s]", "v2": "x₂′ [m/s]"}
_BODY_COLOURS = {"1": BIT, "2": STRIKER}

Motions = Sequence[xr.Dataset]
Texts = Sequence[str]


def stacked(
    height: float, x: str, y: Texts, titles: Texts = (), share: bool = True, grid: bool = True
) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with a panel for each label in `y`, one above the other; a common abscissa `x` if `share`."""
    figure = new_figure(FIGURE_WIDTH, 0.7 + height * len(y))
    figure.subplots(len(y), 1, sharex=share)
    for axes, label, title in zip(figure.axes, y, titles or repeat(""), strict=False):
        axes.grid(grid)
        axes.set_ylabel(label)
        axes.set_title(title, loc="left")
    figure.axes[-1].set_xlabel(x)
    return figure, figure.axes


def in_row(
    height: float, x: Texts, y: str, titles: Texts = (), share: bool = False, grid: bool = True
) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with a panel for each label in `x`, side by side; they have a common ordinate `y` if `share`."""
    figure = new_figure(FIGURE_WIDTH, height)
    figure.subplots(1, len(x), sharey=share)
    for axes, label, title in zip(figure.axes, x, titles or repeat(""), strict=False):
        axes.grid(grid)
        axes.set(xlabel=label, title=title)
    figure.axes[0].set_ylabel(y)
    return figure, figure.axes


def _draw_portrait(axes: Axes, motion: xr.Dataset, body: str, since: float, stride: int = 1) -> None:
    """Draw a phase portrait of the bit (`body` "1") or striker ("2"): thin before `since` [s], thick afterwards."""
    late = within(motion, since)
    for part, linewidth, alpha in ((~late, 0.35, 0.6), (late, 1.2, None)):
        x_mm, velocity = 1e3 * motion[f"x{body}"].values[part][::stride], motion[f"v{body}"].values[part][::stride]
        axes.plot(x_mm, velocity, color=_BODY_COLOURS[body], linewidth=linewidth, alpha=alpha, rasterized=True)


def over_time(motions: Motions, names: Texts, until: float, titles: Texts = (), stride: int = 1) -> Figure:
    """Draw variables over time up to `until` [s], with one panel per motion and variable name."""
    rows = [(motion, name) for motion in motions for name in names]
    figure, panels = stacked(1.3, "time [s]", [_AXIS_LABELS[name] for _, name in rows], titles)
    for axes, (motion, name) in zip(panels, rows, strict=True):
        values = (1e3 if name[0] == "x" else 1.0) * motion[name].values[::stride]
        colour = _BODY_COLOURS[name[1]]
        axes.plot(motion["time"].values[::stride], values, color=colour, linewidth=0.5, rasterized=True)
    panels[-1].set_xlim(0, until)
    return figure


def portraits(motions: Motions, since: Sequence[float], titles: Texts = (), height: float = 3.0) -> Figure:
    """Draw phase portraits of bit and striker for each motion.

    `since` [s] (one time per motion): the lines are thick from there on. If there are `titles`, the earlier part of the
    motion is not drawn.
    """
    labels = ["bit x₁ [mm]", "striker x₂ [mm]"] * len(motions)
    figure, panels = in_row(height, labels, "velocity [m/s]", [title for title in titles for _ in "12"])
    for index, (motion, begin) in enumerate(zip(motions, since, strict=True)):
        shown = motion.isel(time=within(motion, begin)) if titles else motion
        for axes, body in zip(panels[2 * index :], "12", strict=False):
            _draw_portrait(axes, shown, body, begin, 2 if titles else 4)
    return figure


def strikers(
    motions: Motions, since: float, titles: Texts, stride: int = 1, limits: tuple[float, float] | None = None
) -> Figure:
    """Draw the striker's phase portraits from `since` [s] on; `limits` [mm] are common limits of the abscissas."""
    figure, panels = in_row(2.6, ["x₂ [mm]"] * len(motions), "x₂′ [m/s]", titles, share=limits is not None)
    for axes, motion in zip(panels, motions, strict=True):
        _draw_portrait(axes, motion.isel(time=within(motion, since)), "2", since, stride)
        if limits:
            axes.set_xlim(*limits)
    return figure


def limit_cycles(motions: Motions, titles: Texts) -> Figure:
    """Draw phase portraits that approach the limit cycle from several initial states (Figs 5.28 to 5.31)."""
    labels = ["bit displacement x₁ [mm]"] * len(motions)
    figure, panels = in_row(3.0, labels, "bit velocity x₁′ [m/s]", titles, share=True)
    for axes, motion in zip(panels, motions, strict=True):
        _draw_portrait(axes, motion, "1", 35.0)
        axes.plot(1e3 * motion["x1"][0], motion["v1"][0], "o", color=INK, markersize=5)
    return figure


def struck_masses(masses: Sequence[Blows]) -> Figure:
    """Draw the displacements of three masses that hit a stop over time (Figs 5.1, 5.2, 5.7)."""
    titles, windows = ("free, on an elastic stop", "Tsaplin's hammer", "thrown ball"), ((0.0, 2.0), (58.0, 60.0))
    figure, panels = stacked(1.1, "time [s]", ["x [mm]"] * 3, titles, share=False, grid=False)
    for axes, mass, (begin, end) in zip(panels, masses, (*windows, windows[1]), strict=True):
        time, x = mass.path
        inside = (time >= begin) & (time <= end)
        axes.plot(time[inside] - begin, 1e3 * x[inside], color=BIT, linewidth=1.1)
        for impact in mass.times[(mass.times >= begin) & (mass.times <= end)]:
            axes.axvline(impact - begin, color=FAINT, linewidth=0.6)
    return figure


def restitution_of_blows(restitutions: Sequence[float]) -> Figure:
    """Draw the coefficient of restitution over the loss factor, in closed form (eq. 5.8) and of simulated blows."""
    figure, (axes,) = in_row(2.8, ["loss factor ξ"], "restitution R")
    xi = np.linspace(0, 1, 200)
    axes.plot(xi, restitution(xi), color=INK, linewidth=1.1, label="closed form")
    axes.plot(LOSS_FACTORS, restitutions, "o", color=BIT, label="simulated blow")
    axes.legend()
    return figure


def friction_in_time(motion: xr.Dataset) -> Figure:
    """Draw the friction force in the first 12 s, and force and sliding speed after 39.2 s (Figs 5.32, 5.33).

    In the first panel the vibration grows; in the second panel it is periodic.
    """
    figure, panels = stacked(1.6, "time [s]", ["friction F [N]"] * 2, share=False)
    time, friction, late = motion["time"].values, motion["friction_force"].values, within(motion, 39.2)
    panels[0].plot(time, friction, color=INK, linewidth=0.4, rasterized=True)
    panels[0].set_xlim(0, 12)
    panels[1].plot(time[late], friction[late], color=INK, linewidth=1.1)
    twin = panels[1].twinx()
    twin.plot(time[late], motion["v1"].values[late] + DRIVE_SPEED, color=BIT, linewidth=1.1)
    twin.set_ylabel("sliding speed u [m/s]", color=BIT)
    return figure


def spectra(motions: Motions, since: Sequence[float], titles: Texts) -> Figure:
    """Draw power spectra of both velocities up to 20 Hz, normalised to a maximum of 1 (Figs 5.25, 5.26, 5.50)."""
    labels = ["frequency [Hz]"] * len(motions)
    figure, panels = in_row(2.8, labels, "power, greatest 1", titles, share=True, grid=False)
    for axes, motion, begin in zip(panels, motions, since, strict=True):
        for name, colour, label in (("v1", BIT, "bit"), ("v2", STRIKER, "striker")):
            frequencies, power = power_spectrum(motion, name, begin, padding=4)
            low = frequencies <= 20.0
            axes.plot(frequencies[low], power[low] / power[low].max(), color=colour, linewidth=1.0, label=label)
        axes.axhline(0, color=FAINT, linewidth=0.5)
    panels[0].legend()
    panels[0].set_xticks(np.arange(0, 21, 5))
    return figure


def working_cycle(motion: xr.Dataset) -> Figure:
    """Draw displacements, velocities and the bit's acceleration over two cycles (Figs 5.52, 5.72).

    Intervals of sticking and the times of impacts are marked.
    """
    begin, end = last_cycle(motion)
    begin -= end - begin
    shown = within(motion, begin, end)
    cycles, time = motion.isel(time=shown), motion["time"].values[shown]
    title = "bit blue, sticking thick black; striker orange; impacts dashed"
    figure, panels = stacked(1.35, "time [s]", ("x₁, x₂ [mm]", "x₁′, x₂′ [m/s]", "x₁″ [m/s²]"), (title, "", ""))
    for axes, variable, factor in ((panels[0], "x", 1e3), (panels[1], "v", 1.0)):
        for body, colour in _BODY_COLOURS.items():
            axes.plot(time, factor * cycles[variable + body].values, color=colour, linewidth=1.1)
            if body == "1":
                stuck = np.where(cycles["stuck"].values == 1, factor * cycles[variable + body].values, np.nan)
                axes.plot(time, stuck, color=STICK, linewidth=2.6)
    acceleration = np.gradient(motion["v1"].values, motion["time"].values)[shown]
    panels[2].plot(time, acceleration, color=BIT, linewidth=1.1)
    usual = np.quantile(np.abs(acceleration), 0.97)
    panels[2].set_ylim(-2 * usual, 2 * usual)
    for axes in panels:
        for impact in events(motion, "impact", begin):
            axes.axvline(impact, color=IMPACT, linewidth=0.8, linestyle=(0, (3, 2)))
    panels[2].set_xlim(begin, end)
    return figure


def forces_in_blow(motion: xr.Dataset) -> Figure:
    """Draw the impact force and the friction force during one blow (Figs 5.51, 5.74)."""
    impact = events(motion, "impact", 10.0)[-1]
    blow = motion.isel(time=within(motion, impact - 3e-3, impact + 9e-3))
    time = 1e3 * (blow["time"].values - impact)
    figure, panels = stacked(1.4, "time since the impact began [ms]", ("impact J [kN]", "friction F [kN]"))
    panels[0].plot(time, blow["impact_force"].values / 1e3, color=IMPACT, linewidth=1.3)
    panels[1].plot(time, blow["friction_force"].values / 1e3, color=INK, linewidth=1.1)
    return figure


def last_cycles(motions: Motions, titles: Texts, duration: float, bodies: str, height: float) -> Figure:
    """Draw displacements over the last `duration` [s] of each motion.

    `bodies` "12" draws bit and striker with the stop (motions in phase and in counter-phase, Figs 5.60, 5.67). "2"
    draws the striker with its impacts (single, alternating single and double, and irregular impacts, Fig. 5.77).
    """
    labels = ["x₂ [mm]" if bodies == "2" else "x₁, x₂ [mm]"] * len(motions)
    figure, panels = stacked(height, "time [s]", labels, titles, grid=False)
    for axes, motion in zip(panels, motions, strict=True):
        begin = float(motion["time"][-1]) - duration
        end = motion.isel(time=within(motion, begin))
        for body in bodies:
            colour = _BODY_COLOURS[body]
            axes.plot(end["time"].values - begin, 1e3 * end[f"x{body}"].values, color=colour, linewidth=1.1)
        if bodies == "2":
            impacts = events(motion, "impact", begin)
            axes.plot(impacts - begin, np.full(len(impacts), -5.0), "o", color=IMPACT, markersize=3.5)
        else:
            axes.axhline(-5, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)))
    return figure


def swept_sine(motions: Motions, stiffnesses: Sequence[int]) -> Figure:
    """Draw the bit's velocity amplitude and the depth of the hole over the frequency (Figs 6.4 to 6.7)."""
    labels = ("swing of x₃′ [mm/s]", "hole x₄ [mm]")
    figure, panels = stacked(1.5, "frequency of the swept sine [Hz]", labels, grid=False)
    for motion, k3, colour in zip(motions, stiffnesses, LINE_COLOURS, strict=False):
        middles, swings = envelope(motion, "v3", 0.1)
        panels[0].plot(swept_frequency(middles), 1e3 * swings, color=colour, label=f"k₃ = {k3} MN/m")
        frequency = swept_frequency(motion["time"].values[::50])
        panels[1].plot(frequency, 1e3 * motion["x4"].values[::50], color=colour)
    panels[0].legend()
    return figure


def _draw_hole(axes: Axes, motion: xr.Dataset, unit: float) -> None:
    """Draw the displacements of bit (thin) and hole (thick) over time in units of `unit` [s]."""
    time = motion["time"].values / unit
    axes.plot(time, 1e3 * motion["x4"].values, color=ROCK, linewidth=2.0, label="hole x₄")
    axes.plot(time, 1e3 * motion["x3"].values, color=BIT, linewidth=0.9, label="bit x₃")


def bit_and_hole(motions: Motions, titles: Texts, until_ms: int = 0) -> Figure:
    """Draw the displacements of bit and hole under pulses (Figs 6.8 to 6.11, 6.14, 6.16).

    `until_ms`: duration [ms] of the drawn beginning; 0 draws the complete motion.
    """
    labels = ["time [ms]" if until_ms else "time [s]"] * len(motions)
    figure, panels = in_row(2.6, labels, "x₃, x₄ [mm]" if until_ms else "displacement [mm]", titles)
    for axes, motion in zip(panels, motions, strict=True):
        _draw_hole(axes, motion, 1e-3 if until_ms else 1.0)
        if until_ms:
            axes.set_xlim(0, until_ms)
            axes.set_ylim(top=1.15 * 1e3 * motion["x3"].values[1e3 * motion["time"].values < until_ms].max())
    if not until_ms:
        panels[0].legend()
    return figure


def hole_in_steps(motion: xr.Dataset) -> Figure:
    """Draw the impact force, and the displacements of bit and hole, over three cycles (Figs 6.29, 6.31)."""
    begin, end = last_cycle(motion)
    cycles = motion.isel(time=within(motion, end - 3 * (end - begin), end))
    figure, panels = stacked(1.5, "time [s]", ("impact J [kN]", "x₃, x₄ [mm]"), grid=False)
    panels[0].plot(cycles["time"].values, cycles["impact_force"].values / 1e3, color=IMPACT)
    _draw_hole(panels[1], cycles, 1.0)
    panels[1].legend(loc="upper left")
    return figure
