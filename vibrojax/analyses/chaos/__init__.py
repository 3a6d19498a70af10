"""What irregular motion is: the greatest Lyapunov exponent through all events, and what nature follows from it."""

from vibrojax.analyses.chaos.natures import Natures as Natures
