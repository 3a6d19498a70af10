"""The bit on rock under a given force: the hole's steps under pulses, and the response to a swept sine."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from vibrojax.analyses.trajectory.motion import Hole, Samples, read_hole
from vibrojax.errors import InputError
from vibrojax.io.attributes import parameters_of
from vibrojax.plot.axes import number, point_text
from vibrojax.plot.contents import contents
from vibrojax.plot.envelope import band_text, draw_over_time
from vibrojax.plot.margins import write_margins
from vibrojax.plot.style import BIT, DASHED, FAINT, INK, ROCK, Mark, new_figure, styled

_UNITS = (("mm", 1e3, 2e-4), ("µm", 1e6, 0.0))  # from which swing [m]
_ENLARGED = 2  # blows
_LEAD = 0.08  # of the time between blows, shown before the first of them
_LEAST_CYCLES = 4
_LEAST_SLIP = 1e-12  # [m] in one cycle: rounding

OfCycles = Float[np.ndarray, " cycles"]


def draw_hole(axes: Axes, hole: Hole, start: float, end: float) -> None:
    """Draw the bit's displacement x3 and the hole's depth x4 from `start` to `end` [s]."""
    late = hole.between(start, end)
    factor, unit = _length_scale([hole.x3[late], hole.x4[late]])
    axes.grid(True)
    # The hole below: where the bit presses on its bottom, both are seen.
    draw_over_time(axes, hole.time[late], factor * hole.x4[late], ROCK, 2.4, "hole x₄")
    draw_over_time(axes, hole.time[late], factor * hole.x3[late], BIT, 0.9, "bit x₃")
    axes.set_ylabel(f"depth\n[{unit}]")


def _draw_forces(axes: Axes, hole: Hole, start: float, end: float) -> None:
    """Draw the given force, the rock's resistance and its threshold from `start` to `end` [s], where there are any."""
    late = hole.between(start, end)
    shown = [force for force in (hole.applied_force, hole.rock_force) if force is not None]
    factor, unit = force_scale(shown)
    axes.grid(True)
    if hole.threshold is not None:
        name = f"threshold D = {number(factor * hole.threshold)} {unit}"
        axes.axhline(factor * hole.threshold, color=ROCK, linewidth=1.0, linestyle=DASHED, label=name)
    for force, colour, name in ((hole.applied_force, FAINT, "given I"), (hole.rock_force, INK, "rock N")):
        if force is not None:
            draw_over_time(axes, hole.time[late], factor * force[late], colour, 1.0, name)
    axes.set_ylabel(f"force\n[{unit}]")


def growth_text(hole: Hole) -> str:
    """How much the hole grew over the run, in words."""
    depth, duration = 1e3 * hole.growth, float(np.ptp(hole.time))
    return (
        f"The hole grows by {number(float(f'{depth:.3g}'))} mm in {number(duration)} s"
        if depth > 0
        else "No penetration"
    )


def _length_scale(lengths: Sequence[Float[np.ndarray, "*shape"]]) -> tuple[float, str]:
    """The factor and the unit in which `lengths` [m] read well."""
    greatest = max((float(np.abs(one).max(initial=0.0)) for one in lengths), default=0.0)
    unit, factor, _ = next((known for known in _UNITS if greatest >= known[2] or greatest == 0.0), _UNITS[-1])
    return factor, unit


def force_scale(forces: Sequence[Samples]) -> tuple[float, str]:
    """The factor and the unit in which `forces` [N] read well."""
    return (1e-3, "kN") if max(np.abs(force).max() for force in forces) >= 1e4 else (1.0, "N")


# Pulses.


@styled
def pulses(ds: xr.Dataset, last: float | None = None) -> Figure:
    """Bit and hole above the forces on the bit: the whole run, and beside it its end enlarged.

    **Arguments:**

    - `ds`: what `simulate` gives for the penetration scene: `x3`, `x4` [m] along `time` [s]; `applied_force` and
      `rock_force` [N] where there are any.
    - `last`: how much of the end to enlarge [s]; left out: the last two blows.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where the dataset holds no such trajectory.
    """
    hole = read_hole(ds)
    first, end = float(hole.time[0]), float(hole.time[-1])
    late = _last_blows(hole) if last is None else max(end - last, first)
    forces = hole.applied_force is not None or hole.rock_force is not None
    figure = new_figure(10.0, 5.4 if forces else 3.4)
    grid = GridSpec(1 + forces, 2, figure, width_ratios=[1.25, 1.0], height_ratios=[1.3, 1.0][: 1 + forces])
    for column, start in enumerate((first, late)):
        shown: list[Axes] = [figure.add_subplot(grid[0, column])]
        draw_hole(shown[0], hole, start, end)
        if forces:
            shown.append(figure.add_subplot(grid[1, column], sharex=shown[0]))
            _draw_forces(shown[1], hole, start, end)
            shown[0].tick_params(labelbottom=False)
        shown[0].set_xlim(start, end)
        shown[-1].set_xlabel("time [s]")
        for axes in shown:
            if column == 0:
                axes.axvspan(late, end, color=FAINT, alpha=0.25, linewidth=0)
                axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderpad=0.0, borderaxespad=0.3)
    shown[0].set_title("enlarged: the shaded end of the run", loc="right")
    figure.align_ylabels()
    title = str(ds.attrs.get("title") or ds.attrs.get("scene", ""))
    write_margins(figure, title, point_text(ds), growth_text(hole), band_text(*figure.axes))
    return figure


def _last_blows(hole: Hole) -> float:
    """When the last two blows begin, a little before [s]; the last fifth where there are no more than these."""
    begun = hole.blows
    if begun.size <= _ENLARGED + 1:
        return float(hole.time[-1] - 0.2 * np.ptp(hole.time))
    between = float(np.median(np.diff(begun)))
    begun = begun[begun < hole.time[-1] - 0.5 * between]  # one cut short by the end of the run does not count
    return float(begun[-_ENLARGED] - _LEAD * between)


# A swept sine.


@dataclass(frozen=True)
class _Cycles:
    """What happened in each whole cycle of the force: mean frequency [Hz], half swings [m, m/s], slip and depth [m]."""

    frequency: OfCycles
    displacement: OfCycles
    velocity: OfCycles
    slip: OfCycles
    depth: OfCycles


@styled
def response(ds: xr.Dataset) -> Figure:
    """Amplitude of the bit's displacement and velocity, and the hole's depth, against the frequency of a swept sine.

    A point for each whole cycle of the force; where the rock slips is shaded (Figs 6.4 to 6.7).

    **Arguments:**

    - `ds`: what `simulate` gives for the penetration scene with `pulse_shape = "sweep"`: `x3`, `x4` [m], `v3` [m/s]
      along `time` [s]; the sweep in the attribute `parameters`.

    **Returns:** a figure that pyplot knows nothing of.

    **Raises:** `InputError` where the dataset holds no such trajectory, or hardly a cycle.
    """
    hole = read_hole(ds)
    cycles = _read_cycles(ds, hole)
    figure = new_figure(7.6, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    factor, unit = _length_scale([cycles.displacement])
    _draw_cycles(panels[0], cycles, factor * cycles.displacement, BIT, f"amplitude of\nx₃ − x₄ [{unit}]")
    speed, per = (1e3, "mm/s") if cycles.velocity.max() < 1.0 else (1.0, "m/s")
    _draw_cycles(panels[1], cycles, speed * cycles.velocity, INK, f"amplitude of\nx₃′ [{per}]")
    factor, unit = _length_scale([cycles.depth])
    _draw_cycles(panels[2], cycles, factor * cycles.depth, ROCK, f"depth of the hole\nx₄ [{unit}]")
    panels[2].lines[-1].set_linewidth(2.0)
    panels[2].set_xlabel("frequency of the force [Hz]")
    panels[0].set_xlim(float(cycles.frequency.min()), float(cycles.frequency.max()))
    spans = [patch for patch in panels[0].patches if patch.get_label() == "the rock slips"]
    if spans:
        panels[0].legend(handles=spans[:1], loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0)
    figure.align_ylabels()
    write_margins(figure, str(ds.attrs.get("title") or ds.attrs.get("scene", "")), point_text(ds), growth_text(hole))
    return figure


def _read_cycles(ds: xr.Dataset, hole: Hole) -> _Cycles:
    """The whole cycles of the force; raises `InputError` where there are hardly any, or none are known."""
    given = parameters_of(ds)
    if not contents(ds).swept_sine:
        raise InputError("no response to draw: the force is no swept sine (pulse_shape, sweep_rate)")
    start, rate = given.get("sweep_start", 0.0), given["sweep_rate"]
    phase = np.abs(start * hole.time + rate * hole.time**2 / 2)
    turn = np.concatenate([[0], 1 + np.flatnonzero(np.diff(np.floor(phase)) != 0)])
    if turn.size <= _LEAST_CYCLES:
        raise InputError(f"no response to draw: {max(turn.size - 1, 0)} whole cycles; simulate longer")
    compression = hole.x3 - hole.x4
    middle = (hole.time[turn[:-1]] + hole.time[turn[1:]]) / 2
    depth = hole.x4[turn]
    return _Cycles(
        frequency=np.abs(start + rate * middle),
        displacement=_half_swing(compression, turn),
        velocity=_half_swing(hole.v3, turn),
        slip=np.diff(depth),
        depth=depth[1:],
    )


def _half_swing(values: Samples, turn: Int[np.ndarray, " turns"]) -> Float[np.ndarray, " turns-1"]:
    whole = values[: turn[-1]]
    return (np.maximum.reduceat(whole, turn[:-1]) - np.minimum.reduceat(whole, turn[:-1])) / 2


def _draw_cycles(axes: Axes, cycles: _Cycles, values: OfCycles, colour: str, label: str) -> None:
    axes.grid(True)
    for left, right in _slipping(cycles):
        axes.axvspan(left, right, color=FAINT, alpha=0.25, linewidth=0, label="the rock slips")
    marker = Mark(marker="o", markersize=2.0) if values.size < 120 else Mark()
    axes.plot(cycles.frequency, values, color=colour, linewidth=1.1, **marker)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(label)


def _slipping(cycles: _Cycles) -> list[tuple[float, float]]:
    """The ranges of frequency over which the rock slips in every cycle."""
    slips = cycles.slip > _LEAST_SLIP
    change = np.flatnonzero(np.diff(np.concatenate([[False], slips, [False]]).astype(int)))
    middle = (cycles.frequency[1:] + cycles.frequency[:-1]) / 2
    ends = np.concatenate([cycles.frequency[:1], middle, cycles.frequency[-1:]])
    return [(float(ends[left]), float(ends[right])) for left, right in change.reshape(-1, 2)]
