"""Largest Lyapunov exponents across all events, and the classification of lanes (periodic, chaotic, ...) by them."""

from vibrojax.analyses.chaos.natures import Natures as Natures
