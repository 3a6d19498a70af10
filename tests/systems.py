"""Systems written as plain functions with public names only. Their closed forms are in `own_scenes` and here."""

import numpy as np
from scipy.linalg import expm

import vibrojax as vj

positive, table = vj.parameters.positive, vj.parameters.table
cos, sin = vj.elementary.cos, vj.elementary.sin

IMPACT_OSCILLATOR = vj.System(
    "impact-oscillator",
    states={"x": "m", "v": "m s-1"},
    parameters={"stiffness": 1.0, "damping": 0.1, "a": 1.0, "w": 0.9, "stop": 1.0, "r": 0.7},
    field=lambda t, y, p: {
        "x": y["v"],
        "v": p["a"] * cos(p["w"] * t) - p["damping"] * y["v"] - p["stiffness"] * y["x"],
    },
    period=lambda p: 2 * np.pi / p["w"],
    events=[vj.Impact("stop_hit", gap=lambda t, y, p: p["stop"] - y["x"], velocity="v", restitution=lambda p: p["r"])],
)
"""A mass on a spring, shaken against a stop: Shaw and Holmes, Journal of Sound and Vibration 90 (1983), 129."""

BALL = vj.System(
    "ball",
    states={"x": "m", "v": "m s-1"},
    parameters={"g": 9.81, "a": 0.0, "w": 2 * np.pi, "r": 0.5},
    field=lambda t, y, p: {"x": y["v"], "v": -p["g"]},
    period=lambda p: 2 * np.pi / p["w"],
    events=[
        vj.Impact(
            "table",
            gap=lambda t, y, p: y["x"] + p["a"] * cos(p["w"] * t),
            velocity="v",
            restitution=lambda p: p["r"],
        )
    ],
)
"""A ball on a shaken table: Guckenheimer and Holmes, *Nonlinear Oscillations*, 1983, section 2.4."""

BELT = vj.System(
    "belt",
    states={"x": "m", "v": "m s-1"},
    parameters={"k": 1.0, "belt_speed": 0.2, "mu_k": 0.2, "mu_s": 0.4, "N": 1.0},
    field=lambda t, y, p: {"x": y["v"], "v": -p["k"] * y["x"]},
    section="v",
    events=[
        vj.Friction(
            "sliding",
            relative=lambda t, y, p: y["v"] - p["belt_speed"],
            normal=lambda t, y, p: p["N"],
            law=lambda p: p["mu_k"],
            static=lambda p: p["mu_s"],
            acts_on="v",
        )
    ],
)
"""A mass on a belt with a static and a lower kinetic friction: Den Hartog, *Mechanical Vibrations*."""


def belt_period(v: float, rise: float, w: float = 1.0) -> float:
    """Return the period of stick-slip. `rise` is the change of the spring's length between static and kinetic friction.

    While the mass slips, it swings about the kinetic equilibrium, from `rise` above it to `rise` below it. While it
    sticks, the belt carries it back.
    """
    return 2 * (np.pi - np.arctan(rise * w / v)) / w + 2 * rise / v


SHAKEN = vj.System(
    "shaken-against-friction",
    states={"x": "m", "v": "m s-1"},
    parameters={"grip": 0.5, "w": 1.5, "zeta": 0.1},
    field=lambda t, y, p: {"x": y["v"], "v": cos(p["w"] * t) - 2 * p["zeta"] * y["v"] - y["x"]},
    period=lambda p: 2 * np.pi / p["w"],
    events=[
        vj.Friction(
            "sliding",
            relative=lambda t, y, p: y["v"],
            normal=lambda t, y, p: p["grip"],
            law=1.0,
            acts_on="v",
        )
    ],
)
"""A mass on a spring, shaken against Coulomb friction: Den Hartog, Transactions of the ASME 53 (1931), 107; Shaw,
Journal of Sound and Vibration 108 (1986), 305."""


def friction_stops(w: float, zeta: float) -> float:
    """Return the friction, relative to the amplitude of the force, above which the mass of `SHAKEN` stops at its
    turning points.

    In the half cycle from x0 to -x0, the distance z from the forced oscillation satisfies z(T/2) = M z(0), and the
    friction displaces the equilibrium. The amplitude follows from the half cycle. It is also the amplitude at which the
    force just overcomes twice the friction where the mass turns.
    """
    half = expm(np.array([[0.0, 1.0], [-1.0, -2 * zeta]]) * np.pi / w)
    g, h = np.linalg.solve(np.eye(2) + half, (np.eye(2) - half)[:, 0])
    amplitude = (1 + (1 - w**2) * g + 2 * zeta * h) / w**2  # relative to the friction
    return float(1 / abs(complex(1 - w**2, 2 * zeta * w)) / np.hypot(amplitude + g, h / w))


BILINEAR = vj.System(
    "bilinear",
    states={"x": "m", "v": "m s-1"},
    parameters={"k1": 1.0, "k2": 9.0},
    field=lambda t, y, p, s: {
        "x": y["v"],
        "v": -0.5 * ((p["k1"] + p["k2"]) + (p["k2"] - p["k1"]) * s["side"]) * y["x"],
    },
    section="v",
    events=[vj.Switch("side", lambda t, y, p: y["x"])],
)
"""A bilinear oscillator; its natural frequency is 2 w1 w2/(w1 + w2): Shaw and Holmes, as above."""

RELAY = vj.System(
    "relay",
    states={"x": "1", "y": "1"},
    parameters={"gain": 1.0},
    field=lambda t, y, p, s: {"x": y["y"], "y": -p["gain"] * s["surface"]},
    section="x",
    events=[vj.Switch("surface", lambda t, y, p: y["x"] + y["y"])],
)
"""A relay with the sliding surface x + y = 0, on which x decays as exp(-t)."""
