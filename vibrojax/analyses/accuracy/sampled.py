"""Features of a smoothed motion, computed from samples for solvers that do not measure features while stepping.

Events between samples are located by one integration step from the preceding sample, in the mode at that sample. Event
times have the order of accuracy of this step, independent of the sampling.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from vibrojax.measures.ledger import MOST_CYCLES
from vibrojax.measures.repeats import REPEATS_WITHIN
from vibrojax.models.arrays import Array
from vibrojax.models.scenes import HasContact, HasFriction, Scene
from vibrojax.models.scenes.scene import ARMED_BELOW
from vibrojax.stepping.smoothed import STICK_WIDTHS, runge_kutta

EVENT_NEWTON_ITERATIONS = 5
EVENTS_PER_CALL = 128  # fixed, so that one compiled program serves any number of events

Constants = Any
"""A scene's constants, each of shape (lanes,)."""

Events = Int[np.ndarray, " events"]


@dataclass(frozen=True)
class _Motion:
    """Smoothed motion of one lane: constants `p`, `states` every `interval` [s], and friction switch `width` [m/s]."""

    scene: HasFriction[Any]
    p: Constants
    interval: float
    states: Float[np.ndarray, "states samples"]
    width: float


def features_of(
    scene: Scene[Any],
    p: Constants,
    sampling: float,
    states: Float[np.ndarray, "states lanes samples"],
    width: float,
) -> dict[str, Shaped[np.ndarray, " lanes"]]:
    """Return period, cycles, stick_fraction; with a contact also impacts, impact_velocity and peak_impact_force.

    **Arguments:** `p`: the scene's constants (lanes,); `sampling`: sampling interval [s]; `width`: width [m/s] of the
    friction switch.
    """
    assert isinstance(scene, HasFriction)
    lanes = []
    for lane in range(states.shape[1]):
        constants = jax.tree.map(lambda x, k=lane: x[k], p)
        lanes.append(_lane_features(_Motion(scene, constants, sampling, states[:, lane].astype(float), width)))
    return {name: np.array([features[name] for features in lanes]) for name in lanes[0]}


def _lane_features(motion: _Motion) -> dict[str, float | int]:
    scene, states, p = motion.scene, motion.states, motion.p
    undefined: dict[str, float | int] = {"period": np.nan, "cycles": 0, "stick_fraction": np.nan}
    if isinstance(scene, HasContact):
        undefined |= {"impacts": 0, "impact_velocity": np.nan, "peak_impact_force": np.nan}
    if not np.isfinite(states).all():
        return undefined
    v = float(scene.bit(p).drive_speed)
    times, section = _locate(motion, _returns(states[1], -ARMED_BELOW * v), 1, 0.0)
    if len(times) < 3:
        return undefined
    bit, striker = np.ptp(states[0]) / 2, np.ptp(states[2]) / 2
    scale = np.array([bit, striker, striker * 2 * np.pi / np.diff(times).mean()])
    cycles = _cycles(section[[0, 2, 3]] / scale[:, None])
    returns = len(times) - 1
    returns -= returns % cycles if cycles else 0
    begin, end = float(times[0]), float(times[returns])
    stuck = np.abs(states[1] + v) <= STICK_WIDTHS * motion.width
    stick_fraction = _share(stuck, motion.interval, begin, end)
    features = {"period": (end - begin) / returns, "cycles": cycles, "stick_fraction": stick_fraction}
    if not isinstance(scene, HasContact):
        return features
    x2, delta = states[2], float(p.contact.delta)
    times, contact = _locate(motion, np.flatnonzero((x2[:-1] < delta) & (x2[1:] >= delta)), 2, delta)
    inside = (times >= begin) & (times < end)
    number = int(inside.sum())
    samples = tuple(jnp.asarray(x, scene.speed_scale(p).dtype) for x in states)
    force = np.asarray(scene.contact_force(p, scene.mode_at(p, samples), samples), float)
    return features | {
        "impacts": round(number / returns * cycles) if cycles else number / returns,
        "impact_velocity": float(contact[3][inside].mean()) if number else np.nan,
        "peak_impact_force": _peak(force),
    }


def _returns(v1: Float[np.ndarray, " samples"], below: float) -> Events:
    """Return the indices of the samples before section crossings: v1 rises through zero after it was below `below`."""
    returns, since = [], 0
    for index in np.flatnonzero((v1[:-1] <= 0) & (v1[1:] > 0)).tolist():
        if v1[since : index + 1].min() < below:
            returns.append(index)
            since = index + 1
    return np.array(returns, int)


def _locate(
    motion: _Motion, before: Events, which: int, level: float
) -> tuple[Float[np.ndarray, " events"], Float[np.ndarray, "states events"]]:
    """Return the times [s] at which state `which` reaches `level` after the samples `before`, and all states then."""
    begin = motion.states[:, before]
    if not before.size:
        return np.zeros(0), begin
    parts = []
    for first in range(0, before.size, EVENTS_PER_CALL):
        part = begin[:, first : first + EVENTS_PER_CALL]
        padded = tuple(np.pad(part, ((0, 0), (0, EVENTS_PER_CALL - part.shape[1])), mode="edge"))
        elapsed, states = _step_to(motion.scene, which, motion.p, padded, motion.interval, motion.width, level)
        parts.append(np.stack([elapsed, *states])[:, : part.shape[1]])
    events = np.concatenate(parts, axis=1).astype(float)
    return before * motion.interval + events[0], events[1:]


@partial(jax.jit, static_argnames=("scene", "which"))
def _step_to(
    scene: HasFriction[Any],
    which: int,
    p: Constants,
    state: tuple[Float[Array, " events"], ...],
    interval: Float[Array, ""],
    width: Float[Array, ""],
    level: Float[Array, ""],
) -> tuple[Float[Array, " events"], tuple[Float[Array, " events"], ...]]:
    """Return the time [s] from `state` until state `which` reaches `level`, by Newton's method, and all states then."""
    dtype = scene.speed_scale(p).dtype
    state = tuple(jnp.asarray(y, dtype) for y in state)
    interval, width, level = (jnp.asarray(x, dtype) for x in (interval, width, level))
    mode = scene.mode_at(p, state)

    def rates(y: tuple[Array, ...]) -> tuple[Array, ...]:
        return scene.smoothed_field(p, mode, y, width)

    elapsed, reached = jnp.zeros_like(state[0]), state
    for _ in range(EVENT_NEWTON_ITERATIONS):
        elapsed = jnp.clip(elapsed - (reached[which] - level) / rates(reached)[which], 0, interval)
        reached, _ = runge_kutta(rates, state, elapsed)
    return elapsed, reached


def _cycles(section: Float[np.ndarray, "3 returns"]) -> int:
    """Return the period, in returns, of the scaled states at the section; 0 if they are not periodic."""
    for repeat in range(1, MOST_CYCLES + 1):
        if section.shape[1] < 3 * repeat + 1:
            return 0
        if np.abs(section[:, repeat:] - section[:, :-repeat]).max() < REPEATS_WITHIN:
            return repeat
    return 0


def _share(mask: Bool[np.ndarray, " samples"], interval: float, begin: float, end: float) -> float:
    """Return the fraction of the time from `begin` to `end` [s] in which the mask is true, by the trapezoidal rule."""
    weight = mask.astype(float)
    total = np.concatenate([[0.0], np.cumsum((weight[1:] + weight[:-1]) / 2)]) * interval
    ends = np.interp([begin, end], np.arange(len(weight)) * interval, total)
    return float((ends[1] - ends[0]) / (end - begin))


def _peak(force: Float[np.ndarray, " samples"]) -> float:
    """Return the maximum of a sampled signal, by the parabola through the largest sample and its neighbours."""
    top = int(np.argmax(force[1:-1])) + 1
    before, most, after = force[top - 1 : top + 2]
    bend = before - 2 * most + after
    return float(most if bend >= 0 else most - (after - before) ** 2 / (8 * bend))
