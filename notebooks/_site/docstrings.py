"""Conversion of the package's docstrings, which are Markdown, into the reStructuredText that autodoc reads."""

import re

from sphinx.application import Sphinx

REFERENCE = re.compile(r"\[([\w.]+)\]\[\]")
"""A reference to a name of the package: `[vibrojax.scenes][]`."""

LITERAL = re.compile(r"(`[^`]*`)")

SIGNS = re.compile(r"(\||(?<![\w*])\*(?=[\s,)]))")
"""Literal bars and asterisks, which reStructuredText would read as markup."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Convert every docstring before autodoc reads it."""
    app.connect("autodoc-process-docstring", lambda app, what, name, obj, options, lines: rewrite(lines))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def rewrite(lines: list[str]) -> None:
    """Convert, in place, references, literal signs, and indented code, which would become a quotation."""
    result: list[str] = []
    code = example = False
    for line in (line for line in lines if line != "**Example:**"):  # code with prompts needs no label
        indent = len(line) - len(line.lstrip())
        begins = indent >= 4 and not code and bool(result) and not result[-1].strip() and not _in_list(result)
        if begins:
            result += [".. code-block:: python", ""]
        code = (code or begins) and (indent >= 4 or not line.strip())
        example = line.startswith(">>>") or (example and bool(line.strip()))
        result.append(line if code or example else _converted(line))
    lines[:] = [*result, ""]


def _converted(line: str) -> str:
    parts = LITERAL.split(REFERENCE.sub(r"`\1`", line))
    return "".join(part if part.startswith("`") else SIGNS.sub(r"\\\1", part) for part in parts)


def _in_list(lines: list[str]) -> bool:
    """Return whether the last line that is not blank belongs to an item of a list."""
    above = [line for line in lines if line.strip()]
    return bool(above) and above[-1].startswith(("- ", "  "))
