"""Shared parts of the pictures: figures with panels, time histories and phase portraits."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import BIT, STRIKER, new_figure

FIGURE_WIDTH = 6.4
"""Width of a figure [inch]: half the width of the text on the reproduction page."""
LINE_COLOURS = ("#004488", "#CC6677", "#8C6D1F", "#2E8B57", "#7A5195", "#56B4E9")
"""Line colours that are distinct in greyscale, too."""
AXIS_LABELS = {"x1": "x₁ [mm]", "x2": "x₂ [mm]", "v1": "x₁′ [m/s]", "v2": "x₂′ [m/s]"}


def single_panel(height: float) -> tuple[Figure, Axes]:
    """Return a figure with one panel; `height` in inches."""
    figure, (axes,) = in_row(1, height)
    return figure, axes


def stacked(rows: int, height: float = 1.5, share: bool = True, grid: bool = True) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with `rows` panels, one above the other; they have a common abscissa if `share`."""
    return _panels(0.7 + height * rows, (rows, 1), share, grid)


def in_row(columns: int, height: float = 3.0, share: bool = False, grid: bool = True) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with `columns` panels side by side; they have a common ordinate if `share`."""
    return _panels(height, (1, columns), share, grid)


def _panels(height: float, shape: tuple[int, int], share: bool, grid: bool) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure and its panels; `share`: a column of panels shares its abscissa, a row its ordinate."""
    figure = new_figure(FIGURE_WIDTH, height)
    figure.subplots(*shape, sharex=share and shape[1] == 1, sharey=share and shape[0] == 1)
    for axes in figure.axes:
        axes.grid(grid)
    return figure, figure.axes


def window(motion: xr.Dataset, since: float | int, until: float | int = np.inf) -> Bool[np.ndarray, " samples"]:
    """Return a mask of the samples from the time `since` to `until` [s], both inclusive."""
    time = motion["time"].values
    return (time >= since) & (time <= until)


def draw_portrait(axes: Axes, motion: xr.Dataset, body: str, since: float | int, stride: int = 1) -> None:
    """Draw a phase portrait of the bit (`body` "1") or striker ("2"): thin before `since` [s], thick afterwards."""
    late = window(motion, since)
    for part, linewidth, alpha in ((~late, 0.35, 0.6), (late, 1.2, None)):
        x_mm, velocity = 1e3 * motion[f"x{body}"].values[part][::stride], motion[f"v{body}"].values[part][::stride]
        colour = BIT if body == "1" else STRIKER
        axes.plot(x_mm, velocity, color=colour, linewidth=linewidth, alpha=alpha, rasterized=True)


def over_time(
    motions: Sequence[xr.Dataset], names: Sequence[str], until: float | int, titles: Sequence[str] = (), stride: int = 1
) -> Figure:
    """Draw variables over time up to `until` [s], with one panel per motion and variable name."""
    rows = [(motion, name) for motion in motions for name in names]
    figure, panels = stacked(len(rows), 1.3)
    for axes, (motion, name), title in zip(panels, rows, titles or [""] * len(rows), strict=True):
        factor, colour = 1e3 if name[0] == "x" else 1.0, BIT if name[1] == "1" else STRIKER
        values = factor * motion[name].values[::stride]
        axes.plot(motion["time"].values[::stride], values, color=colour, linewidth=0.5, rasterized=True)
        axes.set_title(title, loc="left")
        axes.set_ylabel(AXIS_LABELS[name])
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0, until)
    return figure


def portraits(
    motions: Sequence[xr.Dataset], since: Sequence[float | int], titles: Sequence[str] = (), height: float = 3.0
) -> Figure:
    """Draw phase portraits of bit and striker for each motion.

    `since` [s] (one time per motion): the lines are thick from there on. If there are `titles`, the earlier part of the
    motion is not drawn.
    """
    figure, panels = in_row(2 * len(motions), height)
    for index, (motion, begin) in enumerate(zip(motions, since, strict=True)):
        shown = motion.isel(time=window(motion, begin)) if titles else motion
        for axes, body, name in zip(panels[2 * index :], "12", ("bit x₁", "striker x₂"), strict=False):
            draw_portrait(axes, shown, body, begin, 2 if titles else 4)
            axes.set(title=titles[index] if titles else "", xlabel=f"{name} [mm]")
    panels[0].set_ylabel("velocity [m/s]")
    return figure


def strikers(
    motions: Sequence[xr.Dataset],
    since: float | int,
    titles: Sequence[str],
    stride: int = 1,
    limits: Sequence[float | int] = (),
) -> Figure:
    """Draw the striker's phase portraits from `since` [s] on; `limits` [mm] are common limits of the abscissas."""
    figure, panels = in_row(len(motions), 2.6, share=bool(limits))
    for axes, motion, title in zip(panels, motions, titles, strict=True):
        draw_portrait(axes, motion.isel(time=window(motion, since)), "2", since, stride)
        axes.set(title=title, xlabel="x₂ [mm]")
        if limits:
            axes.set_xlim(*limits)
    panels[0].set_ylabel("x₂′ [m/s]")
    return figure
