"""One-sided visco-elastic contact of striker and bit (Batako's thesis, eq. 5.18), and closed-form results.

**Example:**

>>> import jax
>>> round(float(vj.contact.restitution(0.3)), 3)
0.451
>>> round(float(jax.grad(vj.contact.restitution)(0.0)), 4)  # - pi: R = 1 - pi xi to first order
-3.1416
"""

from typing import Any

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Real, Value


def raw_force(compression: Value, rate: Value, k0: Value, c0: Value) -> Any:
    """Return k0 d + c0 d' [N] (source, eq. 5.18) for `compression` d [m] and `rate` d' [m/s].

    The result is the contact force while striker and bit touch; see [vibrojax.scenes][]. The function accepts arrays
    and Taylor series.
    """
    return k0 * compression + c0 * rate


def force(compression: Real, rate: Real, k0: Real, c0: Real) -> Any:
    """Return the contact force J [N] (Batako's thesis, eq. 5.18): max(k0 d + c0 d', 0) for d >= 0, else 0.

    The function accepts arrays only, not Taylor series.
    """
    return jnp.where(compression >= 0, jnp.maximum(raw_force(compression, rate, k0, c0), 0), 0)


def damping_ratio(mass: Real, k0: Real, c0: Real) -> Any:
    """Return the damping ratio xi = c0/(2 m W) [1] of a mass m [kg] on the contact, with W = sqrt(k0/m).

    `k0`, `c0`: stiffness [N/m] and damping [N s/m] of the contact. xi = 1 is critical damping.
    """
    return c0 / (2 * jnp.sqrt(k0 * mass))


def restitution(xi: Real) -> Any:
    """Return the ratio of the speeds after and before an impact on a Kelvin-Voigt stop.

    The mass leaves the stop when the contact force is zero. The ratio is R = exp(-2 xi acos(xi)/sqrt(1 - xi²)). The
    formula is eq. 5.8 of Batako's thesis, with the square root corrected to sqrt(1 - xi²). For xi > 1,
    acosh(xi)/sqrt(xi² - 1) replaces acos(xi)/sqrt(1 - xi²).

    **Arguments:** `xi` >= 0, any shape.
    """
    return jnp.exp(-2 * xi * _acos_over_root(xi))


def contact_time(mass: Real, k0: Real, c0: Real) -> Any:
    """Return the duration T [s] of an impact of a mass [kg], from w_d T = 2 acos(xi) (Batako's thesis, eq. 5.7).

    w_d is the damped natural frequency of the mass on the contact.
    """
    xi = damping_ratio(mass, k0, c0)
    return 2 * _acos_over_root(xi) / jnp.sqrt(k0 / mass)


def _acos_over_root(xi: Real) -> Any:
    """Return acos(xi)/sqrt(1 - xi²), continued beyond xi = 1 as acosh(xi)/sqrt(xi² - 1).

    Near xi = 1, a series avoids 0/0 in the value and in its gradient.
    """
    near = jnp.abs(xi - 1) < 1e-3
    under = jnp.where((xi < 1) & ~near, xi, 0.5)
    over = jnp.where((xi > 1) & ~near, xi, 2.0)
    e = xi - 1
    series = 1 - e / 3 + 2 * e**2 / 15 - 2 * e**3 / 35  # both branches about xi = 1; the next term is 8 e^4/315
    exact = jnp.where(xi < 1, jnp.arccos(under) / jnp.sqrt(1 - under**2), jnp.arccosh(over) / jnp.sqrt(over**2 - 1))
    return jnp.where(near, series, exact)
