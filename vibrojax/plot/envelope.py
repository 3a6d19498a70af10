"""What is drawn over time: lines, or where there are more oscillations than can be told apart, the band they fill."""

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba

from vibrojax.plot.style import FINEST

_NARROWEST = 5.0  # pixels of a cycle, from which a line shows it
_COLUMN = 8  # pixels over which a band takes its least and greatest value: a cycle and more
_SHADE = 0.3

Samples = Float[np.ndarray, " samples"]


def draw_over_time(axes: Axes, time: Samples, values: Samples, color: str, linewidth: float, label: str = "") -> Artist:
    """Draw `values` over `time`: a line; a band from the least to the greatest where a line would cover the panel.

    **Returns:** the line or the band, under `label`.
    """
    columns = _columns(axes)
    if not _covers(values, columns):
        (line,) = axes.plot(time, values, color=color, linewidth=linewidth, label=label)
        return line
    first = np.flatnonzero(np.diff(_column_of(time, max(columns // _COLUMN, 1)), prepend=-1))
    least, greatest = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
    ends, last = np.append(time[first], time[-1]), slice(-1, None)  # to the end of the last column
    least, greatest = np.append(least, least[last]), np.append(greatest, greatest[last])
    face, edge = to_rgba(color, _SHADE), to_rgba(color, 0.9)
    return axes.fill_between(
        ends, least, greatest, facecolor=face, edgecolor=edge, linewidth=0.6, label=label, step="post"
    )


def is_band(drawn: Artist) -> bool:
    """Whether `drawn`, from [vibrojax.plot.envelope.draw_over_time][], is a band."""
    return isinstance(drawn, PolyCollection)


def band_text(*panels: Axes) -> str:
    """What the bands on `panels` are, in words; nothing where there are none."""
    if not any(is_band(drawn) for axes in panels for drawn in axes.collections):
        return ""
    return "Bands: from the least to the greatest value, where the oscillations are too many to be told apart"


def _columns(axes: Axes) -> int:
    """How many pixels wide the panel is, about."""
    return max(int(axes.bbox.width / axes.figure.dpi * FINEST), 1)


def _covers(values: Samples, columns: int) -> bool:
    """Whether the strokes of a line, laid end to end, are those of cycles over the whole height narrower than that."""
    height = float(np.ptp(values)) if values.size else 0.0
    if not height > 0:
        return False
    return float(np.abs(np.diff(values)).sum()) / (2.0 * height) > columns / _NARROWEST


def _column_of(time: Samples, columns: int) -> Float[np.ndarray, " samples"]:
    """The number of the column in which each sample lies."""
    share = (time - time[0]) / np.ptp(time)
    return np.minimum(np.floor(share * columns), columns - 1)
