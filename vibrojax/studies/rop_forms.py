"""Forms of the rate-of-penetration law: formulas of the rate as a function of the relief P/D.

The source's law, rate = C ln(P/D) (eq. 6.4), gives a negative rate if the relief P/D is below 1. It is therefore read
in three ways ("forms"): as printed, with P/D in percent, and as C ln((P/D)/eta0) with a fitted onset eta0, the relief
at which penetration begins. A straight line, a power law and a constant serve as comparison.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vibrojax.studies.rop_least_squares import (
    ExponentialRates,
    Jacobian,
    LaneFlags,
    Lanes,
    LinearRates,
    Theta,
)

Model = LinearRates | ExponentialRates
"""Model of the rates of a form."""

Coefficients = Float[np.ndarray, " 3"]
"""C (in the unit of the rate), eta0 and exponent; NaN for a coefficient that the formula does not have."""

Slopes = Float[np.ndarray, "3 coefficients"]
"""Derivatives of `Coefficients` with respect to the fitted parameters theta."""


@dataclass(frozen=True)
class Form:
    """A formula of the law: the rate as a function of z = (t - centre)/spread, a variable t(eta) scaled in each group.

    eta is the relief P/D. `variable` is the function t, and `inverse` converts t to eta. `kind` is one of

    - "proportional": rate = theta_0 z,
    - "onset": rate = theta_0 + theta_1 z,
    - "power": rate = exp(theta_0 + theta_1 z).

    `rate` is the formula as a function of eta and the coefficients C, eta0 and exponent.
    """

    name: str
    formula: str
    kind: str
    variable: Callable[[Lanes], Lanes]
    rate: Callable[[Lanes, float, float, float], Lanes]
    inverse: Callable[[float], float] = float

    @property
    def size(self) -> int:
        return 1 if self.kind == "proportional" else 2

    def model(self, relief: Lanes, seen: LaneFlags) -> tuple[Model, tuple[float, float]]:
        """Return the model of a group's rates, and the centre and spread of t over `seen`, the lanes that penetrate."""
        t = self.variable(relief)
        centre = 0.0 if self.kind == "proportional" else float(t[seen].mean())
        spread = float(np.sqrt(np.mean((t[seen] - centre) ** 2)))
        z = (t - centre) / spread
        columns: Jacobian = z[:, None] if self.size == 1 else np.stack([np.ones_like(z), z], axis=1)
        return (ExponentialRates if self.kind == "power" else LinearRates)(columns), (centre, spread)

    def coefficients(self, theta: Theta, centre: float, spread: float) -> tuple[Coefficients, Slopes]:
        """Return the coefficients of the law, and their derivatives with respect to theta."""
        none = [np.nan] * self.size
        if self.kind == "proportional":
            return np.array([theta[0] / spread, np.nan, np.nan]), np.array([[1 / spread], none, none])
        if self.kind == "power":
            exponent = theta[1] / spread
            c = np.exp(theta[0] - exponent * centre)
            return np.array([c, np.nan, exponent]), np.array([[c, -c * centre / spread], none, [0.0, 1 / spread]])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            onset = centre - spread * theta[0] / theta[1]
            eta0 = self.inverse(onset)
            slope = (eta0 if self.variable is np.log else 1.0) * spread / theta[1]
            slopes = [[0.0, 1 / spread], [-slope, slope * theta[0] / theta[1]], none]
        return np.array([theta[1] / spread, eta0, np.nan]), np.array(slopes)


FORMS = (
    Form("literal", "C ln(eta)", "proportional", np.log, lambda eta, C, eta0, exponent: C * np.log(eta)),
    Form(
        "percent",
        "C ln(100 eta)",
        "proportional",
        lambda eta: np.log(100 * eta),
        lambda eta, C, eta0, exponent: C * np.log(100.0 * eta),
    ),
    Form("onset", "C ln(eta/eta0)", "onset", np.log, lambda eta, C, eta0, exponent: C * np.log(eta / eta0), np.exp),
    Form("line", "C (eta - eta0)", "onset", np.asarray, lambda eta, C, eta0, exponent: C * (eta - eta0)),
    Form("power", "C eta^exponent", "power", np.log, lambda eta, C, eta0, exponent: C * eta**exponent),
    Form("constant", "C", "proportional", np.ones_like, lambda eta, C, eta0, exponent: C * np.ones_like(eta)),
)

SAME_AS_ONSET = ("literal", "percent")
"""Forms that have the same curve as the onset form if the threshold is unknown."""
