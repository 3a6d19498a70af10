"""The page of `vibrojax reproduce` within the site, and its table: the directive `{reproduction-table}`.

A build that executes no pages (`-D nb_execution_mode=off`) omits both.
"""

import subprocess
import sys
from functools import partial
from pathlib import Path

from docutils import nodes
from fingerprint import fingerprint
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from tables import as_table

KEPT = Path(__file__).parents[2] / "build" / "reproduction" / fingerprint()
PART = KEPT.with_suffix(".part")
PAGE = "reproduced/index.html"
PLURAL = {"agrees": "agree", "agrees in trend": "agree in trend", "differs": "differ"}


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the computation and the directive.

    The computation is a process of its own, beside which the interactive page is made: neither keeps all cores busy.
    """
    begun: list[subprocess.Popen[bytes]] = []
    app.connect("config-inited", partial(begin, begun), priority=400)
    app.connect("config-inited", partial(finish, begun), priority=600)
    app.add_directive("reproduction-table", ReproductionTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def begin(begun: list[subprocess.Popen[bytes]], app: Sphinx, config: Config) -> None:
    """Begin to compute the page unless it is cached for the same package."""
    if config.nb_execution_mode == "off" or (KEPT / PAGE).exists():
        return
    logging.getLogger(__name__).info("vibrojax reproduce ...")
    command = [sys.executable, "-m", "vibrojax", "reproduce", "-o", str((PART / PAGE).parent), "--quiet"]
    begun.append(subprocess.Popen(command))


def finish(begun: list[subprocess.Popen[bytes]], app: Sphinx, config: Config) -> None:
    """Wait until the page is computed, and add it to the site."""
    if config.nb_execution_mode == "off":
        return
    while begun:
        process = begun.pop()
        if process.wait():
            raise subprocess.CalledProcessError(process.returncode, process.args)
        PART.replace(KEPT)
    config.html_extra_path = [*config.html_extra_path, str(KEPT)]


class ReproductionTable(SphinxDirective):
    """The number of results with each verdict, a link to the whole page, and its table."""

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        if self.config.nb_execution_mode == "off":
            return [nodes.paragraph("", "Left out of this build: nothing was computed for it.")]
        lines = (KEPT / PAGE).with_name("table.md").read_text(encoding="utf-8").splitlines()
        header, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
        verdicts = [row[header.index("verdict")] for row in rows]
        counts = ", ".join(
            f"{verdicts.count(verdict)} {PLURAL.get(verdict, verdict)}" for verdict in sorted({*verdicts})
        )
        whole = nodes.reference("", "The whole page", refuri=PAGE)
        score = nodes.paragraph("", f"Of {len(rows)} results: {counts}. ")
        score += [whole, nodes.Text(" has pictures, and says what is behind the differences.")]
        return [score, as_table(header, rows)]
