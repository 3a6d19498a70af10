"""Picture of families of periodic orbits over a parameter, with their stability, special points and multipliers."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.patches import Circle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from vibrojax.io.branches import FAMILY, along_name
from vibrojax.plot.axes import label, scale, values_along, with_unit
from vibrojax.plot.branches import (
    LARGEST,
    Curve,
    colour_handles,
    curves_of,
    draw_families,
    heights_of,
    ranges_text,
    special_handles,
    stability_handles,
)
from vibrojax.plot.sheet import write_margins
from vibrojax.plot.starts import SYMBOLS
from vibrojax.plot.style import INK, colour_map, new_figure, styled

_MODULUS_RANGE = (1e-2, 1e2)  # limits of the axis of the largest modulus
_DENSE_TICKS_BELOW = 50.0  # ratio of the axis limits below which 2 and 5 also have ticks
_HALF_PLANE = (1.2, 1.5)  # bounds of half the width of the multiplier plot
_QUANTITIES = ("impact_velocity", "slip_per_impact", "bit_amplitude", "period")  # the first available one is drawn
_PANEL_HEIGHT = 2.1  # inches


@styled
def families(ds: xr.Dataset, names: Sequence[str] = ()) -> Figure:
    """Draw families over the parameter with their special points; stable orbits are solid, unstable orbits dashed.

    The panels show the impact velocity (without impacts, the bit's amplitude), the bit's position at the section, and
    the largest modulus of the multipliers. Next to the panels, the multipliers are drawn in the complex plane. Branches
    of a single family are coloured by their number of section crossings per period, and the multipliers of its first
    branch by the parameter. If there are several families, each has its own colour.

    `names`: variables with the dimension `point` that replace the variables of the first two panels.
    """
    if not names:
        known = [name for name in _QUANTITIES if name in ds and bool(np.isfinite(ds[name].values).any())]
        states = [str(name) for name in ds.data_vars if str(name).startswith("orbit_")]
        names = (*known[:1], *states[:1])
    names = (*names, LARGEST)
    curves, many = curves_of(ds), FAMILY in ds.dims
    figure = new_figure(11.0, _PANEL_HEIGHT * len(names) + 0.8)
    columns = GridSpec(1, 2, figure, width_ratios=[1.75, 1.0])
    panels = columns[0].subgridspec(len(names), 1).subplots(sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        draw_families(axes, ds, curves, name, thin=many)
        axes.set_ylabel(_label(ds, name))
        axes.grid(True)
    _shape_moduli(panels[-1])
    panels[-1].set_xlabel(label(ds[along_name(ds)]))
    figure.align_ylabels(panels)
    beside = columns[1].subgridspec(3, 1, height_ratios=[2.55, 0.09, 0.85 * len(names) - 0.45])
    plane, bar, keys = (figure.add_subplot(beside[i]) for i in range(3))
    outside = _draw_plane(plane, bar, ds, curves)
    keys.axis("off")
    handles = [*colour_handles(ds, curves), *stability_handles(ds, curves), *special_handles(ds)]
    keys.legend(handles=handles, loc="upper left", ncols=2, borderpad=0.0)
    largest, (low, high) = heights_of(ds, LARGEST, 1.0), _MODULUS_RANGE
    cut = bool(((largest < low) | (largest > high)).any())
    moduli = f"The largest modulus is drawn from {low:g} to {high:g}" if cut else ""
    write_margins(figure, ds, ranges_text(ds, names), moduli, outside)
    return figure


def _label(ds: xr.Dataset, name: str) -> str:
    if name == LARGEST:
        return "largest modulus\nof the multipliers"
    state = name.removeprefix("orbit_")
    words = f"{SYMBOLS.get(state, state)} at the section" if state != name else name.replace("_", " ")
    return with_unit(words, scale(ds[name])[1]).replace(" [", "\n[")


def _shape_moduli(axes: Axes) -> None:
    """Use a logarithmic axis for the largest modulus, and draw the stability limit."""
    axes.axhline(1.0, color=INK, linewidth=0.8, zorder=1)
    low, high = (float(end) for end in axes.dataLim.intervaly)
    low, high = max(min(low, 0.5), _MODULUS_RANGE[0]) / 1.2, min(max(high, 1.5), _MODULUS_RANGE[1]) * 1.2
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < _DENSE_TICKS_BELOW else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_plane(axes: Axes, bar: Axes, ds: xr.Dataset, curves: Sequence[Curve]) -> str:
    """Draw the multipliers of the first branches in the complex plane; return a note on those outside the axes."""
    parameter, many = ds[along_name(ds)], FAMILY in ds.dims
    along = values_along(parameter)
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=INK, linewidth=0.9))
    axes.axhline(0.0, color="0.85", linewidth=0.6, zorder=0)
    axes.axvline(0.0, color="0.85", linewidth=0.6, zorder=0)
    first = min((curve.branch.number for curve in curves), default=0)
    shown = [curve for curve in curves if curve.branch.number == first]
    points = np.concatenate([np.zeros(0, int), *(curve.branch.points for curve in shown)])
    modulus, argument = ds[LARGEST].values[points], ds["multiplier_arg"].values[points]
    half = float(np.clip(1.1 * modulus[np.isfinite(modulus)].max(initial=0.0), *_HALF_PLANE))
    values = (modulus * np.exp(1j * argument)).reshape(len(points), -1)
    norm = Normalize(along[points].min(), along[points].max()) if len(points) else Normalize()
    if many:
        colours = np.repeat([curve.colour for curve in shown], [len(curve.branch.points) for curve in shown])
        bar.axis("off")
    else:
        colours = colour_map()(norm(along[points]))
        mappable = ScalarMappable(norm, colour_map())
        bar.figure.colorbar(mappable, cax=bar, orientation="horizontal", label=label(parameter, 60))
    for column in values.T if len(points) else ():
        for mirrored in (column, column.conj()):
            axes.scatter(mirrored.real, mirrored.imag, s=5.0 if many else 12.0, c=colours, linewidths=0, zorder=3)
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.set_title(f"multipliers of branch {first}")
    largest = values[:, 0] if len(points) else np.zeros(0)
    outside = int((np.maximum(np.abs(largest.real), np.abs(largest.imag)) > half).sum())
    return f"The plane leaves out {outside} of {len(points)} orbits' largest multiplier" if outside else ""
