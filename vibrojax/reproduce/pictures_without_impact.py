"""Pictures of friction laws, the classical checks and the self-excitation without impact."""

import numpy as np
import xarray as xr
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vibrojax.analyses.pictures import REGIME_COLOURS
from vibrojax.measures.labels import REGIMES
from vibrojax.models.physics.contact import restitution
from vibrojax.models.physics.friction import FRICTION_LAWS
from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.entry import Picture
from vibrojax.reproduce.figures import (
    BIT,
    FAINT,
    INK,
    STRIKER,
    WIDTH,
    beside,
    draw_portrait,
    new_figure,
    over_time,
    spectrum,
    stacked,
    strikers,
    styled,
    window,
)
from vibrojax.reproduce.judges_closed_forms import curve
from vibrojax.reproduce.needs import Features
from vibrojax.reproduce.struck_mass import Blows


@styled
def curves() -> Figure:
    """mu of each law over the sliding speed (Figs 3.8 to 3.13, 5.12)."""
    figure = new_figure(WIDTH, 3.6)
    speeds = np.linspace(0, 5, 1001)
    for axes, law in zip(figure.subplots(2, 3, sharex=True, sharey=True).ravel(), data.LAWS, strict=True):
        mu = curve(law, speeds)
        axes.plot(np.concatenate([-speeds[::-1], speeds]), np.concatenate([-mu[::-1], mu]), linewidth=1.2)
        axes.axhline(0, color=FAINT, linewidth=0.5)
        axes.set_title(f"{law} ({FRICTION_LAWS[law].reference})", fontsize=8)
        axes.set_ylim(-0.75, 0.75)
        axes.grid(True)
    figure.supxlabel("sliding speed u [m/s]", fontsize=9)
    figure.supylabel("friction coefficient μ sgn u", fontsize=9)
    return figure


@styled
def regimes(*maps: xr.Dataset) -> Figure:
    """Regimes over beta and gamma under each law."""
    figure = new_figure(WIDTH, 4.2)
    colours = ListedColormap([REGIME_COLOURS[flag] for flag in range(len(REGIMES))])
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, ds, law in zip(panels.ravel(), maps, data.LAWS, strict=True):
        regime = ds.regime.sel(start="drive").transpose("gamma", "beta")
        axes.pcolormesh(ds.beta, ds.gamma, regime, cmap=colours, vmin=-0.5, vmax=len(REGIMES) - 0.5)
        axes.set_title(law)
    for axes in panels[-1]:  # a label of the whole figure would lie under the legend
        axes.set_xlabel("mass ratio β")
    for axes in panels[:, 0]:
        axes.set_ylabel("frequency ratio γ")
    shown = sorted({int(flag) for ds in maps for flag in np.unique(ds.regime)})
    handles = [Patch(facecolor=REGIME_COLOURS[flag], edgecolor=FAINT, label=REGIMES[flag]) for flag in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


@styled
def struck(*masses: Blows) -> Figure:
    """Displacement over time of the three struck masses."""
    figure, panels = stacked(3, 1.1, share=False)
    cases = (("free, on an elastic stop", 0.0, 2.0), ("Tsaplin's hammer", 58.0, 60.0), ("thrown ball", 58.0, 60.0))
    for axes, one, (title, begin, end) in zip(panels, masses, cases, strict=True):
        time, x = one.path
        inside = (time >= begin) & (time <= end)
        axes.plot(time[inside] - begin, 1e3 * x[inside], color=BIT, linewidth=1.1)
        for at in one.times[(one.times >= begin) & (one.times <= end)]:
            axes.axvline(at - begin, color=FAINT, linewidth=0.6)
        axes.set_title(title, loc="left")
        axes.set_ylabel("x [mm]")
    panels[-1].set_xlabel("time [s]")
    return figure


@styled
def restitutions(*blows: xr.Dataset) -> Figure:
    """Restitution over the loss factor (eq. 5.8)."""
    figure = new_figure(WIDTH, 2.8)
    axes = figure.subplots()
    xi = np.linspace(0, 1, 200)
    axes.plot(xi, restitution(xi), color=INK, linewidth=1.1, label="closed form")
    axes.plot(data.LOSS_FACTORS, [motions.restitution(one) for one in blows], "o", color=BIT, label="simulated blow")
    axes.set_xlabel("loss factor ξ")
    axes.set_ylabel("restitution R")
    axes.grid(True)
    axes.legend()
    return figure


@styled
def velocities(*over_speed: xr.Dataset) -> Figure:
    """Velocity of the bit over time, one panel for each drive speed (Figs 5.19 to 5.21)."""
    return over_time([(one, "v1") for one in over_speed], 40.0, [f"v = {v} m/s" for v in (0.5, 1.5, 2.5)])


@styled
def limit_cycle(inside: xr.Dataset, outside: xr.Dataset) -> Figure:
    """The limit cycle from the centre and from outside (Figs 5.28 to 5.31)."""
    figure, panels = beside(2, share=True)
    for axes, motion, title in zip(panels, (inside, outside), ("from zero", "from 10 mm, 3.5 m/s"), strict=True):
        draw_portrait(axes, motion, "1", BIT, 35.0)
        axes.plot(1e3 * motion["x1"][0], motion["v1"][0], "o", color=INK, markersize=5)
        axes.set_title(title)
        axes.set_xlabel("bit displacement x₁ [mm]")
    panels[0].set_ylabel("bit velocity x₁′ [m/s]")
    return figure


@styled
def settling(*lanes: Features) -> Figure:
    """Settling time over the drive speed and over gamma (Figs 5.22, 5.38); the first five lanes are over speed."""
    figure, panels = beside(2, 2.8)
    over = (
        (lanes[:5], data.SPEEDS, "driving velocity v [m/s]"),
        (lanes[5:], data.GAMMAS, "frequency ratio γ (β = 0.3)"),
    )
    for axes, (part, values, label) in zip(panels, over, strict=True):
        axes.plot(values, [one["settling_time"] for one in part], "o-", color=BIT, markersize=4)
        axes.set_xlabel(label)
        axes.grid(True)
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("settling time [s]")
    return figure


@styled
def friction_in_time(motion: xr.Dataset) -> Figure:
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
def decaying(*over_gamma: xr.Dataset) -> Figure:
    """Decaying vibration at gamma 0.9 and 1.2 (Figs 5.39, 5.40)."""
    return over_time([(one, "v1") for one in over_gamma], 30.0, [f"γ = {gamma}" for gamma in (0.9, 1.2)])


@styled
def lobed(*over_gamma: xr.Dataset) -> Figure:
    """Phase portraits of the striker at gamma 3, 9 and 10 (Figs 5.44, 5.45, 5.47)."""
    return strikers(over_gamma, [f"γ = {gamma}" for gamma in (3, 9, 10)], 58.0)


@styled
def spectra(usual: xr.Dataset, two: xr.Dataset) -> Figure:
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


# Rows of tables: the source's figures and the caption; then what is computed, and who draws it.
# fmt: off

FRICTION = (
    Picture("Figs 3.8 to 3.13 and 5.12", "Friction coefficient of the six laws over the sliding speed.",
        (), curves),
    Picture("Section 5.3.2",
        "Regimes over mass and frequency ratio under each law, from the start `drive` (gap -5 mm).",
        data.REGIMES, regimes),
)

CLASSICAL = (
    Picture("Figs 5.1, 5.2 and 5.7", "Free oscillator on a stop, hammer, and ball: displacement over time.",
        (data.FREE[0.005], data.HAMMERED, data.THROWN), struck),
    Picture("Eq. 5.8", "Restitution of one blow over the loss factor: simulated (points) and in closed form.",
        tuple(data.ONE_BLOW.values()), restitutions),
)

SELF_EXCITATION = (
    Picture("Figs 5.19 to 5.21",
        "The bit's velocity grows by itself until it reaches the drive's; the faster the drive, the later. At "
        "2.5 m/s it decays here.",
        (data.SLOW_DRIVE, data.FROM_INSIDE, data.FAST_DRIVE), velocities),
    Picture("Figs 5.29 to 5.31",
        "One limit cycle, reached from the centre and from outside; its flat edge is the bit that sticks.",
        (data.FROM_INSIDE, data.FROM_OUTSIDE), limit_cycle),
    Picture("Figs 5.22 and 5.38", "Settling time over the driving velocity and over the frequency ratio.",
        (*data.OVER_SPEED, *data.OVER_GAMMA), settling),
    Picture("Figs 5.32 and 5.33", "Friction force as the vibration grows, and with the bit's speed when it is steady.",
        (data.FROM_INSIDE,), friction_in_time),
    Picture("Figs 5.39 and 5.40", "Beyond gamma 0.86 the vibration dies away at 1.5 m/s.",
        (data.DECAYING, data.STRONGLY_DECAYING), decaying),
    Picture("Figs 5.44, 5.45 and 5.47",
        "Lobes of the striker's phase portrait at high frequency ratios (v 0.5 m/s, beta 0.3).",
        (data.LOBED[3], data.NINE, data.TEN), lobed),
    Picture("Figs 5.25, 5.26 and 5.50", "One frequency with Table 5.1, two at beta 0.4 and gamma 1.2.",
        (data.FROM_INSIDE, data.TWO_FREQUENCIES), spectra),
)
