"""Pictures of motions with the same axes as the source's figures; `source.toml` calls these functions.

"Fig." and "eq." refer to the source.
"""

from collections.abc import Mapping, Sequence
from itertools import product, repeat
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from source.closed_forms import LOSS_FACTORS
from source.motions import DRIVE_SPEED, envelope, events, last_cycle, power_spectrum, swept_frequency, within
from vibrojax.physics.contact import restitution
from vibrojax.pictures.draw import new_figure
from vibrojax.pictures.style import BIT, FAINT, IMPACT, INK, ROCK, STICK, STRIKER

FIGURE_WIDTH = 6.4
"""Width of a figure [inch]: half the width of the text on the reproduction page."""
THIN = {"linewidth": 0.5, "rasterized": True}
LINE_COLOURS = ("#004488", "#CC6677", "#8C6D1F", "#2E8B57", "#7A5195", "#56B4E9")
"""Line colours that are distinct in greyscale, too."""
_SYMBOLS = {"x1": "x₁", "x2": "x₂", "v1": "x₁′", "v2": "x₂′", "x3": "x₃", "x4": "x₄"}
_SYMBOLS |= {"impact_force": "impact J", "friction_force": "friction F"}
_UNITS = dict.fromkeys(("x1", "x2", "x3", "x4"), (1e3, "mm")) | dict.fromkeys(("v1", "v2"), (1.0, "m/s"))
_UNITS |= dict.fromkeys(("impact_force", "friction_force"), (1e-3, "kN"))
_COLOURS = {"x1": BIT, "v1": BIT, "x2": STRIKER, "v2": STRIKER, "x3": BIT, "x4": ROCK}
_COLOURS |= {"impact_force": IMPACT, "friction_force": INK}
_NAMES = {"x3": "bit x₃", "x4": "hole x₄"}
_WIDTHS = {"x3": 0.9, "x4": 2.0}  # the hole lies below the bit that presses on it

Motions = Sequence[xr.Dataset]
Texts = Sequence[str]


def panels_for(
    height: float, x: str | Texts, y: str | Texts, titles: Texts = (), share: bool = False, grid: bool = True
) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with a panel for each label: side by side if `x` is a list, one above the other if `y` is.

    `height`: height [inch] of the figure, or of each of the panels one above the other; `share`: whether the panels
    have the other axis in common, which is labelled once.
    """
    in_row = not isinstance(x, str)
    rows, columns = (1, len(x)) if in_row else (len(y), 1)
    figure = new_figure(FIGURE_WIDTH, height if in_row else 0.7 + height * rows)
    figure.subplots(rows, columns, sharex=share and not in_row, sharey=share and in_row)
    for axes, title in zip(figure.axes, titles or repeat(""), strict=False):
        axes.grid(grid)
        axes.set_title(title, loc="center" if in_row else "left")
    for axes, label in zip(figure.axes, x if in_row else y, strict=False):
        axes.set(**{"xlabel" if in_row else "ylabel": label})
    figure.axes[0 if in_row else -1].set(**{"ylabel" if in_row else "xlabel": y if in_row else x})
    return figure, figure.axes


def histories(
    motions: Motions,
    rows: Sequence[Texts],
    window: tuple[float, float],
    titles: Texts = (),
    height: float = 1.3,
    look: Mapping[str, Any] = MappingProxyType({}),
    mark: str = "",
    unit: str = "s",
) -> Figure:
    """Draw variables over time: for each motion, a panel for each of the lists of names in `rows`.

    `window`: the drawn times [s]; if the first is negative, both are relative to the end of the motion, and the axis
    begins at zero. `look`: properties of the lines. `mark`: "stop" for a line at the stop, "impacts" for dots at the
    beginnings of impacts. `unit`: unit of the time, "s" or "ms".
    """
    labels = [", ".join(_SYMBOLS[name] for name in sorted(names)) + f" [{_UNITS[names[0]][1]}]" for names in rows]
    figure, panels = panels_for(height, f"time [{unit}]", labels * len(motions), titles, share=True, grid=not mark)
    scale = 1e3 if unit == "ms" else 1.0
    for axes, (motion, names) in zip(panels, product(motions, rows), strict=True):
        origin = window[0] + float(motion["time"][-1]) if window[0] < 0 else 0.0
        begin, end = origin or window[0], origin + window[1] - min(window[0], 0.0)
        shown = motion.isel(time=within(motion, begin, end))
        for name in names:
            line = {"linewidth": _WIDTHS.get(name, 1.1), "label": _NAMES.get(name), **look}
            axes.plot(scale * (shown["time"] - origin), _UNITS[name][0] * shown[name], color=_COLOURS[name], **line)
        if mark == "stop":
            axes.axhline(-5, color=FAINT, linewidth=0.8, linestyle=(0, (4, 3)))
        elif mark == "impacts":
            impacts = events(motion, "impact", begin) - begin
            axes.plot(impacts, np.full(len(impacts), -5.0), "o", color=IMPACT, markersize=3.5)
        if "x4" in names:
            axes.legend(loc="upper left")
    panels[-1].set_xlim(scale * (begin - origin), scale * (end - origin))
    return figure


def portraits(
    motions: Motions,
    since: Sequence[float],
    titles: Texts = (),
    bodies: str = "12",
    whole: bool = False,
    limits: tuple[float, float] | None = None,
    height: float = 2.6,
) -> Figure:
    """Draw phase portraits of the `bodies`, "1" bit and "2" striker, for each motion.

    Lines are thick from the time `since` [s] of the motion on. If `whole`, they are thin before, and a dot is at the
    beginning. `limits` [mm] are common limits of the abscissas.
    """
    labels = [{"1": "bit x₁ [mm]", "2": "striker x₂ [mm]"}[body] for body in bodies]
    texts = [title for title in titles for _ in bodies]
    share = len(bodies) == 1 and (whole or limits is not None)
    figure, panels = panels_for(height, labels * len(motions), "velocity [m/s]", texts, share)
    for axes, ((motion, begin), body) in zip(panels, product(zip(motions, since, strict=True), bodies), strict=True):
        late = within(motion, begin)
        for mask, linewidth, alpha in ((~late, 0.35, 0.6), (late, 1.2, None)) if whole else ((late, 1.2, None),):
            x_mm, velocity = (factor * motion[name + body].values[mask][::2] for name, factor in (("x", 1e3), ("v", 1)))
            colour = _COLOURS[f"x{body}"]
            axes.plot(x_mm, velocity, color=colour, linewidth=linewidth, alpha=alpha, rasterized=True)
        if whole:
            axes.plot(1e3 * motion[f"x{body}"][0], motion[f"v{body}"][0], "o", color=INK, markersize=5)
        if limits:
            axes.set_xlim(*limits)
    return figure


def struck_masses(motions: Motions) -> Figure:
    """Draw the displacements of three masses that hit a stop over time (Figs 5.1, 5.2, 5.7)."""
    titles, windows = ("free, on an elastic stop", "Tsaplin's hammer", "thrown ball"), ((0.0, 2.0), (58.0, 60.0))
    figure, panels = panels_for(1.1, "time [s]", ["x [mm]"] * 3, titles, grid=False)
    for axes, motion, (begin, end) in zip(panels, motions, (*windows, windows[1]), strict=True):
        shown = motion.isel(time=within(motion, begin, end))
        axes.plot(shown["time"] - begin, 1e3 * shown["x"], color=BIT, linewidth=1.1)
        for impact in events(motion, "impact", begin):
            axes.axvline(impact - begin, color=FAINT, linewidth=0.6)
        axes.set_xlim(0.0, end - begin)
    return figure


def restitution_of_blows(restitutions: Sequence[float]) -> Figure:
    """Draw the coefficient of restitution over the loss factor, in closed form (eq. 5.8) and of simulated blows."""
    figure, (axes,) = panels_for(2.8, ["loss factor ξ"], "restitution R")
    xi = np.linspace(0, 1, 200)
    axes.plot(xi, restitution(xi), color=INK, linewidth=1.1, label="closed form")
    axes.plot(LOSS_FACTORS, restitutions, "o", color=BIT, label="simulated blow")
    axes.legend()
    return figure


def friction_in_time(motion: xr.Dataset) -> Figure:
    """Draw the friction force in the first 12 s, and force and sliding speed after 39.2 s (Figs 5.32, 5.33).

    In the first panel the vibration grows; in the second panel it is periodic.
    """
    figure, panels = panels_for(1.6, "time [s]", ["friction F [N]"] * 2)
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
    figure, panels = panels_for(2.8, labels, "power, greatest 1", titles, share=True, grid=False)
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
    figure, panels = panels_for(1.35, "time [s]", ("x₁, x₂ [mm]", "x₁′, x₂′ [m/s]", "x₁″ [m/s²]"), (title,), share=True)
    for axes, variable, factor in ((panels[0], "x", 1e3), (panels[1], "v", 1.0)):
        for body, colour in (("1", BIT), ("2", STRIKER)):
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


def swept_sine(motions: Motions, stiffnesses: Sequence[int]) -> Figure:
    """Draw the bit's velocity amplitude and the depth of the hole over the frequency (Figs 6.4 to 6.7)."""
    labels = ("amplitude of x₃′ [mm/s]", "hole x₄ [mm]")
    figure, panels = panels_for(1.5, "frequency of the swept sine [Hz]", labels, share=True, grid=False)
    for motion, k3, colour in zip(motions, stiffnesses, LINE_COLOURS, strict=False):
        middles, swings = envelope(motion, "v3", 0.1)
        panels[0].plot(swept_frequency(middles), 1e3 * swings, color=colour, label=f"k₃ = {k3} MN/m")
        frequency = swept_frequency(motion["time"].values[::50])
        panels[1].plot(frequency, 1e3 * motion["x4"].values[::50], color=colour)
    panels[0].legend()
    return figure


def bit_and_hole(motions: Motions, titles: Texts, until_ms: int = 0) -> Figure:
    """Draw the displacements of bit and hole under pulses (Figs 6.8 to 6.11, 6.14, 6.16).

    `until_ms`: duration [ms] of the drawn beginning; 0 draws the complete motion.
    """
    labels = ["time [ms]" if until_ms else "time [s]"] * len(motions)
    figure, panels = panels_for(2.6, labels, "x₃, x₄ [mm]" if until_ms else "displacement [mm]", titles)
    for axes, motion in zip(panels, motions, strict=True):
        time = motion["time"].values * (1e3 if until_ms else 1.0)
        for name in ("x4", "x3"):
            axes.plot(time, 1e3 * motion[name], color=_COLOURS[name], linewidth=_WIDTHS[name], label=_NAMES[name])
        if until_ms:
            axes.set_xlim(0, until_ms)
            axes.set_ylim(top=1.15e3 * motion["x3"].values[time < until_ms].max())
    if not until_ms:
        panels[0].legend()
    return figure
