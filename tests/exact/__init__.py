"""An exact reference of the five scenes, written from the model alone: it shares nothing with the package under test.

Between two switches the motion is that of one mode, a system of equations without a switch in it. A step of a mode is
a polynomial of degree 24 that satisfies those equations to rounding; the first switch on it is a root of a polynomial;
there the mode changes. Nothing is smoothed, and there is no step size to choose. It is for tests and for certifying.

    motion = exact.run("vibro-impact", beta=0.4, gamma=0.75, start="stuck", settle=40.0, observe=8.0)
    exact.measure(motion)["period"]

Equations and readings (R1, R2, ...) are numbered as in the model; measures and labels are those of the contract.
"""

from exact.measures import label, measure
from exact.motion import Motion, run
from exact.pulses import Pulses, Sweep
from exact.scenes import SCENES

__all__ = ["SCENES", "Motion", "Pulses", "Sweep", "label", "measure", "run"]
