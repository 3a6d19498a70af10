"""Eq. 2.13: friction that does not depend on speed."""

from vibrojax.physics.friction._law import FrictionLaw
from vibrojax.physics.parameters import not_negative, table


def mu(speed, p):
    """Constant mu, eq. 2.13; `speed` = |u| [m/s], any shape; unit 1."""
    return p["mu"]


LAW = FrictionLaw(
    name="coulomb",
    reference="eq. 2.13",
    parameters=table(not_negative("mu", 0.4, "1", "friction coefficient", "μ")),
    mu=mu,
)
