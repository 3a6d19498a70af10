"""Families of periodic orbits over a parameter: solid where stable, with their special points and multipliers."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.patches import Circle
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from vibrojax.errors import InputError
from vibrojax.io.branches import FAMILY, along_name
from vibrojax.io.kinds import kind_of
from vibrojax.plot.axes import label, point_text, scale, values_along, with_unit
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
from vibrojax.plot.margins import write_margins
from vibrojax.plot.starts import SYMBOLS
from vibrojax.plot.style import COLOURS, INK, new_figure, styled

_MODULI = (1e-2, 1e2)  # greatest range of the largest modulus that is drawn
_FEW = 50.0  # between its ends, up to which 2 and 5 have ticks as well
_PLANE = (1.2, 1.5)  # half the width of the plane of multipliers, at least and at most
_QUANTITIES = ("impact_velocity", "slip_per_impact", "bit_amplitude", "period")  # the first of them is drawn
_HEIGHT = 2.1  # inches of a panel


@styled
def families(ds: xr.Dataset, names: Sequence[str] = ()) -> Figure:
    """Families over the parameter, solid where they are stable, dashed where not, with their special points.

    Above each other the impact velocity (without impacts the bit's amplitude), the bit's position at the section, and
    the largest modulus of the multipliers; beside them the multipliers in the complex plane. Of one family branches are
    told apart by their number of returns, and the multipliers are those of the first branch, in the colour of the
    parameter; of several each has its own colour.

    **Arguments:**

    - `ds`: what `follow` gives.
    - `names`: variables along `point` to draw in place of the first two.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where there are no families, or no such variable.
    """
    if kind_of(ds) != "family":
        raise InputError("no families to draw: the dataset holds no branch and special_kind, as vj.follow gives them")
    names = (*(names or _usual(ds)), LARGEST)
    curves, many = curves_of(ds), FAMILY in ds.dims
    figure = new_figure(11.0, _HEIGHT * len(names) + 0.8)
    columns = GridSpec(1, 2, figure, width_ratios=[1.75, 1.0])
    above = columns[0].subgridspec(len(names), 1)
    panels: list[Axes] = []
    for at, name in enumerate(names):
        axes = figure.add_subplot(above[at], sharex=panels[0] if panels else None)
        draw_families(axes, ds, curves, name, thin=many)
        axes.set_ylabel(_label(ds, name))
        axes.tick_params(labelbottom=at == len(names) - 1)
        axes.grid(True)
        panels.append(axes)
    _shape_moduli(panels[-1])
    panels[-1].set_xlabel(label(ds[along_name(ds)]))
    figure.align_ylabels(panels)
    beside = columns[1].subgridspec(3, 1, height_ratios=[2.55, 0.09, 0.85 * len(names) - 0.45])
    plane, bar, keys = (figure.add_subplot(beside[at]) for at in range(3))
    beyond = _draw_plane(plane, bar, ds, curves, many)
    keys.axis("off")
    keys.legend(
        handles=[*colour_handles(ds, curves), *stability_handles(ds, curves), *special_handles(ds)],
        loc="upper left",
        ncols=2,
        borderpad=0.0,
    )
    notes = point_text(ds), ranges_text(ds, names), _moduli_text(ds), beyond
    write_margins(figure, str(ds.attrs.get("title", "")), *notes)
    return figure


def _usual(ds: xr.Dataset) -> tuple[str, ...]:
    """What there is of the blows, else of the bit, and its position at the section."""
    known = [name for name in _QUANTITIES if name in ds and bool(np.isfinite(ds[name].values).any())]
    states = [str(name) for name in ds.data_vars if str(name).startswith("orbit_")]
    return (*known[:1], *states[:1])


def _label(ds: xr.Dataset, name: str) -> str:
    if name == LARGEST:
        return "largest modulus\nof the multipliers"
    unit, state = scale(ds[name])[1], name.removeprefix("orbit_")
    words = f"{SYMBOLS.get(state, state)} at the section" if name.startswith("orbit_") else name.replace("_", " ")
    return with_unit(words, unit).replace(" [", "\n[")


def _shape_moduli(axes: Axes) -> None:
    """Logarithmic, with the border of stability."""
    axes.axhline(1.0, color=INK, linewidth=0.8, zorder=1)
    low, high = (float(end) for end in axes.dataLim.intervaly)
    ends = np.array([max(min(low, 0.5), _MODULI[0]) / 1.2, min(max(high, 1.5), _MODULI[1]) * 1.2])
    axes.set_yscale("log")
    axes.set_ylim(*ends)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ends[1] / ends[0] < _FEW else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _moduli_text(ds: xr.Dataset) -> str:
    """What is left out of the largest moduli, in words."""
    largest = heights_of(ds, LARGEST, 1.0)
    low, high = _MODULI
    return (
        f"The largest modulus is drawn from {low:g} to {high:g}" if ((largest < low) | (largest > high)).any() else ""
    )


# The plane of multipliers.


def _draw_plane(axes: Axes, bar: Axes, ds: xr.Dataset, curves: Sequence[Curve], many: bool) -> str:
    """Draw the multipliers of the first branches in the complex plane; and say how many lie beyond what is shown."""
    along = values_along(ds[along_name(ds)])
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=INK, linewidth=0.9))
    axes.axhline(0.0, color="0.85", linewidth=0.6, zorder=0)
    axes.axvline(0.0, color="0.85", linewidth=0.6, zorder=0)
    first = min((one.branch.number for one in curves), default=0)
    shown = [one for one in curves if one.branch.number == first]
    points = np.concatenate([one.branch.points for one in shown]) if shown else np.zeros(0, int)
    modulus, argument = ds[LARGEST].values[points], ds["multiplier_arg"].values[points]
    finite = modulus[np.isfinite(modulus)]
    half = float(np.clip(1.1 * finite.max(initial=0.0), *_PLANE))
    values = modulus * np.exp(1j * argument)
    norm = (
        Normalize(along[points].min(initial=np.inf), along[points].max(initial=-np.inf)) if len(points) else Normalize()
    )
    map_ = colormaps[COLOURS.get() or "viridis"]
    colours = (
        np.repeat([one.colour for one in shown], [len(one.branch.points) for one in shown])
        if many
        else map_(norm(along[points]))
    )
    size = 5.0 if many else 12.0
    for column in range(values.shape[1] if values.ndim > 1 else 0):
        for mirrored in (values[:, column], values[:, column].conj()):
            axes.scatter(mirrored.real, mirrored.imag, s=size, c=colours, linewidths=0, zorder=3)
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="real part", ylabel="imaginary part")
    axes.set_title(f"multipliers of branch {first}")
    bar.axis("off") if many else bar.figure.colorbar(
        ScalarMappable(norm, map_), cax=bar, orientation="horizontal", label=label(ds[along_name(ds)], 60)
    )
    largest = values[:, 0] if values.ndim > 1 else values
    outside = int((np.maximum(np.abs(largest.real), np.abs(largest.imag)) > half).sum())
    return f"The plane leaves out {outside} of {len(points)} orbits' largest multiplier" if outside else ""
