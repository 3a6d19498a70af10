"""Pictures of trajectories: time histories, phase portraits, spectrum, blows on rock, response to a swept sine.

Oscillations that are too dense for a line are drawn as bands.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from vibrojax.errors import InputError
from vibrojax.io.runs import Run, Samples, read_run
from vibrojax.pictures.axes import axis, margins, number, scale
from vibrojax.pictures.colours import value_axis, value_of
from vibrojax.pictures.contents import TIME, Contents
from vibrojax.pictures.plots import FAINT, INK, Area, Axis, Layer, Line, Look, Plot, Sheet, Text, dots, level, upright
from vibrojax.pictures.style import BIT, DASHED, IMPACT, ROCK, SAVED_DPI, STICK, STRIKER

FIGURE_WIDTH = 10.0  # of the figures [inch]
_PANEL_SHARE = 0.775  # of the width of the figure
_COLUMNS = 6  # of the grid that the panels of a row share
_CYCLE_PIXELS = 5.0  # least width of a cycle that a line resolves
_COLUMN_PIXELS = 8  # a band takes minimum and maximum over this width: more than an unresolved cycle
_WINDOW = 1.5  # duration of the end of the run that is shown [s]
_OVERVIEW_FROM = 1.5  # ratio of the run's length to the window from which there is an overview
_MOST_PEAKS, _LEAST_PEAK = 3, 0.1  # number of peaks, and least height relative to the highest
_PADDED = 8  # length of the spectrum's samples with zeros appended, in units of the length without
_LOBE_BINS = 4 * _PADDED  # width of the Hann window's main lobe in frequency bins
_SPECTRUM_SPAN = 5.0  # in units of the bit's dominant frequency
_SPECTRUM_AT_REST = 25.0  # span [Hz] if nothing moves
_LEAST_AMPLITUDE = 1e-6  # [mm]: less is rounding error
_IMPACT_WINDOW = 0.1  # time [s] within which the bit must come to rest after an impact, if the impact is enlarged
_REST_SPEED = 0.01  # fraction of the greatest speed up to which the bit counts as resting
_IMPACT_LEAD = 0.15  # fraction of an impact's duration that is shown before the impact
_MOST_STATES = 6  # of a system; more would not be legible on one page
_DOTS: Look = {"size": 4.0, "colour": IMPACT, "order": 4.0, "clip": False}
REPORTED_DRIFT = 1e-3  # relative distance from the settled motion: half a digit of printed values
_FORCES = {  # colour, line width, legend text
    "applied_force": (FAINT, 1.0, "given I"),
    "rock_force": (INK, 1.0, "rock N"),
    "impact_force": (IMPACT, 1.0, "impact force J"),
    "friction_force": (INK, 0.8, "friction force F"),
}


def trace(time: Samples, values: Samples, share: float = 1.0, **look: Any) -> Line | Area:
    """Return values over time as a line, or as a band from minimum to maximum if a line would cover the panel.

    `share`: width of the panel, as a fraction of the figure's panels.
    """
    pixels = max(int(share * _PANEL_SHARE * FIGURE_WIDTH * SAVED_DPI), 1)
    height = float(np.ptp(values)) if values.size else 0.0
    # Number of cycles: the total variation over twice the height. Are the cycles too narrow for a line?
    if not (height > 0 and float(np.abs(np.diff(values)).sum()) / (2.0 * height) > pixels / _CYCLE_PIXELS):
        return Line(time, values, **look)
    count = max(pixels // _COLUMN_PIXELS, 1)
    column = np.minimum(np.floor((time - time[0]) / np.ptp(time) * count), count - 1)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    low, high = (reduce.reduceat(values, first) for reduce in (np.minimum, np.maximum))
    ends, low, high = np.append(time[first], time[-1]), np.append(low, low[-1]), np.append(high, high[-1])
    about = {name: look[name] for name in ("label", "order") if name in look}
    return Area(ends, low, high, look["colour"], 0.3, edge=look["colour"], step=True, **about)


def band_text(plots: Sequence[Plot]) -> str:
    """Return the note on bands, or "" if no plot has a band."""
    if not any(isinstance(layer, Area) and layer.step for plot in plots for layer in plot.layers):
        return ""
    return "Bands: from the least to the greatest value, where the oscillations are too many to be told apart"


def unsettled_text(drift: float) -> str:
    """Return that a motion has not settled, given its `drift_estimate`; "" if it has, or the estimate is NaN."""
    if not drift > REPORTED_DRIFT:
        return ""
    far = f"by some {100 * drift:.3g} %" if np.isfinite(drift) else "and its returns do not tell how far"
    return f"still on its way to where it settles, {far}: a longer duration brings it there"


def run_notes(ds: xr.Dataset, plots: Sequence[Plot], *notes: str) -> dict[str, Any]:
    """Return the margins of a picture of a run with `notes`, those on bands, and whether the motion has settled."""
    drift = ds.get("drift_estimate")
    text = "" if drift is None or drift.ndim else unsettled_text(float(drift))
    return margins(ds, *notes, band_text(plots), text[:1].upper() + text[1:])


def time_axis(start: float, end: float, group: str = "time") -> Axis:
    """Return the axis of the time from `start` to `end` [s]."""
    return Axis("time [s]", TIME, (start, end), group=group)


def span(start: float, end: float, alpha: float, label: str = "") -> Area:
    """Return a shaded interval of the horizontal axis."""
    return Area([start, end], [-np.inf] * 2, [np.inf] * 2, FAINT, alpha, label=label)


def enlarged(plot: Plot, title: str, **about: Any) -> Plot:
    """Return a plot beside one of the same lines, which the legend of that one names."""
    layers = [replace(layer, label="") if isinstance(layer, Line | Area) else layer for layer in plot.layers]
    return replace(plot, layers=layers, title=title, **about)


def printed_unit(unit: str, *values: Samples) -> tuple[float, str]:
    """Return the conversion factor and the unit to print `values` in, which have an SI unit."""
    factor, printed = scale(xr.DataArray(np.concatenate([np.zeros(1), *values]), attrs={"units": unit}))
    return factor, printed.replace(" s-1", "/s")


def _gap(motion: Run) -> float | None:
    """Return the place [mm] of the contact between striker and bit, or None for a scene without impacts."""
    known = "impact_force" in motion.series and "delta" in motion.parameters
    return 1e3 * motion.parameters["delta"] if known else None


def _both(motion: Run, x_bit: Samples, x_striker: Samples, labels: Sequence[str] = ("",) * 4) -> list[Layer]:
    """Draw a quantity of striker and bit over time; mark sticking and impacts on lines, but not on bands."""
    bit = trace(motion.time, x_bit, colour=BIT, width=1.1, label=labels[0], order=2.1)
    striker = trace(motion.time, x_striker, colour=STRIKER, width=1.1, label=labels[1])
    layers: list[Layer] = [bit, striker]
    if isinstance(bit, Line) and motion["stuck"].any():
        stuck = np.where(motion["stuck"] == 1, x_bit, np.nan)
        layers.append(Line(motion.time, stuck, STICK, 2.6, label=labels[2], order=2.2))
    if isinstance(striker, Line) and motion.impacts.size:
        at_impacts = np.interp(motion.impacts, motion.time, x_striker)
        layers.append(dots(motion.impacts, at_impacts, label=labels[3], **_DOTS))
    return layers


def _portrait(motion: Run, start: float, x: str, speed: str, label: str) -> Plot:
    """Draw the phase portrait of bit (`x` is x1) or striker (x2), with impacts as dots.

    The motion before time `start` [s] is faint. Sticking is a thick line, the contact a vertical one.
    """
    name, symbol, colour = ("bit", "x₁", BIT) if x == "x1" else ("striker", "x₂", STRIKER)
    before, late = motion.between(motion.time[0], start), motion.between(start, np.inf)
    layers: list[Layer] = [level(0.0, colour=FAINT, width=0.6, order=1.5)]
    if x == "x2" and (gap := _gap(motion)) is not None:
        layers.append(upright(gap, colour=FAINT, width=0.8, dash=DASHED, order=1.5))
    layers.append(Line(1e3 * before[x], before[speed], FAINT, 0.4, alpha=0.6))
    layers.append(Line(1e3 * late[x], late[speed], colour, 1.1))
    if x == "x1":
        layers.append(Line(1e3 * late[x], np.where(late["stuck"] == 1, late[speed], np.nan), STICK, 2.8, order=3.0))
    layers.append(dots(*(np.interp(late.impacts, late.time, part) for part in (1e3 * late[x], late[speed])), **_DOTS))
    title = name + ", earlier in grey" * bool(start > motion.time[0])
    return Plot(layers, Axis(f"{symbol} [mm]"), Axis(label), title)


def _spectrum(motion: Run) -> Plot:
    """Draw the amplitude spectra of both displacements, and label the peaks with their frequencies."""
    late = np.linspace((motion.time[0] + motion.time[-1]) / 2, motion.time[-1], max(motion.time.size // 2, 8))
    window = 1.0 - np.cos(2.0 * np.pi * np.arange(late.size) / late.size)  # of Hann
    named: list[tuple[float, float]] = []
    layers: list[Layer] = []
    end, top, lobe = 0.0, _LEAST_AMPLITUDE, 0.0
    for name, x, colour in (("bit", "x1", BIT), ("striker", "x2", STRIKER)):
        signal = np.interp(late, motion.time, 1e3 * motion[x])
        spectrum = np.fft.rfft(window * (signal - signal.mean()), _PADDED * late.size)
        frequencies = np.fft.rfftfreq(_PADDED * late.size, late[1] - late[0])
        amplitudes = 2.0 * np.abs(spectrum) / window.sum()
        maxima = _peaks(amplitudes)
        end = end or (_SPECTRUM_SPAN * float(frequencies[maxima[0]]) if maxima.size else 0.0)
        lobe, top = float(frequencies[_LOBE_BINS]), max(top, float(amplitudes.max()))
        shown = frequencies < (end or _SPECTRUM_AT_REST)
        layers.append(Line(frequencies[shown], amplitudes[shown], colour, 1.0, label=name))
        # Where both lines have a peak, the higher line hides the lower line, but not the marker at its top.
        layers.append(dots(frequencies[maxima], amplitudes[maxima], colour=colour, size=3.2, order=4.0))
        named += zip(frequencies[maxima].tolist(), amplitudes[maxima].tolist(), strict=True)
    end = end or _SPECTRUM_AT_REST
    texts: list[Text] = []
    look: dict[str, Any] = {"colour": INK, "size": 8.0, "halo": 1.0, "offset": (4.0, 2.0), "order": 5.0}
    for frequency, amplitude in sorted(named, key=lambda peak: -peak[1]):
        if frequency < end and all(abs(frequency - text.x) > lobe for text in texts):
            texts.append(Text(frequency, amplitude, f"{number(round(frequency, 2))} Hz", "left", "bottom", **look))
    up = Axis("amplitude [mm]", limits=(0.0, 1.25 * top))  # room for the text at the highest peak
    title = "spectrum, second half of the run"
    return Plot([*layers, *texts], Axis("frequency [Hz]", limits=(0.0, end)), up, title, keys="upper right")


def _peaks(amplitudes: np.ndarray) -> np.ndarray:
    """Return the indices of the highest peaks, highest first, at least the width of a window's main lobe apart."""
    inner = amplitudes[1:-1]
    maxima = 1 + np.flatnonzero((inner > amplitudes[:-2]) & (inner >= amplitudes[2:]))
    maxima = maxima[amplitudes[maxima] >= max(_LEAST_PEAK * amplitudes.max(), _LEAST_AMPLITUDE)]
    peaks: list[int] = []
    for index in maxima[np.argsort(-amplitudes[maxima], kind="stable")]:
        if len(peaks) < _MOST_PEAKS and all(abs(index - peak) >= _LOBE_BINS for peak in peaks):
            peaks.append(int(index))
    return np.array(peaks, int)


def hole_plot(hole: Run, start: float, end: float, group: str) -> Plot:
    """Draw the bit's displacement x3 and the hole's depth x4 from `start` to `end` [s], on half of the width."""
    late = hole.between(start, end)
    factor, unit = printed_unit("m", late["x3"], late["x4"])
    # The wider line of the hole is drawn first, so that both are visible where the bit presses on the hole's bottom.
    layers = [
        trace(late.time, factor * late["x4"], 0.5, colour=ROCK, width=2.4, label="hole x₄"),
        trace(late.time, factor * late["x3"], 0.5, colour=BIT, width=0.9, label="bit x₃"),
    ]
    return Plot(layers, time_axis(start, end, group), Axis(f"depth\n[{unit}]"))


def force_plot(run: Run, names: Sequence[str], across: Axis, limit: float | None = None, share: float = 1.0) -> Plot:
    """Draw the forces `names` of a run, and the rock's threshold `limit` [N]."""
    factor, unit = printed_unit("N", *(run[name] for name in names))
    layers: list[Layer] = []
    if limit is not None:
        text = f"threshold D = {number(factor * limit)} {unit}"
        layers.append(level(factor * limit, colour=ROCK, width=1.0, dash=DASHED, label=text))
    for name in names:
        colour, width, label = _FORCES[name]
        layers.append(trace(run.time, factor * run[name], share, colour=colour, width=width, label=label))
    return Plot(layers, across, Axis(f"force\n[{unit}]"))


def growth_text(hole: Run) -> str:
    """Return the note on the hole's growth over the run."""
    depth, duration = 1e3 * float(hole["x4"][-1] - hole["x4"][0]), float(np.ptp(hole.time))
    if not depth > 0:
        return "No penetration"
    return f"The hole grows by {number(float(f'{depth:.3g}'))} mm in {number(duration)} s"


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
    begin, end, driven = float(motion.time[0]), float(motion.time[-1]), "v" in motion.parameters
    start = max(end - _WINDOW, begin)
    late, across = motion.between(start, np.inf), time_axis(start, end)
    rows: list[tuple[float, list[Plot]]] = []  # with their heights
    if end - begin > _OVERVIEW_FROM * _WINDOW:
        both = [trace(motion.time, 1e3 * motion[x], colour=c, width=0.4) for x, c in (("x1", BIT), ("x2", STRIKER))]
        whole = [*both, span(start, end, 0.3)]
        rows.append(
            (0.65, [Plot(whole, time_axis(begin, end, ""), Axis("[mm]"), "whole run; its shaded end is below")])
        )
    labels = "bit", "striker", "bit sticks", "impact begins"
    displacements = _both(late, 1e3 * late["x1"], 1e3 * late["x2"], labels)
    if (gap := _gap(motion)) is not None:
        text = f"gap Δ = {number(gap)} mm"
        displacements.append(level(gap, colour=FAINT, width=0.8, dash=DASHED, label=text, order=1.5))
    rows.append((1.25, [Plot(displacements, across, Axis("displacement\n[mm]"), keys="above")]))
    speeds = [level(0.0, colour=FAINT, width=0.7), *_both(late, late["u"], late["v2"])]
    rows.append((1.25, [Plot(speeds, across, Axis(f"{'u' if driven else 'x₁′'} and x₂′\n[m/s]"))]))
    if forces := [name for name in ("impact_force", "friction_force") if name in motion.series]:
        rows.append((0.9, [replace(force_plot(late, forces, across), keys="above right")]))
    if hole:
        depths = replace(hole_plot(hole, start, end, "hole"), keys="above left")
        row = [depths]
        if near := _last_impact(hole, motion.between(start, end).impacts):
            near_plot = enlarged(hole_plot(hole, *near, "impact"), "enlarged: the shaded impact")
            near_plot = replace(near_plot, x=replace(near_plot.x, intervals=4))
            row = [replace(depths, layers=[span(*near, 0.4), *depths.layers]), near_plot]
        rows.append((1.3, row))
    of_bit = _portrait(motion, start, "x1", "u", "sliding speed u [m/s]" if driven else "velocity x₁′ [m/s]")
    of_striker = _portrait(motion, start, "x2", "v2", "velocity x₂′ [m/s]")
    rows.append((2.7, [of_bit, of_striker, _spectrum(motion)]))
    heights, plots = [height for height, _ in rows], []
    for k, (_, row) in enumerate(rows):
        wide = _COLUMNS // len(row)
        plots += [replace(plot, place=(k, i * wide, 1, wide)) for i, plot in enumerate(row)]
    about = run_notes(ds, plots, "u = x₁′ + v" * driven, growth_text(hole) if hole else "")
    return Sheet(plots, (FIGURE_WIDTH, sum(heights) + 0.33 * len(heights) + 1.2), heights=heights, **about)


def _last_impact(hole: Run, impacts: Samples) -> tuple[float, float] | None:
    """Return the time interval [s] around the last impact after which the bit comes to rest, or None."""
    for begins in impacts[::-1].tolist():
        after = hole.between(begins, min(begins + _IMPACT_WINDOW, float(hole.time[-1])))
        speed = np.abs(after["v3"])
        moving = np.flatnonzero(speed > _REST_SPEED * speed.max(initial=0.0))
        if moving.size and moving[-1] < speed.size - 1:
            rest = float(after.time[moving[-1]])
            return begins - _IMPACT_LEAD * (rest - begins), rest + 2 * _IMPACT_LEAD * (rest - begins)
    return None


def states_over_time(ds: xr.Dataset) -> Sheet:
    """Draw the states over the last ten periods of a motion, and a phase portrait of its first two states.

    The transient is faint in the portrait.

    **Raises:** `InputError` if the dataset holds no state.
    """
    along = [str(name) for name, data in ds.data_vars.items() if data.dims == (TIME,) and data.dtype.kind == "f"]
    names = [name for name in along if not name.endswith("_force")][:_MOST_STATES]
    if not names:
        raise InputError("no trajectory to draw: the dataset has no state along time")
    motion, end = read_run(ds, *names), float(ds[TIME].values[-1])
    # In the units of the axes, which are mm for small lengths.
    motion = replace(motion, series=dict(motion.series) | {name: scale(ds[name])[0] * motion[name] for name in names})
    period = float(ds["period"]) if "period" in ds and ds["period"].ndim == 0 else np.nan
    length, part = (10 * period, "the last ten periods") if np.isfinite(period) else (end / 10, "the last tenth")
    start, part = (end - length, part) if length < end else (0.0, "the whole motion")
    late = motion.between(start, np.inf)
    plots = []
    for row, name in enumerate(names):
        layers: list[Layer] = [trace(late.time, late[name], 2 / 3, colour=BIT, width=0.9)]
        # Only the first state is continuous in an impact; elsewhere a dot would lie within the jump.
        if not row and late.impacts.size:
            look = {**_DOTS, "size": 3.0, "label": "impacts"}
            layers.append(dots(late.impacts, np.interp(late.impacts, late.time, late[name]), **look))
        plots.append(Plot(layers, time_axis(start, end), axis(ds[name]), place=(row, 0, 1, 2)))
    if portrait := len(names) > 1:
        lines = [
            Line(motion[names[0]], motion[names[1]], FAINT, 0.5, label="whole motion" if start > 0 else ""),
            Line(late[names[0]], late[names[1]], BIT, 1.0, label=part),
        ]
        across, up = (axis(ds[name]) for name in names[:2])
        plots.append(Plot(lines, across, up, place=(0, 2, len(names), 1)))
    notes = run_notes(ds, plots, f"Drawn: {part}" * (not portrait))
    return Sheet(plots, (FIGURE_WIDTH, max(1.5 * len(names) + 1.0, 3.6)), beside=False, **notes)


def histories(ds: xr.Dataset, names: Sequence[str]) -> Sheet:
    """Draw chosen variables of a run over the whole time."""
    time = ds[TIME].values.astype(float)
    across = axis(ds[TIME], limits=(time[0], time[-1]), group="time")
    plots = []
    for row, value in enumerate(value_of(ds[name]) for name in names):
        line = trace(time, value.of(ds).values.astype(float), colour=BIT, width=1.0)
        plots.append(Plot([line], across, value_axis(value, value.label.replace(" [", "\n[")), place=(row, 0)))
    return Sheet(plots, (FIGURE_WIDTH, 1.5 * len(names) + 0.9), **margins(ds, band_text(plots)))
