"""Periodic orbits of random points, and how much their multipliers differ from independently computed ones."""

from typing import Any, NamedTuple

import numpy as np
from exact import friction, orbits
from exact.motion import Motion

import vibrojax as vj

BOX = {
    "beta": (0.1, 1.2),
    "gamma": (0.3, 1.2),
    "v": (0.2, 2.0),
    "delta": (-0.02, 0.01),
    "c0": (0.0, 2e4),
    "c2": (50.0, 400.0),
}
"""Ranges of the parameters. They exceed the default map, and include contact dampers, which make the force jump."""

LAWS: dict[str, dict[str, tuple[float, float]]] = {
    "stribeck": {"mu": (0.02, 0.6), "v_cr": (0.5, 5.0)},
    "hyperbolic": {"mu0": (0.02, 0.6), "delta_f": (0.3, 5.0)},
    "popp-exponential": {},
    "popp-arctan": {"a1": (0.05, 0.2)},
}
"""Laws under which the drill is self-excited, with the ranges of their parameters. The last law never sticks."""

FAR_FROM_GRAZING = 1e-3
"""Margin above which a finite difference does not change the order of events."""


class Orbit(NamedTuple):
    """An orbit of a lane.

    `section` is the state (x1, x2, x2') at the section. `span` [s] is the time of all `cycles` returns. `stick` and
    `reverse` are shares of time.
    """

    point: dict[str, Any]
    section: np.ndarray
    span: float
    cycles: int
    multipliers: np.ndarray
    stick: float
    reverse: float


def drawn(law: str, points: int, seed: int) -> list[Orbit]:
    """Return the orbits, away from grazing, on which the lanes of random points end."""
    random = np.random.default_rng(seed)
    columns = {name: random.uniform(*ends, points).tolist() for name, ends in (BOX | LAWS[law]).items()}
    sweep = {"scene": "vibro-impact", "points": columns, "starts": ["stuck"], "unusual": True}
    dataset = vj.run_sweep(sweep | {"parameters": {"friction": law}, "run": {"orbits": True}}, progress=False)
    dataset = dataset.isel(start=0)
    selected = (dataset.orbit_reason == 0) & (dataset.orbit_cycles == dataset.cycles)
    selected &= dataset.grazing_margin > FAR_FROM_GRAZING
    return [_orbit(dataset.isel(point=index), columns, law) for index in np.flatnonzero(selected.values)]


def _orbit(lane, columns, law) -> Orbit:
    cycles = int(lane.cycles)
    return Orbit(
        point={name: column[int(lane.point)] for name, column in columns.items()} | {"friction": law},
        section=np.array([lane[f"orbit_{name}"].item() for name in ("x1", "x2", "v2")]),
        span=lane.period.item() * cycles,
        cycles=cycles,
        multipliers=lane.multiplier_abs.values * np.exp(1j * lane.multiplier_arg.values),
        stick=lane.stick_fraction.item(),
        reverse=lane.reverse_fraction.item(),
    )


def off_by_differences(orbit: Orbit) -> float:
    """Return the largest distance of the multipliers from those of the exact motion by central differences."""
    exact = orbits.multipliers("vibro-impact", orbit.point, orbit.section, orbit.span, orbit.cycles)
    return float(np.max(np.abs(orbits.in_upper_half(orbit.multipliers) - orbits.in_upper_half(exact))))


def off_by_volumes(orbit: Orbit) -> tuple[float, float]:
    """Return the relative error of the multipliers' product against the exact volume change, and the saltations' part.

    The error is relative to the product, or to 1e-6 if the product is smaller, because then the least multiplier is
    within rounding errors of the largest. Only for orbits that do not stick.
    """
    product, jumps = volume_change("vibro-impact", orbit.point, orbit.section, orbit.span)
    return abs(np.prod(np.abs(orbit.multipliers)) - abs(product)) / max(abs(product), 1e-6), jumps


def volume_change(scene: str, point: dict, section, span: float) -> tuple[float, float]:
    """Return the product of the multipliers of an orbit with period `span` [s], and the part of it due to saltations.

    It follows from the change of volumes along the flow. Within a mode, this is exp of the integrated divergence. At a
    switch it is the determinant of the saltation matrix, n f+ / n f-, for a continuous state and a surface with normal
    n (Leine and Nijmeijer, chapter 7). It applies to orbits that do not stick; sticking makes one multiplier zero.
    """
    motion = orbits.motion_from(scene, point, section, span)
    exponent = sum(piece.integral(lambda t, Y, p=piece.phase: _divergence(motion, p, Y)) for piece in motion.pieces)
    jumps = float(np.prod([_jump(motion, event) for event in motion.events]))
    return float(np.exp(exponent)) * jumps, jumps


def _divergence(motion: Motion, phase, states) -> np.ndarray:
    """Return the divergence of the vector field of a phase: the trace of its linear part, and the slope of friction."""
    assert phase.bit, "it sticks"
    scene, p, h = motion.scene, motion.scene.p, 2e-5
    mode = scene.mode(phase)
    u, J = phase.bit * (states[:, 1] + p.v), states @ scene.J(phase)
    near = [friction.force(u + k * h, J, p) for k in (-2, -1, 1, 2)]
    slope = (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * h)
    return np.trace(mode.A) - slope / p.m1


def _jump(motion: Motion, event) -> float:
    scene = motion.scene
    normal = scene.surfaces(event.before)[event.name]

    def rate(phase):
        mode = scene.mode(phase)
        return normal @ (mode.A @ event.state + mode.G * mode.force(event.time, event.state[None])[0])

    return rate(event.after) / rate(event.before)
