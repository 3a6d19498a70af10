"""Stribeck's law: friction that decreases with speed up to v_cr and increases beyond v_cr (source, eq. 5.9).

The coefficient mu under the impact force is constant (reading R2 of the source).
"""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import not_negative, positive, table


def mu(speed: Value, p: Numbers) -> Any:
    """Return mu (1 - |u|/v_cr + |u|³/(3 v_cr³)) [1] for `speed` = |u| [m/s] of any shape."""
    ratio = speed * (1 / p["v_cr"])
    return p["mu"] * (1.0 - ratio + ratio * ratio * ratio * (1 / 3))


def mu_impact(speed: Value, p: Numbers) -> Any:
    """Return the constant friction coefficient mu [1] under the impact force (source, eq. 5.12)."""
    return p["mu"]


LAW = FrictionLaw(
    name="stribeck",
    reference="eq. 5.9",
    parameters=table(
        not_negative("mu", 0.4, "1", "friction coefficient", "μ", (0.1, 1.0)),
        positive("v_cr", 3.0, "m s-1", "Stribeck speed (R4)", "v_cr", (0.5, 10.0)),
    ),
    mu=mu,
    mu_impact=mu_impact,
)
