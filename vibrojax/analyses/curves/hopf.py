"""Hopf points in two parameters: equilibria with a pair of eigenvalues on the imaginary axis."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrojax.analyses.continuation.hopf import Field, moving_states, section_product
from vibrojax.models.scenes import Scene

DIFFERENCE = 1e-5
"""Scaled step of the differences with respect to the parameters, of exact equilibria and eigenvalues."""


class HopfPoint(NamedTuple):
    """An equilibrium and its critical pair of eigenvalues.

    - `states`: scaled states at the section; `growth`: growth rate relative to the frequency; `period` [s].
    - `product`: derivative of the return map in the limit of zero amplitude.
    """

    states: Float[np.ndarray, " states"]
    growth: float
    period: float
    product: Float[np.ndarray, "states states"]


@dataclass(frozen=True)
class HopfEquations:
    """Equilibria of one field over two parameters; `scales`: scales of the return map's states."""

    scene: Scene[Any]
    field: Field
    names: tuple[str, str]
    scales: Float[np.ndarray, " states"]

    def at(
        self, values: Float[np.ndarray, "2"], units: Float[np.ndarray, "2"]
    ) -> tuple[HopfPoint, Float[np.ndarray, "equations 2"]]:
        """Return the equilibrium, and the derivatives of its states and growth rate with respect to the parameters."""
        columns = []
        for step in DIFFERENCE * np.diag(units):
            ahead, behind = (self._point(values + sign * step) for sign in (1.0, -1.0))
            difference = np.append(ahead.states - behind.states, ahead.growth - behind.growth)
            columns.append(difference / (2 * DIFFERENCE))
        return self._point(values), np.column_stack(columns)

    def _point(self, values: Float[np.ndarray, "2"]) -> HopfPoint:
        known = self.field.equilibrium(dict(zip(self.names, values.tolist(), strict=True)))
        rows = len(self.scales)
        none = np.full(rows, np.nan)
        if known is None:
            return HopfPoint(none, np.nan, np.inf, np.full((rows, rows), np.nan))
        eigenvalues, vectors = np.linalg.eig(known.jacobian)
        turning = np.flatnonzero(eigenvalues.imag > 0)
        if not len(turning):
            return HopfPoint(none, np.nan, np.inf, np.full((rows, rows), np.nan))
        # On the curve, the critical pair is the one next to the imaginary axis.
        pair = turning[np.abs(eigenvalues[turning].real).argmin()]
        eigenvalue = complex(eigenvalues[pair])
        product = section_product(self.scene, known, eigenvalue, vectors[:, pair], self.scales)
        names = moving_states(self.scene)
        states = known.states[[names.index(name) for name in self.scene.return_states]] / self.scales
        return HopfPoint(states, eigenvalue.real / eigenvalue.imag, 2 * np.pi / eigenvalue.imag, product)
