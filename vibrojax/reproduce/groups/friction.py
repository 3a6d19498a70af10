"""The friction laws of chapters 3 and 5: their curves, and what the choice of the law does to the drill."""

import numpy as np

from vibrojax.reproduce import _signal as signal
from vibrojax.reproduce._entry import Entry, Here, claim, listed, trend
from vibrojax.reproduce._friction import LAWS, curve
from vibrojax.reproduce._group import Group, Picture
from vibrojax.reproduce._needs import ALL_STARTS, grid, motion
from vibrojax.reproduce.pictures import friction as pictures

SPEEDS = np.linspace(0.0, 5.0, 20001)
_AXES = {
    "beta": np.round(np.arange(0.2, 0.801, 0.1), 2),
    "gamma": np.round(np.arange(0.5, 1.001, 0.1), 2),
}
MAPS = tuple(grid(f"regimes under {law}", "vibro-impact", _AXES, ALL_STARTS, friction=law) for law in LAWS)
"""From all starts, so that the source's own law needs no program of its own."""
FALLING = {"coulomb": 1.5, "popp-exponential": 1.5, "popp-arctan": 0.5, "hyperbolic": 1.5, "hyperbolic-quadratic": 0.05}
"""A drive speed [m/s] on the falling branch of each law, where it has one."""
FREE = {law: motion("rotary", 40.0, sampling=5e-3, friction=law, v=v) for law, v in FALLING.items()}


def _constant() -> Here:
    mu = curve("coulomb", SPEEDS)
    return claim(f"{np.ptp(mu):g} is the range of mu", np.ptp(mu) == 0)


def _rises_then_falls(law: str):
    def judge() -> Here:
        mu = curve(law, SPEEDS)
        top = int(np.argmax(mu))
        holds = 0 < top < len(mu) - 1 and mu[-1] < 0.9 * mu[top]
        return trend(f"{SPEEDS[top]:.3f} m/s is where mu is greatest, {mu[top]:.3f}; {mu[-1]:.3f} at 5 m/s", holds)

    return judge


def _falls() -> Here:
    mu = curve("hyperbolic", SPEEDS)
    return trend(f"{mu[0]:.3f} at rest, {mu[-1]:.3f} at 5 m/s", bool(np.all(np.diff(mu) < 0)))


def _falls_then_rises(law: str):
    def judge() -> Here:
        mu = curve(law, SPEEDS)
        low = int(np.argmin(mu))
        text = f"{SPEEDS[low]:.2f} m/s is where mu is least, {mu[low]:.3f}; {mu[0]:.3f} at rest"
        return trend(text, 0 < low < len(mu) - 1)

    return judge


def _critical() -> Here:
    mu = curve("stribeck", SPEEDS)
    low = int(np.argmin(mu))
    text = f"{SPEEDS[low]:.3f} m/s is where mu is least, {mu[low] / mu[0]:.4f} of that at rest"
    return claim(text, abs(SPEEDS[low] - 3) < 1e-3 and abs(mu[low] / mu[0] - 1 / 3) < 1e-6)


def _sustains(law: str, expected: bool):
    def judge(moving) -> Here:
        v = FALLING[law]
        swing = signal.amplitude(moving, "v1", 35.0) / v
        lasts = swing > 0.1
        text = f"{swing:.2g} times the drive's velocity after 35 s, v {v} m/s"
        return claim(text, lasts == expected)

    return judge


def _matters(*maps) -> Here:
    """How often the regime is another than under the source's law."""
    own = maps[-1].regime
    off = [float((ds.regime != own).mean()) for ds in maps[:-1]]
    single = [float((ds.regime == 3).mean()) for ds in maps]
    text = f"{listed(off)} of the map has another regime under {', '.join(LAWS[:-1])}"
    note = f"a single impact on {listed(single)} of it under {', '.join(LAWS)}; beta 0.2 to 0.8, gamma 0.5 to 1.0"
    return trend(text, min(off) > 0.1, note)


_FORM = "the form of the curve between 0 and 5 m/s"
_LASTS = "over a tenth of the drive's velocity is left in the bit's after 35 s, or not"
GROUP = Group(
    name="friction",
    title="Friction laws",
    text="Chapter 3 shows six kinds of friction; each can be used in any scene by its name. A falling branch is what "
    "excites the vibration, so the law matters: below, the drill's regimes under each of them.",
    entries=(
        Entry("eq-2.13", "Coulomb friction (Fig. 3.8a)", "constant, 0 range", (), _constant, _FORM),
        Entry(
            "eq-2.14",
            "Popp's exponential law (Fig. 3.10)",
            "rises, passes a maximum, falls slightly",
            (),
            _rises_then_falls("popp-exponential"),
            _FORM,
            ("R28",),
        ),
        Entry(
            "eq-2.15",
            "Popp's arctangent law (Fig. 3.11a)",
            "rises and falls",
            (),
            _rises_then_falls("popp-arctan"),
            _FORM,
            ("R28",),
        ),
        Entry("eq-2.16", "hyperbolic law (Fig. 3.11b)", "falls towards 0", (), _falls, _FORM, ("R28",)),
        Entry(
            "eq-2.17",
            "hyperbolic and quadratic law (Fig. 3.13a)",
            "falls steeply to a minimum, then rises",
            (),
            _falls_then_rises("hyperbolic-quadratic"),
            _FORM,
            ("R28",),
        ),
        Entry(
            "eq-5.9",
            "the law used (Fig. 5.12): its critical speed",
            "v_cr, with a third of the static friction (3 m/s)",
            (),
            _critical,
            "the grid of 0.25 mm/s",
            ("R4",),
        ),
        Entry(
            "fig-3.8",
            "self-excitation under Coulomb friction",
            "none: no instability, 0",
            (FREE["coulomb"],),
            _sustains("coulomb", False),
            _LASTS,
        ),
        Entry(
            "fig-3.11a",
            "self-excitation under Popp's arctangent law",
            "yes: a falling branch",
            (FREE["popp-arctan"],),
            _sustains("popp-arctan", True),
            _LASTS,
            ("R28",),
        ),
        Entry(
            "fig-3.11b",
            "self-excitation under the hyperbolic law",
            "yes: a falling branch",
            (FREE["hyperbolic"],),
            _sustains("hyperbolic", True),
            _LASTS,
            ("R28",),
        ),
        Entry(
            "fig-3.13",
            "self-excitation under the hyperbolic and quadratic law",
            "yes: a falling branch",
            (FREE["hyperbolic-quadratic"],),
            _sustains("hyperbolic-quadratic", True),
            _LASTS,
            ("R28",),
        ),
        Entry(
            "sec-5.3.2",
            "regimes of the drill under the other laws",
            "the law must be chosen carefully",
            MAPS,
            _matters,
            "each other law changes the regime of over a tenth of the map",
            ("R28",),
        ),
    ),
    pictures=(
        Picture(
            "Figs 3.8 to 3.13 and 5.12",
            "Friction coefficient of the six laws over the sliding speed.",
            (),
            pictures.curves,
        ),
        Picture(
            "Section 5.3.2",
            "Regimes over mass and frequency ratio under each law, from the start `drive` (gap -5 mm).",
            MAPS,
            pictures.regimes,
        ),
    ),
)
