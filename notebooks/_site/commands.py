"""What `--help` says of every command, as a page: `{command-help}`."""

import os
import subprocess
import sys

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from vibrojax.cli import _COMMANDS


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class CommandHelp(SphinxDirective):
    """A section for each command."""

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        sections = []
        for name in _COMMANDS:
            section = nodes.section("", nodes.title("", f"vibrojax {name}"), ids=[name])
            section += nodes.literal_block("", said(name), language="none")
            sections.append(section)
        return sections


def said(name: str) -> str:
    """What the command answers, in lines that a page has room for."""
    settings = os.environ | {"COLUMNS": "88", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "vibrojax", name, "--help"]
    return subprocess.run(command, env=settings, check=True, capture_output=True, text=True).stdout.rstrip()
