"""The friction laws (model, section 3; eqs. 2.13 to 2.17 and 5.9) as formulas of the sliding speed w = |u|, w > 0.

A step across w = 0 evaluates them at slightly negative w, where they continue smoothly."""

import numpy as np


def stribeck(w, p):
    """Return (5.9), relative to m1 g."""
    return p.mu * (1 - w / p.v_cr + w**3 / (3 * p.v_cr**3))


def coulomb(w, p):
    """(2.13)"""
    return p.mu + 0 * w


def popp_exponential(w, p):
    """Return (2.14), with the exponent of the second factor read as that of the first; flat at w = 0."""
    w = np.asarray(w)
    rise = np.exp(p.popp_c1 / np.where(w.real > 0, w, 1)) * (w.real > 0)
    return 0.165 * (1 + rise) * (1 + np.exp(p.popp_c2 * w))


def popp_arctan(w, p):
    """(2.15)"""
    return p.a1 * (1 + p.a2 * np.exp(-p.b1 * w)) * np.arctan(p.b2 * w)


def hyperbolic(w, p):
    """(2.16)"""
    return p.mu0 / (1 + p.delta_f * w)


def hyperbolic_quadratic(w, p):
    """(2.17)"""
    return (p.mu0 - p.mu1) / (1 + getattr(p, "lambda") * w) + p.mu1 + p.alpha * w**2


LAWS = {"stribeck": stribeck, "coulomb": coulomb, "popp-exponential": popp_exponential, "popp-arctan": popp_arctan}
LAWS |= {"hyperbolic": hyperbolic, "hyperbolic-quadratic": hyperbolic_quadratic}


def force(w, J, p):
    """Return |F| while the bit slides at speed w and the striker presses with J (5.9, 5.12, R2; section 3)."""
    mu = LAWS[p.friction](w, p)
    if p.friction == "stribeck":
        return mu * p.m1 * p.g + p.mu * J
    return mu * (p.m1 * p.g + J)


def stick_coefficient(p) -> float:
    """Return mu(0+). The bit sticks while the pull is at most mu(0+) (m1 g + J) (5.11)."""
    return float(LAWS[p.friction](0.0, p))
