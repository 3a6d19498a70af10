"""A drill stepped from switch to switch, for numba: scalar code per lane, a state machine over polynomial steps.

A stepper gives the four states as polynomials of the time since the step began, by the equations of the mode at that
time. The first switching surface that they cross ends the step. Newton's method within a bracket finds this root.
Without numba, the code runs as plain Python, slowly but with the same results.
"""

import math

import numpy as np

from peers._machine import ARMED_BELOW, C0, C2, K0, K1, M1, MU, STICK_LIMIT

try:
    import numba
except ImportError:
    numba = None

FAST = {"contract", "nsz", "arcp", "reassoc"}
"""The part of fast mathematics that is safe here: infinities and NaN keep their meaning."""

LATER = 1e-7
"""Time [s] after the start of a step from which it looks for switches; it begins on the surface of the last one."""

ROWS = 6


def compiled(function, **options):
    """Return the function compiled by numba, or unchanged if numba is missing."""
    return numba.njit(fastmath=FAST, error_model="numpy", **options)(function) if numba else function


lanes_of = numba.prange if numba else range


def program(step, n: int, both):
    """Return run(beta, gamma, v, delta, settle, observe, setting) -> (lanes, 3): period, impact velocity, steps.

    `step(slip, touching, state.., lane.., h, limit, setting, coefficients) -> (length, next h)` fills the coefficients
    (degree `n`) of x1, x1', x2, x2'. `both(c, t)` is the value and the slope of such a polynomial.
    """

    @compiled
    def turn(c, low, high, rises):
        """Return where the slope passes through zero, from below if it `rises`."""
        x = 0.5 * (low + high)
        for _ in range(60):
            first, second = n * c[n], 0.0
            for k in range(n - 1, 0, -1):
                second = second * x + first
                first = first * x + k * c[k]
            if (first > 0) == rises:
                high = x
            else:
                low = x
            new = x - first / second if second != 0 else 0.5 * (low + high)
            if not (low < new < high):
                new = 0.5 * (low + high)
            if abs(new - x) <= 1e-9 * high:
                return new
            x = new
        return x

    @compiled
    def root(c, low, high, x):
        """Return where the polynomial falls through zero between `low` and `high`; x is a guess."""
        for _ in range(60):
            height, steep = both(c, x)
            if height > 0:
                low = x
            else:
                high = x
            new = x - height / steep if steep < 0 else 0.5 * (low + high)
            if not (low <= new <= high):
                new = 0.5 * (low + high)
            if abs(new - x) <= 4e-16 * high + 1e-15:
                return new
            x = new
        return x

    @compiled
    def fall(c, h):
        """Return the first time up to h at which the polynomial falls through zero, or infinity."""
        height, steep = both(c, h)
        top = h
        if height >= 0:
            if not (steep > 0 and c[1] + 2 * c[2] * LATER < 0):
                return math.inf
            top = turn(c, LATER, h, True)
            if both(c, top)[0] >= 0:
                return math.inf
        if c[0] + LATER * (c[1] + LATER * c[2]) <= 0 or top <= LATER:
            return min(LATER, h)
        return root(c, LATER, top, 0.5 * top)

    @compiled
    def lane(beta, gamma, v, delta, settle, observe, setting, w):
        x1c, v1c, x2c, v2c, f, g = w[0], w[1], w[2], w[3], w[4], w[5]
        m2, k2 = beta * M1, beta * gamma * gamma * K1
        rate = math.sqrt((K1 + k2) / M1 + k2 / m2) + C2 / m2
        stiff = math.sqrt(K0 / m2 + rate * rate)
        t, end = 0.0, settle + observe
        x1, v1, x2, v2 = 0.0, -v, 0.0, 0.0
        slip, touching, armed = 0, x2 > delta, False
        h_apart, h_touching = setting / rate, setting / stiff
        first, last, number = 0.0, 0.0, 0
        impacts, pending, total, pending_total = 0, 0, 0.0, 0.0
        steps = 0
        while t < end and steps < 100_000_000:
            steps += 1
            stop = settle if t < settle else end
            trial = h_touching if touching else h_apart
            h, following = step(
                slip,
                touching,
                x1,
                v1,
                x2,
                v2,
                m2,
                k2,
                v,
                delta,
                stiff if touching else rate,
                trial,
                stop - t,
                setting,
                x1c,
                v1c,
                x2c,
                v2c,
            )
            if touching:
                h_touching = following
            else:
                h_apart = following
            capped = h >= stop - t
            # Find the first switch
            what = 0
            if touching:
                for k in range(n + 1):
                    f[k] = K0 * x2c[k] + C0 * v2c[k]
                f[0] -= K0 * delta
            else:
                for k in range(n + 1):
                    f[k] = -x2c[k]
                f[0] += delta
            when = fall(f, h)
            if when < h:
                h, what = when, 1
            if slip != 0:
                for k in range(n + 1):
                    g[k] = slip * v1c[k]
                g[0] += slip * v
                when = fall(g, h)
                if when < h:
                    h, what = when, 2
            else:
                for side in (1, -1):
                    for k in range(n + 1):
                        held = MU * f[k] if touching else 0.0
                        g[k] = held - side * (k2 * (x2c[k] - x1c[k]) - K1 * x1c[k])
                    g[0] += STICK_LIMIT
                    when = fall(g, h)
                    if when < h:
                        h, what = when, 2 + (1 if side > 0 else 2)
            x1, v1, x2, v2 = x1c[n], v1c[n], x2c[n], v2c[n]
            for k in range(n - 1, -1, -1):
                x1 = x1 * h + x1c[k]
                v1 = v1 * h + v1c[k]
                x2 = x2 * h + x2c[k]
                v2 = v2 * h + v2c[k]
            # Check the section: x1' has at most one turning point in a step
            if slip == 0:
                armed = True
            elif v1c[0] <= 0 or v1 > 0 or not armed:
                begins, ends = v1c[1], both(v1c, h)[1]
                middle = turn(v1c, 0.0, h, ends > 0) if begins * ends < 0 else h
                low, before = 0.0, v1c[0]
                for part in range(2):
                    high = middle if part == 0 else h
                    after = v1 if high == h else both(v1c, high)[0]
                    if before < -ARMED_BELOW * v:
                        armed = True
                    if armed and before <= 0 and after > 0:
                        armed = False
                        if t >= settle:
                            for k in range(n + 1):
                                g[k] = -v1c[k]
                            at = t + root(g, low, high, low + (high - low) * before / (before - after))
                            if number == 0:
                                first = at
                            else:
                                impacts += pending
                                total += pending_total
                            number += 1
                            last, pending, pending_total = at, 0, 0.0
                    if high == h:
                        break
                    low, before = high, after
            t = stop if capped and what == 0 else t + h
            # Change the mode
            if what == 1:
                touching = not touching
                if touching:
                    x2 = delta
                    if number > 0:
                        pending += 1
                        pending_total += v2
            elif what == 2:
                v1 = -v
                limit = STICK_LIMIT + (MU * (K0 * (x2 - delta) + C0 * v2) if touching else 0.0)
                pull = k2 * (x2 - x1) - K1 * x1
                slip = 0 if abs(pull) <= limit else (1 if pull > 0 else -1)
            elif what == 3:
                slip = 1
            elif what == 4:
                slip = -1
        period = (last - first) / (number - 1) if number > 1 else math.nan
        return period, total / impacts if impacts else math.nan, steps

    def run(beta, gamma, v, delta, settle, observe, setting):
        found = np.empty((len(beta), 3))
        for i in lanes_of(len(beta)):
            w = np.zeros((ROWS, n + 1))
            period, velocity, steps = lane(beta[i], gamma[i], v[i], delta[i], settle, observe, setting, w)
            found[i, 0] = period
            found[i, 1] = velocity
            found[i, 2] = steps
        return found

    return compiled(run, parallel=True)
