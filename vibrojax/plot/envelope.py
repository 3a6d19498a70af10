"""Curves over time, drawn as bands where the oscillations are too dense to be distinguished."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba

from vibrojax.plot.style import SAVED_DPI

_CYCLE_PIXELS = 5.0  # least width of a cycle that a line resolves
_COLUMN_PIXELS = 8  # a band takes minimum and maximum over this width: more than an unresolved cycle
_BAND_ALPHA = 0.3

Samples = Float[np.ndarray, " samples"]


def draw_over_time(axes: Axes, time: Samples, values: Samples, color: str, linewidth: float, label: str = "") -> Artist:
    """Draw values over time as a line, or as a band from minimum to maximum if a line would cover the panel.

    **Returns:** the line or the band, labelled `label`.
    """
    pixels = max(int(axes.bbox.width / axes.figure.dpi * SAVED_DPI), 1)
    height = float(np.ptp(values)) if values.size else 0.0
    # Number of cycles: the total variation over twice the height. Are the cycles too narrow for a line?
    if not (height > 0 and float(np.abs(np.diff(values)).sum()) / (2.0 * height) > pixels / _CYCLE_PIXELS):
        (line,) = axes.plot(time, values, color=color, linewidth=linewidth, label=label)
        return line
    count = max(pixels // _COLUMN_PIXELS, 1)
    column = np.minimum(np.floor((time - time[0]) / np.ptp(time) * count), count - 1)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    least, greatest = (reduce.reduceat(values, first) for reduce in (np.minimum, np.maximum))
    look: dict[str, Any] = {
        "facecolor": to_rgba(color, _BAND_ALPHA),
        "edgecolor": to_rgba(color, 0.9),
        "linewidth": 0.6,
    }
    ends = np.append(time[first], time[-1])  # the last column ends here
    return axes.fill_between(
        ends, np.append(least, least[-1]), np.append(greatest, greatest[-1]), label=label, step="post", **look
    )


def is_band(drawn: Artist) -> bool:
    """Return whether the artist from [vibrojax.plot.envelope.draw_over_time][] is a band."""
    return isinstance(drawn, PolyCollection)


def band_text(*panels: Axes) -> str:
    """Return the note on bands, or "" if no panel has a band."""
    if not any(is_band(drawn) for axes in panels for drawn in axes.collections):
        return ""
    return "Bands: from the least to the greatest value, where the oscillations are too many to be told apart"
