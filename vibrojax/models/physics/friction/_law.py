"""What a dry-friction law is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.parameters import Parameter

Numbers = Mapping[str, Any]
"""A law's own parameters by name: numbers or arrays of lanes."""

Coefficient = Callable[[Any, Numbers], Any]


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """A dry-friction law, force = sgn(u) (mu(|u|) m1 g + mu_J(|u|) J).

    A new law is such an object, passed to `simulate` or a sweep as `friction`; one of the package is a file in this
    folder that binds it to the name `LAW`. Two laws are the same only where they are one object, which is what
    compiled programs go by.

    **Arguments:**

    - `name`: what sweep files call it.
    - `reference`: its equation in the source.
    - `parameters`: the parameters it needs, by name.
    - `mu`: `mu(speed, p)`, with the law's own parameters `p` by name: the coefficient under the bit's weight at sliding
      speed `speed` >= 0 [m/s]; its value at 0 is the limit mu(0+), which is the stick limit. Written with +, -, *, /
      and the functions of [vibrojax.models.physics.elementary][], so that it accepts arrays and Taylor series alike.
    - `mu_impact`: the coefficient under the impact force J; `mu` itself where left out.
    - `flat_below`: `flat_below(p)`, a speed [m/s] below which `mu` is constant to rounding though it varies above, so
      that its series there says nothing of what follows; None where there is no such speed.

    **Example:**

    >>> own = vj.parameters.table(vj.parameters.positive("v_s", 1.8, "m s-1", "speed over which friction falls", "v_s"))
    >>> law = vj.FrictionLaw("falling", "my rig", own, mu=lambda u, p: 0.13 + 0.27 * vj.elementary.exp(-u / p["v_s"]))
    >>> motion = vj.simulate("rotary", friction=law, v_s=1.0, start="stuck", progress=False)
    >>> round(float(abs(motion.friction_force).max()))  # N, where the bit breaks loose: 0.4 m1 g
    981
    """

    name: str
    reference: str
    parameters: Mapping[str, Parameter]
    mu: Coefficient
    mu_impact: Coefficient | None = None
    flat_below: Callable[[Numbers], Any] | None = None

    def on_weight(self, speed: Value, p: Numbers) -> Any:
        """Friction coefficient under the weight m1 g at `speed` >= 0 [m/s]; any shape; unit 1."""
        return self.mu(speed, p)

    def on_impact(self, speed: Value, p: Numbers) -> Any:
        """Friction coefficient under the impact force J at `speed` >= 0 [m/s]; any shape; unit 1."""
        return (self.mu_impact or self.mu)(speed, p)
