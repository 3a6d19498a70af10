"""The explorer's view of one trajectory: the thinned time history, and the last period or last section crossings."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import InputError, printable
from vibrojax.explorer.document import (
    Document,
    command_seconds,
    document_with,
    one_line,
    run_document,
    variable_document,
)
from vibrojax.explorer.encoding import EVENTS, STUCK, TOUCHING, Cell, StateColumn, pack
from vibrojax.explorer.recording import (
    SECTION_RETURNS,
    SHOWN_RETURNS,
    SHOWN_SECONDS,
    TIME_TOLERANCE,
    mark_events,
    repeated_pulses,
    sample_times,
)
from vibrojax.io.attributes import parameters_of, run_of

HISTORY_BINS = 1200
"""Number of time intervals, of each of which the least and greatest value are shown: one per pixel of a wide plot."""

SECTION_STATES = ("x1", "x2", "v2", "x3", "v3")
"""States whose values at section crossings are shown, if the scene has them."""

LAST_PULSES = 32
"""Number of pulses at the end of a motion whose states are compared to find its period."""


def motion_document(ds: xr.Dataset) -> Document:
    """Return the JSON document of a trajectory, given the dataset of `simulate`."""
    if not ds.sizes["time"]:
        raise InputError("explore: the motion has no samples")
    if any(np.isinf(data.values).any() for data in ds.data_vars.values() if data.dtype.kind == "f"):
        raise InputError("explore: the motion has values that are not finite")
    names = [str(name) for name, data in ds.data_vars.items() if data.ndim == 0 and data.dtype.kind in "fiu"]
    return document_with(
        ds,
        "motion",
        [variable_document(ds[name]) | {"map": None} for name in names],
        lanes=pack(np.zeros(1, np.int32)) | {"axes": []},
        run=run_document(ds) | {"duration": command_seconds(float(ds["time"][-1]))},
        history=_history(ds),
    )


def _history(ds: xr.Dataset) -> Document:
    """Return all variables along time, reduced to the two extremes in each time interval, in order of time."""
    time = ds["time"].values
    bins = np.array_split(np.arange(len(time)), min(HISTORY_BINS, len(time)))
    columns: list[Document] = []
    for name, data in ds.data_vars.items():
        if data.dims != ("time",) or data.dtype.kind != "f":
            continue
        values = data.values
        extremes = [sorted((part[np.argmin(values[part])], part[np.argmax(values[part])])) for part in bins]
        columns.append(
            {
                "name": str(name),
                "units": one_line(data.attrs.get("units", "")),
                "long_name": one_line(data.attrs.get("long_name", "")) or str(name),
                "data": pack(values[np.ravel(extremes)].astype(float)),
            }
        )
    ends = np.ravel([[time[part[0]], time[part[-1]]] for part in bins])
    return {"time": pack(ends), "columns": columns, "observed_from": run_of(ds).get("settle")}


def cell_of(motion: xr.Dataset, lane: int = -1) -> Cell:
    """Return the part of a trajectory that the explorer page shows: its last period or its last section crossings.

    **Arguments:** `motion`: the dataset of `simulate`. Without events, as with a solver of diffrax, the last seconds
    are shown. `lane`: number of the lane, -1 for a motion simulated live.

    **Returns:** a `Cell`. Its `numbers` are the features of the motion, with the names of a sweep's variables.
    """
    time = motion["time"].values
    moments, kinds = (motion[n].values if n in motion else np.zeros(0) for n in ("event_time", "event_kind"))
    events = {name: moments[kinds == flag] for flag, name in enumerate(EVENTS) if flag}
    returns, cycles = events["section"], int(motion["cycles"]) if "cycles" in motion else 0
    if not len(returns) and "applied_force" in motion:
        returns = _pulses(motion, float(time[-1]))
        states = [motion["v3"].values, motion["x3"].values - motion["x4"].values]
        passed = np.stack([np.interp(returns, time, x) for x in states], axis=1)
        cycles = repeated_pulses(passed[-LAST_PULSES:], np.ptp(states, axis=1) / 2)
    kind = "orbit" if cycles and len(returns) > cycles else "motion"
    shown = cycles if kind == "orbit" else min(SHOWN_RETURNS, max(len(returns) - 1, 0))
    if shown:
        begin, end = float(returns[-1 - shown]), float(returns[-1])
    else:
        begin, end = max(float(time[0]), float(time[-1]) - SHOWN_SECONDS), float(time[-1])
    data = {
        str(name): state
        for name, state in motion.data_vars.items()
        if state.dims == ("time",) and state.dtype.kind == "f" and not str(name).endswith("_force")
    }
    inside = np.concatenate([[begin], time[(time > begin) & (time < end)], [end]])
    path = np.stack([np.interp(inside, time, x.values) for x in data.values()])
    times = sample_times(inside, path, np.concatenate(list(events.values())), shown)
    tolerance = TIME_TOLERANCE * (end - begin)
    units = {name: [printable(x.attrs.get(key, ""), 200) for key in ("units", "long_name")] for name, x in data.items()}
    passed = returns[1:] if kind == "motion" else returns[len(returns) - cycles :]
    section = [name for name in SECTION_STATES if name in data] if len(passed) else []
    numbers = {str(name): x.values.item() for name, x in motion.data_vars.items() if x.ndim == 0}
    return Cell(
        lane=lane,
        kind=kind,
        note="" if shown else "it passes no section",
        returns=shown,
        duration=end - begin,
        columns=tuple(StateColumn(name, *texts) for name, texts in units.items()),
        time=times - begin,
        states={name: np.interp(times, time, x.values) for name, x in data.items()},
        flags=_flags(motion, times, events, tolerance),
        section={name: np.interp(passed[-SECTION_RETURNS:], time, data[name].values) for name in section},
        numbers={name: x if isinstance(x, int) or np.isfinite(x) else None for name, x in numbers.items()},
    )


def _pulses(motion: xr.Dataset, end: float) -> Float[np.ndarray, " pulses"]:
    """Return the times [s] at which pulses begin; empty for a swept sine."""
    frequency = parameters_of(motion).get("frequency", 0.0)
    if not 0 < end * frequency < motion.sizes["time"]:  # with fewer samples than pulses, a period cannot be detected
        return np.zeros(0)
    return np.arange(int(end * frequency + 1e-9) + 1) / frequency


def _flags(motion: xr.Dataset, times: np.ndarray, events: dict[str, Any], tolerance: float) -> np.ndarray:
    """Return the flags of samples: bit sticks, striker touches the bit, and the event at the sample."""
    flags = np.zeros(len(times), np.uint8)
    if "stuck" in motion:
        samples = np.searchsorted(motion["time"].values, times + tolerance, side="right") - 1
        stuck = motion["stuck"].values[np.clip(samples, 0, motion.sizes["time"] - 1)]
        flags |= np.where(stuck == 1, STUCK, 0).astype(np.uint8)
    if len(events["impact"]) or len(events["release"]):
        begun = np.searchsorted(events["impact"], times + tolerance)
        ended = np.searchsorted(events["release"], times + tolerance)
        flags |= np.where(begun > ended, TOUCHING, 0).astype(np.uint8)
    mark_events(flags, times, events, tolerance)
    return flags
