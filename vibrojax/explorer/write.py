"""The explorer page as text: one module and style sheet for HTML files, servers and widgets, and the written file."""

import base64
import html
import json
import re
from collections.abc import Mapping, Sequence
from hashlib import sha256
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from vibrojax.errors import InputError
from vibrojax.explorer.document import Document
from vibrojax.explorer.encoding import Cell, deflate, encode
from vibrojax.explorer.motions import LiveMotions, motions_for
from vibrojax.explorer.views import contents_of
from vibrojax.io.atomic import atomic_write
from vibrojax.io.files import source
from vibrojax.maps.read import read_sweep
from vibrojax.maps.sweep import Sweep

if TYPE_CHECKING:
    from vibrojax.explorer.widget import Explorer  # needs anywidget

BLOCK_CELLS = 256  # number of motions per block; the page inflates a block when one of its motions is selected

MODULES = [
    f"{name}.js"
    for name in (
        *("dom", "decode", "plots", "paper", "interact", "grid", "figure", "map", "cell", "machine", "player"),
        *("compare", "calls", "fragment", "layout", "pointing", "controls", "legend", "slices", "chosen", "mount"),
    )
]
"""The modules behind `mount`, each after those that it imports."""

LIVE_MODULES = ("sliders.js", "computing.js", "live.js")  # for motions on demand

_IMPORT = re.compile(r"^import [^;]*;\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=async |class |const |function\*? |let )", re.MULTILINE)


def write_page(
    ds: xr.Dataset,
    path: str | PathLike[str],
    over: xr.Dataset | None = None,
    sweep: Sweep | Mapping[str, object] | None = None,
    progress: bool = True,
) -> Path:
    """Write the explorer page of a dataset: one HTML file that loads nothing from the network.

        vj.write_page(vj.run_sweep("regime-map"), "regime-map.html")

    **Arguments:**

    - `ds`: dataset of any kind that has a picture.
    - `path`: path of the HTML file; a page that this package wrote is replaced.
    - `over`: result of `borders` or `curves`, to be drawn on top of a map of the same parameters, or result of
      `follow`, to be drawn on top of the section crossings of a sweep.
    - `sweep`: the sweep of the dataset, needed if the sweep contains objects of your own, such as a scene or a friction
      law.
    - `progress`: whether to report progress. To record the motions for the page, `write_page` runs the sweep of the
      dataset again.

    **Returns:** the path.

    **Raises:** `InputError` if the dataset holds nothing to show, if the overlay or the sweep does not belong to the
    dataset, or if another program wrote the existing file at `path`. `OSError` if the file cannot be written.

    **Example:**

    >>> ds = vj.run_sweep({"scene": "rotary", "grid": {"gamma": [0.6, 0.8]}}, progress=False)
    >>> page = vj.write_page(ds, "page.html", progress=False)
    >>> page.read_text()[:15]
    '<!doctype html>'
    """
    path = Path(path)
    _, document, blocks, _ = page_contents(ds, over, sweep, False, progress)
    with atomic_write(path) as part:
        part.write_text(page_text(document, blocks), encoding="utf-8")
    return path


def explore(
    ds: xr.Dataset,
    *,
    over: xr.Dataset | None = None,
    sweep: Sweep | Mapping[str, object] | None = None,
    live: bool | None = None,
) -> "Explorer":
    """Return the explorer page of a dataset as a notebook widget; Python code can read and set the selected map cell.

    JupyterLab, Jupyter Notebook from version 7 and VS Code show the widget.

    **Arguments:**

    - `ds`, `over`, `sweep`: as for [vibrojax.write_page][].
    - `live`: True to show a slider for every parameter, and to simulate the selected motion in the notebook's kernel.
      If `live` is False, the sweep is run again, and the widget contains the motions of all lanes and works without a
      kernel. By default, `live` is True if the scene belongs to the package.

    **Returns:** the widget. The traits `cell` (index along each axis) and `point` (value of each axis in SI units, and
    the initial condition by name or state) describe the selected map cell. The property `lane` of the widget is the
    dataset of the selected lane.

    **Raises:** `InputError` if the dataset holds nothing to show, or if anywidget is not installed
    (`pip install "vibrojax[widget]"`); an assignment `widget.point = ...` raises `InputError` if the axis or value does
    not exist.

    In a notebook, a cell with the line `widget` shows the page. Select a map cell by a click, or in Python by an
    assignment to `widget.point`.

    **Example:**

    >>> sweep = {"scene": "vibro-impact", "grid": {"beta": [0.3, 0.4]}, "run": {"settle": 8.0}}
    >>> widget = vj.explore(vj.run_sweep(sweep, progress=False))
    >>> widget.observe(lambda change: print("picked", change.new), "point")
    >>> widget.point = {"beta": 0.31, "start": "stuck"}  # the nearest cell; other axes keep their values
    picked {'beta': 0.3, 'start': 'stuck'}
    >>> f"{float(widget.lane.impact_velocity):.2f} m/s"
    '1.70 m/s'
    """
    try:
        from vibrojax.explorer.widget import Explorer
    except ModuleNotFoundError as error:
        if error.name not in ("anywidget", "ipywidgets", "traitlets"):
            raise
        raise InputError('explore: anywidget is not installed; pip install "vibrojax[widget]"') from None
    return Explorer(ds, over, sweep, live)


def page_contents(
    ds: xr.Dataset,
    over: xr.Dataset | None,
    sweep: Sweep | Mapping[str, object] | None,
    live: bool | None,
    progress: bool,
) -> tuple[xr.Dataset, Document, list[str], LiveMotions | None]:
    """Return the dataset of a page, its JSON document, its encoded motions, and its motions on demand."""
    own = read_sweep(sweep) if isinstance(sweep, Mapping) else sweep
    ds, document, cells = contents_of(ds, over, own, progress)
    motions = None
    if live is not False:
        try:
            motions = motions_for(ds, own)
        except InputError:
            if live:
                raise
    has_lanes = motions is not None and motions.sweep is not None
    by_block: dict[int, list[Cell]] = {}
    for cell in () if has_lanes else cells:
        by_block.setdefault(cell.lane // BLOCK_CELLS, []).append(cell)
    blocks = [deflate(encode(by_block.get(index, []))) for index in range(max(by_block, default=-1) + 1)]
    if blocks:
        document["cells"] = {"size": BLOCK_CELLS, "blocks": len(blocks)}
    return ds, document, blocks, motions


def page_text(document: Document, blocks: Sequence[str] = ()) -> str:
    """Return the explorer page as HTML; with the key `live`, it requests motions from its server."""
    is_live = "live" in document
    modules = (*LIVE_MODULES, "begin.js", "served.js") if is_live else ("begin.js", "page.js")
    script = f'\n(() => {{\n"use strict";\n{module_text(*modules)}\n}})();\n'
    style = f"\nbody {{ margin: 0; }}\n{style_text(is_live)}\n"
    data = json.dumps(document, separators=(",", ":"), allow_nan=False)
    parts = {
        "POLICY": content_policy([script], [style], asks=is_live),
        "TITLE": html.escape(str(document["title"] or document["scene"] or "vibrojax")),
        "SOURCE": html.escape(source()),
        "STYLE": style,
        "DATA": data.replace("<", "\\u003c"),  # so that no text ends the script element
        "CELLS": "\n".join(blocks),
        "SCRIPT": script,
    }
    return re.sub("@([A-Z]+)@", lambda key: parts[key[1]], _file("page.html"))


def style_text(live: bool = False) -> str:
    """Return the style sheet, whose rules apply below the class `vibrojax` or to names that begin with `vx-`."""
    return _file("page.css") + (_file("live.css") if live else "")


def module_text(*more: str) -> str:
    """Return the modules behind `mount`, followed by `more`, as one script without imports and exports."""
    return "\n".join(_EXPORT.sub("", _IMPORT.sub("", _file(name))) for name in (*MODULES, *more)) + "\n"


def _file(name: str) -> str:
    return (files("vibrojax.explorer") / "page" / name).read_text(encoding="utf-8")


def content_policy(scripts: Sequence[str], styles: Sequence[str], asks: bool = False) -> str:
    """Return the policy of a page that may use only scripts and style sheets with these contents.

    `asks`: whether the page may send requests to its own server.
    """

    def hashes(texts: Sequence[str]) -> str:
        digests = (base64.b64encode(sha256(text.encode()).digest()).decode() for text in dict.fromkeys(texts))
        return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"

    rules = {
        "default-src": "'none'",
        "script-src": hashes(scripts),
        "style-src": hashes(styles),
        "img-src": "data:",  # pictures embedded in the page, and an empty icon, so that the browser requests none
        "connect-src": "'self'" if asks else "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in rules.items())
