"""Pictures of the bit on rock under an applied force: hole growth under pulses, and response to a swept sine."""

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.pictures.axes import number
from vibrojax.pictures.contents import Contents
from vibrojax.pictures.curves import band_text, draw_over_time
from vibrojax.pictures.motion import Run, Samples, blow_times, read_run
from vibrojax.pictures.sheet import write_margins
from vibrojax.pictures.style import BIT, DASHED, FAINT, IMPACT, INK, ROCK, Mark, new_figure, styled

# Factors and units for large and for small values, and the least large value in SI units.
_UNITS = {
    "length": ((1e3, "mm"), (1e6, "µm"), 2e-4),
    "speed": ((1.0, "m/s"), (1e3, "mm/s"), 1.0),
    "force": ((1e-3, "kN"), (1.0, "N"), 1e4),
}
_FORCES = {  # colour, line width, legend text
    "applied_force": (FAINT, 1.0, "given I"),
    "rock_force": (INK, 1.0, "rock N"),
    "impact_force": (IMPACT, 1.0, "impact force J"),
    "friction_force": (INK, 0.8, "friction force F"),
}
_ENLARGED_BLOWS = 2
_LEAD = 0.08  # fraction of the time between blows that is shown before the first enlarged blow
_FEWEST_CYCLES = 4
_LEAST_SLIP = 1e-12  # [m] in one cycle: less is rounding error
_MANY_CYCLES = 120  # number of cycles from which curves have no markers


def draw_hole(axes: Axes, hole: Run, start: float, end: float) -> None:
    """Draw the bit's displacement x3 and the hole's depth x4 from `start` to `end` [s]."""
    late = hole.between(start, end)
    factor, unit = _scale("length", hole["x3"][late], hole["x4"][late])
    axes.grid(True)
    # The wider line of the hole is drawn first, so that both are visible where the bit presses on the hole's bottom.
    draw_over_time(axes, hole.time[late], factor * hole["x4"][late], ROCK, 2.4, "hole x₄")
    draw_over_time(axes, hole.time[late], factor * hole["x3"][late], BIT, 0.9, "bit x₃")
    axes.set_ylabel(f"depth\n[{unit}]")
    axes.set_xlim(start, end)


def draw_forces(axes: Axes, run: Run, late: slice, *names: str, threshold: float | None = None) -> None:
    """Draw the forces `names` that the run has over the samples `late`, and the rock's threshold [N]."""
    forces = {name: run[name] for name in names if run.has(name)}
    factor, unit = _scale("force", *forces.values())
    axes.grid(True)
    if threshold is not None:
        text = f"threshold D = {number(factor * threshold)} {unit}"
        axes.axhline(factor * threshold, color=ROCK, linewidth=1.0, linestyle=DASHED, label=text)
    for name, force in forces.items():
        draw_over_time(axes, run.time[late], factor * force[late], *_FORCES[name])
    axes.set_ylabel(f"force\n[{unit}]")


def growth_text(hole: Run) -> str:
    """Return the note on the hole's growth over the run."""
    depth, duration = 1e3 * float(hole["x4"][-1] - hole["x4"][0]), float(np.ptp(hole.time))
    if not depth > 0:
        return "No penetration"
    return f"The hole grows by {number(float(f'{depth:.3g}'))} mm in {number(duration)} s"


def _scale(quantity: str, *values: Samples) -> tuple[float, str]:
    """Return the conversion factor and the unit to print `values` of a quantity in, given in SI units."""
    large, small, bound = _UNITS[quantity]
    greatest = max((float(np.abs(part).max(initial=0.0)) for part in values), default=0.0)
    return large if greatest >= bound or (quantity == "length" and greatest == 0.0) else small


@styled
def pulses(ds: xr.Dataset) -> Figure:
    """Draw bit and hole above the forces on the bit: the whole run at the left, its last two blows at the right.

    **Raises:** `InputError` if the dataset holds no trajectory of bit and hole.
    """
    hole = read_run(ds, "x3", "x4")
    first, end = float(hole.time[0]), float(hole.time[-1])
    late = _last_blows(hole)
    forces = hole.has("applied_force", "rock_force")
    figure = new_figure(10.0, 5.4 if forces else 3.4)
    ratios = {"width_ratios": [1.25, 1.0], "height_ratios": [1.3, 1.0][: 1 + forces]}
    grid = figure.add_gridspec(1 + forces, 2, **ratios)
    threshold = hole.parameters.get("threshold")
    for column, start in enumerate((first, late)):
        shown = [figure.add_subplot(grid[0, column])]
        draw_hole(shown[0], hole, start, end)
        if forces:
            shown.append(figure.add_subplot(grid[1, column], sharex=shown[0]))
            draw_forces(shown[1], hole, hole.between(start, end), "applied_force", "rock_force", threshold=threshold)
            shown[0].tick_params(labelbottom=False)
        shown[-1].set_xlabel("time [s]")
        for axes in shown if column == 0 else ():
            axes.axvspan(late, end, color=FAINT, alpha=0.25, linewidth=0)
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderpad=0.0, borderaxespad=0.3)
    shown[0].set_title("enlarged: the shaded end of the run", loc="right")
    figure.align_ylabels()
    write_margins(figure, ds, growth_text(hole), band_text(*figure.axes))
    return figure


def _last_blows(hole: Run) -> float:
    """Return a time [s] shortly before the last two blows, or, with too few blows, before the last fifth of the run."""
    begun = blow_times(hole)
    if begun.size <= _ENLARGED_BLOWS + 1:
        return float(hole.time[-1] - 0.2 * np.ptp(hole.time))
    between = float(np.median(np.diff(begun)))
    begun = begun[begun < hole.time[-1] - 0.5 * between]  # a blow cut short by the end of the run does not count
    return float(begun[-_ENLARGED_BLOWS] - _LEAD * between)


@styled
def response(ds: xr.Dataset) -> Figure:
    """Draw the amplitudes of the bit and the hole's depth against the frequency of a swept sine.

    There is one point per complete cycle of the force. Frequencies at which the rock slips are shaded (source, Figs 6.4
    to 6.7).

    **Raises:** `InputError` if the dataset holds no trajectory under a swept sine, or too few cycles.
    """
    hole = read_run(ds, "x3", "x4")
    if not Contents(ds).swept_sine:
        raise InputError("no response to draw: the force is not a swept sine (pulse_shape, sweep_rate)")
    start, rate = hole.parameters.get("sweep_start", 0.0), hole.parameters["sweep_rate"]
    phase = np.abs(start * hole.time + rate * hole.time**2 / 2)
    turn = np.concatenate([[0], 1 + np.flatnonzero(np.diff(np.floor(phase)) != 0)])
    if turn.size <= _FEWEST_CYCLES:
        raise InputError(f"no response to draw: {max(turn.size - 1, 0)} whole cycles; simulate longer")

    def half_swing(values: Samples) -> Float[np.ndarray, " cycles"]:
        whole = values[: turn[-1]]
        return (np.maximum.reduceat(whole, turn[:-1]) - np.minimum.reduceat(whole, turn[:-1])) / 2

    frequency = np.abs(start + rate * (hole.time[turn[:-1]] + hole.time[turn[1:]]) / 2)
    depth = hole["x4"][turn]
    # Frequency ranges in which the rock slips in every cycle; they end halfway between cycles.
    slips = np.diff(depth) > _LEAST_SLIP
    changes = np.flatnonzero(np.diff(np.concatenate([[False], slips, [False]]).astype(int)))
    ends = np.concatenate([frequency[:1], (frequency[1:] + frequency[:-1]) / 2, frequency[-1:]])
    figure = new_figure(7.6, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    quantities = (
        (half_swing(hole["x3"] - hole["x4"]), "length", BIT, 1.1, "amplitude of\nx₃ − x₄"),
        (half_swing(hole["v3"]), "speed", INK, 1.1, "amplitude of\nx₃′"),
        (depth[1:], "length", ROCK, 2.0, "depth of the hole\nx₄"),
    )
    marker = Mark(marker="o", markersize=2.0) if frequency.size < _MANY_CYCLES else Mark()
    spans = []
    for axes, (values, quantity, colour, width, label) in zip(panels, quantities, strict=True):
        axes.grid(True)
        spans = [
            axes.axvspan(ends[begin], ends[stop], color=FAINT, alpha=0.25, linewidth=0, label="the rock slips")
            for begin, stop in changes.reshape(-1, 2)
        ]
        factor, unit = _scale(quantity, values)
        axes.plot(frequency, factor * values, color=colour, linewidth=width, clip_on=False, **marker)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(f"{label} [{unit}]")
    panels[2].set_xlabel("frequency of the force [Hz]")
    panels[0].set_xlim(float(frequency.min()), float(frequency.max()))
    if spans:
        panels[0].legend(handles=spans[:1], loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0)
    figure.align_ylabels()
    write_margins(figure, ds, growth_text(hole))
    return figure
