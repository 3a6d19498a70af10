"""What the pictures share: figures of the page's size, and lines of motions."""

from collections.abc import Iterable, Sequence

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.plot.style import BIT, FAINT, IMPACT, INK, ROCK, START_COLOURS, STICK, STRIKER, new_figure, styled
from vibrojax.reproduce import motions

__all__ = ["BIT", "FAINT", "IMPACT", "INK", "ROCK", "START_COLOURS", "STICK", "STRIKER", "new_figure", "styled"]

Flags = Bool[np.ndarray, " samples"]
WIDTH = 6.4
"""Of a figure [inch]: on the page it is half a line wide."""
LINES = ("#004488", "#CC6677", "#8C6D1F", "#2E8B57", "#7A5195", "#56B4E9")
"""Colours of lines that differ in greyscale too."""


def stacked(rows: int, height: float = 1.5, share: bool = True) -> tuple[Figure, Sequence[Axes]]:
    """A figure of `rows` panels, over one abscissa or each over its own."""
    figure = new_figure(WIDTH, 0.7 + height * rows)
    return figure, list(figure.subplots(rows, 1, sharex=share, squeeze=False)[:, 0])


def beside(columns: int, height: float = 3.0, share: bool = False) -> tuple[Figure, Sequence[Axes]]:
    """A figure of `columns` panels in a row."""
    figure = new_figure(WIDTH, height)
    return figure, list(figure.subplots(1, columns, sharey=share, squeeze=False)[0])


def window(motion: xr.Dataset, since: float, until: float = np.inf) -> Flags:
    """Where the samples between two times [s] are."""
    time = motion["time"].values
    return (time >= since) & (time <= until)


def draw_portrait(axes: Axes, motion: xr.Dataset, body: str, colour: str, since: float, stride: int = 1) -> None:
    """A phase portrait of bit or striker ("1" or "2"), the approach thin, what comes after `since` [s] thick."""
    late = window(motion, since)
    for part, linewidth, alpha in ((~late, 0.35, 0.6), (late, 1.2, None)):
        x_mm, velocity = 1e3 * motion[f"x{body}"].values[part][::stride], motion[f"v{body}"].values[part][::stride]
        axes.plot(x_mm, velocity, color=colour, linewidth=linewidth, alpha=alpha, rasterized=True)
    axes.grid(True)


def draw_pair(panels: Sequence[Axes], motion: xr.Dataset, since: float, stride: int = 4) -> None:
    """Phase portraits of bit and striker, in two panels."""
    for axes, body, name, colour in zip(panels, "12", ("bit x₁", "striker x₂"), (BIT, STRIKER), strict=True):
        draw_portrait(axes, motion, body, colour, since, stride)
        axes.set_xlabel(f"{name} [mm]")


def pair(motion: xr.Dataset, since: float) -> Figure:
    """A figure of the phase portraits of bit and striker."""
    figure, panels = beside(2)
    draw_pair(panels, motion, since)
    panels[0].set_ylabel("velocity [m/s]")
    return figure


def strikers(
    over: Sequence[xr.Dataset], titles: Iterable[str], since: float, share: bool = False, stride: int = 1
) -> Figure:
    """A figure of the striker's phase portraits from `since` [s] on, one panel for each motion."""
    figure, panels = beside(len(over), 2.6, share)
    for axes, motion, title in zip(panels, over, titles, strict=True):
        draw_portrait(axes, motion.isel(time=window(motion, since)), "2", STRIKER, since, stride)
        axes.set_title(title)
        axes.set_xlabel("x₂ [mm]")
    panels[0].set_ylabel("x₂′ [m/s]")
    return figure


LABELS = {"x1": "x₁ [mm]", "x2": "x₂ [mm]", "v1": "x₁′ [m/s]", "v2": "x₂′ [m/s]"}


def over_time(
    rows: Sequence[tuple[xr.Dataset, str]], until: float, titles: Sequence[str] = (), stride: int = 1
) -> Figure:
    """A figure of variables over time, one panel for each of `rows`, pairs of a motion and a name."""
    figure, panels = stacked(len(rows), 1.3)
    for axes, (motion, name), title in zip(panels, rows, titles or [""] * len(rows), strict=True):
        factor, colour = 1e3 if name[0] == "x" else 1.0, BIT if name[1] == "1" else STRIKER
        values = factor * motion[name].values[::stride]
        axes.plot(motion["time"].values[::stride], values, color=colour, linewidth=0.5, rasterized=True)
        axes.set_title(title, loc="left")
        axes.set_ylabel(LABELS[name])
        axes.grid(True)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0, until)
    return figure


def draw_stick(axes: Axes, motion: xr.Dataset, values: Float[np.ndarray, " samples"]) -> None:
    """A thick line over `values` where the bit sticks."""
    stuck = np.where(motion["stuck"].values == 1, values, np.nan)
    axes.plot(motion["time"].values, stuck, color=STICK, linewidth=2.6)


def spectrum(motion: xr.Dataset, name: str, since: float, highest: float) -> motions.Spectrum:
    """The power spectrum of a variable up to a frequency [Hz], its greatest value 1."""
    frequencies, power = motions.power_spectrum(motion, name, since, padding=4)
    shown = frequencies <= highest
    return motions.Spectrum(frequencies[shown], power[shown] / power[shown].max())
