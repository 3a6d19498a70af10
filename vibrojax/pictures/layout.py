"""Layout of the panels of a picture: matplotlib's constrained layout, in a fraction of its time.

Matplotlib finds the place of the label of an axis, and the height of a title, from all tick labels around, each time
that it measures a panel: for 14 panels, it computes ticks a thousand times. Here, labels are placed once before panels,
and titles stay where they are.
"""

from collections import defaultdict
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.transforms import ScaledTranslation

_POINTS = 72.0  # in an inch
_LAYOUT_MAX_ROUNDS = 3  # the place of labels and the size of panels depend on each other by the width of tick labels
_SAME_PLACE = 0.01  # difference of the places of a label that a further round does not correct [inch]


class PanelLayout(ConstrainedLayoutEngine):
    """A constrained layout that aligns the labels of the vertical axes of each column of panels."""

    def execute(self, fig: Figure) -> Any:
        """Place all panels and their labels."""
        before: dict[Any, float] = {}
        for _ in range(_LAYOUT_MAX_ROUNDS):
            placed = _place_labels(fig)
            if before and all(abs(placed[axis] - before[axis]) < _SAME_PLACE for axis in placed):
                break
            before = placed
            grids = super().execute(fig)
        return grids


def title_height(axes: Axes) -> float | None:
    """Return the height of the title over the panel; None if it has to make room for an exponent of the axis."""
    formatter: Any = axes.yaxis.get_major_formatter()
    formatter.set_locs(axes.yaxis.get_majorticklocs())
    return None if formatter.get_offset() else 1.0


def _place_labels(figure: Figure) -> dict[Any, float]:
    """Place the labels of all axes beside the tick labels; return their distances from the panels [inch], by axis."""
    columns: dict[float, list[Any]] = defaultdict(list)
    placed: dict[Any, float] = {}
    for axes in figure.axes:
        columns[round(axes.get_position(original=True).x0, 3)].append(axes.yaxis)
        placed[axes.xaxis] = _room(axes, axes.xaxis, 1)
        placed[axes.yaxis] = _room(axes, axes.yaxis, 0)
    for column in columns.values():
        placed |= dict.fromkeys(column, max(placed[axis] for axis in column))
    for axis, inches in placed.items():
        vertical = axis is axis.axes.yaxis
        away = ScaledTranslation(-inches * vertical, -inches * (not vertical), figure.dpi_scale_trans)
        axis.set_label_coords(*((0.0, 0.5) if vertical else (0.5, 0.0)), axis.axes.transAxes + away)
    return placed


def _room(axes: Axes, axis: Any, side: int) -> float:
    """Return the distance of the label from the panel [inch]: to the left (`side` 0), below (1), or 0 without label."""
    if not axis.label.get_text():
        return 0.0
    axis.label.set_visible(False)
    ticks = axis.get_tightbbox()
    axis.label.set_visible(True)
    outside = 0.0 if ticks is None else max(0.0, axes.bbox.min[side] - ticks.min[side])
    return float(outside) / axes.figure.dpi + axis.labelpad / _POINTS
