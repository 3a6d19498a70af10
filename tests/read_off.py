"""Functions that read artists and texts off a figure."""

from itertools import combinations

import matplotlib
from matplotlib.collections import QuadMesh


def meshes(figure, name=None):
    """Return the coloured cells of all panels with the regimes, or with the colour map `name`."""
    quads = [mesh for axes in figure.axes for mesh in axes.collections if isinstance(mesh, QuadMesh)]
    panels = [mesh for mesh in quads if not hasattr(mesh.axes, "_colorbar")]
    return [mesh for mesh in panels if mesh.get_cmap().name == (name or "regimes")]


def titles(figure):
    headings = [axes.get_title(loc) for axes in figure.axes for loc in ("left", "center")]
    return [title.replace("\n", " ") for title in headings if title]


def legend(figure):
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    return [text.get_text() for box in legends if box for text in box.get_texts() if text.get_text().strip()]


def note(figure):
    return figure.get_supxlabel()


def axis_labels(figure):
    return {text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text}


def texts(figure):
    """Return the visible texts except tick labels, with their boxes in pixels."""
    figure.draw_without_rendering()
    visible = [text for text in figure.findobj(matplotlib.text.Text) if text.get_visible() and text.get_text().strip()]
    ticks = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in axis.get_ticklabels()}
    return [(text.get_text(), text.get_window_extent()) for text in visible if id(text) not in ticks]


def check_texts(figure):
    """Check that all texts lie within the figure without overlap."""
    whole, placed = figure.bbox.padded(1), texts(figure)
    for text, box in placed:
        assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1, text
    for (text_a, a), (text_b, b) in combinations(placed, 2):
        assert not a.padded(-1).overlaps(b.padded(-1)), (text_a, text_b)


def panel(figure, **criterion):
    (name, text), *_ = criterion.items()
    return next(axes for axes in figure.axes if text in getattr(axes, f"get_{name}")())
