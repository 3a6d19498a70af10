"""Coulomb's law: friction that does not depend on speed (source, eq. 2.13)."""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import not_negative, table


def mu(speed: Value, p: Numbers) -> Any:
    """Return the constant friction coefficient mu [1]."""
    return p["mu"]


LAW = FrictionLaw(
    name="coulomb",
    reference="eq. 2.13",
    parameters=table(not_negative("mu", 0.4, "1", "friction coefficient", "μ", (0.1, 1.0))),
    mu=mu,
)
