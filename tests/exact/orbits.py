"""Multipliers of periodic orbits, by two methods that need no derivative of an event.

The first uses central differences of the return map. The second gives the product of the multipliers from the change of
volumes along the flow. Within a mode, this is exp of the integrated divergence. At a switch it is the determinant of
the saltation matrix, n f+ / n f-, for a continuous state and a surface with normal n (Leine and Nijmeijer, chapter 7).
"""

import numpy as np

from exact import friction
from exact.measures import sections
from exact.motion import Motion, run

SIZES = {"x1": 0.05, "x2": 0.05, "v2": 1.0, "e": 5e-3, "v3": 0.1}
"""Typical states at the section, where x1' = 0 [m, m/s]. The last two apply only if the rock acts back."""


def returns(scene: str, point: dict, section, span: float) -> tuple[list[float], np.ndarray]:
    """Return the times [s] of the returns within `span` [s] after the one at `section`, and the states there."""
    motion = _from(scene, point, section, span)
    times = sections(motion)
    names = [motion.scene.entries.index(name) for name in list(SIZES)[: len(section)]]
    return times, motion.at(times)[:, names]


def multipliers(scene: str, point: dict, section, span: float, cycles: int = 1) -> np.ndarray:
    """Return the eigenvalues of the map's derivative over `cycles` returns, by decreasing modulus.

    Central differences are taken return by return, so that nonlinear effects do not grow. The steps are 1e-6 of the
    sizes.
    """
    product = np.eye(len(section))
    times, states = returns(scene, point, section, 1.01 * span)
    for state, time in zip([section, *states[: cycles - 1]], np.diff([0.0, *times[:cycles]]), strict=True):
        columns = []
        for k, size in enumerate(list(SIZES.values())[: len(section)]):
            moved = 1e-6 * size * np.eye(len(section))[k]
            (_, after), (_, before) = (returns(scene, point, state + sign * moved, 1.01 * time) for sign in (1, -1))
            columns.append((after[0] - before[0]) / (2 * moved[k]))
        product = np.array(columns).T @ product
    values = np.linalg.eigvals(product)
    return values[np.argsort(-np.abs(values), kind="stable")]


def product(scene: str, point: dict, section, span: float) -> tuple[float, float]:
    """Return the product of the multipliers of an orbit with period `span` [s], and the part of it due to saltations.

    It applies to orbits that do not stick; sticking makes one multiplier zero.
    """
    motion = _from(scene, point, section, span)
    exponent = sum(piece.integral(lambda t, Y, p=piece.phase: _divergence(motion, p, Y)) for piece in motion.pieces)
    jumps = float(np.prod([_jump(motion, event) for event in motion.events]))
    return float(np.exp(exponent)) * jumps, jumps


def _from(scene: str, point: dict, section, observe: float) -> Motion:
    x1, x2, v2, *rock = section
    return run(scene, start=[x1, 0.0, x2, v2, *rock], observe=observe, **point)


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
