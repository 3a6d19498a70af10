"""Pictures of chapter 6: the forced penetration, the law of its rate, the whole drill."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from vibrojax.analyses.rop_law import fit_rop
from vibrojax.reproduce import datasets_chapter6 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.entry import Picture
from vibrojax.reproduce.figures import (
    BIT,
    FAINT,
    IMPACT,
    INK,
    LINES,
    ROCK,
    WIDTH,
    beside,
    new_figure,
    pair,
    stacked,
    styled,
    window,
)


@styled
def swept(*sweeps: xr.Dataset) -> Figure:
    """Swing of the bit's velocity and depth of the hole over the frequency (Figs 6.4 to 6.7)."""
    figure, panels = stacked(2, 1.5)
    for sweep, k3, colour in zip(sweeps, (100, 300, 500), LINES, strict=False):
        middles, swings = motions.envelope(sweep, "v3", 0.1)
        panels[0].plot(10 + 20 * middles, 1e3 * swings, color=colour, label=f"k₃ = {k3} MN/m")
        panels[1].plot(10 + 20 * sweep["time"].values[::50], 1e3 * sweep["x4"].values[::50], color=colour)
    panels[0].set_ylabel("swing of x₃′ [mm/s]")
    panels[1].set_ylabel("hole x₄ [mm]")
    panels[1].set_xlabel("frequency of the swept sine [Hz]")
    panels[0].legend()
    return figure


@styled
def staircases(*over_damping: xr.Dataset) -> Figure:
    """Bit and hole under pulses, at three dampings (Figs 6.8 to 6.11)."""
    figure, panels = beside(3, 2.6)
    for axes, motion, zeta in zip(panels, over_damping, (0.5, 1.0, 1.5), strict=True):
        time = 1e3 * motion["time"].values
        axes.plot(time, 1e3 * motion["x4"], color=ROCK, linewidth=2.0)
        axes.plot(time, 1e3 * motion["x3"], color=BIT, linewidth=0.9)
        axes.set_title(f"ζ = {zeta}")
        axes.set_xlabel("time [ms]")
        axes.set_xlim(0, 100)
        axes.set_ylim(top=1.15 * 1e3 * float(motion["x3"].values[time < 100].max()))
        axes.grid(True)
    panels[0].set_ylabel("x₃, x₄ [mm]")
    return figure


@styled
def soft(*soft_and_hard: xr.Dataset) -> Figure:
    """Bit and hole in soft and in hard rock (Figs 6.14, 6.16)."""
    figure, panels = beside(2, 2.6)
    for axes, motion, k3 in zip(panels, soft_and_hard, ("0.1", "100"), strict=True):
        axes.plot(motion["time"], 1e3 * motion["x4"], color=ROCK, linewidth=2.0, label="hole x₄")
        axes.plot(motion["time"], 1e3 * motion["x3"], color=BIT, linewidth=0.9, label="bit x₃")
        axes.set_title(f"k₃ = {k3} MN/m, 150 kN")
        axes.set_xlabel("time [s]")
        axes.grid(True)
    panels[0].set_ylabel("displacement [mm]")
    panels[0].legend()
    return figure


@styled
def over_stiffness(ds: xr.Dataset) -> Figure:
    """Rate of penetration over the stiffness (Figs 6.19, 6.20)."""
    figure = new_figure(WIDTH, 3.0)
    axes = figure.subplots()
    for frequency, colour in zip(ds.frequency.values, LINES, strict=False):
        rates = 1e3 * ds.rate_of_penetration.sel(frequency=frequency)
        axes.plot(ds.k3 / 1e6, rates, color=colour, label=f"{frequency:g} Hz")
    axes.set_xlabel("stiffness k₃ [MN/m]")
    axes.set_ylabel("rate of penetration [mm/s]")
    axes.grid(True)
    axes.legend()
    return figure


@styled
def surfaces(ds: xr.Dataset) -> Figure:
    """Rate of penetration over frequency and force (Figs 6.25, 6.26)."""
    figure = new_figure(WIDTH, 3.4)
    for place, k3 in enumerate(ds.k3.values, start=1):
        axes = figure.add_subplot(1, 2, place, projection="3d")
        _draw_surface(axes, ds.sel(k3=k3), "force", "force [kN]", -125.0)
        axes.set_title(f"k₃ = {k3 / 1e6:g} MN/m")
    return figure


@styled
def over_threshold(ds: xr.Dataset) -> Figure:
    """Rate of penetration over frequency and threshold (Fig. 6.23)."""
    figure = new_figure(WIDTH, 3.4)
    _draw_surface(figure.add_subplot(projection="3d"), ds, "threshold", "threshold D [kN]", 35.0)
    return figure


def _draw_surface(axes: Axes3D, ds: xr.Dataset, name: str, label: str, turned: float) -> None:
    """The rate over a force, by its name, and the frequency, seen from `turned` [degrees]."""
    force, frequency = np.meshgrid(ds[name] / 1e3, ds.frequency, indexing="ij")
    axes.plot_surface(force, frequency, 1e3 * ds.rate_of_penetration.values, cmap="viridis")
    axes.set_xlabel(label)
    axes.set_ylabel("frequency [Hz]")
    axes.set_zlabel("ROP [mm/s]")
    axes.view_init(25, turned)


@styled
def shapes(ds: xr.Dataset) -> Figure:
    """The rate over P/D with the logarithm and the line (eq. 6.4)."""
    figure, panels = beside(2, 3.0)
    part = ds.sel(pulse_width=0.004, drop=True)
    fit = fit_rop(part, along="frequency", progress=False)
    for axes, k3 in zip(panels, part.k3.values, strict=True):
        for force, colour in zip(part.force.values, LINES, strict=False):
            one, law = part.sel(k3=k3, force=force), fit.sel(k3=k3, force=force)
            relief = np.linspace(1e-3, 1.05 * float(one.relief.max()), 200)
            log = float(law.C.sel(form="onset")) * np.log(relief / float(law.eta0.sel(form="onset")))
            axes.plot(relief, np.where(log > 0, 1e3 * log, np.nan), color=colour, linestyle="--", linewidth=0.9)
            axes.plot(relief, 1e3 * float(law.C.sel(form="line")) * relief, color=colour, linewidth=0.9)
            axes.plot(one.relief, 1e3 * one.rate_of_penetration, "o", color=colour, label=f"{force / 1e3:g} kN")
        axes.set_title(f"k₃ = {k3 / 1e6:g} MN/m")
        axes.set_xlabel("relief P/D")
        axes.grid(True)
    panels[0].set_ylabel("rate of penetration [mm/s]")
    panels[0].plot([], [], color=INK, linewidth=0.9, label="line")
    panels[0].plot([], [], color=INK, linewidth=0.9, linestyle="--", label="logarithm")
    panels[0].legend()
    return figure


@styled
def constants(ds: xr.Dataset) -> Figure:
    """C over force, stiffness and pulse width."""
    figure = new_figure(WIDTH, 2.8)
    axes = figure.subplots()
    axes.axhspan(0.046, 0.189, color=FAINT, alpha=0.3, linewidth=0)
    for width, look in zip(ds.pulse_width.values, ("s--", "o-"), strict=True):
        fit = fit_rop(ds.sel(pulse_width=width, drop=True), along="frequency", progress=False)
        for k3, colour in zip(ds.k3.values, LINES, strict=False):
            listed = 2 * np.pi * fit.C.sel(form="onset", k3=k3)
            label = f"{k3 / 1e6:g} MN/m, {1e3 * width:g} ms"
            axes.plot(ds.force / 1e3, listed, look, color=colour, markersize=4, label=label)
    axes.set_xlabel("force [kN]")
    axes.set_ylabel("C [m/s], listing's rate")
    axes.grid(True)
    axes.legend()
    return figure


@styled
def steps(motion: xr.Dataset) -> Figure:
    """Impact force, and bit and hole, over three cycles (Figs 6.29, 6.31)."""
    begin, end = motions.last_cycle(motion)
    inside = window(motion, end - 3 * (end - begin), end)
    time = motion["time"].values[inside]
    figure, panels = stacked(2, 1.5)
    panels[0].plot(time, motion["impact_force"].values[inside] / 1e3, color=IMPACT)
    panels[1].plot(time, 1e3 * motion["x4"].values[inside], color=ROCK, linewidth=2.0, label="hole x₄")
    panels[1].plot(time, 1e3 * motion["x3"].values[inside], color=BIT, linewidth=0.9, label="bit x₃")
    panels[0].set_ylabel("impact J [kN]")
    panels[1].set_ylabel("x₃, x₄ [mm]")
    panels[1].set_xlabel("time [s]")
    panels[1].legend(loc="upper left")
    return figure


@styled
def over_relief(ds: xr.Dataset) -> Figure:
    """Rate of penetration over P/D, varied by the speed (Figs 6.33, 6.34)."""
    figure = new_figure(WIDTH, 3.0)
    axes = figure.subplots()
    part = ds.sel(start="drive")
    for k3, colour in zip(part.k3.values, LINES, strict=False):
        one = part.sel(k3=k3)
        label = f"k₃ = {k3 / 1e6:g} MN/m"
        axes.plot(one.relief, 1e3 * one.rate_of_penetration, "o-", color=colour, markersize=4, label=label)
    axes.set_xlabel("relief P/D (D 50 kN), by v from 0.5 to 2.5 m/s")
    axes.set_ylabel("rate of penetration [mm/s]")
    axes.grid(True)
    axes.legend()
    return figure


@styled
def portraits(motion: xr.Dataset) -> Figure:
    """Phase portraits of bit and striker while drilling (Figs 6.35, 6.36)."""
    return pair(motion, 6.0)


# Rows of tables: the source's figures and the caption; then what is computed, and who draws it.
# fmt: off

PENETRATION = (
    Picture("Figs 6.4 to 6.7",
        "Swept sine: swing of the bit's velocity, and the hole, over the frequency, for three rocks.",
        data.SWEEPS, swept),
    Picture("Figs 6.8 to 6.11",
        "Bit (thin) and hole (thick) under pulses of 300 kN: the lightly damped bit jumps off the rock.",
        tuple(data.STEPS.values()), staircases),
    Picture("Figs 6.14 and 6.16", "Soft rock swings and does not break; hard rock does.",
        tuple(data.SOFT_AND_HARD.values()), soft),
    Picture("Figs 6.19 and 6.20", "Rate of penetration over the stiffness at 200 kN, one line a frequency.",
        (data.STIFFNESS_MAP,), over_stiffness),
    Picture("Figs 6.25 and 6.26", "Surface of the rate over frequency and force, k3 100 and 500 MN/m.",
        (data.FORCE_MAP,), surfaces),
    Picture("Fig. 6.23", "Surface of the rate over frequency and threshold, 300 kN, k3 500 MN/m.",
        (data.THRESHOLD_MAP,), over_threshold),
)

LAW = (
    Picture("Eq. 6.4",
        "The rate over P/D, varied by the frequency, with the logarithm and the line fitted to it: a straight "
        "line through zero, and the logarithm is a chord.",
        (data.CONSTANT_MAP,), shapes),
    Picture("Eq. 6.4",
        "C over force, stiffness and pulse width, in the listing's rate; the grey band is the source's range.",
        (data.CONSTANT_MAP,), constants),
)

DRILL = (
    Picture("Figs 6.29 and 6.31", "Impact force, bit and hole over three cycles: the hole grows by steps.",
        (data.DRILLING,), steps),
    Picture("Figs 6.33 and 6.34", "Rate of penetration of the drill over P/D, varied by the drive's speed.",
        (data.SPEED_MAP,), over_relief),
    Picture("Figs 6.35 and 6.36", "Phase portraits of bit and striker while drilling.",
        (data.DRILLING,), portraits),
)
