"""The steps of many lanes at once, from where their motions begin, and what happens at their ends."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from vibrojax.compile.devices import precision
from vibrojax.explorer.cells import Cell
from vibrojax.explorer.sampled import Begin, Steps, cell_of_steps
from vibrojax.models.scenes import HasContact, HasFriction, Scene
from vibrojax.models.scenes.declared import Values
from vibrojax.stepping import LOCATED_STRIDE, Accuracy, Lane, Located, lane_at
from vibrojax.sweep.engine.compiler import lane_function
from vibrojax.sweep.simulation.dense_output import Record, record_batch
from vibrojax.sweep.simulation.trajectory import impact_begins, lowest_velocity

LANES = 128
"""Lanes that are recorded at once: their steps take some 20 MB."""

MOST_BATCHES = 40
"""Of steps, after which a lane's record is cut off."""

STEPS = Accuracy(tolerance=1e-9, stride=LOCATED_STRIDE, step=np.inf)
"""Of what is recorded."""

STEPS_AT_ONCE = 64
"""Of each lane, in a batch."""


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
        events = events_of(scene, constants, record)
    for at in range(lanes):
        alone = {name: x[..., at] for name, x in record.items()}
        own = {name: mask[:, at] for name, mask in events.items()}
        yield cell_of_steps(scene, alone, own, Begin(*(x[..., at] for x in begin)))


def events_of(scene: Scene[Any], c: Any, record: Steps) -> dict[str, np.ndarray]:
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
