"""A recorded motion as a cell: one repeat, or some returns, at times that are evenly spaced along it and at events."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.explorer.cells import EVENTS, STUCK, TOUCHING, Cell, Column
from vibrojax.models.scenes import HasContact, HasFriction, Scene
from vibrojax.sweep.simulation.dense_output import Record, sample
from vibrojax.sweep.simulation.trajectory import Motion, states_shown

SHOWN = 5
"""Returns that are shown of a lane that does not repeat."""

PASSED = 48
"""Returns of it whose states at the section are shown."""

EVEN, MOST_EVEN = 56, 180
"""Evenly spaced samples a return, and of all returns at most, beside those at events."""

STILL = 2.0
"""Seconds that are shown of a lane that passes no section."""

_FINE = 6
"""Places in each step at which the way that the states pass is measured."""

URGENCE = ("section", "release", "slip", "stick", "impact")
"""Events of one instant: the last of them is shown."""

Steps = dict[str, np.ndarray]
"""The columns of a record by their names, those of many lanes with an axis of lanes last."""


class Begin(NamedTuple):
    """Where the motions of lanes begin, at a section: `state` (states, lanes), all of the scene's; `orbit` (lanes,):
    whether they repeat; `before` [s]: what is left out, `duration` [s]: what is shown, `whole` [s]: what is recorded;
    `returns` shown."""

    state: Float[np.ndarray, "states lanes"]
    orbit: np.ndarray
    before: Float[np.ndarray, " lanes"]
    duration: Float[np.ndarray, " lanes"]
    whole: Float[np.ndarray, " lanes"]
    returns: Int[np.ndarray, " lanes"]


def cell_of_steps(scene: Scene[Any], steps: Steps, events: dict[str, np.ndarray], begin: Begin) -> Cell:
    """One lane's cell from its steps."""
    taken = (steps["dt"] > 0) | steps["hits"].any(axis=1)
    steps = {name: x[taken] for name, x in steps.items()}
    record = Record(**steps)
    end = steps["start"] + steps["dt"]
    reached = float(end[-1]) if len(end) else 0.0
    first, duration = float(begin.before), float(begin.duration)
    if not begin.returns:  # of what passes no section, as much as was recorded
        duration = min(duration, reached)
    if not duration > 0 or reached < first + 0.999 * duration or not np.isfinite(steps["after"]).all():
        return Cell(-1, "none", "its motion could not be recorded: it took too many steps")
    even = min(EVEN * max(int(begin.returns), 1), MOST_EVEN)
    marked = steps["hits"].any(axis=1) & (end > first) & (end < first + duration)
    times = np.unique(np.concatenate([_times(record, first, duration, even), end[marked]]))
    least = duration * 1e-6
    times = times[np.concatenate([[True], np.diff(times) > least])]
    states, modes, step_of = sample(record, times)
    shown = states_shown(scene, Motion(times, states, modes), record, step_of)
    flags = np.zeros(len(times), np.uint8)
    if isinstance(scene, HasFriction):
        flags |= np.where(modes[scene.mode_place("slip")] == 0, STUCK, 0).astype(np.uint8)
    if isinstance(scene, HasContact):
        flags |= np.where(modes[scene.mode_place("touching")] != 0, TOUCHING, 0).astype(np.uint8)
    for name in URGENCE:
        if name in events:
            when = end[events[name][taken]]
            at = np.searchsorted(times, when - least)
            inside = (when >= first - least) & (when <= first + duration + least) & (at < len(times))
            flags[at[inside]] = flags[at[inside]] & (STUCK | TOUCHING) | EVENTS.index(name)
    last = first + duration + least if begin.orbit else np.inf
    passed = np.flatnonzero(events["section"][taken] & (end > first + least) & (end < last))[:PASSED]
    names = [name for name in scene.driving_part().return_states if name in scene.state_names]
    section = {name: steps["after"][passed, scene.place(name)] for name in names} if len(passed) else {}
    columns = tuple(Column(name, one.unit, one.long_name) for name, one in shown.items())
    kind = "orbit" if begin.orbit else "motion"
    return Cell(
        lane=-1,
        kind=kind,
        note="" if begin.returns else "it passes no section",
        returns=int(begin.returns),
        duration=duration,
        columns=columns,
        time=times - first,
        states={name: np.asarray(one.values) for name, one in shown.items()},
        flags=flags,
        section=section,
    )


def _times(record: Record, begin: float, duration: float, count: int) -> np.ndarray:
    """Times of samples of a record, see `evenly_passed`."""
    fractions = np.arange(_FINE) / _FINE
    times = (np.asarray(record.start)[:, None] + np.asarray(record.dt)[:, None] * fractions).ravel()
    times = np.unique(np.concatenate([times[(times > begin) & (times < begin + duration)], [begin, begin + duration]]))
    states, _, _ = sample(record, times)
    return evenly_passed(times, np.asarray(states), count)


def evenly_passed(times: np.ndarray, states: np.ndarray, count: int) -> np.ndarray:
    """So many times and one more, evenly spaced along the motion: along time and along what the states (states, times)
    pass, each over its swing. A blow that takes a hundredth of the time has more than a hundredth of them."""
    swing = np.ptp(states, axis=1)
    moving = swing > 1e-12 * np.abs(states).max(axis=1)
    passed = np.abs(np.diff(states[moving], axis=1)) / swing[moving][:, None]
    steps = len(states) * np.diff(times) / (times[-1] - times[0]) + passed.sum(axis=0)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    return np.interp(np.linspace(0.0, along[-1], count + 1), along, times)
