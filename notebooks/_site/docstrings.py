"""The package's docstrings are Markdown, and autodoc reads reStructuredText: what differs between the two in them."""

import re

from sphinx.application import Sphinx

REFERENCE = re.compile(r"\[([\w.]+)\]\[\]")
"""`[vibrojax.scenes][]`: a name of the package."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Have every docstring rewritten before it is read."""
    app.connect("autodoc-process-docstring", lambda app, what, name, obj, options, lines: rewrite(lines))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def rewrite(lines: list[str]) -> None:
    """In place: references, and indented code, which reStructuredText would take for a quotation."""
    out: list[str] = []
    code = False
    for line in lines:
        indent = len(line) - len(line.lstrip())
        begins = indent >= 4 and not code and out and not out[-1].strip() and not _in_list(out)
        if begins:
            out += [".. code-block:: python" if not line.lstrip().startswith("vibrojax ") else ".. code-block:: sh", ""]
        code = (code or bool(begins)) and (indent >= 4 or not line.strip())
        out.append(line if code else REFERENCE.sub(r"`\1`", line))
    lines[:] = [*out, ""]


def _in_list(lines: list[str]) -> bool:
    """Whether the last paragraph above the blank lines is, or goes on, an item of a list."""
    above = [line for line in lines if line.strip()]
    return bool(above) and (above[-1].startswith(("- ", "  ")) or above[-1].lstrip().startswith("- "))
