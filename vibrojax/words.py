"""Words of this package that a reader may not know, each in half a sentence: one table for all that explains them."""

WORDS = {
    "lane": "one point of the parameters from one start, stepped on its own",
    "section": "the instant at which the bit overtakes the drive",
    "return": "one passage of the section; period and repeats are counted in returns",
    "relief P/D": "mean force on the bit over the force D (threshold) at which the rock yields",
    "regime": "how the striker moves: one clean blow a period (single-impact), several, none, or anyhow (irregular)",
    "reading R1, R2, ...": "how a passage of the source that can be read in two ways was read",
}


def glossary(*words: str) -> str:
    """What some words mean, or all of them, a line each."""
    return "\n".join(f"  {word}: {WORDS[word]}" for word in words or WORDS)
