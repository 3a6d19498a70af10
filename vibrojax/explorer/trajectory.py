"""A cell from a trajectory, as `simulate` gives it: its last repeat, or its last returns."""

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.errors import printable
from vibrojax.explorer.cells import EVENTS, STUCK, TOUCHING, Cell, Column
from vibrojax.explorer.sampled import EVEN, MOST_EVEN, PASSED, SHOWN, STILL, URGENCE, evenly_passed
from vibrojax.io.attributes import parameters_of

RETURN_STATES = ("x1", "x2", "v2", "x3", "v3")
"""States whose values at returns are shown, where there are such."""

_SAME = 1e-3


def cell_of(motion: xr.Dataset, lane: int = -1) -> Cell:
    """The cell of a trajectory.

    **Arguments:** `motion`: what `simulate` gives; one of a solver of diffrax has no events, and shows its last
    seconds; `lane`: its number, -1 for what was simulated live.

    **Returns:** a cell with `numbers`: what was found in the motion, by the names of a sweep's variables.
    """
    time = motion["time"].values
    happened = _events(motion)
    returns = happened["section"]
    driven = not len(returns) and "applied_force" in motion
    if driven:
        returns = _pulses(motion, float(time[-1]))
    cycles = int(motion["cycles"]) if "cycles" in motion else 0
    if driven:
        cycles = _pulses_in_repeat(motion, returns)
    kind = "orbit" if cycles and len(returns) > cycles else "motion"
    shown = cycles if kind == "orbit" else min(SHOWN, max(len(returns) - 1, 0))
    if shown:
        begin, end = float(returns[-1 - shown]), float(returns[-1])
    else:
        begin, end = max(float(time[0]), float(time[-1]) - STILL), float(time[-1])
    even = min(EVEN * max(shown, 1), MOST_EVEN)
    marked = np.concatenate([x[(x > begin) & (x < end)] for x in happened.values()])
    names = [str(name) for name in motion.data_vars if _is_state(motion[name])]
    inside = np.concatenate([[begin], time[(time > begin) & (time < end)], [end]])
    passed = evenly_passed(inside, np.stack([np.interp(inside, time, motion[name].values) for name in names]), even)
    at = np.unique(np.concatenate([passed, marked]))
    at = at[np.concatenate([[True], np.diff(at) > 1e-6 * (end - begin)])]
    columns = tuple(
        Column(name, *(printable(motion[name].attrs.get(key, ""), 200) for key in ("units", "long_name")))
        for name in names
    )
    states = {one.name: np.interp(at, time, motion[one.name].values) for one in columns}
    seen = returns[1:] if kind == "motion" else returns[len(returns) - cycles :]
    known = [name for name in RETURN_STATES if name in states] if len(seen) else []
    section = {name: np.interp(seen[-PASSED:], time, motion[name].values) for name in known}
    return Cell(
        lane=lane,
        kind=kind,
        note="" if shown else "it passes no section",
        returns=shown,
        duration=end - begin,
        columns=columns,
        time=at - begin,
        states=states,
        flags=_flags(motion, at, happened, 1e-6 * (end - begin)),
        section=section,
        numbers=_numbers(motion),
    )


def _events(motion: xr.Dataset) -> dict[str, Float[np.ndarray, " events"]]:
    """The times [s] of what happened, by kind."""
    if "event_time" not in motion:
        return {name: np.zeros(0) for name in EVENTS[1:]}
    when, kinds = motion["event_time"].values, motion["event_kind"].values
    return {name: when[kinds == flag] for flag, name in enumerate(EVENTS) if flag}


def _pulses(motion: xr.Dataset, end: float) -> Float[np.ndarray, " pulses"]:
    """When pulses begin; none of a swept sine."""
    frequency = parameters_of(motion).get("frequency", 0.0)
    if not 0 < end * frequency < motion.sizes["time"]:  # more pulses than samples show nothing
        return np.zeros(0)
    return np.arange(int(end * frequency + 1e-9) + 1) / frequency


def _pulses_in_repeat(motion: xr.Dataset, pulses: np.ndarray) -> int:
    """After how many pulses the motion repeats, by what it does before and after; 0: not after 1 to 8."""
    time = motion["time"].values
    states = [motion["v3"].values, motion["x3"].values - motion["x4"].values]
    for count in range(1, min(8, len(pulses) - 1) + 1):
        at = np.linspace(pulses[-1 - count], pulses[-1], 64)
        before = at - (pulses[-1] - pulses[-1 - count])
        if before[0] < 0:
            return 0
        apart = (np.abs(np.interp(at, time, x) - np.interp(before, time, x)).max() / (np.ptp(x) or 1) for x in states)
        if max(apart) < _SAME * 10:
            return count
    return 0


def _is_state(data: xr.DataArray) -> bool:
    return data.dims == ("time",) and data.dtype.kind == "f" and not str(data.name).endswith("_force")


def _flags(motion: xr.Dataset, at: np.ndarray, happened: dict[str, np.ndarray], within: float) -> np.ndarray:
    flags = np.zeros(len(at), np.uint8)
    if "stuck" in motion:
        place = np.clip(
            np.searchsorted(motion["time"].values, at + within, side="right") - 1, 0, motion.sizes["time"] - 1
        )
        flags |= np.where(motion["stuck"].values[place] == 1, STUCK, 0).astype(np.uint8)
    if len(happened["impact"]) or len(happened["release"]):
        begun = np.searchsorted(happened["impact"], at + within)
        ended = np.searchsorted(happened["release"], at + within)
        flags |= np.where(begun > ended, TOUCHING, 0).astype(np.uint8)
    for name in URGENCE:
        place = np.searchsorted(at, happened[name] - within)
        inside = (place < len(at)) & (happened[name] >= at[0] - within)
        place = place[inside]
        flags[place] = flags[place] & (STUCK | TOUCHING) | EVENTS.index(name)
    return flags


def _numbers(motion: xr.Dataset) -> dict[str, Any]:
    """What was found, by name; none where a number is not finite."""
    found = {str(name): data.values.item() for name, data in motion.data_vars.items() if data.ndim == 0}
    return {name: x if isinstance(x, int) or np.isfinite(x) else None for name, x in found.items()}
