"""Popp's exponential law (source, eq. 2.14, with the second exponent and the units corrected)."""

from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.elementary import exp, maximum
from vibrojax.models.physics.friction._law import FrictionLaw, Numbers
from vibrojax.models.physics.parameters import Parameter, table


def _flat_below(p: Numbers) -> Any:
    """Return the speed below which exp(c1/|u|) < 1e-17; all derivatives of exp(c1/|u|) vanish as |u| -> 0."""
    return p["popp_c1"] * (-1 / 40)


def mu(speed: Value, p: Numbers) -> Any:
    """Return 0.165 (1 + exp(c1/|u|)) (1 + exp(c2 |u|)) [1] for `speed` = |u| [m/s] of any shape."""
    slow = maximum(speed, _flat_below(p))
    return 0.165 * (1.0 + exp(p["popp_c1"] / slow)) * (1.0 + exp(p["popp_c2"] * speed))


LAW = FrictionLaw(
    name="popp-exponential",
    reference="eq. 2.14",
    parameters=table(
        Parameter("popp_c1", -0.02, "m s-1", "speed scale of the rise of Popp's friction law", "c₁", below=0.0),
        Parameter("popp_c2", -0.25, "s m-1", "rate of the fall of Popp's friction law", "c₂"),
    ),
    mu=mu,
    flat_below=_flat_below,
)
