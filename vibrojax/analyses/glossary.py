"""Words of this package that a reader may not know, each in half a sentence: one table for all that explains them."""

WORDS = {
    "lane": "one point of the parameters from one start, stepped on its own",
    "section": "the instant at which the bit overtakes the drive",
    "return": "one passage of the section; period and repeats are counted in returns",
    "relief P/D": "mean force on the bit over the force D (threshold) at which the rock yields",
    "regime": "how the striker moves: one clean blow a period (single-impact), several, none, or anyhow (irregular)",
    "orbit": "a motion that repeats exactly; stable where it attracts what is near it",
    "multiplier": "by how much a small distance from an orbit has grown after one repeat; all below 1: stable",
    "family": "the orbits that go over into each other as one parameter changes, stable and unstable",
    "branch": "a part of a family; 0 is the one begun with, others leave it with twice as many returns to a repeat",
    "special point": "where a family changes its stability, its order of events, or its direction",
    "fold": "the family turns back, and a stable and an unstable orbit meet",
    "period-doubling": "the orbit loses its stability to one that repeats after twice as many returns",
    "torus": "the orbit loses its stability to a motion with a second frequency",
    "grazing": "an impact begins or vanishes",
    "stick": "a stick of the bit, or a slip backwards, begins or vanishes",
    "section point": "the bit just catches up with the drive: returns are counted otherwise from here",
    "end": "a bound is reached, or why a family goes no further",
    "reading R1, R2, ...": "how a passage of the source that can be read in two ways was read",
}


FAMILY_WORDS = (
    "section",
    "return",
    "orbit",
    "multiplier",
    "family",
    "branch",
    "special point",
    "fold",
    "period-doubling",
    "torus",
    "grazing",
    "stick",
    "section point",
    "end",
)
"""Those that families are told in."""


def glossary(*words: str) -> str:
    """What some words mean, or all of them, a line each."""
    return "\n".join(f"  {word}: {WORDS[word]}" for word in words or WORDS)
