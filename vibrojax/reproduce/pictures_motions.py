"""Pictures of motions with the same axes as the source's figures; `source.toml` calls these functions.

"Fig." and "eq." refer to the source.
"""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.models.physics.contact import restitution
from vibrojax.plot.style import BIT, FAINT, IMPACT, INK, ROCK, STICK, STRIKER
from vibrojax.reproduce.closed_forms import LOSS_FACTORS
from vibrojax.reproduce.figures import LINE_COLOURS, draw_portrait, in_row, single_panel, stacked, window
from vibrojax.reproduce.motions import DRIVE_SPEED, envelope, events, last_cycle, power_spectrum, swept_frequency
from vibrojax.reproduce.struck_mass import Blows

Motions = Sequence[xr.Dataset]
Titles = Sequence[str]


def struck_masses(masses: Sequence[Blows]) -> Figure:
    """Draw the displacements of three masses that hit a stop over time (Figs 5.1, 5.2, 5.7)."""
    figure, panels = stacked(3, 1.1, share=False, grid=False)
    cases = (("free, on an elastic stop", 0.0, 2.0), ("Tsaplin's hammer", 58.0, 60.0), ("thrown ball", 58.0, 60.0))
    for axes, mass, (title, begin, end) in zip(panels, masses, cases, strict=True):
        time, x = mass.path
        inside = (time >= begin) & (time <= end)
        axes.plot(time[inside] - begin, 1e3 * x[inside], color=BIT, linewidth=1.1)
        for impact in mass.times[(mass.times >= begin) & (mass.times <= end)]:
            axes.axvline(impact - begin, color=FAINT, linewidth=0.6)
        axes.set_title(title, loc="left")
        axes.set_ylabel("x [mm]")
    panels[-1].set_xlabel("time [s]")
    return figure


def restitution_of_blows(restitutions: Sequence[float]) -> Figure:
    """Draw the coefficient of restitution over the loss factor, in closed form (eq. 5.8) and of simulated blows."""
    figure, axes = single_panel(2.8)
    xi = np.linspace(0, 1, 200)
    axes.plot(xi, restitution(xi), color=INK, linewidth=1.1, label="closed form")
    axes.plot(LOSS_FACTORS, restitutions, "o", color=BIT, label="simulated blow")
    axes.set(xlabel="loss factor ξ", ylabel="restitution R")
    axes.legend()
    return figure


def limit_cycles(motions: Motions, titles: Titles) -> Figure:
    """Draw phase portraits that approach the limit cycle from several initial states (Figs 5.28 to 5.31)."""
    figure, panels = in_row(len(motions), share=True)
    for axes, motion, title in zip(panels, motions, titles, strict=True):
        draw_portrait(axes, motion, "1", 35.0)
        axes.plot(1e3 * motion["x1"][0], motion["v1"][0], "o", color=INK, markersize=5)
        axes.set(title=title, xlabel="bit displacement x₁ [mm]")
    panels[0].set_ylabel("bit velocity x₁′ [m/s]")
    return figure


def friction_in_time(motion: xr.Dataset) -> Figure:
    """Draw the friction force in the first 12 s, and force and sliding speed after 39.2 s (Figs 5.32, 5.33).

    In the first panel the vibration grows; in the second panel it is periodic.
    """
    figure, panels = stacked(2, 1.6, share=False)
    time, friction, late = motion["time"].values, motion["friction_force"].values, window(motion, 39.2)
    panels[0].plot(time, friction, color=INK, linewidth=0.4, rasterized=True)
    panels[0].set_xlim(0, 12)
    panels[1].plot(time[late], friction[late], color=INK, linewidth=1.1)
    twin = panels[1].twinx()
    twin.plot(time[late], motion["v1"].values[late] + DRIVE_SPEED, color=BIT, linewidth=1.1)
    twin.set_ylabel("sliding speed u [m/s]", color=BIT)
    for axes in panels:
        axes.set_ylabel("friction F [N]")
    panels[1].set_xlabel("time [s]")
    return figure


def spectra(motions: Motions, since: Sequence[float | int], titles: Titles) -> Figure:
    """Draw power spectra of both velocities up to 20 Hz, normalised to a maximum of 1 (Figs 5.25, 5.26, 5.50)."""
    figure, panels = in_row(len(motions), 2.8, share=True, grid=False)
    for axes, motion, begin, title in zip(panels, motions, since, titles, strict=True):
        for name, colour, label in (("v1", BIT, "bit"), ("v2", STRIKER, "striker")):
            frequencies, power = power_spectrum(motion, name, begin, padding=4)
            low = frequencies <= 20.0
            axes.plot(frequencies[low], power[low] / power[low].max(), color=colour, linewidth=1.0, label=label)
        axes.set(title=title, xlabel="frequency [Hz]")
        axes.axhline(0, color=FAINT, linewidth=0.5)
    panels[0].set_ylabel("power, greatest 1")
    panels[0].legend()
    panels[0].set_xticks(np.arange(0, 21, 5))
    return figure


def working_cycle(motion: xr.Dataset) -> Figure:
    """Draw displacements, velocities and the bit's acceleration over two cycles (Figs 5.52, 5.72).

    Intervals of sticking and the times of impacts are marked.
    """
    begin, end = last_cycle(motion)
    begin -= end - begin
    cycles = motion.isel(time=window(motion, begin, end))
    time = cycles["time"].values
    figure, panels = stacked(3, 1.35)
    for axes, variable, factor in ((panels[0], "x", 1e3), (panels[1], "v", 1.0)):
        for body, colour in (("1", BIT), ("2", STRIKER)):
            axes.plot(time, factor * cycles[variable + body].values, color=colour, linewidth=1.1)
            if body == "1":
                stuck = np.where(cycles["stuck"].values == 1, factor * cycles[variable + body].values, np.nan)
                axes.plot(time, stuck, color=STICK, linewidth=2.6)
    acceleration = np.gradient(motion["v1"].values, motion["time"].values)[window(motion, begin, end)]
    panels[2].plot(time, acceleration, color=BIT, linewidth=1.1)
    usual = np.quantile(np.abs(acceleration), 0.97)
    panels[2].set_ylim(-2 * usual, 2 * usual)
    for axes, label in zip(panels, ("x₁, x₂ [mm]", "x₁′, x₂′ [m/s]", "x₁″ [m/s²]"), strict=True):
        axes.set_ylabel(label)
        for impact in events(motion, "impact", begin):
            axes.axvline(impact, color=IMPACT, linewidth=0.8, linestyle=(0, (3, 2)))
    panels[0].set_title("bit blue, sticking thick black; striker orange; impacts dashed", loc="left")
    panels[2].set_xlabel("time [s]")
    panels[2].set_xlim(begin, end)
    return figure


def forces_in_blow(motion: xr.Dataset) -> Figure:
    """Draw the impact force and the friction force during one blow (Figs 5.51, 5.74)."""
    impact = events(motion, "impact", 10.0)[-1]
    blow = motion.isel(time=window(motion, impact - 3e-3, impact + 9e-3))
    time = 1e3 * (blow["time"].values - impact)
    figure, panels = stacked(2, 1.4)
    panels[0].plot(time, blow["impact_force"].values / 1e3, color=IMPACT, linewidth=1.3)
    panels[1].plot(time, blow["friction_force"].values / 1e3, color=INK, linewidth=1.1)
    for axes, label in zip(panels, ("impact J [kN]", "friction F [kN]"), strict=True):
        axes.set_ylabel(label)
    panels[1].set_xlabel("time since the impact began [ms]")
    return figure


def last_cycles(motions: Motions, titles: Titles, duration: float, bodies: str, height: float) -> Figure:
    """Draw displacements over the last `duration` [s] of each motion.

    `bodies` "12" draws bit and striker with the stop (motions in phase and in counter-phase, Figs 5.60, 5.67). "2"
    draws the striker with its impacts (single, alternating single and double, and irregular impacts, Fig. 5.77).
    """
    figure, panels = stacked(len(motions), height, grid=False)
    for axes, motion, title in zip(panels, motions, titles, strict=True):
        begin = float(motion["time"][-1]) - duration
        end = motion.isel(time=window(motion, begin))
        for body in bodies:
            colour = BIT if body == "1" else STRIKER
            axes.plot(end["time"].values - begin, 1e3 * end[f"x{body}"].values, color=colour, linewidth=1.1)
        if bodies == "2":
            impacts = events(motion, "impact", begin)
            axes.plot(impacts - begin, np.full(len(impacts), -5.0), "o", color=IMPACT, markersize=3.5)
        else:
            axes.axhline(-5, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set_title(title, loc="left")
        axes.set_ylabel("x₂ [mm]" if bodies == "2" else "x₁, x₂ [mm]")
    panels[-1].set_xlabel("time [s]")
    return figure


def swept_sine(motions: Motions, stiffnesses: Sequence[int]) -> Figure:
    """Draw the bit's velocity amplitude and the depth of the hole over the frequency (Figs 6.4 to 6.7)."""
    figure, panels = stacked(2, 1.5, grid=False)
    for motion, k3, colour in zip(motions, stiffnesses, LINE_COLOURS, strict=False):
        middles, swings = envelope(motion, "v3", 0.1)
        panels[0].plot(swept_frequency(middles), 1e3 * swings, color=colour, label=f"k₃ = {k3} MN/m")
        frequency = swept_frequency(motion["time"].values[::50])
        panels[1].plot(frequency, 1e3 * motion["x4"].values[::50], color=colour)
    panels[0].set_ylabel("swing of x₃′ [mm/s]")
    panels[1].set(ylabel="hole x₄ [mm]", xlabel="frequency of the swept sine [Hz]")
    panels[0].legend()
    return figure


def _draw_hole(axes: Axes, motion: xr.Dataset, unit: str) -> None:
    """Draw the displacements of bit (thin) and hole (thick) over time; `unit` of time: "s" or "ms"."""
    time = motion["time"].values * {"s": 1.0, "ms": 1e3}[unit]
    axes.plot(time, 1e3 * motion["x4"].values, color=ROCK, linewidth=2.0, label="hole x₄")
    axes.plot(time, 1e3 * motion["x3"].values, color=BIT, linewidth=0.9, label="bit x₃")
    axes.set_xlabel(f"time [{unit}]")


def bit_and_hole(motions: Motions, titles: Titles, until_ms: int = 0) -> Figure:
    """Draw the displacements of bit and hole under pulses (Figs 6.8 to 6.11, 6.14, 6.16).

    `until_ms`: duration [ms] of the drawn beginning; 0 draws the complete motion.
    """
    figure, panels = in_row(len(motions), 2.6)
    for axes, motion, title in zip(panels, motions, titles, strict=True):
        _draw_hole(axes, motion, "ms" if until_ms else "s")
        if until_ms:
            axes.set_xlim(0, until_ms)
            axes.set_ylim(top=1.15 * 1e3 * motion["x3"].values[1e3 * motion["time"].values < until_ms].max())
        axes.set_title(title)
    panels[0].set_ylabel("x₃, x₄ [mm]" if until_ms else "displacement [mm]")
    if not until_ms:
        panels[0].legend()
    return figure


def hole_in_steps(motion: xr.Dataset) -> Figure:
    """Draw the impact force, and the displacements of bit and hole, over three cycles (Figs 6.29, 6.31)."""
    begin, end = last_cycle(motion)
    cycles = motion.isel(time=window(motion, end - 3 * (end - begin), end))
    figure, panels = stacked(2, 1.5, grid=False)
    panels[0].plot(cycles["time"].values, cycles["impact_force"].values / 1e3, color=IMPACT)
    _draw_hole(panels[1], cycles, "s")
    panels[0].set_ylabel("impact J [kN]")
    panels[1].set_ylabel("x₃, x₄ [mm]")
    panels[1].legend(loc="upper left")
    return figure
