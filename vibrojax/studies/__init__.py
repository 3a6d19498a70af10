"""Analyses of scenes and datasets, where they are; and definitions of the terms in their output."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points

HOMES = {
    "sweep": "sweep:Sweeps",
    "trajectory": "trajectory:Trajectories",
    "family": "family_analysis:Families",
    "curves": "curve_analysis:Curves",
    "borders": "borders:Borders",
    "attractors": "attractors:Attractors",
    "push": "push:Pushes",
    "tolerance": "tolerance:Tolerances",
    "design": "design:Designs",
    "study": "effects:Studies",
    "rig": "rig_analysis:Rigs",
    "calibration": "calibrate:Calibrations",
    "fit": "rop_results:Fits",
    "accuracy": "accuracy:AccuracyStudy",
    "sensitivity": "sensitivity:Sensitivity",
}
"""Module and class of each of the package's own analyses, which are imported when they are needed."""

GROUP = "vibrojax.analyses"
"""Entry-point group in which an installed package registers its analyses, as `NAME = "module:Class"`."""


@cache
def offered_analyses() -> dict[str, EntryPoint]:
    """Return the entry points of analyses in installed packages, by kind; vibrojax's own kinds cannot be replaced."""
    return {entry.name: entry for entry in entry_points(group=GROUP) if entry.name not in HOMES}


WORDS = {
    "lane": "one simulation of a sweep, with one set of parameter values and one start (initial condition)",
    "section": "the Poincaré section: the instant at which the bit becomes faster than the drive",
    "return": "one crossing of the Poincaré section",
    "relief P/D": "mean force on the bit, divided by the force D (threshold) at which the rock yields",
    "regime": "the kind of motion of the striker, such as single-impact (one impact per period) or irregular",
    "orbit": "a motion that repeats exactly; it is stable if it attracts all neighbouring motions",
    "multiplier": "complex factor by which a small deviation from an orbit grows per period; if the moduli of all "
    "multipliers are below 1, the orbit is stable",
    "family": "the stable and unstable orbits that form a continuous curve as one parameter changes",
    "branch": "a part of a family; branch 0 is the first, and others begin at period doublings and branch points",
    "special point": "a point of a family at which its stability, its direction or the order of events changes",
    "fold": "the family turns back, and a stable and an unstable orbit meet",
    "period-doubling": "the orbit loses its stability to one that repeats after twice as many returns",
    "torus": "the orbit loses its stability to a motion with a second frequency",
    "branch-point": "another family of orbits crosses this one, as where a symmetric orbit loses its symmetry",
    "grazing": "an impact appears or vanishes",
    "stick": "a stick phase of the bit, or a backward slip, appears or vanishes",
    "section point": "the bit barely becomes faster than the drive; beyond it, the number of returns changes",
    "hopf": "the amplitude of the orbit shrinks to zero at an equilibrium, whose stability changes there",
    "end": "a bound is reached, or the family ends for the reason in the note",
    "reading R1, R2, ...": "this package's interpretation of a passage of Batako's thesis that can be read in two ways",
}

FAMILY_WORDS = tuple(word for word in WORDS if word not in ("lane", "relief P/D", "regime", "reading R1, R2, ..."))
"""Terms in the output of `vibrojax follow`."""


def glossary(*words: str) -> str:
    """Return the definitions of the specified words, or of all words, one per line."""
    return "\n".join(f"  {word}: {WORDS[word]}" for word in words or WORDS)
