"""Adaptive Dormand-Prince 5(4) steps for the compiled loop, with the method's own dense output of order 4."""

from peers._compiled import compiled
from peers._machine import C0, C2, K0, K1, M1, MU, STICK_LIMIT, V_CR

DEGREE = 4
SHORTEST = 1e-9  # s


@compiled
def _rates(slip, on, x1, v1, x2, v2, m2, k2, v, delta):
    """Return x1'' and x2'' in the mode of the step: slip is 1, 0 or -1, on is 1 in contact."""
    press = on * (K0 * (x2 - delta) + C0 * v2)
    striker = (-C2 * v2 - k2 * (x2 - x1) - press) / m2
    if slip == 0:
        return 0.0, striker
    u = v1 + v
    w = u * (1 / V_CR)
    friction = slip * (STICK_LIMIT + MU * press) - STICK_LIMIT * w * (1 - w * w * (1 / 3))
    return (-K1 * x1 - k2 * (x1 - x2) - friction) * (1 / M1), striker


@compiled
def step(slip, touching, x1, v1, x2, v2, m2, k2, v, delta, rate, h, limit, setting, a, b, c, d):
    """Take one accepted step of at most `limit`, and fill `a` to `d` with the dense output of x1, x1', x2, x2'."""
    on = 1.0 if touching else 0.0
    small_v = 1 / (setting * v)
    small_x = small_v * rate
    p1, q1 = _rates(slip, on, x1, v1, x2, v2, m2, k2, v, delta)
    while True:
        h = min(h, limit)
        e = h * (1 / 5)
        v12, v22 = v1 + e * p1, v2 + e * q1
        p2, q2 = _rates(slip, on, x1 + e * v1, v12, x2 + e * v2, v22, m2, k2, v, delta)
        e1, e2 = h * (3 / 40), h * (9 / 40)
        v13, v23 = v1 + e1 * p1 + e2 * p2, v2 + e1 * q1 + e2 * q2
        p3, q3 = _rates(slip, on, x1 + e1 * v1 + e2 * v12, v13, x2 + e1 * v2 + e2 * v22, v23, m2, k2, v, delta)
        e1, e2, e3 = h * (44 / 45), h * (-56 / 15), h * (32 / 9)
        v14, v24 = v1 + e1 * p1 + e2 * p2 + e3 * p3, v2 + e1 * q1 + e2 * q2 + e3 * q3
        y1, y2 = x1 + e1 * v1 + e2 * v12 + e3 * v13, x2 + e1 * v2 + e2 * v22 + e3 * v23
        p4, q4 = _rates(slip, on, y1, v14, y2, v24, m2, k2, v, delta)
        e1, e2, e3, e4 = h * (19372 / 6561), h * (-25360 / 2187), h * (64448 / 6561), h * (-212 / 729)
        v15 = v1 + e1 * p1 + e2 * p2 + e3 * p3 + e4 * p4
        v25 = v2 + e1 * q1 + e2 * q2 + e3 * q3 + e4 * q4
        y1 = x1 + e1 * v1 + e2 * v12 + e3 * v13 + e4 * v14
        y2 = x2 + e1 * v2 + e2 * v22 + e3 * v23 + e4 * v24
        p5, q5 = _rates(slip, on, y1, v15, y2, v25, m2, k2, v, delta)
        e1, e2, e3, e4, e5 = h * (9017 / 3168), h * (-355 / 33), h * (46732 / 5247), h * (49 / 176), h * (-5103 / 18656)
        v16 = v1 + e1 * p1 + e2 * p2 + e3 * p3 + e4 * p4 + e5 * p5
        v26 = v2 + e1 * q1 + e2 * q2 + e3 * q3 + e4 * q4 + e5 * q5
        y1 = x1 + e1 * v1 + e2 * v12 + e3 * v13 + e4 * v14 + e5 * v15
        y2 = x2 + e1 * v2 + e2 * v22 + e3 * v23 + e4 * v24 + e5 * v25
        p6, q6 = _rates(slip, on, y1, v16, y2, v26, m2, k2, v, delta)
        e1, e3, e4, e5, e6 = h * (35 / 384), h * (500 / 1113), h * (125 / 192), h * (-2187 / 6784), h * (11 / 84)
        v17 = v1 + e1 * p1 + e3 * p3 + e4 * p4 + e5 * p5 + e6 * p6
        v27 = v2 + e1 * q1 + e3 * q3 + e4 * q4 + e5 * q5 + e6 * q6
        y1 = x1 + e1 * v1 + e3 * v13 + e4 * v14 + e5 * v15 + e6 * v16
        y2 = x2 + e1 * v2 + e3 * v23 + e4 * v24 + e5 * v25 + e6 * v26
        p7, q7 = _rates(slip, on, y1, v17, y2, v27, m2, k2, v, delta)
        e1, e3, e4 = h * (71 / 57600), h * (-71 / 16695), h * (71 / 1920)
        e5, e6, e7 = h * (-17253 / 339200), h * (22 / 525), h * (-1 / 40)
        error = max(
            max(
                abs(e1 * v1 + e3 * v13 + e4 * v14 + e5 * v15 + e6 * v16 + e7 * v17),
                abs(e1 * v2 + e3 * v23 + e4 * v24 + e5 * v25 + e6 * v26 + e7 * v27),
            )
            * small_x,
            max(
                abs(e1 * p1 + e3 * p3 + e4 * p4 + e5 * p5 + e6 * p6 + e7 * p7),
                abs(e1 * q1 + e3 * q3 + e4 * q4 + e5 * q5 + e6 * q6 + e7 * q7),
            )
            * small_v,
        )
        factor = min(5.0, max(0.2, 0.9 * error**-0.2)) if error > 0 else 5.0
        if error <= 1 or h <= SHORTEST:
            break
        h *= factor
    _dense(h, x1, y1, v1, v13, v14, v15, v16, v17, a)
    _dense(h, v1, v17, p1, p3, p4, p5, p6, p7, b)
    _dense(h, x2, y2, v2, v23, v24, v25, v26, v27, c)
    _dense(h, v2, v27, q1, q3, q4, q5, q6, q7, d)
    return h, h * factor


@compiled
def _dense(h, begins, ends, k1, k3, k4, k5, k6, k7, c):
    """Fill in the dense output (Hairer, Norsett and Wanner, Solving ordinary differential equations I, II.6)."""
    change = ends - begins
    bend = h * k1 - change
    again = change - h * k7 - bend
    last = h * (
        (-12715105075 / 11282082432) * k1
        + (87487479700 / 32700410799) * k3
        + (-10690763975 / 1880347072) * k4
        + (701980252875 / 199316789632) * k5
        + (-1453857185 / 822651844) * k6
        + (69997945 / 29380423) * k7
    )
    # begins + s (change + (1 - s) (bend + s (again + (1 - s) last))), where s is the fraction of the step
    inverse = 1 / h
    c[0] = begins
    c[1] = k1
    c[2] = (again + last - bend) * inverse * inverse
    c[3] = (-again - 2 * last) * inverse * inverse * inverse
    c[4] = last * (inverse * inverse) * (inverse * inverse)


@compiled
def both(c, x):
    """Return value and slope of a polynomial of degree 4."""
    value = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))
    return value, c[1] + x * (2 * c[2] + x * (3 * c[3] + x * 4 * c[4]))
