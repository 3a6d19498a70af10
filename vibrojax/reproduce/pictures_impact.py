"""Pictures of the drill with impact, over the frequency ratio and the mass ratio, and of the source's region."""

from collections.abc import Callable

import numpy as np
import xarray as xr
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.entry import Picture
from vibrojax.reproduce.figures import (
    BIT,
    FAINT,
    IMPACT,
    INK,
    LINES,
    START_COLOURS,
    STRIKER,
    WIDTH,
    beside,
    draw_pair,
    draw_stick,
    new_figure,
    over_time,
    pair,
    stacked,
    strikers,
    styled,
    window,
)
from vibrojax.reproduce.judges_impact import change, is_single
from vibrojax.reproduce.judges_mass_ratio import coexisting, single, strong
from vibrojax.reproduce.needs import ALL_STARTS, Features

KINDS = ("none", "from some starts", "from every start", "and clean, strong")
COLOURS = ("#E6E6E6", "#9DB7D5", "#3E74AB", "#F0C808")


@styled
def unsaid(*lanes: Features) -> Figure:
    """Frequency and change of velocity over v_cr, for both gaps and three starts."""
    figure, panels = beside(2, 3.2)
    quantities: tuple[tuple[Callable[[Features], float], float], ...] = (
        (lambda one: one.angular_frequency, 27.45),
        (change, 4.0),
    )
    for axes, (quantity, source) in zip(panels, quantities, strict=True):
        axes.axhline(source, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        rest = iter(lanes)
        for gap, look in zip(data.BOTH_GAPS, ("o", "^"), strict=True):
            for start in ALL_STARTS:
                some = [next(rest) for _ in data.CRITICAL_SPEEDS]
                values = [quantity(one) for one in some]
                colour = START_COLOURS[start]
                axes.plot(data.CRITICAL_SPEEDS, values, color=colour, linewidth=0.6)
                for v_cr, value, one in zip(data.CRITICAL_SPEEDS, values, some, strict=True):
                    face = colour if is_single(one) else "white"
                    axes.plot(v_cr, value, look, color=colour, markerfacecolor=face, markersize=5)
                axes.plot([], [], look + "-", color=colour, markersize=4, label=f"{1e3 * gap:+.0f} mm, {start}")
        axes.set_xlabel("Stribeck speed v_cr [m/s]")
        axes.grid(True)
    panels[0].set_ylabel("frequency [rad/s]")
    panels[1].set_ylabel("change of velocity [m/s]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@styled
def working_cycle(motion: xr.Dataset) -> Figure:
    """Displacement, velocity and acceleration over two cycles, with stick and impact (Figs 5.52, 5.72)."""
    end = motions.last_cycle(motion)[1]
    begin = end - 2 * (end - motions.last_cycle(motion)[0])
    inside = window(motion, begin, end)
    time = motion["time"].values
    figure, panels = stacked(3, 1.35)
    for names, axes, factor in ((("x1", "x2"), panels[0], 1e3), (("v1", "v2"), panels[1], 1.0)):
        for name, colour in zip(names, (BIT, STRIKER), strict=True):
            values = factor * motion[name].values
            axes.plot(time[inside], values[inside], color=colour, linewidth=1.1)
            if name.endswith("1"):
                draw_stick(axes, motion.isel(time=inside), values[inside])
    acceleration = np.gradient(motion["v1"].values, time)
    panels[2].plot(time[inside], acceleration[inside], color=BIT, linewidth=1.1)
    rest = np.quantile(np.abs(acceleration[inside]), 0.97)
    panels[2].set_ylim(-2 * rest, 2 * rest)
    for axes, label in zip(panels, ("x₁, x₂ [mm]", "x₁′, x₂′ [m/s]", "x₁″ [m/s²]"), strict=True):
        axes.set_ylabel(label)
        axes.grid(True)
        for at in motions.events(motion, "impact", begin):
            axes.axvline(at, color=IMPACT, linewidth=0.8, linestyle=(0, (3, 2)))
    panels[0].set_title("bit blue, sticking thick black; striker orange; impacts dashed", loc="left")
    panels[2].set_xlabel("time [s]")
    panels[2].set_xlim(begin, end)
    return figure


@styled
def velocities(motion: xr.Dataset) -> Figure:
    """Velocities of bit and striker from zero (Fig. 5.53)."""
    return over_time([(motion, "v1"), (motion, "v2")], 6.0)


@styled
def portraits(motion: xr.Dataset) -> Figure:
    """Phase portraits of bit and striker with impact (Figs 5.57, 5.68)."""
    return pair(motion, 10.0)


@styled
def forces(motion: xr.Dataset) -> Figure:
    """One blow: impact force and friction force (Figs 5.51, 5.74)."""
    at = motions.events(motion, "impact", 10.0)[-1]
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
def phases(counter: xr.Dataset, together: xr.Dataset) -> Figure:
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
def in_turn(*over_gamma: xr.Dataset) -> Figure:
    """The striker's displacement where blows are single, double in turn, and irregular (Fig. 5.77)."""
    figure, panels = stacked(3, 1.2)
    for axes, motion, gamma in zip(panels, over_gamma, (1.0, 1.1, 1.2), strict=True):
        end = float(motion["time"][-1])
        inside = window(motion, end - 1.0, end)
        time = motion["time"].values[inside] - (end - 1.0)
        axes.plot(time, 1e3 * motion["x2"].values[inside], color=STRIKER, linewidth=1.1)
        hits = motions.events(motion, "impact", end - 1.0)
        axes.plot(hits - (end - 1.0), np.full(len(hits), -5.0), "o", color=IMPACT, markersize=3.5)
        axes.set_title(f"γ = {gamma}", loc="left")
        axes.set_ylabel("x₂ [mm]")
    panels[-1].set_xlabel("time [s]")
    return figure


@styled
def by_mass(*over_beta: xr.Dataset) -> Figure:
    """Phase portraits of the striker at three mass ratios (Fig. 5.80)."""
    figure = strikers(over_beta, [f"β = {beta}" for beta in (0.25, 0.5, 0.6)], 10.0, share=True, stride=2)
    for axes in figure.axes:
        axes.set_xlim(-165, 10)
    return figure


@styled
def extremes(light: xr.Dataset, heavy: xr.Dataset) -> Figure:
    """Phase portraits of bit and striker with a light and a heavy striker (Figs 5.78, 5.81)."""
    figure, panels = beside(4, 2.4)
    for two, motion, beta in zip((panels[:2], panels[2:]), (light, heavy), (0.1, 0.7), strict=True):
        begin = float(motion["time"][-1]) - 1.0
        draw_pair(two, motion.isel(time=window(motion, begin)), begin, stride=2)
        for axes in two:
            axes.set_title(f"β = {beta}")
    panels[0].set_ylabel("velocity [m/s]")
    return figure


@styled
def creeping(motion: xr.Dataset) -> Figure:
    """Displacement of bit and striker at equal masses (Fig. 5.83)."""
    return over_time([(motion, "x1"), (motion, "x2")], 40.0, stride=8)


@styled
def wide(ds: xr.Dataset) -> Figure:
    """Over mass and frequency ratio, for both gaps."""
    figure = new_figure(WIDTH, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, delta in zip(panels, ds.delta.values, strict=True):
        part = ds.sel(delta=delta, v=1.5)
        good, best = single(part), strong(part)
        kind = good.any("start").astype(int) + good.all("start").astype(int) + best.all("start").astype(int)
        kind = kind.transpose("gamma", "beta")
        axes.pcolormesh(part.beta, part.gamma, kind, cmap=ListedColormap(COLOURS), vmin=-0.5, vmax=3.5)
        axes.add_patch(Rectangle((0.25, 0.6), 0.35, 0.2, fill=False, edgecolor=INK, linewidth=1.5))
        axes.set_title(f"gap {1e3 * delta:+.0f} mm")
        axes.set_xlabel("mass ratio β")
    panels[0].set_ylabel("frequency ratio γ")
    handles = [
        Patch(facecolor=colour, edgecolor=FAINT, label=name) for colour, name in zip(COLOURS, KINDS, strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, title="single impact")
    return figure


@styled
def over_gap(ds: xr.Dataset) -> Figure:
    """Shares over the gap, all speeds together."""
    figure = new_figure(WIDTH, 3.0)
    axes = figure.subplots()
    over = ("v", "beta", "gamma")
    good, best, second = single(ds), strong(ds), coexisting(ds)
    gaps = 1e3 * ds.delta.values
    for start, colour in zip(ds.start.values, LINES, strict=False):
        axes.plot(
            gaps, good.sel(start=start).mean(over), "o-", color=colour, markersize=4, label=f"single, from {start}"
        )
    axes.plot(
        gaps, best.sel(start="stuck").mean(over), "s--", color=INK, markersize=4, label="clean, strong, from stuck"
    )
    axes.plot(gaps, second.mean(over), "^:", color=LINES[4], markersize=4, label="a second, worse motion")
    axes.set_xlabel("gap Δ [mm], negative: preload")
    axes.set_ylabel("share of the region")
    axes.set_ylim(-0.03, 1.03)
    axes.set_xticks(np.round(gaps, 1))
    axes.grid(True)
    axes.legend(loc="center left")
    return figure


# Rows of tables: the source's figures and the caption; then what is computed, and who draws it.
# fmt: off

FREQUENCY_RATIO = (
    Picture("Figs 5.53 and 5.54, what the source does not say",
        "Frequency and change of velocity over the Stribeck speed v_cr, for both signs of the gap and three "
        "starts; dashed: the source. Hollow: no single impact.",
        data.UNSAID, unsaid),
    Picture("Fig. 5.52 and 5.72",
        "The working cycle at v 0.5 m/s: stick (thick), slip, and the blow, which falls while the bit slows.",
        (data.TYPICAL_SLOW,), working_cycle),
    Picture("Fig. 5.53", "Velocities of bit and striker with impact, from zero: settled after some cycles.",
        (data.TYPICAL,), velocities),
    Picture("Figs 5.57 and 5.68", "Phase portraits of bit and striker; the striker's vertical edge is the blow.",
        (data.TYPICAL,), portraits),
    Picture("Figs 5.51 and 5.74", "Impact force of one blow, and the friction force beside it (k0 50 MN/m).",
        (data.TYPICAL,), forces),
    Picture("Figs 5.60 and 5.67", "Counter-phase at gamma 0.5 (beta 0.3), in phase at 0.6 (beta 0.4).",
        (data.COUNTER_PHASE, data.IN_PHASE), phases),
    Picture("Fig. 5.77", "k1 625000: single blows at gamma 1.0, single and double in turn at 1.1, irregular at 1.2.",
        data.TRIPLE, in_turn),
)

MASS_RATIO = (
    Picture("Fig. 5.80", "Phase portraits of the striker: its swing grows with the mass ratio.",
        data.BEST_MOTIONS, by_mass),
    Picture("Figs 5.78 and 5.81",
        "The striker too light (beta 0.1: a second swing) and too heavy (beta 0.7: the bit never sticks).",
        (data.LIGHT_MOTION, data.HEAVY_MOTION), extremes),
    Picture("Fig. 5.83", "Beta 1.0: the amplitude creeps up over half a minute.",
        (data.CREEPING,), creeping),
)

REGION = (
    Picture("Section 5.7",
        "Where a single impact is reached from every start, from some, from none, and where it is clean and "
        "strong, at v 1.5 m/s. The rectangle is the source's region.",
        (data.WIDE,), wide),
    Picture("Section 5.7",
        "Share of the source's region with a single impact from each start, with a clean and strong one, and "
        "with a second, worse motion, over the gap.",
        (data.INSIDE,), over_gap),
)
