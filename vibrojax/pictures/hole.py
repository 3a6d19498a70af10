"""Pictures of a bit on rock under an applied force: its blows, and the response to a swept sine."""

from dataclasses import replace

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.io.runs import Run, Samples, read_run
from vibrojax.pictures.axes import margins
from vibrojax.pictures.contents import Contents
from vibrojax.pictures.motion import (
    FIGURE_WIDTH,
    enlarged,
    force_plot,
    growth_text,
    hole_plot,
    printed_unit,
    run_notes,
    span,
    time_axis,
)
from vibrojax.pictures.plots import INK, Axis, Layer, Line, Plot, Sheet
from vibrojax.pictures.style import BIT, ROCK

_ENLARGED_BLOWS = 2
_BLOWS_BEFORE, _MANY_BLOWS = 8, 40  # drawn before the last two, of a run with more
_BLOW_LEAD = 0.08  # fraction of the time between blows that is shown before the first enlarged blow
_FEWEST_CYCLES = 4
_LEAST_SLIP = 1e-12  # [m] in one cycle: less is rounding error
_MANY_CYCLES = 120  # number of cycles from which curves have no markers


def pulses(ds: xr.Dataset) -> Sheet:
    """Draw bit and hole above the forces on the bit: the run at the left, its last two blows at the right.

    Of a run of many blows, the left has the last few, below the depth of the hole over the whole run.

    **Raises:** `InputError` if the dataset holds no trajectory of bit and hole.
    """
    hole = read_run(ds, "x3", "x4")
    begin, end, late, between = float(hole.time[0]), float(hole.time[-1]), *_last_blows(hole)
    names = [name for name in ("applied_force", "rock_force") if name in hole.series]
    threshold = hole.parameters.get("threshold")
    plots: list[Plot] = []
    shown = max(begin, late - _BLOWS_BEFORE * between) if late - begin > _MANY_BLOWS * between else begin
    top = int(shown > begin)  # rows above
    if top:
        factor, unit = printed_unit("m", hole["x4"])
        layers: list[Layer] = [span(shown, end, 0.5), Line(hole.time, factor * hole["x4"], ROCK, 2.4)]
        across = time_axis(begin, end, "")
        plots.append(Plot(layers, across, Axis(f"whole run\n[{unit}]"), place=(0, 0, 1, 2)))
    for column, start in enumerate((shown, late)):
        rows = [hole_plot(hole, start, end, f"time{start}")]
        if names:
            across = time_axis(start, end, f"time{start}")
            rows.append(force_plot(hole.between(start, end), names, across, threshold, 0.5))
        for row, plot in enumerate(rows, top):
            if column:
                plots.append(enlarged(plot, "" if row > top else "enlarged: the shaded end", place=(row, 1)))
            else:
                layers = [span(late, end, 0.25), *plot.layers]
                plots.append(replace(plot, layers=layers, keys="above left", place=(row, 0)))
    plots.sort(key=lambda plot: plot.place)
    about = run_notes(ds, plots, growth_text(hole))
    heights = (*[0.5] * top, 1.3, 1.0)[: top + len(rows)]
    size = FIGURE_WIDTH, (5.4 if names else 3.4) + 1.4 * top
    return Sheet(plots, size, (1.25, 1.0), heights, **about)


def _last_blows(hole: Run) -> tuple[float, float]:
    """Return a time [s] shortly before the last two blows, and the time between blows.

    With too few blows, they are the time before the last fifth of the run, and infinity. A blow begins where the
    applied, or else the rock's, force rises through the middle of its range.
    """
    force = hole.series.get("applied_force", hole.series.get("rock_force", np.zeros(hole.time.size)))
    above = force > (force.max() + force.min()) / 2
    begun = hole.time[1:][above[1:] & ~above[:-1]]
    if begun.size <= _ENLARGED_BLOWS + 1:
        return float(hole.time[-1] - 0.2 * np.ptp(hole.time)), np.inf
    between = float(np.median(np.diff(begun)))
    begun = begun[begun < hole.time[-1] - 0.5 * between]  # a blow cut short by the end of the run does not count
    return float(begun[-_ENLARGED_BLOWS] - _BLOW_LEAD * between), between


def response(ds: xr.Dataset) -> Sheet:
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
    changes = np.flatnonzero(np.diff(slips.astype(int), prepend=0, append=0))
    ends = np.concatenate([frequency[:1], (frequency[1:] + frequency[:-1]) / 2, frequency[-1:]])
    quantities = (
        (half_swing(hole["x3"] - hole["x4"]), "m", BIT, 1.1, "amplitude of\nx₃−x₄"),
        (half_swing(hole["v3"]), "m s-1", INK, 1.1, "amplitude of\nx₃′"),
        (depth[1:], "m", ROCK, 2.0, "depth of the hole\nx₄"),
    )
    marker = "o" if frequency.size < _MANY_CYCLES else ""
    across = Axis("frequency of the force [Hz]", limits=(frequency.min(), frequency.max()), group="frequency")
    plots = []
    for row, (values, quantity, colour, width, label) in enumerate(quantities):
        factor, unit = printed_unit(quantity, values)
        name = "" if row else "the rock slips"
        spans = [span(ends[begin], ends[stop], 0.25, name) for begin, stop in changes.reshape(-1, 2)]
        line = Line(frequency, factor * values, colour, width, marker=marker, size=2.0, clip=False)
        up, keys = Axis(f"{label} [{unit}]", limits=(0.0, None)), "" if row else "above right"
        plots.append(Plot([*spans, line], across, up, place=(row, 0), keys=keys))
    return Sheet(plots, (7.6, 6.2), **margins(ds, growth_text(hole)))
