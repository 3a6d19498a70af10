"""Pictures of the forced penetration."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce.pictures._paper import BIT, LINES, ROCK, WIDTH, beside, new_figure, stacked, styled


@styled
def swept(*sweeps):
    """Swing of the bit's velocity and depth of the hole over the frequency (Figs 6.4 to 6.7)."""
    figure, panels = stacked(2, 1.5)
    for sweep, k3, colour in zip(sweeps, (100, 300, 500), LINES, strict=False):
        middles, swings = signal.envelope(sweep, "v3", 0.1)
        panels[0].plot(10 + 20 * middles, 1e3 * swings, color=colour, label=f"k₃ = {k3} MN/m")
        panels[1].plot(10 + 20 * sweep["time"].values[::50], 1e3 * sweep["x4"].values[::50], color=colour)
    panels[0].set_ylabel("swing of x₃′ [mm/s]")
    panels[1].set_ylabel("hole x₄ [mm]")
    panels[1].set_xlabel("frequency of the swept sine [Hz]")
    panels[0].legend()
    return figure


@styled
def staircases(*motions):
    """Bit and hole under pulses, at three dampings (Figs 6.8 to 6.11)."""
    figure, panels = beside(3, 2.6)
    for axes, motion, zeta in zip(panels, motions, (0.5, 1.0, 1.5), strict=True):
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
def soft(*motions):
    """Bit and hole in soft and in hard rock (Figs 6.14, 6.16)."""
    figure, panels = beside(2, 2.6)
    for axes, motion, k3 in zip(panels, motions, ("0.1", "100"), strict=True):
        axes.plot(motion["time"], 1e3 * motion["x4"], color=ROCK, linewidth=2.0, label="hole x₄")
        axes.plot(motion["time"], 1e3 * motion["x3"], color=BIT, linewidth=0.9, label="bit x₃")
        axes.set_title(f"k₃ = {k3} MN/m, 150 kN")
        axes.set_xlabel("time [s]")
        axes.grid(True)
    panels[0].set_ylabel("displacement [mm]")
    panels[0].legend()
    return figure


@styled
def over_stiffness(ds):
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
def surfaces(ds):
    """Rate of penetration over frequency and force (Figs 6.25, 6.26)."""
    figure = new_figure(WIDTH, 3.4)
    for place, k3 in enumerate(ds.k3.values, start=1):
        axes = figure.add_subplot(1, 2, place, projection="3d")
        _draw_surface(axes, ds.sel(k3=k3), "force", "force [kN]", -125)
        axes.set_title(f"k₃ = {k3 / 1e6:g} MN/m")
    return figure


@styled
def over_threshold(ds):
    """Rate of penetration over frequency and threshold (Fig. 6.23)."""
    figure = new_figure(WIDTH, 3.4)
    _draw_surface(figure.add_subplot(projection="3d"), ds, "threshold", "threshold D [kN]", 35)
    return figure


def _draw_surface(axes, ds, name: str, label: str, turned: float) -> None:
    """The rate over a force, by its name, and the frequency, seen from `turned` [degrees]."""
    force, frequency = np.meshgrid(ds[name] / 1e3, ds.frequency, indexing="ij")
    axes.plot_surface(force, frequency, 1e3 * ds.rate_of_penetration.values, cmap="viridis")
    axes.set_xlabel(label)
    axes.set_ylabel("frequency [Hz]")
    axes.set_zlabel("ROP [mm/s]")
    axes.view_init(25, turned)
