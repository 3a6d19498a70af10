"""Features of a smoothed motion from its samples, for solvers that measure nothing while they step.

Events are told between samples by a step from the sample before, in the mode that holds there, to where the section or
the contact is reached: their times are exact to the order of that step, whatever the sampling.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.measure.ledger import MOST_CYCLES
from vibrojax.measure.section import ARMED_BELOW, REPEATS_WITHIN
from vibrojax.stepping.smoothed import STICK_WIDTHS, runge_kutta

_NEWTON = 5
_EVENTS = 128  # landed on together, whatever their number, so that one compiled program does


def features_of(scene, p, sampling: float, states: np.ndarray, width: float) -> dict:
    """period, cycles, stick_fraction, and with a contact impacts, impact_velocity, peak_impact_force.

    **Arguments:**

    - `p`: the scene's constants (lanes,); `sampling` [s]: interval of the samples; `width` [m/s]: of the switch.
    - `states`: (states, lanes, samples).
    """
    lanes = [
        _of_one(scene, {name: x[lane] for name, x in p.items()}, sampling, states[:, lane].astype(float), width)
        for lane in range(states.shape[1])
    ]
    return {name: np.array([one[name] for one in lanes]) for name in lanes[0]}


def _of_one(scene, p, sampling, states, width) -> dict:
    contact = hasattr(scene, "contact_force")
    nothing = {"period": np.nan, "cycles": 0, "stick_fraction": np.nan}
    if contact:
        nothing |= {"impacts": 0, "impact_velocity": np.nan, "peak_impact_force": np.nan}
    if not np.isfinite(states).all():
        return nothing
    v = float(p["v"])
    overtakes = _armed(states[1], -ARMED_BELOW * v)
    late, at = _landed(scene, p, sampling, states[:, overtakes], width, 1, 0.0)
    times = overtakes * sampling + late
    if len(times) < 3:
        return nothing
    bit, striker = np.ptp(states[0]) / 2, np.ptp(states[2]) / 2
    scale = np.array([bit, striker, striker * 2 * np.pi / np.diff(times).mean()])
    cycles = _cycles(at[[0, 2, 3]] / scale[:, None])
    returns = len(times) - 1
    returns -= returns % cycles if cycles else 0
    first, last = times[0], times[returns]
    stuck = np.abs(states[1] + v) <= STICK_WIDTHS * width
    found = {
        "period": (last - first) / returns,
        "cycles": cycles,
        "stick_fraction": _share(stuck, sampling, first, last),
    }
    if not contact:
        return found
    number, velocity = _impacts(scene, p, sampling, states, width, first, last)
    impacts = round(number / returns * cycles) if cycles else number / returns
    return found | {"impacts": impacts, "impact_velocity": velocity, "peak_impact_force": _peak(scene, p, states)}


def _impacts(scene, p, sampling, states, width, first, last) -> tuple[int, float]:
    """Number of impacts from `first` to before `last` [s], and their mean velocity [m/s]."""
    delta = float(p["delta"])
    begins = np.flatnonzero((states[2, :-1] < delta) & (states[2, 1:] >= delta))
    late, at = _landed(scene, p, sampling, states[:, begins], width, 2, delta)
    times = begins * sampling + late
    inside = (times >= first) & (times < last)
    return int(inside.sum()), float(at[3][inside].mean()) if inside.any() else np.nan


def _armed(v1, below) -> np.ndarray:
    """Samples before v1 rises through zero, having been slower than `below` since the last time (contract: section)."""
    kept, last = [], 0
    for index in np.flatnonzero((v1[:-1] <= 0) & (v1[1:] > 0)):
        if v1[last : index + 1].min() < below:
            kept.append(index)
            last = index + 1
    return np.array(kept, int)


def _landed(scene, p, sampling, before, width, state: int, level: float) -> tuple[np.ndarray, np.ndarray]:
    """How long [s] after the samples `before` (states, events) one `state` reaches `level`, and the states there."""
    events = before.shape[1]
    if not events:
        return np.zeros(0), before
    found = []
    for first in range(0, events, _EVENTS):
        some = before[:, first : first + _EVENTS]
        filled = np.pad(some, ((0, 0), (0, _EVENTS - some.shape[1])), mode="edge")
        late, reached = _land(scene, state, p, tuple(filled), sampling, width, level)
        found.append(np.stack([late, *reached])[:, : some.shape[1]])
    whole = np.concatenate(found, axis=1).astype(float)
    return whole[0], whole[1:]


@partial(jax.jit, static_argnames=("scene", "which"))
def _land(scene, which, p, state, sampling, width, level):
    dtype = p["m1"].dtype
    state = tuple(jnp.asarray(y, dtype) for y in state)
    sampling, width, level = (jnp.asarray(x, dtype) for x in (sampling, width, level))
    mode = scene.mode_at(p, state)

    def rates(y):
        return scene.smoothed_field(p, mode, y, width)

    late, reached = jnp.zeros_like(state[0]), state
    for _ in range(_NEWTON):
        late = jnp.clip(late - (reached[which] - level) / rates(reached)[which], 0, sampling)
        reached, _ = runge_kutta(rates, state, late)
    return late, reached


def _cycles(s: np.ndarray) -> int:
    """The least number of returns after which the scaled section states `s` (3, returns) repeat; 0: they do not."""
    for repeat in range(1, MOST_CYCLES + 1):
        if s.shape[1] < 3 * repeat + 1:
            return 0
        if np.abs(s[:, repeat:] - s[:, :-repeat]).max() < REPEATS_WITHIN:
            return repeat
    return 0


def _share(held: np.ndarray, sampling: float, first: float, last: float) -> float:
    """Share of the time from `first` to `last` [s] in which it is `held`, by the trapezoidal rule."""
    held = held.astype(float)
    total = np.concatenate([[0.0], np.cumsum((held[1:] + held[:-1]) / 2)]) * sampling
    ends = np.interp([first, last], np.arange(len(held)) * sampling, total)
    return float((ends[1] - ends[0]) / (last - first))


def _peak(scene, p, states) -> float:
    """Greatest contact force [N], by the parabola through the greatest sample and its neighbours."""
    y = tuple(jnp.asarray(x, p["m1"].dtype) for x in states)
    force = np.asarray(scene.contact_force(p, scene.mode_at(p, y), y), float)
    top = int(np.argmax(force[1:-1])) + 1
    left, most, right = force[top - 1 : top + 2]
    bend = left - 2 * most + right
    return float(most if bend >= 0 else most - (right - left) ** 2 / (8 * bend))
