"""The response to a swept sine: amplitudes of the bit against the frequency of the force, with the slip of the rock."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vibrojax.errors import InputError
from vibrojax.plot._about import parameters_of, point_text
from vibrojax.plot._blows import Blows, read_blows
from vibrojax.plot._hole import growth_text, length_scale
from vibrojax.plot._sheet import write_margins
from vibrojax.plot._style import BIT, FAINT, INK, ROCK, new_figure, styled

_LEAST_CYCLES = 4
_LEAST_SLIP = 1e-12  # [m] in one cycle: rounding


@dataclass(frozen=True)
class Cycles:
    """What happened in each whole cycle of the force: mean frequency [Hz], half swings [m, m/s], slip and depth [m]."""

    frequency: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    slip: np.ndarray
    depth: np.ndarray


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
    blows = read_blows(ds)
    cycles = read_cycles(ds, blows)
    figure = new_figure(7.6, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    factor, unit = length_scale([cycles.displacement])
    _draw(panels[0], cycles, factor * cycles.displacement, BIT, f"amplitude of\nx₃ − x₄ [{unit}]")
    speed, per = (1e3, "mm/s") if cycles.velocity.max() < 1.0 else (1.0, "m/s")
    _draw(panels[1], cycles, speed * cycles.velocity, INK, f"amplitude of\nx₃′ [{per}]")
    factor, unit = length_scale([cycles.depth])
    _draw(panels[2], cycles, factor * cycles.depth, ROCK, f"depth of the hole\nx₄ [{unit}]")
    panels[2].lines[-1].set_linewidth(2.0)
    panels[2].set_xlabel("frequency of the force [Hz]")
    panels[0].set_xlim(float(cycles.frequency.min()), float(cycles.frequency.max()))
    spans = [patch for patch in panels[0].patches if patch.get_label() == "the rock slips"]
    if spans:
        panels[0].legend(handles=spans[:1], loc="lower right", bbox_to_anchor=(1.0, 1.0), borderpad=0.0)
    figure.align_ylabels()
    write_margins(figure, str(ds.attrs.get("title") or ds.attrs.get("scene", "")), point_text(ds), growth_text(blows))
    return figure


def is_swept(ds: xr.Dataset) -> bool:
    """Whether the force in `ds` is a sine of a frequency that changes."""
    rate = parameters_of(ds).get("sweep_rate", 0.0)
    return ds.attrs.get("pulse_shape") == "sweep" and rate != 0.0


def read_cycles(ds: xr.Dataset, blows: Blows) -> Cycles:
    """The whole cycles of the force; raises `InputError` where there are hardly any, or none are known."""
    given = parameters_of(ds)
    if not is_swept(ds):
        raise InputError("no response to draw: the force is no swept sine (pulse_shape, sweep_rate)")
    start, rate = given.get("sweep_start", 0.0), given["sweep_rate"]
    phase = np.abs(start * blows.time + rate * blows.time**2 / 2)
    turn = np.concatenate([[0], 1 + np.flatnonzero(np.diff(np.floor(phase)) != 0)])
    if turn.size <= _LEAST_CYCLES:
        raise InputError(f"no response to draw: {max(turn.size - 1, 0)} whole cycles; simulate longer")
    compression = blows.x3 - blows.x4
    middle = (blows.time[turn[:-1]] + blows.time[turn[1:]]) / 2
    depth = blows.x4[turn]
    swings = (_half_swing(values, turn) for values in (compression, blows.v3))
    return Cycles(np.abs(start + rate * middle), *swings, np.diff(depth), depth[1:])


def _half_swing(values: np.ndarray, turn: np.ndarray) -> np.ndarray:
    whole = values[: turn[-1]]
    high, low = (take.reduceat(whole, turn[:-1]) for take in (np.maximum, np.minimum))
    return (high - low) / 2


def _draw(axes: Axes, cycles: Cycles, values: np.ndarray, colour: str, label: str) -> None:
    axes.grid(True)
    for left, right in _runs(cycles):
        axes.axvspan(left, right, color=FAINT, alpha=0.25, linewidth=0, label="the rock slips")
    marker = {"marker": "o", "markersize": 2.0} if values.size < 120 else {}
    axes.plot(cycles.frequency, values, color=colour, linewidth=1.1, **marker)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(label)


def _runs(cycles: Cycles) -> list[tuple[float, float]]:
    """The ranges of frequency over which the rock slips in every cycle."""
    slips = cycles.slip > _LEAST_SLIP
    change = np.flatnonzero(np.diff(np.concatenate([[False], slips, [False]]).astype(int)))
    middle = (cycles.frequency[1:] + cycles.frequency[:-1]) / 2
    ends = np.concatenate([cycles.frequency[:1], middle, cycles.frequency[-1:]])
    return [(float(ends[left]), float(ends[right])) for left, right in change.reshape(-1, 2)]
