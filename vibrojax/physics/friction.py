"""Dry-friction laws of Batako's thesis (eqs. 2.13 to 2.17 and 5.9), and `FrictionLaw`, the class of such laws.

**Example:**

>>> law = vj.FRICTION_LAWS["stribeck"]
>>> defaults = {name: parameter.default for name, parameter in law.parameters.items()}
>>> round(float(law.on_weight(0.0, defaults)), 3), law.reference
(0.4, 'eq. 5.9')
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vibrojax.errors import InputError, asked, number_of
from vibrojax.physics.arrays import Value
from vibrojax.physics.elementary import arctan, exp, maximum
from vibrojax.physics.parameters import Parameter, not_negative, positive, table

Numbers = Mapping[str, Any]
"""A law's own parameters by name: scalars, or arrays with one value per lane."""

Coefficient = Callable[[Any, Numbers], Any]


@dataclass(frozen=True, eq=False)
class FrictionLaw:
    """A dry-friction law with the force sgn(u) (mu(|u|) m1 g + mu_J(|u|) J) at sliding velocity u.

    Pass your own law to `simulate` or to a sweep as the parameter `friction`.

    **Arguments:**

    - `name`: name of the law in sweep files; `reference`: where the law is published; "eq. 5.9" is an equation of
      Batako's thesis.
    - `parameters`: the law's own parameters, by name, from `vj.parameters.table`.
    - `mu`: function `mu(speed, p)` that returns the friction coefficient under the bit's weight at the sliding speed
      `speed` >= 0 [m/s]; `p` has the law's own parameters by name. The limit `mu(0, p)` sets the greatest friction
      force on a sticking bit. Write `mu` with +, -, *, / and the functions of [vibrojax.physics.elementary][], because
      it also receives Taylor series.
    - `mu_impact`: function `mu_impact(speed, p)` that returns the friction coefficient mu_J under the impact force J;
      default: `mu`.
    - `flat_below`: function `flat_below(p)` that returns a speed [m/s] below which `mu` is constant within rounding
      error, although `mu` varies at higher speeds.

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

    def __post_init__(self) -> None:
        for name, parameter in self.parameters.items():
            if getattr(parameter, "name", None) != name:
                example = f'vj.parameters.table(vj.parameters.positive("{name}", 0.4, "1", "its meaning", "{name}"))'
                raise InputError(f"friction law {self.name}: {name} must be a parameter of that name: {example}")

    def __reduce_ex__(self, protocol: Any) -> Any:
        # A law of the package is sent to other processes by its name, so that it stays the same object there.
        return (_law, (self.name,)) if FRICTION_LAWS.get(self.name) is self else super().__reduce_ex__(protocol)

    def on_weight(self, speed: Value, p: Numbers) -> Any:
        """Return the friction coefficient [1] under the weight m1 g; `speed` >= 0 [m/s]: an array of any shape."""
        return self._value("mu", self.mu, speed, p)

    def on_impact(self, speed: Value, p: Numbers) -> Any:
        """Return the friction coefficient [1] under the impact force J; `speed` >= 0 [m/s]: an array of any shape."""
        return self._value("mu_impact" if self.mu_impact else "mu", self.mu_impact or self.mu, speed, p)

    def _value(self, name: str, function: Coefficient, speed: Value, p: Numbers) -> Any:
        what = f"friction law {self.name}: {name}"
        return number_of(what, asked(what, function, speed, p, known=self.parameters, written="speed, p"))


def _law(name: str) -> FrictionLaw:
    return FRICTION_LAWS[name]


def _popp_flat_below(p: Numbers) -> Any:
    """Return the speed below which exp(c1/|u|) < 1e-17; all derivatives of exp(c1/|u|) vanish as |u| -> 0."""
    return p["popp_c1"] * (-1 / 40)


def _popp_exponential(u: Value, p: Numbers) -> Any:
    return 0.165 * (1.0 + exp(p["popp_c1"] / maximum(u, _popp_flat_below(p)))) * (1.0 + exp(p["popp_c2"] * u))


def _stribeck(u: Value, p: Numbers) -> Any:
    ratio = u * (1 / p["v_cr"])
    return p["mu"] * (1.0 - ratio + ratio * ratio * ratio * (1 / 3))


_MU = not_negative("mu", 0.4, "1", "friction coefficient", "μ", (0.1, 1.0))
_MU_AT_REST = not_negative("mu0", 0.4, "1", "friction coefficient at rest", "μ₀", (0.1, 1.0))

_LAWS = (
    # Friction that does not depend on speed: mu.
    FrictionLaw("coulomb", "eq. 2.13", table(_MU), mu=lambda u, p: p["mu"]),
    # 0.165 (1 + exp(c1/|u|)) (1 + exp(c2 |u|)), with the second exponent and the units of the source corrected.
    FrictionLaw(
        "popp-exponential",
        "eq. 2.14",
        table(
            Parameter("popp_c1", -0.02, "m s-1", "speed scale of the rising part of Popp's law", "c₁", below=0.0),
            Parameter("popp_c2", -0.25, "s m-1", "rate at which Popp's friction falls with speed", "c₂"),
        ),
        mu=_popp_exponential,
        flat_below=_popp_flat_below,
    ),
    # a1 (1 + a2 exp(-b1 |u|)) arctan(b2 |u|): smooth through u = 0, so the bit never sticks.
    FrictionLaw(
        "popp-arctan",
        "eq. 2.15",
        table(
            not_negative("a1", 0.14, "1", "amplitude of the arctangent friction law", "a₁"),
            not_negative("a2", 1.14, "1", "excess of arctangent friction at low speed", "a₂"),
            not_negative("b1", 2.0, "s m-1", "rate at which arctangent friction falls with speed", "b₁"),
            not_negative("b2", 100.0, "s m-1", "steepness of the arctangent friction law at u = 0", "b₂"),
        ),
        mu=lambda u, p: p["a1"] * (1.0 + p["a2"] * exp(-p["b1"] * u)) * arctan(p["b2"] * u),
    ),
    # mu0/(1 + delta_f |u|): a hyperbolic decrease with speed.
    FrictionLaw(
        "hyperbolic",
        "eq. 2.16",
        table(_MU_AT_REST, not_negative("delta_f", 1.0, "s m-1", "rate at which friction falls with speed", "δ_f")),
        mu=lambda u, p: p["mu0"] / (1.0 + p["delta_f"] * u),
    ),
    # (mu0 - mu1)/(1 + lambda |u|) + mu1 + alpha u²: a hyperbolic decrease to mu1 and a quadratic increase.
    FrictionLaw(
        "hyperbolic-quadratic",
        "eq. 2.17",
        table(
            _MU_AT_REST,
            not_negative("mu1", 0.1, "1", "friction coefficient after the hyperbolic fall", "μ₁"),
            not_negative("lambda", 99.4, "s m-1", "rate at which friction falls hyperbolically with speed", "λ"),
            not_negative("alpha", 0.7, "s2 m-2", "coefficient of the quadratic rise of friction with speed", "α"),
        ),
        mu=lambda u, p: (p["mu0"] - p["mu1"]) / (1.0 + p["lambda"] * u) + p["mu1"] + p["alpha"] * u * u,
    ),
    # mu (1 - |u|/v_cr + |u|³/(3 v_cr³)), decreasing up to v_cr and increasing beyond; under the impact force it is the
    # constant mu (eq. 5.12, reading R2 of the source).
    FrictionLaw(
        "stribeck",
        "eq. 5.9",
        table(_MU, positive("v_cr", 3.0, "m s-1", "Stribeck speed (reading R4)", "v_cr", (0.5, 10.0))),
        mu=_stribeck,
        mu_impact=lambda u, p: p["mu"],
    ),
)

FRICTION_LAWS: dict[str, FrictionLaw] = {law.name: law for law in _LAWS}
"""A dict of the package's friction laws; its keys are the names of the laws in sweep files.

**Example:**

>>> sorted(vj.FRICTION_LAWS)
['coulomb', 'hyperbolic', 'hyperbolic-quadratic', 'popp-arctan', 'popp-exponential', 'stribeck']
>>> list(vj.FRICTION_LAWS["stribeck"].parameters)
['mu', 'v_cr']
"""
