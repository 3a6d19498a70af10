"""Friction that decreases hyperbolically with speed (source, eq. 2.16)."""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import not_negative, table


def mu(speed: Value, p: Numbers) -> Any:
    """Return mu0/(1 + delta_f |u|) [1] for `speed` = |u| [m/s] of any shape."""
    return p["mu0"] / (1.0 + p["delta_f"] * speed)


LAW = FrictionLaw(
    name="hyperbolic",
    reference="eq. 2.16",
    parameters=table(
        not_negative("mu0", 0.4, "1", "friction coefficient at rest", "μ₀", (0.1, 1.0)),
        not_negative("delta_f", 1.0, "s m-1", "rate of the fall of friction with speed", "δ_f"),
    ),
    mu=mu,
)
