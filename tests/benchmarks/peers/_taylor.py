"""Taylor steps for the compiled loop: the recurrences of the series written out for one order, as scalars.

Between switches the equations are polynomials, so a coefficient follows from the previous ones. Written out, without
loops and arrays, a step of order 8 has about 250 operations. Steps are a fixed fraction of the mode's time scale.
"""

from peers._compiled import compiled
from peers._machine import C0, C2, K0, K1, M1, MU, STICK_LIMIT, V_CR


def stepper(order: int):
    """Return `step` and `both` for [peers._compiled.program][]."""
    names = {"M1": M1, "K1": K1, "C2": C2, "MU": MU, "K0": K0, "C0": C0, "LIMIT": STICK_LIMIT}
    names |= {"FALL": STICK_LIMIT / V_CR, "RISE": STICK_LIMIT / (3 * V_CR**3)}
    exec(_step(order), names)
    exec(_both(order), names)
    return compiled(names["step"]), compiled(names["both"])


def _step(order: int) -> str:
    lines = [
        "def step(slip, touching, x1, v1, x2, v2, m2, k2, v, delta, rate, h, limit, setting, a, b, c, d):",
        "    on = 1.0 if touching else 0.0",
        "    rub, moves = MU * slip, 1.0 if slip != 0 else 0.0",
        "    s1, s2, s3, s0 = k2 / m2, -(k2 + on * K0) / m2, -(C2 + on * C0) / m2, on * K0 * delta / m2",
        "    share = moves / M1",
        "    r1, r2, r3 = -(K1 + k2) * share, (k2 - rub * on * K0) * share, -rub * on * C0 * share",
        "    r0, falls, rises = (rub * on * K0 * delta - slip * LIMIT) * share, FALL * share, RISE * share",
        "    a0, b0, c0, d0, u0 = x1, v1, x2, v2, v1 + v if slip != 0 else 0.0",
    ]
    for k in range(order):
        terms = [f"u{i} * u{k - i}" for i in range((k + 1) // 2)]
        square = [f"2 * ({' + '.join(terms)})"] * bool(terms) + [f"u{k // 2} * u{k // 2}"] * (k % 2 == 0)
        cube = " + ".join(f"w{i} * u{k - i}" for i in range(k + 1))
        constant = (" + r0", " + s0") if k == 0 else ("", "")
        lines += [
            f"    w{k} = {' + '.join(square)}",
            f"    r = r1 * a{k} + r2 * c{k} + r3 * d{k} + falls * u{k} - rises * ({cube}){constant[0]}",
            f"    s = s1 * a{k} + s2 * c{k} + s3 * d{k}{constant[1]}",
            f"    a{k + 1}, c{k + 1} = b{k} * {1 / (k + 1)!r}, d{k} * {1 / (k + 1)!r}",
            f"    b{k + 1}, d{k + 1} = r * {1 / (k + 1)!r}, s * {1 / (k + 1)!r}",
            f"    u{k + 1} = b{k + 1}",
        ]
    for k in range(order + 1):
        lines += [f"    {row}[{k}] = {row}{k}" for row in "abcd"]
    return "\n".join([*lines, "    return min(setting / rate, limit), h", ""])


def _both(order: int) -> str:
    lines = ["def both(c, x):", f"    p = c[{order}]", "    d = p"]
    lines += [f"    p = p * x + c[{order - 1}]"]
    for k in range(order - 2, -1, -1):
        lines += ["    d = d * x + p", f"    p = p * x + c[{k}]"]
    return "\n".join([*lines, "    return p, d", ""])
