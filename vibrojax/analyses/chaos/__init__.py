"""Largest Lyapunov exponents through all events, and the natures of lanes that follow from them."""

from vibrojax.analyses.chaos.natures import Natures as Natures
