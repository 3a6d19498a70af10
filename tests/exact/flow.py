"""Steps of one mode, y' = A y + G f(t, y), as polynomials that satisfy the equations at the nodes to rounding.

The linear part is solved directly, once per mode and step length. Only the friction force or a given force remains, and
is iterated to its fixed point. Step lengths are powers of two. A step is halved until the last coefficients of its
polynomial are at the rounding level of the state's largest size so far."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from exact.polynomials import COEFFICIENTS, INTEGRAL, NODES, N

TAIL = 4e-15
SHORTEST = 2.0**-60


@dataclass
class Mode:
    """One mode: its equations, and the linear forms that stay positive while it lasts. `A` [d, d] acts on the state,
    whose last entry is 1. `force(t, Y)` is the only nonlinear force (None: there is none), and `G` [d] the acceleration
    per newton of it. `velocities` [d] marks the entries that are rates. `surfaces` [s, d] are the linear forms, and
    `names` the events at which they fall through zero."""

    A: np.ndarray
    G: np.ndarray
    velocities: np.ndarray
    surfaces: np.ndarray
    names: Sequence[str]
    force: Callable | None = None
    power: int = -4
    maps: dict = field(default_factory=dict)

    def solution(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Return P [nodes, d, d] and R [nodes, d, nodes], such that the states at the nodes are P y + R forces."""
        if h not in self.maps:
            d = len(self.A)
            scale = np.where(self.velocities, h, 1.0)  # scale velocities by h, so that all entries are lengths
            A = h * scale[:, None] * self.A / scale
            inverse = np.linalg.inv(np.eye((N + 1) * d) - np.kron(INTEGRAL, A)).reshape(N + 1, d, N + 1, d)
            P = inverse.sum(axis=2) * scale / scale[:, None]
            R = h * np.einsum("iajb,jk,b->iak", inverse, INTEGRAL, scale * self.G) / scale[:, None]
            self.maps[h] = P, R.reshape(-1, N + 1)
        return self.maps[h]

    def step(self, t: float, y: np.ndarray, swing: np.ndarray) -> tuple[float, np.ndarray]:
        """Return length and coefficients [N + 1, d] of a step from y at t; `swing` [d] is the size of each entry."""
        while True:
            h = 2.0**self.power
            c = self._try(h, t, y)
            if c is not None:
                size = np.maximum(swing, np.abs(c).max(axis=0))
                size[size == 0] = 1.0
                relative = np.abs(c) / size
                if relative[N - 1 :].max() <= TAIL:
                    if relative[N // 2 :].max() <= 1e-8:
                        self.power += 1
                    return h, c
            self.power -= 1
            if h < SHORTEST:
                raise ArithmeticError(f"no step from t = {t}, state {y}")

    def _try(self, h, t, y):
        P, R = self.solution(h)
        Y = P @ y
        if self.force is not None:
            linear, times = Y, t + h * NODES
            with np.errstate(all="ignore"):
                f = self.force(times, np.broadcast_to(y, Y.shape))
                previous_change = np.inf
                for _ in range(60):
                    Y = linear + (R @ f).reshape(linear.shape)
                    new = self.force(times, Y)
                    change = np.abs(new - f).max() / max(np.abs(new).max(), 1e-300)
                    f = new
                    if change <= 1e-16 or (change <= 1e-13 and change >= previous_change):
                        break
                    previous_change = change
                else:
                    return None
            if not change <= 1e-13:
                return None
        return COEFFICIENTS @ Y


def swung(swing: np.ndarray, c: np.ndarray) -> np.ndarray:
    return np.maximum(swing, np.abs(c).sum(axis=0))
