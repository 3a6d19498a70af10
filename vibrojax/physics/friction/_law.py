"""What a dry-friction law is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.physics.parameters import Parameter

Coefficient = Callable[[Any, Mapping[str, Any]], Any]


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """A dry-friction law, force = sgn(u) (mu(|u|) m1 g + mu_J(|u|) J).

    A new law is one file in this folder that binds such an object to the name `LAW`.

    **Arguments:**

    - `name`: what sweep files call it.
    - `reference`: its equation in the source.
    - `parameters`: the parameters it needs, by name.
    - `mu`: `mu(speed, p)`, the coefficient under the bit's weight at sliding speed `speed` >= 0 [m/s]; its value
      at 0 is the limit mu(0+), which is the stick limit. Written with +, -, *, / and the functions of
      [vibrojax.physics.elementary][], so that it accepts arrays and Taylor series alike.
    - `mu_impact`: the coefficient under the impact force J; `mu` itself where left out (model, section 3).
    - `flat_below`: `flat_below(p)`, a speed [m/s] below which `mu` is constant to rounding though it varies above, so
      that its series there says nothing of what follows; None where there is no such speed.
    """

    name: str
    reference: str
    parameters: Mapping[str, Parameter]
    mu: Coefficient
    mu_impact: Coefficient | None = None
    flat_below: Callable[[Mapping[str, Any]], Any] | None = None

    def on_weight(self, speed, p):
        """Friction coefficient under the weight m1 g at `speed` >= 0 [m/s]; any shape; unit 1."""
        return self.mu(speed, p)

    def on_impact(self, speed, p):
        """Friction coefficient under the impact force J at `speed` >= 0 [m/s]; any shape; unit 1."""
        return (self.mu_impact or self.mu)(speed, p)
