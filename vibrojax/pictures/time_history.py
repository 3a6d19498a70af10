"""Pictures of trajectories: time histories, phase portraits, spectrum, growth of the hole, response to a swept sine.

Oscillations that are too dense for a line are drawn as bands.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError
from vibrojax.pictures.axes import axis, margins, number
from vibrojax.pictures.contents import TIME, Contents
from vibrojax.pictures.motion import (
    Peak,
    Run,
    Samples,
    amplitude_spectrum,
    blow_times,
    last_impact,
    peaks,
    read_run,
    separate_peaks,
)
from vibrojax.pictures.plots import (
    FAINT,
    INK,
    Area,
    Axis,
    Layer,
    Line,
    Look,
    Plot,
    Sheet,
    Text,
    dots,
    level,
    upright,
)
from vibrojax.pictures.style import BIT, DASHED, IMPACT, ROCK, SAVED_DPI, STICK, STRIKER

WIDTH = 10.0  # of the figures [inch]
_PANEL_SHARE = 0.775  # of the width of the figure
_CYCLE_PIXELS = 5.0  # least width of a cycle that a line resolves
_COLUMN_PIXELS = 8  # a band takes minimum and maximum over this width: more than an unresolved cycle
_WINDOW = 1.5  # duration of the end of the run that is shown [s]
_OVERVIEW_FROM = 1.5  # ratio of the run's length to the window from which there is an overview
_SPECTRUM_SPAN = 5.0  # in units of the bit's dominant frequency
_SPECTRUM_AT_REST = 25.0  # span [Hz] if nothing moves
_LEAST_AMPLITUDE = 1e-6  # [mm]: less is rounding error
_DOTS: Look = {"size": 4.0, "colour": IMPACT, "order": 4.0, "clip": False}
_MOST_STATES = 6  # of a system; more would not be legible on one page
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


def trace(time: Samples, values: Samples, share: float = 1.0, **look: Any) -> Line | Area:
    """Return values over time as a line, or as a band from minimum to maximum if a line would cover the panel.

    `share`: width of the panel, as a fraction of the figure's panels.
    """
    pixels = max(int(share * _PANEL_SHARE * WIDTH * SAVED_DPI), 1)
    height = float(np.ptp(values)) if values.size else 0.0
    # Number of cycles: the total variation over twice the height. Are the cycles too narrow for a line?
    if not (height > 0 and float(np.abs(np.diff(values)).sum()) / (2.0 * height) > pixels / _CYCLE_PIXELS):
        return Line(time, values, **look)
    count = max(pixels // _COLUMN_PIXELS, 1)
    column = np.minimum(np.floor((time - time[0]) / np.ptp(time) * count), count - 1)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    least, greatest = (reduce.reduceat(values, first) for reduce in (np.minimum, np.maximum))
    ends = np.append(time[first], time[-1])  # the last column ends here
    colour, label, order = look["colour"], look.get("label", ""), look.get("order", 2.0)
    low, high = np.append(least, least[-1]), np.append(greatest, greatest[-1])
    return Area(ends, low, high, colour, 0.3, edge=colour, step=True, label=label, order=order)


def band_text(plots: Sequence[Plot]) -> str:
    """Return the note on bands, or "" if no plot has a band."""
    if not any(isinstance(layer, Area) and layer.step for plot in plots for layer in plot.layers):
        return ""
    return "Bands: from the least to the greatest value, where the oscillations are too many to be told apart"


def _time(start: float, end: float, group: str = "time", **about: Any) -> Axis:
    return Axis("time [s]", TIME, (start, end), group=group, **about)


def _span(start: float, end: float, alpha: float) -> Area:
    return Area([start, end], [-np.inf] * 2, [np.inf] * 2, FAINT, alpha)


def _unlabelled(plot: Plot) -> list[Layer]:
    return [replace(layer, label="") if isinstance(layer, Line | Area) else layer for layer in plot.layers]


# Bit, striker and rock.


def trajectory(ds: xr.Dataset) -> Sheet:
    """Draw the time history, phase portraits and spectrum of one run.

    Displacements, velocities and forces are drawn over the last 1.5 s, below an overview of the whole run.
    Sticking and impacts are marked. The transient is faint in the phase portraits of bit and striker. The amplitude
    spectrum is computed from the run's second half. In scenes with rock, bit and hole are drawn over the same time, and
    enlarged at the last impact.

    **Raises:** `InputError` if the dataset holds no trajectory.
    """
    motion = read_run(ds, "x1", "v1", "x2", "v2")
    hole = read_run(ds, "x3", "x4") if Contents(ds).hole else None
    start, end = max(float(motion.time[-1]) - _WINDOW, float(motion.time[0])), float(motion.time[-1])
    near = hole and last_impact(hole, motion.impacts[(motion.impacts >= start) & (motion.impacts < end)])
    rows: list[tuple[list[Plot], float]] = []
    if float(np.ptp(motion.time)) > _OVERVIEW_FROM * _WINDOW:
        traces = [
            trace(motion.time, 1e3 * motion[name], colour=colour, width=0.4)
            for name, colour in (("x1", BIT), ("x2", STRIKER))
        ]
        whole = Plot(
            [*traces, _span(start, end, 0.3)], _time(motion.time[0], end, ""), Axis("whole run\n[mm]"), grid=""
        )
        rows.append(([whole], 0.65))
    displacements = _both(motion, start, 1e3 * motion["x1"], 1e3 * motion["x2"], named=True)
    up = Axis("displacement\n[mm]")
    rows.append(([Plot(displacements, _time(start, end), up, keys="above", key_columns=5)], 1.25))
    speeds = [level(0.0, colour=FAINT, width=0.7), *_both(motion, start, motion["u"], motion["v2"])]
    names = "u and x₂′\n[m/s]" if "v" in motion.parameters else "x₁′ and x₂′\n[m/s]"
    rows.append(([Plot(speeds, _time(start, end), Axis(names))], 1.25))
    if motion.has("impact_force", "friction_force"):
        forces = _force_plot(motion, motion.since(start), ("impact_force", "friction_force"), _time(start, end))
        rows.append(([replace(forces, keys="above right", key_columns=2)], 0.9))
    if hole:
        depths = _hole_plot(hole, start, end, "hole")
        shaded = [_span(*near, 0.4)] if near else []
        row = [replace(depths, layers=[*shaded, *depths.layers], keys="above left", key_columns=2)]
        if near:
            enlarged = _hole_plot(hole, *near, "impact")
            remark = "enlarged: the shaded impact"
            layers = _unlabelled(enlarged)
            row.append(replace(enlarged, layers=layers, x=replace(enlarged.x, intervals=4), remark=remark))
        rows.append((row, 1.3))
    speed = "sliding speed u = x₁′ + v [m/s]" if "v" in motion.parameters else "velocity x₁′ [m/s]"
    portraits = [
        _portrait(motion, "x1", motion["u"], start, speed),
        _portrait(motion, "x2", motion["v2"], start, "velocity x₂′ [m/s]"),
    ]
    rows.append(([*portraits, _spectrum(motion)], 2.7))
    heights = [height for _, height in rows]
    plots = []
    for k, (row, _) in enumerate(rows):
        begins, wide = {1: ((0,), (3,)), 2: ((0, 2), (2, 1)), 3: ((0, 1, 2), (1, 1, 1))}[len(row)]
        plots += [replace(plot, place=(k, i, 1, n)) for plot, i, n in zip(row, begins, wide, strict=True)]
    about = margins(ds, _growth_text(hole) if hole else "", band_text(plots))
    return Sheet(plots, (WIDTH, sum(heights) + 0.33 * len(heights) + 1.2), (1.0,) * 3, heights, **about)


def _contact(motion: Run) -> float | None:
    """Return the place [mm] of the contact between striker and bit, or None for a scene without impacts."""
    return 1e3 * motion.parameters["delta"] if motion.has("impact_force") and "delta" in motion.parameters else None


def _both(motion: Run, start: float, of_bit: Samples, of_striker: Samples, named: bool = False) -> list[Layer]:
    """Draw a quantity of striker and bit over time; mark sticking and impacts on lines, but not on bands."""
    late, times = motion.since(start), motion.impacts[motion.impacts >= start]
    names = ("bit", "striker", "bit sticks", "impact begins") if named else ("",) * 4
    bit = trace(motion.time[late], of_bit[late], colour=BIT, width=1.1, label=names[0], order=2.1)
    striker = trace(motion.time[late], of_striker[late], colour=STRIKER, width=1.1, label=names[1])
    layers: list[Layer] = [bit, striker]
    if isinstance(bit, Line) and motion["stuck"][late].any():
        stuck = np.where(motion["stuck"] == 1, of_bit, np.nan)[late]
        layers.append(Line(motion.time[late], stuck, STICK, 2.6, label=names[2], order=2.2))
    if isinstance(striker, Line) and times.size:
        layers.append(dots(times, np.interp(times, motion.time, of_striker), label=names[3], **_DOTS))
    gap = _contact(motion)
    if named and gap is not None:
        layers.append(level(gap, colour=FAINT, width=0.8, dash=DASHED, label=f"gap Δ = {number(gap)} mm", order=1.5))
    return layers


def _portrait(motion: Run, x: str, speed: Samples, start: float, speed_label: str) -> Plot:
    """Draw the phase portrait of bit (`x` is x1) or striker (x2), with impacts as dots.

    The transient is faint, the motion after time `start` [s] strong. Sticking is a thick line on the bit's portrait,
    the contact a vertical line on the striker's.
    """
    name, symbol, colour = ("bit", "x₁", BIT) if x == "x1" else ("striker", "x₂", STRIKER)
    late, displacement = motion.since(start), 1e3 * motion[x]
    before = slice(None, late.start + 1)
    layers: list[Layer] = [level(0.0, colour=FAINT, width=0.6, order=1.5)]
    gap = _contact(motion)
    if x == "x2" and gap is not None:
        layers.append(upright(gap, colour=FAINT, width=0.8, dash=DASHED, order=1.5))
    layers.append(Line(displacement[before], speed[before], FAINT, 0.4, alpha=0.6))
    layers.append(Line(displacement[late], speed[late], colour, 1.1))
    if x == "x1":
        stuck = np.where(motion["stuck"] == 1, speed, np.nan)
        layers.append(Line(displacement[late], stuck[late], STICK, 2.8, order=3.0))
    times = motion.impacts[motion.impacts >= start]
    places = (np.interp(times, motion.time, values) for values in (displacement, speed))
    layers.append(dots(*places, **_DOTS))
    return Plot(layers, Axis(f"{symbol} [mm]"), Axis(speed_label), name, title_colour=colour, grid="")


def _spectrum(motion: Run) -> Plot:
    """Draw the amplitude spectra of both displacements, and label the peaks with their frequencies."""
    named: list[Peak] = []
    layers: list[Layer] = []
    end, width, top = 0.0, 0.0, _LEAST_AMPLITUDE
    for name, x, colour in (("bit x₁", "x1", BIT), ("striker x₂", "x2", STRIKER)):
        frequencies, amplitudes = amplitude_spectrum(motion.time, 1e3 * motion[x])
        highest = peaks(frequencies, amplitudes) if amplitudes.max() > _LEAST_AMPLITUDE else []
        end = end or (_SPECTRUM_SPAN * highest[0][0] if highest else 0.0)
        width = 4.0 * float(frequencies[1])
        top = max(top, float(amplitudes.max()))
        layers.append(Line(frequencies, amplitudes, colour, 1.0, label=name))
        # Where both lines have a peak, the higher line hides the lower line, but not the marker at its top.
        layers.append(dots(*(tuple(zip(*highest, strict=True)) or ((), ())), colour=colour, size=3.2, order=4.0))
        named += highest
    end = end or _SPECTRUM_AT_REST
    places, heights = np.reshape(named, (-1, 2)).T
    for index in separate_peaks(places, heights, width):
        frequency, amplitude = named[index]
        if frequency < end:
            text = f"{number(round(frequency, 2))} Hz"
            layers.append(
                Text(frequency, amplitude, text, "left", "bottom", INK, 8.0, halo=1.0, offset=(4.0, 2.0), order=5.0)
            )
    up = Axis("amplitude [mm]", limits=(0.0, 1.12 * top))  # room for the text at the highest peak
    title = "spectrum, second half of the run"
    return Plot(layers, Axis("frequency [Hz]", limits=(0.0, end)), up, title, keys="upper right")


def _hole_plot(hole: Run, start: float, end: float, group: str, share: float = 2 / 3) -> Plot:
    """Draw the bit's displacement x3 and the hole's depth x4 from `start` to `end` [s]."""
    late = hole.between(start, end)
    factor, unit = _scale("length", hole["x3"][late], hole["x4"][late])
    # The wider line of the hole is drawn first, so that both are visible where the bit presses on the hole's bottom.
    layers = [
        trace(hole.time[late], factor * hole["x4"][late], share, colour=ROCK, width=2.4, label="hole x₄"),
        trace(hole.time[late], factor * hole["x3"][late], share, colour=BIT, width=0.9, label="bit x₃"),
    ]
    return Plot(layers, _time(start, end, group), Axis(f"depth\n[{unit}]"))


def _force_plot(
    run: Run, late: slice, names: Sequence[str], across: Axis, threshold: float | None = None, share: float = 1.0
) -> Plot:
    """Draw the forces `names` that the run has over the samples `late`, and the rock's threshold [N]."""
    forces = {name: run[name] for name in names if run.has(name)}
    factor, unit = _scale("force", *forces.values())
    layers: list[Layer] = []
    if threshold is not None:
        text = f"threshold D = {number(factor * threshold)} {unit}"
        layers.append(level(factor * threshold, colour=ROCK, width=1.0, dash=DASHED, label=text))
    for name, force in forces.items():
        colour, width, label = _FORCES[name]
        layers.append(trace(run.time[late], factor * force[late], share, colour=colour, width=width, label=label))
    return Plot(layers, across, Axis(f"force\n[{unit}]"))


def _growth_text(hole: Run) -> str:
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


# The bit on rock under an applied force.


def pulses(ds: xr.Dataset) -> Sheet:
    """Draw bit and hole above the forces on the bit: the whole run at the left, its last two blows at the right.

    **Raises:** `InputError` if the dataset holds no trajectory of bit and hole.
    """
    hole = read_run(ds, "x3", "x4")
    first, end = float(hole.time[0]), float(hole.time[-1])
    late = _last_blows(hole)
    forces = hole.has("applied_force", "rock_force")
    plots = []
    for column, start in enumerate((first, late)):
        share = 0.5
        shown = [_hole_plot(hole, start, end, f"time{column}", share)]
        if forces:
            part, names = hole.between(start, end), ("applied_force", "rock_force")
            threshold = hole.parameters.get("threshold")
            shown.append(_force_plot(hole, part, names, _time(start, end, f"time{column}"), threshold, share))
        for row, plot in enumerate(shown):
            if column:
                layers = _unlabelled(plot)
                plot = replace(plot, layers=layers, remark="" if row else "enlarged: the shaded end of the run")
            else:
                plot = replace(plot, layers=[_span(late, end, 0.25), *plot.layers], keys="above left", key_columns=3)
            plots.append(replace(plot, place=(row, column)))
    plots.sort(key=lambda plot: plot.place)
    about = margins(ds, _growth_text(hole), band_text(plots))
    return Sheet(plots, (WIDTH, 5.4 if forces else 3.4), (1.25, 1.0), (1.3, 1.0)[: 1 + forces], **about)


def _last_blows(hole: Run) -> float:
    """Return a time [s] shortly before the last two blows, or, with too few blows, before the last fifth of the run."""
    begun = blow_times(hole)
    if begun.size <= _ENLARGED_BLOWS + 1:
        return float(hole.time[-1] - 0.2 * np.ptp(hole.time))
    between = float(np.median(np.diff(begun)))
    begun = begun[begun < hole.time[-1] - 0.5 * between]  # a blow cut short by the end of the run does not count
    return float(begun[-_ENLARGED_BLOWS] - _LEAD * between)


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
    changes = np.flatnonzero(np.diff(np.concatenate([[False], slips, [False]]).astype(int)))
    ends = np.concatenate([frequency[:1], (frequency[1:] + frequency[:-1]) / 2, frequency[-1:]])
    quantities = (
        (half_swing(hole["x3"] - hole["x4"]), "length", BIT, 1.1, "amplitude of\nx₃ − x₄"),
        (half_swing(hole["v3"]), "speed", INK, 1.1, "amplitude of\nx₃′"),
        (depth[1:], "length", ROCK, 2.0, "depth of the hole\nx₄"),
    )
    marker = "o" if frequency.size < _MANY_CYCLES else ""
    limits = float(frequency.min()), float(frequency.max())
    plots = []
    for row, (values, quantity, colour, width, label) in enumerate(quantities):
        factor, unit = _scale(quantity, values)
        name = "" if row else "the rock slips"
        spans = [replace(_span(ends[begin], ends[stop], 0.25), label=name) for begin, stop in changes.reshape(-1, 2)]
        line = Line(frequency, factor * values, colour, width, marker=marker, size=2.0, clip=False)
        across = Axis("frequency of the force [Hz]", limits=limits, group="frequency")
        up = Axis(f"{label} [{unit}]", limits=(0.0, None))
        plots.append(Plot([*spans, line], across, up, place=(row, 0), keys="" if row else "above right"))
    return Sheet(plots, (7.6, 6.2), heights=(1.0,) * 3, **margins(ds, _growth_text(hole)))


# Systems.


def states_over_time(ds: xr.Dataset) -> Sheet:
    """Draw the states over the last ten periods of a motion, and a phase portrait of its first two states.

    The transient is faint in the portrait. Dots are impacts.

    **Raises:** `InputError` if the dataset holds no state.
    """
    along = [str(name) for name, data in ds.data_vars.items() if data.dims == (TIME,) and data.dtype.kind == "f"]
    names = [name for name in along if not name.endswith("_force")][:_MOST_STATES]
    if not names:
        raise InputError("no trajectory to draw: the dataset has no state along time")
    motion, end = read_run(ds, *names), float(ds[TIME].values[-1])
    length, part = _observed(ds, end)
    start = end - length
    late, impacts = motion.since(start), motion.impacts[motion.impacts >= start]
    plots = []
    for row, name in enumerate(names):
        layers: list[Layer] = [trace(motion.time[late], motion[name][late], 2 / 3, colour=BIT, width=0.9)]
        # Only the first state is continuous in an impact; elsewhere a dot would lie within the jump.
        if not row:
            places = impacts, np.interp(impacts, motion.time, motion[name])
            layers.append(dots(*places, **_DOTS | {"size": 3.0}))
        plots.append(Plot(layers, _time(start, end), axis(ds[name]), place=(row, 0, 1, 2), grid=""))
    portrait = len(names) > 1
    if portrait:
        x, y = (motion[name] for name in names[:2])
        lines = [Line(x, y, FAINT, 0.5), Line(x[late], y[late], BIT, 1.0)]
        across, up = (axis(ds[name]) for name in names[:2])
        plots.append(Plot(lines, across, up, place=(0, 2, len(names), 1), grid=""))
    about = f"Drawn: {part}" + (", grey: the whole motion" if portrait and start > 0 else "")
    size = WIDTH, max(1.5 * len(names) + 1.0, 3.6)
    notes = margins(ds, about, "Dots: impacts" if impacts.size else "", band_text(plots))
    return Sheet(plots, size, (1.0,) * (2 + portrait), (1.0,) * len(names), **notes)


def _observed(ds: xr.Dataset, end: float) -> tuple[float, str]:
    """Return the length of the part of the motion that is drawn [s] and its name: ten periods, or a tenth of it."""
    period = float(ds["period"]) if "period" in ds and ds["period"].ndim == 0 else np.nan
    if not np.isfinite(period):
        return end / 10, "the last tenth"
    return (10 * period, "the last ten periods") if 10 * period < end else (end, "the whole motion")
