"""A page to click through: one module of JavaScript behind a self-contained file, a live server and a widget.

(The public function is `vibrojax.explore`; a folder of that name would hide it.)

`mount(element, {data, source, state, onPick, onState})` of `page/mount.js` shows a dataset in an element of a page:

- `data`: the *document* of a dataset, what `document_of` makes, as JSON (below).
- `source`: where motions come from: `{cell(lane), motion(parameters, start)}`, both promises of a cell, or of null
  where there is none. `lane` is the number of the lane, or of the point of a family. A page reads its own
  (`embeddedSource`); a server or a widget answers with `encode([cell])`, of which `decodeCells(buffer)[0]` is the
  cell. `cells_of(ds)` makes the cells of all lanes; `cell_of(motion)` that of a trajectory, which has its own
  `numbers`, by the names of the document's variables.
- `state`: the fragment of an address, `variable=regime&x=gamma&y=beta&at.beta=0.4&...`; `onState(state)` hears of
  changes.
- `onPick({cell, lane, values})` hears of every chosen cell: indices by axis, its lane, and its coordinates by name.

It gives `{pick(cell), show(changes), showMotion(cell), restore(state), state, calls(), destroy()}`. The module as one
text, style and page: `module_text(exported=True)`, `style_text()`, `page_text(document)`.

**The document:**

    {"format": 1, "kind": "grid" | "family" | "motion" | "borders",
     "title", "scene", "source", "notes": [text, ...],
     "axes": [{"name", "label", "symbol", "units" and "factor" (shown = value * factor), "numeric", "log",
               "values": [...], "columns": [the same, along a list of points or starts]}],
     "variables": [{"name", "label", "long_name", "units", "factor", "axes": [names], "flags": {flag: meaning} | null,
                    "colours": {flag: colour} | null, "map": a name in `maps` | null, "low", "high" (shown), "log",
                    "extend", "nothing_at_zero", "whole", "data": a packed array, see `packed.py`}],
     "maps": {name: 256 colours},
     "lanes": a packed array with its "axes": the number of the lane of each cell | null,
     "fixed": {coordinates without an axis},
     "region": {axis: [low, high]}: the source's, SI,
     "run": what the command line of a cell is made of, see `run.py`: {"own_scene": true}, or {"own_scene": false,
            "scene", "parameters": {name: value}, "options", "start": word, vector or null, "duration", and what may be
            written: "names" of parameters, "starts", "states" of a vector, "rocks"} | null,
     "curves": {"colours": {kind: colour}, "list": [{"kind", "at": {axis: value}, "points": {axis: values}}]} | null,
     "family": {"runs", "special", ...} only of families,
     "cells": {"size", "blocks"} of those that a page holds | null,
     "without": why there are no motions}

The form of a cell is that of `cells.py`.
"""

from vibrojax.explorer.cells import Cell as Cell
from vibrojax.explorer.cells import decode as decode
from vibrojax.explorer.cells import encode as encode
from vibrojax.explorer.of_dataset import cells_of as cells_of
from vibrojax.explorer.of_dataset import document_of as document_of
from vibrojax.explorer.of_dataset import explored as explored
from vibrojax.explorer.trajectory import cell_of as cell_of
from vibrojax.explorer.write import module_text as module_text
from vibrojax.explorer.write import page_text as page_text
from vibrojax.explorer.write import style_text as style_text
from vibrojax.explorer.write import write_page as write_page
