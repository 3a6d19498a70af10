"""Friction that decreases hyperbolically to mu1 and increases quadratically with speed (source, eq. 2.17)."""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import not_negative, table


def mu(speed: Value, p: Numbers) -> Any:
    """Return (mu0 - mu1)/(1 + lambda |u|) + mu1 + alpha u² [1] for `speed` = |u| [m/s] of any shape."""
    return (p["mu0"] - p["mu1"]) / (1.0 + p["lambda"] * speed) + p["mu1"] + p["alpha"] * speed * speed


LAW = FrictionLaw(
    name="hyperbolic-quadratic",
    reference="eq. 2.17",
    parameters=table(
        not_negative("mu0", 0.4, "1", "friction coefficient at rest", "μ₀", (0.1, 1.0)),
        not_negative("mu1", 0.1, "1", "friction coefficient after the hyperbolic fall", "μ₁"),
        not_negative("lambda", 99.4, "s m-1", "rate of the hyperbolic fall", "λ"),
        not_negative("alpha", 0.7, "s2 m-2", "rate of the quadratic rise", "α"),
    ),
    mu=mu,
)
