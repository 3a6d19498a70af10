"""The package's docstrings are Markdown, and autodoc reads reStructuredText: what differs between the two in them."""

import re

from sphinx.application import Sphinx

REFERENCE = re.compile(r"\[([\w.]+)\]\[\]")
"""`[vibrojax.models.scenes][]`: a name of the package."""

LITERAL = re.compile(r"(`[^`]*`)")

SIGNS = re.compile(r"(\||(?<![\w*])\*(?=[\s,)]))")
"""Bars and stars that are meant as such; reStructuredText would take them for the beginning of something."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Have every docstring rewritten before it is read."""
    app.connect("autodoc-process-docstring", lambda app, what, name, obj, options, lines: rewrite(lines))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def rewrite(lines: list[str]) -> None:
    """In place: references, signs, and indented code, which reStructuredText would take for a quotation."""
    out: list[str] = []
    code = example = False
    for line in lines:
        indent = len(line) - len(line.lstrip())
        begins = indent >= 4 and not code and bool(out) and not out[-1].strip() and not _in_list(out)
        if begins:
            out += [".. code-block:: python", ""]
        code = (code or begins) and (indent >= 4 or not line.strip())
        example = line.startswith(">>>") or (example and bool(line.strip()))
        out.append(line if code or example else _in_words(line))
    lines[:] = [*out, ""]


def _in_words(line: str) -> str:
    parts = LITERAL.split(REFERENCE.sub(r"`\1`", line))
    return "".join(part if part.startswith("`") else SIGNS.sub(r"\\\1", part) for part in parts)


def _in_list(lines: list[str]) -> bool:
    """Whether the last line above the blank ones is, or goes on, an item of a list."""
    above = [line for line in lines if line.strip()]
    return bool(above) and above[-1].startswith(("- ", "  "))
