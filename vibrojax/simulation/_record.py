"""One lane, step by step: every step's polynomial is kept, so that the motion can be read at any time."""

from functools import partial
from math import ceil
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from vibrojax.errors import InputError
from vibrojax.stepping import lane_at

BATCH = 4096
MOST_STEPS = 2500 * BATCH


class Record(NamedTuple):
    """The steps of one lane: numpy arrays with steps along the first axis.

    `start`, `h`, `dt` [s]; `polynomials` (steps, states, orders) in (t - start)/h; `mode` (steps, modes);
    `after` (steps, states); `hits` (steps, surfaces and markers); `falling` (steps, markers).
    """

    start: np.ndarray
    h: np.ndarray
    dt: np.ndarray
    polynomials: np.ndarray
    mode: np.ndarray
    after: np.ndarray
    hits: np.ndarray
    falling: np.ndarray


def record(scene, method, p, state, settings, duration, told=None, most_steps=MOST_STEPS) -> Record:
    """Step one lane, of shape (1,), from t = 0 to `duration` [s]; `told(t)` hears how far it is.

    Raises `InputError` where that takes over `most_steps`, ten million unless there is no room for so many.
    """
    p = scene.scaled(p, state)
    lane = lane_at(scene, p, state)
    parts = []
    for _ in range(ceil(most_steps / BATCH)):
        lane, part = _batch(scene, method, p, lane, settings, duration)
        parts.append(jax.tree.map(np.asarray, part))
        if told:
            told(float(lane.clock.high[0]))
        if not float(lane.clock.until(duration)[0]) > 0:
            whole = jax.tree.map(lambda *x: np.concatenate(x), *parts)
            taken = whole.dt > 0
            taken |= whole.hits.any(axis=1)
            return Record(*(x[taken] for x in whole))
    reached = float(lane.clock.high[0])
    raise InputError(
        f"simulate: duration: {most_steps} steps, all there is room for, led to {reached:.3g} s of "
        f"{float(duration):g} s; give a shorter duration, or a softer contact"
    )


@partial(jax.jit, static_argnames=("scene", "method"))
def _batch(scene, method, p, lane, settings, duration):
    def one(lane, _):
        moving = lane.clock.until(duration) > 0
        new, step = method.step(scene, p, lane, settings, duration, moving)
        kept = Record(
            start=lane.clock.high[0],
            h=step.h[0],
            dt=step.dt[0],
            polynomials=jnp.stack([jnp.stack([c[0] for c in series]) for series in step.polynomials]),
            mode=jnp.stack([m[0] for m in step.mode]),
            after=jnp.stack([y[0] for y in step.after]),
            hits=jnp.stack([hit[0] for hit in step.hits]),
            falling=jnp.stack([down[0] for down in step.falling]),
        )
        return new, kept

    return jax.lax.scan(one, lane, length=BATCH)


def sample(record: Record, times) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States (states, samples) and modes (modes, samples) at `times` [s], read off the steps' polynomials; and which
    of the moving steps each sample is of."""
    moving = record.dt > 0
    start, h = record.start[moving], record.h[moving]
    step = np.clip(np.searchsorted(start, times, side="right") - 1, 0, len(start) - 1)
    tau = np.minimum(times - start[step], record.dt[moving][step]) / h[step]
    states = _value(record.polynomials[moving][step], tau)
    return states.T, record.mode[moving][step].T, step


def accumulated(record: Record, state: int) -> np.ndarray:
    """What to add in each moving step to a state that is set back to zero now and then, so that it is not."""
    moving = record.dt > 0
    polynomials = record.polynomials[moving][:, state : state + 1]
    start = polynomials[:, 0, 0]
    growth = _value(polynomials, record.dt[moving] / record.h[moving])[:, 0] - start
    return np.concatenate([[0.0], np.cumsum(growth)[:-1]]) - start


def _value(coefficients, tau) -> np.ndarray:
    """Polynomials (steps, states, orders) at tau (steps,)."""
    values = coefficients[:, :, -1]
    for order in range(coefficients.shape[2] - 2, -1, -1):
        values = values * tau[:, None] + coefficients[:, :, order]
    return values
