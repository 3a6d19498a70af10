"""Pictures of lanes and maps with the same axes as the source's figures; `source.toml` calls these functions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from source.closed_forms import friction
from source.maps import LISTED_RATE, REGION, coexisting, fit_law, single_impact, strong
from source.pictures_motions import FIGURE_WIDTH, LINE_COLOURS, panels_for
from vibrojax.measures.labels import REGIMES
from vibrojax.physics.friction import FRICTION_LAWS
from vibrojax.pictures.colours import REGIME_COLOURS
from vibrojax.pictures.draw import new_figure
from vibrojax.pictures.style import BIT, FAINT, INK, START_COLOURS

LAWS = ("coulomb", "popp-exponential", "popp-arctan", "hyperbolic", "hyperbolic-quadratic", "stribeck")
SINGLE_IMPACT_COLOURS = {
    "none": "#E6E6E6",
    "from some starts": "#9DB7D5",
    "from every start": "#3E74AB",
    "and clean, strong": "#F0C808",
}
"""Colours of parameter points, by the initial conditions from which they have a single impact."""


def friction_laws() -> Figure:
    """Draw the friction coefficient of each law over the sliding speed (source, Figs 3.8 to 3.13, 5.12)."""
    figure = new_figure(FIGURE_WIDTH, 3.6)
    speeds = np.linspace(0, 5, 1001)
    for axes, law in zip(figure.subplots(2, 3, sharex=True, sharey=True).ravel(), LAWS, strict=True):
        mu = friction(law, speeds)
        axes.plot(np.concatenate([-speeds[::-1], speeds]), np.concatenate([-mu[::-1], mu]), linewidth=1.2)
        axes.axhline(0, color=FAINT, linewidth=0.5)
        axes.set_title(f"{law} ({FRICTION_LAWS[law].reference})", fontsize=8)
        axes.set_ylim(-0.75, 0.75)
        axes.grid(True)
    figure.supxlabel("sliding speed u [m/s]", fontsize=9)
    figure.supylabel("friction coefficient μ sgn u", fontsize=9)
    return figure


def regimes_under_laws(maps: Sequence[xr.Dataset]) -> Figure:
    """Draw a map of the regimes over beta and gamma for each friction law."""
    figure = new_figure(FIGURE_WIDTH, 4.2)
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, map, law in zip(panels.ravel(), maps, LAWS, strict=True):
        _draw_cells(axes, map.regime.sel(start="drive"), list(REGIME_COLOURS.values()))
        axes.set_title(law)
    for axes in panels[-1]:  # the legend would cover a label of the whole figure
        axes.set_xlabel("mass ratio β")
    for axes in panels[:, 0]:
        axes.set_ylabel("frequency ratio γ")
    flags = sorted({int(flag) for map in maps for flag in np.unique(map.regime)})
    _legend_below(figure, {REGIMES[flag]: REGIME_COLOURS[flag] for flag in flags})
    return figure


def _draw_cells(axes: Axes, flags: xr.DataArray, colours: Sequence[str]) -> None:
    """Draw flags over beta and gamma as cells, each with one of the `colours`."""
    look: dict[str, Any] = {"cmap": ListedColormap(colours), "vmin": -0.5, "vmax": len(colours) - 0.5}
    axes.pcolormesh(flags.beta, flags.gamma, flags.transpose("gamma", "beta"), **look)


def _legend_below(figure: Figure, colours: Mapping[str, str], title: str | None = None) -> None:
    """Draw a legend below the panels, with a filled patch for each name in `colours`."""
    handles = [Patch(facecolor=colour, edgecolor=FAINT, label=name) for name, colour in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, title=title)


def settling_times(speeds: Mapping[str, Any], ratios: Mapping[str, Any]) -> Figure:
    """Draw the settling time over the driving velocity and over gamma (source, Figs 5.22, 5.38)."""
    labels = ("driving velocity v [m/s]", "frequency ratio γ (β = 0.3)")
    figure, panels = panels_for(2.8, labels, "settling time [s]")
    for axes, lanes, name in zip(panels, (speeds, ratios), ("v", "gamma"), strict=True):
        axes.plot(lanes[name], lanes["settling_time"], "o-", color=BIT, markersize=4)
        axes.set_ylim(bottom=0)
    return figure


def over_stribeck_speed(lanes: Mapping[str, Any]) -> Figure:
    """Draw the frequency and the velocity change at impact over v_cr (source, Figs 5.53, 5.54).

    There is a line for each combination of gap (two) and initial condition (three).
    """
    figure, panels = panels_for(3.2, ["Stribeck speed v_cr [m/s]"] * 2, "")
    quantities = (("omega", 27.45, "frequency [rad/s]"), ("velocity_change", 4.0, "change of velocity [m/s]"))
    for axes, (name, source, label) in zip(panels, quantities, strict=True):
        axes.axhline(source, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        for gap, marker in ((-0.005, "o"), (0.005, "^")):
            for start, colour in START_COLOURS.items():
                lines = (lanes["delta"] == gap) & (lanes["start"] == start)
                speeds, values, single = lanes["v_cr"][lines], lanes[name][lines], lanes["single"][lines]
                axes.plot(speeds, values, color=colour, linewidth=0.6)
                for face, which in ((colour, single), ("white", ~single)):
                    points = speeds[which], values[which]
                    axes.plot(*points, marker, color=colour, markerfacecolor=face, markersize=5)
                axes.plot([], [], marker + "-", color=colour, markersize=4, label=f"{1e3 * gap:+.0f} mm, {start}")
        axes.set_ylabel(label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def region_of_impacts(map: xr.Dataset) -> Figure:
    """Draw, for each gap, a map of where single impacts occur over mass ratio and frequency ratio (section 5.7).

    A rectangle marks the source's region of best performance.
    """
    titles = [f"gap {1e3 * delta:+.0f} mm" for delta in map.delta.values]
    figure, panels = panels_for(3.4, ["mass ratio β"] * 2, "frequency ratio γ", titles, share=True, grid=False)
    (beta, beta_end), (gamma, gamma_end) = REGION.values()
    for axes, delta in zip(panels, map.delta.values, strict=True):
        part = map.sel(delta=delta, v=1.5)
        good, best = single_impact(part), strong(part)
        kind = good.any("start").astype(int) + good.all("start").astype(int) + best.all("start").astype(int)
        _draw_cells(axes, kind, list(SINGLE_IMPACT_COLOURS.values()))
        region = Rectangle((beta, gamma), beta_end - beta, gamma_end - gamma, fill=False, edgecolor=INK, linewidth=1.5)
        axes.add_patch(region)
    _legend_below(figure, SINGLE_IMPACT_COLOURS, "single impact")
    return figure


def shares_over_gap(map: xr.Dataset) -> Figure:
    """Draw, over the gap, the fractions of the source's region of best performance with certain motions (section 5.7).

    The fractions are of all lanes in that region of parameters, for all speeds together.
    """
    figure, (axes,) = panels_for(3.0, ["gap Δ [mm], negative: preload"], "share of the region")
    gaps = 1e3 * map.delta.values
    lines = [
        (single_impact(map).sel(start=start), "o-", colour, f"single, from {start}")
        for start, colour in zip(map.start.values, LINE_COLOURS, strict=False)
    ]
    lines.append((strong(map).sel(start="stuck"), "s--", INK, "clean, strong, from stuck"))
    lines.append((coexisting(map), "^:", LINE_COLOURS[4], "a second, worse motion"))
    for flags, line, colour, label in lines:
        axes.plot(gaps, flags.mean(("v", "beta", "gamma")), line, color=colour, markersize=4, label=label)
    axes.set_ylim(-0.03, 1.03)
    axes.set_xticks(np.round(gaps, 1))
    axes.legend(loc="center left")
    return figure


def rates(map: xr.Dataset, x: str, scale: float, label: str, lines: str, line: str, marker: str) -> Figure:
    """Draw the rate of penetration over the axis `x` (source, Figs 6.19, 6.20, 6.33, 6.34).

    **Arguments:**

    - `scale`: unit of `x` in the picture, as a multiple of the SI unit; `label`: label of the abscissa.
    - `lines`: axis with one line per value; `line`: format string for the label of a line (k3 is in MN/m).
    - `marker`: format string of matplotlib for all lines.
    """
    figure, (axes,) = panels_for(3.0, [label], "rate of penetration [mm/s]")
    for value, colour in zip(map[lines].values, LINE_COLOURS, strict=False):
        part = map.sel({lines: value})
        name = line.format(value / 1e6 if lines == "k3" else value)
        axes.plot(part[x] / scale, 1e3 * part.rate_of_penetration, marker, color=colour, markersize=4, label=name)
    axes.legend()
    return figure


def surfaces(map: xr.Dataset, name: str, label: str, azimuth: int) -> Figure:
    """Draw the rate of penetration as a surface over a force and the frequency (source, Figs 6.23, 6.25, 6.26).

    There is a panel for each k3. `name` and `label` are the coordinate of the force and its axis label.
    """
    figure = new_figure(FIGURE_WIDTH, 3.4)
    stiffnesses = map.k3.values if "k3" in map.dims else [None]
    for column, k3 in enumerate(stiffnesses, start=1):
        axes = figure.add_subplot(1, len(stiffnesses), column, projection="3d")
        part = map if k3 is None else map.sel(k3=k3)
        force, frequency = np.meshgrid(part[name] / 1e3, part.frequency, indexing="ij")
        axes.plot_surface(force, frequency, 1e3 * part.rate_of_penetration.values, cmap="viridis")
        axes.set(xlabel=label, ylabel="frequency [Hz]", zlabel="ROP [mm/s]")
        axes.view_init(25, azimuth)
        axes.set_title("" if k3 is None else f"k₃ = {k3 / 1e6:g} MN/m")
    return figure


def laws_beside_rates(map: xr.Dataset) -> Figure:
    """Draw the rate over P/D, with the fitted logarithm (source, eq. 6.4) and the fitted straight line."""
    titles = [f"k₃ = {k3 / 1e6:g} MN/m" for k3 in map.k3.values]
    figure, panels = panels_for(3.0, ["relief P/D"] * 2, "rate of penetration [mm/s]", titles)
    fit = fit_law(map, "frequency")
    map = map.sel(pulse_width=0.004)
    for axes, k3 in zip(panels, map.k3.values, strict=True):
        for force, colour in zip(map.force.values, LINE_COLOURS, strict=False):
            lanes, law = map.sel(k3=k3, force=force), fit.sel(k3=k3, force=force)
            relief = np.linspace(1e-3, 1.05 * float(lanes.relief.max()), 200)
            logarithm = float(law.C.sel(form="onset")) * np.log(relief / float(law.eta0.sel(form="onset")))
            curve = np.where(logarithm > 0, 1e3 * logarithm, np.nan)
            axes.plot(relief, curve, color=colour, linestyle="--", linewidth=0.9)
            axes.plot(relief, 1e3 * float(law.C.sel(form="line")) * relief, color=colour, linewidth=0.9)
            axes.plot(lanes.relief, 1e3 * lanes.rate_of_penetration, "o", color=colour, label=f"{force / 1e3:g} kN")
    panels[0].plot([], [], color=INK, linewidth=0.9, label="line")
    panels[0].plot([], [], color=INK, linewidth=0.9, linestyle="--", label="logarithm")
    panels[0].legend()
    return figure


def constants_over_force(map: xr.Dataset) -> Figure:
    """Draw C over the force, with a line for each stiffness and pulse width, and the source's range."""
    figure, (axes,) = panels_for(2.8, ["force [kN]"], "C [m/s], listing's rate")
    axes.axhspan(0.046, 0.189, color=FAINT, alpha=0.3, linewidth=0)
    for width, marker in zip(map.pulse_width.values, ("s--", "o-"), strict=True):
        fit = fit_law(map, "frequency", float(width))
        for k3, colour in zip(map.k3.values, LINE_COLOURS, strict=False):
            constants = LISTED_RATE * fit.C.sel(form="onset", k3=k3)
            label = f"{k3 / 1e6:g} MN/m, {1e3 * width:g} ms"
            axes.plot(map.force / 1e3, constants, marker, color=colour, markersize=4, label=label)
    axes.legend()
    return figure
