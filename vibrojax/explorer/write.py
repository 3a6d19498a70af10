"""A page written: one self-contained HTML file, with what the dataset lacks computed."""

import html
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from os import PathLike
from pathlib import Path

import xarray as xr

from vibrojax.explorer.cells import Cell, encode
from vibrojax.explorer.document import Document
from vibrojax.explorer.of_dataset import cells_of, document_of, explored
from vibrojax.explorer.packed import deflated
from vibrojax.io.atomic import atomic_write
from vibrojax.io.content_policy import content_policy
from vibrojax.sweep.input.definition import Sweep
from vibrojax.sweep.input.read import read_sweep

SIZE = 256
"""Cells of a block, which the page reads as a whole when one of them is chosen."""

MODULES = (
    *("dom.js", "decode.js", "plots.js", "grid.js", "map.js", "cell.js", "calls.js", "fragment.js"),
    *("layout.js", "pointing.js", "controls.js", "legend.js", "slices.js", "chosen.js", "mount.js"),
)
"""The modules behind `mount`, each after those that it imports from."""

LIVE = ("sliders.js", "computing.js", "live.js")
"""Those of a page that has motions computed."""

_IMPORT = re.compile(r"^import [^;]*;\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=async |class |const |function |let )", re.MULTILINE)


def write_page(
    ds: xr.Dataset,
    path: str | PathLike[str],
    over: xr.Dataset | None = None,
    sweep: Sweep | Mapping[str, object] | None = None,
    progress: bool = True,
) -> Path:
    """Write the page of a dataset: one HTML file that loads nothing from outside.

        vj.write_page(vj.run_sweep("regime-map"), "regime-map.html")

    A click on the map, or arrow keys, choose a cell; its motion is shown in phase planes, over time, as a spectrum and
    by its returns and multipliers, with its numbers and the command that simulates it. What is chosen stands in the
    address, so that a link restores it.

    **Arguments:**

    - `ds`: the dataset of a sweep, of its orbits or attractors, of families, borders, a trajectory, or a fit.
    - `path`: the file to be; one that is there is replaced.
    - `over`: borders, as `borders` gives them, to lay over a map of the same parameters.
    - `sweep`: the sweep that the dataset is of, where it holds objects of yours (a scene, a law), which no file names.
    - `progress`: whether to say on stderr how far it is. A sweep is run again for its motions, with its orbits.

    **Returns:** the path.

    **Raises:** `InputError` where there is nothing of the dataset to show, or `over` or `sweep` does not belong there;
    `OSError` where the file cannot be written.

    **Example:**

    >>> ds = vj.run_sweep({"scene": "rotary", "grid": {"gamma": [0.6, 0.8]}}, progress=False)
    >>> page = vj.write_page(ds, "page.html", progress=False)
    >>> page.read_text()[:15]
    '<!doctype html>'
    """
    path = Path(path)
    own = read_sweep(sweep) if isinstance(sweep, Mapping) else sweep
    ds, over = explored(ds, over, progress)
    document = document_of(ds, over, own)
    blocks = blocks_of(cells_of(ds, progress, own))
    if blocks:
        document["cells"] = {"size": SIZE, "blocks": len(blocks)}
    with atomic_write(path) as part:
        part.write_text(page_text(document, blocks), encoding="utf-8")
    return path


def blocks_of(cells: Iterable[Cell]) -> list[str]:
    """Cells in blocks by their number, `SIZE` in each, deflated, in base64: the lines of a page."""
    some: dict[int, list[Cell]] = {}
    for cell in cells:
        some.setdefault(cell.lane // SIZE, []).append(cell)
    last = max(some, default=-1)
    return [deflated(encode(some.get(index, []))) for index in range(last + 1)]


def page_text(document: Document, blocks: Sequence[str] = ()) -> str:
    """Return the page as HTML; one whose document has `live`, what may be asked for, asks its server for motions.

    Its content security policy lets the browser run and apply what stands in the page, and load nothing.
    """
    live = "live" in document
    modules = (*LIVE, "begin.js", "served.js") if live else ("begin.js", "page.js")
    script = f'\n(() => {{\n"use strict";\n{module_text(*modules)}\n}})();\n'
    style = f"\nbody {{ margin: 0; }}\n{style_text(live)}\n"
    parts = {
        "POLICY": content_policy([script], [style], asks=live),
        "TITLE": html.escape(str(document["title"] or document["scene"] or "vibrojax")),
        "SOURCE": html.escape(str(document["source"] or "vibrojax")),
        "STYLE": style,
        "DATA": in_script(json.dumps(document, separators=(",", ":"), allow_nan=False)),
        "CELLS": "\n".join(blocks),
        "SCRIPT": script,
    }
    return re.sub("@([A-Z]+)@", lambda found: parts[found[1]], _file("page.html"))


def style_text(live: bool = False) -> str:
    """The style sheet, all of whose rules are below the class `vibrojax` or of names that begin with `vx-`.

    `live`: with what a page has that computes.
    """
    return _file("page.css") + (_file("live.css") if live else "")


def module_text(*more: str, exported: bool = False) -> str:
    """The page's modules as one: those behind `mount`, and then `more`.

    `exported`: whether `mount`, `decodeCells` and `embeddedSource` are exported, as a widget or a server's page asks.
    """
    parts = [_EXPORT.sub("", _IMPORT.sub("", _file(name))) for name in (*MODULES, *more)]
    ending = "\nexport { mount, decodeCells, embeddedSource };\n" if exported else ""
    return "\n".join(parts) + ending


def in_script(text: str) -> str:
    """JSON as it may stand in a script element, which nothing in it ends."""
    return text.replace("<", "\\u003c")


def _file(name: str) -> str:
    return (files("vibrojax.explorer") / "page" / name).read_text(encoding="utf-8")
