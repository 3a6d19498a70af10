"""When the bit sticks and slips, when impacts begin and end, and when the section is passed."""

import jax.numpy as jnp
import numpy as np

from vibrojax.measure.section import ARMED_BELOW, lowest

KINDS = ("none", "stick", "slip", "impact", "release", "section")
"""Meaning of the flags of `event_kind`."""


def events(scene, p, record) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and kinds, indices into `KINDS`, of what happened, in order.

    **Arguments:** `p`: the scene's constants; `record`: the steps of one lane.
    """
    time = record.start + record.dt
    if "slip" not in scene.modes:
        return np.zeros(0), np.zeros(0, np.int8)
    slip = record.mode[:, scene.modes.index("slip")]
    after = np.append(slip[1:], slip[-1:])
    friction = record.hits[:, scene.surfaces_named.index("friction")]
    found = {"stick": friction & (slip != 0) & (after == 0), "slip": friction & (after != 0)}
    if "contact" in scene.surfaces_named:
        hits, modes, states = tuple(record.hits.T), tuple(record.mode.T), tuple(record.after.T)
        found["impact"] = np.asarray(scene.impact_begins(p, modes, states, hits))
        contact = record.hits[:, scene.surfaces_named.index("contact")]
        found["release"] = contact & (record.mode[:, scene.modes.index("touching")] != 0)
    found["section"] = _sections(scene, p, record)
    kinds = np.concatenate([np.full(mask.sum(), KINDS.index(name)) for name, mask in found.items()])
    times = np.concatenate([time[mask] for mask in found.values()])
    order = np.argsort(times, kind="stable")
    return times[order], kinds[order].astype(np.int8)


def _sections(scene, p, record) -> np.ndarray:
    """Steps that end on the section: x1' rises through zero, having been below -0.05 v since the last one."""
    rises = record.hits[:, scene.bit_turn] & ~record.falling[:, 0]
    armed, passed = False, np.zeros(len(rises), bool)
    # A step taken for a mere switch has no length, and nothing falls in it.
    tau = np.where(record.dt > 0, record.dt / np.where(record.h > 0, record.h, 1), 0)
    velocity = [jnp.asarray(c) for c in record.polynomials[:, 1].T]
    low = np.asarray(lowest(velocity, jnp.asarray(tau))) < -ARMED_BELOW * float(np.ravel(p["v"])[0])
    for index in np.flatnonzero(rises | low):
        armed = armed or low[index]
        passed[index] = rises[index] and armed
        armed = armed and not passed[index]
    return passed
