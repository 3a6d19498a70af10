"""Pictures of the self-excitation without impact."""

import numpy as np

from vibrojax.reproduce.pictures._paper import (
    BIT,
    FAINT,
    INK,
    STRIKER,
    beside,
    draw_portrait,
    over_time,
    spectrum,
    stacked,
    strikers,
    styled,
    window,
)


@styled
def velocities(*motions):
    """Velocity of the bit over time, one panel for each drive speed (Figs 5.19 to 5.21)."""
    return over_time([(one, "v1") for one in motions], 40.0, [f"v = {v} m/s" for v in (0.5, 1.5, 2.5)])


@styled
def limit_cycle(inside, outside):
    """The limit cycle from the centre and from outside (Figs 5.28 to 5.31)."""
    figure, panels = beside(2, share=True)
    for axes, motion, title in zip(panels, (inside, outside), ("from zero", "from 10 mm, 3.5 m/s"), strict=True):
        draw_portrait(axes, motion, "x1", "v1", BIT, 35.0)
        axes.plot(1e3 * motion["x1"][0], motion["v1"][0], "o", color=INK, markersize=5)
        axes.set_title(title)
        axes.set_xlabel("bit displacement x₁ [mm]")
    panels[0].set_ylabel("bit velocity x₁′ [m/s]")
    return figure


@styled
def settling(*lanes):
    """Settling time over the drive speed and over gamma (Figs 5.22, 5.38); the first five lanes are over speed."""
    figure, panels = beside(2, 2.8)
    over = ((lanes[:5], (0.5, 1.0, 1.5, 2.0, 2.5), "driving velocity v [m/s]"),)
    over += ((lanes[5:], (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), "frequency ratio γ (β = 0.3)"),)
    for axes, (part, values, label) in zip(panels, over, strict=True):
        axes.plot(values, [one["settling_time"] for one in part], "o-", color=BIT, markersize=4)
        axes.set_xlabel(label)
        axes.grid(True)
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("settling time [s]")
    return figure


@styled
def friction_in_time(motion):
    """Friction force with its self-excitation, and with the velocity in the steady state (Figs 5.32, 5.33)."""
    figure, panels = stacked(2, 1.6, share=False)
    time = motion["time"].values
    panels[0].plot(time, motion["friction_force"], color=INK, linewidth=0.4, rasterized=True)
    panels[0].set_xlim(0, 12)
    late = window(motion, 39.2)
    panels[1].plot(time[late], motion["friction_force"].values[late], color=INK, linewidth=1.1, label="friction F")
    twin = panels[1].twinx()
    twin.plot(time[late], motion["v1"].values[late] + 1.5, color=BIT, linewidth=1.1)
    twin.set_ylabel("sliding speed u [m/s]", color=BIT)
    for axes in panels:
        axes.set_ylabel("friction F [N]")
        axes.grid(True)
    panels[1].set_xlabel("time [s]")
    return figure


@styled
def decaying(*motions):
    """Decaying vibration at gamma 0.9 and 1.2 (Figs 5.39, 5.40)."""
    return over_time([(one, "v1") for one in motions], 30.0, [f"γ = {gamma}" for gamma in (0.9, 1.2)])


@styled
def lobed(*motions):
    """Phase portraits of the striker at gamma 3, 9 and 10 (Figs 5.44, 5.45, 5.47)."""
    return strikers(motions, [f"γ = {gamma}" for gamma in (3, 9, 10)], 58.0)


@styled
def spectra(usual, two):
    """Power spectra of both velocities, Table 5.1 and where two frequencies stay (Figs 5.25, 5.26, 5.50)."""
    figure, panels = beside(2, 2.8, share=True)
    titles = ("β 0.4, γ 0.75, v 1.5 m/s", "β 0.4, γ 1.2, v 0.5 m/s")
    for axes, motion, since, title in zip(panels, (usual, two), (20.0, 40.0), titles, strict=True):
        for name, colour, label in (("v1", BIT, "bit"), ("v2", STRIKER, "striker")):
            axes.plot(*spectrum(motion, name, since, 20.0), color=colour, linewidth=1.0, label=label)
        axes.set_title(title)
        axes.set_xlabel("frequency [Hz]")
        axes.axhline(0, color=FAINT, linewidth=0.5)
    panels[0].set_ylabel("power, greatest 1")
    panels[0].legend()
    panels[0].set_xticks(np.arange(0, 21, 5))
    return figure
