"""Dry-friction laws of the source (eqs. 2.13 to 2.17 and 5.9), and the type of a friction law.

**Example:**

>>> law = vj.friction.law_named("stribeck")
>>> defaults = {name: parameter.default for name, parameter in law.parameters.items()}
>>> round(float(law.on_weight(0.0, defaults)), 3), law.reference
(0.4, 'eq. 5.9')
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.models.arrays import Value
from vibrojax.models.physics.elementary import arctan, exp, maximum
from vibrojax.models.physics.parameters import Parameter, not_negative, positive, table

Numbers = Mapping[str, Any]
"""A law's own parameters by name: scalars, or arrays with one value per lane."""

Coefficient = Callable[[Any, Numbers], Any]


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """A dry-friction law with the force sgn(u) (mu(|u|) m1 g + mu_J(|u|) J) at sliding velocity u.

    Pass your own law to `simulate` or a sweep as `friction`. Laws compare by identity; compiled programs rely on this.

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


def _coulomb(speed: Value, p: Numbers) -> Any:
    """Return the constant friction coefficient mu [1]."""
    return p["mu"]


COULOMB = FrictionLaw(
    name="coulomb",
    reference="eq. 2.13",
    parameters=table(not_negative("mu", 0.4, "1", "friction coefficient", "μ", (0.1, 1.0))),
    mu=_coulomb,
)
"""Coulomb's law: friction that does not depend on speed (source, eq. 2.13)."""


def _popp_flat_below(p: Numbers) -> Any:
    """Return the speed below which exp(c1/|u|) < 1e-17; all derivatives of exp(c1/|u|) vanish as |u| -> 0."""
    return p["popp_c1"] * (-1 / 40)


def _popp_exponential(speed: Value, p: Numbers) -> Any:
    """Return 0.165 (1 + exp(c1/|u|)) (1 + exp(c2 |u|)) [1] for `speed` = |u| [m/s] of any shape."""
    slow = maximum(speed, _popp_flat_below(p))
    return 0.165 * (1.0 + exp(p["popp_c1"] / slow)) * (1.0 + exp(p["popp_c2"] * speed))


POPP_EXPONENTIAL = FrictionLaw(
    name="popp-exponential",
    reference="eq. 2.14",
    parameters=table(
        Parameter("popp_c1", -0.02, "m s-1", "speed scale of the rise of Popp's friction law", "c₁", below=0.0),
        Parameter("popp_c2", -0.25, "s m-1", "rate of the fall of Popp's friction law", "c₂"),
    ),
    mu=_popp_exponential,
    flat_below=_popp_flat_below,
)
"""Popp's exponential law (source, eq. 2.14, with the second exponent and the units corrected)."""


def _popp_arctan(speed: Value, p: Numbers) -> Any:
    """Return a1 (1 + a2 exp(-b1 |u|)) arctan(b2 |u|) [1] for `speed` = |u| [m/s] of any shape."""
    return p["a1"] * (1.0 + p["a2"] * exp(-p["b1"] * speed)) * arctan(p["b2"] * speed)


POPP_ARCTAN = FrictionLaw(
    name="popp-arctan",
    reference="eq. 2.15",
    parameters=table(
        not_negative("a1", 0.14, "1", "amplitude of the arctangent friction law", "a₁"),
        not_negative("a2", 1.14, "1", "excess of the arctangent friction law at low speed", "a₂"),
        not_negative("b1", 2.0, "s m-1", "rate of the fall of the arctangent friction law", "b₁"),
        not_negative("b2", 100.0, "s m-1", "steepness of the arctangent friction law at u = 0", "b₂"),
    ),
    mu=_popp_arctan,
)
"""Popp's arctangent law (source, eq. 2.15). It is smooth through u = 0, so the bit never sticks."""


def _hyperbolic(speed: Value, p: Numbers) -> Any:
    """Return mu0/(1 + delta_f |u|) [1] for `speed` = |u| [m/s] of any shape."""
    return p["mu0"] / (1.0 + p["delta_f"] * speed)


HYPERBOLIC = FrictionLaw(
    name="hyperbolic",
    reference="eq. 2.16",
    parameters=table(
        not_negative("mu0", 0.4, "1", "friction coefficient at rest", "μ₀", (0.1, 1.0)),
        not_negative("delta_f", 1.0, "s m-1", "rate of the fall of friction with speed", "δ_f"),
    ),
    mu=_hyperbolic,
)
"""Friction that decreases hyperbolically with speed (source, eq. 2.16)."""


def _hyperbolic_quadratic(speed: Value, p: Numbers) -> Any:
    """Return (mu0 - mu1)/(1 + lambda |u|) + mu1 + alpha u² [1] for `speed` = |u| [m/s] of any shape."""
    return (p["mu0"] - p["mu1"]) / (1.0 + p["lambda"] * speed) + p["mu1"] + p["alpha"] * speed * speed


HYPERBOLIC_QUADRATIC = FrictionLaw(
    name="hyperbolic-quadratic",
    reference="eq. 2.17",
    parameters=table(
        not_negative("mu0", 0.4, "1", "friction coefficient at rest", "μ₀", (0.1, 1.0)),
        not_negative("mu1", 0.1, "1", "friction coefficient after the hyperbolic fall", "μ₁"),
        not_negative("lambda", 99.4, "s m-1", "rate of the hyperbolic fall", "λ"),
        not_negative("alpha", 0.7, "s2 m-2", "rate of the quadratic rise", "α"),
    ),
    mu=_hyperbolic_quadratic,
)
"""Friction that decreases hyperbolically to mu1 and increases quadratically with speed (source, eq. 2.17)."""


def _stribeck(speed: Value, p: Numbers) -> Any:
    """Return mu (1 - |u|/v_cr + |u|³/(3 v_cr³)) [1] for `speed` = |u| [m/s] of any shape."""
    ratio = speed * (1 / p["v_cr"])
    return p["mu"] * (1.0 - ratio + ratio * ratio * ratio * (1 / 3))


def _stribeck_impact(speed: Value, p: Numbers) -> Any:
    """Return the constant friction coefficient mu [1] under the impact force (source, eq. 5.12)."""
    return p["mu"]


STRIBECK = FrictionLaw(
    name="stribeck",
    reference="eq. 5.9",
    parameters=table(
        not_negative("mu", 0.4, "1", "friction coefficient", "μ", (0.1, 1.0)),
        positive("v_cr", 3.0, "m s-1", "Stribeck speed (R4)", "v_cr", (0.5, 10.0)),
    ),
    mu=_stribeck,
    mu_impact=_stribeck_impact,
)
"""Stribeck's law: friction that decreases with speed up to v_cr and increases beyond v_cr (source, eq. 5.9).

The coefficient mu under the impact force is constant (reading R2 of the source)."""


_LAWS = (COULOMB, POPP_EXPONENTIAL, POPP_ARCTAN, HYPERBOLIC, HYPERBOLIC_QUADRATIC, STRIBECK)

FRICTION_LAWS: dict[str, FrictionLaw] = {law.name: law for law in _LAWS}
"""The friction laws of the package by name, as in sweep files.

**Example:**

>>> sorted(vj.FRICTION_LAWS)
['coulomb', 'hyperbolic', 'hyperbolic-quadratic', 'popp-arctan', 'popp-exponential', 'stribeck']
>>> list(vj.FRICTION_LAWS["stribeck"].parameters)
['mu', 'v_cr']
"""


def law_named(law: str | FrictionLaw) -> FrictionLaw:
    """Return the friction law with this name; a law object is returned unchanged.

    Raises `KeyError` if the name is unknown.
    """
    return law if isinstance(law, FrictionLaw) else FRICTION_LAWS[law]
