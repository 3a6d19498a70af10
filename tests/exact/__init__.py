"""Exact reference for the five scenes, written from the model alone. It shares no code with the package under test.

Between two switches, the motion follows one mode, whose equations contain no switch. A step of a mode is a polynomial
of degree 24 that satisfies these equations to rounding. The next switch is the first root of a polynomial, and there
the mode changes. Nothing is smoothed, and there is no step size to choose. The reference is for tests and for
certification.

    motion = exact.run("vibro-impact", beta=0.4, gamma=0.75, start="stuck", settle=40.0, observe=8.0)
    exact.measure(motion)["period"]

Equations and readings (R1, R2, ...) are numbered as in the model. Measures follow the contract.
"""

from exact.measures import measure
from exact.motion import Motion, run
from exact.parameters import Pulses
from exact.scenes import SCENES

__all__ = ["SCENES", "Motion", "Pulses", "measure", "run"]
