"""The results as a table in Markdown (contract: reproduction)."""

from vibrojax.reproduce._run import Reproduction

COLUMNS = ("id", "what", "source", "here", "verdict", "reading")


def table(found: Reproduction) -> str:
    """One line per entry, in the order of the registry."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for result in found.results:
        entry, here = result.entry, result.here
        cells = (entry.id, entry.what, entry.source, here.text, here.verdict, ", ".join(entry.readings))
        lines.append(f"| {' | '.join(_cell(text) for text in cells)} |")
    return "\n".join([*lines, ""])


def _cell(text: str) -> str:
    """A cell may hold no bar and no line break."""
    return " ".join(text.replace("|", "/").split())
