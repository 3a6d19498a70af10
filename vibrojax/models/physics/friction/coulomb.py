"""Eq. 2.13: friction that does not depend on speed."""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import not_negative, table


def mu(speed: Value, p: Numbers) -> Any:
    """Constant mu, eq. 2.13; `speed` = |u| [m/s], any shape; unit 1."""
    return p["mu"]


LAW = FrictionLaw(
    name="coulomb",
    reference="eq. 2.13",
    parameters=table(not_negative("mu", 0.4, "1", "friction coefficient", "μ", (0.1, 1.0))),
    mu=mu,
)
