"""Linear modes of bit and striker without impact (Batako's thesis, eqs. 5.15 to 5.17).

**Example:**

>>> lower, upper = vj.modes.natural_frequencies({"m1": 250.0, "k1": 156250.0, "beta": 0.4, "gamma": 0.75})
>>> f"{lower:.2f} and {upper:.2f} rad/s"
'15.96 and 29.37 rad/s'
"""

from collections.abc import Mapping
from math import pi
from typing import Any

from jaxtyping import Float

from vibrojax.lazy import jnp
from vibrojax.physics.arrays import Array, Value

Numbers = Mapping[str, Any]
"""Parameters by name: scalars, or arrays with one value per lane."""


def striker(p: Numbers) -> tuple[Any, Any]:
    """Return the striker's mass m2 = beta m1 [kg] and spring stiffness k2 = m2 (gamma w1)² [N/m]; w1² = k1/m1."""
    return p["beta"] * p["m1"], p["beta"] * p["k1"] * p["gamma"] ** 2


def uncoupled_frequencies(p: Numbers) -> tuple[Any, Any]:
    """Return the natural frequencies [Hz] of bit and striker, each alone on its spring: w1/2pi and w2/2pi.

    **Example:**

    >>> bit, striker_alone = vj.modes.uncoupled_frequencies({"m1": 250.0, "k1": 156250.0, "gamma": 0.75})
    >>> f"{bit:.3f} and {striker_alone:.3f} Hz"
    '3.979 and 2.984 Hz'
    """
    bit = (p["k1"] / p["m1"]) ** 0.5 / (2 * pi)
    return bit, bit * p["gamma"]


def natural_frequencies(p: Numbers, xp: Any = jnp) -> Float[Array, "*lanes 2"]:
    """Return the two undamped natural frequencies [rad/s] (Batako's thesis, eq. 5.16).

    The last axis of the result has length 2; the lower frequency comes first. The frequencies w are the roots of w⁴ -
    w² (w1² + w2² (1 + beta)) + w1² w2² = 0. `xp`: the array library, jax.numpy or numpy.
    """
    w1_squared = p["k1"] / p["m1"]
    w2_squared = w1_squared * p["gamma"] ** 2
    total = w1_squared + w2_squared * (1 + p["beta"])
    product = w1_squared * w2_squared
    upper = (total + xp.sqrt(total**2 - 4 * product)) / 2
    # product/upper instead of (total - root)/2, which loses digits by cancellation if the frequencies are far apart.
    frequencies: Array = xp.sqrt(xp.stack([product / upper, upper], axis=-1))
    return frequencies


def empirical_frequency(p: Numbers, share: Value = 0.25) -> Any:
    """Return an empirical estimate of the vibration frequency [rad/s] (Batako's thesis, eq. 5.17).

    The estimate is w = sqrt((k1 + k2)/m1 + s k2/m2), with s = `share`, which is 1/4 in Batako's thesis.
    """
    m2, k2 = striker(p)
    return jnp.sqrt((p["k1"] + k2) / p["m1"] + share * k2 / m2)


def linearised(p: Numbers, friction_slope: Value) -> Float[Array, "4 4"]:
    """Return the system matrix of the motion linearised about steady sliding (Batako's thesis, eq. 5.15).

    **Arguments:** `p`: scalar parameters; `friction_slope` [N s/m]: dF/du at the drive speed. If `friction_slope` is
    negative, friction feeds energy into the vibration.

    **Returns:** an array (4, 4) for the state (x1, x1', x2, x2'). The eigenvalues of the system matrix have the growth
    rates [1/s] of the modes as real parts, and the frequencies [rad/s] of the modes as imaginary parts.
    """
    m1, k1, c2 = p["m1"], p["k1"], p["c2"]
    m2, k2 = striker(p)
    return jnp.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-(k1 + k2) / m1, -friction_slope / m1, k2 / m1, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [k2 / m2, 0.0, -k2 / m2, -c2 / m2],
        ]
    )
