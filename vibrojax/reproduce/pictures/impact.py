"""Pictures of the drill with impact."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce.pictures._paper import (
    BIT,
    FAINT,
    IMPACT,
    INK,
    START_COLOURS,
    STRIKER,
    beside,
    draw_stick,
    over_time,
    pair,
    stacked,
    styled,
    window,
)

GAPS = (-0.005, 0.005)
STARTS = ("drive", "stuck", "touching")
CRITICAL = (2.0, 2.5, 3.0, 4.0, 5.0)


@styled
def unsaid(*lanes):
    """Frequency and change of velocity over v_cr, for both gaps and three starts."""
    figure, panels = beside(2, 3.2)
    quantities = ((lambda one: one.angular_frequency, 27.45), (lambda one: 2 * one["impact_velocity"], 4.0))
    for axes, (quantity, source) in zip(panels, quantities, strict=True):
        axes.axhline(source, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        rest = iter(lanes)
        for gap, look in zip(GAPS, ("o", "^"), strict=True):
            for start in STARTS:
                some = [next(rest) for _ in CRITICAL]
                values = [quantity(one) for one in some]
                colour = START_COLOURS[start]
                axes.plot(CRITICAL, values, color=colour, linewidth=0.6)
                for v_cr, value, one in zip(CRITICAL, values, some, strict=True):
                    face = colour if one.regime == "single-impact" else "white"
                    axes.plot(v_cr, value, look, color=colour, markerfacecolor=face, markersize=5)
                axes.plot([], [], look + "-", color=colour, markersize=4, label=f"{1e3 * gap:+.0f} mm, {start}")
        axes.set_xlabel("Stribeck speed v_cr [m/s]")
        axes.grid(True)
    panels[0].set_ylabel("frequency [rad/s]")
    panels[1].set_ylabel("change of velocity [m/s]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@styled
def working_cycle(motion):
    """Displacement, velocity and acceleration over two cycles, with stick and impact (Figs 5.52, 5.72)."""
    end = signal.last_cycle(motion)[1]
    begin = end - 2 * (end - signal.last_cycle(motion)[0])
    inside = window(motion, begin, end)
    time = motion["time"].values
    figure, panels = stacked(3, 1.35)
    for names, axes, factor in ((("x1", "x2"), panels[0], 1e3), (("v1", "v2"), panels[1], 1.0)):
        for name, colour in zip(names, (BIT, STRIKER), strict=True):
            values = factor * motion[name].values
            axes.plot(time[inside], values[inside], color=colour, linewidth=1.1)
            if name.endswith("1"):
                draw_stick(axes, motion.isel(time=inside), values[inside], np.ones(inside.sum(), bool))
    acceleration = np.gradient(motion["v1"].values, time)
    panels[2].plot(time[inside], acceleration[inside], color=BIT, linewidth=1.1)
    rest = np.quantile(np.abs(acceleration[inside]), 0.97)
    panels[2].set_ylim(-2 * rest, 2 * rest)
    for axes, label in zip(panels, ("x₁, x₂ [mm]", "x₁′, x₂′ [m/s]", "x₁″ [m/s²]"), strict=True):
        axes.set_ylabel(label)
        axes.grid(True)
        for at in signal.events(motion, "impact", begin):
            axes.axvline(at, color=IMPACT, linewidth=0.8, linestyle=(0, (3, 2)))
    panels[0].set_title("bit blue, sticking thick black; striker orange; impacts dashed", loc="left")
    panels[2].set_xlabel("time [s]")
    panels[2].set_xlim(begin, end)
    return figure


@styled
def velocities(motion):
    """Velocities of bit and striker from zero (Fig. 5.53)."""
    return over_time([(motion, "v1"), (motion, "v2")], 6.0)


@styled
def portraits(motion):
    """Phase portraits of bit and striker with impact (Figs 5.57, 5.68)."""
    return pair(motion, 10.0)


@styled
def forces(motion):
    """One blow: impact force and friction force (Figs 5.51, 5.74)."""
    at = signal.events(motion, "impact", 10.0)[-1]
    inside = window(motion, at - 3e-3, at + 9e-3)
    time = 1e3 * (motion["time"].values[inside] - at)
    figure, panels = stacked(2, 1.4)
    panels[0].plot(time, motion["impact_force"].values[inside] / 1e3, color=IMPACT, linewidth=1.3)
    panels[1].plot(time, motion["friction_force"].values[inside] / 1e3, color=INK, linewidth=1.1)
    for axes, label in zip(panels, ("impact J [kN]", "friction F [kN]"), strict=True):
        axes.set_ylabel(label)
        axes.grid(True)
    panels[1].set_xlabel("time since the impact began [ms]")
    return figure


@styled
def phases(counter, together):
    """Displacements of bit and striker in counter-phase and in phase (Figs 5.60, 5.67)."""
    figure, panels = stacked(2, 1.5)
    for axes, motion, title in zip(panels, (counter, together), ("β 0.3, γ 0.5", "β 0.4, γ 0.6"), strict=True):
        end = float(motion["time"][-1])
        inside = window(motion, end - 0.8, end)
        for name, colour in (("x1", BIT), ("x2", STRIKER)):
            time = motion["time"].values[inside] - (end - 0.8)
            axes.plot(time, 1e3 * motion[name].values[inside], color=colour, linewidth=1.1)
        axes.axhline(-5, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set_title(title, loc="left")
        axes.set_ylabel("x₁, x₂ [mm]")
    panels[1].set_xlabel("time [s]")
    return figure


@styled
def in_turn(*motions):
    """The striker's displacement where blows are single, double in turn, and irregular (Fig. 5.77)."""
    figure, panels = stacked(3, 1.2)
    for axes, motion, gamma in zip(panels, motions, (1.0, 1.1, 1.2), strict=True):
        end = float(motion["time"][-1])
        inside = window(motion, end - 1.0, end)
        time = motion["time"].values[inside] - (end - 1.0)
        axes.plot(time, 1e3 * motion["x2"].values[inside], color=STRIKER, linewidth=1.1)
        hits = signal.events(motion, "impact", end - 1.0)
        axes.plot(hits - (end - 1.0), np.full(len(hits), -5.0), "o", color=IMPACT, markersize=3.5)
        axes.set_title(f"γ = {gamma}", loc="left")
        axes.set_ylabel("x₂ [mm]")
    panels[-1].set_xlabel("time [s]")
    return figure
