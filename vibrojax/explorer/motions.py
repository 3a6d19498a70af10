"""The motions of a sweep's lanes as cells: of lanes that repeat one repeat of their orbit, of others some returns.

They follow from where the lanes ended: the sweep is run again with its orbits, which says at which state each lane
passes the section; from there its steps are recorded, many lanes at once, and read at evenly spaced times and at
events.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrojax.devices import precision
from vibrojax.engine.batch import Features
from vibrojax.engine.carried import Carried
from vibrojax.engine.chunks import Chunks
from vibrojax.engine.compiler import lane_function
from vibrojax.explorer.cells import EVENTS, STUCK, TOUCHING, Cell, Column
from vibrojax.input.definition import Sweep
from vibrojax.measure.kept_returns import state_name
from vibrojax.periodic import Orbits, early_ends
from vibrojax.periodic.measured import DRIVEN_RETURNS
from vibrojax.progress import Progress
from vibrojax.scenes import HasContact, HasFriction, Scene
from vibrojax.scenes.declared import Values
from vibrojax.simulation._record import Record, record_batch, sample
from vibrojax.simulation._trajectory import Motion, impact_begins, lowest_velocity, states_shown
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Lane, Located, lane_at
from vibrojax.store.variables import orbit_name
from vibrojax.workers.work import quiet

SHOWN = 5
"""Returns that are shown of a lane that does not repeat."""

PASSED = 48
"""Returns of it whose states at the section are shown."""

EVEN, MOST_EVEN = 56, 180
"""Evenly spaced samples a return, and of all returns at most, beside those at events."""

LANES = 128
"""Lanes that are recorded at once: their steps take some 20 MB."""

MOST_BATCHES = 40
"""Of steps, after which a lane's record is cut off."""

STILL = 2.0
"""Seconds that are shown of a lane that passes no section."""

STEPS = Accuracy(tolerance=1e-9, stride=LOCATED_STRIDE, step=np.inf)
"""Of what is recorded."""


Steps = dict[str, np.ndarray]
"""The columns of a record by their names, those of many lanes with an axis of lanes last."""


class Begin(NamedTuple):
    """Where the motions of lanes begin, at a section: `state` (states, lanes), all of the scene's; `kind` (lanes,);
    `before` [s]: what is left out, `duration` [s]: what is shown, `all` [s]: what is recorded; `returns` shown."""

    state: Float[np.ndarray, "states lanes"]
    orbit: np.ndarray
    before: Float[np.ndarray, " lanes"]
    duration: Float[np.ndarray, " lanes"]
    whole: Float[np.ndarray, " lanes"]
    returns: Int[np.ndarray, " lanes"]


def motions(sweep: Sweep, progress: bool = True) -> Iterator[Cell]:
    """The cells of all lanes of a sweep, in the order in which they are counted (see `Sweep.counted`).

    The sweep is run again, in its own chunks, with orbits; of its lanes one repeat is recorded, or some returns.
    """
    names = sweep.system.driving_part().return_states
    asked = replace(sweep, run=replace(sweep.run, orbits=bool(names)))
    orbits = Orbits(asked) if names else None

    def beyond(first: int, end: int, features: Features) -> Features:
        found = features | (orbits(first, end, features) if orbits is not None else {})
        last = {f"last_{name}": _newest(features[state_name(name)]) for name in names if state_name(name) in features}
        return {
            name: x for name, x in (found | last).items() if x.ndim == 1 or name in ("multiplier_abs", "multiplier_arg")
        }

    carried = sweep.run.carry is not None
    chunks = Carried(asked, beyond) if carried else Chunks(asked, beyond, early_ends(asked))
    with Progress(sweep.lanes, "lanes", progress) as shown:
        for index in range(chunks.count):
            with quiet():
                features = chunks.compute(index, shown.add)
                yield from _cells(asked, chunks, chunks.lanes(index), features)


def _newest(returns: np.ndarray) -> np.ndarray:
    """The last of the returns of each lane, which of a scene under pulses are kept alone."""
    return returns if returns.ndim == 1 else returns[:, -1]


def _cells(sweep: Sweep, chunks: Chunks, lanes: tuple[int, int], features: Features) -> list[Cell]:
    first, end = lanes
    parameters, _ = sweep.lane_values(first, end)
    begin = _begins(sweep, chunks, lanes, features, parameters)
    found = [Cell(lane, "none", why) for lane, why in enumerate(_why_not(sweep, features, parameters), first)]
    usable = np.isfinite(begin.state).all(axis=0) & np.isfinite(begin.whole) & (begin.whole > 0)
    usable &= np.array([not cell.note.startswith(("refused", "failed")) for cell in found])
    order = np.flatnonzero(usable)
    order = order[np.argsort(begin.whole[order] / np.maximum(begin.duration[order], 1e-9), kind="stable")]
    for at in range(0, len(order), LANES):
        some = order[at : at + LANES]
        given = {name: x[some] for name, x in parameters.items()}
        part = Begin(*(x[..., some] for x in begin))
        for which, cell in zip(some, recorded(sweep.system, given, part), strict=True):
            found[which] = replace(cell, lane=first + int(which), multipliers=_multipliers(features, int(which)))
    return found


def _multipliers(features: Features, lane: int) -> np.ndarray | None:
    """Moduli and arguments of a lane's multipliers, None where there are none."""
    if "multiplier_abs" not in features:
        return None
    both = np.stack([features[f"multiplier_{name}"][lane] for name in ("abs", "arg")], axis=1)
    return both if np.isfinite(both).all() else None


def _why_not(sweep: Sweep, features: Features, parameters: dict[str, np.ndarray]) -> list[str]:
    """Why each lane has no motion, if it has none."""
    why = np.full(len(features["finite"]), "its motion was not found", object)
    why[~features["finished"]] = "failed: it took too many steps"
    why[~features["finite"]] = "failed: it is not finite"
    refusal = sweep.system.refused(parameters)
    if refusal is not None:
        why[np.broadcast_to(np.asarray(refusal[1]), why.shape)] = f"refused: {refusal[0].replace('-', ' ')}"
    return [str(text) for text in why]


def _begins(
    sweep: Sweep, chunks: Chunks, lanes: tuple[int, int], features: Features, parameters: dict[str, np.ndarray]
) -> Begin:
    """Where the motions of a chunk's lanes begin: on their orbits, at their last return, or where they have settled."""
    first, end = lanes
    scene, count = sweep.system, end - first
    driving = scene.driving_part()
    orbit = features["orbit_cycles"] > 0 if "orbit_cycles" in features else np.zeros(count, bool)
    state = np.zeros((len(scene.states), count))
    unknown = np.zeros(count, bool)
    for name in driving.return_states:
        last = features.get(f"last_{name}", np.full(count, np.nan))
        row = np.where(orbit, features.get(orbit_name(name), last), last)
        unknown |= ~np.isfinite(row)
        state[scene.place(name)] = row
    if not driving.return_states:
        unknown[:] = True
    period = features["period"] if "period" in features else 1 / parameters.get("frequency", np.full(count, np.nan))
    unknown |= ~(np.isfinite(period) & (period > 0))
    zero = np.zeros(count)
    cycles = np.where(orbit, features.get("orbit_cycles", zero), features.get("cycles", zero))
    returns = np.where(unknown, 0, np.where(cycles > 0, np.maximum(cycles, 1), SHOWN)).astype(int)
    repeats = ~unknown & (cycles > 0)
    before = np.where(unknown, 0.0, (DRIVEN_RETURNS if driving is not scene else 0) * period)
    duration = np.where(unknown, STILL, returns * period)
    # A little more than a repeat, so that the return that ends it is seen.
    whole = before + np.where(unknown, STILL, np.where(repeats, duration + 1e-3 * period, PASSED * period))
    if unknown.any() and not isinstance(chunks, Carried):
        some = np.flatnonzero(unknown)
        batch = chunks.engine.start(first, end, chunks.accuracy).of(some)
        [batch] = chunks.engine.settle([batch])
        assert batch.underway is not None
        state[:, some] = np.stack([np.asarray(x, float) for x in batch.underway.lane.state])
    elif unknown.any():
        state[:, unknown] = np.nan
    return Begin(state, repeats, before, duration, whole, returns)


@lane_function(static=1)
def _begun(scene: Scene[Any], p: dict[str, Any], state: Values) -> tuple[Any, Lane]:
    """(the scene's constants for motions from `state`, the lanes that start there)."""
    constants = scene.scaled(scene.constants(p), state)
    return constants, lane_at(scene, constants, state)


def recorded(scene: Scene[Any], parameters: dict[str, np.ndarray], begin: Begin) -> Iterator[Cell]:
    """The cells of lanes from where they begin."""
    stepper = Located()
    lanes = begin.state.shape[1]
    with precision("float64"):
        given = {name: parameters[name] for name in scene.parameters()}
        constants, lane = _begun(scene, given, tuple(begin.state))
        accuracy = Accuracy(*(np.float64(x) for x in STEPS))
        parts = []
        for _ in range(MOST_BATCHES):
            lane, part = record_batch(scene, stepper, STEPS_AT_ONCE, constants, lane, accuracy, begin.whole)
            parts.append({name: np.asarray(x) for name, x in part.items()})
            if not (np.asarray(lane.clock.until(begin.whole)) > 0).any():
                break
        record = {name: np.concatenate([part[name] for part in parts]) for name in Record._fields}
        events = _events(scene, constants, record)
    for at in range(lanes):
        alone = {name: x[..., at] for name, x in record.items()}
        own = {name: mask[:, at] for name, mask in events.items()}
        yield _cell(scene, alone, own, Begin(*(x[..., at] for x in begin)))


STEPS_AT_ONCE = 64


def _events(scene: Scene[Any], c: Any, record: Steps) -> dict[str, np.ndarray]:
    """Which steps (steps, lanes) end on what, by the names of `EVENTS`."""
    hits = {name: record["hits"][:, at] for at, name in enumerate(scene.event_names)}
    masks: dict[str, np.ndarray] = {}
    if isinstance(scene, HasFriction):
        slip = record["mode"][:, scene.mode_place("slip")]
        after = np.concatenate([slip[1:], slip[-1:]])
        masks["stick"] = hits["friction"] & (slip != 0) & (after == 0)
        masks["slip"] = hits["friction"] & (after != 0)
    shape = record["dt"].shape
    if isinstance(scene, HasContact):
        flat = _along_steps(c, shape)
        modes, states = (tuple(np.moveaxis(x, 1, 0).reshape(x.shape[1], -1)) for x in (record["mode"], record["after"]))
        flags = {name: mask.ravel() for name, mask in hits.items()}
        masks["impact"] = np.asarray(impact_begins(scene, flat, modes, states, flags)).reshape(shape)
        masks["release"] = hits["contact"] & (record["mode"][:, scene.mode_place("touching")] != 0)
    masks["section"] = _passes(scene, c, record, hits)
    return masks


def _along_steps(c: Any, shape: tuple[int, ...]) -> Any:
    """Constants of lanes for all their steps, flat."""
    import jax

    return jax.tree.map(lambda x: np.broadcast_to(np.asarray(x), shape).ravel(), c)


def _passes(scene: Scene[Any], c: Any, record: Steps, hits: dict[str, np.ndarray]) -> np.ndarray:
    """Steps that end on the section, having been beyond the level that re-arms it; under pulses, where one begins."""
    shape = record["dt"].shape
    section = scene.section
    if section is None:
        begins = getattr(scene, "pulse_begins", None)
        if begins is None or "pulse" not in hits:
            return np.zeros(shape, bool)
        return np.asarray(begins(c, tuple(np.moveaxis(record["mode"], 1, 0)), hits))
    sign, marker = 1.0 if section.rising else -1.0, scene.marker_of(section.velocity)
    falling = record["falling"][:, scene.marker_names.index(marker)]
    returns = hits[marker] & (~falling if section.rising else falling)
    tau = np.where(record["dt"] > 0, record["dt"] / np.where(record["h"] > 0, record["h"], 1), 0)
    series = np.moveaxis(record["polynomials"][:, scene.place(section.velocity)], 1, 0)
    least = np.asarray(lowest_velocity([sign * one.ravel() for one in series], tau.ravel())).reshape(shape)
    low = least < sign * np.asarray(section.rearm(c))
    armed, passed = np.zeros(shape[1], bool), np.zeros(shape, bool)
    for step in range(shape[0]):
        armed |= low[step]
        passed[step] = returns[step] & armed
        armed &= ~passed[step]
    return passed


def _along_motion(record: Record, begin: float, duration: float, count: int) -> np.ndarray:
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


_FINE = 6
"""Places in each step at which the way that the states pass is measured."""

_URGENCE = ("section", "release", "slip", "stick", "impact")
"""Events of one instant: the last of them is shown."""


def _cell(scene: Scene[Any], steps: Steps, events: dict[str, np.ndarray], begin: Begin) -> Cell:
    """One lane's cell from its steps."""
    taken = (steps["dt"] > 0) | steps["hits"].any(axis=1)
    steps = {name: x[taken] for name, x in steps.items()}
    record = Record(**steps)
    end = steps["start"] + steps["dt"]
    reached = float(end[-1]) if len(end) else 0.0
    from_, duration = float(begin.before), float(begin.duration)
    if not begin.returns:  # of what passes no section, as much as was recorded
        duration = min(duration, reached)
    if not duration > 0 or reached < from_ + 0.999 * duration or not np.isfinite(steps["after"]).all():
        return Cell(-1, "none", "its motion could not be recorded: it took too many steps")
    even = min(EVEN * max(int(begin.returns), 1), MOST_EVEN)
    marked = steps["hits"].any(axis=1) & (end > from_) & (end < from_ + duration)
    times = np.unique(np.concatenate([_along_motion(record, from_, duration, even), end[marked]]))
    least = duration * 1e-6
    times = times[np.concatenate([[True], np.diff(times) > least])]
    states, modes, step_of = sample(record, times)
    shown = states_shown(scene, Motion(times, states, modes), record, step_of)
    flags = np.zeros(len(times), np.uint8)
    if isinstance(scene, HasFriction):
        flags |= np.where(modes[scene.mode_place("slip")] == 0, STUCK, 0).astype(np.uint8)
    if isinstance(scene, HasContact):
        flags |= np.where(modes[scene.mode_place("touching")] != 0, TOUCHING, 0).astype(np.uint8)
    for name in _URGENCE:
        if name in events:
            when = end[events[name][taken]]
            at = np.searchsorted(times, when - least)
            inside = (when >= from_ - least) & (when <= from_ + duration + least) & (at < len(times))
            flags[at[inside]] = flags[at[inside]] & (STUCK | TOUCHING) | EVENTS.index(name)
    last = from_ + duration + least if begin.orbit else np.inf
    passed = np.flatnonzero(events["section"][taken] & (end > from_ + least) & (end < last))[:PASSED]
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
        time=times - from_,
        states={name: np.asarray(one.values) for name, one in shown.items()},
        flags=flags,
        section=section,
    )
