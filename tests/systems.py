"""Systems written as plain functions with public names only, and their closed forms."""

from inspect import signature
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import vibrojax as vj

positive, table = vj.parameters.positive, vj.parameters.table
cos = vj.elementary.cos


def system(states, field, *events, name="own", parameters=None, **options):
    """Return a system; states that are names only have no unit."""
    states = states if isinstance(states, dict) else dict.fromkeys(states, "1")
    return vj.System(name, states=states, parameters=parameters or {"q": 1.0}, field=field, events=events, **options)


def mass(rate, *events, name="mass", parameters=None, **options):
    """Return a system of one mass; `rate` gives its acceleration, as a field does. The period is 1 s by default."""
    fields = {3: lambda t, y, p: {"x": y["v"], "v": rate(t, y, p)}}
    fields[4] = lambda t, y, p, s: {"x": y["v"], "v": rate(t, y, p, s)}
    field, states = fields[len(signature(rate).parameters)], {"x": "m", "v": "m s-1"}
    return system(states, field, *events, name=name, parameters=parameters, **(options or {"period": 1.0}))


def one_state(rate, *events, **options):
    """Return a system of one state x; `rate` gives its rate, as a field does."""
    fields = {3: lambda t, y, p: {"x": rate(t, y, p)}, 4: lambda t, y, p, s: {"x": rate(t, y, p, s)}}
    return system("x", fields[len(signature(rate).parameters)], *events, name="one-state", **options)


def ends(system, start, duration, **options):
    """Return the states at the end of a trajectory."""
    motion = vj.simulate(system, start=start, duration=duration, progress=False, **options)
    return [float(motion[name][-1]) for name in system.start_states]


def events_of(motion, kind):
    """Return the times [s] of a motion's events of this kind."""
    flag = motion.event_kind.attrs["flag_meanings"].split().index(kind)
    return motion.event_time.values[motion.event_kind.values == flag]


def names_of(ds, variable="regime"):
    """Return the names of a variable's flags by lane."""
    return np.array(ds[variable].attrs["flag_meanings"].split())[ds[variable].values.ravel()].tolist()


def special_values(family, kind, branch=0):
    """Return the parameter values of the special points of a kind on a branch."""
    flag = family.special_kind.attrs["flag_meanings"].split().index(kind)
    chosen = (family.special_kind.values == flag) & (family.special_branch.values == branch)
    return family.special_value.values[chosen]


IMPACT_OSCILLATOR = mass(
    lambda t, y, p: p["a"] * cos(p["w"] * t) - p["damping"] * y["v"] - p["stiffness"] * y["x"],
    vj.Impact("stop_hit", gap=lambda t, y, p: p["stop"] - y["x"], velocity="v", restitution=lambda p: p["r"]),
    name="impact-oscillator",
    parameters={"stiffness": 1.0, "damping": 0.1, "a": 1.0, "w": 0.9, "stop": 1.0, "r": 0.7},
    period=lambda p: 2 * np.pi / p["w"],
)
"""A mass on a spring, shaken against a stop: Shaw and Holmes, Journal of Sound and Vibration 90 (1983), 129."""

WALLS = mass(
    lambda t, y, p: cos(0.9 * t) - 0.06 * y["v"] - y["x"],
    vj.Impact("right", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=lambda p: p["r"]),
    vj.Impact("left", gap=lambda t, y, p: p["d"] + y["x"], velocity="v", restitution=lambda p: p["r"]),
    name="walls",
    parameters={"d": 0.32, "r": 0.7},
    period=lambda p: 2 * np.pi / 0.9,
)
"""The same mass between two walls: symmetric orbits, and pairs of asymmetric ones."""

BALL = mass(
    lambda t, y, p: -p["g"],
    vj.Impact("table", lambda t, y, p: y["x"] + p["a"] * cos(p["w"] * t), "v", restitution=lambda p: p["r"]),
    name="ball",
    parameters={"g": 9.81, "a": 0.0, "w": 2 * np.pi, "r": 0.5},
    period=lambda p: 2 * np.pi / p["w"],
)
"""A ball on a shaken table: Guckenheimer and Holmes, *Nonlinear Oscillations*, 1983, section 2.4."""

_BELT_FRICTION = {"normal": lambda t, y, p: p["N"], "law": lambda p: p["mu_k"], "static": lambda p: p["mu_s"]}
BELT = mass(
    lambda t, y, p: -p["k"] * y["x"],
    vj.Friction("sliding", relative=lambda t, y, p: y["v"] - p["belt_speed"], acts_on="v", **_BELT_FRICTION),
    name="belt",
    parameters={"k": 1.0, "belt_speed": 0.2, "mu_k": 0.2, "mu_s": 0.4, "N": 1.0},
    section="v",
)
"""A mass on a belt with a static and a lower kinetic friction: Den Hartog, *Mechanical Vibrations*."""


def belt_period(v: float, rise: float, w: float = 1.0) -> float:
    """Return the period of stick-slip. `rise` is the change of the spring's length between static and kinetic friction.
    While the mass slips, it swings about the kinetic equilibrium, from `rise` above it to `rise` below it. While it
    sticks, the belt carries it back."""
    return 2 * (np.pi - np.arctan(rise * w / v)) / w + 2 * rise / v


RELAY = system(
    "xy",
    lambda t, y, p, s: {"x": y["y"], "y": -p["gain"] * s["surface"]},
    vj.Switch("surface", lambda t, y, p: y["x"] + y["y"]),
    name="relay",
    parameters={"gain": 1.0},
    section="x",
)
"""A relay with the sliding surface x + y = 0, on which x decays as exp(-t)."""

VAN_DER_POL = system(
    {"x": "1", "v": "s-1"},
    lambda t, y, p: {"x": y["v"], "v": p["mu"] * (1 - y["x"] ** 2) * y["v"] - y["x"]},
    name="relaxation",
    parameters={"mu": 1.0},
    section="x",
)

FAST = table(positive("mu_d", 0.5, "1", "friction of fast sliding", "mu_d"))
EXPONENTIAL = vj.FrictionLaw("exponential", "", FAST, lambda u, p: p["mu_d"] * (1 + vj.elementary.exp(-u / 0.5)))
BELT_OSCILLATOR = mass(
    lambda t, y, p: -y["x"] - 0.1 * y["v"],
    vj.Friction("sliding", lambda t, y, p: y["v"] - p["belt"], lambda t, y, p: 1.0, law=EXPONENTIAL, acts_on="v"),
    name="belt-oscillator",
    parameters={"belt": (1.5, "m s-1")},
    section="v",
)
"""The friction oscillator of Stender and Hoffmann, bSTAB (Nonlinear Dynamics 2021)."""


def lorenz(section):
    def field(t, y, p):
        across = y["x"] * y["y"] - 8 / 3 * (y["w"] + p["r"] - 1.0)
        return {"x": 10.0 * (y["y"] - y["x"]), "y": y["x"] * (1.0 - y["w"]) - y["y"], "w": across}

    return system("xyw", field, name="lorenz", parameters={"r": 28.0}, section=section)


class Rigid(NamedTuple):
    """An orbit of one impact, with the force's `phase` [rad] and the mass's `speed` [m/s] there. `multipliers` are
    sorted by falling modulus. `section` is the state (x, v) at the section."""

    phase: float
    speed: float
    multipliers: np.ndarray
    section: np.ndarray


def _multipliers(trace: float, determinant: float) -> np.ndarray:
    multipliers = np.roots([1.0, -trace, determinant])
    return multipliers[np.argsort(-np.abs(multipliers), kind="stable")]


def oscillator_grazes(w: float, stiffness: float, damping: float, stop: float) -> float:
    """Return the amplitude `a` at which the steady motion without impact touches the stop, soft or rigid."""
    return float(stop * np.hypot(stiffness - w**2, damping * w))


def oscillator_orbits(a, R, w, stiffness, damping, stop, n=1) -> list[Rigid]:
    """Return the orbits of one impact in `n` periods, by impact speed, including those that cross the stop.

    With E the flow of the homogeneous equation over the time between impacts, the state relative to the forced motion,
    u = (stop - p, -q), obeys (E - 1) u = V (R E + 1) e2, and (p, q/w) lies on the circle of the forced motion: Shaw and
    Holmes, Journal of Sound and Vibration 90 (1983), 129.
    """
    E, forced = _flow(2 * np.pi * n / w, stiffness, damping), a / complex(stiffness - w**2, damping * w)
    u = np.linalg.solve(E - np.eye(2), (R * E + np.eye(2)) @ [0.0, 1.0])
    square = [u[0] ** 2 + (u[1] / w) ** 2, -2 * stop * u[0], stop**2 - abs(forced) ** 2]
    orbits = []
    for V in sorted(root.real for root in np.roots(square) if root.imag == 0 and root.real > 0):
        p, q = stop - V * u[0], -V * u[1]
        phase = (np.angle(complex(p, -q / w)) - np.angle(forced)) % (2 * np.pi)
        push = a * np.cos(phase) - stiffness * stop
        before, after = push - damping * V, push + damping * R * V
        saltation = np.array([[-R, 0.0], [(after + R * before) / V, -R]])
        M = E @ saltation
        since = _flow((2 * np.pi * n - phase) / w, stiffness, damping) @ (np.array([stop, -R * V]) - [p, q])
        section = since + [forced.real, -w * forced.imag]
        orbits.append(Rigid(phase, V, _multipliers(np.trace(M), np.linalg.det(M)), section))
    return orbits


def oscillator_doubles(between, R, w, stiffness, damping, stop, n=1) -> float:
    """Return the amplitude `a`, within `between`, at which the fastest orbit doubles: 1 + trace + determinant = 0."""
    product = lambda a: float(np.prod(1 + oscillator_orbits(a, R, w, stiffness, damping, stop, n)[-1].multipliers).real)
    return float(brentq(product, *between, xtol=1e-15))


def _flow(t: float, stiffness: float, damping: float) -> np.ndarray:
    """Return the flow of x'' = -stiffness x - damping x' over t, below critical damping."""
    half = damping / 2
    wd = np.sqrt(stiffness - half**2)
    cos, sin_over = np.cos(wd * t), np.sin(wd * t) / wd
    turn = [[cos + half * sin_over, sin_over], [-stiffness * sin_over, cos - half * sin_over]]
    return np.exp(-half * t) * np.array(turn)


def ball_appears(R: float) -> float:
    """Return a/g at which the orbit of a ball that meets the table once per period appears, in a fold. The ball flies
    for a period T, so that it leaves and meets the table at speed gT/2, where the table's velocity is gT/2 (1 - R)/(1 +
    R). The determinant is R², the trace 1 + R² - (1 + R)² (a/g) sin: Guckenheimer and Holmes, *Nonlinear Oscillations*,
    1983, section 2.4, here without the approximation of high bounces."""
    return np.pi * (1 - R) / (1 + R)


def ball_doubles(R: float) -> float:
    """Return a/g at which its period doubles."""
    return float(np.hypot(ball_appears(R), 2 * (1 + R**2) / (1 + R) ** 2))


SHAKEN = mass(
    lambda t, y, p: cos(p["w"] * t) - 2 * p["zeta"] * y["v"] - y["x"],
    vj.Friction("sliding", lambda t, y, p: y["v"], normal=lambda t, y, p: p["grip"], law=1.0, acts_on="v"),
    name="shaken",
    parameters={"grip": 0.5, "w": 1.5, "zeta": 0.1},
    period=lambda p: 2 * np.pi / p["w"],
)
"""A mass on a spring, shaken against Coulomb friction: Den Hartog, Transactions of the ASME 53 (1931), 107; Shaw,
Journal of Sound and Vibration 108 (1986), 305."""


def friction_stops(w: float, zeta: float) -> float:
    """Return the friction, relative to the amplitude of the force, above which the mass of `SHAKEN` stops at its
    turning points. In the half cycle from x0 to -x0, the distance z from the forced oscillation satisfies z(T/2) = M
    z(0), and the friction displaces the equilibrium. The amplitude follows from the half cycle. It is also the
    amplitude at which the force just overcomes twice the friction where the mass turns."""
    half = expm(np.array([[0.0, 1.0], [-1.0, -2 * zeta]]) * np.pi / w)
    g, h = np.linalg.solve(np.eye(2) + half, (np.eye(2) - half)[:, 0])
    amplitude = (1 + (1 - w**2) * g + 2 * zeta * h) / w**2  # relative to the friction
    return float(1 / abs(complex(1 - w**2, 2 * zeta * w)) / np.hypot(amplitude + g, h / w))
