"""What the pictures share: figures of the page's size, and lines of motions."""

import numpy as np

from vibrojax.plot._style import BIT, FAINT, IMPACT, INK, ROCK, START_COLOURS, STICK, STRIKER, new_figure, styled
from vibrojax.reproduce import _signal as signal

__all__ = ["BIT", "FAINT", "IMPACT", "INK", "ROCK", "START_COLOURS", "STICK", "STRIKER", "new_figure", "styled"]

WIDTH = 6.4
"""Of a figure [inch]: on the page it is half a line wide."""
LINES = ("#004488", "#CC6677", "#8C6D1F", "#2E8B57", "#7A5195", "#56B4E9")
"""Colours of lines that are apart in greyscale too."""


def stacked(rows: int, height: float = 1.5, share: bool = True):
    """A figure of `rows` panels, over one abscissa or each over its own."""
    figure = new_figure(WIDTH, 0.7 + height * rows)
    return figure, figure.subplots(rows, 1, sharex=share, squeeze=False)[:, 0]


def beside(columns: int, height: float = 3.0, share: bool = False):
    """A figure of `columns` panels in a row."""
    figure = new_figure(WIDTH, height)
    return figure, figure.subplots(1, columns, sharey=share, squeeze=False)[0]


def window(motion, since: float, until: float = np.inf) -> np.ndarray:
    """Where the samples between two times [s] are."""
    time = motion["time"].values
    return (time >= since) & (time <= until)


def draw_portrait(axes, motion, x: str, v: str, colour: str, since: float, drive: float = 0.0, stride: int = 1) -> None:
    """A phase portrait, the approach thin, what comes after `since` [s] thick; `drive` [m/s] is added to velocities."""
    late = window(motion, since)
    for part, look in ((~late, {"linewidth": 0.35, "alpha": 0.6}), (late, {"linewidth": 1.2})):
        x_mm, velocity = 1e3 * motion[x].values[part], motion[v].values[part] + drive
        axes.plot(x_mm[::stride], velocity[::stride], color=colour, rasterized=True, **look)
    axes.grid(True)


def draw_pair(panels, motion, since: float, stride: int = 4) -> None:
    """Phase portraits of bit and striker, in two panels."""
    for axes, number, name, colour in zip(panels, "12", ("bit x₁", "striker x₂"), (BIT, STRIKER), strict=True):
        draw_portrait(axes, motion, f"x{number}", f"v{number}", colour, since, stride=stride)
        axes.set_xlabel(f"{name} [mm]")


def pair(motion, since: float):
    """A figure of the phase portraits of bit and striker."""
    figure, panels = beside(2)
    draw_pair(panels, motion, since)
    panels[0].set_ylabel("velocity [m/s]")
    return figure


def strikers(motions, titles, since: float, share: bool = False, stride: int = 1):
    """A figure of the striker's phase portraits from `since` [s] on, one panel for each motion."""
    figure, panels = beside(len(motions), 2.6, share)
    for axes, motion, title in zip(panels, motions, titles, strict=True):
        draw_portrait(axes, motion.isel(time=window(motion, since)), "x2", "v2", STRIKER, since, stride=stride)
        axes.set_title(title)
        axes.set_xlabel("x₂ [mm]")
    panels[0].set_ylabel("x₂′ [m/s]")
    return figure


LABELS = {"x1": "x₁ [mm]", "x2": "x₂ [mm]", "v1": "x₁′ [m/s]", "v2": "x₂′ [m/s]"}


def over_time(rows, until: float, titles=None, height: float = 1.3, stride: int = 1):
    """A figure of variables over time, one panel for each of `rows`, pairs of a motion and a name."""
    figure, panels = stacked(len(rows), height)
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


def draw_stick(axes, motion, values: np.ndarray, inside: np.ndarray) -> None:
    """A thick line over `values` where the bit sticks, of the samples `inside`."""
    stuck = np.where(motion["stuck"].values == 1, values, np.nan)
    axes.plot(motion["time"].values[inside], stuck[inside], color=STICK, linewidth=2.6)


def spectrum(motion, name: str, since: float, highest: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] up to `highest` and the power spectrum of a variable, its greatest value 1."""
    x = signal.part(motion, name, since)
    power = np.abs(np.fft.rfft(np.hanning(len(x)) * (x - x.mean()), 4 * len(x))) ** 2
    frequencies = np.fft.rfftfreq(4 * len(x), float(motion["time"][1] - motion["time"][0]))
    shown = frequencies <= highest
    return frequencies[shown], power[shown] / power[shown].max()
