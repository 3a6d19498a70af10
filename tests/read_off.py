"""What is read off a figure in the tests of pictures."""

from itertools import combinations

import matplotlib
from matplotlib.collections import QuadMesh
from matplotlib.patches import Rectangle


def meshes(figure, name=None):
    """The coloured cells of all panels: of the regimes, or of those whose colour map is `name`."""
    found = [mesh for axes in figure.axes for mesh in axes.collections if isinstance(mesh, QuadMesh)]
    panels = [mesh for mesh in found if not hasattr(mesh.axes, "_colorbar")]
    return [mesh for mesh in panels if mesh.get_cmap().name == (name or "regimes")]


def titles(figure):
    found = [axes.get_title(loc) for axes in figure.axes for loc in ("left", "center")]
    return [title.replace("\n", " ") for title in found if title]


def legend(figure):
    found = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    return [text.get_text() for one in found if one for text in one.get_texts() if text.get_text().strip()]


def note(figure):
    return figure.get_supxlabel()


def outlines(figure):
    boxes = [patch for axes in figure.axes for patch in axes.patches if isinstance(patch, Rectangle)]
    return [box.get_bbox().extents for box in boxes if not box.get_fill()]


def axis_labels(figure):
    return {text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text}


def texts(figure):
    """The visible texts but tick labels, and their boxes in pixels."""
    figure.draw_without_rendering()
    found = [text for text in figure.findobj(matplotlib.text.Text) if text.get_visible() and text.get_text().strip()]
    ticks = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in axis.get_ticklabels()}
    return [(text.get_text(), text.get_window_extent()) for text in found if id(text) not in ticks]


def check_texts(figure):
    """Check that all texts lie on the figure and off each other."""
    whole, placed = figure.bbox.padded(1), texts(figure)
    for text, box in placed:
        assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1, text
    for (one, a), (other, b) in combinations(placed, 2):
        assert not a.padded(-1).overlaps(b.padded(-1)), (one, other)


def panel(figure, **wanted):
    (name, text), *_ = wanted.items()
    return next(axes for axes in figure.axes if text in getattr(axes, f"get_{name}")())
