"""The type of a dry-friction law."""

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

    Pass a law of your own to `simulate` or a sweep as `friction`. A law of the package is a file in this folder that
    binds it to the name `LAW`. Laws compare by identity, and compiled programs rely on that.

    **Arguments:**

    - `name`: its name in sweep files; `reference`: its equation in the source.
    - `parameters`: the law's own parameters, by name.
    - `mu`: `mu(speed, p)`, the coefficient under the bit's weight at sliding speed `speed` >= 0 [m/s], with the law's
      own parameters `p` by name. Its value at 0 is the limit mu(0+), which is the stick limit. It uses +, -, *, / and
      the functions of [vibrojax.models.physics.elementary][], so that it accepts arrays and Taylor series.
    - `mu_impact`: the coefficient under the impact force J; default: `mu` itself.
    - `flat_below`: `flat_below(p)`, a speed [m/s] below which `mu` is constant to rounding although it varies above.
      Its series there does not predict what follows. None: there is no such speed.

    **Example:**

    >>> own = vj.parameters.table(vj.parameters.positive("v_s", 1.8, "m s-1", "speed over which friction falls", "v_s"))
    >>> law = vj.FrictionLaw("falling", "my rig", own, mu=lambda u, p: 0.13 + 0.27 * vj.elementary.exp(-u / p["v_s"]))
    >>> motion = vj.simulate("rotary", friction=law, v_s=1.0, start="stuck", progress=False)
    >>> round(float(abs(motion.friction_force).max()))  # N, as the bit breaks loose: 0.4 m1 g
    981
    """

    name: str
    reference: str
    parameters: Mapping[str, Parameter]
    mu: Coefficient
    mu_impact: Coefficient | None = None
    flat_below: Callable[[Numbers], Any] | None = None

    def on_weight(self, speed: Value, p: Numbers) -> Any:
        """Return the friction coefficient under the weight m1 g at `speed` >= 0 [m/s]; any shape; unit 1."""
        return self.mu(speed, p)

    def on_impact(self, speed: Value, p: Numbers) -> Any:
        """Return the friction coefficient under the impact force J at `speed` >= 0 [m/s]; any shape; unit 1."""
        return (self.mu_impact or self.mu)(speed, p)
