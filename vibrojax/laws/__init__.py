"""What a designer carries away: how the rate of penetration depends on the parameters."""

from vibrojax.laws.sensitivity import rop_derivatives as rop_derivatives
