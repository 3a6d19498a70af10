"""The page that `vibrojax reproduce` makes, beside the site's own; its table on one of them: `{reproduction-table}`.

Both are left out where pages are not executed either (`-D nb_execution_mode=off`).
"""

import subprocess
import sys
from pathlib import Path

from docutils import nodes
from fingerprint import fingerprint
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from tables import as_table

KEPT = Path(__file__).parents[2] / "build" / "reproduction" / fingerprint()
PAGE = "reproduced/index.html"
PLURAL = {"agrees": "agree", "agrees in trend": "agree in trend", "differs": "differ"}


def setup(app: Sphinx) -> dict[str, bool]:
    """Have it computed, copied and shown."""
    app.connect("config-inited", compute)
    app.add_directive("reproduction-table", ReproductionTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def compute(app: Sphinx, config: Config) -> None:
    """Compute it, unless that was done for the same package; and have it copied into the site."""
    if config.nb_execution_mode == "off":
        return
    if not (KEPT / PAGE).exists():
        logging.getLogger(__name__).info("vibrojax reproduce ...")
        made = KEPT.with_suffix(".part")
        command = [sys.executable, "-m", "vibrojax", "reproduce", "-o", str((made / PAGE).parent), "--quiet"]
        subprocess.run(command, check=True)
        made.replace(KEPT)
    config.html_extra_path = [*config.html_extra_path, str(KEPT)]


class ReproductionTable(SphinxDirective):
    """How many results have each verdict, where the whole page is, and its table."""

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        if self.config.nb_execution_mode == "off":
            return [nodes.paragraph("", "Left out of this build: nothing was computed for it.")]
        lines = (KEPT / PAGE).with_name("table.md").read_text(encoding="utf-8").splitlines()
        header, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
        verdicts = [row[header.index("verdict")] for row in rows]
        counts = ", ".join(f"{verdicts.count(one)} {PLURAL.get(one, one)}" for one in sorted({*verdicts}))
        whole = nodes.reference("", "The whole page", refuri=PAGE)
        score = nodes.paragraph("", f"Of {len(rows)} results: {counts}. ")
        score += [whole, nodes.Text(" has pictures, and says what is behind the differences.")]
        return [score, as_table(header, rows)]
