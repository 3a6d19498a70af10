"""Popp's arctangent law (source, eq. 2.15). It is smooth through u = 0, so the bit never sticks."""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.elementary import arctan, exp
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import not_negative, table


def mu(speed: Value, p: Numbers) -> Any:
    """Return a1 (1 + a2 exp(-b1 |u|)) arctan(b2 |u|) [1] for `speed` = |u| [m/s] of any shape."""
    return p["a1"] * (1.0 + p["a2"] * exp(-p["b1"] * speed)) * arctan(p["b2"] * speed)


LAW = FrictionLaw(
    name="popp-arctan",
    reference="eq. 2.15",
    parameters=table(
        not_negative("a1", 0.14, "1", "amplitude of the arctangent friction law", "a₁"),
        not_negative("a2", 1.14, "1", "excess of the arctangent friction law at low speed", "a₂"),
        not_negative("b1", 2.0, "s m-1", "rate of the fall of the arctangent friction law", "b₁"),
        not_negative("b2", 100.0, "s m-1", "steepness of the arctangent friction law at u = 0", "b₂"),
    ),
    mu=mu,
)
