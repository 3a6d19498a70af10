"""The interactive page of a small map, embedded on the first page: the directive `{interactive-page}`.

A build that executes no pages (`-D nb_execution_mode=off`) omits it.
"""

import os
from pathlib import Path

from docutils import nodes
from fingerprint import fingerprint
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.util.docutils import SphinxDirective

import vibrojax as vj

KEPT = Path(__file__).parents[2] / "build" / "interactive" / fingerprint()
PAGE = "map/index.html"
VALUES = int(os.environ.get("VIBROJAX_NOTEBOOK_VALUES", 19))
SWEEP = {
    "scene": "vibro-impact",
    "title": "Regimes over mass ratio and frequency ratio",
    "starts": ["drive", "stuck"],
    "parameters": {"delta": 0.005},
    "grid": {"beta": {"start": 0.1, "stop": 1.2, "num": VALUES}, "gamma": {"start": 0.3, "stop": 1.2, "num": VALUES}},
}


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the computation and the directive."""
    app.connect("config-inited", compute)
    app.add_directive("interactive-page", InteractivePage)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def compute(app: Sphinx, config: Config) -> None:
    """Write the page unless it is cached for the same package, and add it to the site."""
    if config.nb_execution_mode == "off":
        return
    if not (KEPT / PAGE).exists():
        (KEPT / PAGE).parent.mkdir(parents=True, exist_ok=True)
        vj.write_page(vj.run_sweep(SWEEP, progress=False), KEPT / PAGE, progress=False)
    config.html_extra_path = [*config.html_extra_path, str(KEPT)]


class InteractivePage(SphinxDirective):
    """The page in a frame, with a link to it on its own."""

    def run(self) -> list[nodes.Node]:
        self.env.note_reread()
        if self.config.nb_execution_mode == "off":
            return [
                nodes.paragraph("", "This build of the site has no interactive map, because it ran no simulations.")
            ]
        frame = f'<iframe class="interactive" src="{PAGE}" title="Interactive regime map" loading="eager"></iframe>'
        link = nodes.reference("", "Open this page on its own", refuri=PAGE)
        return [nodes.raw("", frame, format="html"), nodes.paragraph("", "", link, nodes.Text("."))]
