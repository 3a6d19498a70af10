"""Returns to the section: the instant at which the bit overtakes the drive (contract: dataset).

x1' rises through zero, having been below -0.05 v since the last return. Here a lane's repeats are found, and when it
settled.
"""

import jax.numpy as jnp

from vibrojax.measure.ledger import MOST_CYCLES
from vibrojax.stepping import keep

REPEATS_WITHIN = 1e-3
SETTLED_WITHIN = 0.01
ARMED_BELOW = 0.05


def begin(lane) -> dict:
    """What is known of returns at t = 0."""
    x1, _, x2, _ = lane.state[:4]
    nothing = jnp.full((MOST_CYCLES, *x1.shape), jnp.nan, x1.dtype)
    zero = jnp.zeros_like(x1)
    return {
        "armed": jnp.zeros_like(x1, bool),
        "waiting": jnp.zeros_like(x1, bool),
        "since": zero,
        "swing1": (x1, x1),
        "swing2": (x2, x2),
        "states": jnp.stack([nothing] * 3, axis=1),
        "times": nothing,
        "settled": jnp.zeros_like(nothing),
        "frequency": zero,
        "phase": zero,
        "number": zero,
        "worst": jnp.zeros((MOST_CYCLES, 3, *x1.shape), x1.dtype),
    }


def observe(carry: dict) -> dict:
    """What is known of returns at the beginning of the observation: returns are counted anew."""
    return carry | {"number": jnp.zeros_like(carry["number"]), "worst": jnp.zeros_like(carry["worst"])}


def step(scene, p, carry: dict, lane, step) -> dict:
    """Take in a step: extremes since the last return, and whether it ends on the section."""
    x1, v1, x2, _ = lane.state[:4]
    overtakes = step.hits[scene.bit_turn] & ~step.falling[0] & carry["armed"]
    return carry | {
        "armed": carry["armed"] | (v1 < -ARMED_BELOW * p["v"]),
        "waiting": carry["waiting"] | overtakes,
        "since": carry["since"] + step.dt,
        "phase": carry["phase"] + carry["frequency"] * step.dt,
        "swing1": _widened(carry["swing1"], x1),
        "swing2": _widened(carry["swing2"], x2),
    }


def _widened(extremes, x):
    lowest, highest = extremes
    return jnp.minimum(lowest, x), jnp.maximum(highest, x)


def section_state(lane):
    """(x1, x2, x2') at the section, stacked along a first axis of 3."""
    x1, _, x2, v2 = lane.state[:4]
    return jnp.stack([x1, x2, v2])


def amplitudes(carry: dict):
    """Half the swings of x1 and x2 since the last return [m]."""
    return tuple((highest - lowest) / 2 for lowest, highest in (carry["swing1"], carry["swing2"]))


def turn_over(carry: dict, lane) -> dict:
    """Take in the returns of the lanes that wait at the section, and let them go on."""
    here = carry["waiting"]
    state = section_state(lane)
    bit, striker = amplitudes(carry)
    scale = keep(jnp.stack([bit, striker, striker * 2 * jnp.pi / carry["since"]]))
    differs = keep(jnp.abs(state[None] - carry["states"]))
    # A return that has not been yet is NaN, which compares false.
    unsettled = here[None] & jnp.any(differs > SETTLED_WITHIN * scale[None], axis=1)
    repeats = jnp.all(differs <= SETTLED_WITHIN * scale[None], axis=1)
    back = jnp.arange(MOST_CYCLES, dtype=carry["number"].dtype).reshape(-1, *[1] * carry["number"].ndim)
    compared = here[None] & (back < carry["number"][None])
    worst = jnp.where(compared[:, None], jnp.maximum(carry["worst"], differs), carry["worst"])
    times = keep(jnp.concatenate([lane.clock.high[None], carry["times"][:-1]]))
    x1, _, x2, _ = lane.state[:4]
    turn = 2 * jnp.pi
    # From the first return of the observation on, without the whole turns.
    phase = jnp.where(carry["number"] == 0, 0, carry["phase"] - turn * jnp.round(carry["phase"] / turn))
    return carry | {
        "frequency": jnp.where(here, turn * _rate(carry["times"], repeats, lane.clock.high), carry["frequency"]),
        "phase": jnp.where(here, phase, carry["phase"]),
        "armed": carry["armed"] & ~here,
        "waiting": jnp.zeros_like(here),
        "since": jnp.where(here, 0, carry["since"]),
        "swing1": tuple(jnp.where(here, x1, one) for one in carry["swing1"]),
        "swing2": tuple(jnp.where(here, x2, one) for one in carry["swing2"]),
        "states": jnp.where(here[None, None], jnp.concatenate([state[None], carry["states"][:-1]]), carry["states"]),
        "times": jnp.where(here[None], times, carry["times"]),
        "settled": jnp.where(unsettled, carry["times"], carry["settled"]),
        "number": jnp.where(here, carry["number"] + 1, carry["number"]),
        "worst": worst,
    }


def _rate(times, repeats, now):
    """Returns per second, over the fewest returns after which the state repeats, else over all that are kept; 0 before
    there are two."""
    rate = jnp.zeros_like(now)
    for p in range(1, MOST_CYCLES + 1):
        rate = jnp.where(jnp.isfinite(times[p - 1]), p / (now - times[p - 1]), rate)
    for p in range(MOST_CYCLES, 0, -1):
        rate = jnp.where(repeats[p - 1], p / (now - times[p - 1]), rate)
    return rate


def cycles(carry: dict, bit_amplitude, striker_amplitude, period):
    """Returns after which the motion repeats, 1 to 8; 0 where it does not, or where there are fewer than 3 p + 1."""
    scale = jnp.stack([bit_amplitude, striker_amplitude, striker_amplitude * 2 * jnp.pi / period])
    found = jnp.zeros_like(carry["number"])
    for p in range(MOST_CYCLES, 0, -1):
        repeats = jnp.all(carry["worst"][p - 1] < REPEATS_WITHIN * scale, axis=0) & (carry["number"] >= 3 * p + 1)
        found = jnp.where(repeats, float(p), found)
    return found


def settling_time(carry: dict, cycles):
    """Time [s] of the last return that differs from that `cycles` returns later by over 0.01; NaN where cycles is 0."""
    time = jnp.full_like(cycles, jnp.nan)
    for p in range(1, MOST_CYCLES + 1):
        time = jnp.where(cycles == p, carry["settled"][p - 1], time)
    return time
