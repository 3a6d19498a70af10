"""Judges of what is known in closed form: linear modes, the friction laws' curves, struck masses, one blow."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import xarray as xr
from jaxtyping import Float

from vibrojax.models.physics.contact import contact_time, restitution
from vibrojax.models.physics.friction import FRICTION_LAWS
from vibrojax.models.physics.modes import empirical_frequency, natural_frequencies, striker
from vibrojax.reproduce import datasets_chapter5 as data
from vibrojax.reproduce import motions
from vibrojax.reproduce.struck_mass import Blows
from vibrojax.reproduce.verdicts import (
    AGREES,
    DIFFERS,
    Here,
    claim,
    listed,
    number,
    printed,
    shown,
    trend,
    within_range,
)

PAIR = "the source's pair are no roots: their product is 468.6, and must be w1 w2 = 468.75"
SPEEDS = np.linspace(0.0, 5.0, 20001)


def _modes(**p: float) -> tuple[float, float]:
    """Natural frequencies [rad/s] of eq. 5.16, lower first."""
    lower, upper = np.asarray(natural_frequencies({"m1": 250.0, "k1": 156250.0} | p))
    return float(lower), float(upper)


def roots() -> Here:
    m2, k2 = (float(x) for x in striker(data.TABLE_5_1))
    matrix = np.array([[(156250.0 + k2) / 250.0, -k2 / 250.0], [-k2 / m2, k2 / m2]])
    frequencies = np.sqrt(np.sort(np.linalg.eigvals(matrix).real))
    worst = np.abs(frequencies / np.array(_modes(**data.TABLE_5_1)) - 1).max()
    return claim(f"{shown(worst)} relative difference", worst < 1e-9)


def mode_of_table_5_1(index: int, source: str) -> Callable[[], Here]:
    def judge() -> Here:
        return printed(_modes(**data.TABLE_5_1)[index], source, "rad/s", PAIR)

    return judge


def second_spring() -> Here:
    return printed(float(striker(data.TABLE_5_1)[1]), "35156", "N/m")


def column_5_16() -> Here:
    ours = [float(natural_frequencies(row.modes)[1]) for row in data.TABLE_5_3]
    return _column(ours, [row.eq_5_16 for row in data.TABLE_5_3])


def column_5_17() -> Here:
    ours = [float(empirical_frequency(row.modes)) for row in data.TABLE_5_3]
    return _column(ours, [row.eq_5_17 for row in data.TABLE_5_3])


def _column(ours: Sequence[float], source: Sequence[float]) -> Here:
    """A column of Table 5.3 as closed form: how many rows are within a unit of the last printed digit."""
    off = np.abs(np.array(ours) - source) > 0.1
    wrong = "; ".join(
        f"row {row} is {here:.2f} here, {there} there"
        for row, (here, there, is_off) in enumerate(zip(ours, source, off, strict=True), start=1)
        if is_off
    )
    text = f"{min(ours):.2f} to {max(ours):.2f} rad/s, {np.sum(~off)} of 11 rows within 0.1"
    return Here(text, DIFFERS if off[np.arange(11) != 9].any() else AGREES, wrong)


def higher_at_gamma_1_2() -> Here:
    return printed(_modes(beta=0.3, gamma=1.2)[1] / (2 * np.pi), "5.93", "Hz")


def lower_at_gamma_1_2() -> Here:
    return number(_modes(beta=0.3, gamma=1.2)[0] / (2 * np.pi), 3.2, "Hz", 3e-3)


def without_impact() -> Here:
    p = {"m1": 250.0, "k1": 156250.0, "beta": 0.4, "gamma": 0.9}
    ours, by_5_16 = float(empirical_frequency(p)) / (2 * np.pi), _modes(**p)[1] / (2 * np.pi)
    return number(ours, 4.9, "Hz", 0.01, f"by eq. 5.17; eq. 5.16 gives {by_5_16:.2f} Hz")


def lower_rises() -> Here:
    lower = [_modes(beta=0.3, gamma=gamma)[0] for gamma in (0.6, 1.0, 1.2, 2.0, 4.0, 15.0)]
    limit = 25 / np.sqrt(1.3)
    text = f"{lower[2]:.1f} rad/s at gamma 1.2, {lower[3]:.1f} at 2, {lower[4]:.1f} at 4; the limit is {limit:.1f}"
    hertz = [w / (2 * np.pi) for w in (lower[2], limit)]
    note = f"it goes on rising, from {hertz[0]:.2f} to {hertz[1]:.2f} Hz"
    return trend(text, lower[2] > lower[0] and hertz[1] - hertz[0] < 0.1, note)


def curve(law: str, speeds: Float[np.ndarray, " speeds"]) -> Float[np.ndarray, " speeds"]:
    """mu at sliding speeds [m/s], with the law's default coefficients."""
    friction = FRICTION_LAWS[law]
    p = {name: np.asarray(parameter.default) for name, parameter in friction.parameters.items()}
    return np.asarray(friction.on_weight(speeds, p)) + 0.0 * speeds


def constant() -> Here:
    mu = curve("coulomb", SPEEDS)
    return claim(f"{np.ptp(mu):g} is the range of mu", np.ptp(mu) == 0)


def rises_then_falls(law: str) -> Callable[[], Here]:
    def judge() -> Here:
        mu = curve(law, SPEEDS)
        top = int(np.argmax(mu))
        holds = 0 < top < len(mu) - 1 and mu[-1] < 0.9 * mu[top]
        return trend(f"{SPEEDS[top]:.3f} m/s is where mu is greatest, {mu[top]:.3f}; {mu[-1]:.3f} at 5 m/s", holds)

    return judge


def falls() -> Here:
    mu = curve("hyperbolic", SPEEDS)
    return trend(f"{mu[0]:.3f} at rest, {mu[-1]:.3f} at 5 m/s", np.all(np.diff(mu) < 0))


def falls_then_rises(law: str) -> Callable[[], Here]:
    def judge() -> Here:
        mu = curve(law, SPEEDS)
        low = int(np.argmin(mu))
        text = f"{SPEEDS[low]:.2f} m/s is where mu is least, {mu[low]:.3f}; {mu[0]:.3f} at rest"
        return trend(text, 0 < low < len(mu) - 1)

    return judge


def critical_speed() -> Here:
    mu = curve("stribeck", SPEEDS)
    low = int(np.argmin(mu))
    text = f"{SPEEDS[low]:.3f} m/s is where mu is least, {mu[low] / mu[0]:.4f} of that at rest"
    return claim(text, abs(SPEEDS[low] - 3) < 1e-3 and abs(mu[low] / mu[0] - 1 / 3) < 1e-6)


def sustains(law: str, expected: bool) -> Callable[[xr.Dataset], Here]:
    def judge(motion: xr.Dataset) -> Here:
        v = data.FALLING[law]
        swing = motions.amplitude(motion, "v1", 35.0) / v
        text = f"{swing:.2g} times the drive's velocity after 35 s, v {v} m/s"
        return claim(text, (swing > 0.1) == expected)

    return judge


def law_matters(*maps: xr.Dataset) -> Here:
    """How often the regime is another than under the source's law."""
    own = maps[-1].regime
    off = [float((ds.regime != own).mean()) for ds in maps[:-1]]
    single = [float((ds.regime == 3).mean()) for ds in maps]
    text = f"{listed(off)} of the map has another regime under {', '.join(data.LAWS[:-1])}"
    note = f"a single impact on {listed(single)} of it under {', '.join(data.LAWS)}; beta 0.2 to 0.8, gamma 0.5 to 1.0"
    return trend(text, min(off) > 0.1, note)


def period_on_stop(*masses: Blows) -> Here:
    ratios = [float(np.diff(one.times).mean() / (2 * np.pi / data.NATURAL)) for one in masses]
    known = [0.5 + np.arcsin(gap / 0.01) / np.pi for gap in data.FREE]
    worst = max(abs(a - b) for a, b in zip(ratios, known, strict=True))
    text = f"{listed(ratios)} of the linear period, at gaps of 0.5, 0 and -0.5 amplitudes"
    return claim(text, worst < 1e-9, f"1/2 + asin(gap/A)/pi, worst difference {worst:.0e}")


def _periodic_hammer(p: Mapping[str, float]) -> float:
    """Impact velocity [m/s] of Tsaplin's hammer, one impact a period of the force (eqs. 5.1, 5.2), the faster solution.

    x = A sin(w t + theta) − (1 + R) V/(2 w_n sin(w_n T/2)) cos(w_n (t − T/2)) between impacts at t = 0 and T, so that
    A w cos(theta) = V (1 − R)/2 and A sin(theta) = gap + (1 + R) V cot(w_n T/2)/(2 w_n).
    """
    w, wn, r = p["frequency"], p["natural"], p["restitution"]
    swing = p["drive"] / (wn**2 - w**2)
    slope, lean = (1 - r) / (2 * w), (1 + r) / (2 * wn * np.tan(wn * np.pi / w))
    a, b, c = slope**2 + lean**2, 2 * p["gap"] * lean, p["gap"] ** 2 - swing**2
    return float((-b + np.sqrt(b**2 - 4 * a * c)) / (2 * a))


def hammer(mass: Blows) -> Here:
    here, known = float(mass.before[-1]), _periodic_hammer(data.HAMMER)
    spread = float(np.ptp(mass.before[-10:]))
    note = f"the periodic solution has {known:.6f} m/s; the last ten impacts differ by {spread:.0e}"
    return claim(f"{here:.6f} m/s before each impact, w = 1.5 w_n", abs(here / known - 1) < 1e-6, note)


def hammer_at_twice(mass: Blows) -> Here:
    periods = np.diff(mass.times[-10:]) / (2 * np.pi / 20.0)
    here, known = float(mass.before[-1]), _periodic_hammer(data.HAMMER_AT_TWICE)
    note = f"impact velocity {here:.6f} m/s, the periodic solution has {known:.6f}"
    text = f"{periods.mean():.4f} periods of the force between impacts, w = 2 w_n"
    return claim(text, np.ptp(periods) < 1e-6, note)


def thrown(mass: Blows) -> Here:
    period = 2 * np.pi / data.BALL["frequency"]
    known = 9.81 * period / (1 + data.BALL["restitution"])
    note = "g T/(1 + R), one impact a period; dropped from less than 0.15 m the ball chatters and rests instead"
    return number(float(mass.before[-1]), known, "m/s", 1e-6, note)


def thrown_phase(mass: Blows) -> Here:
    r, w = data.BALL["restitution"], data.BALL["frequency"]
    known = np.pi * 9.81 / data.BALL["drive"] * (1 - r) / (1 + r)
    here = -float(np.cos(w * mass.times[-1]))
    note = f"pi m g (1 − R)/(F (1 + R)) = {known:.6f}"
    return claim(f"{here:.6f} is the sine of the phase at impact", abs(here - known) < 1e-6, note)


def duration(fast: xr.Dataset, slow: xr.Dataset) -> Here:
    spans = [float(motions.events(one, "release")[0] - motions.events(one, "impact")[0]) for one in (fast, slow)]
    known = float(contact_time(data.M2, data.K0, 2 * 0.3 * np.sqrt(data.K0 * data.M2)))
    text = f"{1e3 * spans[0]:.4f} ms at 2 m/s, {1e3 * spans[1]:.4f} ms at 0.5 m/s"
    holds = abs(spans[0] / known - 1) < 1e-4 and abs(spans[1] / known - 1) < 1e-4
    return claim(text, holds, f"2 acos(xi)/w_d is {1e3 * known:.4f} ms")


def restitutions(*blows: xr.Dataset) -> Here:
    here = np.array([motions.restitution(one) for one in blows])
    known = np.asarray(restitution(np.array(data.LOSS_FACTORS)))
    worst = float(np.abs(here / known - 1).max())
    note = (
        f"closed form {listed(known)}, worst relative difference {worst:.0e}; as printed it gives {listed(_printed())}"
    )
    return claim(f"{listed(here)} at xi {listed(data.LOSS_FACTORS)}", worst < 1e-3, note)


def _printed() -> list[float]:
    """Eq. 5.8 letter by letter, where its roots are real."""
    values = []
    for xi in data.LOSS_FACTORS[:3]:
        angle = np.arctan(-2 * xi * np.sqrt(1 - xi**2) / (1 - 2 * xi**2))
        values.append(float(np.exp(-xi / np.sqrt(1 - 2 * xi**2) * angle) * np.sin(angle)))
    return values


def listing(*blows: xr.Dataset) -> Here:
    low, high = sorted(motions.restitution(blows[place]) for place in (2, 4))
    return within_range(low, high, (0.1, 0.3), "", "at xi 0.91 and 0.5")
