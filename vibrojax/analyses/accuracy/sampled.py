"""Features of a smoothed motion from its samples, for solvers that measure nothing while they step.

Events are located between samples by a step from the sample before, in the mode that holds there, to where the section
or the contact is reached: their times are exact to the order of that step, whatever the sampling.
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

_NEWTON = 5
_EVENTS = 128  # located together, whatever their number, so that one compiled program does

Constants = Any
"""A scene's constants, each (lanes,)."""

Values = tuple[Array, ...]
"""States or modes of a scene."""


Samples = Float[np.ndarray, " samples"]


@dataclass(frozen=True)
class _Motion:
    """The smoothed motion of one lane: constants `p`, `states` every `interval` [s], and the switch's `width` [m/s]."""

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
    """period, cycles, stick_fraction, and with a contact impacts, impact_velocity, peak_impact_force.

    **Arguments:**

    - `p`: the scene's constants (lanes,); `sampling` [s]: interval of the samples; `width` [m/s]: of the switch.
    """
    assert isinstance(scene, HasFriction)
    lanes = [
        _lane_features(
            _Motion(scene, jax.tree.map(lambda x, k=lane: x[k], p), sampling, states[:, lane].astype(float), width)
        )
        for lane in range(states.shape[1])
    ]
    return {name: np.array([one[name] for one in lanes]) for name in lanes[0]}


def _lane_features(motion: _Motion) -> dict[str, float | int]:
    scene, states = motion.scene, motion.states
    contact = isinstance(scene, HasContact)
    nothing: dict[str, float | int] = {"period": np.nan, "cycles": 0, "stick_fraction": np.nan}
    if contact:
        nothing |= {"impacts": 0, "impact_velocity": np.nan, "peak_impact_force": np.nan}
    if not np.isfinite(states).all():
        return nothing
    v = float(scene.bit(motion.p).drive_speed)
    times, at = _located(motion, _armed(states[1], -ARMED_BELOW * v), 1, 0.0)
    if len(times) < 3:
        return nothing
    bit, striker = np.ptp(states[0]) / 2, np.ptp(states[2]) / 2
    scale = np.array([bit, striker, striker * 2 * np.pi / np.diff(times).mean()])
    cycles = _cycles(at[[0, 2, 3]] / scale[:, None])
    returns = len(times) - 1
    returns -= returns % cycles if cycles else 0
    begin, end = float(times[0]), float(times[returns])
    stuck = np.abs(states[1] + v) <= STICK_WIDTHS * motion.width
    features: dict[str, float | int] = {
        "period": (end - begin) / returns,
        "cycles": cycles,
        "stick_fraction": _share(stuck, motion.interval, begin, end),
    }
    if not isinstance(scene, HasContact):
        return features
    number, velocity = _impacts(motion, begin, end)
    impacts = round(number / returns * cycles) if cycles else number / returns
    peak = _peak(_force(scene, motion.p, states))
    return features | {"impacts": impacts, "impact_velocity": velocity, "peak_impact_force": peak}


def _impacts(motion: _Motion, begin: float, end: float) -> tuple[int, float]:
    """Number of impacts from `begin` to before `end` [s], and their mean velocity [m/s]."""
    x2, delta = motion.states[2], float(motion.p.contact.delta)
    times, at = _located(motion, np.flatnonzero((x2[:-1] < delta) & (x2[1:] >= delta)), 2, delta)
    inside = (times >= begin) & (times < end)
    return int(inside.sum()), float(at[3][inside].mean()) if inside.any() else np.nan


def _armed(v1: Float[np.ndarray, " samples"], below: float) -> Int[np.ndarray, " events"]:
    """Samples before v1 rises through zero, having been slower than `below` since the return before."""
    returns, since = [], 0
    for index in np.flatnonzero((v1[:-1] <= 0) & (v1[1:] > 0)).tolist():
        if v1[since : index + 1].min() < below:
            returns.append(index)
            since = index + 1
    return np.array(returns, int)


def _located(
    motion: _Motion, before: Int[np.ndarray, " events"], which: int, level: float
) -> tuple[Float[np.ndarray, " events"], Float[np.ndarray, "states events"]]:
    """When [s] after each of the samples `before` one state (`which`) reaches `level`, and the states there."""
    starts = motion.states[:, before]
    if not before.size:
        return np.zeros(0), starts
    parts = []
    for first in range(0, before.size, _EVENTS):
        some = starts[:, first : first + _EVENTS]
        filled = tuple(np.pad(some, ((0, 0), (0, _EVENTS - some.shape[1])), mode="edge"))
        late, reached = _step_to(motion.scene, which, motion.p, filled, motion.interval, motion.width, level)
        parts.append(np.stack([late, *reached])[:, : some.shape[1]])
    whole = np.concatenate(parts, axis=1).astype(float)
    return before * motion.interval + whole[0], whole[1:]


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
    """How long [s] after `state` one state reaches `level`, by Newton's method on the step; and the state there."""
    dtype = scene.speed_scale(p).dtype
    state = tuple(jnp.asarray(y, dtype) for y in state)
    interval, width, level = (jnp.asarray(x, dtype) for x in (interval, width, level))
    mode = scene.mode_at(p, state)

    def rates(y: Values) -> Values:
        return scene.smoothed_field(p, mode, y, width)

    late, reached = jnp.zeros_like(state[0]), state
    for _ in range(_NEWTON):
        late = jnp.clip(late - (reached[which] - level) / rates(reached)[which], 0, interval)
        reached, _ = runge_kutta(rates, state, late)
    return late, reached


def _cycles(section: Float[np.ndarray, "3 returns"]) -> int:
    """The least number of returns after which the scaled states at the section repeat; 0: they do not."""
    for repeat in range(1, MOST_CYCLES + 1):
        if section.shape[1] < 3 * repeat + 1:
            return 0
        if np.abs(section[:, repeat:] - section[:, :-repeat]).max() < REPEATS_WITHIN:
            return repeat
    return 0


def _share(holds: Bool[np.ndarray, " samples"], interval: float, begin: float, end: float) -> float:
    """Share of the time from `begin` to `end` [s] in which it `holds`, by the trapezoidal rule."""
    weight = holds.astype(float)
    total = np.concatenate([[0.0], np.cumsum((weight[1:] + weight[:-1]) / 2)]) * interval
    ends = np.interp([begin, end], np.arange(len(weight)) * interval, total)
    return float((ends[1] - ends[0]) / (end - begin))


def _force(scene: HasContact[Any], p: Constants, states: Float[np.ndarray, "states samples"]) -> Samples:
    """Contact force [N] at the samples."""
    y = tuple(jnp.asarray(x, scene.speed_scale(p).dtype) for x in states)
    return np.asarray(scene.contact_force(p, scene.mode_at(p, y), y), float)


def _peak(force: Samples) -> float:
    """Greatest of the samples, by the parabola through it and its neighbours."""
    top = int(np.argmax(force[1:-1])) + 1
    left, most, right = force[top - 1 : top + 2]
    bend = left - 2 * most + right
    return float(most if bend >= 0 else most - (right - left) ** 2 / (8 * bend))
