"""The type of a dry-friction law."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.parameters import Parameter

Numbers = Mapping[str, Any]
"""A law's own parameters by name: scalars, or arrays with one value per lane."""

Coefficient = Callable[[Any, Numbers], Any]


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """A dry-friction law with the force sgn(u) (mu(|u|) m1 g + mu_J(|u|) J) at sliding velocity u.

    Pass your own law to `simulate` or a sweep as `friction`. Each law of the package is defined in one file of this
    folder under the name `LAW`. Laws compare by identity; compiled programs rely on this.

    **Arguments:**

    - `name`: name of the law in sweep files; `reference`: number of its equation in the source.
    - `parameters`: the law's own parameters, by name.
    - `mu`: function `mu(speed, p)`, the friction coefficient under the bit's weight at sliding speed `speed` >= 0
      [m/s]; `p` has the law's own parameters by name. `mu(0, p)` is the limit mu(0+), which defines the stick limit.
      The function uses +, -, *, / and the functions of [vibrojax.models.physics.elementary][], so that it accepts
      arrays and Taylor series.
    - `mu_impact`: the same for mu_J, the friction coefficient under the impact force J; default: `mu`.
    - `flat_below`: function `flat_below(p)`, a speed [m/s] below which `mu` is constant within rounding error although
      it varies above. A Taylor series at such low speeds does not predict `mu` above. None: there is no such speed.

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
        """Return the friction coefficient [1] under the weight m1 g at `speed` >= 0 [m/s] of any shape."""
        return self.mu(speed, p)

    def on_impact(self, speed: Value, p: Numbers) -> Any:
        """Return the friction coefficient [1] under the impact force J at `speed` >= 0 [m/s] of any shape."""
        return (self.mu_impact or self.mu)(speed, p)
