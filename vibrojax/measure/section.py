"""Returns to the section: the instant at which the bit overtakes the drive (contract: dataset).

x1' rises through zero, having been below -0.05 v since the last return. Here a lane's repeats are found, and when it
settled. Before the observation steps do not end on the section: a return on the way is read off the step's polynomials.
"""

import jax.numpy as jnp

from vibrojax.measure.ledger import MOST_CYCLES
from vibrojax.stepping import keep
from vibrojax.stepping.polynomial import first_guess, slope, value

REPEATS_WITHIN = 1e-3
SETTLED_WITHIN = 0.01
ARMED_BELOW = 0.05


def begin(lane) -> dict:
    """What is known of returns at t = 0, while it settles."""
    x1, _, x2, _ = lane.state[:4]
    nothing = jnp.full((MOST_CYCLES, *x1.shape), jnp.nan, x1.dtype)
    zero = jnp.zeros_like(x1)
    return {
        "armed": jnp.zeros_like(x1, bool),
        "since": zero,
        "swing1": (x1, x1),
        "swing2": (x2, x2),
        "states": jnp.stack([nothing] * 3, axis=1),
        "times": nothing,
        "settled": jnp.zeros_like(nothing),
        "frequency": zero,
        "passed": {
            "waiting": jnp.zeros_like(x1, bool),
            "state": jnp.stack([zero] * 3),
            "time": zero,
            "since": zero,
            "bit": zero,
            "striker": zero,
        },
    }


def pass_by(scene, p, carry: dict, lane, step) -> dict:
    """Take in a step of the settling: extremes since the last return, and a return on the way.

    The turns of bit and striker are where x1' and x2' pass zero on the step's polynomials.
    """
    x1, v1, x2, v2 = lane.state[:4]
    place1, velocity1, place2, velocity2 = step.polynomials[:4]
    turns1, at1 = _turn(velocity1, v1, step)
    for _ in range(2):
        at1 = _polished(velocity1, at1, step)
    # The striker's swing is flat there: a first guess of when will do.
    turns2, at2 = _turn(velocity2, v2, step)
    there = keep(jnp.stack([value(place1, at1), value(place2, at1), value(velocity2, at1)]))
    swing1 = _widened(carry["swing1"], jnp.where(turns1, there[0], x1))
    swing2 = _widened(carry["swing2"], jnp.where(turns2, value(place2, at2), x2))
    armed = keep(carry["armed"] | (lowest(velocity1, step.tau) < -ARMED_BELOW * p["v"]))
    overtakes = keep(turns1 & (velocity1[0] < 0) & armed)
    since = carry["since"] + step.dt
    left = step.dt - at1 * step.h
    new = {
        "state": there,
        "time": lane.clock.high - left,
        "since": since - left,
        "bit": (swing1[1] - swing1[0]) / 2,
        "striker": (swing2[1] - swing2[0]) / 2,
    }
    passed = {name: jnp.where(overtakes, now, carry["passed"][name]) for name, now in new.items()}
    return carry | {
        "armed": jnp.where(overtakes, v1 < 0, armed),
        "since": jnp.where(overtakes, left, since),
        "swing1": tuple(jnp.where(overtakes, there[0], one) for one in _widened(swing1, x1)),
        "swing2": tuple(jnp.where(overtakes, there[1], one) for one in _widened(swing2, x2)),
        "passed": passed | {"waiting": carry["passed"]["waiting"] | overtakes},
    }


def _turn(velocity, after, step):
    """Where a velocity passes zero on the step, and the tau of it by a parabola."""
    sign = jnp.where(velocity[0] < 0, -1.0, 1.0)
    guess = first_guess(jnp.abs(velocity[0]), sign * velocity[1] * step.tau, sign * after)
    return sign * after < 0, keep(guess * step.tau)


def _polished(velocity, tau, step):
    """A better zero by a Newton iteration, if that stays within the step."""
    better = tau - value(velocity, tau) / slope(velocity, tau)
    return keep(jnp.where((better > 0) & (better < step.tau), better, tau))


def turn_over_passed(carry: dict) -> dict:
    """Take in the returns that have been passed."""
    passed = carry["passed"]
    here = passed["waiting"]
    carry, _ = _returned(carry, here, *(passed[name] for name in ("state", "time", "since", "bit", "striker")))
    return carry | {"passed": passed | {"waiting": jnp.zeros_like(here)}}


def observe(carry: dict) -> dict:
    """What is known of returns at the beginning of the observation: they are counted from here on, and landed on."""
    zero = jnp.zeros_like(carry["since"])
    known = {name: one for name, one in turn_over_passed(carry).items() if name != "passed"}
    return known | {
        "waiting": jnp.zeros_like(carry["armed"]),
        "phase": zero,
        "number": zero,
        "worst": jnp.zeros_like(carry["states"]),
    }


def step(scene, p, carry: dict, lane, step) -> dict:
    """Take in a step: extremes since the last return, and whether it ends on the section."""
    x1, _, x2, _ = lane.state[:4]
    armed = keep(carry["armed"] | (lowest(step.polynomials[1], step.tau) < -ARMED_BELOW * p["v"]))
    overtakes = step.hits[scene.bit_turn] & ~step.falling[0] & armed
    return carry | {
        "armed": armed,
        "waiting": carry["waiting"] | overtakes,
        "since": carry["since"] + step.dt,
        "phase": carry["phase"] + carry["frequency"] * step.dt,
        "swing1": _widened(carry["swing1"], x1),
        "swing2": _widened(carry["swing2"], x2),
    }


def lowest(velocity, tau):
    """Least value of a velocity from 0 to `tau`, by the parabola through its ends and its middle."""
    start, middle, end = velocity[0], value(velocity, tau / 2), value(velocity, tau)
    bend, fall = start + end - 2 * middle, 3 * start + end - 4 * middle
    # A step not taken is flat: 0/0 is no number, and no turn.
    share = fall / (4 * bend)
    vertex = start - fall * share / 2
    return jnp.minimum(jnp.minimum(start, end), jnp.where((bend > 0) & (share > 0) & (share < 1), vertex, start))


def _widened(extremes, x):
    lowest, highest = extremes
    return jnp.minimum(lowest, x), jnp.maximum(highest, x)


def amplitudes(carry: dict):
    """Half the swings of x1 and x2 since the last return [m]."""
    return tuple((highest - lowest) / 2 for lowest, highest in (carry["swing1"], carry["swing2"]))


def turn_over(carry: dict, lane) -> dict:
    """Take in the returns of the lanes that wait at the section, and let them go on."""
    here = carry["waiting"]
    x1, _, x2, v2 = lane.state[:4]
    at_section = (jnp.stack([x1, x2, v2]), lane.clock.high, carry["since"], *amplitudes(carry))
    known, differs = _returned(carry, here, *at_section)
    back = jnp.arange(MOST_CYCLES, dtype=carry["number"].dtype).reshape(-1, *[1] * carry["number"].ndim)
    compared = here[None] & (back < carry["number"][None])
    worst = jnp.where(compared[:, None], jnp.maximum(carry["worst"], differs), carry["worst"])
    turn = 2 * jnp.pi
    # From the first return of the observation on, without the whole turns.
    phase = jnp.where(carry["number"] == 0, 0, carry["phase"] - turn * jnp.round(carry["phase"] / turn))
    return known | {
        "armed": carry["armed"] & ~here,
        "waiting": jnp.zeros_like(here),
        "since": jnp.where(here, 0, carry["since"]),
        "phase": jnp.where(here, phase, carry["phase"]),
        "swing1": tuple(jnp.where(here, x1, one) for one in carry["swing1"]),
        "swing2": tuple(jnp.where(here, x2, one) for one in carry["swing2"]),
        "number": jnp.where(here, carry["number"] + 1, carry["number"]),
        "worst": worst,
    }


def _returned(carry, here, state, time, since, bit, striker):
    """The returns that are kept after one in `state` at `time`, where `here`; and how it differs from those before.

    `bit` and `striker` are half the swings in the time `since` the return before.
    """
    scale = keep(jnp.stack([bit, striker, striker * 2 * jnp.pi / since]))
    differs = keep(jnp.abs(state[None] - carry["states"]))
    # A return that has not been yet is NaN, which compares false.
    unsettled = here[None] & jnp.any(differs > SETTLED_WITHIN * scale[None], axis=1)
    repeats = jnp.all(differs <= SETTLED_WITHIN * scale[None], axis=1)
    times = keep(jnp.concatenate([time[None], carry["times"][:-1]]))
    states = jnp.concatenate([state[None], carry["states"][:-1]])
    rate = 2 * jnp.pi * _rate(carry["times"], repeats, time)
    known = carry | {
        "frequency": jnp.where(here, rate, carry["frequency"]),
        "states": jnp.where(here[None, None], states, carry["states"]),
        "times": jnp.where(here[None], times, carry["times"]),
        "settled": jnp.where(unsettled, carry["times"], carry["settled"]),
    }
    return known, differs


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
