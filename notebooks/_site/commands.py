"""The output of `--help` of every command, as a page: the directive `{command-help}`."""

import os
import subprocess
import sys

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from vibrojax.cli import _COMMANDS


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class CommandHelp(SphinxDirective):
    """A section for each command."""

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        sections = []
        for name in _COMMANDS:
            section = nodes.section("", nodes.title("", f"vibrojax {name}"), ids=[name])
            section += nodes.literal_block("", help_text(name), language="none")
            sections.append(section)
        return sections


def help_text(name: str) -> str:
    """Return the help of a command in lines that fit on a page, without the terms that the glossary defines."""
    settings = os.environ | {"COLUMNS": "88", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "vibrojax", name, "--help"]
    text = subprocess.run(command, env=settings, check=True, capture_output=True, text=True).stdout
    return text.partition("words used in the output:")[0].rstrip()
