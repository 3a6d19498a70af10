"""Shared parts of the pictures: panels of the page's size, time histories and phase portraits."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import BIT, STRIKER, new_figure

FIGURE_WIDTH = 6.4
"""Width of a figure [inch]: half a line of the page."""
LINE_COLOURS = ("#004488", "#CC6677", "#8C6D1F", "#2E8B57", "#7A5195", "#56B4E9")
"""Colours of lines that also differ in greyscale."""
AXIS_LABELS = {"x1": "x₁ [mm]", "x2": "x₂ [mm]", "v1": "x₁′ [m/s]", "v2": "x₂′ [m/s]"}


def single_panel(height: float) -> tuple[Figure, Axes]:
    """Return a figure with one panel, with a grid."""
    figure = new_figure(FIGURE_WIDTH, height)
    axes = figure.subplots()
    axes.grid(True)
    return figure, axes


def stacked(rows: int, height: float = 1.5, share: bool = True) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure of `rows` panels, over one abscissa or each over its own."""
    figure = new_figure(FIGURE_WIDTH, 0.7 + height * rows)
    return figure, list(figure.subplots(rows, 1, sharex=share, squeeze=False)[:, 0])


def in_row(columns: int, height: float = 3.0, share: bool = False) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure of `columns` panels side by side."""
    figure = new_figure(FIGURE_WIDTH, height)
    return figure, list(figure.subplots(1, columns, sharey=share, squeeze=False)[0])


def window(motion: xr.Dataset, since: float | int, until: float | int = np.inf) -> Bool[np.ndarray, " samples"]:
    """Return flags of the samples between two times [s], both included."""
    time = motion["time"].values
    return (time >= since) & (time <= until)


def draw_portrait(axes: Axes, motion: xr.Dataset, body: str, since: float | int, stride: int = 1) -> None:
    """Draw a phase portrait of bit or striker ("1" or "2"), thin up to `since` [s] and thick from there."""
    late = window(motion, since)
    for part, linewidth, alpha in ((~late, 0.35, 0.6), (late, 1.2, None)):
        x_mm, velocity = 1e3 * motion[f"x{body}"].values[part][::stride], motion[f"v{body}"].values[part][::stride]
        colour = BIT if body == "1" else STRIKER
        axes.plot(x_mm, velocity, color=colour, linewidth=linewidth, alpha=alpha, rasterized=True)
    axes.grid(True)


def draw_both_portraits(panels: Sequence[Axes], motion: xr.Dataset, since: float | int, stride: int = 4) -> None:
    """Draw phase portraits of bit and striker in two panels."""
    for axes, body, name in zip(panels, "12", ("bit x₁", "striker x₂"), strict=True):
        draw_portrait(axes, motion, body, since, stride)
        axes.set_xlabel(f"{name} [mm]")


def over_time(
    motions: Sequence[xr.Dataset],
    names: Sequence[str],
    until: float | int,
    titles: Sequence[str] = (),
    stride: int = 1,
) -> Figure:
    """Draw variables over time, a panel for each motion and each name."""
    rows = [(motion, name) for motion in motions for name in names]
    figure, panels = stacked(len(rows), 1.3)
    for axes, (motion, name), title in zip(panels, rows, titles or [""] * len(rows), strict=True):
        factor, colour = 1e3 if name[0] == "x" else 1.0, BIT if name[1] == "1" else STRIKER
        values = factor * motion[name].values[::stride]
        axes.plot(motion["time"].values[::stride], values, color=colour, linewidth=0.5, rasterized=True)
        axes.set_title(title, loc="left")
        axes.set_ylabel(AXIS_LABELS[name])
        axes.grid(True)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0, until)
    return figure


def portraits(motion: xr.Dataset, since: float | int) -> Figure:
    """Draw the phase portraits of bit and striker."""
    figure, panels = in_row(2)
    draw_both_portraits(panels, motion, since)
    panels[0].set_ylabel("velocity [m/s]")
    return figure


def strikers(
    motions: Sequence[xr.Dataset],
    since: float | int,
    titles: Sequence[str],
    stride: int = 1,
    limits: Sequence[float | int] = (),
) -> Figure:
    """Draw the striker's phase portraits from `since` [s] on, over the same axes if there are `limits` [mm]."""
    figure, panels = in_row(len(motions), 2.6, share=bool(limits))
    for axes, motion, title in zip(panels, motions, titles, strict=True):
        draw_portrait(axes, motion.isel(time=window(motion, since)), "2", since, stride)
        axes.set_title(title)
        axes.set_xlabel("x₂ [mm]")
        if limits:
            axes.set_xlim(*limits)
    panels[0].set_ylabel("x₂′ [m/s]")
    return figure
