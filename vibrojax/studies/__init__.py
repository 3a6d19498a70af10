"""Analyses of scenes and datasets, where they are; and definitions of the terms in their output."""

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

WORDS = {
    "lane": "one simulation of a batch: one set of parameter values with one initial condition, its start",
    "section": "the instant at which the bit overtakes the drive",
    "return": "one crossing of the section; periods and repeats are counted in returns",
    "relief P/D": "mean force on the bit over the force D (threshold) at which the rock yields",
    "regime": "how the striker moves: one impact a period (single-impact), several, none, or irregularly (irregular)",
    "orbit": "a motion that repeats exactly; stable if it attracts its neighbourhood",
    "multiplier": "factor by which a small distance from an orbit grows over one repeat; all moduli below 1: stable",
    "family": "orbits that form a continuous curve as one parameter changes, stable and unstable",
    "branch": "a part of a family; 0 is the first, others leave it at period doublings and branch points",
    "special point": "point of a family at which its stability, its order of events or its direction changes",
    "fold": "the family turns back, and a stable and an unstable orbit meet",
    "period-doubling": "the orbit loses its stability to one that repeats after twice as many returns",
    "torus": "the orbit loses its stability to a motion with a second frequency",
    "branch-point": "another family of orbits crosses, such as the symmetric one of a pair that loses its symmetry",
    "grazing": "an impact appears or vanishes",
    "stick": "a stick phase of the bit, or a backward slip, appears or vanishes",
    "section point": "the bit only just overtakes the drive; beyond this point, the number of returns differs",
    "hopf": "the amplitude shrinks to zero at an equilibrium, which changes its stability",
    "end": "a bound is reached, or the family ends for the reason in the note",
    "reading R1, R2, ...": "interpretation of a passage of the source that can be read in two ways",
}

FAMILY_WORDS = tuple(word for word in WORDS if word not in ("lane", "relief P/D", "regime", "reading R1, R2, ..."))
"""Terms in the output of `vibrojax follow`."""


def glossary(*words: str) -> str:
    """Return the definitions of the specified words, or of all words, one per line."""
    return "\n".join(f"  {word}: {WORDS[word]}" for word in words or WORDS)
