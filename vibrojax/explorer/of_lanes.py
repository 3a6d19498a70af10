"""The motions of a sweep's lanes as cells: of lanes that repeat one repeat of their orbit, of others some returns.

They follow from where the lanes ended: the sweep is run again with its orbits, which says at which state each lane
passes the section; from there its steps are recorded, many lanes at once, and read at evenly spaced times and at
events.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vibrojax.analyses.sweep.workers.work import quiet
from vibrojax.explorer.cells import Cell
from vibrojax.explorer.recorded import LANES, recorded
from vibrojax.explorer.sampled import PASSED, SHOWN, STILL, Begin
from vibrojax.io.variables import orbit_name
from vibrojax.measures.kept_returns import state_name
from vibrojax.periodic import Orbits, early_ends
from vibrojax.periodic.measured import DRIVEN_RETURNS
from vibrojax.progress import Progress
from vibrojax.sweep.engine.batch import Features
from vibrojax.sweep.engine.carried import Carried
from vibrojax.sweep.engine.chunks import Chunks
from vibrojax.sweep.input.definition import Sweep


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
