"""Glossary of the package's terms, and links to it from the first use of each term on a page.

The directive `{code-glossary}` writes the definitions of `vibrojax.studies.WORDS` and those of the site.
"""

import re

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from vibrojax.io.kinds import SPECIAL_KINDS
from vibrojax.studies import WORDS

PAGE = "files_and_symbols"
SITE_WORDS = {
    "Batako's thesis": "Batako, *A self-exciting system for percussive-rotary drilling*, PhD thesis, "
    "Loughborough University: the source of the drill's equations, called *the source* in files and docstrings",
    "default map": "map of the bundled sweep `regime-map`: 8,280 lanes over β, γ, gap and start",
    "ω₂/ω₁": "ratio γ (`gamma` in code) of the natural frequencies of striker and bit, each alone on its spring",
}
"""Terms that only the site needs."""

LINKED = ("lane", "regime", "relief P/D", "orbit", "multiplier", "family", "default map", "Batako's thesis")
"""Terms that are linked wherever they occur. Others, such as *section*, have everyday meanings too."""

_PLURALS = {"family": "families", "relief P/D": "relief"}
_NOT_LINKED = (nodes.reference, nodes.literal, nodes.literal_block, nodes.title, pending_xref, nodes.math, nodes.raw)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive and the links."""
    app.add_directive("code-glossary", CodeGlossary)
    app.connect("doctree-read", link_terms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class CodeGlossary(SphinxDirective):
    """The definitions of all terms, in alphabetical order."""

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        terms = sorted((WORDS | SITE_WORDS).items(), key=lambda item: item[0].lower())
        kinds = {*SPECIAL_KINDS, "section point"}  # which the table of the guide to orbits describes
        lines = [line for term, meaning in terms if term not in kinds for line in (term, f"  {meaning}.", "")]
        return self.parse_text_to_nodes("\n".join(["```{glossary}", *lines, "```"]))


def link_terms(app: Sphinx, document: nodes.document) -> None:
    """Replace the first use of each term in a page's paragraphs by a link to its definition."""
    page = app.env.docname
    if page == PAGE or page.startswith("api/"):
        return
    patterns = {term: re.compile(rf"\b({re.escape(term)}s?|{_PLURALS.get(term, term)})\b") for term in LINKED}
    texts = [
        text
        for paragraph in document.findall(nodes.paragraph)
        for text in paragraph.findall(nodes.Text)
        if not _inside(text, paragraph)
    ]
    for term, pattern in patterns.items():
        for index, text in enumerate(texts):
            match = pattern.search(text.astext())
            if match:
                link = pending_xref(
                    "", nodes.inline("", match[0], classes=["term"]), refdomain="std", reftype="term", reftarget=term,
                    refexplicit=True, refwarn=True, refdoc=page,
                )  # fmt: skip
                before, after = nodes.Text(text.astext()[: match.start()]), nodes.Text(text.astext()[match.end() :])
                text.parent.replace(text, [before, link, after])
                texts[index : index + 1] = [before, after]
                break


def _inside(text: nodes.Text, paragraph: nodes.paragraph) -> bool:
    """Return whether a text is part of a link, of code or of an equation."""
    parent = text.parent
    while parent is not None and parent is not paragraph:
        if isinstance(parent, _NOT_LINKED):
            return True
        parent = parent.parent
    return False
