"""Classical checks from chapter 5's review: struck masses with known motions, and the contact's restitution."""

import numpy as np

from vibrojax.physics.contact import contact_time, restitution
from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import Entry, Here, claim, listed, number, within_range
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import motion, struck
from vibrojax.reproduce.pictures import classical as pictures

NATURAL = 10.0
FREE = {gap: struck((-0.01, 0.0), 5.0, natural=NATURAL, gap=gap) for gap in (0.005, 0.0, -0.005)}
HAMMER = {"natural": NATURAL, "frequency": 15.0, "drive": 5.0, "restitution": 0.5, "gap": 0.01}
HAMMERED = struck((0.0, 0.0), 60.0, **HAMMER)
INTEGER = HAMMER | {"frequency": 20.0, "gap": 0.0}
HAMMERED_AT_TWICE = struck((-0.02, 0.0), 60.0, **INTEGER)
BALL = {"natural": 0.0, "frequency": 20.0, "drive": 12.0, "pull": 9.81, "restitution": 0.6}
THROWN = struck((-0.15, 0.0), 60.0, **BALL)
XIS = pictures.XIS
M2, K0 = 100.0, 50e6


def _blow(xi: float, speed: float = 2.0):
    """The striker flying at the contact, the drive at rest."""
    c0 = float(2 * xi * np.sqrt(K0 * M2))
    return motion("vibro-impact", 0.03, (0.0, 0.0, -0.01, speed), 2e-6, v=0.0, delta=0.0, c0=c0, c2=0.0, gamma=1e-3)


ONE_BLOW = {xi: _blow(xi) for xi in XIS}
SLOW_BLOW = _blow(0.3, 0.5)


def _restitution(*motions) -> Here:
    found, known = np.array([signal.restitution(one) for one in motions]), np.asarray(restitution(np.array(XIS)))
    worst = float(np.abs(found / known - 1).max())
    note = (
        f"closed form {listed(known)}, worst relative difference {worst:.0e}; as printed it gives {listed(_printed())}"
    )
    return claim(f"{listed(found)} at xi {listed(XIS)}", worst < 1e-3, note)


def _printed() -> list[float]:
    """Eq. 5.8 letter by letter, where its roots are real."""
    values = []
    for xi in XIS[:3]:
        angle = np.arctan(-2 * xi * np.sqrt(1 - xi**2) / (1 - 2 * xi**2))
        values.append(float(np.exp(-xi / np.sqrt(1 - 2 * xi**2) * angle) * np.sin(angle)))
    return values


def _listing(*motions) -> Here:
    found = sorted(signal.restitution(motions[place]) for place in (2, 4))
    return within_range(*found, (0.1, 0.3), "", "at xi 0.91 and 0.5")


def _duration(fast, slow) -> Here:
    spans = [float(signal.events(one, "release")[0] - signal.events(one, "impact")[0]) for one in (fast, slow)]
    known = float(contact_time(M2, K0, 2 * 0.3 * np.sqrt(K0 * M2)))
    text = f"{1e3 * spans[0]:.4f} ms at 2 m/s, {1e3 * spans[1]:.4f} ms at 0.5 m/s"
    holds = abs(spans[0] / known - 1) < 1e-4 and abs(spans[1] / known - 1) < 1e-4
    return claim(text, holds, f"2 acos(xi)/w_d is {1e3 * known:.4f} ms")


def _free(*found) -> Here:
    ratios = [float(np.diff(one.times).mean() / (2 * np.pi / NATURAL)) for one in found]
    known = [0.5 + np.arcsin(gap / 0.01) / np.pi for gap in FREE]
    worst = max(abs(a - b) for a, b in zip(ratios, known, strict=True))
    text = f"{listed(ratios)} of the linear period, at gaps of 0.5, 0 and -0.5 amplitudes"
    return claim(text, worst < 1e-9, f"1/2 + asin(gap/A)/pi, worst difference {worst:.0e}")


def hammer(p) -> float:
    """Impact velocity [m/s] of Tsaplin's hammer, one impact a period of the force (eqs. 5.1, 5.2), the faster solution.

    x = A sin(w t + theta) − (1 + R) V/(2 w_n sin(w_n T/2)) cos(w_n (t − T/2)) between impacts at t = 0 and T, so that
    A w cos(theta) = V (1 − R)/2 and A sin(theta) = gap + (1 + R) V cot(w_n T/2)/(2 w_n).
    """
    w, wn, r = p["frequency"], p["natural"], p["restitution"]
    swing = p["drive"] / (wn**2 - w**2)
    slope, lean = (1 - r) / (2 * w), (1 + r) / (2 * wn * np.tan(wn * np.pi / w))
    a, b, c = slope**2 + lean**2, 2 * p["gap"] * lean, p["gap"] ** 2 - swing**2
    return float((-b + np.sqrt(b**2 - 4 * a * c)) / (2 * a))


def _hammer(found) -> Here:
    here, known = float(found.before[-1]), hammer(HAMMER)
    spread = float(np.ptp(found.before[-10:]))
    note = f"the periodic solution has {known:.6f} m/s; the last ten impacts differ by {spread:.0e}"
    return claim(f"{here:.6f} m/s before each impact, w = 1.5 w_n", abs(here / known - 1) < 1e-6, note)


def _integer(found) -> Here:
    period = 2 * np.pi / 20.0
    gaps = np.diff(found.times[-10:]) / period
    here, known = float(found.before[-1]), hammer(INTEGER)
    note = f"impact velocity {here:.6f} m/s, the periodic solution has {known:.6f}"
    return claim(f"{gaps.mean():.4f} periods of the force between impacts, w = 2 w_n", bool(np.ptp(gaps) < 1e-6), note)


def _thrown(found) -> Here:
    period = 2 * np.pi / BALL["frequency"]
    known = 9.81 * period / (1 + BALL["restitution"])
    return number(
        float(found.before[-1]),
        known,
        "m/s",
        1e-6,
        "g T/(1 + R), one impact a period; dropped from less than 0.15 m the ball chatters and rests instead",
    )


def _phase(found) -> Here:
    r, w = BALL["restitution"], BALL["frequency"]
    known = np.pi * 9.81 / BALL["drive"] * (1 - r) / (1 + r)
    here = -float(np.cos(w * found.times[-1]))
    return claim(
        f"{here:.6f} is the sine of the phase at impact",
        abs(here - known) < 1e-6,
        f"pi m g (1 − R)/(F (1 + R)) = {known:.6f}",
    )


_KNOWN = "1e-6 of the known solution"
GROUP = Group(
    name="classical",
    title="Classical checks",
    text="The machines of chapter 5's review have periodic motions in closed form. They are small scenes of their own, "
    "stepped like the others: the contact is right, and a scene is quick to add.",
    entries=(
        Entry(
            "fig-5.7",
            "period of the free oscillator on an elastic stop",
            "never over that without the stop, 1",
            tuple(FREE.values()),
            _free,
            "1e-9 of the closed form",
        ),
        Entry(
            "eq-5.1",
            "Tsaplin's hammer, w = 1.5 w_n, R 0.5: impact velocity",
            "periodic, with the velocity of the known solution",
            (HAMMERED,),
            _hammer,
            _KNOWN,
        ),
        Entry(
            "eq-5.2",
            "Tsaplin's hammer, w = 2 w_n, R 0.5, no gap",
            "periodic where w/w_n is an integer",
            (HAMMERED_AT_TWICE,),
            _integer,
            "the time between the last ten impacts is constant to 1e-6",
        ),
        Entry(
            "eq-5.3a",
            "ball thrown by a force: impact velocity",
            "periodic, g T/(1 + R) = 1.926 m/s",
            (THROWN,),
            _thrown,
            _KNOWN,
        ),
        Entry(
            "eq-5.3b",
            "ball thrown by a force: phase of the impact",
            "fixed by the force, 0.642",
            (THROWN,),
            _phase,
            _KNOWN,
        ),
        Entry(
            "eq-5.6",
            "duration of a blow on the contact, xi 0.3",
            "depends on frequency and loss factor only",
            (ONE_BLOW[0.3], SLOW_BLOW),
            _duration,
            "1e-4 of the closed form",
            ("R29",),
        ),
        Entry(
            "eq-5.8",
            "restitution over the loss factor",
            "falls with it from 1",
            tuple(ONE_BLOW.values()),
            _restitution,
            "1e-3 of the closed form with its root read as 1 − xi²",
            ("R29",),
        ),
        Entry(
            "listing-a3-1",
            "restitution for loss factors 0.5 to 0.91",
            "0.1 to 0.3",
            tuple(ONE_BLOW.values()),
            _listing,
            "within the range",
            ("R29",),
        ),
    ),
    pictures=(
        Picture(
            "Figs 5.1, 5.2 and 5.7",
            "Free oscillator on a stop, hammer, and ball: displacement over time.",
            (FREE[0.005], HAMMERED, THROWN),
            pictures.struck,
        ),
        Picture(
            "Eq. 5.8",
            "Restitution of one blow over the loss factor: simulated (points) and in closed form.",
            tuple(ONE_BLOW.values()),
            pictures.restitutions,
        ),
    ),
)
