"""The region of the source's best single impacts, outlined on maps over beta and gamma."""

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke

from vibrojax.plot._style import INK

# Chapter 5 of the source: stable single impact, "best".
REGION = {"beta": (0.25, 0.60), "gamma": (0.60, 0.80)}
_NAME = "source's best region"


def outline_region(axes: Axes, x: str, y: str) -> None:
    """Outline the source's region where the axes are beta and gamma and show some of it."""
    if {x, y} != set(REGION):
        return
    (left, right), (low, high) = REGION[x], REGION[y]
    (first, last), (bottom, top) = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    if left < last and right > first and low < top and high > bottom:
        region = Rectangle((left, low), right - left, high - low, fill=False, edgecolor=INK, linewidth=1.3)
        region.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
        region.set_label(_NAME)
        axes.add_patch(region)


def outline_handle(axes: Axes) -> list[Artist]:
    """The legend's entry for the source's region, where `axes` shows it."""
    shown = any(isinstance(patch, Rectangle) and patch.get_label() == _NAME for patch in axes.patches)
    return [Patch(fill=False, edgecolor=INK, linewidth=1.3, label=_NAME)] if shown else []
