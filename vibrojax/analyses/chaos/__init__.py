"""Largest Lyapunov exponents across all events, and the nature of lanes (periodic, chaotic, ...) that they imply."""

from vibrojax.analyses.chaos.natures import Natures as Natures
