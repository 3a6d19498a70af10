"""Returns and multipliers of periodic orbits, by central differences of the return map."""

import numpy as np

from exact.measures import sections
from exact.motion import Motion, run

SIZES = {"x1": 0.05, "x2": 0.05, "v2": 1.0, "e": 5e-3, "v3": 0.1}
"""Typical states at the section, where x1' = 0 [m, m/s]. The last two apply only if the rock acts back."""


def returns(scene: str, point: dict, section, span: float) -> tuple[list[float], np.ndarray]:
    """Return the times [s] of the returns within `span` [s] after the one at `section`, and the states there."""
    motion = motion_from(scene, point, section, span)
    times = sections(motion)
    names = [motion.scene.entries.index(name) for name in list(SIZES)[: len(section)]]
    return times, motion.at(times)[:, names]


def multipliers(scene: str, point: dict, section, span: float, cycles: int = 1) -> np.ndarray:
    """Return the eigenvalues of the map's derivative over `cycles` returns, by decreasing modulus. Central differences
    are taken return by return, so that nonlinear effects do not grow. The steps are 1e-6 of the sizes."""
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


def in_upper_half(values) -> np.ndarray:
    """Return multipliers by falling modulus as in a dataset, where both of a pair lie above the real axis."""
    values = np.array([complex(x.real, abs(x.imag)) for x in np.asarray(values)])
    return values[np.argsort(-np.abs(values), kind="stable")]


def motion_from(scene: str, point: dict, section, observe: float) -> Motion:
    x1, x2, v2, *rock = section
    return run(scene, start=[x1, 0.0, x2, v2, *rock], observe=observe, **point)
